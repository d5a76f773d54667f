"""Sweeps that are killed, stopped, damaged or started twice: all ends as if nothing had been."""

import re
import shutil
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import h5py
import pytest
from commands import NEEDS_MPIRUN, RINGWEAR, SHELL_ENVIRONMENT
from killed_sweeps import children, kill, wait_for_end
from swept import assert_same_sweeps, table, write_study
from waiting import Waiting

import ringwear_par as rw
from ringwear_par.studies import blocks, many

pytestmark = pytest.mark.slow
STUDY = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }
"upper.young" = { values = [5e4, 1e5] }
"""
#: a sweep in blocks of two cases, perhaps killed as it calls a function
SWEEP = """
import json, os, signal, sys
from pathlib import Path
import ringwear_par as rw
from ringwear_par.studies import many

study, output, function, call = sys.argv[1:]
many.MOST = 2
left = [int(call)]

def kill(frame, event, _):
    code = frame.f_code
    if event == "call" and code.co_name == function and "studies" in code.co_filename:
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)

sys.setprofile(kill if left[0] else None)
print(rw.sweep(Path(study), output).computed)
"""


def started(study, output, function="", call=0, launcher=()):
    """Start a sweep in blocks of two cases."""
    words = [*launcher, sys.executable, "-c", SWEEP, str(study), str(output), function, str(call)]
    return subprocess.Popen(
        words, env=SHELL_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def ended(process):
    """Return the status, standard output and error of a process at its end."""
    output = process.communicate(timeout=200)
    return process.returncode, *output


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch):
    monkeypatch.setattr(many, "MOST", 2)


@pytest.fixture(scope="module")
def swept(tmp_path_factory, comm):
    """A study of three blocks, its folder, and one of a sweep killed before it merged."""
    folder = tmp_path_factory.mktemp("swept")
    study = write_study(folder, comm, STUDY)
    assert ended(started(study, folder / "reference"))[0] == 0
    assert ended(started(study, folder / "killed", "merge", 1))[0] == -signal.SIGKILL
    return study, folder / "reference", folder / "killed"


@pytest.mark.parametrize(
    ("function", "call", "computed"),
    [("write_block", 2, 4), ("_compute_block", 1, 6), ("_columns", 2, 0), ("merge", 1, 0)],
)
def test_a_killed_sweep_goes_on(tmp_path, swept, comm, function, call, computed):
    """What is computed once more is at most the block that was at work."""
    study, reference, _ = swept
    status, _, error = ended(started(study, tmp_path / "out", function, call))
    assert status == -signal.SIGKILL, error
    assert rw.sweep(study, tmp_path / "out", comm).computed <= max(computed, 2)
    assert_same_sweeps(tmp_path / "out", reference)


@pytest.mark.parametrize("damage", ["empty", "cut", "changed"])
def test_a_damaged_block_is_computed_anew(tmp_path, swept, comm, caplog, damage):
    """Checksums tell whether numbers have changed."""
    study, reference, unmerged = swept
    output = shutil.copytree(unmerged, tmp_path / "out")
    path = sorted((output / "blocks").glob("*.h5"))[1]
    content = bytearray(path.read_bytes())
    with h5py.File(path) as file:
        place = file["pressure"].id.get_chunk_info(0).byte_offset
    content[place + 20] ^= 1
    sizes = {"empty": 0, "cut": len(content) // 2}
    path.write_bytes(content[: sizes.get(damage)])
    assert rw.sweep(study, output, comm).computed == 2
    assert re.search(f"{path.name}.* damaged; it is removed, and its cases", caplog.text)
    assert_same_sweeps(output, reference)


def test_a_disk_without_locks(tmp_path, swept, comm, monkeypatch, caplog):
    def flock(*_):
        raise OSError(37, "No locks available")

    study, reference, _ = swept
    monkeypatch.setattr(blocks.fcntl, "flock", flock)
    assert rw.sweep(study, tmp_path / "out", comm).computed == 6
    assert "has no locks" in caplog.text
    assert_same_sweeps(tmp_path / "out", reference)


def test_processes_at_once_share_the_work(tmp_path, swept):
    """As tasks of an array: all end when all is there, one merges."""
    study, reference, _ = swept
    ends = [ended(p) for p in [started(study, tmp_path / "out") for _ in range(3)]]
    assert [status for status, _, _ in ends] == [0, 0, 0], ends
    assert sum(int(output) for _, output, _ in ends) == 6
    assert_same_sweeps(tmp_path / "out", reference)


def test_a_block_of_a_killed_process_is_taken_over(tmp_path, swept):
    """By one that waits for it."""
    study, reference, _ = swept
    victim = started(study, tmp_path / "out", "write_block", 1)
    limit = time.monotonic() + 60.0
    while not list(tmp_path.glob("out/blocks/*.lock")) and victim.poll() is None:
        assert time.monotonic() < limit
        time.sleep(0.01)
    status, computed, error = ended(started(study, tmp_path / "out"))
    assert ended(victim)[0] == -signal.SIGKILL
    assert (status, int(computed)) == (0, 6), error
    assert_same_sweeps(tmp_path / "out", reference)


def test_a_disk_without_space_for_the_results(tmp_path, swept, comm, monkeypatch):
    """One sentence, blocks stay, and the same command goes on."""
    study, reference, unmerged = swept
    output = shutil.copytree(unmerged, tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10_000))
        with pytest.raises(rw.ComputationError, match=r"too full for the results.* 3 of 3 blocks"):
            rw.sweep(study, output, comm)
    assert rw.sweep(study, output, comm).computed == 0
    assert_same_sweeps(output, reference)


@NEEDS_MPIRUN
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_all_ranks_with_one_sentence(tmp_path, comm, number):
    """What is there stays, and the same command goes on."""
    waiting, output = Waiting(tmp_path), tmp_path / "out"
    waiting.hold(5.0)
    process = subprocess.Popen(
        ["mpirun", "-n", "2", *RINGWEAR, "sweep", str(waiting.study), "-o", str(output)],
        env=SHELL_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    limit = time.monotonic() + 60.0
    while not waiting.waits:
        assert time.monotonic() < limit
        time.sleep(0.02)
    ranks = children(process.pid)
    for rank in ranks:
        kill(rank, number)
    status, _, error = ended(process)
    wait_for_end(ranks)
    assert status == 1, error
    assert "Traceback" not in error
    assert "0 of 1 blocks are there, and the same command goes on" in error
    waiting.release()
    assert rw.sweep(waiting.study, output, comm).computed == waiting.cases
    assert {row["status"] for row in table(output)} == {"done"}
