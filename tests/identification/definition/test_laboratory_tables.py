"""``[tests]``: a table of tests and masses is the experiments written out."""

import numpy as np
import pytest
from laboratory import fit_tables, refused
from parts import read_measurements

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit

#: with a preamble, a row of units, an interrupted test, decimal commas, a column of no use
TABLE = """Labor 3; Serie 7
Versuch;Probe;p;n;Dauer;at;vor;nach;sd Verlust;lower.density;Schrieb;Bemerkung
-;-;MPa;rad/s;min;s;g;mg;mg;g/cm3;-;-
A;S1;40;3,5;1,5;50;12,3500;12349,2;0,1;1,9;z1.csv;ok
A;;;;;90;;12348,5;0,1;;;
B;S2;85;3,5;1,5;;11,0000;10992,1;0,2;1,9;z2.csv;laut
"""
RECORD = {
    "quantity": "penetration", "columns": {"time": "t_s", "value": "z_um"}, "sd": 0.2,
    "exclude": [[90.0, 200.0]], "nuisance": {"offset": {}},
}  # fmt: skip


@pytest.fixture
def folder(laboratory):
    return laboratory[0]


def in_table(folder, text=TABLE, **keys):
    """Return a fit file as a dict whose tests are in a table."""
    (folder / "tests.csv").write_text(text, encoding="utf-8")
    tables = fit_tables(folder, [])
    del tables["experiment"]
    data = [{**RECORD, "file": f"{folder}/{{Schrieb}}"}]
    return tables | {"tests": {"file": str(folder / "tests.csv"), "data": data, **keys}}


def written_out(folder):
    """Return the same with each test in a table of its own."""

    def experiment(name, specimen, pressure, file, *masses):
        weighings = [{"quantity": "mass.lower", **mass} for mass in masses]
        conditions = {"load.pressure": pressure, "load.omega": 3.5, "time.end": "1.5 min",
                      "lower.density": "1.9 g/cm3"}  # fmt: skip
        data = [{**RECORD, "file": str(folder / file)}, *weighings]
        return {"name": name, "specimen": specimen, "set": conditions, "data": data}

    return fit_tables(
        folder,
        [
            experiment(
                "A", "S1", 40.0, "z1.csv",
                {"value": "0.8 mg", "sd": "0.1 mg", "at": 50.0},
                {"value": "1.5 mg", "sd": "0.1 mg", "at": "90 s"},
            ),
            experiment("B", "S2", 85.0, "z2.csv", {"value": "7.9 mg", "sd": "0.2 mg"}),
        ],
    )  # fmt: skip


def test_a_table_is_the_experiments_written_out(folder):
    """Bit for bit."""
    read = read_fit(in_table(folder))
    for test, twin in zip(read.experiments, read_fit(written_out(folder)).experiments, strict=True):
        assert (test.name, test.groups, test.case.text) == (twin.name, twin.groups, twin.case.text)
        for series, same in zip(test.series, twin.series, strict=True):
            assert (series.name, series.unit) == (same.name, same.unit)
            assert (series.nuisances, series.excluded) == (same.nuisances, same.excluded)
            assert all(np.array_equal(getattr(series, v), getattr(same, v)) for v in ("x", "sd"))
            assert np.array_equal(series.value, same.value)
    assert len(read.hashes) == 3


def test_columns_and_units_may_be_named(folder):
    """Both bodies weighed: of one, no column says which; sd of one weighing, a loss is of two."""
    text = "who,kN,dm,upper loss / mg\nA,1,3.2,0.1\nB,2,4.1,-\n"
    columns = {"name": "who", "load.force": "kN", "loss.lower": "dm"}
    tables = in_table(
        folder, text, columns=columns, units={"load.force": "kN", "loss.lower": "mg"},
        sd="0.1 mg", data=[],
    )  # fmt: skip
    tables["case"] = rw.read_case(
        str(folder / "case.toml"),
        {"lower.density": 0.002, "upper.density": 0.008, "wear.upper.law": "archard",
         "wear.upper.k": 1e-9},
    )  # fmt: skip
    first, second = read_fit(tables).experiments
    assert [series.name for series in first.series] == ["mass.lower", "mass.upper"]
    assert [series.name for series in second.series] == ["mass.lower"]
    assert first.series[0].sd == pytest.approx(1e-4 * np.sqrt(2.0))
    assert second.case.load.force == pytest.approx(2000.0)


def test_columns_that_are_named_leave_no_other_of_theirs(folder, caplog):
    """And lines above the names, and cells that are no readings, may be left out."""
    text = (
        "Rig;F;n\nRig 7;3;5\n"
        "Test;F / N;load / kN;p / MPa;max load / N;loss / mg;loss of both / mg;sd / mg\n"
        "A;9;1;9;8;3.2;OVL;0.1\nB;9;2;9;8;4.1;9;0.1\n"
    )
    columns = {"load.force": "load / kN", "loss.lower": "loss / mg"}
    tables = in_table(folder, text, columns=columns, data=[], skip=2, drop=["OVL"])
    tables["case"] = rw.read_case(str(folder / "case.toml"), {"lower.density": 0.002})
    tests = read_fit(tables).experiments
    assert [test.case.load.force for test in tests] == [1000.0, 2000.0]
    assert [test.series[0].value.tolist() for test in tests] == [
        pytest.approx([3.2e-3]),
        pytest.approx([4.1e-3]),
    ]
    assert "F / N, p / MPa, max load / N, loss of both / mg" in caplog.text
    tables["tests"] |= {"columns": {**columns, "loss.lower": "loss of both / mg"}}
    assert "A: has no reading" in str(refused(tables))


@pytest.mark.parametrize(
    ("cells", "row"),
    [
        (["9.468", "9.471", "9.502"], None),  # a balance with three decimals
        (["12", "1.468"], None),
        (["950", "1.050"], 1),
        (["1.000", "2.500"], 0),
        (["9.468", "9.5"], None),  # the other number tells the mark
    ],
)
def test_thousands_are_asked_for_where_numbers_speak_for_them(cells, row, tmp_path):
    (tmp_path / "a.csv").write_text("\n".join(["name;x", *(f"A;{cell}" for cell in cells)]))
    table = read_measurements(tmp_path / "a.csv", labelled=True)
    assert table.column(1).perhaps_thousands() == row


def test_limits_stand_in_a_column_or_in_a_template(folder):
    text = TABLE.replace("Bemerkung", "censored").replace("z1.csv;ok", "z1.csv;below")
    series = read_fit(in_table(folder, text.replace("laut", ""), data=[])).experiments[0].series
    assert [None if s.censored is None else s.censored.tolist() for s in series] == [[-1], None]
    text = "Test;p / MPa;m;side;lower.density / (g/cm3)\nA;40;0,8;below;1,9\nB;50;1,5;;1,9\n"
    template = {"quantity": "mass.lower", "value": "{m}", "unit": "mg", "sd": 0.1,
                "censored": "{side}"}  # fmt: skip
    first, second = read_fit(in_table(folder, text, data=[template])).experiments
    assert first.series[0].censored.tolist() == [-1]
    assert second.series[0].censored is None
    assert second.series[0].value == pytest.approx([1.5e-3])
