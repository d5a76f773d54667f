"""Teams of ranks at work: cases are drawn, computed on the pair of their group, and stored."""

import logging
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import (
    ComputationError,
    InputError,
    RingwearError,
    UnfitError,
)
from ringwear_par.history.lockstep import must_run_alone
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.snapshots import Observer, Snapshot
from ringwear_par.options import reject_unused_options
from ringwear_par.parallel import on_first_rank, together
from ringwear_par.results.execution.progress import SweepProgress
from ringwear_par.results.execution.recorder import Recorder
from ringwear_par.results.execution.stopping import StopSignals
from ringwear_par.results.execution.watch import Watch
from ringwear_par.results.result import HistoryColumns, Result
from ringwear_par.results.storage.result_files import open_result, write_result
from ringwear_par.results.unit_suspicions import but_varied
from ringwear_par.studies.definition.texts import Texts
from ringwear_par.studies.execution.batches import PairResources, computed
from ringwear_par.studies.execution.operators import (
    StorageError,
    map_operator,
    reason_of_failure,
    write_operator,
)
from ringwear_par.studies.execution.plan import Plan
from ringwear_par.studies.execution.scheduling import Cases, Scheduler
from ringwear_par.studies.storage.blocks import Block
from ringwear_par.studies.storage.shards import Shard
from ringwear_par.version import __version__

log = logging.getLogger(__name__)

#: how long a team that waits for an operator sleeps between two looks, and between two questions
#: whether all are to stop
_NAP_SECONDS, _ASK_SECONDS = 0.01, 0.5
#: histories of more steps are computed alone, with checkpoints
LONG_STEPS = 20_000


@dataclass
class Timings:
    """Where a rank's time went, s, and what it did; flags of the cases that have some."""

    stepping: float = 0.0
    assembly: float = 0.0
    waiting: float = 0.0
    output: float = 0.0
    operators: int = 0
    worst: float = 0.0
    flagged: Counter[tuple[str, ...]] = field(default_factory=Counter)


def goes_with_others(case: Case) -> bool:
    """Tell whether a case is stepped side by side with others, if there are some or not."""
    return case.about_steps <= LONG_STEPS and not must_run_alone(case)


class Worker:
    """Where a team computes its cases: the contact pair in use, and its shard.

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
        self._saved: set[str] = set()  # cases that have left a checkpoint
        self._group = -1
        self._resources: PairResources | None = None

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
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
        if self._plan.cases_left:

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
            if not self._work(drawn):
                if first:
                    scheduler.ask_to_stop()
                return

    def _work(self, drawn: Cases) -> bool:
        """Compute some cases and store them, in blocks; tell whether all of them have ended.

        All ranks of the team go the same way.
        """
        group, first, count = drawn
        numbers = self._plan.todo[group][first : first + count]
        with together(self._team):
            cases, texts = self._plan.study.cases_and_texts(numbers)
        ids = [identity.decode() for identity in self._plan.study.identities[numbers]]
        try:
            resources = self._resources_of(group, first, cases[0])
        except _StoppedError:
            return False
        except StorageError:
            raise
        except ComputationError as error:  # the same for all of them
            recorder = Recorder(cases, self._team, stresses=lambda case: None, results=False)
            failures: dict[int, Exception] = dict.fromkeys(range(count), error)
            self._store(recorder.columns(failures), cases, ids, texts, 0.0)
            return True
        side_by_side: list[int] = []
        if self._team.size == 1:
            begun = self._plan.interrupted
            side_by_side = [
                i for i in range(count) if ids[i] not in begun and goes_with_others(cases[i])
            ]
        if side_by_side and not self._work_side_by_side(resources, side_by_side, cases, ids, texts):
            return False
        for i in sorted(set(range(count)) - set(side_by_side)):
            if self._stopping() or not self._work_alone(
                resources, cases[i], ids[i], texts.part([i])
            ):
                return False
        return True

    def _work_side_by_side(
        self,
        resources: PairResources,
        places: Sequence[int],
        cases: Sequence[Case],
        ids: Sequence[str],
        texts: Texts,
    ) -> bool:
        """Compute some cases of those drawn side by side, and store them in blocks; tell as above.

        Parameters
        ----------
        resources : of their pair.
        places : which.
        """

        def stop() -> bool:
            self._check_options()
            self._scheduler.serve()
            if self._progress is not None:
                self._progress()
            return bool(self._signals.received)

        before, ended = time.perf_counter(), 0
        chosen = [cases[i] for i in places]
        for block in computed(chosen, resources.pair, resources=resources, stop=stop):
            seconds = time.perf_counter() - before
            self._timings.stepping += seconds
            own = [places[number] for number in block.numbers]
            self._store(
                block.columns, [cases[i] for i in own], [ids[i] for i in own], texts.part(own),
                seconds,
            )  # fmt: skip
            ended += len(own)
            before = time.perf_counter()
        self._timings.stepping += time.perf_counter() - before
        return ended == len(places)

    def _work_alone(
        self, resources: PairResources, case: Case, identity: str, texts: Texts
    ) -> bool:
        """Compute a case by itself, with checkpoints, and store it; tell whether it has ended.

        All ranks of the team go the same way: what fails on one of them is raised on all.
        """
        begun, failures = time.perf_counter(), dict[int, Exception]()
        recorder = Recorder([case], self._team, self._stored(identity), stresses=resources.stresses)
        try:
            self._step(identity, case, resources.pair, recorder)
            if not recorder.finished:
                return False
        except (StorageError, KeyboardInterrupt):
            raise
        except Exception as error:  # of the solver, or of a law that is not ours
            if isinstance(error, InputError) and not isinstance(error, UnfitError):
                raise  # an option for PETSc, not the case
            failures[0] = error
        finally:
            self._timings.stepping += time.perf_counter() - begun
        self._store(
            recorder.columns(failures), [case], [identity], texts, time.perf_counter() - begun
        )
        return True

    def _stopping(self) -> bool:
        """Tell whether a signal has reached any rank of the team."""
        if self._team.size == 1:
            return bool(self._signals.received)
        return bool(self._team.allreduce(self._signals.received, MPI.MAX))

    def _store(
        self,
        columns: HistoryColumns,
        cases: Sequence[Case],
        ids: Sequence[str],
        texts: Texts,
        seconds: float,
    ) -> None:
        """Store cases that have ended in one piece, and count them.

        Parameters
        ----------
        seconds : that they took.
        """
        t0, varied = time.perf_counter(), self._plan.study.names
        both = zip(columns.flags, cases, strict=True)
        flags = tuple(but_varied(flags, case, varied) for flags, case in both)
        columns = replace(columns, flags=flags)
        block = Block.of_columns(columns, cases[0], ids, texts, __version__)
        self._timings.worst = max(self._timings.worst, float(columns.imbalance.max()))

        def add() -> None:
            assert self._shard is not None
            self._shard.add(block)
            for identity in block.ids:
                if identity in self._plan.in_flight or identity in self._saved:
                    self._plan.store.inflight(identity).unlink(missing_ok=True)
            self._timings.flagged.update(flags for flags in block.columns.flags if flags)

        on_first_rank(self._team, add)
        self._timings.output += time.perf_counter() - t0
        if self._team.rank == 0:
            failed = block.columns.status.count("failed")
            self._scheduler.count(len(block.ids) - failed, failed, seconds)

    def _step(
        self,
        identity: str,
        case: Case,
        pair: ContactPair,
        recorder: Recorder,
    ) -> None:
        """Step a case to its end, or to a checkpoint that is written when a signal stops it."""
        team, path = self._team, self._plan.store.inflight(identity)

        def save() -> None:
            result = recorder.result()
            self._saved.add(identity)
            on_first_rank(team, lambda: write_result(path, result))

        watch = Watch(self._signals, save, team)
        observers: list[Observer] = [
            recorder, self._check_options, watch, self._scheduler.serve,
        ]  # fmt: skip
        if self._progress is not None:
            observers.append(self._progress)
        simulate_one(case, team, pair=pair, start=recorder.start, observers=observers)
        if recorder.last is not None and not recorder.finished:
            try:
                save()
            except ComputationError as error:
                raise StorageError(str(error)) from error

    def _stored(self, identity: str) -> Result | None:
        """Return the checkpoint of an interrupted case; None where there is none."""
        if identity not in self._plan.interrupted:
            return None

        def read() -> Result | None:
            with suppress(InputError):
                return open_result(self._plan.store.inflight(identity))
            return None

        return on_first_rank(self._team, read)

    def _resources_of(self, group: int, place: int, case: Case) -> PairResources:
        """Return the pair of a group, with what its cases share."""
        if self._resources is None or group != self._group:
            self._resources = PairResources(self._find_operator(group, place, case), self._team)
            self._group = group
        return self._resources

    def _check_options(self, _: Snapshot | None = None) -> bool:
        """Refuse unused PETSc options, once: an observer, for cases that make their own solver."""
        if self._timings.operators and not self._options_checked:
            with together(self._team):
                reject_unused_options()
            self._options_checked = True
        return False

    def _find_operator(self, group: int, place: int, case: Case) -> ContactPair:
        """Return a group's operator: the team that has its first case provides it."""
        plan, team = self._plan, self._team
        if place == 0 and not plan.all_assemble:
            provide_operator(plan, group, team, self._timings)
        path, t0 = plan.store.operator(group), time.perf_counter()
        failure = reason_of_failure(path)
        received, asked = 0, 0.0

        def look() -> str | None:
            """Return "" once it is there, why it never will be, or None as long as it may."""
            if path.exists():
                return ""
            if failure.exists():
                return failure.read_text(encoding="utf-8")
            nonlocal asked
            if received:
                self._scheduler.ask_to_stop()
                raise _StoppedError
            if time.perf_counter() - asked > _ASK_SECONDS:
                asked = time.perf_counter()
                if self._scheduler.stopped:
                    raise _StoppedError
            self._scheduler.serve()
            if self._progress is not None:
                self._progress()
            return None

        while (reason := on_first_rank(team, look)) is None:
            time.sleep(_NAP_SECONDS)
            received = team.allreduce(self._signals.received, MPI.MAX)  # by any of its ranks
        if reason:
            raise ComputationError(reason)
        operator = map_operator(path, case, team)
        self._timings.waiting += time.perf_counter() - t0
        return operator


class _StoppedError(RingwearError):
    """Asked to stop while there was nothing to compute yet."""


def provide_operator(plan: Plan, group: int, comm: MPI.Comm, timings: Timings) -> None:
    """Assemble a group's operator into its file, or leave the reason of a failure. Collective."""
    t0 = time.perf_counter()
    write_operator(plan.store.operator(group), plan.study.case(int(plan.todo[group][0])), comm)
    timings.operators += 1
    timings.assembly += time.perf_counter() - t0
