"""``ringwear fit`` and the folder that it writes: numbers, tables, dry runs."""

import json
import pickle
import sys

import h5py
import pytest
import xarray
from laboratory import TRUTH
from parts import main, toml_text

import ringwear_par as rw
from ringwear_par.identification.fit_command import run_fit


@pytest.fixture
def write(tmp_path):
    """Function that writes a fit file; returns it, and the folder of its results."""

    def write(tables):
        path = tmp_path / "fit.toml"
        path.write_text(toml_text(tables))
        return path, tmp_path / "out"

    return write


def test_a_dry_run_says_what_is_not_installed(tables, write, comm, capsys, monkeypatch):
    """And does not need it, as the fit does."""
    path, folder = write(tables(intervals=["posterior"]))
    monkeypatch.setitem(sys.modules, "emcee", None)  # as if it were not there
    run_fit(path, folder, comm, dry_run=True)
    assert "needs emcee" in capsys.readouterr().out
    with pytest.raises(rw.InputError, match="needs emcee"):
        run_fit(path, folder, comm)
    monkeypatch.undo()
    run_fit(path, folder, comm, dry_run=True)
    output = capsys.readouterr().out
    assert "missing" not in output
    assert "to be expected" in output
    assert not folder.exists()


def test_what_is_written(tables, write, capsys):
    path, folder = write(tables())
    assert main(["fit", str(path), "-o", str(folder)]) == 0
    assert "wear.lower.p0" in capsys.readouterr().out
    assert sorted(p.name for p in folder.iterdir()) == [
        "fit.json", "fit.png", "parameters.png", "results.h5",
    ]  # fmt: skip
    stored = json.loads((folder / "fit.json").read_text())
    low, high = stored["parameters"]["wear.lower.k"]["interval"]
    assert low < TRUTH["wear.lower.k"] < high
    with h5py.File(folder / "results.h5") as file:
        groups = {name: group for name, group in file.items() if "experiment" in group.attrs}
        assert len(groups) == 4
        chi2 = sum((group["residual"][:] ** 2).sum() for group in groups.values())
        assert chi2 == pytest.approx(stored["chi2"])
    units = {"wear.lower.k": "1/MPa", "wear.lower.p0": "MPa"}
    assert {key: one["unit"] for key, one in stored["parameters"].items()} == units
    for name in groups:
        with xarray.open_dataset(folder / "results.h5", group=name, engine="h5netcdf") as opened:
            assert opened["parameter"].values.tolist() == list(units)
            assert opened["parameter_unit"].values.tolist() == list(units.values())
            assert opened["sensitivity"].sel(parameter="wear.lower.k").dims == ("reading",)
            assert opened["data"].attrs["units"] == "mm"
    check_exported(folder, stored, chi2)


def check_exported(folder, stored, chi2):
    """Check that the tables for spreadsheets have the numbers of the fit."""
    openpyxl = pytest.importorskip("openpyxl")
    assert main(["export", str(folder), "-o", str(folder.parent / "fit.xlsx")]) == 0
    book = openpyxl.load_workbook(folder.parent / "fit.xlsx")
    sheets = {sheet.title: [*sheet.iter_rows(values_only=True)] for sheet in book}
    header, *keys = sheets["parameters"]
    k = dict(zip(header, keys[0], strict=True))
    assert (k["key"], k["unit"]) == ("wear.lower.k", "1/MPa")
    assert [k["from"], k["to"]] == pytest.approx(stored["parameters"]["wear.lower.k"]["interval"])
    place = sheets["readings"][0].index("residual over noise")
    assert sum(row[place] ** 2 for row in sheets["readings"][1:]) == pytest.approx(chi2)
    path = folder.parent / "fit.csv"
    assert main(["export", str(folder), "-o", str(path), "--decimal", "comma"]) == 0
    rows = [line.split(";") for line in path.read_text().splitlines()]
    assert rows[0] == list(sheets["tests"][0])
    for row, cells in zip(rows[1:], sheets["tests"][1:], strict=True):
        assert row[0] == cells[0]
        numbers = [float(cell.replace(",", ".")) for cell in row[1:]]
        assert numbers == pytest.approx(cells[1:], rel=1e-14)


def test_a_fit_can_be_pickled(tables, write):
    """As between processes: there is no engine in it."""
    found = rw.fit(write(tables())[0])
    assert "wear.lower.k" in repr(found)
    assert pickle.loads(pickle.dumps(found)).to_dict() == found.to_dict()


def test_a_reading_that_no_key_changes_is_refused_and_nothing_written(tables, write, capsys):
    mass = {"quantity": "mass.upper", "value": 0, "unit": "g", "density": 0.0078, "sd": 1}
    given = tables()
    given["experiment"][0]["data"].append(mass)
    path, folder = write(given)
    before = sorted(path.parent.iterdir())
    assert main(["fit", str(path), "-o", str(folder)]) == 2
    assert "respond" in capsys.readouterr().err
    assert sorted(path.parent.iterdir()) == before
