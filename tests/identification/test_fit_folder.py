"""The folder of a fit: what is written, dry runs, starts that are kept, fits that go on."""

import json
import pickle
import signal
import sys
import tomllib
from pathlib import Path

import h5py
import pytest
import xarray
from laboratory import (
    FITTED,
    TRUTH,
)
from parts import StopSignals, main, toml_value

import ringwear_par as rw
from ringwear_par.identification import fit as fit_room
from ringwear_par.identification import fit_command
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.estimation import solution as solution_room
from ringwear_par.identification.estimation import starts as starts_room
from ringwear_par.identification.fit import fit, fit_problem
from ringwear_par.identification.fit_command import run_fit
from ringwear_par.identification.model.rounds import StoppedError


def test_a_dry_run_tells_what_is_not_installed(tables, tmp_path, comm, capsys, monkeypatch):
    """And does not need it, as the fit does."""
    given = tables(intervals=["posterior"])
    path = tmp_path / "fit.toml"
    path.write_text("".join(f"{key} = {toml_value(value)}\n" for key, value in given.items()))
    monkeypatch.setitem(sys.modules, "emcee", None)  # as if it were not there
    run_fit(path, tmp_path / "out", comm, dry_run=True)
    assert 'missing: fit.intervals: "posterior" needs emcee: pip install' in capsys.readouterr().out
    with pytest.raises(rw.InputError, match=r'fit.toml: fit.intervals: "posterior" needs emcee'):
        run_fit(path, tmp_path / "out", comm)
    monkeypatch.undo()
    run_fit(path, tmp_path / "out", comm, dry_run=True)
    said = capsys.readouterr().out
    assert "missing" not in said
    assert "to be expected" in said
    assert not (tmp_path / "out").exists()


def test_only_a_fit_that_keeps_its_starts_can_go_on(tables, written, comm, monkeypatch):
    class Signals(StopSignals):
        def __enter__(self):
            self.received = signal.SIGTERM
            return self

    monkeypatch.setattr(fit_room, "StopSignals", Signals)
    with pytest.raises(rw.ComputationError, match="stopped by SIGTERM") as caught:
        fit(tables(), comm)
    assert "--restart" not in str(caught.value)
    with pytest.raises(rw.ComputationError, match="; nothing written"):
        run_fit(*written, comm)
    (written[1] / "progress").mkdir(parents=True)
    (written[1] / "progress" / "0-0.json").write_text("{}")
    assert starts_room.StoredStarts(written[1], "").hint.endswith("with --restart goes on")


@pytest.fixture
def written(tables, tmp_path):
    """A fit file of two starts, and the folder of its results."""
    given = tables()
    path = tmp_path / "fit.toml"
    path.write_text("".join(f"{key} = {toml_value(value)}\n" for key, value in given.items()))
    return path, tmp_path / "out"


def test_what_is_written(written, comm, capsys):
    path, folder = written
    run_fit(path, folder, comm)
    said = capsys.readouterr().out
    assert "wear.lower.p0" in said
    assert "chi2" in said
    assert sorted(p.name for p in folder.iterdir()) == [
        "fit.json", "fit.png", "parameters.png", "results.h5",
    ]  # fmt: skip
    told = json.loads((folder / "fit.json").read_text())
    names = "parameters covariance chi2 n_data aic bic experiments nuisance histories alternatives "
    assert set(f"{names}starts versions data".split()) <= told.keys()
    low, high = told["parameters"]["wear.lower.k"]["interval"]
    assert low < TRUTH["wear.lower.k"] < high
    with h5py.File(folder / "results.h5") as file:
        groups = [group for group in file.values() if "experiment" in group.attrs]
        assert len(groups) == 4
        chi2 = sum((group["residual"][:] ** 2).sum() for group in groups)
        assert chi2 == pytest.approx(told["chi2"])
        sensitivity = groups[0]["sensitivity"]
        assert sensitivity.shape == (len(groups[0]["time"]), 2)
        names = [name for name, group in file.items() if "experiment" in group.attrs]
    units = {"wear.lower.k": "1/MPa", "wear.lower.p0": "MPa"}
    assert {key: one["unit"] for key, one in told["parameters"].items()} == units
    for name in names:
        opened = xarray.open_dataset(folder / "results.h5", group=name, engine="h5netcdf")
        with opened as stored:
            assert stored["parameter"].values.tolist() == list(units)
            assert stored["parameter_unit"].values.tolist() == list(units.values())
            to_k = stored["sensitivity"].sel(parameter="wear.lower.k")
            assert to_k.dims == ("reading",)
            assert stored["data"].attrs["units"] == "mm"
    check_exported(folder, told, chi2)


def check_exported(folder, told, chi2):
    """Check that the tables for spreadsheets have the numbers of the fit."""
    openpyxl = pytest.importorskip("openpyxl")
    assert main(["export", str(folder), "-o", str(folder.parent / "fit.xlsx")]) == 0
    book = openpyxl.load_workbook(folder.parent / "fit.xlsx")
    sheets = {sheet.title: [*sheet.iter_rows(values_only=True)] for sheet in book}
    assert list(sheets) == ["tests", "parameters", "readings"]
    header, *keys = sheets["parameters"]
    k = dict(zip(header, keys[0], strict=True))
    stored = told["parameters"]["wear.lower.k"]
    assert (k["key"], k["unit"]) == ("wear.lower.k", "1/MPa")
    assert [k["from"], k["to"]] == pytest.approx(stored["interval"])
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


def test_a_complete_fit_is_left_as_it_is(written, comm, monkeypatch, caplog):
    caplog.set_level("INFO")
    path, folder = written
    text = path.read_text()
    path.write_text(
        text.replace("starts = 2", "starts = 1")
        + 'compare.fixed.set = {}\ncompare.fixed.parameters."wear.lower.k" = '
        + toml_value(FITTED["wear.lower.k"])
    )
    folder = folder.parent / "not" / "there"
    run_fit(path, folder, comm)
    run_fit(path, folder, comm, restart=True, compare=True)
    whole = (folder / "fit.json").read_text()
    assert list(json.loads(whole)["alternatives"]) == ["fixed"]

    def never(*args, **kwargs):
        raise AssertionError("fitted again")

    monkeypatch.setattr(fit_command, "fit_problem", never)
    run_fit(path, folder, comm, restart=True)
    assert (folder / "fit.json").read_text() == whole
    path.write_text(path.read_text() + "\n# another\n")
    with pytest.raises(AssertionError, match="fitted again"):
        run_fit(path, folder, comm)
    assert f"{folder / 'fit.json'} is there already: it will be replaced" in caplog.text


def test_a_fit_goes_on_with_the_starts_that_are_kept(written, comm, monkeypatch):
    """If it was stopped; one that has failed leaves nothing in the way of the next."""
    path, folder = written
    whole = rw.fit(path)
    assert "wear.lower.k" in repr(whole)
    assert pickle.loads(pickle.dumps(whole)).to_dict() == whole.to_dict()  # no engine in it

    def fails_with(error):
        calls = []

        def ending(*args):
            calls.append(args)
            if len(calls) == 2:
                raise error("the power failed")
            return solved(*args)

        with monkeypatch.context() as patch:
            patch.setattr(starts_room, "_solved", ending)
            with pytest.raises(error, match="the power failed"):
                run_fit(path, folder, comm)

    solved = starts_room._solved
    fails_with(rw.ComputationError)
    assert not folder.exists()
    fails_with(StoppedError)
    assert len(list((folder / "progress").iterdir())) == 1
    with pytest.raises(rw.InputError, match="--restart"):
        run_fit(path, folder, comm)
    other = path.with_name("other.toml")
    other.write_text("# another\n" + path.read_text())
    with pytest.raises(rw.InputError, match="another file"):
        run_fit(other, folder, comm, restart=True)
    run_fit(path, folder, comm, restart=True)
    told = json.loads((folder / "fit.json").read_text())
    assert not (folder / "progress").exists()
    assert told["parameters"]["wear.lower.k"]["estimate"] == whole.parameters[0].estimate
    assert told["starts"] == whole.to_dict()["starts"]
    # those at the optimum of a start that was kept are computed once more, in two tests
    assert 0 <= told["histories"] - whole.histories <= 2

    def stopping(*args):
        raise StoppedError("the power failed")

    with monkeypatch.context() as patch:  # once all starts are kept
        patch.setattr(solution_room, "likelihood_profiles", stopping)
        with pytest.raises(StoppedError, match="the power failed"):
            run_fit(path, folder.with_name("later"), comm)
    again = fit_problem(read_fit(path), comm, folder=folder.with_name("later"))
    assert 0 <= again.histories - whole.histories <= 2


def test_another_case_is_another_problem(written):
    path, _ = written
    case = Path(tomllib.loads(path.read_text())["case"])
    before = read_fit(path).key
    text = case.read_text()
    try:
        case.write_text(text.replace("contact_elements = 12", "contact_elements = 10"))
        assert read_fit(path).key != before
    finally:
        case.write_text(text)
    assert read_fit(path).key == before
