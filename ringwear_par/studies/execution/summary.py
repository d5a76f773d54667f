"""The summary of a sweep: where its time went, and how many cases have ended."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from ringwear_par.results.execution.progress import duration
from ringwear_par.studies.storage.results_file import RESULTS, TABLE, count_flags

_PARTS = ("stepping", "assembly", "waiting", "output")


@dataclass
class Timings:
    """Where a rank's time went, s, and its counts; flags of the cases that have some."""

    stepping: float = 0.0
    assembly: float = 0.0
    waiting: float = 0.0
    output: float = 0.0
    operators: int = 0
    worst: float = 0.0
    flagged: Counter[tuple[str, ...]] = field(default_factory=Counter)


@dataclass(frozen=True)
class Summary:
    """The summary of a sweep; the command prints it as a text.

    Parameters
    ----------
    folder : of the results.
    part : name of the slice, "" for the whole.
    total, done, failed : cases of the study, or slice, those that are done and have failed.
    computed : those of them that this sweep computed.
    operators : how many it assembled.
    seconds : wall time.
    peak : MB, largest memory of a rank.
    timings : of each rank.
    flagged : how many cases have the same flags, by these.
    merged : whether the results were written.
    """

    folder: Path
    part: str
    total: int
    done: int
    failed: int
    computed: int
    operators: int
    seconds: float
    peak: float
    timings: tuple[Timings, ...]
    flagged: Counter[tuple[str, ...]]
    merged: bool = False

    def __str__(self) -> str:
        lines = [
            f"cases{f' of slice {self.part}' if self.part else ''}: {self.total}, {self.done} "
            f"done, {self.failed} failed, {self.total - self.done - self.failed} not done; "
            f"operators assembled: {self.operators}"
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
            lines.append(f"worst balance (force, volume, energy, KKT) of these cases: {worst:.1e}")
        if self.flagged:
            lines.append(count_flags(self.flagged))
        if self.part:
            lines.append(
                "the same command without --slice computes what is left and merges all slices"
            )
        elif self.merged:
            lines.append(f"{self.folder / TABLE}, {self.folder / RESULTS}")
        return "\n".join(lines)
