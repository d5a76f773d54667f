"""What ranks do together: one acts for all, errors reach all alike."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from ringwear_par.errors import ComputationError, RingwearError

if TYPE_CHECKING:
    from mpi4py import MPI

log = logging.getLogger(__name__)
T = TypeVar("T")


class PeerError(ComputationError):
    """Another rank has failed; ``together`` raises its error in place of this one."""


def on_first_rank(comm: "MPI.Comm", action: Callable[[], T]) -> T:
    """Return what an action returns on rank 0, or raise its error, on all ranks. Collective."""
    result: Any = None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as error:
            if comm.size == 1 and not isinstance(error, RingwearError | OSError):
                raise
            result = _as_ours(error)
            if result is not error and not isinstance(error, OSError):
                log.exception("an error that should not be")
    result = comm.bcast(result)
    if isinstance(result, RingwearError):
        raise result
    return result


@contextmanager
def together(comm: "MPI.Comm") -> Iterator[None]:
    """Run a block on all ranks; if it fails on any of them, raise that error on all.

    Collective on comm. Of several errors that of the lowest rank is raised; one that is not ours
    reaches the others as a ComputationError. A rank that fails does not enter what is collective in
    the rest of the block: there must be nothing, or it must join the others there in its own way.
    """
    own: Exception | None = None
    try:
        yield
    except Exception as error:
        if comm.size == 1:
            raise
        own = error
    if comm.size > 1:
        every = [e for e in comm.allgather(own and _as_ours(own)) if e is not None]
        if every:
            every.sort(key=lambda error: isinstance(error, PeerError))  # consequences come last
            raise every[0] from own


def _as_ours(error: Exception) -> RingwearError:
    """Return an error that is told in one sentence, and may be sent to other ranks."""
    if isinstance(error, RingwearError):
        return error
    if isinstance(error, OSError):
        return ComputationError(f"{error.filename or 'output'}: {error.strerror or error}")
    return ComputationError(repr(error))
