"""The explorer without a browser: sliders and their keys, and histories."""

import numpy as np
import pytest
from paths import CASES, PAPER

import ringwear_par as rw
from ringwear_par.explorer.exploring import Exploration
from ringwear_par.explorer.moved_keys import raw_keys

SMALL = ["mesh.contact_elements=12", "time.steps=8"]
#: keys of a rig as its users write them
RIG = """
[lower]
r = [20.0, 40.0]
z = [0.0, "2 cm"]
young = "10 GPa"
poisson = 0.3
[upper]
r = ["28.5 mm", "3.15 cm"]
z = [20.0, 40.0]
young = 100e3
poisson = 0.3
profile = { fillet = [0.1, "200 um"] }
[contact]
friction = 0.1
[wear.lower]
law = "archard"
k = "1e-5 mm3/(N m)"
[wear.upper]
law = "threshold"
k = { r = [[29.0, 1e-8], [31.0, 2e-8]] }
[load]
force = [["0 h", "30 kN"], ["1 h", 45000]]
omega = "30 rpm"
[time]
scheme = "adaptive"
end = "0.5 h"
[mesh]
contact_elements = 12
[output]
times = ["0.25 h"]
fields = ["gap"]
profiles = "last"
"""


def same(found, case):
    """Whether a history has the very numbers of rw.simulate at the end and in between.

    Without stresses, which sliders leave out.
    """
    case = case if case.stress is None else case.replace({"stress": None})
    result, other = found.result, rw.simulate(case)
    at = np.isin(result.histories["time"], other.histories["time"])
    for name, values in other.histories.items():
        if name != "contact_iterations":
            assert np.array_equal(result.histories[name][at], values), name
    for name, values in other.profiles.items():
        there = result.profiles[name]
        assert np.array_equal(there[at] if values.ndim == 2 else there[-1], values), name
    assert result.summary() == other.summary()


@pytest.mark.parametrize("name", ["user_law", "updated", "wear_through", "table", "start_stop"])
def test_the_text_taken_home_gives_the_same_numbers(name, tmp_path, comm):
    path = CASES / f"{name}.toml"
    exploration = Exploration(raw_keys(path, ["mesh.contact_elements=16"]), str(path), comm)
    # a little off, so that whatever is within reach may be
    moved = {
        name: f"{control.value * 1.02:.6g}"
        for name, control in exploration.controls.items()
        if not (control.assembles or control.whole)
    }
    found = exploration.compute(moved)
    assert {name: found.controls[name].value for name in moved} == {
        name: float(text) for name, text in moved.items()
    }
    home = tmp_path / "home.toml"  # another folder
    home.write_text(found.text)
    case = rw.read_case(home)
    assert case == found.case
    same(found, case)
    assert any("wear." in name for name in moved)  # of bodies, or of their layers
    assert any(name.startswith("load.") for name in moved)


def test_numbers_stay_in_the_units_of_the_user(tmp_path, comm):
    path = tmp_path / "case.toml"
    path.write_text(RIG)
    exploration = Exploration(raw_keys(path, []), str(path), comm)
    told = {name: (c.value, c.unit) for name, c in exploration.controls.items()}
    assert (told["load.omega"], told["upper.r[1]"]) == ((30.0, "rpm"), (3.15, "cm"))
    assert told["wear.lower.k"] == (1e-5, "mm3/(N m)")
    found = exploration.compute(
        {"load.omega": "45", "lower.young": "12000 MPa", "upper.profile.fillet[1]": "250",
         "load.force \N{MULTIPLICATION SIGN}": "0.5", "wear.upper.k \N{MULTIPLICATION SIGN}": "2"}
    )  # fmt: skip
    assert 'omega = "45 rpm"' in found.text
    assert 'young = "12000 MPa"' in found.text
    assert found.controls["lower.young"].value == 12.0  # GPa, as it was
    assert '"fillet" = [0.1, "250 um"]' in found.text
    assert 'force = [["0 h", "15 kN"], ["1 h", 22500.0]]' in found.text
    assert 'k = { "r" = [[29.0, 2e-08], [31.0, 4e-08]] }' in found.text
    assert 'k = "1e-5 mm3/(N m)"' in found.text
    assert found.text.endswith('times = ["0.25 h"]\nfields = ["gap"]\nprofiles = "last"\n')
    assert set(found.result.profiles) == {"pressure", "gap", "wear_lower", "wear_upper"}
    same(found, found.case)


@pytest.mark.parametrize(
    ("key", "low", "high"),
    [("wear.lower.k", 1e-9, 1e-5), ("contact.friction", 0.0, 0.3), ("upper.r[0]", 27.0, 30.0)],
)
def test_sliders_reach_what_makes_sense(key, low, high, comm):
    control = Exploration(raw_keys(PAPER, SMALL), "paper", comm).controls[key]
    assert (control.low, control.high) == pytest.approx((low, high))
    assert control.at(2.0 * high).high >= 2.0 * high  # typed


def test_numbers_of_layers_have_sliders(comm):
    keys = raw_keys(CASES / "wear_through.toml", ["mesh.contact_elements=12"])
    exploration = Exploration(keys, "wear_through.toml", comm)
    thickness = exploration.controls["lower.layers[0].thickness"]
    assert (thickness.value, thickness.unit) == (3.0, "um")
    found = exploration.compute({"lower.layers[0].thickness": "4", "lower.young": "2e4"})
    assert '"thickness" = "4 um"' in found.text
    assert found.case.lower.layers[0].thickness == pytest.approx(4e-3)
    same(found, found.case)
    with pytest.raises(rw.InputError) as caught:
        exploration.compute({"lower.layers[0].poisson": "0.7", "contact.friction": "-1"})
    faults = " ".join(caught.value.faults)
    assert all(key in faults for key in ("layers[0].poisson", "contact.friction"))
