"""What ranks do together: one acts for all, errors reach all alike."""

import logging
from collections.abc import Callable
from typing import Any, TypeVar

from mpi4py import MPI

from ringwear_par.errors import ComputationError, RingwearError

log = logging.getLogger(__name__)
T = TypeVar("T")


def on_first_rank(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Return what an action returns on rank 0, or raise its error, on all ranks. Collective."""
    result: Any = None
    if comm.rank == 0:
        try:
            result = action()
        except RingwearError as error:
            result = error
        except OSError as error:
            result = ComputationError(f"{error.filename or 'output'}: {error.strerror or error}")
        except Exception as error:
            if comm.size == 1:
                raise
            # the other ranks wait to hear of it
            log.exception("an error that should not be")
            result = ComputationError(f"{type(error).__name__}: {error}")
    result = comm.bcast(result)
    if isinstance(result, RingwearError):
        raise result
    return result
