"""Limits of [stop]: histories end after the step that reaches one, and are the same until then."""

import numpy as np
import pytest
from parts import computed, run_case
from paths import PAPER
from stored import assert_same

import ringwear_par as rw

SMALL = {"mesh.contact_elements": 12}
FIXED = {"time.steps": 40}


@pytest.mark.parametrize("scheme", [FIXED, {"time.scheme": "adaptive", "time.end": 40.0}])
def test_each_history_of_a_batch_ends_at_its_own_limit(comm, scheme):
    case = rw.read_case(PAPER, {**SMALL, **scheme})
    limits = [{"stop.penetration": 1e-3}, {}, {"stop.energy": 9e6, "stop.wear_lower": 1.0}]
    results = rw.simulate_all([case.replace(limit) for limit in limits], comm)
    whole = results[1].histories
    for result, name, limit in (
        (results[0], "penetration", 1e-3),
        (results[2], "dissipated_energy", 9e6),
    ):
        values, end = result.histories[name], len(result.histories[name])
        assert values[-2] < limit <= values[-1]
        assert result.attributes["status"] == "complete"
        assert end < len(whole["time"])
        for variable, column in result.histories.items():
            np.testing.assert_allclose(column, whole[variable][:end], rtol=1e-9, atol=1e-9)
    assert "stop.penetration = 0.001 mm" in results[0].summary()
    assert "stop." not in results[1].summary()


def test_what_needs_all_of_a_history_refuses_limits(comm):
    case = rw.read_case(PAPER, {**SMALL, **FIXED, "stop.wear_lower": "3 um"})
    with pytest.raises(rw.InputError, match=r"stop\.wear_lower = 0\.003"):
        rw.function(case, ["wear.lower.k"], ["penetration"])


@pytest.mark.parametrize("time", [["time.steps=20"], ["time.scheme=adaptive", "time.end=20"]])
def test_a_larger_limit_goes_on_to_the_same_bits(tmp_path, comm, time):
    whole, parts = tmp_path / "whole.h5", tmp_path / "parts.h5"
    keys = ["mesh.contact_elements=12", "output.every=3", *time]

    def run(path, limit, restart=False):
        limits = [f"stop.penetration={limit}"] if limit else []
        run_case(PAPER, path, [*keys, *limits], comm=comm, restart=restart)

    run(whole, "1 um")
    run(parts, "0.3 um")
    run(parts, "1 um", restart=True)
    assert_same(whole, parts)
    assert 0.0 < rw.open_result(parts).histories["time"][-1] < 20.0
    run(whole, "")
    run(parts, "", restart=True)
    one, two = rw.open_result(whole), rw.open_result(parts)
    for name, values in one.histories.items():
        assert np.array_equal(values, two.histories[name], equal_nan=True), name
    for name, values in vars(one.last_state).items():
        assert values is None or np.array_equal(values, vars(two.last_state)[name]), name
    assert "stopped_by" not in rw.open_result(parts).attributes


def test_a_sweep_flags_cases_that_a_limit_ended(comm):
    case = rw.read_case(PAPER, {**SMALL, **FIXED})
    cases = [case.replace({"stop.energy": limit}) for limit in (9e6, 1e12)]
    flags = [b.recorder.columns(b.failures).flags for b in computed(cases, {}, comm)[0]]
    assert flags == [(("stopped_by_energy",), ())]
