"""Charts of a sweep: histories, final values against each key, sensitivity indices.

Of many cases there are quantiles and some cases, so that a page of thousands stays readable and
small; all of them are in the sweep's own files.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.reports import charts
from ringwear_par.reports.blocks import Chart, Charts
from ringwear_par.results.instants import time_unit
from ringwear_par.results.pictures.drawing import COLOURS
from ringwear_par.studies.analysis.effects import Plan, running_median, values_told
from ringwear_par.studies.analysis.sensitivity import chosen_cases
from ringwear_par.studies.definition.axes import LOG_VALUE, least_range, spans
from ringwear_par.studies.pictures.fan import FEW, Fan, fan_of, labels_of
from ringwear_par.studies.pictures.figures import Choice
from ringwear_par.studies.pictures.index_bars import IndexBars
from ringwear_par.studies.storage.end_values import final_name, shown
from ringwear_par.studies.storage.ensemble import Ensemble

#: cases with a line of their own beside quantiles, and points against a key
_LINES, _POINTS = 40, 1000
#: so many points have a running median
_MANY = 200
#: cases of a key of categories are spread so wide about it
_ASIDE = 0.2
_GREY = "#8c8c8c"
_DASH = "\N{EN DASH}"


def histories(ensemble: Ensemble, chosen: Choice) -> Charts:
    """Return the chart of the penetration over time: a line a case, or a fan of quantiles."""
    if len(chosen.cases) <= FEW:
        return Charts([_lines(ensemble, chosen)])
    return Charts([_fan(ensemble, chosen, fan_of(ensemble, chosen.cases))])


def _lines(ensemble: Ensemble, chosen: Choice) -> Chart:
    cases = chosen.cases
    labels, _ = labels_of(ensemble, cases, chosen.keys)
    time, depth = (ensemble.histories(name, cases) for name in ("time", "penetration"))
    unit, seconds = time_unit(float(np.nanmax(time)))
    data = []
    for row, (case, words) in enumerate(zip(cases, _words(ensemble, chosen, cases), strict=True)):
        count = ensemble.steps_stored[case]
        name = labels[row] if labels else ensemble.ids[case]
        line = charts.line(
            time[row, :count] / seconds, 1e3 * depth[row, :count], charts.shown(name), row,
            text=words, hovertemplate=_hover(unit),
        )  # fmt: skip
        data.append(line)
    return _penetration(ensemble, cases, data, unit, "Penetration of each case")


def _fan(ensemble: Ensemble, chosen: Choice, fan: Fan) -> Chart:
    unit, seconds = time_unit(float(fan.time[-1]))
    rows = fan.singles(_LINES)
    words = _words(ensemble, chosen, fan.cases[rows])
    steps: dict[str, Any] = {"x0": 0, "dx": charts.numbers(fan.time[1] / seconds)[0]}
    singles = f"{len(rows)} of the cases"
    data: list[dict[str, Any]] = []
    for row, told in zip(rows, words, strict=True):
        depth = fan.table[row]
        data.append({
            **steps, "y": charts.numbers(depth[np.isfinite(depth)]), "name": singles,
            "mode": "lines", "line": {"color": _GREY, "width": 0.8}, "opacity": 0.7,
            "legendgroup": "cases", "showlegend": not data, "text": told,
            "hovertemplate": _hover(unit), "meta": "aside",
        })  # fmt: skip
    known = np.isfinite(fan.quantiles[0])
    time = fan.time[known] / seconds
    low, lower, median, upper, high = fan.quantiles[:, known]
    for names, ends, opacity in (
        (("5 %", "95 %"), (low, high), 0.16), (("25 %", "75 %"), (lower, upper), 0.3),
    ):  # fmt: skip
        name = f"{names[0][:-2]}{_DASH}{names[1]}"
        data += charts.band(time, *ends, name, names, 0, opacity)
    style = {"color": COLOURS[0], "width": 2.5}
    data.append(charts.line(time, median, "median", 0, line=style))
    told = "; ".join(" ".join(each.split()) for each in fan.chosen)
    caption = f"Penetration: quantiles of {len(fan.cases)} cases, and {singles} from the least to "
    caption += f"the deepest{'; ' if told else ''}{told}"
    return _penetration(ensemble, fan.cases, data, unit, caption)


def _penetration(
    ensemble: Ensemble, cases: IntArray, data: list[dict[str, Any]], unit: str, caption: str
) -> Chart:
    label = shown("penetration").label
    y: dict[str, Any] = {"rangemode": "tozero"}
    ends = 1e3 * ensemble.final["penetration"][cases]
    if len(cases) > FEW and spans(ends, LOG_VALUE):
        y = {"type": "log", "range": np.log10([0.1 * ends.min(), 1.5 * ends.max()]).tolist()}
    x = charts.axis(f"time ({unit})", rangemode="tozero")
    words = f"Line chart: {label} over time ({unit})"
    made = charts.layout(x, charts.axis(label, **y), showlegend=len(data) > 1)
    return Chart("histories", caption, words, data, made, 440, wide=True)


def _hover(unit: str) -> str:
    return f"%{{text}}<br>%{{x:.4g}} {unit}: %{{y:.5g}} \N{MICRO SIGN}m<extra></extra>"


def _words(ensemble: Ensemble, chosen: Choice, cases: IntArray) -> list[str]:
    """Return what each of some cases is, as plotly draws texts."""
    rows = np.searchsorted(chosen.cases, cases)
    columns = [
        (charts.shown(key.label), values_told(replace(key, values=key.values[rows])))
        for key in chosen.keys
    ]
    return [
        "<br>".join([
            f"case {charts.shown(ensemble.ids[case])}",
            *(f"{label} = {charts.shown(values[number])}" for label, values in columns),
        ])
        for number, case in enumerate(cases)
    ]  # fmt: skip


def effects(ensemble: Ensemble, chosen: Choice) -> Charts:
    """Return a chart of each final value against each key, its points being cases."""
    shown = chosen_cases(chosen.cases, _POINTS)
    rows = np.searchsorted(chosen.cases, shown)
    drawn = [
        _effect(ensemble, chosen, plan, output, rows)
        for plan in chosen.plans
        for output in chosen.outputs
    ]
    return Charts(drawn, points=_words(ensemble, chosen, shown))


def _effect(
    ensemble: Ensemble, chosen: Choice, plan: Plan, output: str, rows: IntArray
) -> Chart:  # fmt: skip
    key = plan.key
    factor, label = shown(output).factor, shown(output).label
    if output == "penetration":
        label = f"final {label}"
    values = factor * ensemble.final[output][chosen.cases]
    x, y = key.values[rows], values[rows]
    curves = plan.kind == "curves" and len(rows) == len(chosen.cases)
    if key.categories and not curves:
        x = x + np.random.default_rng(1).uniform(-_ASIDE, _ASIDE, len(x))
    hover = "%{text}<br>%{y:.5g}<extra></extra>"

    def dots(some: Any, name: str, **style: Any) -> dict[str, Any]:
        """Some of the points; their texts are those of the page's cases."""
        return {
            "x": charts.numbers(x[some]), "y": charts.numbers(y[some]), "name": name,
            "customdata": np.arange(len(rows))[some].tolist(), "hovertemplate": hover, **style,
        }  # fmt: skip

    small = {"size": 4 if len(rows) > _MANY else 6, "color": _GREY, "opacity": 0.6}
    if curves:
        data = _curves(plan, dots, small)
    else:
        data = [dots(slice(None), "cases", mode="markers", marker=small)]
    response = _response(chosen, key.name, output, factor)
    if not (curves or response):
        known = np.isfinite(key.values) & np.isfinite(values)
        data += _middle(plan, key.values[known], values[known])
    data += response
    return Chart(
        f"effect-{output}-{key.name}".replace("_", "-").replace(".", "-"),
        f"{label} over {key.label}",
        f"Chart: {label} over {key.label}, a point each case",
        data,
        charts.layout(
            _key_axis(plan),
            charts.axis(label, **_value_axis(values, data)),
            showlegend=len(data) > 1,
        ),
    )


def _value_axis(values: FloatArray, data: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return what is particular of the axis of an output: logarithmic, or wider than round-off."""
    if spans(values, LOG_VALUE):
        return {"type": "log"}
    drawn = [y for each in data for y in each["y"] if y is not None]
    low, high = min(drawn, default=0.0), max(drawn, default=0.0)
    ends = least_range(low, high)
    return {} if ends == (low, high) else {"range": list(ends)}


def _curves(plan: Plan, dots: Any, small: dict[str, Any]) -> list[dict[str, Any]]:
    data = []
    for number, curve in enumerate(plan.curves):
        name = plan.labels[number] if plan.labels else "cases"
        style = charts.line([], [], "", number)["line"]
        data.append(dots(curve, charts.shown(name), mode="lines+markers", line=style))
    if plan.points is not None and len(plan.points):
        data.append(dots(plan.points, "other cases", mode="markers", marker=small))
    return data


def _middle(plan: Plan, x: FloatArray, y: FloatArray) -> list[dict[str, Any]]:
    """Return the median of all cases along a key."""
    if plan.kind == "scatter" and len(x) <= _MANY:
        return []
    if plan.kind == "scatter":
        told, places, middle = "running median of all", *running_median(x, y)
    else:
        places = np.unique(x)
        told, middle = "median of all", np.array([np.median(y[x == level]) for level in places])
    mode = "markers" if plan.key.categories else "lines"
    marker = {"symbol": "line-ew-open", "size": 22, "line": {"width": 3}, "color": COLOURS[1]}
    return [charts.line(places, middle, told, 1, mode=mode, marker=marker)]


def _response(chosen: Choice, key: str, output: str, factor: float) -> list[dict[str, Any]]:
    """Return the surrogate's mean over the other keys, with its error."""
    found = chosen.responses
    if found is None or output not in found.names or key not in found.over:
        return []
    along, mean, low, high = found.curve(output, found.over[key])
    told = "surrogate, mean over the other keys" if len(chosen.keys) > 1 else "surrogate"
    ends = ("less 2 leave-out errors", "plus 2 leave-out errors")
    error = charts.band(along, factor * low, factor * high, "\u00b1 2 errors", ends, 0, 0.3)
    return [*error, charts.line(along, factor * mean, told, 0)]


def _key_axis(plan: Plan) -> dict[str, Any]:
    key = plan.key
    if key.categories:
        words = [charts.shown(word) for word in key.categories]
        return charts.axis(
            charts.shown(key.label), tickvals=list(range(len(words))), ticktext=words,
            range=[-0.6, len(words) - 0.4],
        )  # fmt: skip
    more = {"type": "log"} if key.logarithmic else {}
    return charts.axis(charts.shown(key.label), **more)


def indices(bars: Sequence[IndexBars]) -> Charts | None:
    """Return a chart of the indices of each output; None: there are none."""
    return Charts([_bars(each) for each in bars]) if bars else None


def _bars(each: IndexBars) -> Chart:
    data: list[dict[str, Any]] = []
    for number, (name, values, widths) in enumerate(
        zip(each.names, each.values, each.widths, strict=True)
    ):
        data.append({
            "type": "bar", "orientation": "h", "y": list(each.keys), "x": charts.numbers(values),
            "name": name, "marker": {"color": COLOURS[number], "opacity": 0.8},
        })  # fmt: skip
        if widths is not None:
            data[-1]["error_x"] = {"type": "data", "array": charts.numbers(widths), "thickness": 1}
    caption = f"Indices of the {final_name(each.output)}"
    lines = []
    if each.noise:
        caption += "; dotted: \N{GREEK SMALL LETTER DELTA} of a key without influence"
        style = {"color": "#222", "dash": "dot", "width": 1}
        lines = [{"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": each.noise,
                  "x1": each.noise, "line": style}]  # fmt: skip
    keys = charts.axis("", autorange="reversed", type="category")
    layout = charts.layout(charts.axis("index", range=[0, 1.05]), keys, shapes=lines)
    words = f"Bar chart: indices of the {final_name(each.output)} by key; the table has them"
    height = 160 + 55 * len(each.keys)
    return Chart(f"indices-{each.output}".replace("_", "-"), caption, words, data, layout, height)
