"""The contact pairs that cases share, each in a file that every team maps: a node holds it once."""

import io
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity import pair_cache
from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.stress.recovery import load_stress_kernels
from ringwear_par.errors import ComputationError, InputError, RingwearError
from ringwear_par.files.writing import atomic_write
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.pairs import assemble, from_stacked, to_stacked
from ringwear_par.history.lockstep import must_run_alone
from ringwear_par.parallel import on_first_rank, together
from ringwear_par.studies.execution.plan import Plan
from ringwear_par.studies.execution.summary import Timings

#: how long a file may stay unseen by another machine (NFS: a minute by default), and between two
#: looks for it
PATIENCE_SECONDS = 75.0
_NAP_SECONDS = 0.01


class StorageError(ComputationError):
    """The disk; not the fault of a case."""


class StoppedError(RingwearError):
    """All are to stop, and there is no pair yet."""


def load_kernels_of(plan: Plan, comm: MPI.Comm) -> None:
    """Load what assembles and recovers stresses, where cases need it. Collective.

    By all ranks together, not by each team when it needs them.
    """

    def known() -> bool:
        cases = (plan.study.case(int(plan.todo[group][0])) for group in plan.left)
        return all(not must_run_alone(c) and pair_cache.has(operator_key(c)) for c in cases)

    if not on_first_rank(comm, known):
        load_kernels(comm)
    if plan.cases_left and plan.study.case(int(plan.todo.cases[0])).stress is not None:
        load_stress_kernels(comm)


def provide_all_pairs(plan: Plan, comm: MPI.Comm, timings: Timings) -> None:
    """Provide the pairs of all groups that are left, by all ranks. Collective.

    Raises
    ------
    ComputationError : the disk.
    """
    try:
        for group in plan.left:
            provide_pair(plan, group, comm, timings)
    except StorageError as error:
        on_first_rank(comm, plan.folder.drop_operators)
        ended = f"{plan.done + plan.failed} of {plan.total} cases are stored"
        raise ComputationError(f"{error}; {ended}, and the same command goes on") from error
    comm.Barrier()


def provide_pair(plan: Plan, group: int, comm: MPI.Comm, timings: Timings) -> None:
    """Assemble a group's pair into its file, or leave the reason of a failure. Collective."""
    t0 = time.perf_counter()
    write_pair(plan.folder.operator(group), plan.study.case(int(plan.todo[group][0])), comm)
    timings.operators += 1
    timings.assembly += time.perf_counter() - t0


def await_pair(
    path: Path, case: Case, comm: MPI.Comm, stopped: Callable[[], bool], received: Callable[[], int]
) -> ContactPair:
    """Return the pair of a case that another team provides. Collective on comm.

    Parameters
    ----------
    path : of its file.
    stopped : called now and then on the first rank; tells whether all are to stop.
    received : returns the signal that this rank has received, or 0.

    Raises
    ------
    StoppedError : all are to stop.
    StorageError : one of the ranks does not see the file, or not the whole of it.
    ComputationError : there is no such pair.
    """
    failure, agreed = _reason_file(path), 0

    def look() -> str | None:
        """Return "" once it is there, why it never will be, or None as long as it may."""
        if path.exists():
            return ""
        if failure.exists():
            return failure.read_text(encoding="utf-8")
        if agreed or stopped():
            raise StoppedError
        return None

    while (reason := on_first_rank(comm, look)) is None:
        time.sleep(_NAP_SECONDS)
        agreed = comm.allreduce(received(), MPI.MAX)
    if reason:
        raise ComputationError(reason)
    return map_pair(path, case, comm)


def write_pair(path: Path, case: Case, comm: MPI.Comm) -> None:
    """Assemble the pair of a case into a file, or leave the reason of a failure beside it.

    Collective on comm.

    Raises
    ------
    InputError : an option for PETSc.
    StorageError : the disk.
    """
    reason = ""
    try:
        with together(comm):
            stacked = to_stacked(assemble(case, comm))
    except InputError:
        raise
    except Exception as error:  # those who wait for it must hear of it
        reason = str(error) or repr(error)

    def write() -> None:
        content = io.BytesIO()  # to a disk, numpy.save does not tell why it fails
        if reason:
            content.write(reason.encode())
        else:
            np.save(content, stacked)
        try:
            with atomic_write(_reason_file(path) if reason else path) as temporary:
                temporary.write_bytes(content.getbuffer())
        except OSError as error:
            raise StorageError(f"{path}: {error.strerror or error}") from error

    on_first_rank(comm, write)


def _reason_file(path: Path) -> Path:
    """Return the file that says why there is no operator."""
    return path.with_suffix(".error")


def map_pair(path: Path, case: Case, comm: MPI.Comm) -> ContactPair:
    """Map the pair of a case from its file. Collective on comm.

    Raises
    ------
    StorageError : one of the ranks does not see the file, or not the whole of it.
    """
    with together(comm):
        stacked = _mapped(path)
    return from_stacked(case, stacked)


def _mapped(path: Path) -> FloatArray:
    """Return two stacked (n + 3, n) matrices; network disks show files late, and piece by piece."""
    limit = time.monotonic() + PATIENCE_SECONDS
    while True:
        try:
            stacked: FloatArray = np.load(path, mmap_mode="r")
            return stacked
        except (OSError, EOFError, ValueError) as error:
            if time.monotonic() > limit:
                raise StorageError(f"{path}: cannot be mapped: {error}") from error
        time.sleep(_NAP_SECONDS)
