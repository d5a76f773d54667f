"""Folders of killed sweeps, and damaged ones: the same command ends as if nothing had been."""

import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from commands import SHELL_ENVIRONMENT
from swept import table, variables, write_study

import ringwear_par as rw
from ringwear_par.errors import ComputationError

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


@pytest.fixture
def output(tmp_path, swept):
    """A folder of shards that are not merged."""
    shutil.copytree(swept[2], tmp_path / "out")
    return tmp_path / "out"


def seconds(output):
    return {row["case"]: row["seconds"] for row in table(output)}


def check(study, output, reference):
    """Sweep until it ends well, twice at most; compare all but the time that it took."""
    try:
        rw.sweep(study, output)
    except ComputationError as error:
        assert "the same command" in str(error)  # noqa: PT017
        rw.sweep(study, output)
    one, other = variables(output), variables(reference)
    assert one.keys() == other.keys()
    for name, values in one.items():
        assert np.array_equal(values, other[name], equal_nan=values.dtype.kind == "f"), name
    without = [[{**row, "seconds": ""} for row in table(folder)] for folder in (output, reference)]
    assert without[0] == without[1]


def test_a_sweep_killed_as_it_merges_computes_nothing_again(output, swept, comm):
    study, reference, _ = swept
    assert rw.sweep(study, output, comm).computed == 0
    before = seconds(output)
    check(study, output, reference)
    assert seconds(output) == before
    assert {p.name for p in output.rglob("*")} == {p.name for p in reference.rglob("*")}


def test_a_sweep_killed_as_it_stores(tmp_path, swept):
    study, reference, _ = swept
    killed(study, tmp_path / "out", "add", 2)
    check(study, tmp_path / "out", reference)


@pytest.mark.parametrize("how", ["cut", "flipped", "another", "removed"])
@pytest.mark.parametrize("name", ["shards/*.blocks", "results.h5"])
def test_damaged_files_are_computed_anew(output, swept, name, how):
    study, reference, _ = swept
    if name == "results.h5":
        shutil.rmtree(output)
        shutil.copytree(reference, output)
    (path,) = output.glob(name)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    changed = {"cut": content[: len(content) // 2], "flipped": content, "another": b"x" * 5000}
    path.unlink() if how == "removed" else path.write_bytes(changed[how])
    check(study, output, reference)


def test_a_damaged_checkpoint_is_not_gone_on_from(tmp_path, swept, comm, stopped_after, one_by_one):
    study, reference, _ = swept
    output = tmp_path / "out"
    with stopped_after(7), pytest.raises(ComputationError, match="stopped by SIGTERM"):
        rw.sweep(study, output, comm)
    (path,) = (output / "inflight").iterdir()
    os.truncate(path, path.stat().st_size // 2)
    check(study, output, reference)
