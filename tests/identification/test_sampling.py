"""Draws of densities whose quantiles and integrals are known."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm
from scipy.stats import t as student_t

from ringwear_par.identification.sampling import draw, worth

TAILS = [0.025, 0.5, 0.975]


def drawn(log_likelihood, d, width=8.0, seed=1, bent=2):
    """Return draws of a likelihood, which count more than enough, from those of a wide normal."""
    random = np.random.default_rng(seed)
    start = width * random.standard_normal((2048, d))

    def log_prior(x):
        return norm.logpdf(x, 0.0, width).sum(axis=1)

    def parts(x):  # no prior in the end
        return log_prior(x), log_likelihood(x) - log_prior(x)

    found = draw(parts, start, log_prior(start), 1.0, bent, random, 4000.0)
    assert found.logs == pytest.approx(log_likelihood(found.draws))
    assert found.effective > 4000.0
    assert found.log_integral == pytest.approx(0.0, abs=max(4.0 * found.error, 1e-3))
    return found.draws


def test_a_bent_density():
    """X is normal, y about half its square: quantiles of a mixture, by as many numbers."""

    def banana(x):
        return norm.logpdf(x[:, 0], 0.0, 1.5) + norm.logpdf(x[:, 1], 0.5 * x[:, 0] ** 2, 0.5)

    draws, exact = drawn(banana, 2), np.random.default_rng(0).standard_normal((2, 200_000))
    exact[0] *= 1.5
    exact[1] = 0.5 * exact[0] ** 2 + 0.5 * exact[1]
    for x, true in zip(draws.T, exact, strict=True):
        width = np.diff(np.quantile(true, [0.025, 0.975]))[0] / 4
        assert np.quantile(x, TAILS) == pytest.approx(np.quantile(true, TAILS), abs=0.3 * width)


def test_a_funnel_whose_neck_is_not_narrow():
    def funnel(x):
        return norm.logpdf(x[:, 0]) + norm.logpdf(x[:, 1:], 0.0, np.exp(0.5 * x[:, :1])).sum(axis=1)

    size = drawn(funnel, 5, 3.0)[:, 0]
    assert np.quantile(size, TAILS) == pytest.approx(norm.ppf(TAILS), abs=0.2)


def test_ends_repeat_where_a_tail_is_long_and_bent():
    """X has a t distribution, y keeps to a bent ridge along it."""

    def ridge(x):
        middle = 0.3 * x[:, 0] + 0.03 * x[:, 0] ** 2
        return student_t.logpdf(x[:, 0], 4) + norm.logpdf(x[:, 1], middle, 0.05)

    ends = [np.quantile(drawn(ridge, 2, seed=seed)[:, 0], TAILS) for seed in range(5)]
    off = (np.array(ends) - student_t.ppf(TAILS, 4)) / np.sqrt(2.0)  # in its sd
    assert np.abs(off).max() < 0.1


def test_the_integral_of_a_density_of_many_entries():
    matrix = 0.3 + np.diag(np.geomspace(1e-4, 4.0, 12))
    known = multivariate_normal(np.arange(12.0), matrix)
    draws = drawn(known.logpdf, 12, 20.0, bent=1)
    assert draws.mean(axis=0) == pytest.approx(np.arange(12.0), abs=0.06)
    np.testing.assert_allclose(np.cov(draws.T), matrix, atol=0.2)


def test_what_points_are_worth():
    """As draws, those of a normal distribution themselves; ends of a long tail are known worse."""
    random, even = np.random.default_rng(3), np.ones(40_000)
    points = np.column_stack([random.standard_normal(40_000), random.standard_t(3, 40_000)])
    assert worth(points[:, :1], even) == (pytest.approx(40_000.0, rel=0.1), 0)
    effective, worst = worth(points, even)
    assert (effective < 28_000.0, worst) == (True, 1)
    some = (np.arange(40_000) < 10_000).astype(float)
    assert worth(points[:, :1], some)[0] == pytest.approx(10_000.0, rel=0.2)
    one = np.where(np.arange(40_000) == 7, 1.0, 1e-8)
    assert worth(points, one)[0] < 2.0
