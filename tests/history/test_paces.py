"""Wear whose rate is multiplied in each step: the same history, on another clock."""

import numpy as np
import pytest
from mpi4py import MPI
from parts import results_of
from paths import ROOT

import ringwear_par as rw

ENDS = np.array([2.0, 5.0, 15.0, 40.0, 60.0, 100.0])
FACTORS = np.array([0.5, 2.0, 1.3, 0.2, 1.0, 0.7])
CLOCK = np.cumsum(FACTORS * np.diff(ENDS, prepend=0.0))
LAWS = {
    "threshold": {"wear.lower.k": 1e-7, "wear.lower.p0": 20.0},
    "both bodies": {"wear.lower.k": 1e-7, "wear.upper.law": "archard", "wear.upper.k": 5e-8},
    "through a layer": {
        "wear.lower.k": 1e-6, "lower.layers": [
            {"thickness": 2e-3, "young": 2e5, "poisson": 0.3, "wear": {"law": "archard", "k": 2e-7}}
        ],
    },
}  # fmt: skip


@pytest.mark.parametrize("law", LAWS)
def test_a_pace_is_another_clock(law):
    changes = {
        "load.pressure": 60.0, "time.scheme": "adaptive", "time.step": None, "time.steps": None,
        "mesh.contact_elements": 16, **LAWS[law],
    }  # fmt: skip
    case = rw.read_case(ROOT / "scripts/cases/paper.toml", {**changes, "time.end": ENDS[-1]})
    other = case.replace({"time.end": CLOCK[-1]})
    paces = [np.stack([FACTORS, FACTORS]), np.ones((2, len(ENDS)))]
    paced, even = results_of([case] * 2, MPI.COMM_SELF, step_times=[ENDS] * 2, paces=paces)
    (on_clock,) = results_of([other], MPI.COMM_SELF, step_times=[CLOCK])
    (plain,) = results_of([case], MPI.COMM_SELF, step_times=[ENDS])
    for name in ("penetration", "worn_volume_lower", "worn_volume_upper", "torque"):
        expected = on_clock.histories[name]
        assert paced.histories[name] == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert np.array_equal(even.histories[name], plain.histories[name])
    assert paced.balances["volume"] < 1e-9
