"""Fit files: what they may say, and every fault of theirs, told together before any work."""

import copy
import math
import tomllib

import numpy as np
import pytest
from laboratory import CASE, FITTED, fit_tables, write_table, write_tests

from ringwear_par.errors import InputError
from ringwear_par.identification.fit import fit, predicted
from ringwear_par.identification.fit_file import read_fit
from ringwear_par.identification.histories import Histories
from ringwear_par.identification.inline_tables import on_one_line
from ringwear_par.identification.least_squares import LeastSquares
from ringwear_par.identification.plausible import refuse_reversed
from ringwear_par.identification.problem import FittedParameter

#: every key that a fit file may have
FULL = """
case = "case.toml"
[fit]
parameters."wear.lower.k"  = { start = 1e-7, bounds = [1e-9, 1e-5], scale = "log" }
parameters."wear.lower.p0" = { start = 0.0,  bounds = [0.0, 200.0] }
parameters."contact.friction" = { start = 0.1, bounds = [0.01, 1.0], scale = "log",
                                  prior = { normal = [0.1, 0.05] } }
starts = 8
method = "brgn"
intervals = ["linear", "profile"]
level = 0.9
loss = "student"
[[experiment]]
name = "low"
set = { "load.pressure" = 50.0, "load.omega" = 3.54, "time.end" = 100.0 }
  [[experiment.data]]
  quantity = "penetration"
  file = "low_lvdt.csv"
  columns = { time = "t_min", value = "z" }
  units   = { time = "min", value = "um" }
  sd = 0.2
  correlation_time = 2.0
  nuisance = { offset = {}, drift = { prior = { normal = [0.0, 0.5] } },
               compliance = { bounds = [0, 1] } }
  [[experiment.data]]
  quantity = "profile.lower"
  at = 100.0
  file = "low_profile.csv"
  columns = { r = "r_mm", value = "depth_um" }
  sd = "noise_um"
  nuisance = { level = {}, tilt = {} }
  exclude = [[28.4, 28.55], [31.45, 31.6]]
[[experiment]]
name = "high"
set = { "load.pressure" = 100.0, "load.omega" = 3.54, "time.end" = 100.0 }
  [[experiment.data]]
  quantity = "torque"
  file = "high_torque.csv"
  columns = { time = "t_s", value = "M_Nm" }
  units = { value = "N m" }
  sd = { relative = 0.01 }
[compare]
archard = { set = { "wear.lower.law" = "archard" }, parameters = {
  # one only
  "wear.lower.k" = { start = 1e-8, bounds = [1e-11, 1e-5], scale = "log" }
} }
[design]
criterion = "D"
vary = { "load.pressure" = [30, 100], "time.end" = [20, 200] }
budget = { "time.end" = 200.0, experiments = 2 }
"""


def test_every_key(tmp_path):
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "fit.toml").write_text(FULL)
    (tmp_path / "low_lvdt.csv").write_text(
        "# a rig\nt_min;z;note\n0,1;0,5;\n0,2;;gap\n"
        + "".join(f"{i / 10:g};1;\n" for i in range(3, 17))
    )
    (tmp_path / "low_profile.csv").write_text(
        "r_mm,depth_um,noise_um\n28.0,0,0.1\n28.5,9,0.1\n30,2,0.2\n31,3,0.1\n"
    )
    (tmp_path / "high_torque.csv").write_text("t_s,M_Nm\n1,21\n2,20\n3,\n4,22\n")
    problem = read_fit(tmp_path / "fit.toml")
    low, high = problem.experiments
    lvdt, profile = low.series
    assert lvdt.x[:2] == pytest.approx([6.0, 18.0])
    assert lvdt.value[:2] == pytest.approx([5e-4, 1e-3])
    assert lvdt.lines[:2].tolist() == [3, 5]
    assert (lvdt.sd[0], lvdt.unit, lvdt.correlation_time) == (pytest.approx(2e-4), "um", 2.0)
    assert [n.kind for n in lvdt.nuisances] == ["offset", "drift", "compliance"]
    assert (lvdt.nuisances[1].prior.sd, lvdt.nuisances[2].bounds) == (0.5, (0.0, 1.0))
    assert profile.x.tolist() == [28.0, 30.0, 31.0]
    assert profile.sd == pytest.approx([1e-4, 2e-4, 1e-4])
    (torque,) = high.series
    assert torque.value == pytest.approx([21e3, 20e3, 22e3])
    assert torque.sd == pytest.approx([210.0, 210.0, 220.0])  # of their running median
    assert low.case.time.end == high.case.time.end == 100.0
    assert low.case.time.adaptive
    assert low.case.wear_lower.p0 == 0.0
    assert problem.settings.level == 0.9
    assert problem.alternatives["archard"].keys == ("wear.lower.k",)
    assert len(problem.hashes) == 3


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A folder of measurements, and the fit file as a dict."""
    folder = tmp_path_factory.mktemp("laboratory")
    return fit_tables(folder, write_tests(folder), starts=1)


def changed(good, path, value):
    """Return the fit file with one entry changed; None takes it away."""
    tables = copy.deepcopy(good)
    *inner, last = path
    place = tables
    for key in inner:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return tables


PEN, PROF = ("experiment", 0, "data", 0), ("experiment", 0, "data", 1)
K = ("fit", "parameters", "wear.lower.k")


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("cases",), 1, "cases: unknown key (did you mean case?); must be one of case, fit"),
        (("case",), None, "case is missing"),
        (("case",), "nowhere.toml", 'fit: case = "nowhere.toml": nowhere.toml: cannot be read'),
        (("experiment",), [], "must be tables, [[experiment]]"),
        (("experiment",), {"name": "a"}, "must be tables, [[experiment]]"),
        (("experiment", 1, "name"), "test 1", "is there twice"),
        (("experiment", 1, "name"), None, "experiment 2: name is missing"),
        (("experiment", 0, "data"), None, "data is missing: must be tables"),
        (("experiment", 0, "sett"), {}, "sett: unknown key (did you mean set?)"),
        (("experiment", 0, "set", "load.presure"), 1, "did you mean load.pressure?"),
        (("experiment", 0, "set", "wear.lower.k"), 1e-7, "is set, and wear.lower.k is fitted"),
        (("experiment", 0, "set", "mesh.geometry"), "updated", 'must be "fixed" in a fit'),
        (("fit", "parameters"), {}, "must name one case key at least"),
        (("fit", "parameters", "wear.lower.K"), {"start": 1}, "did you mean wear.lower.k?"),
        (
            ("fit", "parameters", "wear.lower.m"),
            {"start": 2.0, "bounds": [1.0, 3.0]},
            'must be among k, p0 (m is of law = "power")',
        ),
        (("fit", "parameters", "upper.r"), {"start": 1}, "cannot be fitted"),
        (("fit", "parameters", "time.end"), {"start": 1}, "cannot be fitted"),
        (("fit", "parameters", "wear.upper.k"), FITTED["wear.lower.k"], "wear.upper.law is missi"),
        ((*K, "start"), 1e-4, "start = 0.0001: must be within its bounds, 1e-09 to 1e-05"),
        ((*K, "start"), None, "start is missing"),
        ((*K, "start"), "much", 'start = "much": must be a finite number'),
        ((*K, "bounds"), [1e-5, 1e-9], "bounds = [1e-05, 1e-09]: must be two increasing numbers"),
        (
            (*K[:-1], "wear.lower.p0", "bounds"), ["0 s", "10 s"],
            'bounds = ["0 s", "10 s"]: must be in MPa (s is no unit of MPa)',
        ),
        ((*K, "bounds"), [0.0, 1e-5], 'must be two increasing numbers > 0 where scale = "log"'),
        ((*K, "bounds"), [-1.0, 1.0], "must be values that wear.lower.k may have"),
        ((*K, "scale"), "ln", 'scale = "ln": must be one of linear, log'),
        ((*K, "prior"), {"normal": [1e-7, 0]}, "must be { normal = [mean, sd] }"),
        ((*K, "guess"), 1, "guess: unknown key"),
        (("fit", "starts"), 0, "starts = 0: must be a whole number from 1"),
        (("fit", "method"), "newton", "method = \"newton\": must be one of brgn, lm"),
        (("fit", "intervals"), ["posteriors"], 'intervals = ["posteriors"]: must be'),
        (("fit", "level"), 95, "level = 95: must be a number > 0.5 and < 1"),
        (("fit", "loss"), "l1", "must be one of gaussian, student"),
        ((*PEN, "quantity"), "depth", 'quantity = "depth": must be one of penetration'),
        ((*PEN, "file"), "nowhere.csv", "nowhere.csv: cannot be read"),
        ((*PEN, "columns", "value"), "w_um", "no column w_um for value; must be one of t_s, z_um"),
        ((*PEN, "units"), {"value": "parsecs per"}, "must be the unit of a length, such as um, mm"),
        ((*PEN, "units"), {"value": "s"}, 'units.value = "s": must be the unit of a length'),
        ((*PEN, "units"), {"time": "mm"}, 'units.time = "mm": must be the unit of a time, such as'),
        ((*PEN, "units"), {"time": "min"}, 'units.time = "min": the column t_s of '),
        ((*PEN, "units"), {"time": "min"}, "is in s by its name; must be the same unit"),
        ((*PEN, "units"), {"value": "mm"}, "is in um by its name; must be the same unit"),
        ((*PEN, "at"), 10.0, "must be absent beside file"),
        ((*PEN, "value"), 10.0, "value = 10.0: must be absent beside file"),
        ((*PEN, "sd"), None, "sd is missing"),
        ((*PEN, "sd"), 0.0, "sd = 0.0: must be a finite number > 0"),
        ((*PEN, "sd"), -1.0, "sd = -1.0: must be a finite number > 0"),
        ((*PEN, "sd"), "noise", 'sd = "noise": must be a number, "fit", { relative = x } or a'),
        ((*PROF, "sd"), {"relative": 0.01}, "must be in the data's unit where readings are near"),
        ((*PEN, "sd"), {"relative": -1}, "must be { relative = x }, a number > 0"),
        ((*PEN, "nuisance"), {"level": {}}, "nuisance.level: must be one of offset, drift"),
        ((*PEN, "nuisance"), {"drift": {"prior": 1}}, "prior = 1: must be { normal"),
        ((*PEN, "nuisance"), {"drift": {"bounds": [1, 0]}}, "must be two increasing numbers"),
        ((*PEN, "exclude"), [[2, 1]], "must be a list of increasing pairs"),
        ((*PEN, "exclude"), [[0, 1000]], "has no readings"),
        ((*PEN, "densty"), 1.0, "densty: unknown key"),
        ((*PROF, "at"), 100.1, "at = 100.1: must be within the test, which ends at 100 s"),
        ((*PEN, "correlation_time"), 1e5, "must be at most 100 times the test"),
        ((*PROF, "correlation_time"), 1.0, "must be absent for a profile"),
        (("experiment", 1, "data", 0, "file"), 0, "must be the name of a table"),
        (("compare",), {"a": {"set": {}, "parameters": {}}}, "compare.a.parameters: is missing"),
        (
            ("compare",),
            {"a": {"set": {"wear.lower.law": "x"}, "parameters": FITTED}},
            'wear.lower.law = "x"',
        ),
        (("Design",), {}, "Design: unknown key (did you mean design?)"),
        (("design",), {"criterion": "C"}, 'criterion = "C": must be one of D, A, eig'),
    ],
)  # fmt: skip
def test_faults(path, value, said, good):
    with pytest.raises(InputError) as caught:
        read_fit(changed(good, path, value))
    assert said in str(caught.value)
    assert str(caught.value).startswith("fit: ") or "nowhere.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([(1, 1), (2, 1), (2, 1)], "line 4: time 2 s after 2 s: times must increase"),
        ([(1, 1), (3, 1), (2, 1)], "line 4: time 2 s after 3 s: times must increase"),
        ([(5, 1), (4, 1), (3, 1), (9, 1)], "line 3: time 4 s after 5 s (and 1 more reading)"),
        (
            [(1, 1), (101, 1), (102, 1), (103, 1)],
            "line 3: time 101 s (and 2 more readings): must be within the test",
        ),
        ([(1, 1), (99, 1), (101, 1)], "line 4: time 101 s: must be within the test, from 0 to 100"),
        ([(-1, 1), (99, 1)], "line 2: time -1 s: must be within the test"),
        ([(1, 1), (2, 3e7)], "line 3: 30000 mm: must be less than the height of a body"),
        ([(1, 1), (2, math.nan)], "has 1 reading; must have more than nuisances"),
    ],
)
def test_faulty_times(rows, said, good, tmp_path):
    write_table(tmp_path / "z.csv", ("t_s", "z_um"), *np.array(rows).T)
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    tables["experiment"] = tables["experiment"][:1]
    del tables["experiment"][0]["data"][1]
    with pytest.raises(InputError) as caught:
        read_fit(tables)
    assert said in str(caught.value)


def test_a_fault_of_many_readings_is_told_once(good, tmp_path):
    """In hours what was meant in seconds: all readings but a few are beyond the end."""
    write_table(tmp_path / "z.csv", ("time", "z_um"), range(1, 50), range(1, 50))
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    tables["experiment"][0]["data"][0] |= {
        "columns": {"value": "z_um"}, "units": {"time": "h"}, "sd": 0.2,
    }  # fmt: skip
    with pytest.raises(InputError) as caught:
        read_fit(tables)
    (fault,) = caught.value.faults
    assert "time 3600 s (and 48 more readings): must be within the test" in fault


def test_radii_in_another_unit(good, tmp_path):
    write_table(tmp_path / "d.csv", ("r", "d_um"), (28.0, 30.0, 32.0), (0.0, 1.0, 0.0))
    tables = changed(good, (*PROF, "file"), str(tmp_path / "d.csv"))
    tables["experiment"][0]["data"][1] |= {
        "columns": {"value": "d_um"}, "units": {"r": "m"}
    }  # fmt: skip
    with pytest.raises(InputError) as caught:
        read_fit(tables)
    first, _ = caught.value.faults
    assert "r = 28000 mm (and 2 more readings): must be on the lower body" in first
    assert "a thousand times too large" in first


def test_noise_in_another_unit_than_its_readings(good, tmp_path):
    columns = (1.0, 2.0, 3.0), (1.0, 2.0, 3.0), (2e-4, 2e-4, 2e-4)
    write_table(tmp_path / "z.csv", ("t_s", "z_um", "noise_mm"), *columns)
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    tables["experiment"][0]["data"][0]["sd"] = "noise_mm"
    with pytest.raises(InputError, match=r'sd = "noise_mm": .* in mm by its name; must be in um'):
        read_fit(tables)


def test_records_of_a_spreadsheet(good, tmp_path):
    """With its first line, decimal commas and clock times."""
    rows = "".join(f"0:{t // 60:02d}:{t % 60:02d};{t / 10:g}\n" for t in range(2, 99, 2))
    (tmp_path / "z.csv").write_text("sep=;\ntime;z_um\n" + rows.replace(".", ","))
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    tables["experiment"][0]["data"][0]["columns"] = {"value": "z_um"}
    record = read_fit(tables).experiments[0].series[0]
    assert record.x == pytest.approx(np.arange(2.0, 99.0, 2.0))
    assert record.value == pytest.approx(1e-4 * record.x)


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
    with pytest.raises(InputError) as caught:
        read_fit(tables, plans=True)
    (fault,) = caught.value.faults
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
    tables["experiment"][0]["data"][0]["sd"] = "2 s"
    with pytest.raises(InputError, match=r'sd = "2 s": must be .*s is no unit of um'):
        read_fit(tables, plans=True)


def test_a_mass_has_the_density_of_its_body(plan):
    tables = copy.deepcopy(plan)
    weighing = {"quantity": "mass.lower", "value": 5.0, "unit": "mg", "sd": 0.1}
    tables["experiment"][0]["data"].append(weighing)
    with pytest.raises(InputError, match=r"density is missing: must be"):
        read_fit(tables, plans=True)
    tables["experiment"][0]["set"]["lower.density"] = "7.8 g/cm3"
    mass = read_fit(tables, plans=True).experiments[0].series[-1]
    assert mass.density == pytest.approx(0.0078)
    weighing["density"] = 0.0019
    mass = read_fit(tables, plans=True).experiments[0].series[-1]
    assert mass.density == pytest.approx(0.0019)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("sd = 0,2", "(at line 2, column 7): sd = 0,2; decimals have a point, as 0.2"),
        ("a = { b = 0,2, c = 1 }", "decimals have a point, as 0.2"),
        ("[[case]]", "[[case]]; a table that is there several times is [[case]] every time"),
        ("x = what", "x = what"),
    ],
)
def test_what_is_no_toml_is_shown(line, said, tmp_path):
    (tmp_path / "fit.toml").write_text(f'case = "a"\n{line}\n')
    with pytest.raises(InputError) as caught:
        read_fit(tmp_path / "fit.toml")
    assert said in str(caught.value)
    assert ("point" in str(caught.value)) == ("point" in said)


def test_series_tell_more_than_their_nuisances(plan):
    tables = copy.deepcopy(plan)
    data = tables["experiment"][0]["data"]
    data[1]["r"] = [29.0, 30.0]
    data[0]["times"] = [50.0, 100.0]  # its drift has a prior
    with pytest.raises(InputError) as caught:
        read_fit(tables, plans=True)
    (fault,) = caught.value.faults
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
            told = predicted(read_fit(own, plans=True), comm)
            spreads.append([p.sd for p in told.parameters])
        assert spreads[0] == pytest.approx(spreads[1], rel=1e-5)
    assert predicted(found, comm).chi2 < 1e-12


def test_a_weighing_may_be_planned(plan):
    tables = copy.deepcopy(plan)
    tables["experiment"][0]["data"] += [
        {"quantity": "mass.lower", "unit": "mg", "density": 0.0019, "sd": 0.1, **when}
        for when in ({}, {"at": 50.0}, {"times": [10.0, 20.0]})
    ]
    series = read_fit(tables, plans=True).experiments[0].series[2:]
    assert [one.x.tolist() for one in series] == [[100.0], [50.0], [10.0, 20.0]]


def test_a_fit_needs_readings(plan):
    with pytest.raises(InputError) as caught:
        read_fit(plan)
    assert len(caught.value.faults) == 4
    assert caught.value.faults[0] == (
        'fit: experiment "test 1": data 1 (penetration): file is missing: must be the name of a '
        "table; planned readings are for --dry-run and ringwear design only"
    )


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ((*PEN, "times"), [1.0, 1.0], "times = [1.0, 1.0]: must be { from = a, to = b, count"),
        ((*PEN, "times"), {"from": 1.0, "to": 9.0}, "must be { from = a, to = b, count = n }"),
        ((*PEN, "times"), {"from": 9.0, "to": 1.0, "count": 5}, "with a < b"),
        ((*PEN, "times"), {"from": 1.0, "to": 9.0, "count": 1e9}, "n from 2 to 100000"),
        ((*PEN, "times"), [1.0, 101.0], "time 101 s: must be within the test, from 0 to 100 s"),
        ((*PEN, "times"), None, "file is missing: must be the name of a table; or times"),
        ((*PEN, "r"), [29.0], "r: unknown key"),
        ((*PEN, "value"), 1.0, "must be absent beside value; it is for readings that are planned"),
        ((*PEN, "at"), 9.0, "at = 9.0: must be absent beside times"),
        ((*PEN, "columns"), {"time": "t"}, "file is missing: must be the name of a table"),
        ((*PEN, "sd"), "fit", 'sd = "fit": must be a number > 0, in unit, of readings that are'),
        ((*PEN, "sd"), "z_sd", "must be a number > 0, in unit, of readings that are planned"),
        ((*PEN, "sd"), {"relative": 0.1}, "must be a number > 0, in unit, of readings that are"),
        ((*PEN, "sd"), None, "sd is missing"),
        ((*PEN, "unit"), None, "unit is missing: must be the unit of a length"),
        ((*PEN, "unit"), "s", 'unit = "s": must be the unit of a length'),
        ((*PROF, "r"), [10.0, 30.0], "r = 10 mm: must be on the lower body, from 20 to 40 mm"),
        ((*PROF, "r"), [21.0, 22.0], "has no reading within the contact, 28.5 to 31.5 mm"),
        ((*PROF, "r"), [28000.0, 30000.0], "r = 28000 mm (and 1 more reading): must be on the l"),
        ((*PROF, "r"), None, "file is missing: must be the name of a table of depths over radii"),
        ((*PROF, "at"), 100.1, "at = 100.1: must be within the test, which ends at 100 s"),
        ((*PROF, "exclude"), [[20, 40]], "has no readings"),
    ],
)  # fmt: skip
def test_faults_of_plans(path, value, said, plan):
    with pytest.raises(InputError) as caught:
        read_fit(changed(plan, path, value), plans=True)
    assert said in str(caught.value)


def test_fewer_readings_than_parameters(plan):
    tables = copy.deepcopy(plan)
    tables["experiment"] = tables["experiment"][:1]
    del tables["experiment"][0]["data"][1], tables["experiment"][0]["data"][0]["nuisance"]
    tables["experiment"][0]["data"][0]["times"] = [50.0]
    with pytest.raises(InputError, match="1 readings: must be at least as many as are sought, 2 "):
        read_fit(tables, plans=True)


def test_all_faults_are_told_together(good):
    tables = changed(good, (*PEN, "sd"), 0)
    tables["fit"]["starts"] = -1
    tables["experiment"][1]["data"][1]["at"] = 1e9
    with pytest.raises(InputError) as caught:
        read_fit(tables)
    assert len(caught.value.faults) == 3


def test_the_same_readings_twice(good):
    path = good["experiment"][0]["data"][0]["file"]
    with pytest.raises(InputError, match="has the readings of experiment"):
        read_fit(changed(good, ("experiment", 1, "data", 0, "file"), path))


def test_the_same_readings_twice_in_one_experiment(good):
    tables = copy.deepcopy(good)
    data = tables["experiment"][0]["data"]
    data.append({**data[0], "sd": 0.3, "exclude": [[0, 50]]})
    with pytest.raises(InputError, match=r'"test 1": data 3 \(penetration\): .* is there twice'):
        read_fit(tables)
    data[0]["exclude"] = [[50, 100]]
    assert len(read_fit(tables).experiments[0].series) == 3  # parts of one record


@pytest.mark.parametrize(
    ("quantity", "column"),
    [("penetration", name) for name in ("p_Nm", "p_MPa", "p_s", "p_kN")]
    + [("mass.upper", "Drehmoment_Nm")],
)
def test_columns_in_units_of_something_else(quantity, column, good, tmp_path):
    write_table(tmp_path / "z.csv", ("t_s", column), (1.0, 2.0, 3.0), (1e-3, 2e-3, 3e-3))
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    table = tables["experiment"][0]["data"][0]
    table |= {"quantity": quantity, "columns": {"time": "t_s", "value": column}}
    with pytest.raises(InputError) as caught:
        read_fit(tables)
    unit = column.rpartition("_")[2]
    said = f"z.csv: the column {column} is in {unit} by its name; must be in the unit of a "
    assert said in str(caught.value)
    assert "or units.value must be given" in str(caught.value)


def test_a_table_of_names_only(good, tmp_path):
    write_table(tmp_path / "z.csv", ("t_s", "z_um"), (), ())
    for sd in ({"relative": 0.01}, 0.1):
        tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
        table = tables["experiment"][0]["data"][0]
        table |= {"columns": {"time": "t_s", "value": "z_um"}, "sd": sd}
        with pytest.raises(InputError, match="has no readings; must have one at least"):
            read_fit(tables)


def test_noise_in_a_unit_of_something_else(good, tmp_path):
    write_table(tmp_path / "z.csv", ("t_s", "z_um", "sd_N"), *[(1.0, 2.0, 3.0)] * 3)
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    tables["experiment"][0]["data"][0]["sd"] = "sd_N"
    with pytest.raises(InputError, match="the column is in N by its name; must be in um"):
        read_fit(tables)


def test_units_are_named_by_columns_too(good, tmp_path):
    data = good["experiment"][0]["data"][0]
    x, y = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
    for name, told in (("z_mm", True), ("z", False)):
        write_table(tmp_path / "z.csv", ("t_s", name), x, 1e-3 * y)
        tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
        tables["experiment"][0]["data"][0]["columns"] = {"time": "t_s", "value": name}
        assert read_fit(tables).experiments[0].series[0].unit_told is told


def test_values_stay_within_bounds_without_overflow():
    parameter = FittedParameter("wear.lower.k", 1e-7, (1e-9, 1e-5), log=True)
    with np.errstate(all="raise"):
        assert [parameter.value(u) for u in (-1e6, 1e6)] == [1e-9, 1e-5]
    assert parameter.value(parameter.unknown(3e-7)) == pytest.approx(3e-7, rel=1e-12)


@pytest.mark.parametrize("entry", [PEN, PROF])
def test_wrong_signs(entry, good, tmp_path, comm):
    data = good["experiment"][0]["data"][entry[-1]]
    names = tuple(data["columns"].values())
    x, y = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
    write_table(tmp_path / "a.csv", names, x, -y)
    with pytest.raises(InputError, match="has the wrong sign"):
        fit(changed(good, (*entry, "file"), str(tmp_path / "a.csv")), comm)


def test_a_key_to_which_nothing_responds(good, comm):
    """But for the pressure at the edges, which exceeds every threshold a little."""
    tables = copy.deepcopy(good)
    tables["experiment"] = tables["experiment"][:1]
    tables["experiment"][0]["set"]["wear.lower.p0"] = 300.0
    del tables["fit"]["parameters"]["wear.lower.p0"]
    with pytest.raises(InputError, match=r"nothing that was read responds to wear.lower.k"):
        fit(tables, comm)
    tables["experiment"][0]["set"]["wear.lower.p0"] = 25.0
    start = {"start": 1e-11, "bounds": [1e-12, 1e-5], "scale": "log"}
    tables["fit"]["parameters"]["wear.lower.k"] = start
    found = predicted(read_fit(tables), comm)  # hardly at the start, but elsewhere
    assert found.parameters[0].sd > 0


def test_a_drift_that_outweighs_the_wear_is_no_wrong_sign(good, tmp_path, comm):
    data = good["experiment"][0]["data"][0]
    t, z = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
    write_table(tmp_path / "z.csv", tuple(data["columns"].values()), t, z - 4.0 * z.max() * t / 100)
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    prior = {"prior": {"normal": [-4.0 * z.max(), z.max()]}}
    tables["experiment"][0]["data"][0]["nuisance"]["drift"] = prior
    for known in (prior, {}):
        tables["experiment"][0]["data"][0]["nuisance"]["drift"] = known
        problem = read_fit(tables)
        squares = LeastSquares(problem, Histories(problem, comm))
        refuse_reversed(squares, squares.started(list(problem.start.values())))


def test_a_torque_that_falls_is_no_wrong_sign(good, tmp_path, comm):
    t = np.linspace(1.0, 100.0, 50)
    write_table(tmp_path / "m.csv", ("time", "value"), t, -10.0 - np.sin(t))
    tables = copy.deepcopy(good)
    tables["experiment"][0]["data"].append(
        {
            "quantity": "torque",
            "file": str(tmp_path / "m.csv"),
            "units": {"value": "N m"},
            "sd": 0.1,
        }
    )
    problem = read_fit(tables)
    squares = LeastSquares(problem, Histories(problem, comm))
    refuse_reversed(squares, squares.started(list(problem.start.values())))


def test_a_quantity_that_does_not_respond(good, comm):
    tables = copy.deepcopy(good)
    tables["experiment"][0]["data"].append(
        {"quantity": "mass.upper", "value": 0.0, "unit": "mg", "density": 7.8e-3, "sd": 0.1}
    )
    with pytest.raises(InputError, match=r"mass.upper: does not respond to any parameter"):
        fit(tables, comm)


def test_other_files_are_told(tmp_path):
    (tmp_path / "case.toml").write_text(CASE)
    with pytest.raises(InputError, match="is a case, not a fit file"):
        read_fit(tmp_path / "case.toml")


def test_inline_tables_over_lines_keep_line_numbers():
    text = "a = { b = \"{\", # }\n c = 1 } # {\n[d]\ne = '}'\nf = [{ g = 1,\n h = 2 }, 3]\n"
    found = tomllib.loads(on_one_line(text))
    assert found == {"a": {"b": "{", "c": 1}, "d": {"e": "}", "f": [{"g": 1, "h": 2}, 3]}}
    with pytest.raises(tomllib.TOMLDecodeError, match="line 7"):
        tomllib.loads(on_one_line(text + "=\n"))


def test_what_is_planned_and_left_out_may_have_units(good):
    given = copy.deepcopy(good)
    profile = given["experiment"][0]["data"][1]
    profile["exclude"] = [["2.84 cm", 28.6]]
    given["experiment"][0]["data"][0] = {
        "quantity": "penetration", "unit": "um", "sd": "0.2 um",
        "times": {"from": "2 s", "to": "1 min", "count": 30},
    }  # fmt: skip
    given["design"] = {
        "vary": {"load.pressure": ["20 MPa", "0.1 GPa"], "time.end": [10, "2 min"]},
        "budget": {"time.end": "5 min", "experiments": 2},
    }
    problem = read_fit(given, plans=True)
    planned, read = problem.experiments[0].series
    assert planned.x == pytest.approx(np.linspace(2.0, 60.0, 30))
    assert not ((read.x >= 28.4) & (read.x <= 28.6)).any()
    assert problem.design.ranges == {"load.pressure": (20.0, 100.0), "time.end": (10.0, 120.0)}
    assert problem.design.seconds == 300.0
    profile["exclude"] = [["2.84 s", 28.6]]
    given["design"]["vary"]["time.end"] = [10, "2 mm"]
    with pytest.raises(InputError) as error:
        read_fit(given, plans=True)
    assert "exclude" in str(error.value)
    assert "time.end" in str(error.value)
