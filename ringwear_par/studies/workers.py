"""Teams of ranks at work: a case is drawn, computed on the pair of its group, and stored."""

import logging
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol

from mpi4py import MPI

import ringwear_par
from ringwear_par.cases.case import Case
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.pair import ContactCompliance, ContactPair
from ringwear_par.errors import ComputationError, InputError, RingwearError, UnfitError
from ringwear_par.history.model import State, WearHistory, run
from ringwear_par.history.pairs import young
from ringwear_par.info import versions
from ringwear_par.options import reject_unused_options
from ringwear_par.parallel import PeerError, on_first_rank, together
from ringwear_par.results.doubts import Doubt, doubts, instability
from ringwear_par.results.files import Checkpoint, Recorder, read_checkpoint, write_result
from ringwear_par.results.progress import Monitor, StopSignals, SweepProgress
from ringwear_par.studies.operators import (
    StorageError,
    map_operator,
    reason_of_failure,
    write_operator,
)
from ringwear_par.studies.plan import Plan
from ringwear_par.studies.scheduling import Scheduler
from ringwear_par.studies.shards import Record, Shard

log = logging.getLogger(__name__)

#: how long a team that waits for an operator sleeps between two looks
_NAP_SECONDS = 0.002


class Watch(Protocol):
    """What happens between the steps of a case; see Monitor."""

    def __call__(self, state: State) -> bool:
        """Return whether to stop after this state. Collective."""

    def show(self, state: State) -> None:
        """Take a state within a step. Not collective."""

    def fail(self) -> None:
        """Tell the other ranks, which call this object, that this one has failed. Collective."""


def compute_case(
    history: WearHistory,
    recorder: Recorder,
    watch: Watch,
    comm: MPI.Comm,
    find_checkpoint: Callable[[], Checkpoint | None] = lambda: None,
) -> tuple[State, tuple[Doubt, ...]]:
    """Compute a case to its end, or until somebody says stop. Collective on comm.

    Parameters
    ----------
    history : of the case, on its pair.
    recorder : takes every state.
    watch : called with every new state, the first one excepted.
    find_checkpoint : returns where the case goes on; collective, called once.

    Returns
    -------
    The last state, and what makes it doubtful (nothing before the end of the case).

    Raises
    ------
    RingwearError : the case failed on one of the ranks; raised on all of them.
    """
    with together(comm):
        state = history.start()
    checkpoint = find_checkpoint()
    with together(comm):
        if checkpoint is None:
            recorder.add(state)
        else:
            state = checkpoint.state
            history.resume(state, checkpoint.warm)
            recorder.restore(checkpoint)
    with together(comm):
        try:
            state = run(history, state, watch, watch.show)
        except PeerError:
            raise
        except Exception:  # the others are on their way to the meeting after this step
            watch.fail()
            raise
    if not history.finished(state):
        return state, ()
    with together(comm):
        return state, (*instability(history), *doubts(history.case, history.pair, state))


@dataclass
class Timings:
    """Where a rank's time went, s, and what it did; flags of the cases that have some."""

    stepping: float = 0.0
    assembly: float = 0.0
    waiting: float = 0.0
    output: float = 0.0
    operators: int = 0
    worst: float = 0.0
    flagged: list[tuple[str, ...]] = field(default_factory=list)


class Worker:
    """Where a team computes its cases: the contact pair and solver in use, and its shard.

    A context manager; everything is collective on the team.

    Parameters
    ----------
    plan : of the sweep.
    number : of the team.
    scheduler : that cases are drawn from.
    signals : that ask to stop.
    progress : told of steps, on rank 0 of the sweep only.
    team : communicator.
    timings : where the time goes.
    """

    def __init__(
        self,
        plan: Plan,
        number: int,
        scheduler: Scheduler,
        signals: StopSignals,
        progress: SweepProgress | None,
        team: MPI.Comm,
        timings: Timings,
    ) -> None:
        self._plan, self._scheduler, self._signals = plan, scheduler, signals
        self._progress, self._team, self._timings = progress, team, timings
        self._path = plan.store.shard(number)
        self._shard: Shard | None = None
        self._options_checked = False
        self._group = -1
        self._operator: ContactPair | None = None
        self._setting: tuple[int, float, float] | None = None
        self._compliance: ContactCompliance | None = None
        self._solver: ContactSolver | None = None

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self._drop_solver()
        if self._shard is not None:
            self._shard.close()

    def work(self) -> None:
        """Draw and compute cases until none is left or somebody asks to stop.

        Raises
        ------
        ComputationError : a case could not be stored.
        InputError : an option for PETSc that nobody used.
        """
        team, scheduler, first = self._team, self._scheduler, self._team.rank == 0
        if any(self._plan.todo):

            def open_shard() -> None:
                self._shard = Shard(self._path)

            on_first_rank(team, open_shard)
        while True:
            drawn = None
            if first:
                if self._signals.received:
                    scheduler.ask_to_stop()
                drawn = scheduler.draw()
            if team.size > 1:
                drawn = team.bcast(drawn)
            if drawn is None:
                return
            record = self._computed(*drawn)
            if record is None:  # interrupted
                if first:
                    scheduler.ask_to_stop()
                return
            self._store(record)
            group = drawn[0]
            if first and scheduler.count(group, record.status == "failed"):
                self._plan.store.operator(group).unlink(missing_ok=True)

    def _store(self, record: Record) -> None:
        t0 = time.perf_counter()

        def add() -> None:
            assert self._shard is not None
            self._shard.add(record)
            self._plan.store.inflight(record.id).unlink(missing_ok=True)
            if record.flags:
                self._timings.flagged.append(record.flags)

        on_first_rank(self._team, add)
        self._timings.output += time.perf_counter() - t0

    def _computed(self, group: int, place: int) -> Record | None:
        """Return a case computed, or failed with its reason; None if it was interrupted.

        All ranks of the team go the same way: what fails on one of them is raised on all.
        """
        study, started = self._plan.study, time.perf_counter()
        number = self._plan.todo[group][place]
        identity, text = study.ids[number], ""
        recorder, version = None, ringwear_par.__version__
        try:
            with together(self._team):
                case = study.case(number)
                text = case.text
            solver = self._set_up(group, place, case)
            with together(self._team):
                assert self._compliance is not None
                history = WearHistory(case, self._compliance, solver)
                recorder = Recorder(history)
            begun = time.perf_counter()
            try:
                state, found = self._stepped(identity, history, solver, recorder)
            finally:
                self._timings.stepping += time.perf_counter() - begun
        except _StoppedError:
            return None
        except Exception as error:  # of the solver, or of a law that is not ours
            unfit = isinstance(error, UnfitError)
            if isinstance(error, StorageError | InputError) and not unfit:
                raise  # the disk, or an option for PETSc, not the case
            self._drop_solver()
            reason = str(error) if isinstance(error, RingwearError) else repr(error)
            arrays = recorder.arrays() if recorder is not None else {}
            seconds = time.perf_counter() - started
            reason = " ".join(reason.split())
            return Record(identity, text, "failed", reason, seconds, 0.0, arrays, version)
        if case.follows_wear:  # the solver's compliance is that of a worn shape
            self._drop_solver()
        if not history.finished(state):
            return None
        worst, flags = state.balances.worst, tuple(doubt.flag for doubt in found)
        self._timings.worst = max(self._timings.worst, worst)
        seconds = time.perf_counter() - started
        arrays = recorder.arrays()
        return Record(identity, text, "done", "", seconds, worst, arrays, version, flags)

    def _stepped(
        self, identity: str, history: WearHistory, solver: ContactSolver, recorder: Recorder
    ) -> tuple[State, tuple[Doubt, ...]]:
        """Run a history to its end, or to a checkpoint that is written when a signal stops it."""
        team, begun = self._team, time.perf_counter()

        def save(state: State) -> None:
            warm = solver.warm()
            attributes = {
                "status": "incomplete",
                "ranks": team.size,
                **versions(),
                "seconds_stepping": time.perf_counter() - begun,
                "imbalance": state.balances.worst,
            }
            path, line = self._plan.store.inflight(identity), history.pair.line
            on_first_rank(
                team,
                lambda: write_result(path, history.case, line, recorder, state, warm, attributes),
            )

        monitor = Monitor(history.finished, recorder, save, self._signals, team, self._progress)
        state, found = compute_case(
            history, recorder, monitor, team, lambda: self._checkpoint(identity)
        )
        if not history.finished(state):
            try:
                save(state)
            except ComputationError as error:
                raise StorageError(str(error)) from error
        return state, found

    def _checkpoint(self, identity: str) -> Checkpoint | None:
        if identity not in self._plan.interrupted:
            return None

        def read() -> Checkpoint | None:
            with suppress(OSError, KeyError, ValueError, RuntimeError):
                return read_checkpoint(self._plan.store.inflight(identity))[1]
            return None

        return on_first_rank(self._team, read)

    def _set_up(self, group: int, place: int, case: Case) -> ContactSolver:
        """Return a solver that starts cold, on the pair of this group and these moduli."""
        setting = group, *young(case)
        if self._solver is None or setting != self._setting:
            self._drop_solver()
            if group != self._group or self._operator is None:
                self._group, self._operator = -1, None
                self._operator = self._find_operator(group, place, case)
                self._group = group
            with together(self._team):
                self._compliance = self._operator.compliance(young(case))
            matrix, line = self._compliance.matrix, self._compliance.line
            self._solver = ContactSolver(matrix, line.area, self._team)
            self._setting = setting
            if self._timings.operators and not self._options_checked:
                with together(self._team):
                    reject_unused_options()  # by now everything has looked for its own
                self._options_checked = True
        self._solver.cold_start()
        return self._solver

    def _find_operator(self, group: int, place: int, case: Case) -> ContactPair:
        """Return a group's operator: the team that has its first case provides it."""
        plan, team = self._plan, self._team
        if place == 0 and not plan.all_assemble:
            provide_operator(plan, group, team, self._timings)
        path, t0 = plan.store.operator(group), time.perf_counter()
        failure = reason_of_failure(path)

        def wait() -> str:
            while not path.exists():
                if failure.exists():
                    return failure.read_text(encoding="utf-8")
                if self._signals.received:
                    self._scheduler.ask_to_stop()
                if self._scheduler.stopped:
                    raise _StoppedError
                if self._progress is not None:
                    self._progress()
                time.sleep(_NAP_SECONDS)
            return ""

        reason = on_first_rank(team, wait)
        if reason:
            raise ComputationError(reason)
        operator = map_operator(path, case, team)
        self._timings.waiting += time.perf_counter() - t0
        return operator

    def _drop_solver(self) -> None:
        if self._solver is not None:
            self._solver.destroy()
        self._solver = self._compliance = self._setting = None


class _StoppedError(RingwearError):
    """Asked to stop while there was nothing to compute yet."""


def provide_operator(plan: Plan, group: int, comm: MPI.Comm, timings: Timings) -> None:
    """Assemble a group's operator into its file, or leave the reason of a failure. Collective."""
    t0 = time.perf_counter()
    write_operator(plan.store.operator(group), plan.study.case(plan.todo[group][0]), comm)
    timings.operators += 1
    timings.assembly += time.perf_counter() - t0
