"""Sweeps that are killed, stopped or damaged, and disks and cases that fail."""

import shutil
import signal
import subprocess
import time

import h5py
import killed_sweeps as faults
import pytest
from commands import SHELL_ENVIRONMENT
from waiting import STEPS, Waiting

from ringwear_par.results.execution import run as run_command
from ringwear_par.studies.execution import summary, team_store
from ringwear_par.studies.execution.sweep import run_sweep

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not shutil.which("mpirun"), reason="no mpirun"),
]
#: a team of ranks has one case at a time, with checkpoints
_ONE_BY_ONE = ("--ranks-per-case", "2")


def sweep(study, output, *words, ranks=2, patience=100):
    process = start(study, output, *words, ranks=ranks)
    try:
        stdout, stderr = process.communicate(timeout=patience)
    finally:
        if process.poll() is None:
            end(process)
    return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr)


def start(study, output, *words, ranks=2):
    return subprocess.Popen(
        [*faults.command(study, output, ranks), *map(str, words)],
        env=SHELL_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def end(process):
    """Kill what is left of a sweep that we started."""
    family = faults.children(process.pid)
    if process.poll() is None:
        for pid in (process.pid, *family):
            faults.kill(pid, signal.SIGKILL)
    process.communicate(timeout=60)
    faults.wait_for_end(family)


def until(condition, process=None, patience=60.0):
    limit = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < limit, "waited in vain"
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.02)


def sentences(text):
    return [line for line in text.splitlines() if line.startswith("ringwear: ")]


def statuses(output):
    with h5py.File(output / "results.h5", "r") as file:
        return file.attrs["status"], list(file["status"].asstr()[:]), list(file["error"].asstr()[:])


def kept(before, output, but=()):
    """Whether cases were not computed again."""
    after = faults.seconds_by_id(output)
    return all(after[i] == seconds for i, seconds in before.items() if i not in but)


@pytest.fixture(scope="module")
def unhurried(tmp_path_factory, comm):
    """A study whose cases can wait under way, and its folder of results."""
    folder = tmp_path_factory.mktemp("waiting")
    waiting = Waiting(folder)
    run_sweep(waiting.study, folder / "reference", comm)
    return waiting, folder / "reference"


@pytest.fixture
def held(unhurried):
    """The same; from now on half of its cases wait."""
    waiting, reference = unhurried
    waiting.hold()
    yield waiting, reference
    waiting.release()


def test_a_sweep_killed_under_way_goes_on(tmp_path, held):
    (waiting, reference), output = held, tmp_path / "out"
    process = start(waiting.study, output)
    try:
        until(lambda: waiting.waits == 2, process)
        family = faults.children(process.pid)
        for pid in (process.pid, *family):
            faults.kill(pid)
        process.communicate(timeout=60)
    finally:
        end(process) if process.poll() is None else None
    faults.wait_for_end(family)
    waiting.release()
    before = faults.done_before(output)
    assert 0 < len(before) <= waiting.cases // 2  # but for the blocks in work
    result = sweep(waiting.study, output)
    assert result.returncode == 0, result.stderr
    assert f"{len(before)} of {waiting.cases} cases are there already" in result.stderr
    assert kept(before, output)
    assert not faults.differences(output, reference)


def test_what_marks_a_stop_goes_through_no_link(tmp_path):
    elsewhere, mark = tmp_path / "elsewhere", tmp_path / "STOPPED"
    mark.symlink_to(elsewhere)
    summary.mark_stopped(mark)
    assert not elsewhere.exists()
    assert mark.is_file()
    assert not mark.is_symlink()


def test_two_sweeps_in_one_folder(tmp_path, held):
    (waiting, reference), output = held, tmp_path / "out"
    process = start(waiting.study, output)
    try:
        until(lambda: any((output / "shards").glob("*.blocks")), process)
        second = sweep(waiting.study, output, ranks=0)
        assert second.returncode == 2, second.stderr
        (told,) = sentences(second.stderr)
        assert "another sweep is at work" in told
        waiting.release()
        _, stderr = process.communicate(timeout=100)
        assert process.returncode == 0, stderr
    finally:
        end(process) if process.poll() is None else None
    assert not faults.differences(output, reference)


def test_signal_to_one_rank(tmp_path, held):
    (waiting, reference), output = held, tmp_path / "out"
    process = start(waiting.study, output, *_ONE_BY_ONE)
    try:
        until(lambda: waiting.waits == 2, process)
        faults.kill(faults.children(process.pid)[-1], signal.SIGTERM)
        waiting.release()
        _, stderr = process.communicate(timeout=100)
    finally:
        end(process) if process.poll() is None else None
    assert process.returncode == 1, stderr
    assert "Traceback" not in stderr
    assert "stopped by SIGTERM, incomplete" in sentences(stderr)[-1]
    assert (output / "STOPPED").exists()
    whole, status, _ = statuses(output)
    assert whole == "incomplete"
    inflight = sorted(path.stem for path in (output / "inflight").glob("*.h5"))
    assert inflight
    with h5py.File(output / "results.h5", "r") as file:
        steps = dict(zip(file["case"].asstr()[:], file["steps_stored"][:], strict=True))
    assert all(1 < steps[identity] < STEPS + 1 for identity in inflight)
    assert status.count("done") + len(inflight) < waiting.cases
    before = faults.done_before(output)
    result = sweep(waiting.study, output, *_ONE_BY_ONE)
    assert result.returncode == 0, result.stderr
    assert kept(before, output)
    assert not faults.differences(output, reference)


def test_no_checkpoint_is_left(tmp_path, monkeypatch, one_by_one, comm):
    study = faults.write_study(tmp_path, count=2, steps=4, elements=(16,))
    monkeypatch.setattr(run_command, "CHECKPOINT_SECONDS", 0.0)
    written, write = [], team_store.write_result
    monkeypatch.setattr(team_store, "write_result", lambda *w: (written.append(w), write(*w))[1])
    run_sweep(study, tmp_path / "out", comm)
    assert len(written) == 10 * 3
    assert not (tmp_path / "out" / "inflight").exists()


def test_steps_that_differ_stay_named_so(tmp_path, comm):
    study = faults.write_study(tmp_path, count=2, steps=30, elements=(16,))
    text = study.read_text(encoding="utf-8")
    study.write_text(text.replace("[design]", '"output.every" = { values = [1, 10] }\n[design]'))
    run_sweep(study, tmp_path / "out", comm)
    shutil.copytree(tmp_path / "out", tmp_path / "first")
    run_sweep(study, tmp_path / "out", comm)
    assert not faults.differences(tmp_path / "out", tmp_path / "first")
