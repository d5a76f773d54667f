"""Penetrations of a sweep over time: a line for each case, or a fan of quantiles of many."""

from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.pictures.panel import GREY, Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.studies.end_values import display_of
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.pictures.effects import LOG_VALUE, Choice, spans
from ringwear_par.studies.surrogate import chosen_cases

#: most cases that are drawn one by one, and most of which names are the values of so many keys
_FEW, _NAMED_KEYS = 12, 3
#: most cases of which quantiles are drawn, and number of those with a line of their own on top
_MOST_HISTORIES, _LINES = 1000, 40
#: common times of a fan
_TIMES = 201
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def histories(ensemble: Ensemble, choice: Choice) -> Panel:
    """Return the penetration over time: a line for each case, or a fan of quantiles."""
    if len(choice.cases) <= _FEW:
        return _lines(ensemble, choice)
    return _fan(ensemble, choice)


def _lines(ensemble: Ensemble, choice: Choice) -> Panel:
    cases = choice.cases
    differing = [key for key in choice.keys if key.differs]
    names, legend = [ensemble.ids[case] for case in cases], "case"
    if 0 < len(differing) <= _NAMED_KEYS:
        names = [", ".join(row) for row in zip(*(key.words() for key in differing), strict=True)]
        legend = ",\n".join(key.label for key in differing)
    time, depth = (ensemble.histories(name, cases) for name in ("time", "penetration"))
    unit, seconds = time_unit(float(np.nanmax(time)))
    curves = [
        Curve(
            time[row, :count] / seconds, 1e3 * depth[row, :count], names[row],
            COLOURS[row % len(COLOURS)], row // len(COLOURS),
        )
        for row, count in enumerate(ensemble.steps_stored[cases].tolist())
    ]  # fmt: skip
    return Panel(
        Axis(f"time ({unit})", zero=True), Axis(display_of("penetration").label, zero=True),
        "Penetration of each case", curves=curves, legend=legend,
    )  # fmt: skip


def _fan(ensemble: Ensemble, choice: Choice) -> Panel:
    """Return quantiles, as long as half of the cases last, and some cases."""
    cases = chosen_cases(choice.cases, _MOST_HISTORIES)
    time, depth, even = _common_times(ensemble, cases)
    unit, seconds = time_unit(float(time[-1]))
    time = time / seconds
    by_depth = np.argsort(np.nanmax(depth, axis=1))
    rows = by_depth[np.unique(np.linspace(0, len(cases) - 1, _LINES).astype(int))]
    singles = f"{len(rows)} of the cases"
    curves = [
        Curve(time, depth[row], singles, GREY, 0, 0.8, tabulated=False) for row in rows.tolist()
    ]
    known = np.isfinite(depth).sum(axis=0) >= 0.5 * len(depth)
    low, lower, median, upper, high = np.nanquantile(depth[:, known], _QUANTILES, axis=0)
    bands = [
        Band(time[known], *ends, words, names, COLOURS[0], opacity)
        for words, names, ends, opacity in (
            ("5\N{EN DASH}95 %", ("5 %", "95 %"), (low, high), 0.16),
            ("25\N{EN DASH}75 %", ("25 %", "75 %"), (lower, upper), 0.3),
        )
    ]
    curves.append(Curve(time[known], median, "median", COLOURS[0], 0, 2.5))
    remarks = []
    if len(cases) < len(choice.cases):
        remarks.append(f"{len(cases)} of {len(choice.cases)} cases, chosen at random")
    if not even:
        remarks.append("quantiles of cases that last so long,\nas long as half of them do")
    title = f"Penetration: quantiles of {len(cases)} cases, {singles} from the least to the deepest"
    deepest = 1e3 * ensemble.final["penetration"][cases]
    y = Axis(display_of("penetration").label, zero=True)
    if spans(deepest, LOG_VALUE):
        y = replace(y, log=True, ends=(0.1 * float(deepest.min()), 1.5 * float(deepest.max())))
    return Panel(
        Axis(f"time ({unit})", zero=True), y, title, curves=curves, bands=bands,
        legend=",\n".join(remarks),
    )  # fmt: skip


def _common_times(ensemble: Ensemble, cases: IntArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return times (times,), s, penetrations (cases, times), um, and whether all last so long.

    Penetrations are NaN where a case has ended.
    """
    last = ensemble.steps_stored[cases] - 1
    instants, depths = (ensemble.histories(name, cases) for name in ("time", "penetration"))
    ends = instants[np.arange(len(cases)), last]
    time = np.linspace(0.0, ends.max(), _TIMES)
    table = np.array([
        np.interp(time, instants[row, : n + 1], 1e3 * depths[row, : n + 1])
        for row, n in enumerate(last.tolist())
    ])  # fmt: skip
    table[time > ends[:, None] * (1.0 + 1e-9)] = np.nan
    return time, table, bool(ends.min() >= ends.max() * (1.0 - 1e-9))
