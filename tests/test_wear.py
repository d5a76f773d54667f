"""Wear laws: values, and slope and potential as derivative and integral of the rate."""

import numpy as np
import pytest

from ringwear_par.wear import StepWear, ThresholdLaw

P = np.array([0.0, 10.0, 39.0, 41.0, 100.0])
POWER = np.array([1.0, 2.0, 3.0, 4.0, 5.0])


def test_threshold_law_is_equation_4():
    rate = ThresholdLaw(1e-7, 40.0).rate(P, POWER)
    assert rate == pytest.approx([0, 0, 0, 4e-7, 3e-5])
    assert ThresholdLaw(1e-7).proportional == 1e-7
    assert ThresholdLaw(1e-7, 1.0).proportional is None


@pytest.mark.parametrize("law", [ThresholdLaw(1e-7, 40.0), ThresholdLaw(2e-6)])
def test_taylor_remainders_of_rate_and_potential(law):
    pressure = P + 5.0  # away from the kinks, where one-sided slopes are all there is
    step = StepWear((law, ThresholdLaw(5e-7, 70.0)), POWER, 3.0)
    direction = np.array([0.3, -0.2, 0.1, 0.2, -0.5])
    for f, derivative in ((step.depth, step.slope), (step.potential, step.depth)):
        first = f(pressure), derivative(pressure) * direction
        remainders = [
            np.abs(f(pressure + h * direction) - first[0] - h * first[1]).max()
            for h in (1e-1, 1e-2, 1e-3)
        ]
        size = np.abs(first[1]).max()
        for h, remainder in zip((1e-1, 1e-2, 1e-3), remainders, strict=True):
            # piecewise linear rate: no remainder; quadratic potential: h^2
            assert remainder <= (1e-10 * size if f == step.depth else 0.05 * h * h * size + 1e-16)
