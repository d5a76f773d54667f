"""``ringwear sweep``: every case of a study, on all ranks, never lost.

Teams of ranks draw cases from a scheduler. An operator is assembled once for all the cases that
share it, put into a file, and mapped by every team that needs it, so that a node holds it once; the
file goes with the group's last case. What is done is in the team's shard before the next case is
drawn.
"""

import logging
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.elasticity.stress.recovery import load_stress_kernels
from ringwear_par.errors import ComputationError, InputError, RingwearError
from ringwear_par.files.writing import atomic_write
from ringwear_par.parallel import on_first_rank, peak_memory, warn_of_threads
from ringwear_par.results.execution.progress import SweepProgress
from ringwear_par.results.execution.stopping import StopSignals, name_of, remark
from ringwear_par.results.storage.hdf5 import UnreadableError
from ringwear_par.studies.definition.study import Study, read_study_together
from ringwear_par.studies.execution.estimate import estimate
from ringwear_par.studies.execution.operators import PATIENCE_SECONDS, StorageError
from ringwear_par.studies.execution.plan import Plan, Request, make_plan
from ringwear_par.studies.execution.scheduling import Scheduler
from ringwear_par.studies.execution.summary import Summary
from ringwear_par.studies.execution.workers import Timings, Worker, provide_operator
from ringwear_par.studies.storage.dataset import Listing, write_ensemble
from ringwear_par.studies.storage.ensemble import read_ensemble
from ringwear_par.studies.storage.index import DamagedError, Index
from ringwear_par.studies.storage.results_file import RESULTS, TABLE
from ringwear_par.studies.storage.store import reporting_unreadable
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: how long between two looks for what another machine has stored
_LATE_SECONDS = 0.2

Source = Study | Path | str | Mapping[str, Any]


def sweep(
    study: Source,
    folder: Path | str,
    comm: MPI.Intracomm | None = None,
    *,
    ranks_per_case: int = 1,
    part: tuple[int, int] | None = None,
    retry_failed: bool = False,
    mix_versions: bool = False,
) -> Summary:
    """Compute every case of a study, or go on with it. Collective on comm.

    Parameters
    ----------
    study : read already, or as ``read_study`` takes it; the same on all ranks.
    folder : of the results; made if it is not there.
    comm : communicator, the world's where none is given.
    ranks_per_case : size of the teams; must divide the number of ranks.
    part : which slice, and of how many; None for the whole, which merges.
    retry_failed : compute failed cases again.
    mix_versions : go on where another version of ringwear-par has computed cases.

    Raises
    ------
    InputError : the study, the folder or the numbers, before any work.
    ComputationError : cases failed, the sweep was stopped, or the disk.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    request = Request(Path(folder), comm.size, ranks_per_case, part, retry_failed, mix_versions)
    summary, trouble = _swept(study, request, comm)
    if trouble is not None:
        raise trouble
    return summary


def run_sweep(
    study: Source,
    folder: Path | str,
    comm: MPI.Intracomm,
    *,
    ranks_per_case: int = 1,
    part: tuple[int, int] | None = None,
    retry_failed: bool = False,
    mix_versions: bool = False,
    dry_run: bool = False,
) -> None:
    """Do as ``sweep`` and print what was done, or in a dry run what would be.

    Collective on comm.
    """
    request = Request(Path(folder), comm.size, ranks_per_case, part, retry_failed, mix_versions)
    if dry_run:
        told = estimate(_planned(study, request, comm, None), comm)
        if comm.rank == 0:
            print(told)
        return
    summary, trouble = _swept(study, request, comm)
    if comm.rank == 0:
        print(summary)
    if trouble is not None:
        raise trouble


def _planned(source: Source, request: Request, comm: MPI.Intracomm, held: ExitStack | None) -> Plan:
    """Read the study and look what is done of it. Collective; rank 0 keeps the lock in ``held``."""
    request.check()
    m = request.ranks_per_case
    read = source if isinstance(source, Study) else read_study_together(source, m, comm)

    def plan() -> Plan:
        assert read is not None
        return make_plan(read, request, held)

    return on_first_rank(comm, plan)


def _swept(
    source: Source, request: Request, comm: MPI.Intracomm
) -> tuple[Summary, RingwearError | None]:
    """Return what was done, and in one sentence what is wrong, if anything. Collective."""
    started = time.perf_counter()
    with ExitStack() as held:
        plan = _planned(source, request, comm, held)
        if comm.rank == 0:
            warn_of_threads(comm.size)
            there = plan.done + plan.failed
            if there:
                log.info("%d of %d cases are there already", there, plan.total)
            left = plan.in_flight - plan.interrupted
            todo = plan.study.identities[plan.todo.cases] if left else ()
            anew = sum(identity.decode() in left for identity in todo)
            if anew:
                log.warning("%d interrupted cases of another version start anew", anew)
        team = comm.Split(comm.rank // request.ranks_per_case, comm.rank)
        try:
            return _compute(plan, started, comm, team)
        finally:
            team.Free()


def _compute(
    plan: Plan, started: float, comm: MPI.Intracomm, team: MPI.Comm
) -> tuple[Summary, RingwearError | None]:
    load_kernels(comm)
    if plan.cases_left and plan.study.case(int(plan.todo.cases[0])).stress is not None:
        load_stress_kernels(comm)
    timings = Timings()
    if plan.all_assemble:
        _assemble_all(plan, comm, timings)

    def group_ended(group: int) -> None:
        with suppress(OSError):  # or else at the end
            plan.store.operator(group).unlink()

    work, todo = plan.study.work, plan.todo
    seconds = [float(work[todo[group][:1]].sum()) for group in range(len(todo))]
    scheduler = Scheduler(todo.sizes, comm, plan.request.teams, seconds, group_ended)
    trouble: RingwearError | None = None
    with StopSignals() as signals, ExitStack() as at_end:
        progress = None
        if comm.rank == 0:
            progress = SweepProgress(plan.done, plan.failed, plan.total, scheduler.ended)
            at_end.callback(progress.close)
        number = comm.rank // team.size
        try:
            with Worker(plan, number, scheduler, signals, progress, team, timings) as worker:
                worker.work()
        except RingwearError as error:
            trouble = error
            scheduler.ask_to_stop()

        def meanwhile() -> None:
            if signals.received:
                scheduler.ask_to_stop()
            if progress is not None:
                progress()

        scheduler.wait_for_all(meanwhile)
        done, failed = comm.bcast(scheduler.ended())
        scheduler.destroy()
        troubles = [error for error in comm.allgather(trouble) if error is not None]
        received = max(comm.allgather(signals.received))
        every = tuple(comm.allgather(timings))
        summary = Summary(
            plan.request.folder,
            plan.store.part,
            plan.total,
            plan.done + done,
            plan.failed + failed,
            done + failed,
            sum(t.operators for t in every) // (comm.size if plan.all_assemble else team.size),
            0.0,
            1e-6 * comm.allreduce(peak_memory(), MPI.MAX),
            every,
            sum((t.flagged for t in every), plan.flagged),
        )
        counted = summary.done, summary.failed
        try:
            done, failed = on_first_rank(comm, lambda: _settle(plan, summary, not troubles))
            merged = not troubles and not plan.store.part
            summary = replace(summary, done=done, failed=failed, merged=merged)
        except RingwearError as error:  # of the disk
            troubles.append(error)
    summary = replace(summary, seconds=time.perf_counter() - started)
    return summary, _trouble(plan, summary, counted, troubles, received, comm)


def _assemble_all(plan: Plan, comm: MPI.Intracomm, timings: Timings) -> None:
    """Provide all operators, by all ranks. Collective."""
    try:
        for group in plan.left:
            provide_operator(plan, group, comm, timings)
    except StorageError as error:
        on_first_rank(comm, plan.store.drop_operators)
        ended = f"{plan.done + plan.failed} of {plan.total} cases are stored"
        raise ComputationError(f"{error}; {ended}, and the same command goes on") from error
    comm.Barrier()


def _trouble(
    plan: Plan,
    summary: Summary,
    counted: tuple[int, int],
    troubles: list[RingwearError],
    received: int,
    comm: MPI.Intracomm,
) -> RingwearError | None:
    """Return in one sentence what is wrong, if anything, the same on all ranks. Collective.

    Parameters
    ----------
    counted : cases done and failed, of which ``summary`` says how many are stored.
    """
    ended = f"{summary.done + summary.failed} of {summary.total} cases are stored"
    if troubles:
        if isinstance(troubles[0], InputError):
            return troubles[0]
        if comm.rank == 0:  # beside results of an earlier study, which look complete
            with suppress(OSError), atomic_write(plan.store.stopped):
                pass
        return ComputationError(f"{troubles[0]}; {ended}, and the same command goes on")
    stopped = summary.computed < plan.cases_left
    if stopped:
        on_first_rank(comm, lambda: _mark(plan.store.stopped))
    stored = summary.done, summary.failed
    # what failed before and is stored still must not make up for what is lost
    lost = max(counted[0] - stored[0], sum(counted) - sum(stored))
    if lost > 0:
        return ComputationError(
            f"{summary.folder}: {lost} of {sum(counted)} cases that have ended are not stored any "
            f"more (files in {summary.folder / 'shards'} were removed or damaged); {ended}, and "
            "the same command computes the others again"
        )
    if stopped:
        name = name_of(received) if received else "a team"
        return ComputationError(
            f"stopped by {name}, incomplete: {ended}, and the same command goes on"
            f"{remark(received)}"
        )
    if summary.failed:
        where = summary.folder / TABLE
        told = f"{where} says why of each" if not plan.store.part else "merging tells why"
        return ComputationError(f"{summary.failed} of {summary.total} cases failed; {told}")
    return None


def _mark(path: Path) -> None:
    """Make an empty file in place of whatever has its name, or say why it cannot be."""
    try:
        with atomic_write(path):
            pass
    except OSError as error:
        log.warning("%s: cannot be written: %s", path, error.strerror)


@reporting_unreadable()
def _settle(plan: Plan, summary: Summary, well: bool) -> tuple[int, int]:
    """Merge if all is well and this is no slice; return what is stored, done and failed.

    On one rank.

    Raises
    ------
    RingwearError, OSError : the disk.
    """
    with suppress(OSError):
        plan.store.drop_operators()
    if not well:
        with suppress(RingwearError, OSError):  # there is trouble enough to tell
            return plan.count(plan.store.scan(plan.study.identities, mend=False)[0])
        return summary.done, summary.failed
    awaited = summary.done + summary.failed
    while True:
        index = _scan(plan, awaited)
        try:
            if not plan.store.part:
                _merge(plan, summary, index)
        except DamagedError as error:
            log.warning("%s", plan.store.mend(error.path))
            awaited = 0  # what was in it will not come to light
            continue
        return plan.count(index)


def _scan(plan: Plan, awaited: int) -> Index:
    """Return what is stored; if that is less than awaited, network disks may show it late."""
    limit = time.monotonic() + PATIENCE_SECONDS
    while True:
        index, notes = plan.store.scan(plan.study.identities, mend=True)
        for note in notes:
            log.warning("%s", note)
        if notes or sum(plan.count(index)) >= awaited or time.monotonic() > limit:
            return index
        time.sleep(_LATE_SECONDS)


def _merge(plan: Plan, summary: Summary, index: Index) -> None:
    """Write results.h5 and cases.csv of all that is stored, then drop the shards. On one rank.

    Raises
    ------
    DamagedError, UnreadableError : one of the files that are read.
    OSError : the disk.
    """
    study, store, ranks = plan.study, plan.store, len(summary.timings)
    if not summary.computed and (store.folder / RESULTS).exists():
        try:
            ranks = int(read_ensemble(store.folder).attributes["ranks"])
        except UnreadableError:
            raise
        except InputError as error:
            raise DamagedError(store.folder / RESULTS) from error
    entry = index.find(study.identities)
    others = np.ones(len(index), dtype=bool)
    others[entry[entry >= 0]] = False
    gone = np.flatnonzero(others)
    listing = Listing(
        study.names,
        study.cases.columns,
        np.concatenate([study.identities, index["id"][gone]]),
        np.arange(len(entry) + len(gone)) < len(entry),
        index,
        np.concatenate([entry, gone]),
        study.texts,
    )
    ended = sum(plan.count(index))
    complete = ended == summary.total and summary.computed == plan.cases_left
    attributes = {
        "status": "complete" if complete else "incomplete",
        "study": study.text,
        "method": study.method,
        "ranks": ranks,
        **versions(),
    }
    write_ensemble(store.folder, listing, attributes)
    if ended >= summary.done + summary.failed:  # else they may yet come to light
        store.forget_shards()
