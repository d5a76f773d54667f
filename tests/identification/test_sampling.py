"""Draws of densities whose quantiles and integrals are known."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from ringwear_par.identification.sampling import (
    correlation_time,
    draw,
    log_evidence,
)

TAILS = [0.025, 0.5, 0.975]


def drawn(log_likelihood, d, width=8.0, seed=1):
    """Return draws, and their effective number, of a likelihood with a wide normal prior."""
    random = np.random.default_rng(seed)
    start = width * random.standard_normal((2048, d))

    def log_prior(x):
        return norm.logpdf(x, 0.0, width).sum(axis=1)

    def log_p(x, power=1.0):
        return log_prior(x) * (1.0 - power) + power * log_likelihood(x)

    draws, logs, effective = draw(log_p, start, log_prior(start), 1.0, random, 4000.0)
    assert logs == pytest.approx(log_likelihood(draws))
    assert effective > 2500.0  # chains end, whatever they are worth
    return draws


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


def test_the_integral_of_a_density():
    matrix = 0.3 + np.diag([1.0, 1e-4, 4.0, 0.5])
    draws = np.random.default_rng(2).multivariate_normal(np.arange(4.0), matrix, 4000)
    known = multivariate_normal(np.arange(4.0), matrix)
    found, error = log_evidence(lambda x: known.logpdf(x) + 7.0, draws)
    assert error < 0.02
    assert found == pytest.approx(7.0, abs=4.0 * error)


def test_how_long_chains_remember():
    """Of an AR(1) process, (1 + r) / (1 - r) states."""
    random, chain = np.random.default_rng(6), np.zeros((4000, 64, 2))
    for i in range(1, 4000):
        chain[i] = np.array([0.9, 0.2]) * chain[i - 1] + random.standard_normal((64, 2))
    assert correlation_time(chain) == pytest.approx(19.0, rel=0.05)
