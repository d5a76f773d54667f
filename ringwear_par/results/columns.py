"""Many histories of one contact pair by column: what is stored of all of them in few arrays."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ringwear_par.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class HistoryColumns:
    """B histories as they are stored, in the order in which their cases were given.

    Stored states of all histories follow each other as rows: those of history i are
    ``offsets[i]`` to ``offsets[i + 1]``. A failed history has the rows before its failure.

    Parameters
    ----------
    offsets : (B + 1,) int.
    steps : (rows,) int, steps made.
    histories : (rows,) each, by name, see ``variables.HISTORIES``.
    profiles : (rows, n) each, by name, see ``variables.PROFILES``; or (B, n), where the last ones
        are stored only: NaN where a history has none.
    imbalance : (B,) float, the worst balance of each, see ``Balances.worst``.
    flags : what makes each doubtful, see ``ValidityWarning.flag``.
    seconds : (B,) float, s, that each took: of those that are stepped together, its share.
    status : "done" or "failed".
    reason : why it failed, one line; "" for one that has not.
    derivatives : (P, rows) each, of fields (P, rows, n) or (P, B, n), by name, see
        ``variables.D_HISTORIES`` and ``D_PROFILES``.
    layers : (rows,), (rows, layers + 1), (rows, n) or (B, n) each, by name, see
        ``variables.LAYERS``.
    stress : (rows,) or (rows, points) each, by name, see ``stress_variables.stress_rows``.
    each : (B,) or (B, points) each, by name: when wear got through layers, where points are.
    """

    offsets: IntArray
    steps: IntArray
    histories: Mapping[str, Any]
    profiles: Mapping[str, FloatArray]
    imbalance: FloatArray
    flags: tuple[tuple[str, ...], ...]
    seconds: FloatArray
    status: tuple[str, ...]
    reason: tuple[str, ...]
    derivatives: Mapping[str, FloatArray] = field(default_factory=dict)
    layers: Mapping[str, FloatArray] = field(default_factory=dict)
    stress: Mapping[str, FloatArray] = field(default_factory=dict)
    each: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of the histories."""
        return len(self.status)

    @property
    def deep(self) -> bool:
        """Whether the profiles are stored as often as the histories."""
        return all(len(values) == len(self.steps) for values in self.profiles.values())

    def rows(self, i: int) -> slice:
        """Return which rows are of history i."""
        return slice(int(self.offsets[i]), int(self.offsets[i + 1]))
