"""Fit files: what they may say."""

import numpy as np
import pytest
from laboratory import CASE, refused
from paths import CASES

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import FittedParameter
from ringwear_par.identification.definition.schema import KEYS

#: two tests, whose records say for themselves what they are
RECORDS = """
case = "case.toml"
[fit]
parameters."wear.lower.k"  = { start = 1e-7, bounds = [1e-9, 1e-5], scale = "log" }
parameters."wear.lower.p0" = { start = 0.0,  bounds = [0.0, 200.0] }
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
"""


def test_a_file_and_its_records(tmp_path):
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "fit.toml").write_text(RECORDS)
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
    assert low.case.wear_lower.values["p0"] == 0.0
    assert problem.settings.level == 0.9
    assert len(problem.hashes) == 3


def test_values_stay_within_bounds_without_overflow():
    parameter = FittedParameter("wear.lower.k", 1e-7, (1e-9, 1e-5), log=True)
    with np.errstate(all="raise"):
        assert [parameter.value(u) for u in (-1e6, 1e6)] == [1e-9, 1e-5]
    assert parameter.value(parameter.unknown(3e-7)) == pytest.approx(3e-7, rel=1e-12)


def test_defaults_are_those_of_what_is_read(tables):
    """A file that says every default is read as one that says none."""
    given = tables() | {"design": {"vary": {"load.pressure": [1.0, 2.0]}}}
    plain = read_fit(given)
    for key in KEYS:
        table, _, name = key.path.rpartition(".")
        if table in ("fit", "design") and key.default is not None:
            given[table][name] = key.default
    given["fit"]["parameters"]["wear.lower.p0"]["scale"] = "linear"
    said = read_fit(given)
    assert said.settings == plain.settings
    assert said.design == plain.design
    assert said.parameters == plain.parameters


def test_starts_and_ranges_may_have_units(tables):
    given = tables()
    given["fit"]["parameters"] = {
        "wear.lower.k": {
            "start": "1e-4 mm3/(N m)", "bounds": ["1e-9 1/MPa", 1e-5], "scale": "log",
        },
        "wear.lower.p0": {
            "start": 0.0, "bounds": [0.0, "0.2 GPa"], "prior": {"normal": ["20 MPa", 5.0]},
        },
    }  # fmt: skip
    given["design"] = {
        "vary": {"load.pressure": ["20 MPa", "0.1 GPa"], "time.end": [10, "2 min"]},
        "budget": {"time.end": "5 min", "experiments": 2},
    }
    problem = read_fit(given)
    k, p0 = problem.parameters
    assert (k.start, k.bounds) == (1e-7, (1e-9, 1e-5))
    assert (p0.bounds, p0.prior) == ((0.0, 200.0), (20.0, 5.0))
    assert problem.design.ranges == {"load.pressure": (20.0, 100.0), "time.end": (10.0, 120.0)}
    assert problem.design.seconds == pytest.approx(300.0)


LAYER = {"thickness": 1.0, "young": 5e3, "poisson": 0.3, "wear": {"law": "archard"}}
USER = {
    "wear.upper.law": "user", "wear.upper.file": str(CASES / "user_law.py"),
    "wear.upper.parameters": {"p1": 10.0},
}  # fmt: skip


@pytest.mark.parametrize(
    ("key", "brought", "table"),
    [
        ("wear.upper.k", {"wear.upper.law": "archard"}, {"wear.upper.k": 1e-8}),
        ("lower.layers[0].wear.k", {"lower.layers": [LAYER]}, {"lower.layers[0].wear.k": 1e-8}),
        ("wear.upper.parameters.k", USER, {"wear.upper.parameters": {"k": 1e-8, "p1": 10.0}}),
    ],
)
def test_a_law_that_set_brings_in_may_be_fitted(key, brought, table, tables):
    """Its number has no value in the case, which begins with the start."""
    given = tables()
    given["fit"]["parameters"][key] = {"start": 3e-8, "bounds": [1e-9, 1e-5], "scale": "log"}
    for test in given["experiment"]:
        test["set"] |= brought
    for experiment in read_fit(given).experiments:
        assert "3e-08" in experiment.case.text
        assert experiment.case.replace({key: 5e-8}).text != experiment.case.text
    given["experiment"][0]["set"] |= table
    (fault,) = refused(given)
    assert f"{key}: is set, and {key} is fitted" in fault


def test_faults_of_the_case_file_are_told_of_it_once(tables, tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text(CASE.replace("[contact]", "[contact]\nfrction = 0.2"))
    (fault,) = refused(tables() | {"case": str(path)})
    assert fault.startswith(f"{path}: contact.frction: unknown key")
