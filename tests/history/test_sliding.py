"""Sliding at a speed that changes along lines: distance, and energy as torque times angle."""

import numpy as np
import pytest
from mpi4py import MPI
from paths import PAPER

import ringwear_par as rw


def test_distance_and_energy_are_integrals_of_the_schedule():
    """Steps end neither where it bends nor only at its start."""
    keys = {"load.omega": [[0.0, 1.0], [10.0, 3.0], [25.0, 0.5]], "mesh.contact_elements": 16,
            "time.step": 3.0, "time.steps": 11}  # fmt: skip
    result = rw.simulate(rw.read_case(PAPER, keys), MPI.COMM_SELF)
    found, time = result.histories, result.histories["time"]
    first, then = np.minimum(time, 10.0), np.clip(time - 10.0, 0.0, 15.0)
    angle = first + 0.1 * first**2 + 3.0 * then - then**2 / 12.0 + 0.5 * np.maximum(time - 25.0, 0)
    distance = result.to_xarray()["sliding_distance"].values
    assert distance == pytest.approx(0.030 * angle, rel=1e-12)
    work = found["torque"][1:] * np.diff(angle)  # of implicit steps, at pressures of their ends
    assert np.diff(found["dissipated_energy"]) == pytest.approx(work, rel=1e-12)
