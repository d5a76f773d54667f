"""Bokeh's figures of a history: worn faces, contact pressure, and quantities over time."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from bokeh.models import ColumnDataSource, HoverTool, Legend, LegendItem
from bokeh.plotting import figure
from matplotlib.colors import to_hex

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.errors import InputError
from ringwear_par.explorer.measured import Laid
from ringwear_par.results.drawing import COLOURS, stage_colour, time_unit
from ringwear_par.results.history_panels import HISTORY_PANELS
from ringwear_par.results.result import Result

#: in the order of those of other figures
_DASHES = ("solid", "dashed", "dashdot", "dotted", "dotdash")
_QUARTERS = 4
#: as many points of a curve, or fewer, are marked
_FEW_POINTS = 20
_GREY, _LEGEND = "#8a929a", 4
_MICRO = "\N{MICRO SIGN}m"
#: readings by their kinds: name of the chart over time, and what they are times as much there
_OVER_TIME = {
    "penetration": ("penetration", 1e3), "approach": ("approach", 1e3), "torque": ("torque", 1e-3),
    "volume": ("volume", 1.0), "mass": ("volume", 1.0),
}  # fmt: skip
#: labels of the charts that the second one over time may be; the first is that of penetration
MENU = {name: panel.label for name, panel in HISTORY_PANELS.items() if name != "penetration"}


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


class Chart:
    """A figure of lines and points, all of which are drawn anew at once.

    Parameters
    ----------
    name : of its element on the page.
    marks : whether lines of few points are marked at them.
    """

    def __init__(self, name: str, marks: bool = False) -> None:
        self._marks = marks
        self.figure = plot = figure(
            name=name, height=300, sizing_mode="stretch_width", x_axis_label=" ", y_axis_label=" ",
            tools="pan,box_zoom,reset,save", toolbar_location="right",
        )  # fmt: skip
        self._lines, self._dots, self._points = (ColumnDataSource() for _ in range(3))
        self.draw([])
        plot.toolbar.logo = None
        lines = plot.multi_line(
            "x", "y", line_color="colour", line_dash="dash", line_width="width", source=self._lines
        )
        plot.scatter("x", "y", size=4, color="colour", source=self._dots)
        points = plot.scatter(
            "x", "y", size=5, line_color="colour", fill_color=None, source=self._points
        )
        plot.add_tools(HoverTool(renderers=[lines, points], tooltips="$x{0.[000]}, $y{0.[000]}"))
        legend = Legend(
            items=[LegendItem(label={"field": "label"}, renderers=[r]) for r in (lines, points)],
            orientation="horizontal", ncols=_LEGEND, border_line_color=None, padding=0, margin=0,
            spacing=10, glyph_width=18, label_text_font_size="12px",
        )  # fmt: skip
        plot.add_layout(legend, "above")
        for axis in (plot.xaxis, plot.yaxis):
            axis.axis_label_text_font_style = "normal"
            axis.axis_label_text_font_size = "13px"
            axis.major_label_text_font_size = "12px"
            axis.minor_tick_line_color = None
        plot.grid.grid_line_color = "#e4e4e4"
        plot.outline_line_color = None

    def draw(
        self, lines: Sequence[Line], points: Sequence[Points] = (), x: str = "", y: str = ""
    ) -> None:
        """Draw some lines and points, and no others; x and y are the axes' labels."""
        self._lines.data = {
            "x": [line.x for line in lines], "y": [line.y for line in lines],
            "label": [line.label for line in lines], "colour": [line.colour for line in lines],
            "dash": [line.dash for line in lines], "width": [line.width for line in lines],
        }  # fmt: skip
        few = [line for line in lines if self._marks and len(line.x) <= _FEW_POINTS]
        for source, sets in ((self._dots, few), (self._points, points)):
            source.data = {
                "x": np.concatenate([[], *(one.x for one in sets)]),
                "y": np.concatenate([[], *(one.y for one in sets)]),
                "label": [one.label for one in sets for _ in one.x],
                "colour": [one.colour for one in sets for _ in one.x],
            }
        for axis, label in ((self.figure.xaxis, x), (self.figure.yaxis, y)):
            axis.axis_label = label


class Figures:
    """The charts of the page."""

    def __init__(self) -> None:
        self.wear, self.pressure = Chart("wear"), Chart("pressure")
        self.penetration, self.other = Chart("penetration", True), Chart("other", True)

    @property
    def roots(self) -> list[Any]:
        """What belongs on the page."""
        charts = self.wear, self.pressure, self.penetration, self.other
        return [chart.figure for chart in charts]

    def draw(
        self, result: Result, first: Result, case: Case, share: float, menu: str,
        laid: Sequence[Laid],
    ) -> tuple[str, str]:  # fmt: skip
        """Draw a history; return its chosen time, and what is cut off the pressure, in words.

        Parameters
        ----------
        result : with all profiles.
        first : that of the case file.
        case : of the result, which tells densities.
        share : of the whole time, which is chosen.
        menu : name of the second chart over time.
        laid : readings to be laid over it.
        """
        time = result.histories["time"]
        unit, seconds = time_unit(float(time[-1]))
        chosen = int(np.abs(time - share * time[-1]).argmin())
        wished = [time[min(1, len(time) - 1)], *(time[-1] * q / _QUARTERS for q in range(1, 5))]
        rows = [int(row) for row in np.unique([np.abs(time - t).argmin() for t in wished])]
        self._draw_wear(result, first, case, rows, chosen, laid)
        cut = self._draw_pressure(result, rows, chosen)
        self._draw_history(self.penetration, "penetration", result, first, case, laid)
        self._draw_history(self.other, menu, result, first, case, laid)
        return f"{time[chosen] / seconds:.4g} {unit}", cut

    def _draw_wear(
        self, result: Result, first: Result, case: Case, rows: Sequence[int], chosen: int,
        laid: Sequence[Laid],
    ) -> None:  # fmt: skip
        lines = _stages(result, rows, chosen, _faces)
        if first is not result:
            lines.insert(0, _line(first, -1, _faces, "case file, end", _GREY, "dashed"))
        points = []
        for number, one in enumerate(laid):
            if one.along:
                sign = -1e3 if one.quantity == "profile.lower" else 1e3
                points.append(
                    Points(one.x, sign * one.values(case), one.column, _colour(number))
                )
        worn = [b for b in ("lower", "upper") if result.profiles[f"wear_{b}"].any()] or ["lower"]
        where = {
            ("lower",): "worn face of lower", ("upper",): "worn face of upper",
            ("lower", "upper"): "worn faces: lower below 0, upper above",
        }[tuple(worn)]  # fmt: skip
        self.wear.draw(lines, points, "distance to axis (mm)", f"{where} ({_MICRO})")

    def _draw_pressure(self, result: Result, rows: Sequence[int], chosen: int) -> str:
        """Draw pressures, singular edges cut as in the other figures; return what is cut."""
        shown = [*rows, chosen]
        pressure = result.profiles["pressure"][shown]
        lines = _stages(result, rows, chosen, _pressures)
        label = "contact pressure (MPa)"
        self.pressure.draw(lines, (), "distance to axis (mm)", label)
        touched = (pressure > 0.0) @ result.line.area
        force = result.histories["force"][shown]
        top = 3.0 * float((force / np.where(touched > 0.0, touched, np.inf)).max())
        highest = float(pressure.max())
        self.pressure.figure.y_range.update(
            start=0.0, end=min(top, 1.1 * highest) if highest > 0.0 else 1.0
        )
        return f"its peak of {highest:.0f} MPa is cut" if highest > top > 0.0 else ""

    def _draw_history(
        self, chart: Chart, name: str, result: Result, first: Result, case: Case,
        laid: Sequence[Laid],
    ) -> None:  # fmt: skip
        panel = HISTORY_PANELS[name]
        unit, seconds = time_unit(float(result.histories["time"][-1]))
        try:
            lines = _curves(panel.curves(result), result, seconds)
            if first is not result:
                before = _curves(panel.curves(first), first, seconds)
                lines = [
                    *(
                        line._replace(
                            label=f"case file {line.label}".strip(), colour=_GREY, dash="dashed"
                        )
                        for line in before
                    ),
                    *lines,
                ]
        except InputError:  # p V without friction
            lines = []
        points = []
        for number, one in enumerate(laid):
            kind = one.quantity.partition(".")[0]
            if not one.along and _OVER_TIME[kind][0] == name:
                factor = _OVER_TIME[kind][1]
                points.append(
                    Points(one.x / seconds, factor * one.values(case), one.column, _colour(number))
                )
        chart.draw(lines, points, f"time ({unit})", panel.label)


def _colour(number: int) -> str:
    """Return the colour of readings, which is not that of a curve."""
    return COLOURS[(2 + number) % len(COLOURS)]


def _faces(result: Result, row: int) -> tuple[FloatArray, FloatArray]:
    """Return the worn faces, um: that of lower falls below 0, that of upper rises above it."""
    faces = [
        sign * result.profiles[f"wear_{body}"]
        for body, sign in (("lower", -1e3), ("upper", 1e3))
    ]  # fmt: skip
    there = [face for face in faces if face.any()] or faces[:1]
    nothing = np.array([np.nan])
    if len(there) == 1:
        return result.line.r, there[0][row]
    r = result.line.r
    return np.concatenate([r, nothing, r]), np.concatenate([there[0][row], nothing, there[1][row]])


def _pressures(result: Result, row: int) -> tuple[FloatArray, FloatArray]:
    return result.line.r, result.profiles["pressure"][row]


def _line(
    result: Result, row: int, of: Any, label: str, colour: str, dash: str, width: float = 1.6
) -> Line:
    x, y = of(result, row)
    return Line(x, y, label, colour, dash, width)


def _stages(result: Result, rows: Sequence[int], chosen: int, of: Any) -> list[Line]:
    """Return lines along the radius: at some states, and at that which is chosen."""
    time = result.histories["time"]
    unit, seconds = time_unit(float(time[-1]))
    lines = [
        _line(result, row, of, f"{time[row] / seconds:.4g} {unit}",
              to_hex(stage_colour(number, len(rows))), _DASHES[number % len(_DASHES)])
        for number, row in enumerate(rows)
    ]  # fmt: skip
    return [*lines, _line(result, chosen, of, "time chosen", COLOURS[1], "solid", 3.0)]


def _curves(curves: dict[str, FloatArray], result: Result, seconds: float) -> list[Line]:
    time = result.histories["time"] / seconds
    lines = []
    for number, (name, y) in enumerate(curves.items()):
        x = time
        if len(y) < len(time):  # means of the time between two states
            x, y = np.repeat(time, 2)[1:-1], np.repeat(y, 2)
        lines.append(Line(x, y, name or "now", COLOURS[number], _DASHES[number], 2.0))
    return lines
