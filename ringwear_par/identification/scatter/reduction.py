"""Tests reduced to normal equations: readings are looked at once, whatever scatters.

Noise, nuisances and the random part of wear are integrated here; what is left of a test speaks of
its fitted keys alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.model.noise import NuisanceProjection


@dataclass(frozen=True, eq=False)
class ReducedTest:
    """Normal equations of a test's unknowns, nuisances projected out."""

    #: (m, m) float, ``J' V^-1 J``
    information: FloatArray
    #: (m,) float, ``J' V^-1 z``, of the linearised readings z = y - h + J x
    score: FloatArray
    #: ``z' V^-1 z``
    square: float
    #: log determinants of V, and of the nuisances' normal matrix
    log_volume: float
    log_nuisances: float = 0.0


def with_fixed(test: ReducedTest, values: Mapping[int, float]) -> ReducedTest:
    """Return the normal equations of the other unknowns, where some have values, by number."""
    if not values:
        return test
    fixed = list(values)
    free = [j for j in range(len(test.score)) if j not in values]
    at, across = np.array([values[j] for j in fixed]), test.information[np.ix_(free, fixed)]
    square = test.square - 2.0 * at @ test.score[fixed]
    square += at @ test.information[np.ix_(fixed, fixed)] @ at
    return replace(
        test, information=test.information[np.ix_(free, free)],
        score=test.score[free] - across @ at, square=float(square),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class LinearisedTest:
    """A test linearised at its unknowns x, in units of its noise and without its correlation."""

    #: (n,) float, z = y - h(x) + J x
    readings: FloatArray
    #: (n, m) float, J
    jacobian: FloatArray
    #: (n, c) float, what unit nuisances add to the readings
    nuisances: FloatArray
    #: (r, c) and (r,) float, the nuisances' priors in units of their sd
    prior_rows: FloatArray
    prior_values: FloatArray
    #: log determinant of the noise's covariance
    log_volume: float
    #: (n, n) float, covariance that the random part of wear adds, for a size of 1 mm
    process: FloatArray | None = None


def reduce_test(test: LinearisedTest, sizes: Sequence[float] = (0.0,)) -> tuple[ReducedTest, ...]:
    """Return the normal equations of a test at each size of the random part of its wear.

    Nuisances are integrated: those without a prior as if it were infinitely wide.

    Parameters
    ----------
    sizes : mm, of the process noise; of no meaning to a test that has none.
    """
    rows = np.column_stack([test.readings, test.jacobian, test.nuisances])
    variances = np.zeros(len(rows))
    if test.process is not None:
        # one decomposition makes the covariances of all sizes diagonal
        variances, vectors = np.linalg.eigh(test.process)
        variances, rows = np.maximum(variances, 0.0), vectors.T @ rows
    m = test.jacobian.shape[1]
    no_keys = np.zeros((len(test.prior_values), m))
    priors = np.column_stack([test.prior_values, no_keys, test.prior_rows])
    return tuple(
        _reduce(rows, priors, 1.0 + size * variances, m, test.log_volume) for size in sizes
    )


def _reduce(
    rows: FloatArray, priors: FloatArray, variances: FloatArray, m: int, log_volume: float
) -> ReducedTest:
    """Return the normal equations of uncorrelated rows: readings, m keys, then the nuisances."""
    scaled = np.concatenate([rows / np.sqrt(variances)[:, None], priors])
    projection = NuisanceProjection(scaled[:, 1 + m :])
    rest = projection.rest(scaled[:, : 1 + m])
    products = rest.T @ rest
    return ReducedTest(
        products[1:, 1:], products[1:, 0], float(products[0, 0]),
        log_volume + float(np.log(variances).sum()), projection.log_volume,
    )  # fmt: skip
