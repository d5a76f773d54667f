"""Histories as functions: the numbers of ``simulate``, broadcast, with derivatives; refusals."""

import pickle

import numpy as np
import pytest
from paths import CASES, PAPER

import ringwear_par as rw

pytestmark = pytest.mark.serial

SMALL = {"mesh.contact_elements": 12, "time.steps": 20}
KEYS = ["wear.lower.k", "load.pressure"]


@pytest.fixture(scope="module")
def case(comm):
    return rw.read_case(PAPER, SMALL)


@pytest.mark.ranks
def test_numbers_are_those_of_histories(case):
    outputs = ["penetration", "torque@10 s", "worn_volume_lower@all"]
    base = rw.read_case(PAPER, {**SMALL, "output.times": [5, 10]})
    f = pickle.loads(pickle.dumps(rw.function(base, KEYS, outputs)))
    k = np.array([[1e-7], [3e-7]])
    many = f({"wear.lower.k": k, "load.pressure": [50.0, 80.0, 90.0]})
    assert [many[name].shape for name in outputs] == [(2, 3), (2, 3), (2, 3, 4)]
    assert not f.errors
    change = {"wear.lower.k": 3e-7, "load.pressure": "50 MPa"}
    history = rw.simulate(base.replace(change)).histories
    alone = f(change)
    assert isinstance(alone["penetration"], float)
    assert alone["penetration"] == history["penetration"][-1] == many["penetration"][1, 0]
    assert alone["torque@10 s"] == history["torque"][2]
    assert (alone["worn_volume_lower@all"] == history["worn_volume_lower"]).all()


def test_derivatives_are_those_of_differences(case):
    f = rw.function(case, ["wear.lower.k", "load.force"], ["penetration@15"], derivatives=True)
    x = {"wear.lower.k": 2e-7, "load.force": 3e4}
    _, slopes = f(x)
    for name, value in x.items():
        ends = f({**x, name: value * np.array([1 - 1e-4, 1 + 1e-4])})[0]["penetration@15"]
        difference = (ends[1] - ends[0]) / (2e-4 * value)
        assert slopes["penetration@15", name] == pytest.approx(difference, rel=1e-6)


def test_failed_cases_are_nan(case):
    f = rw.function(case, ["load.pressure", "upper.r[1]"], ["penetration", "penetration@all"])
    values = f({"load.pressure": [-1.0, 60.0, np.nan, 60.0], "upper.r[1]": [31, 31, 31, 20]})
    assert np.isnan(values["penetration"]).tolist() == [True, False, True, True]
    assert values["penetration@all"].shape == (4, 21)
    assert sorted(f.errors) == [0, 2, 3]
    assert str(f.errors[0]).startswith("case: load.pressure = -1.0: must be a finite number > 0")
    assert not np.isnan(f({"load.pressure": 60.0, "upper.r[1]": 31})["penetration"])
    assert f.errors == {}
    assert f({"load.pressure": [], "upper.r[1]": 31})["penetration@all"].shape == (0, 0)


def test_shares_of_layers_and_what_names_mean(comm):
    case = rw.read_case(CASES / "wear_through.toml", {"mesh.contact_elements": 12})
    f = rw.function(case, ["lower.layers[0].thickness"], ["share_through_lower"])
    shares = f({"lower.layers[0].thickness": ["3 um", "1 mm"]})["share_through_lower"]
    assert shares[0] > 0.0 == shares[1]
    (thickness,) = f.schema["inputs"].values()
    assert (thickness["unit"], thickness["bounds"]) == ("mm", [0.0, None])
    assert thickness["value"] == case.lower.layers[0].thickness
    assert f.schema["outputs"]["share_through_lower"]["unit"] == "1"


@pytest.mark.parametrize(
    ("inputs", "outputs", "derivatives", "sentence"),
    [
        ("wear.lower.k", ["torque"], False, 'inputs = "wear.lower.k": must be a list of keys'),
        (["wear.lower.kk"], ["torque"], False, r"unknown key \(did you mean wear.lower.k\?\)"),
        (["lower.r"], ["torque"], False, r"lower.r = \[20.0, 40.0\]: must be a number"),
        (["load.displacement"], ["torque"], False, "load.displacement: is not in the case"),
        (["load.force", "load.pressure"], ["torque"], False, "both are given"),
        (KEYS, ["torqe"], False, r"unknown name \(did you mean torque\?\)"),
        (KEYS, ["torque@soon"], False, "torque@soon: behind @ must be all, or a time"),
        (KEYS, ["torque@1 h"], False, "torque@1 h: 3600 s is after the end .* <= time.end = 20"),
        (KEYS, ["torque@1", "torque@all"], False, "torque@all: needs output.times in the case"),
        (["lower.poisson"], ["torque"], True, "lower.poisson: is no plain number"),
        (KEYS, ["time"], True, "time: has no derivatives"),
    ],
)
def test_what_is_no_function_is_refused_at_once(case, inputs, outputs, derivatives, sentence):
    with pytest.raises(rw.InputError, match=sentence):
        rw.function(case, inputs, outputs, derivatives=derivatives)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"wear.lower.k": 1e-7}, "load.pressure: is missing"),
        ({"wear.lower.k": 1e-7, "load.pressure": 1, "k": 1}, "k: unknown key"),
        ({"wear.lower.k": 1e-7, "load.pressure": "3 mm"}, "mm is no unit of MPa"),
        ({"wear.lower.k": [[1], [1, 2]], "load.pressure": True}, "true: must be a number"),
        ({"wear.lower.k": [1, 2, 3], "load.pressure": [1, 2]}, "arrays that broadcast together"),
    ],
)
def test_bad_values_are_refused(case, values, sentence):
    with pytest.raises(rw.InputError, match=sentence):
        rw.function(case, KEYS, ["torque"])(values)
