"""Fit files before any readings are there: times and radii, densities, numbers with units."""

import numpy as np
import pytest
from laboratory import RADII

from ringwear_par.identification.definition.fit_file import read_fit


def test_numbers_with_units(plan):
    """As in case files."""
    weighing = {"quantity": "mass.lower", "value": 3.0, "unit": "mg", "sd": "100 ug"}
    volume = {"quantity": "volume.lower", "value": "2 mm3", "sd": "0.1 mm3"}
    data = plan["experiment"][0]["data"]
    data += [volume, {**weighing, "density": "1.9 g/cm^3", "at": "1.5 min"}]
    data[0] |= {"sd": "0.0002 mm", "correlation_time": "0.1 min"}
    data[0]["times"] = {"from": "2 s", "to": "1 min", "count": 30}
    data[1]["exclude"] = [["2.84 cm", 28.6]]
    record, profile, volume, mass = read_fit(plan, plans=True).experiments[0].series
    assert record.x == pytest.approx(np.linspace(2.0, 60.0, 30))
    assert not ((profile.x >= 28.4) & (profile.x <= 28.6)).any()
    assert (volume.value, volume.sd) == (pytest.approx([2.0]), pytest.approx([0.1]))
    assert mass.density == pytest.approx(0.0019)
    assert mass.x == pytest.approx([90.0])
    assert mass.sd == pytest.approx([1e-4])
    assert record.sd == pytest.approx(2e-4)
    assert record.correlation_time == pytest.approx(6.0)
    written = plan["experiment"][0]["data"][-1]
    del written["unit"]
    written["value"] = "3.0 mg"
    text = read_fit(plan, plans=True).experiments[0].series[-1]
    assert (text.value, text.sd, text.unit) == (mass.value, mass.sd, "mg")


def test_a_mass_of_layers_is_of_the_density_of_each(plan):
    weighing = {"quantity": "mass.lower", "value": 5.0, "unit": "mg", "sd": 0.1}
    plan["experiment"][0]["data"].append(weighing)
    given = plan["experiment"][0]["set"]
    layer = {"thickness": 0.02, "young": 4e3, "poisson": 0.3, "density": 1.2e-3}
    given |= {"lower.density": "7.8 g/cm3", "lower.layers": [layer]}
    assert read_fit(plan, plans=True).experiments[0].series[-1].density is None
    layer["density"] = 7.8e-3  # one for all that is lost, whichever layer it is of
    assert read_fit(plan, plans=True).experiments[0].series[-1].density == pytest.approx(7.8e-3)
    layer["density"] = 1.2e-3
    weighing["density"] = 0.0019  # the user's word
    assert read_fit(plan, plans=True).experiments[0].series[-1].density == pytest.approx(0.0019)


@pytest.fixture
def plan(tables):
    """The fit file before any readings are there."""
    planned = tables()
    for experiment in planned["experiment"]:
        record, profile = experiment["data"]
        for series in (record, profile):
            del series["file"], series["columns"]
            series["unit"] = "um"
        record["times"] = {"from": 2.0, "to": 100.0, "count": 50}
        profile["r"] = RADII.tolist()
    return planned


def test_readings_may_be_planned(plan):
    plan["experiment"][1]["data"] += [
        {"quantity": "mass.lower", "unit": "mg", "density": 0.0019, "sd": 0.1, **when}
        for when in ({}, {"at": 50.0}, {"times": [10.0, 20.0]})
    ]
    record, profile, *masses = read_fit(plan, plans=True).experiments[1].series
    assert record.x == pytest.approx(np.linspace(2.0, 100.0, 50))
    assert (profile.n, profile.at, profile.unit) == (90, 100.0, "um")
    assert profile.sd == pytest.approx(8e-5)
    assert record.planned
    assert profile.planned
    assert [one.x.tolist() for one in masses] == [[100.0], [50.0], [10.0, 20.0]]
