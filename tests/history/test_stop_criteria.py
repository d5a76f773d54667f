"""Limits of [stop]: histories end after the step that reaches one, and are the same until then."""

import numpy as np
import pytest
from paths import PAPER

import ringwear_par as rw

SMALL = {"mesh.contact_elements": 12}
FIXED = {"time.steps": 40}


@pytest.mark.serial
@pytest.mark.parametrize("scheme", [FIXED, {"time.scheme": "adaptive", "time.end": 40.0}])
def test_each_history_of_a_batch_ends_at_its_own_limit(comm, scheme):
    case = rw.read_case(PAPER, {**SMALL, **scheme})
    limits = [{"stop.penetration": 1e-3}, {}, {"stop.energy": 9e6, "stop.wear_lower": 1.0}]
    results = rw.simulate_all([case.replace(limit) for limit in limits])
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
            assert np.array_equal(column, whole[variable][:end]), variable
    assert f"ended        at t = {results[0].histories['time'][-1]:g} of 40 s" in rw.summary(
        results[0]
    )


@pytest.mark.serial
def test_what_needs_all_of_a_history_refuses_limits(comm):
    case = rw.read_case(PAPER, {**SMALL, **FIXED, "stop.wear_lower": "3 um"})
    with pytest.raises(
        rw.InputError,
        match=r"^function: stop\.wear_lower = 0\.003: must be absent in a function of a case, "
        r"which needs whole histories$",
    ):
        rw.function(case, ["wear.lower.k"], ["penetration"])
