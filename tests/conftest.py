"""One rank runs all tests; those in ``tests/mpi`` are for several, where none waits for ever.

``python -m pytest``, and ``mpirun -n 2 python -m pytest --only-mpi``.
"""

import os
import sys
import tempfile
import time

import commands  # noqa: F401  (keeps the environment before MPI adds to it)
import pytest

#: seconds that a rank waits for the others after a test
PATIENCE = float(os.environ.get("RINGWEAR_TEST_PATIENCE", "120"))


def pytest_configure(config):
    config.addinivalue_line("markers", "slow: takes some ten seconds; these go first")
    config._world = None
    if not (config.getoption("--only-mpi") or config.getoption("--with-mpi")):
        return
    from mpi4py import MPI

    if MPI.COMM_WORLD.size > 1:  # ranks that clear one temporary folder at once trip over it
        config._world = MPI.COMM_WORLD.Dup()
        os.environ["PYTEST_DEBUG_TEMPROOT"] = tempfile.mkdtemp(prefix="ranks-")


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    """Print a failure at once: the ranks may not come to the end."""
    report = yield
    if item.config._world is not None and report.failed:
        print(f"{item.nodeid}\n{report.longreprtext}", file=sys.__stderr__, flush=True)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Meet the other ranks after each test: one that failed alone may have left them waiting."""
    outcome = yield
    if item.config._world is not None:
        request, started = item.config._world.Ibarrier(), time.monotonic()
        while not request.Test():
            if time.monotonic() - started > PATIENCE:
                print(f"no other rank came after {item.nodeid}", file=sys.__stderr__, flush=True)
                item.config._world.Abort(1)
            time.sleep(0.001)
    return outcome


@pytest.fixture(scope="session")
def comm():
    """The world's communicator."""
    from mpi4py import MPI

    import ringwear_par.petsc  # noqa: F401  (starts it as the package does)

    return MPI.COMM_WORLD


@pytest.fixture
def with_memory(monkeypatch):
    """Function that gives the machine so many bytes."""

    def with_memory(size):
        page = float(os.sysconf("SC_PAGE_SIZE"))
        known = {"SC_PAGE_SIZE": page, "SC_PHYS_PAGES": size / page}
        monkeypatch.setattr(os, "sysconf", known.get)

    return with_memory


@pytest.fixture(scope="session")
def paper_pair(comm):
    """The paper's case at 80 MPa and p0 = 40 MPa, and its contact pair."""
    from parts import Mesh
    from reference_cases import paper_case

    import ringwear_par as rw

    case = paper_case(Mesh())
    return case, rw.assemble(case, comm)
