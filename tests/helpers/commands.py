"""The command `ringwear` in a process of its own, as a user starts it."""

import os
import re
import shutil
import subprocess
import sys

import pytest

#: the environment before MPI adds to it: what a user's shell gives to a command
SHELL_ENVIRONMENT = dict(os.environ)
RINGWEAR = [sys.executable, "-m", "ringwear_par"]
NEEDS_MPIRUN = pytest.mark.skipif(not shutil.which("mpirun"), reason="no mpirun")


def on_ranks(*numbers):
    """Return the parameters of a test that starts commands without mpirun (0) and with it."""
    return [n if n == 0 else pytest.param(n, marks=NEEDS_MPIRUN) for n in numbers]


def python(*words, ranks=0, cwd=None, **environment):
    """Run Python, under mpirun where it has a number of ranks; return the process."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    return subprocess.run(
        [*launcher, sys.executable, *map(str, words)],
        env={**SHELL_ENVIRONMENT, "OPENBLAS_NUM_THREADS": "1", **environment}, cwd=cwd,
        capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip


def ringwear(*words, ranks=0, cwd=None):
    """Run the command as `python` runs Python."""
    return python(*RINGWEAR[1:], *words, ranks=ranks, cwd=cwd)


def sentences(result):
    """Return its sentences but for the progress that a busy machine shows; nothing of mpirun."""
    lines = [line for line in result.stderr.splitlines() if line.startswith("ringwear: ")]
    return [line for line in lines if not re.match(r"ringwear: step \d+, time", line)]
