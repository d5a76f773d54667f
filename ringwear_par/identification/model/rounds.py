"""Searches side by side, and ranks together: who asks for histories, and who computes them.

Minimisers meet where they ask for histories, which one batch then computes. Each has a thread of
its own, as TAO asks by callbacks and does not let go; only one of them runs at a time, and always
in the same order, so that nothing depends on how threads are scheduled. What decides where
histories are wanted runs on the first rank alone, so that ranks cannot part ways; the others serve
it until it is done.
"""

import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import Experiment, Problem
from ringwear_par.identification.model.histories import STEPS, Histories, HistoryError, Pair
from ringwear_par.parallel import as_ours, together
from ringwear_par.results.execution.progress import FitProgress
from ringwear_par.results.execution.stop_signals import StopSignals, name_of, remark

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


@dataclass(frozen=True)
class Renewed:
    """What the first rank tells the others of cases that have changed."""

    experiments: tuple[Experiment, ...]


class Rounds(Histories):
    """Histories that all ranks compute together while the first one leads.

    Making one is collective on comm.

    Parameters
    ----------
    problem : the problem.
    comm : of the ranks.
    signals : that end a job before its next round, on whichever rank they come.
    hint : returns what is added to the sentence that says so.
    """

    def __init__(
        self,
        problem: Problem,
        comm: MPI.Intracomm,
        signals: StopSignals,
        hint: Callable[[], str] = str,
    ) -> None:
        with together(comm):
            super().__init__(problem, comm)
        self._comm, self._signals, self._hint = comm, signals, hint
        self._leads = False
        self._progress: FitProgress | None = None
        # ranks take experiments with operators of their own, each of which costs a batch
        self._order = self.operators.order

    def lead(self, job: Callable[[], T]) -> T:
        """Return the result of a job of the first rank. Collective.

        Raises
        ------
        StoppedError : a signal.
        RingwearError : of the job, or of the histories of any rank.
        """
        comm = self._comm
        result = None
        with together(comm):
            if comm.rank == 0:
                self._leads = True
                try:
                    with closing(FitProgress()) as self._progress:
                        result = job()
                finally:
                    self._leads, self._progress = False, None
                    comm.bcast(None)
            else:
                while (request := comm.bcast(None)) is not None:
                    if isinstance(request, Renewed):
                        self.change_cases(request.experiments)
                    else:
                        self._share(*request)
        answer: T = comm.bcast(result)
        if received := comm.allreduce(self._signals.received, MPI.MAX):
            raise self._stopped(received)
        return answer

    def tell(self, state: str) -> None:
        """Tell the user, now and then, what the job of the first rank is at. Not collective."""
        if self._progress is not None:
            self._progress.tell(state)

    def read(
        self,
        points: FloatArray,
        pairs: Sequence[Pair],
        steps: int = STEPS,
        derivatives: bool = True,
        exact: bool = True,
    ) -> list[FloatArray | HistoryError]:
        """Return them, computed by all ranks where this one leads; else by itself."""
        if not self._leads:
            return super().read(points, pairs, steps, derivatives, exact)
        count = self.count + len(pairs)
        order = sorted(pairs, key=lambda p: (self._order[p[1]], p[1]))
        request = points, order, steps, derivatives, exact
        responses = dict(self._share(*self._comm.bcast(request)))
        self.count = count
        if self._progress is not None:
            self._progress(count)
        return [responses[pair] for pair in pairs]

    def renew_inputs(self, values: FloatArray) -> tuple[Experiment, ...]:
        """Return the experiments with other friction, on all ranks where this one leads."""
        experiments = super().renew_inputs(values)
        if self._leads:
            self._comm.bcast(Renewed(experiments))
        return experiments

    def _share(
        self,
        points: FloatArray,
        pairs: Sequence[Pair],
        steps: int,
        derivatives: bool,
        exact: bool,
    ) -> list[tuple[Pair, FloatArray | HistoryError]]:
        """Compute this rank's share of what the first one asks, which is told all. Collective."""
        rank, size = self._comm.rank, self._comm.size
        share = pairs[rank * len(pairs) // size : (rank + 1) * len(pairs) // size]
        responses: list[FloatArray | HistoryError] = []
        error: Exception | None = None
        try:
            if share and not self._signals.received:
                responses = super().read(points, share, steps, derivatives, exact)
        except Exception as failure:
            error = failure if self._comm.size == 1 else as_ours(failure)
        parts = list(zip(share, responses, strict=False))
        gathered = self._comm.gather((parts, self._signals.received, error))
        if gathered is None:
            return []
        if received := max(number for _, number, _ in gathered):
            raise self._stopped(received)
        for _, _, failed in gathered:
            if failed is not None:
                raise failed
        return [entry for part, _, _ in gathered for entry in part]

    def _stopped(self, received: int) -> StoppedError:
        return StoppedError(f"stopped by {name_of(received)}{self._hint()}{remark(received)}")
