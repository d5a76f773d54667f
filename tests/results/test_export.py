"""Exported files, read back: ParaView's by hand, tables by csv."""

import csv
import itertools
import shutil
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_cli import ringwear, sentences

from ringwear_par.errors import InputError
from ringwear_par.results.execution.run import run_case
from ringwear_par.results.storage import export as module
from ringwear_par.results.storage.export import export
from ringwear_par.results.storage.result_files import open_result

pytestmark = pytest.mark.serial
CASES = Path(__file__).parents[2] / "scripts" / "cases"
SMALL = ["mesh.contact_elements=16"]
RANKS = [
    0,
    *(
        pytest.param(n, marks=pytest.mark.skipif(not shutil.which("mpirun"), reason="no mpirun"))
        for n in (2, 3)
    ),
]


@pytest.fixture(scope="module")
def runs(tmp_path_factory, comm):
    folder = tmp_path_factory.mktemp("runs")
    run_case(CASES / "fields.toml", folder / "run.h5", SMALL, comm=comm)
    words = [*SMALL, "output.boundary=none", "output.profiles=last"]
    run_case(CASES / "fields.toml", folder / "plain.h5", words, comm=comm)
    words = [*SMALL, "output.boundary=last", "time.steps=2"]
    run_case(CASES / "sphere.toml", folder / "axis.h5", words, comm=comm)
    return folder


def read_vtk(path, kind="PolyData"):
    """Arrays of a .vtp or .vtu file with raw appended data, by name, and the sizes of its piece."""
    head, _, raw = path.read_bytes().partition(b'<AppendedData encoding="raw">')
    raw = raw[raw.index(b"_") + 1 :]
    found = {}
    root = ET.fromstring(head + b"</VTKFile>")
    assert root.attrib["type"] == kind
    assert root.attrib["header_type"] == "UInt64"
    for array in root.iter("DataArray"):
        at = int(array.attrib["offset"])
        (size,) = np.frombuffer(raw, np.uint64, 1, at)
        dtype = np.dtype(array.attrib["type"].lower())
        data = np.frombuffer(raw, dtype, int(size) // dtype.itemsize, at + 8)
        columns = int(array.attrib["NumberOfComponents"])
        found[array.attrib["Name"]] = data.reshape(-1, columns) if columns > 1 else data
    return found, root.find(f"{kind}/Piece").attrib


def test_contours(runs, tmp_path):
    state = open_result(runs / "run.h5").boundary[-1]
    lower, upper = state.bodies
    told = export(runs / "run.h5", tmp_path / "a.vtp")
    assert "200 s" in told
    assert [p.name for p in tmp_path.iterdir()] == ["a.vtp"]
    data, sizes = read_vtk(tmp_path / "a.vtp")
    m, k = len(lower.nodes), len(lower.elements)
    assert int(sizes["NumberOfPoints"]) == m + len(upper.nodes)
    assert int(sizes["NumberOfLines"]) == k + len(upper.elements)
    assert np.array_equal(data["points"][:m, [0, 2]], lower.nodes)
    assert not data["points"][:, 1].any()
    assert np.array_equal(data["displacement"][m:][:, [0, 2, 1]], upper.displacement)
    assert np.array_equal(data["traction"][:k][:, [0, 2, 1]], lower.traction)
    assert np.array_equal(data["connectivity"].reshape(-1, 3)[k:], upper.elements + m)
    assert np.array_equal(data["offsets"], 3 * np.arange(1, 1 + k + len(upper.elements)))
    assert np.array_equal(data["body"], np.repeat([0, 1], [k, len(upper.elements)]))
    assert np.array_equal(data["wear"][:k], lower.wear)
    assert np.array_equal(data["pressure"][k:], upper.pressure)


def test_time_and_scale(runs, tmp_path):
    states = open_result(runs / "run.h5").boundary
    for time, nearest in ((0, 0), (12.0, 10.0), (70, 50.0), (80, 100.0), (200, 200.0)):
        told = export(runs / "run.h5", tmp_path / "a.vtp", time)
        assert f": {nearest:g} s" in told
        data, _ = read_vtk(tmp_path / "a.vtp")
        (state,) = (s for s in states if s.time == nearest)
        m = len(state.bodies[0].nodes)
        assert np.array_equal(data["displacement"][:m, 2], state.bodies[0].displacement[:, 1])
    export(runs / "run.h5", tmp_path / "b.vtp", scale=50.0)
    warped, _ = read_vtk(tmp_path / "b.vtp")
    assert warped["points"] - data["points"] == pytest.approx(50 * data["displacement"], abs=1e-12)


@pytest.mark.parametrize("segments", [None, 5])
@pytest.mark.parametrize("run", ["run", "axis"])
def test_revolved_surfaces(runs, tmp_path, run, segments):
    state = open_result(runs / f"{run}.h5").boundary[-1]
    export(runs / f"{run}.h5", tmp_path / "a.vtu", segments=segments)
    n = segments or 72
    data, sizes = read_vtk(tmp_path / "a.vtu", "UnstructuredGrid")
    counts = [len(body.elements) for body in state.bodies]
    cells, points, body = data["connectivity"].reshape(-1, 4), data["points"], data["body"]
    assert int(sizes["NumberOfPoints"]) == len(points)
    assert int(sizes["NumberOfCells"]) == len(cells) == n * sum(counts)
    assert np.array_equal(data["types"], np.full(len(cells), 9))  # quadrangles
    assert np.array_equal(data["offsets"], 4 * np.arange(1, 1 + len(cells)))
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
    assert header[-1] == "contact_iterations"
    approach = [float(row[2]) for row in rows]
    assert approach == result.histories["approach"].tolist()  # to the last digit
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


def test_no_half_files(runs, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    from pyevtk.vtk import VtkFile

    monkeypatch.setattr(VtkFile, "appendData", full)
    with pytest.raises(OSError, match="No space"):
        export(runs / "run.h5", tmp_path / "a.vtp")
    monkeypatch.setattr(module, "_history_table", lambda _: (["a"], map(full, [0])))
    with pytest.raises(OSError, match="No space"):
        export(runs / "run.h5", tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


def test_without_pyevtk(runs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyevtk", None)
    with pytest.raises(InputError, match="needs the Python package pyevtk"):
        export(runs / "run.h5", tmp_path / "a.vtu")
    export(runs / "run.h5", tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run.h5", "-o", "{}/a.vtk"], "its ending must be one of .vtkhdf, .vtp, .vtu"),
        (
            ["run.h5", "-o", "{}/a.vtp", "--stress"],
            "/a.vtp: its ending must be .vtu (the grid), .vtkhdf (the grid) or .csv (the points)",
        ),
        (["run.h5", "-o", "{}/a.txt", "--stress"], "must be .vtu (the grid), .vtkhdf (the grid)"),
        (
            ["run.h5", "-o", "{}/a.txt", "--interfaces"],
            "/a.txt: its ending must be .vtp (lines) or .csv (a table)",
        ),
        (["no.h5", "-o", "{}/a.vtp"], "no.h5: does not exist"),
        (["run.h5", "-o", "{}/no/a.vtp"], "its folder"),
        (["run.h5", "-o", "{}/a.vtp", "--time", "201"], "--time 201: must be from 0 to 200 s"),
        (["run.h5", "-o", "{}/a.vtp", "--time", "1 h"], "--time 3600: must be from 0 to 200 s"),
        (["run.h5", "-o", "{}/a.vtp", "--time", "nan"], "nan: must be a time in s, or with its"),
        (["run.h5", "-o", "{}/a.vtp", "--time", "2 mm"], "2 mm: must be a time in s, or with its"),
        (["run.h5", "-o", "{}/a.csv", "--time", "10"], "--time 10: must be"),
        (
            ["run.h5", "-o", "{}/a.csv", "--fields", "--time", "2 h"],
            "--time 2 h: must be absent for .csv, it is for .vtp and .vtu only; --fields writes",
        ),
        (["run.h5", "-o", "{}/a.csv", "--scale", "10"], "--scale 10: must be"),
        (["run.h5", "-o", "{}/a.vtp", "--revolve", "10"], "for .vtu and .vtkhdf only"),
        (["run.h5", "-o", "{}/a.vtkhdf", "--time", "5"], "for .vtp and .vtu only"),
        (["run.h5", "-o", "{}/a.vtu", "--revolve", "2"], "must be from 3 to 3600"),
        (["run.h5", "-o", "{}/a.vtu", "--fields"], "--fields"),
        (["plain.h5", "-o", "{}/a.vtu"], "output.boundary"),
    ],
)
def test_bad_input_is_one_sentence(runs, tmp_path, words, said):
    done = ringwear("export", *(w.format(tmp_path) for w in words), cwd=runs)
    assert done.returncode == 2, done.stderr
    assert len(sentences(done)) == 1
    assert said in sentences(done)[0]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ranks", RANKS)
def test_the_command_on_any_number_of_ranks(runs, tmp_path, ranks):
    words = [runs / "run.h5", "-o", "a.vtu", "--time", "1.5 min"]
    done = ringwear("export", *words, ranks=ranks, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("a.vtu: 100 s") == 1
    if ranks:
        bad = ringwear("export", runs / "plain.h5", "-o", "b.vtu", ranks=ranks, cwd=tmp_path)
        assert bad.returncode == 2
        assert len(sentences(bad)) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.vtu"]


def vtkhdf_step(file, number):
    """Points, cells, types and fields at a step of a VTKHDF file, by the rules of its format."""
    root = file["VTKHDF"]
    steps = root["Steps"]
    part = steps["PartOffsets"][number]
    assert steps["NumberOfParts"][number] == 1
    m, k, ids = (
        int(root[f"NumberOf{name}"][part]) for name in ("Points", "Cells", "ConnectivityIds")
    )
    at, cell = steps["PointOffsets"][number], steps["CellOffsets"][number, 0]
    first = steps["ConnectivityIdOffsets"][number, 0]
    offsets = root["Offsets"][cell + part : cell + part + k + 1]
    connectivity = root["Connectivity"][first : first + ids]
    fields = {}
    for data, size in (("PointData", m), ("CellData", k)):
        for name, values in root[data].items():
            begin = steps[f"{data}Offsets"][name][number]
            fields[name] = values[begin : begin + size]
    cells = [connectivity[a:b] for a, b in itertools.pairwise(offsets)]
    return root["Points"][at : at + m], np.array(cells), root["Types"][cell : cell + k], fields


@pytest.mark.parametrize("segments", [None, 5])
def test_a_history_is_in_one_file(runs, tmp_path, segments):
    """Every step of it is what the files of single times hold."""
    states = open_result(runs / "run.h5").boundary
    told = export(runs / "run.h5", tmp_path / "a.vtkhdf", segments=segments, scale=20.0)
    assert told.endswith(f"{len(states)} states from 0 to 200 s")
    assert [p.name for p in tmp_path.iterdir()] == ["a.vtkhdf"]
    single = tmp_path / ("a.vtu" if segments else "a.vtp")
    with h5py.File(tmp_path / "a.vtkhdf") as file:
        root = file["VTKHDF"]
        assert root.attrs["Type"] == b"UnstructuredGrid"
        assert list(root.attrs["Version"]) == [2, 0]
        assert root["Steps"].attrs["NSteps"] == len(states)
        assert np.array_equal(root["Steps/Values"], [state.time for state in states])
        for number, state in enumerate(states):
            points, cells, types, fields = vtkhdf_step(file, number)
            export(runs / "run.h5", single, state.time, segments=segments, scale=20.0)
            data, _ = read_vtk(single, "UnstructuredGrid" if segments else "PolyData")
            assert np.array_equal(points, data.pop("points"))
            assert np.array_equal(cells.ravel(), data.pop("connectivity"))
            assert set(types) == {9 if segments else 4}
            assert np.array_equal(cells.shape[1] * np.arange(1, len(cells) + 1), data["offsets"])
            assert fields.keys() == data.keys() - {"offsets", "types"}
            for name, values in fields.items():
                assert np.array_equal(values, data[name])
