"""The charts of the explorer: panels of a history in figures of Bokeh, which change their data."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from ringwear_par.arrays import FloatArray
from ringwear_par.explorer.readings import Readings
from ringwear_par.pictures import run_panels
from ringwear_par.pictures.panel import Axis, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.result import Result
from ringwear_par.results.variables import DISPLAY_UNITS

#: share of a range that is left beyond what is drawn
_ROOM = 0.04
_DASHES = ("solid", "dashed", "dashdot", "dotted", "dotdash")
#: columns of both sources, whose labels are two entries of the legend
_LINE, _POINT = ("x", "y", "line", "colour", "dash", "width"), ("x", "y", "point", "colour")


class Chart:
    """A figure of lines and points, with a legend above it."""

    def __init__(self) -> None:
        self._lines = ColumnDataSource({name: [] for name in _LINE})
        self._points = ColumnDataSource({name: [] for name in _POINT})
        self.figure = figure(
            height=330, sizing_mode="stretch_width", x_range=Range1d(), y_range=Range1d(),
            tools="pan,box_zoom,wheel_zoom,reset,save",
        )  # fmt: skip
        self.figure.toolbar.logo = None
        self.figure.multi_line(
            "x", "y", line_color="colour", line_dash="dash", line_width="width",
            legend_field="line", source=self._lines,
        )  # fmt: skip
        self.figure.scatter(
            "x", "y", size=5, color="colour", fill_color=None, legend_field="point",
            source=self._points,
        )  # fmt: skip
        legend = self.figure.legend[0]
        legend.update(
            orientation="horizontal", ncols=4, border_line_color=None, padding=2, spacing=4,
            label_text_font_size="12px", location="left",
        )  # fmt: skip
        self.figure.add_layout(legend, "above")
        self.figure.axis.axis_label_text_font_style = "normal"

    def show(self, panel: Panel) -> None:
        """Draw a panel in the place of the one before."""
        lines = [_line(curve) for curve in panel.curves if curve.name]
        points = [
            (x, y, points.name, points.colour)
            for points in panel.points
            for x, y in zip(points.x, points.y, strict=True)
        ]
        self._lines.data = _columns(_LINE, lines)
        self._points.data = _columns(_POINT, points)
        marks: list[Curve | Points] = [*panel.curves, *panel.points]
        for axis, drawn, scale, values in (
            (panel.x, self.figure.x_range, self.figure.xaxis[0], [mark.x for mark in marks]),
            (panel.y, self.figure.y_range, self.figure.yaxis[0], [mark.y for mark in marks]),
        ):
            scale.axis_label = axis.label
            low, high = _ends(axis, np.concatenate([[], *values]))
            start, end = (high, low) if axis.reversed else (low, high)
            drawn.update(start=start, end=end, reset_start=start, reset_end=end)


def _columns(names: Sequence[str], rows: Sequence[tuple[Any, ...]]) -> dict[str, list[Any]]:
    columns = zip(*rows, strict=True) if rows else [()] * len(names)
    return {name: list(column) for name, column in zip(names, columns, strict=True)}


def _line(curve: Curve) -> tuple[Any, ...]:
    x, y = curve.x, curve.y
    if len(y) < len(x):  # means of the time between two states
        x, y = np.repeat(x, 2)[1:-1], np.repeat(y, 2)
    dash = _DASHES[curve.dash % len(_DASHES)]
    return x, y, curve.name, curve.colour, dash, curve.width


def _ends(axis: Axis, values: FloatArray) -> tuple[float, float]:
    """Return the ends of an axis: its own, or those of what is drawn with some room."""
    if axis.ends is not None:
        return axis.ends
    drawn = np.append(values[np.isfinite(values)], [0.0] if axis.zero else [])
    low, high = (float(drawn.min()), float(drawn.max())) if drawn.size else (0.0, 0.0)
    room = _ROOM * (high - low) or 0.5 * abs(high) or 1.0
    return low - room * (low != 0.0 or not axis.zero), high + room


# -- what they show --------------------------------------------------------------------------------


def wear(
    result: Result, others: Mapping[str, Result], row: int, readings: Sequence[Readings]
) -> Panel:
    """Return worn faces at some times and at one state, the ends of others, and measured ones."""
    bodies = run_panels.worn_bodies(result)
    curves = [
        _other(name, Curve(other.line.r, run_panels.worn_depth(other, body)[-1], "end"), number)
        for number, (name, other) in enumerate(others.items())
        for body in run_panels.worn_bodies(other)
    ]
    panel = run_panels.worn_faces(result, bodies)
    chosen = [
        run_panels.at_instant(result, run_panels.worn_depth(result, body)[row]) for body in bodies
    ]
    points = _points(readings, "wear", 1.0, 1e3)
    return replace(panel, curves=[*curves, *panel.curves, *chosen], points=points)


def pressure(result: Result, row: int) -> Panel:
    """Return the contact pressure at some times and at one state."""
    panel = run_panels.pressure(result)
    chosen = run_panels.at_instant(result, result.profiles["pressure"][row])
    return replace(panel, curves=[*panel.curves, chosen])


def history(
    result: Result, others: Mapping[str, Result], name: str, readings: Sequence[Readings]
) -> Panel:
    """Return a quantity over time beside that of others, and its readings."""
    end = float(result.histories["time"][-1])
    panel = run_panels.history([result], ["now"], name)
    curves = [
        _other(other_name, curve, number)
        for number, (other_name, other) in enumerate(others.items())
        for curve in run_panels.history([other], [""], name, end).curves
    ]
    points = _points(readings, name, 1.0 / time_unit(end)[1], DISPLAY_UNITS.get(name, ("", 1.0))[1])
    return replace(panel, curves=[*curves, *panel.curves], points=points)


def _other(name: str, curve: Curve, number: int) -> Curve:
    """Return a curve that the present one is compared with."""
    words = ", ".join(filter(None, (name, curve.name)))
    return replace(curve, name=words, colour=("#8a929a", COLOURS[3])[number], dash=1 + 2 * number)


def _points(readings: Sequence[Readings], panel: str, x: float, y: float) -> list[Points]:
    """Return the readings of a panel, in the units of its axes."""
    return [
        Points(x * one.x, y * one.y, one.name, COLOURS[(2 + number) % len(COLOURS)])
        for number, one in enumerate(readings)
        if one.panel == panel
    ]
