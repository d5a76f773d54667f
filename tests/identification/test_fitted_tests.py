"""What fits tell of readings and keys, against the likelihood itself and known distributions."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

import ringwear_par as rw
from ringwear_par.identification.fitted_tests import log_p_of_tests, readings_of_draws
from ringwear_par.identification.key_estimates import judged
from ringwear_par.identification.likelihood import TestLikelihood


@pytest.fixture(scope="module")
def fitted(good):
    """Return the fit of two tests."""
    return rw.fit(good)


def test_log_p_of_a_reading_given_the_others_is_a_difference(fitted):
    emulated, x = fitted.solution.posterior.likelihoods[0], fitted.draws.tests[:3, 0]
    whole, model = emulated.likelihood, emulated.emulator(x)
    found, _ = readings_of_draws(emulated, x, np.random.default_rng(0))
    test, first = whole.test, whole.test.series[0]
    for number in (0, 20, first.n - 1):
        kept = np.arange(test.n) != number
        part = replace(test, series=(first.part(kept[: first.n]), *test.series[1:]))
        sd, expected = whole.setting.sd, whole.setting.expected
        setting = replace(whole.setting, sd=sd[kept], expected=expected[kept])
        others = TestLikelihood(part, setting, whole.shares)(model[:, kept])
        constant = -np.log(sd[number]) - 0.5 * np.log(2.0 * np.pi)
        assert np.allclose(found[:, number], whole(model) - others + constant, atol=1e-8)


def test_replicas_are_about_as_far_off_as_the_readings(fitted):
    emulated, x = fitted.solution.posterior.likelihoods[0], fitted.draws.tests[:, 0]
    _, replicas = readings_of_draws(emulated, x, np.random.default_rng(0))
    test = fitted.tests[0]
    off = (replicas - test.model) / np.hypot(test.sd, test.band)
    assert abs(off.mean()) < 0.02
    assert off.std() == pytest.approx(1.0, abs=0.03)


def test_a_value_of_a_specimen_is_integrated_out():
    """Log p = -(x - 1)^2 / (2 0.5^2) of a test, x normal about the material with sd 2."""
    emulator = SimpleNamespace(coordinates=lambda x: x, holds=lambda x: np.ones(len(x), dtype=bool))

    class Emulated:
        def __call__(self, x, shares):
            return -2.0 * (x[:, 0] - 1.0) ** 2

    Emulated.emulator = emulator
    posterior = SimpleNamespace(scatterings=[SimpleNamespace(key=0)], likelihoods=[Emulated()])
    drawn = 1.0 + 0.5 * np.random.default_rng(0).standard_normal((1000, 1, 1))
    material = np.linspace(-1.0, 3.0, 1000)[:, None]
    found = log_p_of_tests(posterior, drawn, material, np.full((1000, 1), 2.0), np.zeros((1000, 0)))
    exact = norm.logpdf(material, 1.0, np.hypot(0.5, 2.0)) + 0.5 * np.log(2.0 * np.pi * 0.25)
    assert found == pytest.approx(exact, abs=0.05)


def test_verdicts_follow_the_density_at_bounds():
    normal = np.random.default_rng(0).standard_normal(20_000)
    verdict, interval = judged(normal, -10.0, 10.0, 6.0, 0.95)
    assert verdict == "identified"
    assert np.allclose(interval, [-1.96, 1.96], atol=0.05)
    verdict, (low, high) = judged(np.abs(normal), 0.0, 10.0, 3.0, 0.95)
    assert (verdict, low) == ("at bound", None)
    assert high == pytest.approx(1.96, abs=0.05)
    assert judged(-np.abs(normal), -10.0, 0.0, 3.0, 0.95)[1][1] is None
    assert judged(normal, -10.0, 10.0, 1.5, 0.95)[0] == "not identified"
    flat = np.random.default_rng(0).uniform(0.0, 1.0, 20_000)
    assert judged(flat, 0.0, 1.0, 1.0, 0.95) == ("not identified", [None, None])
