"""Histories whose steps are given, as fits and differences have them."""

import pytest
from mpi4py import MPI
from parts import Recorder
from paths import PAPER

import ringwear_par as rw
from ringwear_par.history.elastic import assemble
from ringwear_par.history.loop import simulate_one

ADAPTIVE = {"mesh.contact_elements": 12, "time": {"scheme": "adaptive", "end": 30.0}}


def test_steps_that_are_given():
    case = rw.read_case(PAPER, ADAPTIVE)
    pair = assemble(case, MPI.COMM_SELF)

    def history(times=None):
        recorder = Recorder([case], MPI.COMM_SELF)
        simulate_one(case, MPI.COMM_SELF, pair=pair, observers=[recorder], step_times=times)
        return recorder.result().histories

    alone = history()
    ends = alone["time"][1:].tolist()
    again = history(ends)
    for name in ("penetration", "worn_volume_lower", "torque"):
        assert again[name] == pytest.approx(alone[name], rel=1e-12)
    twice = sorted([*ends, *(0.5 * (a + b) for a, b in zip([0.0, *ends], ends, strict=False))])
    assert history(twice)["time"][1:].tolist() == twice
    for wrong in (ends[:-1], [], ends[::-1]):
        with pytest.raises(ValueError, match="step_times"):
            history(wrong)
