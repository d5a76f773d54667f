"""Teams of ranks at work: cases are drawn, computed on the pair of their group, and stored."""

import time

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.errors import ComputationError
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.parallel import together
from ringwear_par.results.progress import SweepProgress
from ringwear_par.results.result import HistoryColumns
from ringwear_par.results.signals import StopSignals
from ringwear_par.studies.execution.batches import PairResources, computed, failed_columns
from ringwear_par.studies.execution.case_queue import SharedQueue, Stretch
from ringwear_par.studies.execution.pairs import Pairs, pair_of
from ringwear_par.studies.execution.plan import CaseSet, Plan
from ringwear_par.studies.execution.single_cases import is_batchable, simulate_alone
from ringwear_par.studies.execution.summary import Timings
from ringwear_par.studies.execution.team_store import TeamStore


class Team:
    """Computes the cases that it draws; everything is collective on its communicator.

    ``progress`` is the bar of rank 0 of the sweep, ``pairs`` those of groups that all ranks have
    assembled; others are assembled here.
    """

    def __init__(
        self,
        plan: Plan,
        comm: MPI.Comm,
        queue: SharedQueue,
        store: TeamStore,
        signals: StopSignals,
        progress: SweepProgress | None,
        timings: Timings,
        pairs: Pairs,
    ) -> None:
        self._plan, self._comm, self._queue, self._store = plan, comm, queue, store
        self._signals, self._progress, self._timings = signals, progress, timings
        self._pairs = pairs
        self._group = -1
        self._resources: PairResources | None = None

    def work(self) -> None:
        """Draw and compute cases until none is left or somebody asks to stop."""
        comm, queue = self._comm, self._queue
        while True:
            drawn = None
            if comm.rank == 0:
                if self._signals.received:
                    queue.stop()
                drawn = queue.draw()
            if comm.size > 1:
                drawn = comm.bcast(drawn)
            if drawn is None:
                return
            if not self._compute(drawn):
                if comm.rank == 0:
                    queue.stop()
                return

    def _compute(self, stretch: Stretch) -> bool:
        """Compute some cases, store them in blocks; tell whether all have ended, to all ranks."""
        with together(self._comm):
            drawn = self._plan.cases(*stretch)
        try:
            resources = self._resources_of(stretch, drawn.cases[0])
        except ComputationError as error:  # the same for all of them
            self._add(failed_columns(drawn.cases, error, self._comm), drawn, 0.0)
            return True
        places: list[int] = []
        if self._comm.size == 1:
            begun, kind_cases = (
                self._plan.checkpoints,
                dict(zip(drawn.kinds, drawn.cases, strict=True)),
            )
            batchable = {kind for kind, case in kind_cases.items() if is_batchable(case)}
            cases = enumerate(zip(drawn.ids, drawn.kinds, strict=True))
            places = [i for i, (name, kind) in cases if kind in batchable and name not in begun]
        if places and not self._simulate_batched(resources, drawn.part(places)):
            return False
        for i in sorted(set(range(stretch.number)) - set(places)):
            if self._stopping() or not self._simulate_alone(resources, drawn.part([i])):
                return False
        return True

    def _simulate_batched(self, resources: PairResources, cases: CaseSet) -> bool:
        """Compute cases of a pair side by side, store them; tell whether all have ended."""

        def stop() -> bool:
            self._observe()
            return bool(self._signals.received)

        started, ended = time.perf_counter(), 0
        busy = time.process_time()  # neighbours on a machine make no case a longer one
        for block in computed(cases.cases, resources.pair, resources=resources, stop=stop):
            self._timings.stepping += time.perf_counter() - started
            seconds = time.process_time() - busy
            self._add(block.columns, cases.part(block.numbers), seconds)
            ended += len(block.numbers)
            started, busy = time.perf_counter(), time.process_time()
        self._timings.stepping += time.perf_counter() - started
        return ended == len(cases.cases)

    def _simulate_alone(self, resources: PairResources, case: CaseSet) -> bool:
        """Compute a case by itself, with checkpoints, and store it; tell whether it has ended."""
        started, signals, comm = time.perf_counter(), self._signals, self._comm
        # as in blocks; of more ranks, some of whose time is spent on each other, what has passed
        clock = time.process_time if comm.size == 1 else time.perf_counter
        begun = clock()
        try:
            columns = simulate_alone(
                case.cases[0], case.ids[0], resources, self._store, signals, [self._observe], comm
            )
        finally:
            self._timings.stepping += time.perf_counter() - started
        self._add(columns, case, clock() - begun)
        return columns.status != ("incomplete",)

    def _observe(self, _: Snapshot | None = None) -> bool:
        """Answer other ranks, show progress: an observer."""
        self._queue.serve()
        if self._progress is not None:
            self._progress()
        return False

    def _stopping(self) -> bool:
        """Tell whether a signal has reached any rank of the team."""
        if self._comm.size == 1:
            return bool(self._signals.received)
        return bool(self._comm.allreduce(self._signals.received, MPI.MAX))

    def _add(self, columns: HistoryColumns, cases: CaseSet, seconds: float) -> None:
        """Store cases that took so many seconds in one block, and count those that have ended."""
        t0 = time.perf_counter()
        columns = self._store.add(columns, cases)
        self._timings.output += time.perf_counter() - t0
        if columns.status == ("incomplete",):
            return
        self._timings.worst = max(self._timings.worst, float(columns.imbalance.max()))
        if self._comm.rank == 0:
            self._timings.flagged.update(flags for flags in columns.flags if flags)
            failed = columns.status.count("failed")
            self._queue.count(len(cases.ids) - failed, failed, seconds)

    def _resources_of(self, stretch: Stretch, case: Case) -> PairResources:
        """Return the pair of a group, with its stresses, or ComputationError for no such pair."""
        group = stretch.group
        if self._resources is None or group != self._group:
            pair = self._pairs.get(group)
            if pair is None:
                started = time.perf_counter()
                pair = pair_of(case, self._comm)
                self._timings.operators += stretch.first == 0
                self._timings.assembly += time.perf_counter() - started
            if isinstance(pair, ComputationError):
                raise pair
            self._resources, self._group = PairResources(pair, self._comm), group
        return self._resources
