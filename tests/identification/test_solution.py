"""Draws from outside in, where readings are formulas: what is known, what cannot be followed."""

import numpy as np
import pytest
from linear_tests import LinearReadings, experiment, parameter, problem, series
from parts import Scatter
from scipy.stats import t

import ringwear_par as rw
from ringwear_par.identification.solution import solve

RNG = np.random.default_rng(7)
SLOPES = np.column_stack([np.linspace(0.2, 1.0, 20), np.linspace(-1.0, 1.0, 20) ** 2])
TRUTH = np.array([1.0, -0.5])
DATA = SLOPES @ TRUTH + 0.05 * RNG.standard_normal(20)
BOTH = parameter(0), parameter(1)


def solved(parameters, *functions, data=DATA, sd=0.05, seed=0):
    """Return the solution of tests with equal data whose readings are functions of unknowns."""
    tests = [experiment(series(data, sd), name=f"T{i}", groups=(f"S{i}", "", ""))
             for i in range(len(functions))]  # fmt: skip
    return solve(LinearReadings(problem(parameters, tests), *functions), seed)


def linear(x):
    return x @ SLOPES.T


def test_a_linear_test_has_the_posterior_of_least_squares():
    """With its evidence, from bounds that are 200 sd wide."""
    found = solved(BOTH, linear)
    covariance = np.linalg.inv(SLOPES.T @ SLOPES) * 0.05**2
    best = np.linalg.lstsq(SLOPES, DATA, rcond=None)[0]
    sd = np.sqrt(np.diag(covariance))
    assert found.best == pytest.approx(best, abs=0.02 * sd.min())
    assert found.theta.mean(axis=0) == pytest.approx(best, abs=0.1 * sd.min())
    np.testing.assert_allclose(np.cov(found.theta.T), covariance, rtol=0.15)
    rest = DATA - SLOPES @ best
    exact = (
        -0.5 * rest @ rest / 0.05**2 + np.log(2.0 * np.pi) + 0.5 * np.linalg.slogdet(covariance)[1]
    )
    low, high = found.problem.unknown_bounds
    assert found.log_evidence == pytest.approx(exact - np.log(high - low).sum(), abs=0.03)
    assert found.evidence_error < 0.02
    assert found.emulator_error < 0.1
    assert found.failed == 0
    other = solved(BOTH, linear, seed=1)
    ends = [np.quantile(one.theta, [0.025, 0.975], axis=0) for one in (found, other)]
    assert (np.abs(ends[0] - ends[1]) < 0.15 * sd).all()


@pytest.mark.parametrize("count", [6, 18])
def test_specimens_are_those_of_a_normal_model(count):
    """Each test tells its mean; the material's by Student's t where all are known alike."""
    values = np.tile([0.9, 1.0, 1.25, 0.8, 1.05, 1.3], count // 6)
    of = [parameter(0, (-20.0, 20.0), scatter=Scatter({"specimen": None}, 50.0))]

    def of_test(value):
        return lambda x: x[:, [0] * 20] - value  # data less value: the same for all tests

    found = solved(of, *map(of_test, values), data=np.zeros(20), sd=0.01)
    posterior = found.posterior
    material = posterior.material(found.theta, np.random.default_rng(0))[:, 0]
    # a prior of tau so wide is flat: t with n - 2 degrees of freedom
    spread = np.sqrt(values.var() / (count - 2))
    expected = values.mean() + spread * t.ppf([0.025, 0.5, 0.975], count - 2)
    assert np.quantile(material, [0.025, 0.5, 0.975]) == pytest.approx(expected, abs=0.15 * spread)
    each = posterior.of_tests(found.theta)[:, :, 0].mean(axis=0)
    assert each == pytest.approx(values, abs=0.005)


def test_regions_without_histories_are_counted():
    def only_some(x):
        return np.where(x[:, :1] > 1.02, np.nan, linear(x))

    # draws that are no case, as of a p0 below 0, are left out
    found = solved(BOTH, only_some, data=DATA + SLOPES @ [0.0, 1.0])
    assert np.quantile(found.theta[:, 0], 0.99) < 1.06
    assert 0 < found.failed < found.histories
    with pytest.raises(rw.ComputationError, match="no history at any draw: no history there"):
        solved(BOTH, lambda x: np.full((len(x), 20), np.nan))


def test_readings_that_polynomials_cannot_follow_are_told_or_refused():
    """Jumps of some sd; and ones so large that log p is any number."""

    def jumps(size):
        return lambda x: linear(x) + size * np.sign(np.sin(300.0 * x[:, :1]))

    found = solved(BOTH, jumps(0.004))
    assert 0.1 < found.emulator_error < 3.0
    assert np.abs(found.theta.mean(axis=0) - TRUTH).max() < 0.15
    with pytest.raises(
        rw.ComputationError, match=r"readings of T0: narrower bounds of wear\.lower\..*, or priors"
    ):
        solved(BOTH, lambda x: 50.0 * np.sin(1e4 * x[:, :1] * np.arange(1, 21)))
