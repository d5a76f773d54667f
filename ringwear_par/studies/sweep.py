"""``ringwear sweep``: every case of a study, on all ranks, never lost.

Teams of ranks draw cases from a board. An operator is assembled once for all the cases that share
it, put into a file, and mapped by every team that needs it, so that a node holds it once; the file
goes with the group's last case. What is done is in the team's shard before the next case is drawn.
"""

import logging
import resource
import signal
import time
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.cases.text import toml_text
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.assembly import load_kernels
from ringwear_par.elasticity.pair import ContactCompliance, ContactPair
from ringwear_par.errors import ComputationError, InputError, RingwearError, UnfitError
from ringwear_par.history.limits import memory_needed
from ringwear_par.history.model import State, WearHistory, run
from ringwear_par.history.pairs import assemble, operator_key, young
from ringwear_par.info import versions
from ringwear_par.options import reject_unused_options
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.checkpoints import restored, take
from ringwear_par.results.files import open_result, write_result
from ringwear_par.results.progress import Monitor, StopSignals, SweepProgress, duration
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import Result
from ringwear_par.results.run import warn_of_threads
from ringwear_par.studies.dataset import RESULTS, TABLE, Row, read_ensemble, write_ensemble
from ringwear_par.studies.designs import Study, read_study
from ringwear_par.studies.scheduling import Scheduler
from ringwear_par.studies.shards import Entry, Record, Shard, locked
from ringwear_par.studies.store import Store

log = logging.getLogger(__name__)

#: how long a team that waits for an operator, or for the others, sleeps between two looks
_NAP_SECONDS = 0.002
#: memory of a rank without its matrices (Python, MPI, PETSc, compiled code), for estimates
_BARE_BYTES = 250e6
#: longest trial of a dry run
_TRIAL_SECONDS = 20.0


@dataclass(frozen=True)
class Plan:
    """What is to be done, the same on all ranks.

    Parameters
    ----------
    study : the study.
    store : its folder.
    todo : for each group of the study, its cases that are to be computed here.
    interrupted : ids of cases that go on from a checkpoint.
    done, failed, total : cases of this study, or slice, that have ended before; and in all.
    together : whether all ranks assemble each operator (there are fewer than teams) or the team
        that takes its group.
    ranks_per_case : size of the teams.
    """

    study: Study
    store: Store
    todo: tuple[tuple[int, ...], ...]
    interrupted: frozenset[str]
    done: int
    failed: int
    total: int
    together: bool
    ranks_per_case: int


@dataclass
class Timings:
    """Where a team's time went, s, and what it did."""

    stepping: float = 0.0
    assembly: float = 0.0
    waiting: float = 0.0
    output: float = 0.0
    operators: int = 0
    worst: float = 0.0


def run_sweep(
    path: Path,
    folder: Path,
    ranks_per_case: int,
    part: tuple[int, int] | None,
    dry_run: bool,
    retry_failed: bool,
    comm: MPI.Intracomm,
) -> int:
    """Run, or go on with, a study; return the exit status. Collective on comm.

    Parameters
    ----------
    path : study file.
    folder : of the results.
    ranks_per_case : size of the teams; must divide the number of ranks.
    part : which slice, and of how many; None for the whole, which merges.
    dry_run : only say what there is to do.
    retry_failed : compute failed cases again.

    Raises
    ------
    InputError : the study, the folder or the numbers, before any work.
    ComputationError : cases failed, the sweep was stopped, or the disk.
    """
    started = time.perf_counter()
    m = ranks_per_case
    if m < 1 or comm.size % m:
        sizes = ", ".join(str(d) for d in range(1, comm.size + 1) if comm.size % d == 0)
        raise InputError(
            f"--ranks-per-case {m}: {comm.size} ranks do not divide into teams of {m}; must be one "
            f"of {sizes}"
        )
    teams = comm.size // m
    with ExitStack() as held:
        plan: Plan = on_first_rank(
            comm, lambda: _prepare(path, folder, m, teams, part, dry_run, retry_failed, held)
        )
        team = comm.Split(comm.rank // m, comm.rank)
        try:
            if dry_run:
                _estimate(plan, m, comm)
                return 0
            if comm.rank == 0:
                warn_of_threads(comm.size)
                held_back = plan.done + plan.failed
                if held_back:
                    log.info("%d of %d cases are there already", held_back, plan.total)
            return _compute(plan, started, comm, team)
        finally:
            team.Free()


def _prepare(
    path: Path,
    folder: Path,
    ranks_per_case: int,
    teams: int,
    part: tuple[int, int] | None,
    dry_run: bool,
    retry_failed: bool,
    held: ExitStack,
) -> Plan:
    """Read the study and look what is done. On one rank, which keeps the lock in ``held``."""
    study = read_study(path, ranks_per_case)
    store = Store(folder, f"{part[0]}-{part[1]}" if part else "")
    entries: dict[str, Entry] = {}
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; must be a folder, or a new name")
    if not dry_run:
        store.open()
        held.enter_context(locked(folder, store.part))
        store.clear()
        entries, notes = store.scan(mend=True)
        for note in notes:
            log.warning("%s", note)
    elif (folder / "shards").is_dir() or (folder / RESULTS).exists():
        with locked(folder, store.part):
            entries, _ = store.scan(mend=False)
    mine = _slice(study, part)
    ended = {"done"} if retry_failed else {"done", "failed"}
    status = [entries[i].status if i in entries else "" for i in study.ids]
    todo = tuple(
        tuple(n for n in group if n in mine and status[n] not in ended) for group in study.groups
    )
    done = sum(status[n] == "done" for n in mine)
    failed = 0 if retry_failed else sum(status[n] == "failed" for n in mine)
    interrupted = frozenset(i for i in study.ids if store.inflight(i).exists())
    return Plan(
        study, store, todo, interrupted, done, failed, len(mine), len(study.groups) <= teams,
        ranks_per_case,
    )  # fmt: skip


def _slice(study: Study, part: tuple[int, int] | None) -> set[int]:
    """Return the cases of a slice: a stretch of the groups, by estimated work."""
    order = [n for group in study.groups for n in group]
    if part is None:
        return set(order)
    work = np.concatenate(
        [
            study.work[list(group)] + assembly / len(group)
            for group, assembly in zip(study.groups, study.assembly, strict=True)
        ]
    )
    middle = (np.cumsum(work) - 0.5 * work) / work.sum()
    number = np.minimum((middle * part[1]).astype(int), part[1] - 1)
    return {n for n, s in zip(order, number.tolist(), strict=True) if s == part[0] - 1}


def _compute(plan: Plan, started: float, comm: MPI.Intracomm, team: MPI.Comm) -> int:
    load_kernels(comm)
    tally = Timings()
    if plan.together:
        for group, cases in enumerate(plan.todo):
            if cases:
                _provide_operator(plan, group, comm, tally)
        comm.Barrier()
    board = Scheduler([len(cases) for cases in plan.todo], comm)
    trouble: RingwearError | None = None
    with StopSignals() as signals, ExitStack() as at_end:
        progress = None
        if comm.rank == 0:
            progress = SweepProgress(plan.done, plan.failed, plan.total, board.ended, comm)
            at_end.callback(progress.close)
        try:
            with Worker(
                plan, comm.rank // team.size, board, signals, progress, team, tally
            ) as bench:
                bench.work()
        except RingwearError as error:
            trouble = error
            board.ask_to_stop()
        _gather(comm, board, signals, progress)
        done, failed = board.ended()
        board.destroy()
        troubles = [error for error in comm.allgather(trouble) if error is not None]
        received = max(comm.allgather(signals.received))
        counts = plan.done + done, plan.failed + failed, plan.total
        if not troubles and not plan.store.part:
            on_first_rank(comm, lambda: _merge(plan, counts, done + failed, comm.size))
    tallies = comm.gather(tally)
    peak = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, MPI.MAX)
    if tallies is not None:
        wall = time.perf_counter() - started
        print(_summary(plan, counts, done + failed, wall, tallies, peak / 1024.0))
    return _end(plan, counts, troubles, received, comm)


def _gather(
    comm: MPI.Intracomm, board: Scheduler, signals: StopSignals, progress: SweepProgress | None
) -> None:
    """Wait for the other teams, asleep, not spinning. Collective."""
    request = comm.Ibarrier()
    while not request.Test():
        if signals.received and not board.stopped:
            board.ask_to_stop()
        if progress is not None:
            progress()
        time.sleep(_NAP_SECONDS)


def _end(
    plan: Plan,
    counts: tuple[int, int, int],
    troubles: list[RingwearError],
    received: int,
    comm: MPI.Intracomm,
) -> int:
    """Say in one sentence what is wrong, if anything. Collective on comm."""
    done, failed, total = counts
    folder = plan.store.folder
    ended = f"{done + failed} of {total} cases are stored"
    if troubles:
        if isinstance(troubles[0], InputError):
            raise troubles[0]
        raise ComputationError(f"{troubles[0]}; {ended}, and the same command goes on")
    if done + failed < total:
        on_first_rank(comm, lambda: plan.store.stopped.touch())
        name = signal.Signals(received).name if received else "a team"
        raise ComputationError(
            f"stopped by {name}, incomplete: {ended}, and the same command goes on"
        )
    if failed:
        where = folder / TABLE
        told = f"{where} says why of each" if not plan.store.part else "merging tells why"
        raise ComputationError(f"{failed} of {total} cases failed; {told}")
    return 0


class Worker:
    """Where a team computes its cases: the contact pair and solver in use, and its shard.

    A context manager; everything is collective on the team.

    Parameters
    ----------
    plan : of the sweep.
    number : of the team.
    board : that cases are drawn from.
    signals : that ask to stop.
    progress : told of steps, on rank 0 of the sweep only.
    team : communicator.
    tally : where the time goes.
    """

    def __init__(
        self,
        plan: Plan,
        number: int,
        board: Scheduler,
        signals: StopSignals,
        progress: SweepProgress | None,
        team: MPI.Comm,
        tally: Timings,
    ) -> None:
        self._board = board
        self._plan, self._signals, self._progress, self._team = plan, signals, progress, team
        self._tally = tally
        self._path = plan.store.shard(number)
        self._shard: Shard | None = None
        self._options_checked = False
        self._group = -1
        self._operator: ContactPair | None = None
        self._setting: tuple[int, float, float] | None = None
        self._pair: ContactCompliance | None = None
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
        team, board, first = self._team, self._board, self._team.rank == 0
        if any(self._plan.todo):

            def open_shard() -> None:
                self._shard = Shard(self._path)

            on_first_rank(team, open_shard)
        while True:
            drawn = None
            if first:
                if self._signals.received:
                    board.ask_to_stop()
                drawn = board.draw()
            if team.size > 1:
                drawn = team.bcast(drawn)
            if drawn is None:
                return
            record = self._computed(*drawn)
            if record is None:  # interrupted
                if first:
                    board.ask_to_stop()
                return
            self._store(record)
            group = drawn[0]
            if first and board.count(group, record.status == "failed"):
                self._plan.store.operator(group).unlink(missing_ok=True)

    def _store(self, record: Record) -> None:
        t0 = time.perf_counter()

        def add() -> None:
            assert self._shard is not None
            self._shard.add(record)
            self._plan.store.inflight(record.id).unlink(missing_ok=True)

        on_first_rank(self._team, add)
        self._tally.output += time.perf_counter() - t0

    def _computed(self, group: int, place: int) -> Record | None:
        """Return a case computed, or failed with its reason; None if it was interrupted."""
        study, started = self._plan.study, time.perf_counter()
        number = self._plan.todo[group][place]
        identity, text = study.ids[number], ""
        history = recorder = None
        try:
            case = study.case(number)
            text = case.text
            solver = self._set_up(group, place, case)
            assert self._pair is not None
            history = WearHistory(case, self._pair, solver)
            recorder = Recorder(history)
            begun = time.perf_counter()
            try:
                interrupted, worst = self._stepped(identity, history, solver, recorder)
            finally:
                self._tally.stepping += time.perf_counter() - begun
        except _StoppedError:
            return None
        except Exception as error:  # of the solver, or of a law that is not ours
            unfit = isinstance(error, UnfitError)
            if isinstance(error, _StorageError | InputError) and not unfit:
                raise  # the disk, or an option for PETSc, not the case
            self._drop_solver()
            reason = str(error) if isinstance(error, RingwearError) else repr(error)
            arrays = recorder.arrays() if recorder is not None else {}
            seconds = time.perf_counter() - started
            reason = " ".join(reason.split())
            return Record(identity, text, "failed", reason, seconds, 0.0, arrays)
        if case.follows_wear:  # the solver's compliance is that of a worn shape
            self._drop_solver()
        if interrupted:
            return None
        self._tally.worst = max(self._tally.worst, worst)
        seconds = time.perf_counter() - started
        return Record(identity, text, "done", "", seconds, worst, recorder.arrays())

    def _stepped(
        self, identity: str, history: WearHistory, solver: ContactSolver, recorder: Recorder
    ) -> tuple[bool, float]:
        """Run a history; return whether a signal interrupted it, and its worst balance."""
        team = self._team
        begun = time.perf_counter()
        state = history.start()
        stored = self._stored(identity)
        if stored is None:
            recorder.add(state)
        else:
            state, warm = restored(stored)
            history.resume(state, warm)
            recorder.restore(stored)

        def save(state: State) -> None:
            warm = solver.warm()
            attributes = {
                "status": "incomplete",
                "ranks": team.size,
                **versions(),
                "seconds_stepping": time.perf_counter() - begun,
                "imbalance": state.balances.worst,
            }
            path = self._plan.store.inflight(identity)
            checkpoint = take(state, warm, recorder.pending_iterations)
            result = recorder.result(attributes, asdict(state.balances), checkpoint)
            on_first_rank(team, lambda: write_result(path, result))

        monitor = Monitor(history.finished, recorder, save, self._signals, team, self._progress)
        state = run(history, state, monitor, monitor.show)
        if not history.finished(state):
            try:
                save(state)
            except ComputationError as error:
                raise _StorageError(str(error)) from error
            return True, state.balances.worst
        return False, state.balances.worst

    def _stored(self, identity: str) -> Result | None:
        if identity not in self._plan.interrupted:
            return None

        def read() -> Result | None:
            with suppress(InputError):
                return open_result(self._plan.store.inflight(identity))
            return None

        return on_first_rank(self._team, read)

    def _set_up(self, group: int, place: int, case: Case) -> ContactSolver:
        """Return a solver that starts cold, on the pair of this group and these moduli."""
        setting = group, case.lower.young, case.upper.young
        if self._solver is None or setting != self._setting:
            self._drop_solver()
            if group != self._group or self._operator is None:
                self._group, self._operator = -1, None
                self._operator = self._find_operator(group, place, case)
                self._group = group
            self._pair = self._operator.compliance(young(case))
            self._solver = ContactSolver(self._pair.matrix, self._pair.line.area, self._team)
            self._setting = setting
            if self._tally.operators and not self._options_checked:
                reject_unused_options()  # by now everything has looked for its own
                self._options_checked = True
        self._solver.cold_start()
        return self._solver

    def _find_operator(self, group: int, place: int, case: Case) -> ContactPair:
        """Return a group's operator: the team that has its first case provides it."""
        plan, team = self._plan, self._team
        if place == 0 and not plan.together:
            _provide_operator(plan, group, team, self._tally)
        path, t0 = plan.store.operator(group), time.perf_counter()
        failure = path.with_suffix(".error")

        def wait() -> str:
            while not path.exists():
                if failure.exists():
                    return failure.read_text(encoding="utf-8")
                if self._signals.received:
                    self._board.ask_to_stop()
                if self._board.stopped:
                    raise _StoppedError
                if self._progress is not None:
                    self._progress()
                time.sleep(_NAP_SECONDS)
            return ""

        reason = on_first_rank(team, wait)
        if reason:
            raise ComputationError(reason)
        self._tally.waiting += time.perf_counter() - t0
        return _load_operator(path, case)

    def _drop_solver(self) -> None:
        if self._solver is not None:
            self._solver.destroy()
        self._solver = self._pair = self._setting = None


class _StorageError(ComputationError):
    """The disk; not the fault of a case."""


class _StoppedError(RingwearError):
    """Asked to stop while there was nothing to compute yet."""


def _provide_operator(plan: Plan, group: int, comm: MPI.Comm, tally: Timings) -> None:
    """Assemble a group's operator into its file, or leave the reason of a failure. Collective."""
    t0 = time.perf_counter()
    path, reason, stacked = plan.store.operator(group), "", None
    try:
        operator = assemble(plan.study.case(plan.todo[group][0]), comm)
        rest = (operator.twist, operator.force_reaction, operator.torque_reaction)
        stacked = np.concatenate([operator.normal, np.stack(rest, axis=1)], axis=1)
    except InputError:
        raise
    except Exception as error:  # those who wait for it must hear of it
        reason = str(error) or repr(error)

    def write() -> None:
        temporary = path.with_suffix(".tmp")
        try:
            if stacked is None:
                temporary.write_text(reason, encoding="utf-8")
                temporary.replace(path.with_suffix(".error"))
            else:
                with temporary.open("wb") as file:
                    np.save(file, stacked)
                temporary.replace(path)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise _StorageError(f"{path}: {error.strerror or error}") from error

    on_first_rank(comm, write)
    tally.operators += 1
    tally.assembly += time.perf_counter() - t0


def _load_operator(path: Path, case: Case) -> ContactPair:
    """Map a file of two stacked (n + 3, n) matrices; a node holds it once."""
    stacked = np.load(path, mmap_mode="r")
    n = stacked.shape[2]
    parts = stacked[:, :n], stacked[:, n], stacked[:, n + 1], stacked[:, n + 2]
    return ContactPair(case.line, *parts, operator_key(case))


def _merge(plan: Plan, counts: tuple[int, int, int], computed: int, ranks: int) -> None:
    """Write results.h5 and cases.csv of all that is stored, then drop the shards. On one rank."""
    study, store = plan.study, plan.store
    if not computed and (store.folder / RESULTS).exists():
        ranks = int(read_ensemble(store.folder).attributes["ranks"])
    entries, _ = store.scan(mend=True)
    rows = [
        Row(
            identity,
            study.rows[n],
            "" if identity in entries else toml_text(study.keys(n)),
            True,
            entries.get(identity),
        )
        for n, identity in enumerate(study.ids)
    ]
    here = set(study.ids)
    rows += [Row(i, None, "", False, entry) for i, entry in entries.items() if i not in here]
    complete = sum(counts[:2]) == counts[2]
    attributes = {
        "status": "complete" if complete else "incomplete",
        "study": study.text,
        "method": study.method,
        "ranks": ranks,
        **versions(),
    }
    write_ensemble(store.folder, study.names, rows, store.fetch, attributes)
    store.forget_shards()


def _summary(
    plan: Plan,
    counts: tuple[int, int, int],
    computed: int,
    wall: float,
    tallies: list[Timings],
    peak: float,
) -> str:
    """Return the end of a sweep in a few lines."""
    done, failed, total = counts
    ranks = len(tallies)

    def share(name: str) -> str:
        return f"{100.0 * sum(getattr(t, name) for t in tallies) / (wall * ranks):.1f} % {name}"

    sharing = ranks if plan.together else plan.ranks_per_case
    operators = sum(t.operators for t in tallies) // sharing
    part = plan.store.part
    lines = [
        f"cases{f' of slice {part}' if part else ''}: {total}, {done} done, {failed} failed, "
        f"{total - done - failed} not done; operators assembled: {operators}"
    ]
    if computed:
        known = ("stepping", "assembly", "waiting", "output")
        rest = wall * ranks - sum(getattr(t, name) for t in tallies for name in known)
        lines += [
            f"{computed} computed in {duration(wall)}, ranks: {ranks}: {computed / wall:.3g} a "
            f"second, {computed / wall / ranks:.3g} a rank; peak memory of a rank {peak:.0f} MB",
            f"time of the ranks: {', '.join(map(share, known))}, "
            f"{100.0 * rest / (wall * ranks):.1f} % start and merging",
        ]
    worst = max(t.worst for t in tallies)
    if worst > 0.0:
        lines.append(f"worst balance (force, volume, energy, KKT) of these cases: {worst:.1e}")
    if part:
        lines.append("the same command without --slice computes what is left and merges all slices")
    else:
        lines.append(f"{plan.store.folder / TABLE}, {plan.store.folder / RESULTS}")
    return "\n".join(lines)


def _estimate(plan: Plan, ranks_per_case: int, comm: MPI.Intracomm) -> None:
    """Say what there is to do, and how long it will take by a timed first case. Collective."""
    load_kernels(comm)
    if comm.rank > 0:
        return
    study, teams = plan.study, comm.size // ranks_per_case
    left = [group for group, cases in enumerate(plan.todo) if cases]
    print(f"{plan.total} cases, {plan.done} done, {plan.failed} failed before")
    print(f"{len(study.groups)} distinct operator(s), {len(left)} still needed")
    if not left:
        return
    group, number = left[0], plan.todo[left[0]][0]
    case = study.case(number)
    t0 = time.perf_counter()
    operator = assemble(case, MPI.COMM_SELF)
    t1 = time.perf_counter()
    pair = operator.compliance(young(case))
    with ContactSolver(pair.matrix, pair.line.area, MPI.COMM_SELF) as solver:
        history = WearHistory(case, pair, solver)
        recorder = Recorder(history)
        state = history.start()
        recorder.add(state)
        t2 = time.perf_counter()

        def watch(state: State) -> bool:
            recorder.add(state)  # adaptive steps grow: what the first ones take says little
            return not case.time.adaptive and time.perf_counter() - t2 > _TRIAL_SECONDS

        state = run(history, state, watch)
    t3 = time.perf_counter()
    stepping = (t3 - t2) * case.time.end / state.time
    assembly = (t1 - t0) * study.assembly[left].sum() / study.assembly[group]
    cases = [n for g in left for n in plan.todo[g]]
    steps = stepping * study.work[cases].sum() / study.work[number]
    tables = (*recorder.histories.values(), *recorder.profiles.values())
    size = sum(table.nbytes for table in tables)
    memory = _BARE_BYTES + max(
        memory_needed(study.case(plan.todo[g][0]), ranks_per_case) for g in left
    )
    print(
        f"first case timed on one rank: {t1 - t0:.3g} s for its operator, {stepping:.3g} s for its "
        f"{case.time.scheme} steps" + (" (from the first of them)" if not history.finished(state)
        else "")
    )  # fmt: skip
    print(
        f"estimate for {len(cases)} cases on {comm.size} rank(s): "
        f"{duration((assembly + steps) / teams)}, about {memory / 1e6:.0f} MB a rank, "
        f"{size * len(cases) / 1e6:.3g} MB on disk"
    )
