"""Study files: designs, ids, groups."""

import itertools
import math
import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from swept import write_study

from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.files.reading import make_case, parse_case
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.errors import InputError
from ringwear_par.studies.definition import checking
from ringwear_par.studies.definition.designs import SAMPLED
from ringwear_par.studies.definition.identities import case_id
from ringwear_par.studies.definition.study import read_study, read_study_together
from ringwear_par.studies.definition.variations import Column, read_variations
from ringwear_par.studies.definition.varied_columns import CaseColumns
from ringwear_par.studies.execution import plan

CASE = (Path(__file__).parents[2] / "scripts/cases/paper.toml").read_text()
GRID = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }
"wear.lower.p0" = { values = [0, 20] }
[design]
method = "grid"
"""
DRAWN = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6] }
"upper.r[1]" = { linear = [30.5, 32.0] }
mesh.contact_elements = { linear = [8, 16] }
"upper.grip" = { values = ["clamped", "platen"] }
"""


@pytest.fixture
def write(tmp_path, comm):
    def written(text):
        return write_study(tmp_path, comm, text, CASE)

    return written


def sampled(write, method, count, seed=1):
    text = f'{DRAWN}[design]\nmethod = "{method}"\ncount = {count}\nseed = {seed}\n'
    return read_study(write(text))


@pytest.mark.parametrize(
    ("laws", "unit"),
    [(["power"], "mm/s"), (["archard"], "1/MPa"), (["archard", "power"], ""),
     (["archard", "threshold"], "1/MPa")],
)  # fmt: skip
def test_the_unit_of_a_wear_coefficient_is_that_of_the_laws_of_the_cases(laws, unit):
    columns = [Column.of([1e-9] * len(laws)), Column.of([10.0] * len(laws)), Column.of(laws)]
    names = ("wear.lower.k", "load.pressure", "wear.lower.law")
    varied = CaseColumns.of({"wear.lower.law": "table"}, names, tuple(columns))
    assert varied.units() == dict(zip(names, (unit, "MPa", ""), strict=True))
    base = {"wear.lower.law": laws[0], "lower.layers": [{"wear": {"law": laws[0]}}]}
    names = ("wear.lower.k", "lower.layers[0].wear.k")
    fixed = CaseColumns.of(base, names, (columns[0], columns[0]))
    assert set(fixed.units().values()) == {unit or "1/MPa"}


def test_the_unit_of_a_varied_key_is_that_of_its_values():
    vary = {"wear.lower.k": {"log": ["1e-5 mm3/(N m)", 1e-6], "count": 2},
            "load": {"omega": {"values": ["20 rpm", 3.0]}, "pressure": {"values": ["5 MPa"]}},
            "wear.lower.p0": {"values": [0, 20]}}  # fmt: skip
    faults = []
    variations = read_variations("study", vary, "grid", faults)
    assert not faults
    assert [v.unit for v in variations] == ["mm3/(N m)", "rpm", "", ""]


def test_grid_is_the_product_in_order(write):
    study = read_study(write(GRID))
    assert [row[1] for row in study.rows] == [0, 20] * 3
    assert [row[0] for row in study.rows[::2]] == pytest.approx([1e-8, 1e-7, 1e-6], rel=1e-14)
    case = study.case(3)
    assert (case.wear_lower.k, case.wear_lower.p0) == (study.rows[3][0], 20.0)
    assert study.groups == ((0, 1, 2, 3, 4, 5),)


def test_cases_that_are_there_twice_are_counted(write, caplog):
    study = read_study(write('[vary]\n"load.pressure" = { values = ["8 MPa", 8, 9] }\n'))
    assert (len(study.cases), "once: 1 of 3" in caplog.text) == (2, True)


def test_a_case_of_a_study_is_told_by_its_text(write):
    """As one that was read: the text says all of it, and changes make another."""
    study = read_study(write(GRID))
    case = study.case(3)
    assert case.stored_text == case.text
    assert parse_case(case.stored_text, "told") == case
    changed = case.replace({"load.pressure": 60})
    assert changed == parse_case(case.text, "case", {"load.pressure": 60})
    assert changed.replace({"load.pressure": read_keys(case.text, "")["load.pressure"]}) == case
    assert study.case(3) is not case


@pytest.mark.parametrize("method", ["sobol", "random"])
@pytest.mark.parametrize("more", [8, 13, 40])
def test_a_longer_design_extends_a_shorter_one(write, method, more):
    short, long = sampled(write, method, 7), sampled(write, method, more)
    assert long.rows[:7] == short.rows
    assert long.ids[:7] == short.ids


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube", "random"])
def test_samples_fill_their_ranges(write, method):
    study = sampled(write, method, 256)
    k, outer, elements, grip = zip(*study.rows, strict=True)
    fraction = np.log(np.array(k) / 1e-8) / np.log(100.0)
    assert 0.0 <= fraction.min() < 0.03
    assert 0.97 < fraction.max() <= 1.0
    # the mean of 256 uniform numbers: four standard deviations
    assert fraction.mean() == pytest.approx(0.5, abs=4.0 / np.sqrt(12.0 * 256.0))
    assert 30.5 <= min(outer) < max(outer) <= 32.0
    assert set(elements) <= set(range(8, 17))
    assert grip.count("platen") == pytest.approx(128, abs=32)
    assert study.case(0).upper.r == (28.5, outer[0])
    assert sampled(write, method, 256).rows == study.rows
    assert sampled(write, method, 256, seed=2).rows != study.rows


def test_latin_hypercube_has_one_point_in_each_stratum(write):
    k = np.array([row[0] for row in sampled(write, "latin-hypercube", 50).rows])
    strata = (50.0 * np.log(k / 1e-8) / np.log(100.0)).astype(int)
    assert sorted(strata) == list(range(50))


def test_list_from_a_table(write, tmp_path):
    (tmp_path / "rows.csv").write_text(
        'load.pressure,upper.r,time.scheme\n50,"[28, 32]",implicit\n60.5,"[28.5, 31.5]",explicit\n'
    )
    study = read_study(write('[design]\nmethod = "list"\nfile = "rows.csv"\n'))
    assert study.rows == ((50, [28, 32], "implicit"), (60.5, [28.5, 31.5], "explicit"))
    assert study.case(1).time.scheme == "explicit"
    assert len(study.groups) == 2


def test_schemes_vary_and_each_has_the_keys_that_it_knows(tmp_path, comm):
    """A base case says the tolerance of the adaptive ones and the step of the others."""
    adaptive = CASE.replace('"implicit"', '"adaptive"') + "tolerance = 1e-5\n"
    text = '[vary]\n"time.scheme" = { values = ["implicit", "adaptive"] }\n'
    study = read_study(write_study(tmp_path, comm, text, adaptive))
    assert [study.case(n).time.end for n in (0, 1)] == [200.0, 200.0]
    assert study.case(1).time.tolerance == 1e-5
    assert "time.tolerance" not in study.keys(0)


def test_id_follows_content_only():
    one = {"load.pressure": 80, "wear.lower.p0": 0, "title": "x"}
    same = {"wear.lower.p0": 0.0, "load.pressure": 80.0, "time.scheme": "implicit"}
    assert case_id(one) == case_id(same)
    assert case_id(one) != case_id({**one, "load.pressure": 81})
    assert re.fullmatch("[0-9a-f]{16}", case_id(one))


def test_ids_do_not_change():
    """Else folders of sweeps would begin anew."""
    base = {
        "contact.friction": 0.1, "load.omega": 3.541666666666667, "load.pressure": 50.0,
        "lower.poisson": 0.3, "lower.r": [20.0, 40.0], "lower.young": 10000.0,
        "lower.z": [0.0, 20.0], "mesh.contact_elements": 32, "time.scheme": "implicit",
        "time.step": 1.0, "time.steps": 40, "upper.poisson": 0.3, "upper.r": [28.5, 31.5],
        "upper.young": 100000.0, "upper.z": [20.0, 40.0], "wear.lower.k": 1e-07,
        "wear.lower.law": "threshold", "wear.lower.p0": 40.0,
    }  # fmt: skip
    assert case_id(base) == "6bd491c1c9c4b1e1"


def test_groups_share_an_operator_longest_first(write):
    text = """
[vary]
"upper.poisson" = { values = [0.2, 0.3] }
"mesh.contact_elements" = { values = [16, 64] }
"lower.young" = { values = [1e4, 2e4] }
"wear.lower.k" = { values = [1e-7, 2e-7, 3e-7] }
[design]
method = "grid"
"""
    study = read_study(write(text))
    assert [len(group) for group in study.groups] == [6, 6, 6, 6]
    sizes = [study.case(group[0]).mesh.contact_elements for group in study.groups]
    assert sizes == [64, 64, 16, 16]
    moduli = [study.case(n).lower.young for n in study.groups[0]]
    assert moduli == sorted(moduli)


def test_a_range_that_is_open_at_its_end(write):
    open_end = '[vary]\n"lower.young" = { linear = [0, 1e4] }\n[design]\nmethod = "random"\n'
    assert len(read_study(write(open_end + "count = 30\n")).ids) == 30


def test_ranges_of_any_magnitude_are_sentences(tmp_path):
    """Of all keys that are whole numbers, by all designs: none overflows."""
    keys = [path for path, key in BY_PATH.items() if key.kind == "whole"]
    assert {"mesh.contact_elements", "time.steps"} <= set(keys)
    ends = [[1e-300, 1e299], [1e-60, 1e30], [1, 10**29], [1, 10**400], [1.0, math.inf]]
    designs = [{"method": method, "count": 4} for method in SAMPLED] + [{"method": "grid"}]
    for key, spacing, pair, design in itertools.product(keys, ("log", "linear"), ends, designs):
        varied = {spacing: pair} | ({"count": 3} if design["method"] == "grid" else {})
        tables = {"case": tomllib.loads(CASE), "vary": {key: varied}, "design": design}
        with pytest.raises(InputError) as raised:
            read_study(tables)
        (fault,) = raised.value.faults
        assert (fault.loc, fault.code) == (f"vary.{key}", "not_allowed")


def test_the_same_fault_of_many_cases_is_told_once(write):
    text = (
        '[vary]\n"load.pressure" = { values = [50, -1, 60] }\n'
        '"contact.friction" = { values = [0.1, 0.2, -3] }\n"upper.grip" = { values = ["clampt"] }\n'
    )
    with pytest.raises(InputError) as raised:
        read_study(write(text))
    grip, friction, pressure = raised.value.faults
    assert "cases 1, 2, 3 and 6 others" in grip
    assert "cases 3, 6 and 9" in friction
    assert "cases 4, 5 and 6" in pressure
    assert [fault.loc for fault in raised.value.faults] == [
        "upper.grip", "contact.friction", "load.pressure",
    ]  # fmt: skip


def test_parameters_of_a_user_law_vary(tmp_path):
    """By name; the law counts by what it says, not by where its file is."""
    base = Path(__file__).parents[2] / "scripts/cases/user_law.toml"
    study = tmp_path / "study.toml"
    study.write_text(
        f'case = "{base}"\n[vary]\n"wear.lower.parameters.p1" = {{ values = [30, 90] }}\n'
        '"load.omega" = { values = [3.5, [[0, 0], [10, 3.5]]] }\n'
    )
    read = read_study(study, 1)
    laws = [dict(read.case(i).wear_lower.parameters) for i in range(4)]
    assert [law["p1"] for law in laws] == [30.0, 30.0, 90.0, 90.0]
    assert all(law["k"] == 2e-7 for law in laws)
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for name in ("user_law.toml", "user_law.py"):
        (moved / name).write_text((base.parent / name).read_text())
    study.write_text(study.read_text().replace(str(base), str(moved / "user_law.toml")))
    assert read_study(study, 1).ids == read.ids
    (moved / "user_law.py").write_text((moved / "user_law.py").read_text() + "\n# changed\n")
    assert not set(read_study(study, 1).ids) & set(read.ids)


def test_tables_in_python_are_a_study(write, tmp_path):
    """As the file says it, the base case by name or as tables itself."""
    path = write(GRID)
    tables = tomllib.loads(path.read_text())
    base = path.parent / "paper.toml"
    of_file = read_study(path)
    for case in (base, str(base), tomllib.loads(CASE)):
        found = read_study({**tables, "case": case})
        assert (found.ids, found.rows, found.groups) == (of_file.ids, of_file.rows, of_file.groups)
        assert found.case(3) == of_file.case(3)
    with pytest.raises(InputError, match="case"):
        read_study({"vary": tables["vary"]})
    with pytest.raises(InputError, match="case 1"):
        read_study({"case": base, "vary": {"load.pressure": {"values": [-1]}}})


def test_every_rank_checks_its_share_of_the_cases(write, comm, monkeypatch):
    """Each kind of case is made once by a rank that has one, and the study is that of one rank."""
    text = DRAWN + '[design]\nmethod = "sobol"\ncount = 37\n'
    path, made = write(text), []

    def counted(keys, name, **how):
        made.append(name)
        return make_case(keys, name, **how)

    monkeypatch.setattr(checking, "make_case", counted)
    found = read_study_together(path, 1, comm)
    mine = len(made)
    assert mine in (37 // comm.size, -(-37 // comm.size))
    assert comm.allreduce(mine) == 37
    assert (found is None) == (comm.rank > 0)
    alone = read_study(path)
    if found is not None:
        for name in ("ids", "rows", "groups"):
            assert getattr(found, name) == getattr(alone, name), name
        assert found.case(36) == make_case(found.keys(36), "")
        assert found.case(36).text == make_case(found.keys(36), "").text


def test_ranks_without_any_case(write, comm):
    path = write('[vary]\n"load.pressure" = { values = [50] }\n')
    found = read_study_together(path, 1, comm)
    assert found.ids == read_study(path).ids


def test_faults_found_together_are_those_found_alone(write, comm):
    text = f'[vary]\n"load.pressure" = {{ values = {list(range(-26, 4))} }}\n'
    path = write(text)
    with pytest.raises(InputError) as alone:
        read_study(path)
    with pytest.raises(InputError) as found:
        read_study_together(path, 1, comm)
    assert found.value.faults == alone.value.faults
    assert "case 5" in found.value.faults[4]
    assert "22 more" in found.value.faults[-1]


def test_all_teams_have_to_fit_into_the_machine(write, tmp_path, monkeypatch):
    """Those that assemble at once, and what every rank holds."""
    machine = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    study = read_study(
        write('[vary]\n"upper.poisson" = { values = [0.1, 0.2, 0.3] }\n"lower.young" = '
              "{ values = [1e4, 2e4] }\n")
    )  # fmt: skip
    monkeypatch.setattr(plan, "memory_needed", lambda case, ranks: 0.4 * machine)

    def planned(ranks, ranks_per_case=1):
        return plan.make_plan(study, plan.Request(tmp_path / "out", ranks, ranks_per_case), None)

    assert planned(2).memory_needed() == pytest.approx(0.8 * machine)
    assert planned(4, 2).memory_needed() == pytest.approx(0.8 * machine)
    monkeypatch.setattr(plan, "memory_needed", lambda case, ranks: 0.125 * machine * ranks)
    with pytest.raises(InputError, match=r"8 teams.*memory"):
        planned(8)
    monkeypatch.setattr(plan, "memory_needed", lambda case, ranks: 0.4 * machine)
    # fewer operators than teams: all ranks assemble each of them
    assert planned(4).memory_needed() == pytest.approx(0.4 * machine, rel=0.01)


def law_case(law):
    return CASE.replace('law = "threshold"', law).replace("p0 = 40.0", "")


@pytest.mark.parametrize("body", ["wear.lower", "lower.layers[0].wear"])
def test_a_varied_k_start_below_k_is_refused_as_it_is_alone(body):
    case = tomllib.loads(law_case('law = "running-in"\nk_start = 3e-7\ndepth = 1e-3'))
    case["lower"]["layers"] = [
        {"thickness": 1.0, "young": 1e4, "poisson": 0.3, "wear": dict(case["wear"]["lower"])}
    ]
    vary = {f"{body}.k": {"values": [1e-7, 2e-7]},
            f"{body}.k_start": {"values": [1.5e-7, 4e-7]}}  # fmt: skip
    study = {"case": case, "vary": vary, "design": {"method": "grid"}}
    with pytest.raises(InputError) as refused:
        read_study(study)
    (fault,) = refused.value.faults
    assert fault.loc == f"{body}.k_start"
