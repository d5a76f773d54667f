"""Study files: designs, ids, and cases that are those of their keys."""

import pickle

import numpy as np
import pytest
from parts import parse_case
from paths import CASES, PAPER
from swept import write_study

import ringwear_par as rw
from ringwear_par.studies.study import Study, read_study
from ringwear_par.studies.variations import column_of

CASE = PAPER.read_text()
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
    def written(text, case=CASE):
        return write_study(tmp_path, comm, text, case)

    return written


def rows(study):
    """Return the raw values of each case."""
    return list(zip(*(column.tolist() for column in study.columns.values()), strict=True))


def ids(study):
    """Return the ids of all cases."""
    return study.ids(np.arange(len(study))).tolist()


def test_the_unit_of_a_wear_coefficient_is_that_of_the_laws_of_the_cases():
    names = ("wear.lower.k", "wear.lower.law")
    for laws, unit in (
        (["power"], "mm/s"), (["archard"], "1/MPa"), (["archard", "power"], ""),
        (["archard", "threshold"], "1/MPa"),
    ):  # fmt: skip
        columns = dict(zip(names, map(column_of, ([1e-9] * len(laws), laws)), strict=True))
        study = Study("", "", "grid", {"wear.lower.law": "table"}, columns)
        assert study.units() == dict(zip(names, (unit, ""), strict=True))


def test_grid_is_the_product_in_order(write):
    study = read_study(write(GRID))
    values = rows(study)
    assert [row[1] for row in values] == [0, 20] * 3
    assert [row[0] for row in values[::2]] == pytest.approx([1e-8, 1e-7, 1e-6], rel=1e-14)
    case = study.case(3)
    assert case.wear_lower.values == {"k": values[3][0], "p0": 20.0}
    assert study.order.tolist() == [0, 1, 2, 3, 4, 5]


#: base cases and what varies: numbers, texts, lists, single entries, tables over time, ends
VARIED = {
    "numbers": ("paper", {"wear.lower.k": [1e-7, 3e-8, 2], "contact.friction": [0.1, 0]}),
    "texts": ("paper", {"upper.grip": ["clamped", "platen"], "wear.lower.law": ["threshold"]}),
    "shapes": ("paper", {"upper.r": [[28.5, 31.5], [28, 32]], "upper.chamfer": [0.1, [0.1, 0.2]]}),
    "loads": ("paper", {"load.omega": [3.5, [[0, 1.0], [10, 2.0]]], "load.force": [1e4, 12000]}),
    "ends": ("cycles", {"time.end": [100.0, 30], "time.tolerance": [2.5e-6, 1e-5]}),
    "running in": ("running_in", {"wear.lower.k_start": [2e-7, 5e-7], "wear.lower.depth": [1e-3]}),
    "layers": ("two_layers", {"lower.layers[0].thickness": [0.002, 0.01]}),
}


@pytest.mark.parametrize("name", VARIED)
def test_cases_are_those_of_their_keys(name):
    """Made together each is equal to one that is made by itself, and has the id of its keys."""
    stem, keys = VARIED[name]
    vary = {key: {"values": values} for key, values in keys.items()}
    study = read_study({"case": CASES / f"{stem}.toml", "vary": vary, "design": {"method": "grid"}})
    every = np.arange(len(study))
    assert len(study) == np.prod([len(values) for values in keys.values()])
    for n, (row, case, name_of) in enumerate(
        zip(rows(study), study.cases_of(every), ids(study), strict=True)
    ):
        assert case == study.case(n)
        again = rw.read_case(CASES / f"{stem}.toml", dict(zip(keys, row, strict=True)))
        assert parse_case(study.case(n).text, "") == parse_case(again.text, "")
        vary = {key: {"values": [value]} for key, value in zip(keys, row, strict=True)}
        assert ids(read_study({"case": CASES / f"{stem}.toml", "vary": vary})) == [name_of]
    assert len(set(ids(study))) == len(study)


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube", "random"])
def test_samples_fill_their_ranges(write, method):
    study = read_study(write(f'{DRAWN}[design]\nmethod = "{method}"\ncount = 256\n'))
    k, outer, elements, grip = zip(*rows(study), strict=True)
    fraction = np.log(np.array(k) / 1e-8) / np.log(100.0)
    assert 0.0 <= fraction.min() < 0.03
    assert 0.97 < fraction.max() <= 1.0
    # the mean of 256 uniform numbers: four standard deviations
    assert fraction.mean() == pytest.approx(0.5, abs=4.0 / np.sqrt(12.0 * 256.0))
    assert 30.5 <= min(outer) < max(outer) <= 32.0
    assert set(elements) <= set(range(8, 17))
    assert grip.count("platen") == pytest.approx(128, abs=32)


def test_list_from_a_table(write, tmp_path):
    (tmp_path / "rows.csv").write_text(
        "load.pressure,upper.r,time.scheme\n"
        '50,"[28, 32]",implicit\n6.05e1,"[28.5, 31.5]",explicit\n'
    )
    study = read_study(write('[design]\nmethod = "list"\nfile = "rows.csv"\n'))
    assert rows(study) == [(50, [28, 32], "implicit"), (60.5, [28.5, 31.5], "explicit")]
    assert study.case(1).time.scheme == "explicit"
    assert len(set(study.shapes)) == 2


def test_ids_follow_content(write):
    """Neither the title nor how numbers are written."""
    vary = '[vary]\n"load.pressure" = { values = [%s] }\n'
    one = ids(read_study(write(vary % "50, 60")))
    assert len(set(one)) == 2
    titled = CASE.replace('title = "', 'title = "Other: ')
    assert titled != CASE
    assert ids(read_study(write(vary % '"50 MPa", 6e1', titled))) == one
    assert not set(one) & set(ids(read_study(write(vary % "51, 61"))))
    assert not set(one) & set(ids(read_study(write(vary % "50, 60", CASE.replace("0.3", "0.31")))))


def test_bad_values_are_refused_before_any_work(write):
    """All of them, once each, with a case that has them."""
    text = (
        '[vary]\n"load.pressure" = { values = [50, -1, 60] }\n'
        '"contact.friction" = { values = [0.1, 0.2, -3] }\n'
        '"upper.grip" = { values = ["clamped", "clampt"] }\n'
    )
    with pytest.raises(rw.InputError) as raised:
        read_study(write(text))
    faults = {fault.loc: fault for fault in raised.value.faults}
    assert faults.keys() == {"upper.grip", "contact.friction", "load.pressure"}
    assert "case 2: " in faults["upper.grip"]
    assert "-3" in faults["contact.friction"]
    assert len(raised.value.faults) == 3


def test_an_end_of_a_range_that_no_case_can_have_is_refused(write):
    """Of a thousand numbers, one of which is bad whatever the others are."""
    text = '[vary]\n"upper.r[1]" = {{ linear = [{}, 32.0] }}\n'
    text += '"load.pressure" = {{ linear = [1, 2] }}\n[design]\nmethod = "random"\ncount = 1000\n'
    with pytest.raises(rw.InputError, match="upper"):
        read_study(write(text.format(10.0)))
    assert len(read_study(write(text.format(30.0)))) == 1000


def test_parameters_of_a_user_law_vary(tmp_path):
    """The law counts by its text, not by where its file is."""
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        for name in ("user_law.toml", "user_law.py"):
            (tmp_path / folder / name).write_text((CASES / name).read_text())

    def study(folder):
        vary = {"wear.lower.parameters.p1": {"linear": [30.0, 90.0], "count": 5}}
        return read_study({"case": tmp_path / folder / "user_law.toml", "vary": vary})

    one, two, every = study("one"), study("two"), np.arange(5)
    assert ids(one) == ids(two)
    assert one.digest(every) == two.digest(every)
    law = tmp_path / "two" / "user_law.py"
    law.write_text(law.read_text() + "\n# changed\n")
    assert not set(ids(study("two"))) & set(ids(one))
    assert study("two").digest(every) != one.digest(every)
    cases = pickle.loads(pickle.dumps(one)).cases_of(every)
    assert cases == [one.case(n) for n in range(5)]
    assert [case.wear_lower.values["parameters.p1"] for case in cases] == [30, 45, 60, 75, 90]
    assert all(case.wear_lower.values["parameters.k"] == 2e-7 for case in cases)
