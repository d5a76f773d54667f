"""Histories as functions: the numbers of ``simulate``, broadcast, with derivatives."""

import pickle

import numpy as np
import pytest
from paths import CASES, PAPER

import ringwear_par as rw

SMALL = {"mesh.contact_elements": 12, "time.steps": 20}
KEYS = ["wear.lower.k", "load.pressure"]


@pytest.fixture(scope="module")
def case(comm):
    return rw.read_case(PAPER, SMALL)


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
    assert alone["penetration"] == pytest.approx(history["penetration"][-1], rel=1e-4)
    assert alone["penetration"] == pytest.approx(many["penetration"][1, 0], rel=1e-9)
    assert alone["torque@10 s"] == pytest.approx(history["torque"][2], rel=1e-4)
    volumes = alone["worn_volume_lower@all"]
    assert volumes == pytest.approx(history["worn_volume_lower"], rel=1e-4, abs=1e-12)


def test_failed_cases_are_nan(case):
    f = rw.function(case, ["load.pressure", "upper.r[1]"], ["penetration", "penetration@all"])
    values = f({"load.pressure": [-1.0, 60.0, np.nan, 60.0], "upper.r[1]": [31, 31, 31, 20]})
    assert np.isnan(values["penetration"]).tolist() == [True, False, True, True]
    assert values["penetration@all"].shape == (4, 21)
    assert sorted(f.errors) == [0, 2, 3]
    assert f.errors[0].faults[0].loc == "load.pressure"
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
