"""Draws: moments of the mixtures and of the gamma process, and when a depth is reached."""

import numpy as np
import pytest

from ringwear_par.errors import InputError
from ringwear_par.identification.fitted_values import FittedValues
from ringwear_par.prediction.draws import MATERIAL, NEXT, draw_paces, draw_values
from ringwear_par.prediction.prediction import Prediction

DRAWS = 40_000
#: standard errors that a moment may be off
OFF = 4.0


@pytest.fixture
def values():
    """Two keys, the first one's logarithm scatters; three places: material, two specimens."""
    rng = np.random.default_rng(1)
    roots = 0.3 * rng.standard_normal((2, 3, 2, 2))
    return FittedValues(
        ("k", "p0"), np.array([True, False]), np.array([[1e-9, 1e9], [-1e9, 1e9]]),
        np.array([0.3, 0.7]), rng.standard_normal((2, 3, 2)), roots @ np.swapaxes(roots, -1, -2),
        np.array([[0.5], [1.0]]), np.array([0]), np.array([[1e-5, 0.0], [2e-5, 0.0]]),
        ("S1", "S2"), ("archard", ""), np.zeros((2, 5)),
    )  # fmt: skip


@pytest.mark.parametrize(("of", "place"), [(MATERIAL, 0), (NEXT, 0), ("S2", 2)])
def test_draws_have_the_moments_of_their_mixture(values, of, place):
    drawn, sizes = draw_values(values, of, DRAWS, np.random.default_rng(2))
    unknowns = np.column_stack([np.log(drawn[:, 0]), drawn[:, 1]])
    if of == MATERIAL:
        assert not sizes.any()
    else:  # drawn with the values of their part
        assert (sizes[0] == 2e-5).mean() == pytest.approx(0.7, abs=0.01)
    means, weights = values.means[:, place], values.weights
    mean = weights @ means
    shifts = means - mean
    covariance = np.einsum("g,gij->ij", weights, values.covariances[:, place])
    covariance += np.einsum("g,gi,gj->ij", weights, shifts, shifts)
    if of == NEXT:
        covariance[0, 0] += weights @ values.scatters[:, 0] ** 2
    sd = np.sqrt(np.diag(covariance))
    assert np.abs((unknowns.mean(axis=0) - mean) / sd).max() < OFF / np.sqrt(DRAWS)
    off = (np.cov(unknowns.T) - covariance) / np.outer(sd, sd)
    assert np.abs(off).max() < 2.0 * OFF / np.sqrt(DRAWS)


def test_worn_depth_is_a_gamma_process():
    """Mean S and variance size S at every S, whatever the steps; none without noise."""
    size, depth = 1e-5, np.cumsum([1e-6, 0.0, 3e-6, 6e-6, 40e-6])
    depths = np.tile(depth, (DRAWS, 2, 1))
    sizes = np.stack([np.full(DRAWS, size), np.zeros(DRAWS)])
    paces = draw_paces(depths, sizes, np.random.default_rng(3))
    worn = np.cumsum(paces * np.diff(depths, prepend=0.0), axis=-1)
    assert (paces[:, 1] == 1.0).all()
    sd = np.sqrt(size * depth)
    assert np.abs((worn[:, 0].mean(axis=0) - depth) / sd).max() < OFF / np.sqrt(DRAWS)
    kurtosis = 3.0 + 6.0 * size / depth
    off = np.abs(worn[:, 0].var(axis=0) / sd**2 - 1.0)
    assert (off < OFF * np.sqrt((kurtosis - 1.0) / DRAWS)).all()


def test_a_depth_is_reached_by_some_draws_only():
    """Draw i wears i + 1 um/s, linearly between unequal steps."""
    time = np.array([0.0, 1.0, 4.0, 10.0])
    depth = 1e-3 * np.outer(np.arange(1, 101), time)
    prediction = Prediction(
        NEXT, "fit", "", 0, {}, np.zeros((100, 0)), np.zeros((2, 100)), time,
        {"penetration": depth}, 0, (), (), {},
    )  # fmt: skip
    reached = prediction.time_to(0.1)
    assert reached.reached == pytest.approx(0.91)
    assert reached.median == pytest.approx(0.1 / 51e-3)
    assert reached.interval == (pytest.approx(0.1 / 98e-3), None)
    with pytest.raises(InputError, match="> 0"):
        prediction.time_to(-1.0)
    with pytest.raises(InputError, match="penetration"):
        prediction.quantiles("depth")
