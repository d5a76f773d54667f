"""Penetrations of a sweep over time: a line a case, or a fan of quantiles where there are many.

Of many cases there are quantiles and some cases, so that a page of thousands stays readable and
small; all of them are in the sweep's own files.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.pictures.panel import GREY, Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.studies.analysis.responses import chosen_cases
from ringwear_par.studies.end_values import display_of
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.pictures.choice import LOG_VALUE, Choice, spans

#: most cases that are drawn one by one
FEW = 12
#: most cases of which quantiles are drawn, and most with a line of their own on top
_MOST_HISTORIES, _LINES = 2000, 40
#: common times of a fan, and bytes of the file that are read together
_TIMES, _BLOCK_BYTES = 200, 16e6
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_DASH = "\N{EN DASH}"


def histories(ensemble: Ensemble, choice: Choice) -> Panel:
    """Return the penetration over time: a line a case, or a fan of quantiles."""
    if len(choice.cases) <= FEW:
        return _lines(ensemble, choice)
    return _fan(ensemble, choice)


def case_words(ensemble: Ensemble, choice: Choice, cases: IntArray) -> list[str]:
    """Return number and varied keys of some cases, in lines."""
    rows = np.searchsorted(choice.cases, cases)
    columns = [(key.label, replace(key, values=key.values[rows]).words()) for key in choice.keys]
    return [
        "\n".join([
            f"case {ensemble.ids[case]}",
            *(f"{label} = {values[number]}" for label, values in columns),
        ])
        for number, case in enumerate(cases)
    ]  # fmt: skip


def _lines(ensemble: Ensemble, choice: Choice) -> Panel:
    cases = choice.cases
    differing = [key for key in choice.keys if key.differs]
    if len(differing) > 3:
        names, legend = [ensemble.ids[case] for case in cases], "case"
    else:
        names = [", ".join(row) for row in zip(*(key.words() for key in differing), strict=True)]
        names = names or [ensemble.ids[case] for case in cases]
        legend = ",\n".join(key.label for key in differing)
    time, depth = (ensemble.histories(name, cases) for name in ("time", "penetration"))
    unit, seconds = time_unit(float(np.nanmax(time)))
    words, last = case_words(ensemble, choice, cases), ensemble.steps_stored[cases]
    curves = [
        Curve(
            time[row, : last[row]] / seconds, 1e3 * depth[row, : last[row]], names[row],
            COLOURS[row % len(COLOURS)], row // len(COLOURS), words=words[row],
        )
        for row in range(len(cases))
    ]  # fmt: skip
    return Panel(
        Axis(f"time ({unit})", zero=True), Axis(display_of("penetration").label, zero=True),
        "Penetration of each case", curves=curves, legend=legend,
    )  # fmt: skip


@dataclass(frozen=True)
class _Table:
    """Penetrations of many cases at common times."""

    #: (times,) s
    time: FloatArray
    #: (cases, times) um, NaN where a case has ended
    depth: FloatArray
    #: whether all cases last equally long
    even: bool

    @classmethod
    def of(cls, ensemble: Ensemble, cases: IntArray) -> "_Table":
        """Read the penetrations of some cases, in blocks."""
        last, ends = ensemble.steps_stored[cases] - 1, np.empty(len(cases))
        for block in _blocks(ensemble, cases):
            time = ensemble.histories("time", cases[block])
            ends[block] = time[np.arange(len(time)), last[block]]
        grid = np.linspace(0.0, ends.max(), _TIMES + 1)
        table = np.empty((len(cases), len(grid)))
        for block in _blocks(ensemble, cases):
            histories = (ensemble.histories(n, cases[block]) for n in ("time", "penetration"))
            rows = range(block.start, block.stop)
            for row, time, depth in zip(rows, *histories, strict=True):
                stop = last[row] + 1
                table[row] = 1e3 * np.interp(grid, time[:stop], depth[:stop])
                table[row, grid > ends[row] * (1.0 + 1e-9)] = np.nan
        return cls(grid, table, bool(ends.min() >= ends.max() * (1.0 - 1e-9)))

    def quantiles(self) -> FloatArray:
        """Return quantiles, NaN where less than half of the cases last so long: they would jump."""
        quantiles: FloatArray = np.nanquantile(self.depth, _QUANTILES, axis=0)
        quantiles[:, np.isfinite(self.depth).sum(axis=0) < 0.5 * len(self.depth)] = np.nan
        return quantiles

    def singles(self) -> IntArray:
        """Return some rows from the least to the deepest, evenly in their order."""
        by_depth = np.argsort(np.nanmax(self.depth, axis=1))
        return by_depth[np.unique(np.linspace(0, len(by_depth) - 1, _LINES).astype(int))]


def _blocks(ensemble: Ensemble, cases: IntArray) -> Iterator[slice]:
    size = max(1, int(_BLOCK_BYTES // (8 * max(1, int(ensemble.steps_stored.max())))))
    for start in range(0, len(cases), size):
        yield slice(start, min(start + size, len(cases)))


def _fan(ensemble: Ensemble, choice: Choice) -> Panel:
    cases = chosen_cases(choice.cases, _MOST_HISTORIES)
    table = _Table.of(ensemble, cases)
    unit, seconds = time_unit(float(table.time[-1]))
    time, rows = table.time / seconds, table.singles()
    singles = f"{len(rows)} of the cases"
    curves = []
    for row, words in zip(rows, case_words(ensemble, choice, cases[rows]), strict=True):
        known = np.isfinite(table.depth[row])
        curves.append(
            Curve(
                time[known], table.depth[row][known], singles, GREY, 0, 0.8, tabulated=False,
                words=words,
            )
        )  # fmt: skip
    quantiles = table.quantiles()
    known = np.isfinite(quantiles[0])
    low, lower, median, upper, high = quantiles[:, known]
    bands = [
        Band(time[known], *ends, f"{names[0][:-2]}{_DASH}{names[1]}", names, COLOURS[0], opacity)
        for names, ends, opacity in (
            (("5 %", "95 %"), (low, high), 0.16), (("25 %", "75 %"), (lower, upper), 0.3),
        )
    ]  # fmt: skip
    curves.append(Curve(time[known], median, "median", COLOURS[0], 0, 2.5))
    remarks = []
    if len(cases) < len(choice.cases):
        remarks.append(f"{len(cases)} of {len(choice.cases)} cases, chosen at random")
    if not table.even:
        remarks.append("quantiles of cases that last so long,\nas long as half of them do")
    title = "; ".join([
        f"Penetration: quantiles of {len(cases)} cases, and {singles} from the least to the "
        "deepest",
        *(" ".join(remark.split()) for remark in remarks),
    ])  # fmt: skip
    deepest = 1e3 * ensemble.final["penetration"][cases]
    y = Axis(display_of("penetration").label, zero=True)
    if spans(deepest, LOG_VALUE):
        y = replace(y, log=True, ends=(0.1 * float(deepest.min()), 1.5 * float(deepest.max())))
    return Panel(
        Axis(f"time ({unit})", zero=True), y, title, curves=curves, bands=bands,
        legend=",\n".join(remarks),
    )  # fmt: skip
