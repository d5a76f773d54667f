"""The summary of a sweep: where its time went, how many cases have ended, and any trouble."""

import logging
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from mpi4py import MPI

from ringwear_par.errors import ComputationError, InputError, RingwearError
from ringwear_par.files.writing import atomic_write
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.progress import duration
from ringwear_par.results.signals import name_of
from ringwear_par.studies.execution.plan import Plan
from ringwear_par.studies.storage.results_file import RESULTS, TABLE, count_flags

log = logging.getLogger(__name__)

_PARTS = ("stepping", "assembly", "output")


@dataclass
class Timings:
    """Where a rank's time went, s, and its counts; flags of the cases that have some."""

    stepping: float = 0.0
    assembly: float = 0.0
    output: float = 0.0
    operators: int = 0
    worst: float = 0.0
    flagged: Counter[tuple[str, ...]] = field(default_factory=Counter)


@dataclass(frozen=True)
class Summary:
    """The summary of a sweep; the command prints it as a text."""

    #: of the results
    folder: Path
    #: name of the slice, "" for the whole
    part: str
    #: cases of the study, or slice, those that are done and have failed
    total: int
    done: int
    failed: int
    #: those of them that this sweep computed
    computed: int
    #: how many it assembled
    operators: int
    #: wall time
    seconds: float
    #: MB, largest memory of a rank
    peak: float
    #: of each rank
    timings: tuple[Timings, ...]
    #: how many cases have the same flags, by these
    flagged: Counter[tuple[str, ...]]
    #: whether the results were written
    merged: bool = False

    def __str__(self) -> str:
        lines = [
            f"cases{f' of slice {self.part}' if self.part else ''}: {self.total}, {self.done} "
            f"done, {self.failed} failed, {self.total - self.done - self.failed} not done; "
            f"contact pairs assembled: {self.operators}"
        ]
        if self.computed:
            ranks = len(self.timings)
            spent = {name: sum(getattr(t, name) for t in self.timings) for name in _PARTS}
            spent["start and merging"] = self.seconds * ranks - sum(spent.values())
            shares = (f"{100.0 * s / (self.seconds * ranks):.1f} % {n}" for n, s in spent.items())
            rate = self.computed / self.seconds
            lines += [
                f"{self.computed} computed in {duration(self.seconds)}, ranks: {ranks}: {rate:.3g} "
                f"a second, {rate / ranks:.3g} a rank; peak memory of a rank {self.peak:.0f} MB",
                f"time of the ranks: {', '.join(shares)}",
            ]
        worst = max(t.worst for t in self.timings)
        if worst > 0.0:
            lines.append(
                f"largest error of balances (force, volume, energy, KKT), new cases: {worst:.1e}"
            )
        if self.flagged:
            lines.append(count_flags(self.flagged))
        if self.part:
            lines.append(
                "the same command without --slice computes the other cases and merges all slices"
            )
        elif self.merged:
            lines.append(f"{self.folder / TABLE}, {self.folder / RESULTS}")
        return "\n".join(lines)


def trouble_of(
    plan: Plan,
    summary: Summary,
    counted: tuple[int, int],
    troubles: list[RingwearError],
    received: int,
    comm: MPI.Comm,
) -> RingwearError | None:
    """Return the trouble of a sweep in one sentence, if any, the same on all ranks. Collective."""
    ended = f"{summary.done + summary.failed} of {summary.total} cases are stored"
    if troubles:
        if isinstance(troubles[0], InputError):
            return troubles[0]
        if comm.rank == 0:  # beside results of an earlier study, which look complete
            mark_stopped(plan.folder.stopped)
        return ComputationError(f"{troubles[0]}; {ended}, and the same command goes on")
    stopped = summary.computed < plan.cases_left
    if stopped:
        on_first_rank(comm, lambda: mark_stopped(plan.folder.stopped))
    stored = summary.done, summary.failed
    # cases that failed before and are still stored must not make up for lost ones
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
        )
    if summary.failed:
        where = summary.folder / TABLE
        reasons = f"{where} says why of each" + ", once slices are merged" * bool(plan.folder.part)
        return ComputationError(f"{summary.failed} of {summary.total} cases failed; {reasons}")
    return None


def mark_stopped(path: Path) -> None:
    """Make an empty file in place of whatever has its name, or say why it cannot be."""
    try:
        with atomic_write(path):
            pass
    except OSError as error:
        log.warning("%s: cannot be written: %s", path, error.strerror)
