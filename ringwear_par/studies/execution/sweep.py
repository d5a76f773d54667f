"""``ringwear sweep``: every case of a study, on all ranks, never lost.

Teams of ranks draw cases from a queue. An operator is assembled for all the cases that share it: by
all ranks where there are fewer than teams, else by the team that needs it. Cases that have ended
are in the team's shard before the next are drawn.
"""

import logging
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ringwear_par.errors import RingwearError
from ringwear_par.parallel import (
    on_first_rank,
    peak_memory,
    together,
    warn_of_threads,
    with_help_of_all,
)
from ringwear_par.results.execution.progress import SweepProgress
from ringwear_par.results.execution.stop_signals import StopSignals
from ringwear_par.studies.definition.study import Study, read_study_together
from ringwear_par.studies.execution.batches import block_size
from ringwear_par.studies.execution.case_queue import SharedQueue
from ringwear_par.studies.execution.estimate import estimate
from ringwear_par.studies.execution.merging import merge_if_well
from ringwear_par.studies.execution.pairs import pair_of
from ringwear_par.studies.execution.plan import Plan, Request, make_plan
from ringwear_par.studies.execution.single_cases import is_batchable
from ringwear_par.studies.execution.summary import Summary, Timings, mark_stopped, trouble_of
from ringwear_par.studies.execution.team_store import TeamStore
from ringwear_par.studies.execution.teams import Team

log = logging.getLogger(__name__)

Source = Study | Path | str | Mapping[str, Any]


def sweep(
    study: Source,
    folder: Path | str,
    comm: MPI.Intracomm | None = None,
    *,
    ranks_per_case: int = 1,
    part: tuple[int, int] | None = None,
    retry_failed: bool = False,
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

    Returns
    -------
    Summary : how many cases are ``total``, ``done`` and ``failed``; the rest is in the folder.

    Raises
    ------
    InputError : the study, the folder or the numbers, before any work.
    ComputationError : cases failed, the sweep was stopped, or the disk.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> vary = {"load.pressure": {"values": [60, 80]}}
    >>> rw.sweep({"case": "scripts/cases/paper.toml", "vary": vary}, "out").done
    2
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    request = Request(Path(folder), comm.size, ranks_per_case, part, retry_failed)
    summary, trouble = _sweep(study, request, comm)
    with together(comm):
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
    dry_run: bool = False,
) -> None:
    """Sweep and print the summary, or in a dry run an estimate. Collective on comm."""
    request = Request(Path(folder), comm.size, ranks_per_case, part, retry_failed)
    if dry_run:
        text = estimate(_plan(study, request, comm, None), comm)
        if comm.rank == 0:
            print(text)
        return
    summary, trouble = _sweep(study, request, comm)
    if comm.rank == 0:
        print(summary)
    with together(comm):
        if trouble is not None:
            raise trouble


def _plan(source: Source, request: Request, comm: MPI.Intracomm, locks: ExitStack | None) -> Plan:
    """Read the study and look which cases are stored. Collective; rank 0 has the ``locks``."""
    request.check()
    m = request.ranks_per_case
    study = source if isinstance(source, Study) else read_study_together(source, m, comm)

    def plan() -> Plan:
        assert study is not None
        return make_plan(study, request, locks)

    return on_first_rank(comm, plan)


def _sweep(
    source: Source, request: Request, comm: MPI.Intracomm
) -> tuple[Summary, RingwearError | None]:
    """Return the summary, and in one sentence what is wrong, if anything. Collective."""
    started = time.perf_counter()
    with ExitStack() as locks:
        plan = _plan(source, request, comm, locks)
        if comm.rank == 0:
            warn_of_threads(comm.size)
            stored = plan.done + plan.failed
            if stored:
                log.info("%d of %d cases are there already", stored, plan.total)
        team = comm.Split(comm.rank // request.ranks_per_case, comm.rank)
        try:
            return _compute(plan, started, comm, team)
        finally:
            team.Free()


def _compute(
    plan: Plan, started: float, comm: MPI.Intracomm, team: MPI.Comm
) -> tuple[Summary, RingwearError | None]:
    timings, begun = Timings(), time.perf_counter()
    left = plan.left
    groups = left if plan.all_assemble else []
    pairs = {group: pair_of(plan.first_case(group), comm) for group in groups}
    timings.operators = len(pairs)
    timings.assembly = time.perf_counter() - begun
    work, todo = plan.study.work, plan.todo
    seconds = [float(work[todo[group][:1]].sum()) for group in range(len(todo))]
    # the first group decides for all: cases of others are read as they are drawn
    first = plan.first_case(left[0]) if team.size == 1 and left else None
    block = block_size(first) if first is not None and is_batchable(first) else 1
    queue = SharedQueue(todo.sizes, comm, plan.request.teams, seconds, block)
    trouble: RingwearError | None = None
    with StopSignals() as signals, ExitStack() as at_end:
        progress = None
        if comm.rank == 0:
            progress = SweepProgress(plan.done, plan.failed, plan.total, queue.ended)
            at_end.callback(progress.close)
        try:
            with TeamStore(plan, comm.rank // team.size, team) as store:
                Team(plan, team, queue, store, signals, progress, timings, pairs).work()
        except RingwearError as error:
            trouble = error
            queue.stop()

        def meanwhile() -> None:
            if signals.received:
                queue.stop()
            if progress is not None:
                progress()

        queue.wait_for_all(meanwhile)
        done, failed = comm.bcast(queue.ended())
        queue.destroy()
        troubles = [error for error in comm.allgather(trouble) if error is not None]
        received = max(comm.allgather(signals.received))
    rank_timings = tuple(comm.allgather(timings))
    summary = Summary(
        plan.request.folder,
        plan.folder.part,
        plan.total,
        plan.done + done,
        plan.failed + failed,
        done + failed,
        len(pairs) or sum(t.operators for t in rank_timings) // team.size,
        0.0,
        1e-6 * comm.allreduce(peak_memory(), MPI.MAX),
        rank_timings,
        sum((t.flagged for t in rank_timings), plan.flagged),
    )
    counted = summary.done, summary.failed
    try:
        done, failed = with_help_of_all(
            comm, lambda: merge_if_well(plan, summary, not troubles, comm)
        )
        merged = not troubles and not plan.folder.part
        summary = replace(summary, done=done, failed=failed, merged=merged)
    except RingwearError as error:  # of the disk
        troubles.append(error)
    except KeyboardInterrupt:  # nothing is lost: shards go once all is merged
        if comm.rank == 0:
            mark_stopped(plan.folder.stopped)
        raise
    summary = replace(summary, seconds=time.perf_counter() - started)
    return summary, trouble_of(plan, summary, counted, troubles, received, comm)
