"""Charts of plotly, in the style of the other figures: axes, lines, histories, worn profiles."""

import html
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from ringwear_par.arrays import IntArray
from ringwear_par.elasticity.stress.boundary_fields import BODIES, Which
from ringwear_par.errors import InputError
from ringwear_par.reports.blocks import Chart, Charts
from ringwear_par.results.instants import pressure_peak, stages, time_unit, time_words
from ringwear_par.results.layer_ends import ends_near
from ringwear_par.results.pictures.drawing import COLOURS, stage_colour
from ringwear_par.results.pictures.history_panels import HISTORY_PANELS
from ringwear_par.results.result import Result

#: as matplotlib's in ``drawing``
DASHES = ("solid", "dash", "dashdot", "dot", "longdash")
#: digits that a screen shows
_DIGITS = 7
#: most instants of a slider
_INSTANTS = 120
#: as many points of a curve, or fewer, are marked
_FEW_POINTS = 20
_AXIS = {
    "showline": True, "linecolor": "#444", "ticks": "outside", "gridcolor": "#e4e4e4",
    "zeroline": False, "automargin": True, "exponentformat": "power", "minexponent": 6,
}  # fmt: skip


def numbers(values: Any) -> list[float | None]:
    """Return values as a page tells them: as many digits as can be seen, None for no number."""
    return [float(f"{v:.{_DIGITS}g}") if np.isfinite(v) else None for v in np.ravel(values)]


def shown(text: str) -> str:
    """Return a text of a user as plotly draws it, letter by letter."""
    return html.escape(text)


def axis(title: str, **more: Any) -> dict[str, Any]:
    """Return an axis of plotly."""
    return {**_AXIS, "title": {"text": title}, **more}


def layout(x: dict[str, Any], y: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return the layout of a chart with a legend above it, where it covers nothing."""
    return {
        "xaxis": x, "yaxis": y, "showlegend": True, "hovermode": "closest",
        "legend": {"orientation": "h", "x": 0, "xanchor": "left", "y": 1.02, "yanchor": "bottom"},
        "margin": {"l": 60, "r": 15, "t": 75 if more.get("showlegend", True) else 30, "b": 45},
        "font": {"size": 12, "color": "#222"}, "paper_bgcolor": "#fff", "plot_bgcolor": "#fff",
        **more,
    }  # fmt: skip


def line(x: Any, y: Any, name: str, number: int, **more: Any) -> dict[str, Any]:
    """Return a curve, its colour and dashes by its number."""
    style = {"color": COLOURS[number % len(COLOURS)], "dash": DASHES[number % len(DASHES)]}
    return {"x": numbers(x), "y": numbers(y), "name": name, "mode": "lines", "line": style, **more}


def shade(number: int, opacity: float) -> str:
    """Return a colour of ``COLOURS`` that one sees through."""
    red, green, blue = (int(COLOURS[number][i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity})"


def band(
    x: Any, low: Any, high: Any, name: str, ends: tuple[str, str], number: int, opacity: float,
    width: float = 0.0, dash: str = "solid",
) -> list[dict[str, Any]]:  # fmt: skip
    """Return a ribbon between two curves, each part between gaps (NaN) by itself, and its ends."""
    xs: list[float | None] = []
    ys: list[float | None] = []
    for part in np.ma.clump_unmasked(np.ma.masked_invalid(low + high + x)):
        xs += [*numbers(x[part]), *numbers(x[part][::-1]), None]
        ys += [*numbers(low[part]), *numbers(high[part][::-1]), None]
    ribbon = {
        "x": xs[:-1], "y": ys[:-1], "name": name, "mode": "lines", "line": {"width": 0},
        "fill": "toself", "fillcolor": shade(number, opacity), "hoverinfo": "skip",
        "meta": "aside",
    }  # fmt: skip
    style = {"color": COLOURS[number], "width": width, "dash": dash}
    drawn = [
        {**line(x, end, word, number, line=style), "showlegend": False}
        for end, word in ((low, ends[0]), (high, ends[1]))
    ]
    return [ribbon, *drawn]


def histories(result: Result) -> Charts:
    """Return a chart of each quantity over time that the result tells."""
    time = result.histories["time"]
    unit, seconds = time_unit(float(time[-1]))
    charts = []
    for name, panel in HISTORY_PANELS.items():
        try:
            curves = panel.curves(result)
        except InputError:  # p V without friction
            continue
        data = []
        for number, (told, values) in enumerate(curves.items()):
            if len(values) < len(time):  # means of the time between two states
                shape = {"line": {**line([], [], "", number)["line"], "shape": "vh"}}
                values = np.append(values[:1], values)
                data.append(line(time / seconds, values, told, number) | shape)
            else:
                mode = "lines+markers" if len(time) <= _FEW_POINTS else "lines"
                data.append(line(time / seconds, values, told, number, mode=mode))
        nothing = not any(values.any() for values in curves.values())
        y = {"range": [0.0, panel.whole]} if nothing else {"rangemode": "tozero"}
        charts.append(
            Chart(
                name, panel.label, f"Line chart: {panel.label} over time ({unit})", data,
                layout(
                    axis(f"time ({unit})", rangemode="tozero"),
                    axis(panel.label, **y), showlegend=len(curves) > 1,
                ),
            )
        )  # fmt: skip
    return Charts(charts)


def profiles(result: Result) -> Charts | None:
    """Return worn faces and pressure at five instants and at that of a slider; None: not stored."""
    there = {name: values for name, values in result.profiles.items() if values.ndim == 2}
    faces = [
        (name, sign, there[f"wear_{name}"])
        for name, sign in zip(BODIES, (-1.0, 1.0), strict=True)
        if f"wear_{name}" in there
    ]
    faces = [face for face in faces if face[2].any()] or faces[:1]
    if not faces and "pressure" not in there:
        return None
    time = result.histories["time"]
    end = float(time[-1])
    instants = np.unique(np.linspace(0, len(time) - 1, _INSTANTS).round().astype(int))
    rows = stages(time)
    told = [time_words(time[row], end) for row in rows]
    charts = [
        _profile(
            result, f"wear-{name}", f"Height of worn face of {name} (\N{MICRO SIGN}m)",
            sign * 1e3 * wear, rows, told, instants, _ends(result, name, sign),
        )
        for name, sign, wear in faces
    ]  # fmt: skip
    if "pressure" in there:
        charts.append(_pressure(result, there["pressure"], rows, told, instants))
    return Charts(charts, [time_words(time[row], end) for row in instants], len(instants) - 1)


def _profile(
    result: Result, name: str, label: str, values: Any, rows: Sequence[int], told: Sequence[str],
    instants: IntArray, beside: Sequence[dict[str, Any]] = (), **y: Any,
) -> Chart:  # fmt: skip
    """Return curves along the radius: some that stay, and that of the slider, the last.

    Parameters
    ----------
    rows : states of the curves that stay.
    beside : other curves that do.
    """
    r = numbers(result.line.r)
    data: list[dict[str, Any]] = [
        *beside,
        *(
        {
            "x": r, "y": numbers(values[row]), "name": word, "mode": "lines",
            "line": {
                "color": to_hex(stage_colour(number, len(rows))),
                "dash": DASHES[number % len(DASHES)], "width": 1.5,
            },
        }
        for number, (row, word) in enumerate(zip(rows, told, strict=True))
        ),
    ]  # fmt: skip
    frames = [numbers(values[row]) for row in instants]
    data.append(
        {
            "x": r, "y": frames[-1], "name": "time chosen", "mode": "lines+markers",
            "line": {"color": COLOURS[1], "width": 2.5}, "marker": {"size": 4},
        }
    )  # fmt: skip
    words = f"Line chart: {label} over the distance to the axis (mm) at {', '.join(told)}"
    x = axis("distance to axis (mm)")
    return Chart(name, label, words, data, layout(x, axis(label, **y)), 400, frames)


def _ends(result: Result, body: Which, sign: float) -> list[dict[str, Any]]:
    """Return the curves at which layers end that wear comes near."""
    style = {"color": "#666", "dash": "dot", "width": 1}
    return [
        line(result.line.r, sign * 1e3 * end.depth, f"end of layer {end.layer}", 0, line=style)
        for end in ends_near(result, body)
    ]


def _pressure(
    result: Result, pressure: Any, rows: Sequence[int], told: Sequence[str], instants: IntArray
) -> Chart:
    """Return pressures; singular edges of the first instant are cut, as in the other figures."""
    label, peak = "contact pressure (MPa)", pressure_peak(result)
    top = peak.top(float(pressure[np.union1d(rows, instants)].max()))
    chart = _profile(result, "pressure", label, pressure, rows, told, instants, range=[0.0, top])
    note = peak.note(top)
    return replace(chart, caption=f"{label}, {note}") if note else chart
