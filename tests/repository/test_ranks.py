"""Tests under mpirun end in time, whatever happens to one rank."""

import shutil

import pytest
from commands import NEEDS_MPIRUN, python
from paths import HELPERS, ROOT

FAILING = """
import os
import pytest

@pytest.mark.mpi
def test_one_rank(comm):
    if comm.rank == comm.size - 1:
        {}
"""


@NEEDS_MPIRUN
@pytest.mark.parametrize("end", ["raise ValueError('alone')", "os._exit(3)"])
def test_a_rank_that_fails_alone_ends_the_job(tmp_path, end):
    """The others wait for it in a collective call."""
    shutil.copy(ROOT / "tests/conftest.py", tmp_path)
    (tmp_path / "test_failing.py").write_text(FAILING.format(end))
    words = ["-m", "pytest", "-q", "--only-mpi", "--rootdir", tmp_path, "test_failing.py"]
    paths = f"{HELPERS}:{ROOT}"
    done = python(*words, ranks=2, cwd=tmp_path, PYTHONPATH=paths, RINGWEAR_TEST_PATIENCE="2")
    assert done.returncode != 0
    assert "alone" in done.stderr or "_exit" in end
