"""What fits tell of readings and keys, against the likelihood itself and known distributions."""

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.identification.fitted_tests import readings_of_draws
from ringwear_par.identification.key_estimates import judged


@pytest.fixture(scope="module")
def fitted(good):
    """Return the fit of two tests."""
    return rw.fit(good)


def test_replicas_are_about_as_far_off_as_the_readings(fitted):
    """And log p of the readings is about that of their residuals, and of bands that widen them."""
    emulated, x = fitted.solution.posterior.likelihoods[0], fitted.draws.tests[:, 0]
    logs, replicas = readings_of_draws(emulated, x, np.random.default_rng(0))
    model, sd, band, residuals = (
        np.concatenate([getattr(one, name) for one in fitted.tests[0].series])
        for name in ("model", "sd", "band", "residuals")
    )
    off = (replicas - model) / np.hypot(sd, band)
    assert abs(off.mean()) < 0.02
    assert off.std() == pytest.approx(1.0, abs=0.03)
    squares = residuals**2 + (band / sd) ** 2
    expected = -0.5 * squares - np.log(sd) - 0.5 * np.log(2.0 * np.pi)
    assert logs.mean(axis=0) == pytest.approx(expected, abs=0.15)


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
