"""What ranks do together: one acts for all, errors reach all alike."""

import errno
import logging
import os
import pickle
import resource
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar, cast

import numpy as np

from ringwear_par.arrays import BoolArray
from ringwear_par.errors import ComputationError, RingwearError

if TYPE_CHECKING:
    from mpi4py import MPI

log = logging.getLogger(__name__)
T = TypeVar("T")


def on_first_rank(comm: "MPI.Comm", action: Callable[[], T]) -> T:
    """Return the result of an action on rank 0, or raise its error, on all ranks. Collective.

    A result that cannot be sent to other ranks is an error, too.
    """
    if comm.size == 1:
        try:
            return action()
        except OSError as error:
            raise as_ours(error) from error
    packed = b""
    with together(comm):
        if comm.rank == 0:
            packed = pickle.dumps(action(), pickle.HIGHEST_PROTOCOL)
    packed = comm.bcast(packed)
    with together(comm):
        return cast(T, pickle.loads(packed))


def as_on_first_rank(comm: "MPI.Comm", value: T) -> T:
    """Return the value of rank 0 on all ranks. Collective; no message where a rank is alone."""
    return value if comm.size == 1 else comm.bcast(value)


def on_any_rank(comm: "MPI.Comm", which: BoolArray) -> BoolArray:
    """Return which are so on any of the ranks. Collective; no message where a rank is alone."""
    return which if comm.size == 1 else np.any(comm.allgather(which), axis=0)


class together:  # noqa: N801  (it reads as a word: with together(comm))
    """Run a block on all ranks; if it fails on any of them, raise that error on all.

    Collective on comm. Of several errors that of the lowest rank is raised; one that is not ours
    reaches the others as a RingwearError. Nothing in the rest of a block may wait for a rank that
    has failed in it. A class, as it is entered in every step of a history.
    """

    def __init__(self, comm: "MPI.Comm") -> None:
        self._comm = comm

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        comm = self._comm
        if comm.size == 1 or not (error is None or isinstance(error, Exception)):
            return
        from mpi4py import MPI

        failed = np.array([error is not None], dtype=np.int32)
        comm.Allreduce(MPI.IN_PLACE, failed, MPI.MAX)
        if failed[0]:
            errors = comm.allgather(None if error is None else as_ours(error))
            first = next(first for first in errors if first is not None)
            first.ranks = comm.size
            raise first from error


def as_ours(error: Exception) -> RingwearError:
    """Return an error of one sentence that can be sent to other ranks."""
    if isinstance(error, RingwearError):
        return error
    if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
        return RingwearError(f"not enough memory: {error}".rstrip(": "))
    if isinstance(error, OSError):
        return ComputationError(f"{error.filename or 'output'}: {error.strerror or error}")
    # no ComputationError, after which another step may be tried
    return RingwearError(f"{type(error).__name__}: {error}")


def blas_threads() -> int:
    """Return how many threads BLAS may use on this rank. Not collective."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    threads = next((int(os.environ[n]) for n in names if os.environ.get(n, "").isdigit()), None)
    return (os.cpu_count() or 1) if threads is None else threads


def warn_of_threads(ranks: int) -> None:
    """Warn where BLAS threads and ranks are more than the cores. On one rank."""
    cores, threads = os.cpu_count() or 1, blas_threads()
    if ranks > 1 and threads > 1 and threads * ranks > cores:
        log.warning(
            "%d ranks with up to %d BLAS threads each on %d cores: set OPENBLAS_NUM_THREADS=1",
            ranks, threads, cores,
        )  # fmt: skip


def peak_memory() -> float:
    """Return the most memory that this process has held, bytes. Not collective."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
