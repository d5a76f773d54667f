"""The summary of a sweep, by its results."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ringwear_par.errors import ComputationError
from ringwear_par.results.hdf5 import reading
from ringwear_par.results.progress import duration
from ringwear_par.studies.ensemble import (
    FILE_KIND,
    RESULTS,
    SOFTWARE,
    TABLE,
    count_flags,
    split_flags,
)


@dataclass(frozen=True)
class Summary:
    """The summary of a sweep; the command prints it as a text."""

    #: of the results
    folder: Path
    #: cases of the study, those that are done and that have failed
    total: int
    done: int
    failed: int
    #: those that this sweep computed
    computed: int = 0
    #: wall time, and that of all ranks in blocks, s
    seconds: float = 0.0
    busy: float = 0.0
    ranks: int = 1
    #: MB, largest memory of a rank
    peak: float = 0.0
    #: largest error of balances
    worst: float = 0.0
    #: how many cases have the same flags, by these
    flagged: Mapping[tuple[str, ...], int] = field(default_factory=dict)

    def __str__(self) -> str:
        lines = [f"cases: {self.total}, {self.done} done, {self.failed} failed"]
        if self.computed:
            rate = self.computed / self.seconds
            lines.append(
                f"{self.computed} computed in {duration(self.seconds)}, ranks: {self.ranks}: "
                f"{rate:.3g} a second, {100.0 * self.busy / (self.seconds * self.ranks):.0f} % of "
                f"the time in blocks; peak memory of a rank {self.peak:.0f} MB"
            )
        lines.append(f"largest error of balances (force, volume, energy, KKT): {self.worst:.1e}")
        if self.flagged:
            lines.append(count_flags(self.flagged))
        return "\n".join([*lines, f"{self.folder / TABLE}, {self.folder / RESULTS}"])

    def refuse_failures(self) -> None:
        """Raise ComputationError if cases failed; the same on all ranks."""
        if self.failed:
            reasons = f"{self.folder / TABLE} says why of each"
            error = ComputationError(f"{self.failed} of {self.total} cases failed; {reasons}")
            error.ranks = self.ranks
            raise error


def stored_summary(folder: Path) -> Summary:
    """Return what the results in a folder say of their cases. On one rank."""
    with reading(folder / RESULTS, SOFTWARE, FILE_KIND) as file:
        status, flags = file["status"][:], file["flags"][:]
        worst = float(np.nanmax(file["imbalance"][:], initial=0.0))
    failed = int((status == b"failed").sum())
    used, counts = np.unique(flags[flags != b""], return_counts=True)
    words = zip(used.tolist(), counts.tolist(), strict=True)
    flagged = {split_flags(text.decode()): n for text, n in words}
    return Summary(folder, len(status), len(status) - failed, failed, worst=worst, flagged=flagged)
