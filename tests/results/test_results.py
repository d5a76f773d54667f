"""Result files: opened by xarray, of the steps and fields asked for, never half there."""

import shutil

import h5py
import pytest
import xarray
from parts import FigureFile
from paths import PAPER
from stored import assert_same

import ringwear_par as rw
from ringwear_par.results.execution import run as driver
from ringwear_par.results.execution import run as monitor
from ringwear_par.results.execution.run import run_case
from ringwear_par.results.storage import result_files as results

SMALL = ["mesh.contact_elements=16", "time.steps=20"]


def test_only_the_steps_and_fields_asked_for(tmp_path, comm):
    path = tmp_path / "run.h5"
    run_case(PAPER, path, [*SMALL, "output.every=8", "output.fields=['pressure']"], comm=comm)
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        assert list(data.step.values) == [0, 8, 16, 20]
        assert list(data.time.values) == [0, 8, 16, 20]
        assert "gap" not in data
        assert int(data.contact_iterations.sum()) >= 20


def test_a_longer_history_extends_a_complete_one(tmp_path, comm):
    whole, parts = tmp_path / "whole.h5", tmp_path / "parts.h5"
    run_case(PAPER, whole, [*SMALL, "time.steps=30"], comm=comm)
    run_case(PAPER, parts, SMALL, comm=comm)
    run_case(PAPER, parts, SMALL, comm=comm, restart=True)  # nothing to do
    run_case(PAPER, parts, [*SMALL, "time.steps=30"], comm=comm, restart=True)
    assert_same(whole, parts)


def test_restart_with_fewer_steps_is_refused(tmp_path, comm):
    path = tmp_path / "run.h5"
    run_case(PAPER, path, SMALL, comm=comm)
    with pytest.raises(rw.InputError, match=r"holds 20 steps, time\.steps = 10"):
        run_case(PAPER, path, [*SMALL, "time.steps=10"], comm=comm, restart=True)


def test_a_complete_run_is_drawn_without_computing(tmp_path, comm):
    path, figure = tmp_path / "run.h5", tmp_path / "run.png"
    run_case(PAPER, path, SMALL, comm=comm)
    before = shutil.copy(path, tmp_path / "before.h5") if comm.rank == 0 else ""
    run_case(PAPER, path, SMALL, comm=comm, restart=True, figure=FigureFile(figure))
    assert figure.exists()
    assert_same(before, path)


def test_checkpoints_are_written_on_the_way(tmp_path, comm, monkeypatch):
    seen = []
    write = driver.write_result

    def spy(path, *args):
        write(path, *args)
        seen.append(results.read_status(path))

    monkeypatch.setattr(driver, "write_result", spy)
    monkeypatch.setattr(monitor, "CHECKPOINT_SECONDS", 0.0)
    run_case(PAPER, tmp_path / "run.h5", SMALL, comm=comm)
    assert seen[0] == ("incomplete", 1)
    assert seen[-1] == ("complete", 20)
    assert len(seen) == 20


def test_a_failed_last_write_is_an_error_on_all_ranks(tmp_path, comm, monkeypatch):
    def failing(*args):
        raise OSError(28, "No space left on device", "run.h5")

    monkeypatch.setattr(driver, "write_result", failing)
    with pytest.raises(rw.ComputationError, match="No space left"):
        run_case(PAPER, tmp_path / "run.h5", SMALL, comm=comm)
    assert not list(tmp_path.glob("*"))


@pytest.mark.parametrize("kind", ["text", "hdf5", "folder", "nowhere"])
def test_outputs_that_are_not_ours_are_refused(tmp_path, comm, kind):
    path = tmp_path / "run.h5"
    if kind == "text":
        path.write_text("precious")
    elif kind == "hdf5":
        h5py.File(path, "w").close()
    elif kind == "folder":
        path.mkdir()
    if kind == "nowhere":
        path = tmp_path / "no" / "run.h5"
    before = sorted(tmp_path.rglob("*"))
    match = {"folder": "is a folder", "nowhere": "does not exist"}.get(kind, "not a result file")
    with pytest.raises(rw.InputError, match=match):
        run_case(PAPER, path, SMALL, comm=comm)
    assert sorted(tmp_path.rglob("*")) == before
