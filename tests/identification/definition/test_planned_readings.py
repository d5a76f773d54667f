"""Fit files before any readings are there: times and radii, densities, numbers with units."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from laboratory import PEN, PROF, changed, refused
from mpi4py import MPI

from ringwear_par.errors import InputError
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fit import expected_result
from ringwear_par.identification.fit_numbers import specific_wear_rate
from ringwear_par.identification.summary import key_rows

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    ("density", "said"),
    [
        (
            1.9,
            "must be from 1e-05 to 0.03 g/mm3, as of foams and metals; 1.9 g/cm3 would be 0.0019",
        ),
        (1900.0, "1900 kg/m3 would be 0.0019"),
        (7.8e-9, "7.8e-09 t/mm3 would be 0.0078"),
        (1e30, "as of foams and metals"),
    ],
)
def test_densities_that_nothing_has(density, said, plan):
    tables = copy.deepcopy(plan)
    weighing = {"quantity": "mass.lower", "value": 3.0, "unit": "mg", "sd": 0.1}
    tables["experiment"][0]["data"].append({**weighing, "density": density})
    (fault,) = refused(tables, plans=True)
    assert said in fault


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
    written["value"] = "3.0 mm"
    with pytest.raises(InputError, match=r'value = "3.0 mm": must be in the unit of a mass'):
        read_fit(tables, plans=True)
    written["value"] = "3.0 mg"
    tables["experiment"][0]["data"][0]["sd"] = "2 s"
    with pytest.raises(InputError, match=r'sd = "2 s": must be .*s is no unit of um'):
        read_fit(tables, plans=True)


def test_a_mass_has_the_density_of_its_body(plan):
    tables = copy.deepcopy(plan)
    weighing = {"quantity": "mass.lower", "value": 5.0, "unit": "mg", "sd": 0.1}
    tables["experiment"][0]["data"].append(weighing)
    with pytest.raises(InputError, match=r"density is missing: must be .* as lower.density of"):
        read_fit(tables, plans=True)
    tables["experiment"][0]["set"] |= {"lower.density": "7.8 g/cm3", "upper.poisson": 2}
    assert len(refused(tables, plans=True)) == 1  # of Poisson's ratio alone
    del tables["experiment"][0]["set"]["upper.poisson"]
    mass = read_fit(tables, plans=True).experiments[0].series[-1]
    assert mass.density == pytest.approx(0.0078)
    weighing["density"] = 0.0019
    mass = read_fit(tables, plans=True).experiments[0].series[-1]
    assert mass.density == pytest.approx(0.0019)


LAYERED = {
    "lower.density": "7.8 g/cm3",
    "lower.layers": [{"thickness": 0.02, "young": 4e3, "poisson": 0.3}],
}


def test_a_mass_of_layers_needs_the_density_of_each(plan):
    tables = copy.deepcopy(plan)
    weighing = {"quantity": "mass.lower", "value": 5.0, "unit": "mg", "sd": 0.1}
    tables["experiment"][0]["data"].append(weighing)
    given = tables["experiment"][0]["set"]
    given |= copy.deepcopy(LAYERED)

    (fault,) = refused(tables, plans=True)
    assert fault.endswith(
        "(mass.lower): density is missing: must be that of all that is lost, or the case must have "
        "lower.layers[0].density (g/mm3)"
    )
    (layer,) = given["lower.layers"]
    layer["density"] = 1.2
    (fault,) = refused(tables, plans=True)
    assert "(mass.lower): lower.layers[0].density = 1.2: must be from 1e-05 to 0.03" in fault
    layer["density"] = 1.2e-3
    assert read_fit(tables, plans=True).experiments[0].series[-1].density is None
    layer["density"] = 7.8e-3  # one for all that is lost, whichever layer it is of
    assert read_fit(tables, plans=True).experiments[0].series[-1].density == pytest.approx(7.8e-3)
    layer["density"] = 1.2e-3
    weighing["densty"] = 0.0019
    (fault,) = refused(tables, plans=True)
    assert "densty: unknown key (did you mean density?)" in fault
    del weighing["densty"]
    weighing["density"] = 0.0019  # the user's word
    assert read_fit(tables, plans=True).experiments[0].series[-1].density == pytest.approx(0.0019)


def test_series_tell_more_than_their_nuisances(plan):
    tables = copy.deepcopy(plan)
    data = tables["experiment"][0]["data"]
    data[1]["r"] = [29.0, 30.0]
    data[0]["times"] = [50.0, 100.0]  # its drift has a prior
    (fault,) = refused(tables, plans=True)
    assert "data 2 (profile.lower): has 2 readings; must have more than nuisances" in fault


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


def test_a_fit_needs_readings(plan):
    faults = refused(plan)
    assert len(faults) == 4
    assert faults[0] == (
        'fit: experiment "test 1": data 1 (penetration): file is missing: must be the name of a '
        "table; planned readings are for --dry-run and ringwear design only"
    )


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ((*PEN, "times"), [1.0, 1.0], "times = [1.0, 1.0]: must be { from = a, to = b, count"),
        ((*PEN, "times"), {"from": 9.0, "to": 1.0, "count": 5}, "with a < b"),
        ((*PEN, "times"), {"from": 1.0, "to": 9.0, "count": 1e9}, "n from 2 to 100000"),
        ((*PEN, "times"), [1.0, 101.0], "time 101 s: must be within the test, from 0 to 100 s"),
        ((*PEN, "times"), None, "file is missing: must be the name of a table; or times"),
        ((*PEN, "value"), 1.0, "must be absent beside value; it is for readings that are planned"),
        ((*PEN, "at"), 9.0, "at = 9.0: must be absent beside times"),
        ((*PEN, "columns"), {"time": "t"}, "file is missing: must be the name of a table"),
        ((*PEN, "sd"), "fit", 'sd = "fit": must be a number > 0, in unit, of readings that are'),
        ((*PEN, "unit"), None, "unit is missing: must be the unit of a length"),
        ((*PROF, "r"), [10.0, 30.0], "r = 10 mm: must be on the lower body, from 20 to 40 mm"),
        ((*PROF, "r"), [21.0, 22.0], "has no reading within the contact, 28.5 to 31.5 mm"),
        ((*PROF, "r"), [28000.0, 30000.0], "r = 28000 mm (and 1 more reading): must be on the l"),
        ((*PROF, "r"), None, "file is missing: must be the name of a table of depths over radii"),
    ],
)  # fmt: skip
def test_faults_of_plans(path, value, said, plan):
    assert said in "\n".join(refused(changed(plan, path, value), plans=True))


def test_fewer_readings_than_parameters(plan):
    tables = copy.deepcopy(plan)
    tables["experiment"] = tables["experiment"][:1]
    del tables["experiment"][0]["data"][1], tables["experiment"][0]["data"][0]["nuisance"]
    tables["experiment"][0]["data"][0]["times"] = [50.0]
    with pytest.raises(InputError, match="1 readings: must be at least as many as are fitted, 2 "):
        read_fit(tables, plans=True)


def expected(tables, key="wear.lower.k"):
    """Return the entry of a key in fit.json, at its start."""
    fit = expected_result(read_fit(tables, plans=True), MPI.COMM_SELF)
    return fit.to_dict()["parameters"][key]


def test_keys_are_told_in_the_users_unit(plan):
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
    tables["fit"]["units"] = {"wear.lower.k": "mm", "wear.lower.q": "MPa"}
    unknown, wrong = refused(tables, plans=True)
    assert "fit.units: wear.lower.q: is not fitted (did you mean wear.lower.k?)" in unknown
    assert 'fit.units."wear.lower.k" = "mm": must be a unit of 1/MPa' in wrong


def test_a_wear_coefficient_of_friction_energy_is_told_as_a_specific_wear_rate(plan):
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
