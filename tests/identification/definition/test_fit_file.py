"""Fit files: what they may say, and every fault of theirs, told together before any work."""

import copy

import numpy as np
import pytest
from laboratory import CASE, FITTED, PEN, PROF, K, changed, refused

from ringwear_par.errors import InputError
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import FittedParameter

#: every key that a fit file may have
FULL = """
case = "case.toml"
[fit]
parameters."wear.lower.k"  = { start = 1e-7, bounds = [1e-9, 1e-5], scale = "log" }
parameters."wear.lower.p0" = { start = 0.0,  bounds = [0.0, 200.0] }
starts = 8
method = "brgn"
intervals = ["linear", "profile"]
level = 0.9
loss = "student"
[fit.parameters."contact.friction"]
start = 0.1
bounds = [0.01, 1.0]
scale = "log"
prior = { normal = [0.1, 0.05] }
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
  nuisance.offset = {}
  nuisance.drift = { prior = { normal = [0.0, 0.5] } }
  nuisance.compliance = { bounds = [0, 1] }
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
[compare.archard]
set = { "wear.lower.law" = "archard" }
parameters."wear.lower.k" = { start = 1e-8, bounds = [1e-11, 1e-5], scale = "log" }
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


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("cases",), 1, "cases: unknown key (did you mean case?); must be one of case, fit"),
        (("case",), None, "case is missing"),
        (("case",), "nowhere.toml", 'fit: case = "nowhere.toml": nowhere.toml: cannot be read'),
        (("experiment",), [], "must be tables, [[experiment]]"),
        (("experiment", 1, "name"), "test 1", "is there twice"),
        (("experiment", 0, "data"), None, "data is missing: must be tables"),
        (("experiment", 0, "set", "load.presure"), 1, "did you mean load.pressure?"),
        (("experiment", 0, "set", "wear.lower.k"), 1e-7, "is set, and wear.lower.k is fitted"),
        (("experiment", 0, "set", "mesh.geometry"), "updated", 'must be "fixed" in a fit'),
        (("fit", "parameters"), {}, "must name one case key at least"),
        (
            ("fit", "parameters", "wear.lower.m"),
            {"start": 2.0, "bounds": [1.0, 3.0]},
            'must be among k, p0 (m is of law = "power")',
        ),
        (("fit", "parameters", "upper.r"), {"start": 1}, "cannot be fitted"),
        (("fit", "parameters", "wear.upper.k"), FITTED["wear.lower.k"], "wear.upper.law is missi"),
        ((*K, "start"), 1e-4, "start = 0.0001: must be within its bounds, 1e-09 to 1e-05"),
        ((*K, "start"), None, "start is missing"),
        ((*K, "bounds"), [1e-5, 1e-9], "bounds = [1e-05, 1e-09]: must be two increasing numbers"),
        (
            (*K[:-1], "wear.lower.p0", "bounds"), ["0 s", "10 s"],
            'bounds = ["0 s", "10 s"]: must be in MPa (s is no unit of MPa)',
        ),
        ((*K, "bounds"), [0.0, 1e-5], 'must be two increasing numbers > 0 where scale = "log"'),
        ((*K, "bounds"), [-1.0, 1.0], "must be values that wear.lower.k may have"),
        ((*K, "prior"), {"normal": [1e-7, 0]}, "must be { normal = [mean, sd] }"),
        (("fit", "starts"), 0, "starts = 0: must be a whole number from 1"),
        (("fit", "method"), "newton", "method = \"newton\": must be one of brgn, lm"),
        (("fit", "intervals"), ["posteriors"], 'intervals = ["posteriors"]: must be'),
        (("fit", "level"), 95, "level = 95: must be a number > 0.5 and < 1"),
        ((*PEN, "quantity"), "depth", 'quantity = "depth": must be one of penetration'),
        ((*PEN, "file"), "nowhere.csv", "nowhere.csv: cannot be read"),
        ((*PEN, "columns", "value"), "w_um", "no column w_um for value; must be one of t_s, z_um"),
        ((*PEN, "units"), {"value": "s"}, 'units.value = "s": must be the unit of a length'),
        ((*PEN, "units"), {"time": "min"}, 'units.time = "min": the column t_s of '),
        ((*PEN, "at"), 10.0, "must be absent beside file"),
        ((*PEN, "sd"), 0.0, "sd = 0.0: must be a finite number > 0"),
        ((*PEN, "sd"), "noise", 'sd = "noise": must be a number, "fit", { relative = x } or a'),
        ((*PROF, "sd"), {"relative": 0.01}, "must be in the data's unit where readings are near"),
        ((*PEN, "nuisance"), {"level": {}}, "nuisance.level: must be one of offset, drift"),
        ((*PEN, "exclude"), [[2, 1]], "must be a list of increasing pairs"),
        ((*PEN, "exclude"), [[0, 1000]], "has no readings"),
        ((*PROF, "at"), 100.1, "at = 100.1: must be within the test, which ends at 100 s"),
        ((*PEN, "correlation_time"), 1e5, "must be at most 100 times the test"),
        ((*PROF, "correlation_time"), 1.0, "must be absent for a profile"),
        (("compare",), {"a": {"set": {}, "parameters": {}}}, "compare.a.parameters: is missing"),
        (
            ("compare",),
            {"a": {"set": {"wear.lower.law": "x"}, "parameters": FITTED}},
            'wear.lower.law = "x"',
        ),
        (
            ("compare",),
            {"a": {"set": {"wear.lower": {"law": "archard", "k": 1e-7}}, "parameters": FITTED}},
            "compare.a.set: wear.lower.k: is set, and wear.lower.k is fitted",
        ),
    ],
)  # fmt: skip
def test_faults(path, value, said, good):
    faults = refused(changed(good, path, value))
    assert path != ("compare",) or len(faults) == 1
    assert said in "\n".join(faults)
    assert "\n".join(faults).startswith("fit: ") or "nowhere.toml" in "\n".join(faults)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("sd = 0,2", "decimals have a point, as 0.2"),
        ("a = { b = 0,2, c = 1 }", "decimals have a point, as 0.2"),
        ("x = what", "at line 2"),
    ],
)
def test_what_is_no_toml_is_shown(line, said, tmp_path):
    (tmp_path / "fit.toml").write_text(f'case = "a"\n{line}\n')
    faults = refused(tmp_path / "fit.toml")
    assert said in "\n".join(faults)
    assert ("point" in "\n".join(faults)) == ("point" in said)


def test_all_faults_are_told_together(good):
    tables = changed(good, (*PEN, "sd"), 0)
    tables["fit"]["starts"] = -1
    tables["experiment"][1]["data"][1]["at"] = 1e9
    assert len(refused(tables)) == 3


def test_values_stay_within_bounds_without_overflow():
    parameter = FittedParameter("wear.lower.k", 1e-7, (1e-9, 1e-5), log=True)
    with np.errstate(all="raise"):
        assert [parameter.value(u) for u in (-1e6, 1e6)] == [1e-9, 1e-5]
    assert parameter.value(parameter.unknown(3e-7)) == pytest.approx(3e-7, rel=1e-12)


def test_other_files_are_told(tmp_path):
    (tmp_path / "case.toml").write_text(CASE)
    with pytest.raises(InputError, match="is a case, not a fit file"):
        read_fit(tmp_path / "case.toml")


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
    faults = refused(given, plans=True)
    assert "exclude" in "\n".join(faults)
    assert "time.end" in "\n".join(faults)
