"""Verdicts that hold only while another key is at its bound."""

import numpy as np
import pytest

from ringwear_par.identification.estimation.intervals import ParameterEstimate
from ringwear_par.identification.fit_doubts import conditional_verdicts


def test_an_interval_that_another_key_s_bound_makes():
    """Of correlation r, fixing the one leaves sqrt(1 - r^2) of the other's sd."""
    estimates = [
        ParameterEstimate("k", 1e-7, 1e-8, (8e-8, 1.2e-7), "identified"),
        ParameterEstimate("distance", 2e4, 1e3, (1.8e4, None), "at bound"),
        ParameterEstimate("p0", 10.0, 1.0, (8.0, 12.0), "identified"),
    ]
    covariance = np.array([[4.0, 1.8, 0.0], [1.8, 1.0, 0.1], [0.0, 0.1, 1.0]])
    (warning,) = conditional_verdicts(estimates, covariance, ["k", "distance", "p0"], ["distance"])
    assert warning.keys == ("k", "distance")
    assert warning.values["growth_of_sd"] == pytest.approx(1.0 / np.sqrt(1.0 - 0.9**2))
    assert "only if distance = 20000, its bound" in warning.text
    assert conditional_verdicts(estimates, covariance, ["p0"], ["distance"]) == []
    assert conditional_verdicts(estimates, covariance, ["k"], []) == []  # a limit of readings
