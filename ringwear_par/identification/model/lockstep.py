"""Minimisers side by side: they meet where they ask for histories, which one batch then computes.

Each has a thread of its own, as TAO asks by callbacks and does not let go; only one of them runs at
a time, and always in the same order, so that nothing depends on how threads are scheduled.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError

T = TypeVar("T")
#: pauses a job until the histories at a point are computed
WaitFor = Callable[[FloatArray], None]


class StoppedError(ComputationError):
    """A minimisation that was asked to stop."""


def side_by_side(
    jobs: Sequence[Callable[[WaitFor], T]], compute: Callable[[list[FloatArray]], Any]
) -> list[T]:
    """Return the results of jobs. Not collective.

    Parameters
    ----------
    jobs : each is given a function to be called before it needs the histories at a point.
    compute : computes those at several points; must keep them.

    Raises
    ------
    ComputationError : MPI may not be called from threads.
    Exception : of ``compute``, which ends all jobs; or of a job, once the others have ended.
    """
    if MPI.Query_thread() < MPI.THREAD_SERIALIZED:
        raise ComputationError(
            "MPI: fits ask for histories from threads, one at a time, which this MPI was started "
            "not to allow: MPI_THREAD_SERIALIZED or more is needed (MPI4PY_RC_THREAD_LEVEL)"
        )
    workers = [_Worker(job) for job in jobs]
    for worker in workers:
        worker.go()
    while waiting := [worker for worker in workers if worker.point is not None]:
        try:
            compute([worker.point for worker in waiting if worker.point is not None])
        except BaseException:
            for worker in waiting:
                worker.go(stopped=True)
            raise
        for worker in waiting:
            worker.go()
    return [worker.result() for worker in workers]


class _Worker(Generic[T]):
    """A job in its thread, which runs between ``go`` and the return of ``go``."""

    def __init__(self, job: Callable[[WaitFor], T]) -> None:
        self._job = job
        self._may_run, self._has_paused = threading.Semaphore(0), threading.Semaphore(0)
        self._stopped = False
        #: the point that it waits for; None: it does not, or has ended
        self.point: FloatArray | None = None
        self._outcome: T | BaseException = StoppedError("not begun")
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def go(self, stopped: bool = False) -> None:
        """Let it run to its next point, or to its end."""
        self._stopped, self.point = stopped, None
        self._may_run.release()
        self._has_paused.acquire()
        if self.point is None:
            self._thread.join()

    def result(self) -> T:
        """Return its result, or raise its error."""
        if isinstance(self._outcome, BaseException):
            raise self._outcome
        return self._outcome

    def _run(self) -> None:
        self._may_run.acquire()
        try:
            self._outcome = self._job(self._wait_for)
        except BaseException as error:
            self._outcome = error
        finally:
            self._has_paused.release()

    def _wait_for(self, point: FloatArray) -> None:
        self.point = point
        self._has_paused.release()
        self._may_run.acquire()
        if self._stopped:
            raise StoppedError("stopped")
