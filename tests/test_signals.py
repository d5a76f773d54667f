"""Signals at every stage of a command: a word, status 1, and nothing half-written."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from commands import SHELL_ENVIRONMENT, ringwear
from paths import CASES, PAPER
from waiting import Waiting

pytestmark = pytest.mark.serial
PAPER, STUDY = str(PAPER), str(CASES / "study.toml")
#: the command, waiting for ever where it imports a module or calls a function
WAITING = """
import importlib, os, sys, time
from pathlib import Path

place, *words = sys.argv[1:]

def wait(*args, **options):
    Path(f"waits_{os.getpid()}").touch()
    limit = time.monotonic() + 60.0
    while time.monotonic() < limit:
        time.sleep(0.005)
    sys.exit("no signal came")

class Finder:
    def find_spec(self, name, path, target=None):
        if name == place:
            wait()

module, colon, function = place.partition(":")
if colon:
    namespace = vars(importlib.import_module(module))
    assert function in namespace, place
    namespace[function] = wait
else:
    sys.meta_path.insert(0, Finder())
from ringwear_par.cli import main
sys.exit(main(words))
"""


@contextmanager
def started(command, folder, **options):
    """A program, killed at last."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(
        command, cwd=folder, env=SHELL_ENVIRONMENT, **pipes, **options
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for(condition, process):
    limit = time.monotonic() + 100.0
    while not condition() and process.poll() is None:
        assert time.monotonic() < limit
        time.sleep(0.01)


def stopped(place, number, words, folder, ranks=0, waiting=None):
    """Send a signal to a command that waits at a place; return its end and what it said.

    So many processes wait, all where no number is given.
    """
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    with started([*launcher, sys.executable, "-c", WAITING, place, *words], folder) as process:
        wait_for(lambda: len(list(folder.glob("waits_*"))) == (waiting or ranks or 1), process)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    for path in folder.glob("waits_*"):
        path.unlink()
    return process.returncode, errors


FIRST_STEP = " before the first step; nothing written"


@pytest.mark.parametrize(
    ("place", "number", "words", "said"),
    [
        ("mpi4py", signal.SIGHUP, ["run", PAPER, "-o", "a.h5"], FIRST_STEP),
        ("ringwear_par.history.ensemble:assemble", signal.SIGTERM, ["run", PAPER, "-o", "a.h5"],
         FIRST_STEP),
        ("ringwear_par.studies.execution.sweep", signal.SIGINT, ["sweep", STUDY, "-o", "out"],
         "; the same command goes on"),
        ("matplotlib", signal.SIGINT, ["plot", "r.h5", "-o", "a.png"], "; nothing written"),
    ],
)  # fmt: skip
def test_a_signal_before_there_is_anything_to_keep(tmp_path, place, number, words, said):
    status, errors = stopped(place, number, words, tmp_path)
    assert errors == f"ringwear: stopped by {number.name}{said}\n"
    assert status == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not shutil.which("mpirun"), reason="no mpirun")
@pytest.mark.parametrize(
    ("place", "number"),
    [("mpi4py", signal.SIGINT), ("ringwear_par.history.ensemble:assemble", signal.SIGUSR1)],
)
def test_ranks_say_once_what_the_launcher_sent(tmp_path, place, number):
    words = ["run", PAPER, "-o", "a.h5"]
    status, errors = stopped(place, number, words, tmp_path, ranks=2)
    told = [line for line in errors.splitlines() if line.startswith("ringwear: ")]
    sent = {
        signal.SIGINT: ("SIGTERM", "; SIGTERM is mpirun's word for Ctrl-C and SIGHUP, too"),
        signal.SIGUSR1: ("SIGUSR1", ""),
    }
    name, remark = sent[number]
    assert told == [f"ringwear: stopped by {name}{FIRST_STEP}{remark}"]
    assert "Traceback" not in errors
    assert status != 0
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not shutil.which("mpirun"), reason="no mpirun")
def test_a_sweep_is_stopped_while_it_merges(tmp_path):
    """Nothing is lost: the next command goes on."""
    (tmp_path / "study.toml").write_text(
        f'case = "{PAPER}"\n[vary]\n"load.pressure" = {{ values = [60, 80] }}\n'
        '"mesh.contact_elements" = { values = [16] }\n"time.steps" = { values = [4] }\n'
    )
    words, place = ["sweep", "study.toml", "-o", "out"], "ringwear_par.studies.execution.merging"
    status, errors = stopped(f"{place}:write_results", signal.SIGINT, words, tmp_path, 2, waiting=1)
    told = [line for line in errors.splitlines() if line.startswith("ringwear: ")]
    end = "; the same command goes on; SIGTERM is mpirun's word for Ctrl-C and SIGHUP, too"
    assert told == [f"ringwear: stopped by SIGTERM{end}"]
    assert status != 0
    assert (tmp_path / "out" / "STOPPED").exists()
    again = ringwear(*words, ranks=2, cwd=tmp_path)
    assert "2 of 2 cases are there already" in again.stderr
    assert "2 done" in again.stdout
    assert not (tmp_path / "out" / "STOPPED").exists()


def test_nohup_is_respected(tmp_path):
    waiting, output = Waiting(tmp_path), tmp_path / "a.h5"
    waiting.hold(0.05)
    command = ["nohup", sys.executable, "-m", "ringwear_par", "run", str(waiting.case), "-o",
               str(output)]  # fmt: skip
    with started(command, tmp_path, stdin=subprocess.DEVNULL) as process:
        wait_for(lambda: waiting.waits, process)
        process.send_signal(signal.SIGHUP)
        waiting.release()
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert "stopped" not in errors


def test_a_signal_at_the_end_of_the_program_is_too_late(tmp_path):
    """What it came to is written: MPI and Python's own end take some time yet."""
    program = """
import atexit, sys, time
from pathlib import Path

def end():
    Path("waits_1").touch()
    limit = time.monotonic() + 60.0
    while not Path("go").exists() and time.monotonic() < limit:
        time.sleep(0.005)

atexit.register(end)
from ringwear_par.cli import main
sys.exit(main(["info", "--schema", "wear"]))
"""
    with started([sys.executable, "-c", program], tmp_path) as process:
        wait_for((tmp_path / "waits_1").exists, process)
        process.send_signal(signal.SIGTERM)
        (tmp_path / "go").touch()
        _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")


def test_a_signal_while_an_object_is_taken_down_stops_all_the_same():
    program = """
import os, signal, sys, time
from ringwear_par.results.execution.stop_signals import StopAtOnce, Stopped

class Object:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.0)

try:
    with StopAtOnce():
        Object()
        time.sleep(60.0)
except Stopped as stopped:
    sys.exit(f"stopped by {stopped}")
"""
    done = subprocess.run([sys.executable, "-c", program], env=SHELL_ENVIRONMENT, timeout=50,
                          capture_output=True, text=True, check=False)  # fmt: skip
    assert done.stderr == "stopped by SIGINT\n"


@pytest.mark.parametrize(
    ("rank", "seconds", "said"), [("0", 1.0, True), ("0", 0, False), ("1", 1, False)]
)
def test_a_word_is_said_before_mpirun_kills_what_does_not_end(rank, seconds, said):
    program = f"""
import os, signal, time
from ringwear_par.results.execution.stop_signals import StopSignals

with StopSignals() as signals:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep({seconds})
time.sleep(1.0 - {seconds})
"""
    ranks = {"OMPI_COMM_WORLD_SIZE": "2", "OMPI_COMM_WORLD_RANK": rank}
    done = subprocess.run([sys.executable, "-c", program], env={**SHELL_ENVIRONMENT, **ranks},
                          timeout=50, capture_output=True, text=True, check=True)  # fmt: skip
    assert ("stopped by SIGTERM before a step under way has ended; SIGT" in done.stderr) == said


@pytest.mark.skipif(not shutil.which("timeout"), reason="no timeout")
def test_a_second_signal_does_not_take_the_word_away(tmp_path):
    """As `timeout` sends it: to the program, and to its group."""
    with started([sys.executable, "-c", WAITING, "mpi4py", "run", PAPER, "-o", "a.h5"], tmp_path,
                 start_new_session=True) as process:  # fmt: skip
        wait_for(lambda: list(tmp_path.glob("waits_*")), process)
        process.send_signal(signal.SIGTERM)
        os.killpg(process.pid, signal.SIGTERM)
        _, errors = process.communicate(timeout=60)
    assert errors == f"ringwear: stopped by SIGTERM{FIRST_STEP}\n"
    assert process.returncode == 1
