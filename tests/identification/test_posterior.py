"""What is assumed of specimens and sizes, against integrals over the material's value."""

import numpy as np
import pytest
from linear_tests import KEYS, emulator, experiment, parameter, problem, series
from parts import ProcessNoise
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, truncnorm
from scipy.stats import t as student_t

from ringwear_par.identification.definition.problem import Prior, Scatter
from ringwear_par.identification.likelihood import EmulatedLikelihood, TestLikelihood
from ringwear_par.identification.noise import Setting
from ringwear_par.identification.posterior import Posterior

RNG = np.random.default_rng(3)
BATCHES = np.array([0, 0, 1, 1, 1])
LOW, HIGH = -1.0, 1.5
READ = series([0.3, -0.1], 0.5)


def problem_of(sizes, *more, **settings):
    """Return a problem of five specimens, of two batches, whose first key scatters."""
    tests = [experiment(READ, name=f"T{i}", groups=(f"S{i}", f"B{b}", ""))
             for i, b in enumerate(BATCHES)]  # fmt: skip
    scattering = parameter(0, (LOW, HIGH), scatter=Scatter(sizes, 0.4))
    return problem([scattering, *more], tests, **settings)


def theta_of(prior, count=6):
    """Return theta (count, d) within the bounds, specimens near each other or not."""
    theta = 0.3 * RNG.standard_normal((count, prior.dimension))
    for size in prior.sizes:
        theta[:, size.place] = np.log(RNG.uniform(0.05, 0.6, count))
    return theta


def half_t(log_size, scale):
    """Return the log density of the logarithm of a size, but for a constant."""
    return student_t.logpdf(np.exp(log_size) / scale, 4) + log_size


def same_but_for_a_constant(found, expected, most=1e-6):
    found, expected = np.asarray(found), np.asarray(expected)
    assert found - found[0] == pytest.approx(expected - expected[0], abs=most)


def test_the_material_is_integrated_out():
    prior = Posterior(problem_of({"specimen": None}))
    theta, expected = theta_of(prior), []
    for one in theta:
        tau, x = np.exp(one[0]), one[1:]
        weight, _ = quad(lambda b, x=x, t=tau: np.exp(norm.logpdf(x, b, t).sum()), LOW, HIGH,
                         epsabs=0.0, limit=200, points=[x.mean()])  # fmt: skip
        expected.append(np.log(weight) + half_t(one[0], 0.4))
    same_but_for_a_constant(prior.log_prior(theta), expected)
    # and is drawn again
    many = prior.material(np.tile(theta[0], (20_000, 1)), np.random.default_rng(0))[:, 0]
    mean, sd = theta[0, 1:].mean(), np.exp(theta[0, 0]) / np.sqrt(5)
    known = truncnorm((LOW - mean) / sd, (HIGH - mean) / sd, mean, sd)
    assert many.mean() == pytest.approx(known.mean(), abs=0.03 * sd)
    assert many.std() == pytest.approx(known.std(), rel=0.03)


def test_specimens_of_a_batch_share_a_deviation():
    prior = Posterior(problem_of({"specimen": None, "batch": 0.25}))
    theta, expected = theta_of(prior), []
    same = np.equal.outer(BATCHES, BATCHES)
    for one in theta:
        matrix, x = np.exp(2.0 * one[0]) * np.eye(5) + 0.25**2 * same, one[1:]
        centre = np.linalg.solve(matrix, x).sum() / np.linalg.inv(matrix).sum()
        weight, _ = quad(
            lambda b, x=x, m=matrix: np.exp(multivariate_normal.logpdf(x - b, cov=m)), LOW, HIGH,
            epsabs=0.0, limit=200, points=[np.clip(centre, LOW + 0.01, HIGH - 0.01)],
        )  # fmt: skip
        expected.append(np.log(weight) + half_t(one[0], 0.4))
    same_but_for_a_constant(prior.log_prior(theta), expected, 1e-5)
    (scattering,) = prior.scatterings
    assert [len(np.unique(groups, axis=0)) for groups in scattering.same] == [5, 2]
    assert scattering.spread(theta) == pytest.approx(np.hypot(np.exp(theta[:, 0]), 0.25))


def test_what_is_outside_is_impossible():
    more = parameter(1, (0.5, 8.0), log=True, prior=Prior(2.0, 0.3))
    process = {"wear.lower": ProcessNoise(scale=0.05), "wear.upper": ProcessNoise(share=0.02)}
    prior = Posterior(problem_of({"specimen": 0.3}, more, process=process))
    assert (prior.dimension, [s.place for s in prior.wear_shares]) == (7, [1, None])
    theta = theta_of(prior)
    theta[:, 0] = np.log(RNG.uniform(0.6, 4.0, 6))
    expected = norm.logpdf(np.exp(theta[:, 0]), 2.0, 0.3) + theta[:, 0] + half_t(theta[:, 1], 0.05)
    specimens = [norm.logpdf(x, x.mean(), 0.3).sum() for x in theta[:, 2:]]
    same_but_for_a_constant(prior.log_prior(theta), expected + specimens, 1e-3)
    for place, value in ((0, np.log(8.1)), (0, np.log(0.4)), (1, np.log(1.1)), (1, np.log(9e-4))):
        moved = theta[:1].copy()
        moved[0, place] = value
        assert prior.log_prior(moved) == -np.inf
    np.testing.assert_array_equal(prior.shares(theta)[:, 1], 0.02)
    anywhere = prior.anywhere(2000, RNG)
    assert np.isfinite(prior.log_prior(anywhere)).all()


def test_tests_of_a_specimen_share_its_value():
    tests = [experiment(READ, name=name, groups=(specimen, "", ""))
             for name, specimen in (("a", "S1"), ("b", "S2"), ("c", "S1"))]  # fmt: skip
    of = problem(
        [parameter(0, (LOW, HIGH), scatter=Scatter({"specimen": 0.2})), parameter(1)], tests
    )
    slopes = np.array([[1.0, 0.5], [0.2, -1.0]])
    emulated = emulator(np.zeros(2), slopes, [-1.0, -2.0], [1.0, 2.0])
    setting = Setting(READ.sd, np.zeros(2))
    likelihoods = [EmulatedLikelihood(TestLikelihood(test, setting, np.zeros(0)), emulated)
                   for test in tests]  # fmt: skip
    posterior = Posterior(of, likelihoods)
    theta = np.array([[0.5, -0.3, 0.4], [0.1, 0.2, 0.3], [2.5, 0.0, 0.0]])
    np.testing.assert_array_equal(
        posterior.of_tests(theta)[0], [[-0.3, 0.5], [0.4, 0.5], [-0.3, 0.5]]
    )
    prior, likelihood = posterior.parts(theta)
    assert prior[2] == -np.inf  # out of the box, within the bounds
    logs = [norm.logpdf(READ.value, slopes @ x, READ.sd).sum() for one in theta[:2]
            for x in posterior.of_tests(one)]  # fmt: skip
    assert prior[:2] == pytest.approx(posterior.log_prior(theta[:2]))
    same_but_for_a_constant(likelihood[:2], np.reshape(logs, (2, 3)).sum(axis=1))
    assert posterior.problem.keys == KEYS
