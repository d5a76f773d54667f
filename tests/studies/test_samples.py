"""Sampled designs are those of SciPy, point by point."""

import numpy as np
import pytest
from scipy.stats import qmc

from ringwear_par.studies.definition.samples import MOST_AXES, latin_hypercube, sobol


@pytest.mark.parametrize(
    ("count", "axes", "seed"), [(1, 1, 0), (1000, 3, 1), (9, MOST_AXES, 10**18)]
)
def test_points_are_those_of_scipy(count, axes, seed):
    drawn = qmc.Sobol(axes, seed=seed).random_base2((count - 1).bit_length())
    np.testing.assert_array_equal(sobol(count, axes, seed), drawn[:count])
    drawn = qmc.LatinHypercube(axes, seed=seed).random(count)
    np.testing.assert_array_equal(latin_hypercube(count, axes, seed), drawn)
