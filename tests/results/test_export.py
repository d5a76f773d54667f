"""Exported files, read back: ParaView's by hand, tables by csv."""

import csv
import sys

import h5py
import numpy as np
import pytest
from parts import main, write_xlsx
from paths import CASES
from vtkhdf import last_state

from ringwear_par.results.export import export
from ringwear_par.results.files import open_result
from ringwear_par.results.run import run_case

SMALL = ["mesh.contact_elements=16"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory, comm):
    folder = tmp_path_factory.mktemp("runs")
    run_case(CASES / "fields.toml", folder / "run.h5", SMALL, comm=comm)
    words = [*SMALL, "output.boundary=none", "output.profiles=last"]
    run_case(CASES / "fields.toml", folder / "plain.h5", words, comm=comm)
    return folder


def test_contours(runs, tmp_path):
    states = open_result(runs / "run.h5").boundary
    export(runs / "run.h5", tmp_path / "a.vtkhdf")
    assert [p.name for p in tmp_path.iterdir()] == ["a.vtkhdf"]
    for number, state in enumerate(states):
        lower, upper = state.bodies
        data = last_state(tmp_path / "a.vtkhdf", number)
        m, k = len(lower.nodes), len(lower.elements)
        assert set(data["types"]) == {4}  # lines through several points
        assert np.array_equal(data["points"][:m, [0, 2]], lower.nodes)
        assert np.array_equal(data["displacement"][m:][:, [0, 2, 1]], upper.displacement)
        assert np.array_equal(data["traction"][:k][:, [0, 2, 1]], lower.traction)
        assert np.array_equal(data["cells"][k:], upper.elements + m)
        assert np.array_equal(data["body"], np.repeat([0, 1], [k, len(upper.elements)]))
        assert np.array_equal(data["wear"][:k], lower.wear)
        assert np.array_equal(data["pressure"][k:], upper.pressure)
    with h5py.File(tmp_path / "a.vtkhdf") as file:
        assert np.array_equal(file["VTKHDF/Steps/Values"], [state.time for state in states])


def test_tables(runs, tmp_path):
    result = open_result(runs / "run.h5")
    export(runs / "run.h5", tmp_path / "a.csv")
    header, *rows = csv.reader((tmp_path / "a.csv").read_text().splitlines())
    assert header[:3] == ["step", "time (s)", "approach (mm)"]
    assert header[-1] == "pressure_velocity (MPa m/s)"
    assert rows[0][header.index("mean_wear_rate_lower (um/h)")] == ""  # no time has passed
    approach = result.histories["approach"].tolist()
    assert [float(row[2]) for row in rows] == approach  # to the last digit


def test_a_workbook_has_all_tables(runs, tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    export(runs / "run.h5", tmp_path / "a.xlsx")
    book, result = openpyxl.load_workbook(tmp_path / "a.xlsx"), open_result(runs / "run.h5")
    assert book.sheetnames == ["numbers", "histories", "contact line"]
    group, label, value, unit, _ = next(book["numbers"].iter_rows(min_row=2, values_only=True))
    assert (group, label, unit) == ("penetration", "total", "um")
    assert value == pytest.approx(1e3 * result.histories["penetration"][-1], rel=1e-14)
    header, *rows = book["contact line"].iter_rows(values_only=True)
    assert header[:5] == ("step", "element", "time (s)", "r (mm)", "width (mm)")
    found = [row[header.index("pressure (MPa)")] for row in rows]
    np.testing.assert_allclose(found, result.profiles["pressure"].ravel(), rtol=1e-14)
    export(runs / "plain.h5", tmp_path / "a.xlsx")
    last = openpyxl.load_workbook(tmp_path / "a.xlsx")["contact line, last"]
    assert last.max_row == 1 + 16


def test_texts_in_workbooks_are_no_formulas(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    write_xlsx(tmp_path / "a.xlsx", [("texts", ["a", "b"], [["=1+1", float("nan")]])])
    _, row = openpyxl.load_workbook(tmp_path / "a.xlsx")["texts"].iter_rows()
    assert [(cell.value, cell.data_type) for cell in row] == [("=1+1", "s"), (None, "n")]


def test_failures_of_the_command_are_one_sentence(runs, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    for run, name, word in (("run", "a.xlsx", "openpyxl"), ("plain", "a.vtkhdf", "boundary")):
        assert main(["export", str(runs / f"{run}.h5"), "-o", str(tmp_path / name)]) == 2
        error = capsys.readouterr().err
        assert word in error
        assert len(error.splitlines()) == 1
    assert not list(tmp_path.iterdir())
