"""log p of readings: against dense covariances, and integrals by quadrature."""

from dataclasses import replace

import numpy as np
import pytest
from linear_tests import END, emulator, experiment, series
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal, norm
from scipy.stats import t as student_t

from ringwear_par.identification.definition.problem import GROWTH_TIME, Nuisance, Prior
from ringwear_par.identification.likelihood import EmulatedLikelihood, TestLikelihood
from ringwear_par.identification.noise import Setting

RNG = np.random.default_rng(2)
N = 12
LOW, HIGH = [-1.0, -1.0], [1.0, 1.0]
SLOPES = RNG.standard_normal((N + 5, 2))
X = RNG.uniform(-1.0, 1.0, (4, 2))
#: mm^2, variance of an offset that is free
FREE = 1e5


def setting(test, **more):
    """Return a setting with the noise that is given."""
    sd = np.concatenate([one.sd for one in test.series])
    return Setting(sd, np.zeros(test.n), **more)


def constant(test):
    """Return what log densities have that log p leaves out."""
    return 0.5 * test.n * np.log(2.0 * np.pi) + np.log(setting(test).sd).sum()


def both(test, given, shares=()):
    """Return log p (4,) at the points by readings, having checked that emulators say the same."""
    shares, slopes = np.array(shares, dtype=float), SLOPES[: test.n]
    likelihood = TestLikelihood(test, given, shares)
    found = likelihood(X @ slopes.T)
    emulated = EmulatedLikelihood(likelihood, emulator(np.zeros(test.n), slopes, LOW, HIGH), ())
    again = emulated(emulated.emulator.coordinates(X), np.tile(shares, (4, 1)))
    assert again == pytest.approx(found, abs=1e-7)
    return found


@pytest.fixture(scope="module")
def rough():
    """A test with a record of correlated noise, and a second one, both of random wear."""
    nuisances = Nuisance("offset"), Nuisance("drift", Prior(0.3, 0.4))
    record = series(RNG.standard_normal(N), nuisances=nuisances, correlation_time=20.0)
    return experiment(record, series(RNG.standard_normal(5), 0.2, name="second"))


def covariance(test):
    """Return mean and covariance of a test's noise and nuisances."""
    record, second = test.series
    drift = np.concatenate([record.x / END, np.zeros(second.n)])
    first = np.arange(test.n) < record.n
    noise = np.diag(np.concatenate([record.sd, second.sd]) ** 2)
    decay = np.exp(-np.abs(np.subtract.outer(record.x, record.x)) / 20.0)
    noise[:N, :N] = record.sd[0] ** 2 * decay
    return 0.3 * drift, noise + FREE * np.outer(first, first) + 0.16 * np.outer(drift, drift)


def clocks(test):
    """Return how readings follow two bodies' wear, and at which shares of their depths."""
    times = np.concatenate([one.x for one in test.series]) / END
    return (1.0 + times, times), (2.0 - times**2, times**2)


def dense(test, shares=(), scales=()):
    """Return log p (4,) by a covariance of all that is random."""
    mean, matrix = covariance(test)
    for (slope, depth), share in zip(clocks(test), shares, strict=False):
        matrix += share**2 * np.outer(slope, slope) * np.minimum.outer(depth, depth)
    for column in scales:
        matrix += np.outer(column, column)
    rest = np.concatenate([one.value for one in test.series]) - X @ SLOPES[: test.n].T - mean
    logs = multivariate_normal.logpdf(rest, cov=matrix)
    return logs + constant(test) + 0.5 * np.log(FREE)


def test_noise_and_nuisances_are_those_of_a_dense_covariance(rough):
    assert both(rough, setting(rough)) == pytest.approx(dense(rough), abs=1e-4)
    scale = 0.1 * np.arange(rough.n)
    found = both(rough, setting(rough, scales=(scale,)))
    assert found == pytest.approx(dense(rough, (), [scale]), abs=1e-4)


def test_random_wear_is_a_covariance_of_all_readings(rough):
    shares = np.array([0.3, 0.08])
    given = setting(rough, clocks=clocks(rough))
    assert both(rough, given, shares) == pytest.approx(dense(rough, shares), abs=1e-4)


@pytest.mark.parametrize("bodies", [1, 2])
def test_shares_of_random_wear_between_nodes(rough, bodies):
    given = setting(rough, clocks=clocks(rough)[:bodies])
    shares = np.exp(RNG.uniform(np.log(2e-3), np.log(0.9), (4, bodies)))
    likelihood = TestLikelihood(rough, given, shares[0])
    emulated = EmulatedLikelihood(likelihood, emulator(np.zeros(rough.n), SLOPES, LOW, HIGH))
    found = emulated(emulated.emulator.coordinates(X), shares)
    expected = [dense(rough, of)[i] for i, of in enumerate(shares)]
    assert found == pytest.approx(expected, abs={1: 2e-3, 2: 0.3}[bodies])


@pytest.mark.parametrize("known", [True, False])
def test_growth_times_are_integrated(known):
    """Against quadrature over the time, the amplitude in a covariance; and draws of both."""
    amplitude = Nuisance("thermal", Prior(-1.0, 0.8) if known else None)
    time = Nuisance(GROWTH_TIME, Prior(25.0, 6.0), (5.0, 60.0), 25.0)
    record = series(-2.0 * -np.expm1(-np.arange(1, N + 1) / 3.0) + 0.2 * RNG.standard_normal(N),
                    0.2, nuisances=(amplitude, time))  # fmt: skip
    test = experiment(record)
    given = replace(Setting.before(test), sd=record.sd)
    mean, variance = (-1.0, 0.64) if known else (0.0, FREE)

    def density(t, x):
        column = -np.expm1(-record.x / t)
        rest = record.value - SLOPES[:N] @ x - mean * column
        matrix = np.diag(record.sd**2) + variance * np.outer(column, column)
        log_p = multivariate_normal.logpdf(rest, cov=matrix) + constant(test)
        return np.exp(log_p - 0.5 * ((t - 25.0) / 6.0) ** 2 - np.log(6.0))

    low, high = 5.0, 52.0  # the prior's 4.5 sd, within the bounds
    x = X[:2] * 0.02
    moments = [[quad(lambda t, x=x, k=k: t**k * density(t, x), low, high)[0] for k in (0, 1)]
               for x in x]  # fmt: skip
    free = 0.0 if known else 0.5 * np.log(FREE)
    likelihood = TestLikelihood(test, given, np.zeros(0))
    found = likelihood(x @ SLOPES[:N].T)
    assert found == pytest.approx([np.log(zero) + free for zero, _ in moments], abs=1e-4)
    many = np.tile(SLOPES[:N] @ x[0], (4000, 1))
    added, values = likelihood.nuisance_draws(many, np.random.default_rng(0))
    times = values[0, GROWTH_TIME]
    assert times.mean() == pytest.approx(moments[0][1] / moments[0][0], abs=0.3)
    one = values[0, "thermal"][:, None] * -np.expm1(-record.x / times[:, None])
    np.testing.assert_allclose(added, one, atol=1e-9)


def test_an_sd_that_is_fitted_is_integrated():
    """Flat in its logarithm, a free offset beside it; constants are those of no data."""
    record = series(RNG.standard_normal(N), sd_fitted=True, nuisances=(Nuisance("offset"),))
    test = experiment(record)
    expected = []
    for x in X:
        rest = record.value - SLOPES[:N] @ x

        def density(log_scale, rest=rest):
            matrix = np.exp(2.0 * log_scale) * np.diag(record.sd**2) + FREE
            log_p = multivariate_normal.logpdf(rest, cov=matrix) + constant(test)
            return np.exp(log_p + 0.5 * np.log(FREE))

        expected.append(np.log(2.0 * quad(density, -1.0, 4.0, epsabs=0.0)[0]))
    assert both(test, setting(test)) == pytest.approx(expected, abs=1e-4)


def test_limits_are_probabilities_that_they_hold():
    sides = np.array([0] * 8 + [1, 1, -1, -1])
    test = experiment(series(RNG.standard_normal(N), censored=sides))
    record, model = test.series[0], X @ SLOPES[:N].T
    t = (model - record.value) / record.sd
    expected = np.where(sides == 0, -0.5 * t**2, norm.logcdf(sides * t)).sum(axis=1)
    assert both(test, setting(test)) == pytest.approx(expected, abs=1e-9)
    far = TestLikelihood(test, setting(test), np.zeros(0))(np.full((1, N), -1e3))
    assert np.isfinite(far).all()


def test_long_tails_end_at_the_mode_of_students_t():
    value = np.concatenate([RNG.standard_normal(38), [14.0, 9.0]])
    test = experiment(series(value, 1.0, nuisances=(Nuisance("offset"),)))
    given = Setting.before(test, "student")
    assert given.sd == pytest.approx(2.0)  # readings may be outliers
    for _ in range(50):
        likelihood = TestLikelihood(test, given, np.zeros(0))
        given = likelihood.adapted(np.zeros(40), "student")
    best = minimize_scalar(lambda o: -student_t.logpdf(value - o, 4).sum(), (-1.0, 1.0)).x
    assert given.expected[0] == pytest.approx(best, abs=1e-6)
    # about as much as the Fisher information of Student's t, 5/7 of that of a normal one
    drawn = likelihood.nuisance_draws(np.zeros((4000, 40)), np.random.default_rng(0))[1]
    assert drawn[0, "offset"].var() == pytest.approx(7 / 5 / 40, rel=0.3)


def test_what_tells_nothing_changes_nothing():
    """A compliance under constant load, a test in which nothing wears, and no points at all."""
    of = Nuisance("compliance"), Nuisance("offset")
    test, none = experiment(series(RNG.standard_normal(N), nuisances=of)), np.zeros(N)
    likelihood = TestLikelihood(test, setting(test, clocks=((none, none),)), np.array([0.1]))
    _, values = likelihood.nuisance_draws(np.zeros((5, N)), np.random.default_rng(0))
    assert not values[0, "compliance"].any()
    worn = likelihood.noises[0].random_wear(np.zeros((N, 3)), np.random.default_rng(0))
    assert np.abs(worn).max() < 1e-12
    emulated = EmulatedLikelihood(likelihood, emulator(none, SLOPES[:N], LOW, HIGH))
    assert emulated(np.zeros((0, 2)), np.zeros((0, 1))).shape == (0,)
