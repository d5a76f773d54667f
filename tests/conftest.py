"""Serial and parallel runs of the same tests; a rank that fails does not leave the others waiting.

Run as ``pytest`` or as ``mpirun -n 2 python -m pytest --with-mpi``. On several ranks run the tests
that take the communicator ``comm``, directly or by a fixture, but for those marked ``serial``, as a
rule with their whole file, where each rank would but repeat what one does. The mark ``ranks``
brings back a test of such a file, and ``several`` one that compares ranks.
"""

import os
import re
import signal
import sys
import tempfile
import time
from contextlib import contextmanager

import commands  # noqa: F401  (keeps the environment before MPI adds to it)
import pytest

# assembled pairs are not kept, nor found, but in the tests of keeping them
os.environ["RINGWEAR_CACHE"] = ""
#: seconds that a rank waits for the others after a test
GRACE = 180.0


def pytest_configure(config):
    config._failures, config._sync = [], None
    config.addinivalue_line("markers", "serial: ranks would but repeat it, or it starts programs")
    config.addinivalue_line("markers", "ranks: runs on several ranks, in a file that is serial")
    config.addinivalue_line("markers", "several: likewise, and would show nothing on one rank")
    config.addinivalue_line("markers", "slow: of files that take a minute or so, which go first")
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        return  # workers run the tests, and would inherit what MPI puts into the environment
    from mpi4py import MPI

    import ringwear_par.petsc  # noqa: F401  (starts it as the package does)

    config._sync = MPI.COMM_WORLD.Dup() if MPI.COMM_WORLD.size > 1 else None
    if config._sync is not None:  # ranks that clear one temporary folder at once trip over it
        config._own = tempfile.TemporaryDirectory(prefix="ranks-", ignore_cleanup_errors=True)
        os.environ["PYTEST_DEBUG_TEMPROOT"] = config._own.name


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    if getattr(config, "_sync", None) is not None:
        config._sync.Barrier()
        config._own.cleanup()


def pytest_ignore_collect(collection_path, config):
    """On ranks, do not even import files of which nothing would run."""
    if config._sync is None or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text(encoding="utf-8")
    serial = re.search(r"^pytestmark = \[?\s*pytest\.mark\.serial", text, re.MULTILINE)
    brought_back = "mark.ranks" in text or "mark.several" in text
    return True if serial and not brought_back else None


def _runs_on_ranks(item):
    known = ("serial", "ranks", "several")
    marks = [mark.name for mark in item.iter_markers() if mark.name in known]
    return "comm" in item.fixturenames and marks[:1] != ["serial"]  # the closest comes first


def pytest_collection_modifyitems(config, items):
    if config._sync is None:
        left_out = [item for item in items if item.get_closest_marker("several")]
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)
    else:
        left_out = [item for item in items if not _runs_on_ranks(item)]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in set(left_out)]


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    report = outcome.get_result()
    if report.failed:
        item.config._failures.append(f"{report.nodeid}\n{report.longreprtext}")


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    yield
    sync = item.config._sync
    if sync is None:
        return
    request, started = sync.Ibarrier(), time.monotonic()
    while not request.Test():
        if time.monotonic() - started > GRACE:
            text = "\n".join(item.config._failures) or "no failure here"
            sys.__stderr__.write(
                f"rank {sync.rank} waited {GRACE:g} s after {item.nodeid}\n{text}\n"
            )
            sys.__stderr__.flush()
            sync.Abort(1)
        time.sleep(0.001)


@pytest.fixture(scope="session")
def comm():
    from mpi4py import MPI

    return MPI.COMM_WORLD


@pytest.fixture
def shared_path(tmp_path, comm):
    """A folder that is the same on all ranks."""
    return comm.bcast(tmp_path)


@pytest.fixture
def with_memory(monkeypatch):
    """Function that gives the machine so many bytes."""

    def with_memory(size):
        page = float(os.sysconf("SC_PAGE_SIZE"))
        known = {"SC_PAGE_SIZE": page, "SC_PHYS_PAGES": size / page}
        monkeypatch.setattr("ringwear_par.history.refusals.cases.os.sysconf", known.get)

    return with_memory


@pytest.fixture
def few_resamples(monkeypatch):
    """Indices of sweeps, where it does not matter how well they are known: most of the time."""
    monkeypatch.setattr("ringwear_par.studies.analysis.sensitivity._RESAMPLES", 20)
    monkeypatch.setattr("ringwear_par.studies.analysis.sensitivity._EVALUATIONS", 1e4)


@pytest.fixture
def one_by_one(monkeypatch):
    """Cases of sweeps are computed alone, as long ones are."""
    from ringwear_par.studies.execution import single_cases

    monkeypatch.setattr(single_cases, "LONG_STEPS", 0)


@pytest.fixture
def stopped_after(monkeypatch, comm):
    """Context manager: SIGTERM reaches one rank, the last, after a number of steps of a run.

    Or of a case of a sweep, where all of them are as long as those that are computed alone.
    """
    from ringwear_par.results.execution import run as run_command
    from ringwear_par.studies.execution import single_cases

    call = run_command.CheckpointWatch.__call__

    @contextmanager
    def stopped_after(step):
        def interrupted(self, snapshot):
            if snapshot.progress.steps == step and comm.rank == comm.size - 1:
                self._signals.received = signal.SIGTERM
            return call(self, snapshot)

        with monkeypatch.context() as patch:
            patch.setattr(run_command.CheckpointWatch, "__call__", interrupted)
            patch.setattr(single_cases, "LONG_STEPS", 0)
            yield

    return stopped_after


@pytest.fixture
def restarted(shared_path, comm, stopped_after):
    """Run a case at once, and again stopped after a step and restarted; return both files."""
    from ringwear_par.errors import ComputationError
    from ringwear_par.results.execution.run import run_case

    def restarted(case, overrides, step, match="SIGTERM after step"):
        whole, parts = shared_path / "whole.h5", shared_path / "parts.h5"
        run_case(case, whole, overrides, comm=comm)
        with stopped_after(step), pytest.raises(ComputationError, match=match):
            run_case(case, parts, overrides, comm=comm)
        run_case(case, parts, overrides, comm=comm, restart=True)
        return whole, parts

    return restarted


@pytest.fixture(scope="session")
def paper_pair(comm):
    """The paper's case at 80 MPa and p0 = 40 MPa, and its contact pair."""
    from reference_cases import paper_case

    from ringwear_par.elasticity.mesh import Mesh
    from ringwear_par.history.elastic.pairs import assemble

    case = paper_case(Mesh())
    return case, assemble(case, comm)
