"""Searches side by side, and ranks together: who asks for histories, and who computes them.

Minimisers meet where they ask for histories, which one batch then computes. Each has a thread of
its own, as TAO asks by callbacks and does not let go; only one of them runs at a time, and always
in the same order, so that nothing depends on how threads are scheduled. What decides where
histories are wanted runs on the first rank alone, so that ranks cannot part ways; the others serve
it until it is done. Responses keep the readings of a search as long as it may ask for them.
"""

import pickle
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.errors import ComputationError, RingwearError
from ringwear_par.identification.definition.problem import Experiment, Problem
from ringwear_par.identification.model.histories import (
    ROUGH_STEPS,
    STEPS,
    Histories,
    HistoryError,
    Pair,
)
from ringwear_par.parallel import as_ours, together
from ringwear_par.results.execution.progress import Progress
from ringwear_par.results.execution.stop_signals import StopSignals, name_of

T = TypeVar("T")
#: pauses a job until the histories at a point are computed
WaitFor = Callable[[FloatArray], None]


class StoppedError(ComputationError):
    """A minimisation that was asked to stop."""


def side_by_side(
    jobs: Sequence[Callable[[WaitFor], T]], compute: Callable[[list[FloatArray]], Any]
) -> list[T]:
    """Return the results of jobs, each called with what it waits by for histories. Not collective.

    ``compute`` computes those at several points, and must keep them; its error ends all jobs, that
    of a job is raised once the others have ended. ComputationError where MPI allows no threads.
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
        #: whether it is to stop; points that it waits for, None at its end
        self._commands: SimpleQueue[bool] = SimpleQueue()
        self._requests: SimpleQueue[FloatArray | None] = SimpleQueue()
        #: the point that it waits for; None: it does not, or has ended
        self.point: FloatArray | None = None
        self._outcome: T | BaseException = StoppedError("not begun")
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def go(self, stopped: bool = False) -> None:
        """Let it run to its next point, or to its end."""
        self._commands.put(stopped)
        self.point = self._requests.get()
        if self.point is None:
            self._thread.join()

    def result(self) -> T:
        """Return its result, or raise its error."""
        if isinstance(self._outcome, BaseException):
            raise self._outcome
        return self._outcome

    def _run(self) -> None:
        self._commands.get()
        try:
            self._outcome = self._job(self._wait_for)
        except BaseException as error:
            self._outcome = error
        self._requests.put(None)

    def _wait_for(self, point: FloatArray) -> None:
        self._requests.put(point)
        if self._commands.get():
            raise StoppedError("stopped")


class Rounds(Histories):
    """Histories that all ranks compute together while the first one leads. Collective to make.

    Signals on any rank end a job before its next round; ``hint`` returns what is added to that
    sentence.
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
        self._progress: Progress | None = None
        # ranks take experiments with operators of their own, each of which costs a batch
        self._order = self.operators.order

    def lead(self, job: Callable[[], T]) -> T:
        """Return the result of a job of the first rank. Collective.

        Raises StoppedError by a signal, and what the job or the histories of any rank raise.
        """
        comm = self._comm
        content = b""
        with together(comm):
            if comm.rank == 0:
                self._leads = True
                try:
                    with closing(Progress(pause=0.0)) as self._progress:
                        content = pickle.dumps(job(), pickle.HIGHEST_PROTOCOL)
                finally:
                    self._leads, self._progress = False, None
                    comm.bcast(None)
            else:
                while (request := comm.bcast(None)) is not None:
                    method, arguments = request
                    getattr(self, method)(*arguments)
        with together(comm):
            answer: T = pickle.loads(comm.bcast(content))
        if received := comm.allreduce(self._signals.received, MPI.MAX):
            raise self._stopped(received)
        return answer

    def tell(self, state: str) -> None:
        """Tell the user, now and then, what the job of the first rank is at. Not collective."""
        if self._progress is not None:
            self._progress.show(self.count, "%s, %d histories", state, self.count)

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
        _, request = self._comm.bcast(("_share", (points, order, steps, derivatives, exact)))
        responses = dict(zip(request[1], self._share(*request), strict=True))
        self.count = count
        return [responses[pair] for pair in pairs]

    def change_cases(self, experiments: tuple[Experiment, ...]) -> None:
        """Take the experiments with other cases, on all ranks where this one leads."""
        if not self._leads:
            return super().change_cases(experiments)
        self._comm.bcast(("_change", (experiments,)))
        return self._change(experiments)

    def _share(
        self, points: FloatArray, pairs: Sequence[Pair], *how: Any
    ) -> list[FloatArray | HistoryError]:
        """Return to the first rank what it asks, of which each computes a share. Collective."""
        rank, size = self._comm.rank, self._comm.size
        share = pairs[rank * len(pairs) // size : (rank + 1) * len(pairs) // size]
        read = partial(super().read, points, share, *how)
        parts = self._of_all(lambda: read() if share and not self._signals.received else [])
        return [response for part in parts for response in part]

    def _change(self, experiments: tuple[Experiment, ...]) -> None:
        """Take the experiments with other cases. Collective."""
        self._of_all(partial(super().change_cases, experiments))

    def _of_all(self, action: Callable[[], T]) -> list[T]:
        """Return the outcomes of an action on all ranks, or raise their error: on the first rank.

        The others go on to serve, as the first one ends the job. Collective.
        """
        outcome: Any = None
        error: Exception | None = None
        try:
            outcome = action()
        except Exception as failure:
            error = failure if self._comm.size == 1 else as_ours(failure)
        gathered = self._comm.gather((outcome, self._signals.received, error))
        if gathered is None:
            return []
        if received := max(number for _, number, _ in gathered):
            raise self._stopped(received)
        for _, _, failed in gathered:
            if failed is not None:
                raise failed
        return [outcome for outcome, _, _ in gathered]

    def _stopped(self, received: int) -> StoppedError:
        return StoppedError(f"stopped by {name_of(received)}{self._hint()}")


class Responses:
    """Readings of a problem's tests and their derivatives, one history a test.

    Points are unknowns of the fitted keys, or of these and the nuisances. ``stored`` holds readings
    with derivatives (n, 1 + m), or why there are none, by the test's number and the bytes of the
    values; histories make about ``steps``, on operators that are ``exact`` or, in a search,
    interpolated.
    """

    def __init__(self, problem: Problem, histories: Histories) -> None:
        self._problem = problem
        self._engines: Histories | None = histories
        self.steps, self.exact = STEPS, True
        self.stored: dict[tuple[int, bytes], FloatArray | HistoryError] = {}

    @property
    def _histories(self) -> Histories:
        if self._engines is None:
            raise RingwearError(
                "a result of a fit keeps the readings at its estimate only, and computes none "
                "elsewhere: fit again, or run the case with other values"
            )
        return self._engines

    def _values(self, point: FloatArray) -> FloatArray:
        return self._problem.values(point[: len(self._problem.parameters)])

    def allowed(self, points: FloatArray) -> BoolArray:
        """Return at which points (p, m) all rules of the laws hold, (p,)."""
        return self._histories.allowed(np.array([self._values(point) for point in points]))

    def compute(self, points: Sequence[FloatArray]) -> None:
        """Have the histories at points computed together, and keep them. Not collective."""
        tests = range(len(self._problem.experiments))
        self.prepare([(test, v) for v in map(self._values, points) for test in tests])

    def prepare(self, requests: Sequence[tuple[int, FloatArray]]) -> None:
        """Have the histories of tests at values of the keys computed together, and keep them."""
        new = {(test, v.tobytes()): v for test, v in requests}
        new = {key: v for key, v in new.items() if key not in self.stored}
        values = list({v.tobytes(): v for v in new.values()}.values())
        numbers = {v.tobytes(): i for i, v in enumerate(values)}
        pairs = [(numbers[content], test) for test, content in new]
        if pairs:
            responses = self._histories.read(np.array(values), pairs, self.steps, exact=self.exact)
            self.stored.update(zip(new, responses, strict=True))

    def are_computed(self, point: FloatArray) -> bool:
        """Tell whether the histories at a point were computed."""
        return (0, self._values(point).tobytes()) in self.stored

    def of_tests(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the readings of all tests and derivatives by the values (m,) of each, (n, 1 + m).

        Raises HistoryError where there is no history.
        """
        requests = list(enumerate(values))
        self.prepare(requests)
        responses = []
        for test, test_values in requests:
            response = self.stored[test, test_values.tobytes()]
            if isinstance(response, HistoryError):
                raise response
            responses.append(response)
        return np.concatenate(responses)

    def in_shorter_steps(self, values: FloatArray) -> FloatArray | HistoryError:
        """Return the readings (n,) of all tests in steps half as long, or why there are none."""
        (finer,) = self._histories.responses(values[None], 2 * self.steps, derivatives=False)
        return finer if isinstance(finer, HistoryError) else finer[:, 0]

    def forget(self, points: Sequence[FloatArray], but: FloatArray) -> None:
        """Forget the histories at points, but for those at one."""
        past = {self._values(point).tobytes() for point in points} - {self._values(but).tobytes()}
        for key in [key for key in self.stored if key[1] in past]:
            del self.stored[key]

    def keep_only(self, values: Sequence[FloatArray]) -> None:
        """Keep the readings at values of each test, and no engines. Not collective."""
        self.of_tests(values)
        self._engines = None
        remaining = {(test, test_values.tobytes()) for test, test_values in enumerate(values)}
        self.stored = {key: response for key, response in self.stored.items() if key in remaining}

    def renew_inputs(self, values: FloatArray) -> tuple[Experiment, ...]:
        """Return the tests, friction as torques tell it at values (m,); histories are theirs."""
        self.stored = {}
        return self._histories.renew_inputs(values)

    def refine(self) -> None:
        """Have histories make twice as many steps from now on."""
        self.steps *= 2
        self.stored = {}

    def be_exact(self, exact: bool) -> None:
        """Have histories on exact operators from now on, or rough ones: interpolated, few steps."""
        if exact != self.exact:
            self.steps = STEPS if exact else ROUGH_STEPS
            self.exact, self.stored = exact, {}
