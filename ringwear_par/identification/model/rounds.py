"""Rounds of histories: the first rank asks, all ranks compute.

What decides where histories are wanted runs on the first rank alone, so that ranks cannot part
ways; the others serve it until it is done.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from typing import TypeVar

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.model.histories import Histories, Pair
from ringwear_par.identification.model.lockstep import StoppedError
from ringwear_par.parallel import as_ours, together
from ringwear_par.results.execution.progress import FitProgress
from ringwear_par.results.execution.stopping import StopSignals, name_of, remark

T = TypeVar("T")


class Rounds(Histories):
    """Histories that all ranks compute together while the first one leads.

    Making one is collective on comm.

    Parameters
    ----------
    problem : the problem.
    comm : of the ranks.
    signals : that end a job before its next round, on whichever rank they come.
    hint : what is added to the sentence that says so.
    """

    def __init__(
        self, problem: Problem, comm: MPI.Intracomm, signals: StopSignals, hint: str = ""
    ) -> None:
        with together(comm):
            super().__init__(problem, comm)
        self._comm, self._signals, self._hint = comm, signals, hint
        self._leads = False
        self._progress: FitProgress | None = None
        # ranks take experiments with operators of their own, each of which costs a batch
        owners = list(self._pairs)
        self._order = [owners.index(owner) for owner in self._owners]

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
                    self._share(*request)
        answer: T = comm.bcast(result)
        if received := comm.allreduce(self._signals.received, MPI.MAX):
            raise self._stopped(received)
        return answer

    def tell(self, state: str) -> None:
        """Tell the user, now and then, what the job of the first rank is at. Not collective."""
        if self._progress is not None:
            self._progress.tell(state)

    def _read(
        self, points: FloatArray, pairs: Sequence[Pair], steps: int, derivatives: bool
    ) -> list[FloatArray | ComputationError]:
        """Return them, computed by all ranks where this one leads; else by itself."""
        if not self._leads:
            return super()._read(points, pairs, steps, derivatives)
        count = self.count + len(pairs)
        request = points, sorted(pairs, key=lambda p: (self._order[p[1]], p[1])), steps, derivatives
        responses = dict(self._share(*self._comm.bcast(request)))
        self.count = count
        if self._progress is not None:
            self._progress(count)
        return [responses[pair] for pair in pairs]

    def _share(
        self, points: FloatArray, pairs: Sequence[Pair], steps: int, derivatives: bool
    ) -> list[tuple[Pair, FloatArray | ComputationError]]:
        """Compute this rank's share of what the first one asks, which is told all. Collective."""
        rank, size = self._comm.rank, self._comm.size
        share = pairs[rank * len(pairs) // size : (rank + 1) * len(pairs) // size]
        responses: list[FloatArray | ComputationError] = []
        error: Exception | None = None
        try:
            if share and not self._signals.received:
                responses = super()._read(points, share, steps, derivatives)
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
        return StoppedError(f"stopped by {name_of(received)}{self._hint}{remark(received)}")
