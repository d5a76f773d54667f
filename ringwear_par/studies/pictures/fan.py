"""Histories of a sweep over time: one line a case, or a fan of quantiles where there are many."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.studies.analysis.effects import Key, values_told
from ringwear_par.studies.analysis.sensitivity import chosen_cases
from ringwear_par.studies.storage.ensemble import Ensemble

#: so few cases are drawn one by one
FEW = 12
_MOST_HISTORIES, _TIMES, _SINGLES = 2000, 200, 8
_BLOCK_BYTES = 16e6


@dataclass(frozen=True)
class Fan:
    """Penetrations of many cases at common times.

    Parameters
    ----------
    cases : their numbers; of very many, some that were chosen at random.
    chosen : in words whether they were, and what the quantiles are of; "" if there is nothing to
        tell.
    time : (times,), s.
    table : (cases, times), um; NaN where a case has ended.
    quantiles : (5, times), um: 5, 25, 50, 75 and 95 %; NaN where less than half of the cases last
        so long, for they would jump about.
    """

    cases: IntArray
    chosen: tuple[str, ...]
    time: FloatArray
    table: FloatArray
    quantiles: FloatArray

    def singles(self, most: int) -> IntArray:
        """Return rows of the table from the least to the deepest, evenly in their order."""
        by_depth = np.argsort(np.nanmax(self.table, axis=1))
        return by_depth[np.unique(np.linspace(0, len(by_depth) - 1, most).astype(int))]


def fan_of(ensemble: Ensemble, drawn: IntArray) -> Fan:
    """Return the penetrations of cases at common times. Not collective."""
    cases = chosen_cases(drawn, _MOST_HISTORIES)
    time, table, even = _fan_table(ensemble, cases)
    quantiles = np.nanquantile(table, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
    quantiles[:, np.isfinite(table).sum(axis=0) < 0.5 * len(table)] = np.nan
    told = []
    if len(cases) < len(drawn):
        told.append(f"{len(cases)} of {len(drawn)} cases, chosen at random")
    if not even:
        told.append("quantiles of cases that last so long,\nas long as half of them do")
    return Fan(cases, tuple(told), time, table, quantiles)


def labels_of(ensemble: Ensemble, drawn: IntArray, keys: Sequence[Key]) -> tuple[list[str], str]:
    """Return what tells cases apart, and what it is."""
    differ = [key for key in keys if key.differs]
    if len(differ) > 3:
        return [ensemble.ids[case] for case in drawn], "case"
    labels = [", ".join(words) for words in zip(*map(values_told, differ), strict=True)]
    return labels, ",\n".join(key.label for key in differ)


def _fan_table(ensemble: Ensemble, cases: IntArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return common times, penetrations (um) at them, (cases, times), and if all last equally.

    Histories that are shorter have NaN.
    """
    last = ensemble.steps_stored[cases] - 1
    ends = np.empty(len(cases))
    for part in _parts(ensemble, cases):
        time = ensemble.histories("time", cases[part])
        ends[part] = time[np.arange(len(time)), last[part]]
    grid = np.linspace(0.0, ends.max(), _TIMES + 1)
    table = np.empty((len(cases), len(grid)))
    for part in _parts(ensemble, cases):
        time, depth = (ensemble.histories(name, cases[part]) for name in ("time", "penetration"))
        for number, t, d in zip(range(part.start, part.stop), time, depth, strict=True):
            stop, end = last[number] + 1, ends[number] * (1.0 + 1e-9)
            table[number] = 1e3 * np.interp(grid, t[:stop], d[:stop])
            table[number, grid > end] = np.nan
    return grid, table, bool(ends.min() >= ends.max() * (1.0 - 1e-9))


def _parts(ensemble: Ensemble, cases: IntArray) -> Iterator[slice]:
    block = max(1, int(_BLOCK_BYTES // (8 * max(1, int(ensemble.steps_stored.max())))))
    for start in range(0, len(cases), block):
        yield slice(start, min(start + block, len(cases)))
