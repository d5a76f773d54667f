"""Fit files before any readings are there: times and radii, densities, numbers with units."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from laboratory import changed, refused
from mpi4py import MPI

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fit import expected_result
from ringwear_par.identification.fit_numbers import specific_wear_rate
from ringwear_par.identification.summary import key_rows


def test_numbers_with_units(plan):
    """As in case files."""
    tables = copy.deepcopy(plan)
    weighing = {"quantity": "mass.lower", "value": 3.0, "unit": "mg", "sd": "100 ug"}
    tables["experiment"][0]["data"].append({**weighing, "density": "1.9 g/cm^3", "at": "1.5 min"})
    tables["experiment"][0]["data"][0] |= {"sd": "0.0002 mm", "correlation_time": "0.1 min"}
    record, _, mass = read_fit(tables, plans=True).experiments[0].series
    assert mass.density == pytest.approx(0.0019)
    assert mass.x == pytest.approx([90.0])
    assert mass.sd == pytest.approx([1e-4])
    assert record.sd == pytest.approx(2e-4)
    assert record.correlation_time == pytest.approx(6.0)
    written = tables["experiment"][0]["data"][-1]
    del written["unit"]
    written["value"] = "3.0 mg"
    text = read_fit(tables, plans=True).experiments[0].series[-1]
    assert (text.value, text.sd, text.unit) == (mass.value, mass.sd, "mg")


def test_a_mass_has_the_density_of_its_body(plan):
    tables = copy.deepcopy(plan)
    weighing = {"quantity": "mass.lower", "value": 5.0, "unit": "mg", "sd": 0.1}
    tables["experiment"][0]["data"].append(weighing)
    tables["experiment"][0]["set"] |= {"lower.density": "7.8 g/cm3", "upper.poisson": 2}
    assert len(refused(tables, plans=True)) == 1  # of Poisson's ratio alone
    del tables["experiment"][0]["set"]["upper.poisson"]
    mass = read_fit(tables, plans=True).experiments[0].series[-1]
    assert mass.density == pytest.approx(0.0078)
    weighing["density"] = 0.0019
    mass = read_fit(tables, plans=True).experiments[0].series[-1]
    assert mass.density == pytest.approx(0.0019)


def test_a_mass_of_layers_needs_the_density_of_each(plan):
    tables = copy.deepcopy(plan)
    weighing = {"quantity": "mass.lower", "value": 5.0, "unit": "mg", "sd": 0.1}
    tables["experiment"][0]["data"].append(weighing)
    given = tables["experiment"][0]["set"]
    layer = {"thickness": 0.02, "young": 4e3, "poisson": 0.3}
    given |= {"lower.density": "7.8 g/cm3", "lower.layers": [layer]}
    (fault,) = refused(tables, plans=True)
    assert (fault.loc, fault.code) == ("experiment.data.density", "missing")
    assert "lower.layers[0].density" in fault
    layer["density"] = 1.2
    (fault,) = refused(tables, plans=True)
    assert "lower.layers[0].density = 1.2" in fault
    layer["density"] = 1.2e-3
    assert read_fit(tables, plans=True).experiments[0].series[-1].density is None
    layer["density"] = 7.8e-3  # one for all that is lost, whichever layer it is of
    assert read_fit(tables, plans=True).experiments[0].series[-1].density == pytest.approx(7.8e-3)
    layer["density"] = 1.2e-3
    weighing["density"] = 0.0019  # the user's word
    assert read_fit(tables, plans=True).experiments[0].series[-1].density == pytest.approx(0.0019)


@pytest.fixture(scope="module")
def plan(good):
    """The fit file before any readings are there."""
    tables = copy.deepcopy(good)
    for experiment in tables["experiment"]:
        record, profile = experiment["data"]
        for series in (record, profile):
            del series["file"], series["columns"]
            series["unit"] = "um"
        record["times"] = {"from": 2.0, "to": 100.0, "count": 50}
        r = np.concatenate([np.linspace(28.0, 28.4, 15), np.linspace(28.6, 31.4, 60),
                            np.linspace(31.6, 32.0, 15)])  # fmt: skip
        profile["r"] = r.tolist()
    return tables


def test_readings_may_be_planned(plan, good, comm):
    """A dry run tells the same as with readings, whatever these are."""
    found = read_fit(plan, plans=True)
    record, profile = found.experiments[1].series
    assert record.x == pytest.approx(np.linspace(2.0, 100.0, 50))
    assert (profile.n, profile.at, profile.unit) == (90, 100.0, "um")
    assert profile.sd == pytest.approx(8e-5)
    assert record.planned
    assert profile.planned
    for start in (0.0, 25.0):  # at a bound and within
        spreads = []
        for tables in (plan, good):
            own = changed(tables, ("fit", "parameters", "wear.lower.p0", "start"), start)
            told = expected_result(read_fit(own, plans=True), comm)
            spreads.append([p.sd for p in told.parameters])
        assert spreads[0] == pytest.approx(spreads[1], rel=1e-5)
    assert expected_result(found, comm).chi2 < 1e-12


def test_a_weighing_may_be_planned(plan):
    tables = copy.deepcopy(plan)
    tables["experiment"][0]["data"] += [
        {"quantity": "mass.lower", "unit": "mg", "density": 0.0019, "sd": 0.1, **when}
        for when in ({}, {"at": 50.0}, {"times": [10.0, 20.0]})
    ]
    series = read_fit(tables, plans=True).experiments[0].series[2:]
    assert [one.x.tolist() for one in series] == [[100.0], [50.0], [10.0, 20.0]]


def expected(tables, key="wear.lower.k"):
    """Return the entry of a key in fit.json, at its start."""
    fit = expected_result(read_fit(tables, plans=True), MPI.COMM_SELF)
    return fit.to_dict()["parameters"][key]


def test_keys_are_stored_in_the_users_unit(plan):
    tables = copy.deepcopy(plan)
    tables["fit"]["parameters"]["wear.lower.k"]["start"] = "1.3e-4 mm3/(N m)"
    tables["fit"]["parameters"]["wear.lower.p0"]["start"] = 20.0
    entry = expected(tables)
    (row,) = key_rows("wear.lower.k", entry)  # once, not in the case's unit too
    assert row.unit == "mm3/(N m) per friction energy"
    assert row.estimate == pytest.approx(1.3e-4)
    for name in ("estimate", "sd", "interval"):
        assert getattr(row, name) == pytest.approx(1e3 * np.array(entry[name]))
    assert "specific_wear_rate" not in entry  # there is a threshold
    tables["fit"]["units"] = {"wear.lower.k": "um2/N", "wear.lower.p0": "bar"}
    assert expected(tables)["told"]["unit"] == "um2/N"
    p0 = expected(tables, "wear.lower.p0")["told"]
    assert p0["estimate"] == pytest.approx(200.0)
    assert "per" not in p0


def test_a_wear_coefficient_of_friction_energy_has_a_specific_wear_rate(plan):
    tables = copy.deepcopy(plan)
    del tables["fit"]["parameters"]["wear.lower.p0"]
    for experiment in tables["experiment"]:
        experiment["set"] |= {"wear.lower.p0": 0.0, "contact.friction": 0.1}
    entry = expected(tables)
    rate = entry["specific_wear_rate"]
    assert (rate["unit"], rate["mu"]) == ("mm3/(N m)", 0.1)
    for name in ("estimate", "sd", "interval"):
        assert rate[name] == pytest.approx(100.0 * np.array(entry[name]))
    assert rate["in3 min/(ft lbf h)"] == pytest.approx(rate["estimate"] / 201.44, rel=1e-4)
    # mu fitted too: standard deviations of logarithms, which depend on each other
    problem = read_fit(tables, plans=True)
    friction = replace(problem.parameters[0], key="contact.friction")
    problem = replace(problem, parameters=(problem.parameters[0], friction))
    k, mu, rk, rm, rho = 1e-7, 0.2, 0.1, 0.05, -0.6
    entries = {
        "wear.lower.k": {
            "estimate": k,
            "sd": rk * k,
            "interval": [k / 1.2, 1.2 * k],
            "interval_of": "linear model",
        },
        "contact.friction": {"estimate": mu},
    }
    both = rho * rk * k * rm * mu
    covariance = [[(rk * k) ** 2, both], [both, (rm * mu) ** 2]]
    rate = specific_wear_rate(problem, "wear.lower.k", entries, covariance)
    assert rate["estimate"] == pytest.approx(1e3 * k * mu)
    sd = np.sqrt(rk**2 + rm**2 + 2.0 * rho * rk * rm)
    assert rate["sd"] == pytest.approx(sd * rate["estimate"])
    assert np.log(rate["interval"][1] / rate["estimate"]) == pytest.approx(1.959964 * sd)
    entries["wear.lower.k"]["interval_of"] = "scatter integrated"  # no normal distribution
    rate = specific_wear_rate(problem, "wear.lower.k", entries, covariance)
    assert rate["interval"] == [None, None]
