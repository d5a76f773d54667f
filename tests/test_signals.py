"""Signals that ask to stop: what there is stays readable and goes on; a second one kills."""

import signal
import subprocess
import threading
import time
import weakref
from contextlib import contextmanager

import pytest
import xarray
from commands import NEEDS_MPIRUN, RINGWEAR, SHELL_ENVIRONMENT, python, ringwear
from parts import StopSignals
from paths import PAPER
from waiting import Waiting

import ringwear_par as rw

SMALL = {"mesh.contact_elements": 8, "time.steps": 3}
LAW_THAT_WAITS = """
import time
from pathlib import Path

Path(__file__).with_name("waits").touch()
time.sleep(60.0)
"""


@contextmanager
def started(*words, ranks=0, cwd=None):
    """A command, killed at last."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    with subprocess.Popen(
        [*launcher, *RINGWEAR, *map(str, words)], cwd=cwd, text=True,
        env={**SHELL_ENVIRONMENT, "OPENBLAS_NUM_THREADS": "1"},  # as what it is compared with
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


def wait_for(condition, process):
    limit = time.monotonic() + 100.0
    while not condition() and process.poll() is None:
        assert time.monotonic() < limit
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("ranks", "number"),
    [(0, signal.SIGUSR1), pytest.param(2, signal.SIGTERM, marks=NEEDS_MPIRUN)],
)
def test_a_run_that_is_stopped_goes_on_as_if_it_had_not_been(tmp_path, ranks, number):
    (tmp_path / "case").mkdir()
    waiting = Waiting(tmp_path / "case")
    waiting.hold(0.01)  # mpirun kills a second after its signal
    words = ["run", waiting.case, "-o", "a.h5"]
    with started(*words, ranks=ranks, cwd=tmp_path) as process:
        wait_for(lambda: waiting.waits == (ranks or 1), process)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode != 0
    if not ranks:
        assert process.returncode == 1
        assert f"stopped by {number.name} after step" in errors
    assert {path.name for path in tmp_path.iterdir()} == {"case", "a.h5"}
    assert rw.open_result(tmp_path / "a.h5").to_xarray().attrs["status"] == "incomplete"
    waiting.release()
    for more in (["--restart"], ["-o", "whole.h5"]):
        done = ringwear(*words, *more, ranks=ranks, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    with (
        xarray.open_dataset(tmp_path / "a.h5", engine="h5netcdf") as parts,
        xarray.open_dataset(tmp_path / "whole.h5", engine="h5netcdf") as whole,
    ):
        assert parts.attrs["status"] == "complete"
        xarray.testing.assert_equal(parts, whole)


def test_a_second_signal_kills(tmp_path):
    waiting = Waiting(tmp_path)
    waiting.hold(60.0)
    with started("run", waiting.case, "-o", "a.h5", cwd=tmp_path) as process:
        wait_for(lambda: waiting.waits, process)
        process.send_signal(signal.SIGTERM)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=1.5)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=20) == -signal.SIGTERM


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_before_there_is_anything_to_keep(tmp_path, number):
    waiting = Waiting(tmp_path)
    (tmp_path / "waiting.py").write_text(LAW_THAT_WAITS)
    with started("run", waiting.case, "-o", "a.h5", cwd=tmp_path) as process:
        wait_for((tmp_path / "waits").exists, process)
        process.send_signal(number)
        _, errors = process.communicate(timeout=20)
    assert errors == f"ringwear: stopped by {number.name}\n"
    assert process.returncode == 1
    assert not (tmp_path / "a.h5").exists()


def test_nohup_is_respected():
    program = """
import os, signal, sys
signal.signal(signal.SIGHUP, signal.SIG_IGN)
from ringwear_par.results.progress import StopSignals
with StopSignals() as signals:
    os.kill(os.getpid(), signal.SIGHUP)
    os.kill(os.getpid(), signal.SIGTERM)
sys.exit(signals.received != signal.SIGTERM)
"""
    assert python("-c", program).returncode == 0


def test_everything_works_in_any_thread(tmp_path, comm):
    """Only the main thread may take signals over."""
    from ringwear_par.results.run import run_case

    case = rw.read_case(PAPER, SMALL)
    study = {"case": str(PAPER), "vary": {"load.pressure": {"values": [40, 80]}}}
    study["vary"] |= {key: {"values": [value]} for key, value in SMALL.items()}
    done = []

    def work():
        rw.sweep(rw.read_study(study), tmp_path / "out", comm)
        run_case(PAPER, tmp_path / "a.h5", [f"{k}={v}" for k, v in SMALL.items()], comm=comm)
        stored = rw.open_result(tmp_path / "a.h5").histories["penetration"]
        simulated = rw.simulate(case, comm).histories["penetration"]
        (among,) = rw.simulate_all([case], comm)
        done.extend([stored[-1], simulated[-1], among.histories["penetration"][-1]])
        done.append(rw.open_ensemble(tmp_path / "out").sel(case=slice(None)).penetration[1, -1])

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done[:2] == [done[0]] * 2
    assert [float(value) for value in done] == pytest.approx([done[0]] * 4, rel=1e-4)
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_signal_in_a_callback_is_not_lost():
    """Python ignores exceptions there, as where HDF5 frees its objects."""

    def free():
        held = [threading.Event()]
        reference = weakref.ref(held[0], lambda _: signal.raise_signal(signal.SIGTERM))
        held.clear()
        time.sleep(10.0)
        assert not reference

    with StopSignals(at_once=True), pytest.raises(KeyboardInterrupt, match="SIGTERM"):
        free()
