"""Penetrations of a sweep over time: a line for each case, or a fan of quantiles of many."""

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.pictures.panel import GREY, Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.studies.end_values import display_of
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.pictures.effects import Choice, value_axis
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
    cases = chosen_cases(choice.cases, _MOST_HISTORIES)
    counts = ensemble.steps_stored[cases].tolist()
    times, depths = (ensemble.histories(name, cases) for name in ("time", "penetration"))
    unit, seconds = time_unit(float(np.nanmax(times)))
    lines = [
        (time[:count] / seconds, 1e3 * depth[:count])
        for time, depth, count in zip(times, depths, counts, strict=True)
    ]
    x, label = Axis(f"time ({unit})", zero=True), display_of("penetration").label
    if len(cases) > _FEW:
        return _fan(lines, x, label, len(choice.cases))
    keys = [key for key in choice.keys if key.differs]
    names, legend = [ensemble.ids[case] for case in cases], "case"
    if 0 < len(keys) <= _NAMED_KEYS:
        names = [", ".join(row) for row in zip(*(key.words() for key in keys), strict=True)]
        legend = ",\n".join(key.label for key in keys)
    curves = [
        Curve(*line, name, COLOURS[i % len(COLOURS)], i // len(COLOURS))
        for i, (line, name) in enumerate(zip(lines, names, strict=True))
    ]
    title = "Penetration of each case"
    return Panel(x, Axis(label, zero=True), title, curves=curves, legend=legend)


def _fan(lines: list[tuple[FloatArray, FloatArray]], x: Axis, label: str, count: int) -> Panel:
    """Return quantiles of penetrations, as long as half of the cases last, and some of these.

    Parameters
    ----------
    lines : times and penetrations of cases, which are some or all of ``count``.
    """
    last = max(time[-1] for time, _ in lines) * (1.0 - 1e-9)  # all but round-off
    time = np.linspace(0.0, last, _TIMES)
    depth = np.array([np.interp(time, *line, right=np.nan) for line in lines])
    ends = np.array([line[-1] for _, line in lines])
    rows = np.argsort(ends)[np.unique(np.linspace(0, len(ends) - 1, _LINES).astype(int))]
    singles = f"{len(rows)} of the cases"
    curves = [Curve(time, depth[row], singles, GREY, 0, 0.8, tabulated=False) for row in rows]
    known = np.isfinite(depth).sum(axis=0) >= 0.5 * len(depth)
    low, lower, median, upper, high = np.nanquantile(depth[:, known], _QUANTILES, axis=0)
    time = time[known]
    bands = [
        Band(time, low, high, "5\N{EN DASH}95 %", ("5 %", "95 %"), COLOURS[0], 0.16),
        Band(time, lower, upper, "25\N{EN DASH}75 %", ("25 %", "75 %"), COLOURS[0], 0.3),
    ]
    curves.append(Curve(time, median, "median", COLOURS[0], 0, 2.5))
    chosen = f"{len(ends)} of {count} cases, chosen at random" if len(ends) < count else ""
    title = f"Penetration: quantiles of {len(ends)} cases, {singles} from the least to the deepest"
    y = value_axis(label, ends)
    y = y if y.log else Axis(label, zero=True)
    return Panel(x, y, title, curves=curves, bands=bands, legend=chosen)
