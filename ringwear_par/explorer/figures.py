"""Bokeh's figures of a history: worn faces, contact pressure, and quantities over time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from bokeh.models import ColumnDataSource, HoverTool, Legend, LegendItem
from bokeh.plotting import figure
from matplotlib.colors import to_hex

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.errors import InputError
from ringwear_par.explorer.measured import Laid
from ringwear_par.results.instants import pressure_peak, stages, time_unit, time_words
from ringwear_par.results.pictures.drawing import COLOURS, stage_colour
from ringwear_par.results.pictures.history_panels import HISTORY_PANELS
from ringwear_par.results.result import Result
from ringwear_par.results.variables import DISPLAY_UNITS

#: in the order of those of other figures
_DASHES = ("solid", "dashed", "dashdot", "dotted", "dotdash")
#: as many points of a curve, or fewer, are marked
_FEW_POINTS = 20
_GREY, _LEGEND = "#8a929a", 3
_KINDS, _COLUMNS = ("lines", "dots", "points"), ("x", "y", "label", "colour", "dash", "width")
_RADIUS = "distance to axis (mm)"
#: of an axis, beyond what is drawn
_ROOM = 0.04
_MICRO = "\N{MICRO SIGN}m"
#: readings by their kinds: name of the chart over time, and what they are times as much there
_OVER_TIME = {
    **{name: (name, DISPLAY_UNITS[name][1]) for name in ("penetration", "approach", "torque")},
    "volume": ("volume", 1.0), "mass": ("volume", 1.0),
}  # fmt: skip
#: labels of the charts that the second one over time may be; the first is that of penetration
MENU = {name: panel.label for name, panel in HISTORY_PANELS.items() if name != "penetration"}


#: abscissae and values
Curve = tuple[FloatArray, FloatArray]


class Line(NamedTuple):
    """A line of a chart."""

    x: FloatArray
    y: FloatArray
    label: str
    colour: str
    dash: str = "solid"
    width: float = 1.6


class Points(NamedTuple):
    """Readings in a chart."""

    x: FloatArray
    y: FloatArray
    label: str
    colour: str


def _chart(name: str) -> Any:
    """Return a figure of lines and points, whose sources the page fills."""
    plot = figure(
        name=name, height=320, sizing_mode="stretch_width", x_axis_label=" ", y_axis_label=" ",
        x_range=(0.0, 1.0), y_range=(0.0, 1.0), tools="pan,box_zoom,reset,save",
    )  # fmt: skip
    lines, dots, points = (
        ColumnDataSource({column: [] for column in _COLUMNS}, name=f"{name}-{kind}")
        for kind in _KINDS
    )
    plot.toolbar.logo = None
    drawn = plot.multi_line(
        "x", "y", line_color="colour", line_dash="dash", line_width="width", source=lines
    )
    plot.scatter("x", "y", size=4, color="colour", source=dots)
    read = plot.scatter("x", "y", size=5, line_color="colour", fill_color=None, source=points)
    plot.add_tools(HoverTool(renderers=[drawn, read], tooltips="$x{0.[000]}, $y{0.[000]}"))
    legend = Legend(
        items=[LegendItem(label={"field": "label"}, renderers=[r]) for r in (drawn, read)],
        orientation="horizontal", ncols=_LEGEND, location="left", border_line_color=None, padding=0,
        margin=0, spacing=6, glyph_width=22, glyph_height=12, label_height=12,
        label_text_font_size="12px", label_text_baseline="middle",
    )  # fmt: skip
    plot.add_layout(legend, "above")
    for axis in (plot.xaxis, plot.yaxis):
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = "13px"
        axis.major_label_text_font_size = "12px"
        axis.minor_tick_line_color = None
    plot.grid.grid_line_color = "#e4e4e4"
    plot.outline_line_color = None
    return plot


def figures() -> list[Any]:
    """Return the figures of the page, empty."""
    return [_chart(name) for name in ("wear", "pressure", "penetration", "other")]


def _told(
    lines: Sequence[Line], points: Sequence[Points], x: str, y: str, marks: bool = False
) -> dict[str, Any]:
    """Return what a figure is to show, and nothing else: columns of its sources, labels, ranges.

    Parameters
    ----------
    marks : whether lines of few points are marked at them.
    """
    few = [line for line in lines if marks and len(line.x) <= _FEW_POINTS]
    told: dict[str, Any] = {
        "lines": {
            "x": [line.x.tolist() for line in lines], "y": [line.y.tolist() for line in lines],
            "label": [line.label for line in lines], "colour": [line.colour for line in lines],
            "dash": [line.dash for line in lines], "width": [line.width for line in lines],
        },
    }  # fmt: skip
    for kind, sets in (("dots", few), ("points", points)):
        told[kind] = {
            "x": [x for one in sets for x in one.x.tolist()],
            "y": [y for one in sets for y in one.y.tolist()],
            "label": [one.label for one in sets for _ in one.x],
            "colour": [one.colour for one in sets for _ in one.x],
        }
    both: list[Sequence[Line | Points]] = [lines, points]
    ranges = [
        _range(np.concatenate([[], *(one[axis] for sets in both for one in sets)]), axis == 1)
        for axis in (0, 1)
    ]
    return {"sources": told, "x": x, "y": y, "ranges": ranges}


def _range(values: FloatArray, zero: bool) -> list[float]:
    """Return the ends of an axis for some values, with zero where that is asked for."""
    found = values[np.isfinite(values)]
    if not found.size:
        return [0.0, 1.0]
    low, high = float(found.min()), float(found.max())
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    room = _ROOM * ((high - low) or abs(high) or 1.0)
    return [low - room if low or not zero else low, high + room if high or not zero else high]


@dataclass(frozen=True, eq=False)
class Drawing:
    """What the figures are to show of a history.

    Parameters
    ----------
    result : with all profiles.
    first : that of the case file.
    case : of the result, which tells densities.
    share : of the whole time, which is chosen.
    menu : name of the second chart over time.
    laid : readings to be laid over it.
    """

    result: Result
    first: Result
    case: Case
    share: float
    menu: str
    laid: Sequence[Laid]

    @property
    def chosen(self) -> int:
        """The stored state nearest to the chosen time."""
        time = self.result.histories["time"]
        return int(np.abs(time - self.share * time[-1]).argmin())

    @property
    def chosen_time(self) -> str:
        """The chosen time in words."""
        time = self.result.histories["time"]
        return time_words(time[self.chosen], float(time[-1]))

    def told(self) -> dict[str, dict[str, Any]]:
        """Return what the figures show, by name."""
        return {
            "wear": self._wear(), "pressure": self._pressure(),
            "penetration": self._history("penetration"), "other": self._history(self.menu),
        }  # fmt: skip

    def _wear(self) -> dict[str, Any]:
        result, lines = self.result, self._stages(_faces)
        if self.first is not result:
            lines = [
                *(Line(x, y, "case file, end", _GREY, "dashed") for x, y in _faces(self.first, -1)),
                *lines,
            ]
        points = []
        for number, one in enumerate(self.laid):
            if one.along:
                sign = -1e3 if one.quantity == "profile.lower" else 1e3
                y = sign * one.values(self.case, result)
                points.append(Points(one.x, y, one.column, _colour(number)))
        worn = [b for b in ("lower", "upper") if result.profiles[f"wear_{b}"].any()] or ["lower"]
        where = "height of worn faces" if len(worn) > 1 else f"height of worn face of {worn[0]}"
        note = "lower below 0, upper above" if len(worn) > 1 else ""
        return _told(lines, points, _RADIUS, f"{where} ({_MICRO})") | {"note": note}

    def _pressure(self) -> dict[str, Any]:
        """Return pressures; singular edges are cut, as in the other figures."""
        told = _told(self._stages(_pressures), (), _RADIUS, "contact pressure (MPa)")
        peak = pressure_peak(self.result)
        top = peak.top(peak.highest)  # one scale at all times that may be chosen
        told["ranges"][1] = [0.0, top]
        return told | {"note": peak.note(top)}

    def _history(self, name: str) -> dict[str, Any]:
        result, first, panel = self.result, self.first, HISTORY_PANELS[name]
        unit, seconds = time_unit(float(result.histories["time"][-1]))
        note, lines = "", []
        try:
            if first is not result:
                lines = [
                    line._replace(colour=_GREY, dash="dashed", width=1.6)
                    for line in _curves(panel.curves(first), first, seconds, "case file")
                ]
            lines += _curves(panel.curves(result), result, seconds, "now")
        except InputError as error:  # p V without friction
            note = str(error).rpartition(": ")[2]
        points = []
        for number, one in enumerate(self.laid):
            kind = one.quantity.partition(".")[0]
            if not one.along and _OVER_TIME[kind][0] == name:
                y = _OVER_TIME[kind][1] * one.values(self.case, result)
                points.append(Points(one.x / seconds, y, one.column, _colour(number)))
        return _told(lines, points, f"time ({unit})", panel.label, marks=True) | {"note": note}

    def _stages(self, of: Callable[[Result, int], list[Curve]]) -> list[Line]:
        """Return lines along the radius: at some states, and at that which is chosen."""
        result, time = self.result, self.result.histories["time"]
        rows = stages(time)
        lines = [
            Line(x, y, time_words(time[row], float(time[-1])), _stage_colour(number, len(rows)),
                 _DASHES[number % len(_DASHES)])
            for number, row in enumerate(rows)
            for x, y in of(result, row)
        ]  # fmt: skip
        chosen = of(result, self.chosen)
        return lines + [Line(x, y, "time chosen", COLOURS[1], width=3.0) for x, y in chosen]


def _colour(number: int) -> str:
    """Return the colour of readings, which is not that of a curve."""
    return COLOURS[(2 + number) % len(COLOURS)]


@cache
def _stage_colour(number: int, count: int) -> str:
    return str(to_hex(stage_colour(number, count)))


def _faces(result: Result, row: int) -> list[Curve]:
    """Return the worn faces, um: that of lower falls below 0, that of upper rises above it."""
    faces = [
        sign * result.profiles[f"wear_{body}"]
        for body, sign in (("lower", -1e3), ("upper", 1e3))
    ]  # fmt: skip
    there = [face for face in faces if face.any()] or faces[:1]
    return [(result.line.r, face[row]) for face in there]


def _pressures(result: Result, row: int) -> list[Curve]:
    return [(result.line.r, result.profiles["pressure"][row])]


def _curves(
    curves: dict[str, FloatArray], result: Result, seconds: float, whose: str
) -> list[Line]:  # fmt: skip
    """Return histories as lines that are called by whose they are, and by their names."""
    time = result.histories["time"] / seconds
    lines = []
    for number, (name, y) in enumerate(curves.items()):
        x = time
        if len(y) < len(time):  # means of the time between two states
            x, y = np.repeat(time, 2)[1:-1], np.repeat(y, 2)
        label = f"{name}, {whose}" if len(curves) > 1 else whose
        lines.append(Line(x, y, label, COLOURS[number], _DASHES[number], 2.0))
    return lines
