"""Study files: designs, ids, groups, and what is wrong with bad ones."""

import re
from pathlib import Path

import numpy as np
import pytest

from ringwear_par.errors import InputError
from ringwear_par.studies.study import case_id, read_study

CASE = (Path(__file__).parents[2] / "scripts/cases/paper.toml").read_text()
GRID = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }
"wear.lower.p0" = { values = [0, 20] }
[design]
method = "grid"
"""
SAMPLED = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6] }
"upper.r[1]" = { linear = [30.5, 32.0] }
mesh.contact_elements = { linear = [8, 16] }
"upper.grip" = { values = ["clamped", "platen"] }
"""


@pytest.fixture
def write(tmp_path):
    (tmp_path / "paper.toml").write_text(CASE)

    def written(text, name="study.toml"):
        path = tmp_path / name
        path.write_text('case = "paper.toml"\n' + text)
        return path

    return written


def sampled(write, method, count, seed=1):
    text = f'{SAMPLED}[design]\nmethod = "{method}"\ncount = {count}\nseed = {seed}\n'
    return read_study(write(text))


def test_grid_is_the_product_in_order(write):
    study = read_study(write(GRID))
    assert [row[1] for row in study.rows] == [0, 20] * 3
    assert [row[0] for row in study.rows[::2]] == pytest.approx([1e-8, 1e-7, 1e-6], rel=1e-14)
    case = study.case(3)
    assert (case.wear_lower.k, case.wear_lower.p0) == (study.rows[3][0], 20.0)
    assert study.groups == ((0, 1, 2, 3, 4, 5),)


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


def test_id_follows_content_only():
    one = {"load.pressure": 80, "wear.lower.p0": 0, "title": "x"}
    same = {"wear.lower.p0": 0.0, "load.pressure": 80.0, "time.scheme": "implicit"}
    assert case_id(one) == case_id(same)
    assert case_id(one) != case_id({**one, "load.pressure": 81})
    assert re.fullmatch("[0-9a-f]{16}", case_id(one))


def test_repeated_cases_are_one(write):
    text = GRID.replace("values = [0, 20]", "values = [0, 20, 0.0]")
    assert len(read_study(write(text)).rows) == 6


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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["[vary]", "missing"]),
        ('[vary]\n"wear.lower.q" = { values = [1] }', ["wear.lower.q", "unknown key"]),
        ('[vary]\n"wear.lower.k" = 3', ["wear.lower.k", "must be { values"]),
        ('[vary]\n"wear.lower.k" = { values = [] }', ["a list of values"]),
        ('[vary]\n"wear.lower.k" = { log = [0, 1], count = 3 }', ["[0, 1]", "> 0"]),
        ('[vary]\n"wear.lower.k" = { linear = [2, 1], count = 3 }', ["two increasing numbers"]),
        ('[vary]\n"wear.lower.k" = { linear = [1, 2] }', ["count is missing", ">= 2"]),
        ('[vary]\n"wear.lower.k" = { linear = [1, 2], count = 2, seed = 1 }', ["seed"]),
        ('[vary]\n"title" = { values = ["a"] }', ["title"]),
        ('[vary]\n"output.boundary" = { values = ["all"] }', ["output.boundary", "ringwear run"]),
        ('[vary]\n"contact.friction[0]" = { values = [1] }', ["no entries"]),
        ('[vary]\n"load.pressure" = { values = [-5, 80] }', ["load.pressure = -5", "case 1"]),
        ('[vary]\n"upper.r[0]" = { values = [50] }', ["upper.r", "two increasing"]),
        (GRID.replace("grid", "gird"), ["gird", "grid, sobol"]),
        (GRID.replace('"grid"', '"sobol"'), ["design.count is missing", "must be absent"]),
        (GRID + "count = 3", ["design.count = 3", "must be absent"]),
        (GRID + "\n[other]\na = 1", ["other", "unknown key"]),
        ('[design]\nmethod = "list"', ["design.file is missing"]),
        ('[design]\nmethod = "list"\nfile = "no.csv"', ["no.csv", "cannot be read"]),
        ("[vary", ["not valid TOML"]),
    ],
)
def test_each_fault_has_its_sentence(write, text, words):
    with pytest.raises(InputError) as raised:
        read_study(write(text))
    for word in words:
        assert word in str(raised.value)


def test_bad_cases_are_counted(write):
    text = '[vary]\n"load.pressure" = { linear = [-100, -1], count = 30 }\n'
    with pytest.raises(InputError) as raised:
        read_study(write(text))
    assert len(raised.value.faults) == 6
    assert "25 more of 30 cases are bad" in raised.value.faults[-1]


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
