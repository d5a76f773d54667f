"""Panels of a sweep: histories, final values against each key, sensitivity indices.

Of many cases there are quantiles and some cases, so that a page of thousands stays readable and
small; all of them are in the sweep's own files.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.pictures.panels import GREY, Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.panels import Bars as PanelBars
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.instants import time_unit
from ringwear_par.studies.analysis.effects import Plan, running_median, values_told
from ringwear_par.studies.analysis.sensitivity import chosen_cases
from ringwear_par.studies.definition.axes import LOG_VALUE, least_range, spans, upright
from ringwear_par.studies.pictures.choice import Choice
from ringwear_par.studies.pictures.fan import FEW, Fan, fan_of, labels_of
from ringwear_par.studies.pictures.index_bars import IndexBars
from ringwear_par.studies.storage.end_values import display_of, final_name
from ringwear_par.studies.storage.ensemble import Ensemble

#: cases with a line of their own beside quantiles, and points against a key
_LINES, _POINTS = 40, 1000
#: so many points have a running median
_MANY = 200
#: cases of a key of categories are spread so wide about it
_ASIDE = 0.2
_DASH = "\N{EN DASH}"


def histories(ensemble: Ensemble, choice: Choice) -> Panel:
    """Return the penetration over time: a line a case, or a fan of quantiles."""
    if len(choice.cases) <= FEW:
        return _lines(ensemble, choice)
    return _fan(ensemble, choice, fan_of(ensemble, choice.cases))


def _lines(ensemble: Ensemble, choice: Choice) -> Panel:
    cases = choice.cases
    labels, legend = labels_of(ensemble, cases, choice.keys)
    time, depth = (ensemble.histories(name, cases) for name in ("time", "penetration"))
    unit, seconds = time_unit(float(np.nanmax(time)))
    curves = []
    for row, (case, words) in enumerate(zip(cases, words_of(ensemble, choice, cases), strict=True)):
        count = ensemble.steps_stored[case]
        name = labels[row] if labels else ensemble.ids[case]
        curves.append(
            Curve(
                time[row, :count] / seconds, 1e3 * depth[row, :count], name,
                COLOURS[row % len(COLOURS)], row // len(COLOURS), words=words,
            )
        )  # fmt: skip
    return Panel(
        Axis(f"time ({unit})", zero=True), Axis(display_of("penetration").label, zero=True),
        "Penetration of each case", curves=curves, legend=legend,
    )  # fmt: skip


def _fan(ensemble: Ensemble, choice: Choice, fan: Fan) -> Panel:
    unit, seconds = time_unit(float(fan.time[-1]))
    rows = fan.singles(_LINES)
    words = words_of(ensemble, choice, fan.cases[rows])
    singles = f"{len(rows)} of the cases"
    time = fan.time / seconds
    curves = []
    for row, text in zip(rows, words, strict=True):
        known = np.isfinite(fan.table[row])
        curves.append(
            Curve(
                time[known], fan.table[row][known], singles, GREY, 0, 0.8, 0.7, tabulated=False,
                words=text,
            )
        )  # fmt: skip
    known = np.isfinite(fan.quantiles[0])
    low, lower, median, upper, high = fan.quantiles[:, known]
    bands = [
        Band(time[known], *ends, f"{names[0][:-2]}{_DASH}{names[1]}", names, COLOURS[0], opacity)
        for names, ends, opacity in (
            (("5 %", "95 %"), (low, high), 0.16), (("25 %", "75 %"), (lower, upper), 0.3),
        )
    ]  # fmt: skip
    curves.append(Curve(time[known], median, "median", COLOURS[0], 0, 2.5))
    subset = "; ".join(" ".join(words.split()) for words in fan.chosen)
    title = (
        f"Penetration: quantiles of {len(fan.cases)} cases, and {singles} from the least to the "
        f"deepest{'; ' if subset else ''}{subset}"
    )
    y = Axis(display_of("penetration").label, zero=True)
    deepest = 1e3 * ensemble.final["penetration"][fan.cases]
    if spans(deepest, LOG_VALUE):
        y = replace(y, log=True, ends=(0.1 * float(deepest.min()), 1.5 * float(deepest.max())))
    return Panel(
        Axis(f"time ({unit})", zero=True),
        y,
        title,
        curves=curves,
        bands=bands,
        legend=",\n".join(fan.chosen),
    )


def words_of(ensemble: Ensemble, choice: Choice, cases: IntArray) -> list[str]:
    """Return number and varied keys of some cases, in lines."""
    rows = np.searchsorted(choice.cases, cases)
    columns = [
        (key.label, values_told(replace(key, values=key.values[rows]))) for key in choice.keys
    ]
    return [
        "\n".join([
            f"case {ensemble.ids[case]}",
            *(f"{label} = {values[number]}" for label, values in columns),
        ])
        for number, case in enumerate(cases)
    ]  # fmt: skip


def drawn_cases(choice: Choice) -> IntArray:
    """Return the cases that are points of effects."""
    return chosen_cases(choice.cases, _POINTS)


def effects(ensemble: Ensemble, choice: Choice) -> dict[str, Panel]:
    """Return a panel of each final value against each key, its points being ``drawn_cases``."""
    rows = np.searchsorted(choice.cases, drawn_cases(choice))
    return {
        f"effect-{output}-{plan.key.name}": _effect(ensemble, choice, plan, output, rows)
        for plan in choice.plans
        for output in choice.outputs
    }


def _effect(ensemble: Ensemble, choice: Choice, plan: Plan, output: str, rows: IntArray) -> Panel:
    key, display = plan.key, display_of(output)
    label = f"final {display.label}" if output == "penetration" else display.label
    values = display.factor * ensemble.final[output][choice.cases]
    x, y = key.values[rows], values[rows]
    on_curves = plan.kind == "curves" and len(rows) == len(choice.cases)
    if key.categories and not on_curves:
        x = x + np.random.default_rng(1).uniform(-_ASIDE, _ASIDE, len(x))
    small, places = 4.0 if len(rows) > _MANY else 6.0, np.arange(len(rows))
    curves: list[Curve] = []
    points: list[Points] = []
    if on_curves:
        for number, cases in enumerate(plan.curves):
            name = plan.labels[number] if plan.labels else "cases"
            dash, hue = divmod(number, len(COLOURS))
            colour = COLOURS[hue]
            curves.append(Curve(x[cases], y[cases], name, colour, dash, tabulated=False))
            points.append(Points(x[cases], y[cases], name, colour, 5.0, cases=places[cases]))
        if plan.points is not None and len(plan.points):
            rest = plan.points
            points.append(
                Points(x[rest], y[rest], "other cases", GREY, small, 0.6, cases=places[rest])
            )
    else:
        points.append(Points(x, y, "cases", GREY, small, 0.6, cases=places))
    response, error = _response(choice, key.name, output, display.factor)
    if not (on_curves or response):
        known = np.isfinite(key.values) & np.isfinite(values)
        middle = _middle(plan, key.values[known], values[known])
        if isinstance(middle, Points):
            points.append(middle)
        elif middle is not None:
            curves.append(middle)
    panel = Panel(
        Axis(key.label, log=key.logarithmic, categories=key.categories), Axis(label),
        f"{label} over {key.label}", curves=[*curves, *response], bands=error, points=points,
    )  # fmt: skip
    return replace(panel, y=_value_axis(panel, values))


def _value_axis(panel: Panel, values: FloatArray) -> Axis:
    """Return the axis of an output: logarithmic, or wider than round-off."""
    if spans(values, LOG_VALUE):
        return replace(panel.y, log=True)
    drawn = np.concatenate([
        *(curve.y for curve in panel.curves), *(points.y for points in panel.points),
        *(band.low for band in panel.bands), *(band.high for band in panel.bands),
    ])  # fmt: skip
    drawn = drawn[np.isfinite(drawn)]
    low, high = float(drawn.min(initial=np.inf)), float(drawn.max(initial=-np.inf))
    if not len(drawn) or (ends := least_range(low, high)) == (low, high):
        return panel.y
    return replace(panel.y, ends=ends)


def _middle(plan: Plan, x: FloatArray, y: FloatArray) -> Curve | Points | None:
    """Return the median of all cases along a key."""
    if plan.kind == "scatter" and len(x) <= _MANY:
        return None
    if plan.kind == "scatter":
        name, places, middle = "running median of all", *running_median(x, y)
    else:
        places = np.unique(x)
        name, middle = "median of all", np.array([np.median(y[x == level]) for level in places])
    if plan.key.categories:
        return Points(places, middle, name, COLOURS[1], 22.0, level=True)
    return Curve(places, middle, name, COLOURS[1], 1)


def _response(
    choice: Choice, key: str, output: str, factor: float
) -> tuple[list[Curve], list[Band]]:
    """Return the surrogate's mean over the other keys, with its error."""
    responses = choice.responses
    if responses is None or output not in responses.names or key not in responses.over:
        return [], []
    along, mean, low, high = responses.curve(output, responses.over[key])
    name = "surrogate, mean over the other keys" if len(choice.keys) > 1 else "surrogate"
    ends = ("less 2 leave-out errors", "plus 2 leave-out errors")
    band = Band(along, factor * low, factor * high, "\N{PLUS-MINUS SIGN} 2 errors", ends)
    return [Curve(along, factor * mean, name)], [band]


def indices(bars: IndexBars, keys: Sequence[str] | None = None) -> Panel:
    """Return the indices of an output by key, of some keys or of all (None)."""
    chosen = [i for i, key in enumerate(bars.keys) if keys is None or key in keys]
    title = f"Indices of the {final_name(bars.output)}"
    if bars.noise:
        title += "; dotted: \N{GREEK SMALL LETTER DELTA} of a key without influence"
    places = np.arange(len(chosen), dtype=float)
    return Panel(
        Axis("sensitivity index", ends=(0.0, 1.05)),
        Axis("", categories=tuple(bars.keys[i] for i in chosen), reversed=True), title,
        bars=[
            PanelBars(
                places + (-0.17, 0.17)[number], values[chosen], name, COLOURS[number],
                None if widths is None else widths[chosen],
            )
            for number, (name, values, widths) in enumerate(
                zip(bars.names, bars.values, bars.widths, strict=True)
            )
        ],
        uprights=(bars.noise,) if bars.noise else (),
        legend=upright(f"{final_name(bars.output)}:") + f"\n{bars.source}",
    )  # fmt: skip


def all_indices(bars: Sequence[IndexBars]) -> dict[str, Panel]:
    """Return the indices of all outputs, by name."""
    return {f"indices-{of_output.output}": indices(of_output) for of_output in bars}
