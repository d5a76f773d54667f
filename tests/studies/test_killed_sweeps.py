"""Sweeps that are killed, stopped or damaged: the same command ends as if nothing had been."""

import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import h5py
import pytest
from commands import NEEDS_MPIRUN, RINGWEAR, SHELL_ENVIRONMENT
from killed_sweeps import children, kill, wait_for_end
from swept import assert_same_sweeps, write_study
from waiting import Waiting

import ringwear_par as rw

pytestmark = pytest.mark.slow
STUDY = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }
"upper.young" = { values = [5e4, 1e5] }
"""
KILLED = """
import os, signal, sys
import ringwear_par as rw

study, output, function, call = sys.argv[1:]
calls = iter(range(int(call), 0, -1))

def kill(frame, event, _):
    code = frame.f_code
    if event == "call" and code.co_name == function and "studies" in code.co_filename:
        if next(calls) == 1:
            os.kill(os.getpid(), signal.SIGKILL)

sys.setprofile(kill)
rw.sweep(study, output)
"""


def killed(study, output, function, call):
    """Let a sweep be killed as it calls a function."""
    words = [sys.executable, "-c", KILLED, study, output, function, str(call)]
    done = subprocess.run(
        words, env=SHELL_ENVIRONMENT, timeout=200, check=False, capture_output=True
    )
    assert done.returncode == -signal.SIGKILL, done.stderr


@pytest.fixture(scope="module")
def swept(tmp_path_factory, comm):
    """A study, its folder, and one of a sweep killed before it merged."""
    folder = tmp_path_factory.mktemp("swept")
    study = write_study(folder, comm, STUDY)
    rw.sweep(study, folder / "reference", comm)
    killed(study, folder / "killed", "write_results", 1)
    return study, folder / "reference", folder / "killed"


def test_a_sweep_killed_as_it_merges_computes_nothing_again(tmp_path, swept, comm):
    study, reference, unmerged = swept
    output = shutil.copytree(unmerged, tmp_path / "out")
    assert rw.sweep(study, output, comm).computed == 0
    assert_same_sweeps(output, reference)
    assert {p.name for p in output.rglob("*")} == {p.name for p in reference.rglob("*")}


def test_a_sweep_killed_as_it_stores(tmp_path, swept, comm):
    study, reference, _ = swept
    killed(study, tmp_path / "out", "add", 2)
    assert rw.sweep(study, tmp_path / "out", comm).done == 6
    assert_same_sweeps(tmp_path / "out", reference)


@pytest.mark.parametrize("how", ["cut", "flipped"])
@pytest.mark.parametrize("name", ["shards/*.blocks", "results.h5"])
def test_damaged_files_are_computed_anew(tmp_path, swept, comm, name, how):
    """Two commands at most."""
    study, reference, unmerged = swept
    output = shutil.copytree(reference if name == "results.h5" else unmerged, tmp_path / "out")
    (path,) = output.glob(name)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content if how == "flipped" else content[: len(content) // 2])
    try:
        rw.sweep(study, output, comm)
    except rw.ComputationError:
        rw.sweep(study, output, comm)
    assert_same_sweeps(output, reference)


@pytest.fixture(scope="module")
def unhurried(tmp_path_factory, comm):
    """A study whose cases can wait under way, and its folder of results."""
    folder = tmp_path_factory.mktemp("waiting")
    waiting = Waiting(folder)
    rw.sweep(waiting.study, folder / "reference", comm)
    return waiting, folder / "reference"


@pytest.fixture
def held(unhurried):
    """The same; from now on half of its cases wait."""
    waiting, reference = unhurried
    waiting.hold()
    yield waiting, reference
    waiting.release()


@contextmanager
def started(study, output):
    """A sweep on two ranks, killed at last."""
    process = subprocess.Popen(
        ["mpirun", "-n", "2", *RINGWEAR, "sweep", str(study), "-o", str(output)],
        env=SHELL_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        if process.poll() is None:
            kill_all(process)


def kill_all(process):
    """Kill a sweep that we started, and its ranks."""
    family = children(process.pid)
    for pid in (process.pid, *family):
        kill(pid)
    process.communicate(timeout=60)
    wait_for_end(family)


def wait_for(condition, process):
    limit = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < limit, "waited in vain"
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)


@NEEDS_MPIRUN
def test_a_sweep_killed_under_way_goes_on(tmp_path, held, comm):
    (waiting, reference), output = held, tmp_path / "out"
    with started(waiting.study, output) as process:
        wait_for(lambda: waiting.waits == 2, process)
        kill_all(process)
    waiting.release()
    summary = rw.sweep(waiting.study, output, comm)
    assert waiting.cases // 2 <= summary.computed < waiting.cases
    assert_same_sweeps(output, reference)


@NEEDS_MPIRUN
def test_two_sweeps_in_one_folder(tmp_path, held, comm):
    """The second is refused, the first goes on."""
    (waiting, reference), output = held, tmp_path / "out"
    with started(waiting.study, output) as process:
        wait_for(lambda: waiting.waits == 2, process)
        with pytest.raises(rw.InputError, match="another sweep"):
            rw.sweep(waiting.study, output, comm)
        waiting.release()
        _, stderr = process.communicate(timeout=100)
        assert process.returncode == 0, stderr
    assert_same_sweeps(output, reference)


@NEEDS_MPIRUN
def test_a_signal_to_one_rank_stops_all(tmp_path, held, comm):
    """What has ended is stored, and the same command goes on."""
    (waiting, reference), output = held, tmp_path / "out"
    with started(waiting.study, output) as process:
        wait_for(lambda: waiting.waits == 2, process)
        kill(children(process.pid)[-1], signal.SIGTERM)
        waiting.release()
        _, stderr = process.communicate(timeout=100)
    assert process.returncode == 1, stderr
    assert "Traceback" not in stderr
    assert "stopped by SIGTERM" in stderr
    assert (output / "STOPPED").exists()
    with h5py.File(output / "results.h5", "r") as file:
        assert file.attrs["status"] == "incomplete"
        done = file["status"].asstr()[:].tolist().count("done")
    assert done < waiting.cases
    assert rw.sweep(waiting.study, output, comm).computed == waiting.cases - done
    assert_same_sweeps(output, reference)
