"""Curves through readings: splines that follow them, and not their noise."""

import numpy as np
import pytest
from scipy.interpolate import make_smoothing_spline

from ringwear_par.files.smoothing import curve, penalised


def test_a_spline_with_knots_at_all_readings_is_the_smoothing_spline_of_scipy():
    """Two readings at each knot are one of twice the weight."""
    knots = np.linspace(0.0, 3.0, 24)
    x = np.repeat(knots, 2)
    value = np.sin(x) + 0.1 * np.random.default_rng(0).standard_normal(48)
    spline, _ = penalised(x, value, 24)
    # what its penalty is follows from the least: f (y - f) = penalty times the integral of f''^2
    bends = spline.derivative(2)(np.linspace(0.0, 3.0, 47))  # straight between knots
    weights = np.array([1.0, *[4.0, 2.0] * 22, 4.0, 1.0]) * (knots[1] / 6.0)
    penalty = float(spline(x) @ (value - spline(x)) / (weights @ bends**2))
    assert 1e-5 < penalty < 1.0
    mean = value.reshape(24, 2).mean(axis=1)
    expected = make_smoothing_spline(knots, mean, w=np.full(24, 2.0), lam=penalty)(knots)
    np.testing.assert_allclose(spline(knots), expected, rtol=1e-8)


def test_cross_validation_follows_friction_and_not_its_noise():
    t, rng = np.linspace(20.0, 7200.0, 360), np.random.default_rng(1)
    mu = 0.15 - 0.04 * np.exp(-t / 1200.0)
    smoothed = curve(t, mu * (1.0 + 0.02 * rng.standard_normal(360)), "auto", 7200.0)
    assert np.abs(smoothed(t) / mu - 1.0).max() < 0.02
    assert np.std(smoothed(t) / mu) < 0.005
    assert smoothed(0.0) == smoothed(20.0)
    wave = 0.02 * np.sin(2.0 * np.pi * t / 1200.0) * (t > 4800.0)  # late, where knots are far apart
    followed = curve(t, (mu + wave) * (1.0 + 0.02 * rng.standard_normal(360)), "auto", 7200.0)
    assert np.std(followed(t) / (mu + wave)) < 0.012


def test_of_waves_of_the_given_period_half_is_left():
    t = np.linspace(0.0, 1000.0, 4000)
    smoothed = curve(t, 1.0 + 0.1 * np.sin(2.0 * np.pi * t / 50.0), 50.0, 1000.0)(t)
    assert np.ptp(smoothed[1000:3000]) == pytest.approx(0.1, rel=0.01)
