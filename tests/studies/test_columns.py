"""Studies by column: as if each case had been made, checked, named and written by itself."""

import pickle
import random
import re
from pathlib import Path

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.cases.files.law_trials import refuse_bad_laws
from ringwear_par.cases.files.reading import make_case
from ringwear_par.files.text import toml_text
from ringwear_par.studies.definition.checking import LOOKED_AT, case_faults
from ringwear_par.studies.definition.designs import read_draft
from ringwear_par.studies.definition.identities import case_id
from ringwear_par.studies.definition.study import read_study
from ringwear_par.studies.definition.variations import Column, split_key, varied_keys
from ringwear_par.studies.storage.blocks import BY_CASE, BY_STATE, CASE, Kind, PackedBlock
from ringwear_par.studies.storage.case_index import CaseIndex
from ringwear_par.studies.storage.case_windows import fill

CASES = Path(__file__).parents[2] / "scripts/cases"
PAPER = (CASES / "paper.toml").read_text()
LAW = 'law = "threshold"'
RUNNING_IN = PAPER.replace(LAW, 'law = "running-in"\nk_start = 2e-7\ndepth = 1e-3')
PRESSED = PAPER.replace('"force"', '"displacement"').replace("pressure = ", "displacement = 1e-3 #")
ADAPTIVE = PAPER.replace('"implicit"', '"adaptive"')
#: base cases by what is special about them, and keys that vary together
BASES = {
    "paper": (PAPER, ()),
    "running-in": (RUNNING_IN, ("wear.lower.k_start", "wear.lower.depth")),
    "displacement": (PRESSED, ("load.displacement",)),
    "adaptive": (ADAPTIVE, ("time.end", "time.tolerance", "time.pressure_tolerance")),
    "times": (ADAPTIVE + "\n[output]\ntimes = [1.0, 20.0]\n", ("time.end",)),
    "non-local": (
        PAPER.replace(LAW, 'law = "non-local"\nlength = 0.1'),
        ("wear.lower.length",),
    ),
}
#: good values of keys, which are also numbers for which there is a short way
GOOD = {
    "wear.lower.k": [1e-7, 3e-8, 2, 1.5e-7],
    "wear.lower.p0": [0, 0.0, 40.0, 17.25],
    "wear.lower.k_start": [2e-7, 5e-7, 1],
    "wear.lower.depth": [1e-3, 2e-3],
    "wear.lower.length": [0.1, 0.25],
    "contact.friction": [0.1, 0, 0.30000000000000004],
    "load.omega": [3.5, 0, 1e-50],
    "load.pressure": [50, 60.5, 1e2],
    "load.force": [1e4, 12000],
    "load.displacement": [0.1, 0.02],
    "lower.young": [1e4, 20000],
    "upper.young": [1e5, 123456.789],
    "time.end": [100.0, 30],
    "time.tolerance": [2.5e-6, 1e-5],
    "time.pressure_tolerance": [0.1, 0.2],
}
#: others, good and bad
ODD = [
    -1, 0, 0.0, -0.0, float("nan"), float("inf"), 1e300, 10**310, True, "text", [1, 2], None, {},
    [[0, 1.0], [10, 2.0]], [[10, 1.0], [0, 2.0]], 5.0,
]  # fmt: skip
OTHERS = {
    "time.steps": [10, 20, 0, 2.0],
    "time.scheme": ["implicit", "explicit", "adaptive"],
    "upper.grip": ["clamped", "platen", "loose"],
    "upper.r[1]": [31.5, 32, 20.0],
    "mesh.contact_elements": [16, 24, 3],
    "upper.chamfer": [0.1, [0.1, 0.2], 99.0],
    "wear.lower.law": ["threshold", "archard", "running-in"],
}


def study_of(rng, folder):
    """Draw a study; return its tables."""
    name = rng.choice(list(BASES))
    text, own = BASES[name]
    path = folder / "base.toml"
    path.write_text(text)
    loads = ["load.displacement" if name == "displacement" else "load.pressure"]
    common = ["wear.lower.k", "wear.lower.p0", "contact.friction", "load.omega", "upper.young"]
    keys = rng.sample([*common, "lower.young", "load.force", *loads], 2)
    keys += rng.sample(list(own), min(len(own), rng.randint(0, 2)))
    keys += rng.sample(list(OTHERS), rng.randint(0, 2))
    vary = {}
    for key in dict.fromkeys(keys):
        values = list(OTHERS.get(key) or GOOD[key])
        if key in OTHERS and rng.random() < 0.7:
            values = values[:2]
        if rng.random() < 0.3:
            values.append(rng.choice(ODD))
        rng.shuffle(values)
        vary[key] = {"values": values[: rng.randint(1, len(values))]}
    return {"case": str(path), "vary": vary}


def one_by_one(tables):
    """Return ids and cases of a study without repetitions, or its first faults and their number."""
    draft = read_draft(tables)
    parts = [split_key(name) for name in draft.cases.names]
    found, bad = {}, []
    for number, row in enumerate(zip(*(c.by_case() for c in draft.cases.columns), strict=True)):
        keys, name = varied_keys(draft.cases.base, parts, row), f"study: case {number + 1}"
        try:
            case = make_case(keys, name)
            refuse_bad_laws(case, name)
        except rw.InputError as error:
            bad.append((number + 1, error.faults))
            continue
        found.setdefault(case_id(keys), (row, case, keys))
    return found, tuple(case_faults("study", bad[:LOOKED_AT], len(bad), len(draft.cases)))


def test_studies_are_what_their_cases_are_one_by_one(tmp_path):
    """Ids, cases, their texts and the sentences on bad ones."""
    bad = 0
    for seed in range(60):
        tables = study_of(random.Random(seed), tmp_path)
        wanted, faults = one_by_one(tables)
        try:
            found = read_study(tables)
        except rw.InputError as error:
            told = error.faults
            assert told[: len(faults)] == faults
            more = told[len(faults) :]  # of a mesh
            assert not any(re.search(r"\bcases? \d", fault) for fault in more)
            bad += bool(faults)
            continue
        assert faults == ()
        check_cases(found, wanted)
    assert 15 <= bad <= 45  # else it would show little


def check_cases(found, wanted):
    assert found.ids == tuple(wanted)
    cases = found.cases_of(range(len(wanted)))
    for i, (row, case, keys) in enumerate(wanted.values()):
        assert cases[i] == case
        assert cases[i].text == case.text == toml_text(keys)
        assert found.case(i) == case
        assert cases[i].breakpoints == case.breakpoints
        assert repr(found.rows[i]) == repr(row)
        assert repr(found.keys(i)) == repr(keys)
    assert sorted(n for group in found.groups for n in group) == list(range(len(wanted)))


@pytest.mark.parametrize("end", [100.0, 30.0])
def test_ends_of_cases(tmp_path, end):
    """Another end may have other steps, or be before a time at which something is stored."""
    text = ADAPTIVE.replace("friction = 0.1", "friction = [[0, 0.1], [50, 0.2]]")
    text += "\n[stress]\npoints = [[30.0, 15.0]]\ntimes = [40.0]\n"
    (tmp_path / "base.toml").write_text(text)
    tables = {"case": str(tmp_path / "base.toml"), "vary": {"time.end": {"values": [45, end, 80]}}}
    wanted, faults = one_by_one(tables)
    if faults:
        with pytest.raises(rw.InputError) as error:
            read_study(tables)
        assert error.value.faults == faults
    else:
        check_cases(read_study(tables), wanted)


def test_a_users_law_is_the_one_that_was_tried(tmp_path):
    """Whatever becomes of its file before a case is computed, or on another machine."""
    for name in ("user_law.toml", "user_law.py"):
        (tmp_path / name).write_text((CASES / name).read_text())
    vary = {"wear.lower.parameters.p1": {"linear": [30.0, 90.0], "count": 5}}
    study = read_study({"case": str(tmp_path / "user_law.toml"), "vary": vary})
    cases = [study.case(n) for n in range(5)]
    law = (tmp_path / "user_law.py").read_text()
    assert all(case.wear_lower.source == law for case in cases)
    (tmp_path / "user_law.py").unlink()
    there = pickle.loads(pickle.dumps(study))
    assert [there.case(n) for n in range(5)] == cases
    assert [dict(case.wear_lower.parameters)["p1"] for case in cases] == [30, 45, 60, 75, 90]


def test_numbers_of_a_table_are_those_that_toml_has(tmp_path):
    """Whichever way they are read."""
    cells = ["1", "-0", "0.50", "1e-7", "1E3", "+5", "01", "1_000", "inf", ".5", "5.", "0x10", "a"]
    (tmp_path / "rows.csv").write_text("wear.lower.p0\n" + "\n".join(cells) + "\n")
    (tmp_path / "paper.toml").write_text(PAPER)
    draft = read_draft(
        {"case": str(tmp_path / "paper.toml"),
         "design": {"method": "list", "file": str(tmp_path / "rows.csv")}}
    )  # fmt: skip
    wanted = [1, 0, 0.5, 1e-7, 1e3, 5, "01", 1000, float("inf"), ".5", "5.", 16, "a"]
    assert repr(draft.cases.columns[0].by_case()) == repr(wanted)


def test_columns_tell_values_apart_as_they_are_written():
    column = Column.of([0, 0.0, -0.0, 1, True, "1", [1, 2], [1, 2]])
    assert repr(column.by_case()) == "[0, 0.0, -0.0, 1, True, '1', [1, 2], [1, 2]]"
    assert len(set(column.codes.tolist())) == 7
    assert column.numbers is None
    assert len(set(Column.of([0.0, -0.0, 1.5, 0.0]).codes.tolist())) == 3
    part = column.part(np.array([6, 0, 7]))
    assert part.by_case() == [[1, 2], 0, [1, 2]]


def a_block(name, rows, axes=(), **columns):
    cases = np.zeros(len(rows), dtype=CASE)
    for column, values in columns.items():
        cases[column] = values
    cases["rows"] = rows
    return PackedBlock(Path(name), cases, (Kind("1"),), dict(axes), {}, 1, 0, 0, 0, {})


def test_what_is_stored_twice_counts_once():
    """As it was done first, or else as it failed last, or else as it was interrupted last."""
    index = CaseIndex.of([
        a_block("a", [0] * 4, id=["a", "b", "c", "d"], status=[1, 2, 1, 2]),
        a_block("b", [0] * 3, id=["b", "a", "longer"], status=[1, 1, 0]),
        a_block("c", [0] * 3, id=["c", "d", "a"], status=[2, 2, 0]),
    ])  # fmt: skip
    found = {
        identity.decode(): (status, str(index.blocks[block].path))
        for identity, status, block in index.entries[["id", "status", "block"]].tolist()
    }
    assert found == {"a": (1, "b"), "b": (2, "a"), "c": (2, "c"), "d": (2, "a"), "longer": (0, "b")}
    assert index.find(np.array([b"d", b"x", b"longer"]))[1] == -1


def test_a_case_that_was_not_begun_is_not_stored():
    block = a_block("a", [0] * 3, id=["a", "b", "c"], seconds=[1.0, np.nan, 2.0])
    index = CaseIndex.of([block])
    assert index["id"].tolist() == [b"a", b"c"]
    assert index["place"].tolist() == [0, 2]


@pytest.mark.parametrize("seed", range(12))
def test_histories_come_into_their_places(seed):
    """Ragged ones, in any order, with and without elements, against a loop."""
    rng = np.random.default_rng(seed)
    count, n = 6, 3
    lengths = rng.integers(0, 4, count) if seed % 3 else np.full(count, 3)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    places = rng.permutation(count)[:4] if seed % 2 else np.arange(1, 5)
    at = rng.permutation(9)[:4] if seed % 4 else np.arange(3, 7)
    block = a_block("a", lengths, {"time": BY_STATE, "pressure": BY_STATE})
    stored = {"time": rng.random(offsets[-1]), "pressure": rng.random((offsets[-1], n))}
    for name, values in stored.items():
        table = np.full((9, 4, *(4,) * (values.ndim - 1)), np.nan)
        wanted = table.copy()
        fill(table, at, values, block, name, places)
        for row, place in zip(at, places, strict=True):
            own = values[offsets[place] : offsets[place + 1]]
            wanted[(row, *map(slice, own.shape))] = own
        assert np.array_equal(table, wanted, equal_nan=True)
    last = rng.random((count, n))
    block = a_block("a", lengths, {"pressure": BY_CASE})
    table = np.full((9, 4, 4), np.nan)
    wanted = table.copy()
    some = lengths[places] > 0
    fill(table, at[some], last, block, "pressure", places[some])
    for row, place in zip(at, places, strict=True):
        if lengths[place]:
            wanted[row, lengths[place] - 1, :n] = last[place]
    assert np.array_equal(table, wanted, equal_nan=True)
