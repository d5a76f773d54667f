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
    words = [*SMALL, "output.boundary=last", "time.steps=2"]
    run_case(CASES / "sphere.toml", folder / "axis.h5", words, comm=comm)
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


@pytest.mark.parametrize(("run", "segments"), [("run", 72), ("axis", 5)])
def test_revolved_surfaces(runs, tmp_path, run, segments):
    state, n = open_result(runs / f"{run}.h5").boundary[-1], segments
    export(runs / f"{run}.h5", tmp_path / "a.vtkhdf", segments=segments)
    data = last_state(tmp_path / "a.vtkhdf")
    counts = [len(body.elements) for body in state.bodies]
    cells, points, body = data["cells"], data["points"], data["body"]
    assert cells.shape == (n * sum(counts), 4)
    assert set(data["types"]) == {9}  # quadrangles
    assert np.array_equal(np.bincount(body), n * np.array(counts))
    # closed, with normals outwards: the volume of polygonal bodies
    for number, fields in enumerate(state.bodies):
        a, b = (fields.nodes[fields.elements[:, i]] for i in (0, 2))
        moment = np.pi / 3 * (a[:, 0] ** 2 + a[:, 0] * b[:, 0] + b[:, 0] ** 2)
        volume = float(moment @ (b[:, 1] - a[:, 1]))
        corners = points[cells[body == number]]
        p, q, r, s = (corners[:, i] for i in range(4))
        signed = sum(np.einsum("ij,ij", x, np.cross(y, z)) for x, y, z in ((p, q, r), (p, r, s)))
        polygon = np.sin(2 * np.pi / n) / (2 * np.pi / n)
        assert signed / 6 == pytest.approx(volume * polygon, rel=1e-6)
    # forces on the held faces, from vectors turned to the segments
    assert np.abs(data["traction"]).max() >= data["pressure"].max() * 0.99
    u = data["displacement"]
    radius = np.hypot(*points[:, :2].T)
    away = radius > 1e-9
    radial = (u[:, :2] * points[:, :2]).sum(axis=1)[away] / radius[away]
    stored = np.concatenate([f.displacement[:, 0] for f in state.bodies])
    assert np.isclose(radial[:, None], stored[None], atol=1e-12).any(axis=1).all()


def table(path):
    with path.open(newline="") as file:
        return list(csv.reader(file))


def test_tables(runs, tmp_path):
    result = open_result(runs / "run.h5")
    export(runs / "run.h5", tmp_path / "a.csv")
    header, *rows = table(tmp_path / "a.csv")
    assert header[:4] == ["step", "time (s)", "approach (mm)", "penetration (mm)"]
    assert header[-1] == "pressure_velocity (MPa m/s)"
    approach = result.histories["approach"].tolist()
    assert [float(row[2]) for row in rows] == approach  # to the last digit
    export(runs / "run.h5", tmp_path / "a.csv", fields=True)
    header, *rows = table(tmp_path / "a.csv")
    assert header == [
        "step", "time (s)", "element", "r (mm)", "pressure (MPa)", "gap (mm)",
        "wear_lower (mm)", "wear_upper (mm)",
    ]  # fmt: skip
    assert len(rows) == 16 * len(result.step)
    assert [float(row[4]) for row in rows] == result.profiles["pressure"].ravel().tolist()
    export(runs / "plain.h5", tmp_path / "a.csv", fields=True)
    header, *rows = table(tmp_path / "a.csv")
    assert len(rows) == 16
    assert {row[1] for row in rows} == {"200.0"}
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


def test_decimal_commas_have_semicolons(runs, tmp_path):
    export(runs / "run.h5", tmp_path / "a.csv", decimal="comma")
    (header, *rows) = csv.reader((tmp_path / "a.csv").read_text().splitlines(), delimiter=";")
    result = open_result(runs / "run.h5")
    assert header[2] == "approach (mm)"
    assert [float(row[2].replace(",", ".")) for row in rows] == result.histories[
        "approach"
    ].tolist()
    assert not any("." in cell for row in rows for cell in row)
    assert rows[0][header.index("mean_wear_rate_lower (um/h)")] == ""  # no time has passed


def test_a_workbook_has_all_tables(runs, tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    export(runs / "run.h5", tmp_path / "a.xlsx")
    book = openpyxl.load_workbook(tmp_path / "a.xlsx")
    assert book.sheetnames == ["numbers", "histories", "contact line"]
    result = open_result(runs / "run.h5")
    group, label, value, unit, _ = next(book["numbers"].iter_rows(min_row=2, values_only=True))
    assert (group, label, unit) == ("penetration", "total", "um")
    assert value == pytest.approx(1e3 * result.histories["penetration"][-1], rel=1e-14)
    assert book["contact line"].max_row == 1 + result.profiles["pressure"].size


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
