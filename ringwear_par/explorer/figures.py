"""Figures of the explorer: the panels of a history, that of the case file and readings in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.errors import InputError
from ringwear_par.explorer.measured import MeasuredColumn
from ringwear_par.pictures import bokeh, run_panels
from ringwear_par.pictures.panel import Axis, Curve, Panel, Points
from ringwear_par.pictures.run_panels import HISTORY_PANELS
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.result import Result
from ringwear_par.results.variables import DISPLAY_UNITS

_GREY, _HEIGHT = "#8a929a", 320
#: histories that the present one is compared with
CASE_FILE, PINNED = "case file", "pinned"
#: readings by their kinds: name of the chart over time, and what they are times as much there
_OVER_TIME = {
    **{name: (name, DISPLAY_UNITS[name][1]) for name in ("penetration", "approach", "torque")},
    "volume": ("volume", 1.0), "mass": ("volume", 1.0),
}  # fmt: skip
#: labels of the charts that the second one over time may be; the first is that of penetration
MENU = {name: panel.label for name, panel in HISTORY_PANELS.items() if name != "penetration"}


def figures() -> list[Any]:
    """Return the figures of the page, empty."""
    empty = Panel(Axis(" "), Axis(" "))
    return [
        bokeh.chart(name, empty, _HEIGHT, changing=True)
        for name in ("wear", "pressure", "penetration", "other")
    ]


@dataclass(frozen=True, eq=False)
class Drawing:
    """What the figures are to show of a history."""

    #: with all profiles
    result: Result
    #: that it is compared with, by name: that of the case file, the pinned one
    references: Mapping[str, Result]
    #: of the result, which tells densities
    case: Case
    #: that is chosen, from 0 to 1 at the end of the history
    instant: float
    #: name of the second chart over time
    menu: str
    #: readings to be laid over it
    laid: Sequence[MeasuredColumn]

    @property
    def row(self) -> int:
        """The stored state nearest to the chosen time."""
        time = self.result.histories["time"]
        return int(np.abs(time - self.instant * time[-1]).argmin())

    @property
    def chosen_time(self) -> str:
        """The chosen time in words."""
        time = self.result.histories["time"]
        return time_words(time[self.row], float(time[-1]))

    def columns(self) -> dict[str, dict[str, Any]]:
        """Return the columns, labels and ranges of the figures, by name."""
        panels = {
            "wear": self._wear(), "pressure": self._pressure(),
            "penetration": self._history("penetration"), "other": self._history(self.menu),
        }  # fmt: skip
        return {
            name: {
                "sources": bokeh.changing_columns(panel), "ranges": bokeh.ranges_of(panel),
                "x": panel.x.label, "y": panel.y.label, "note": panel.note,
            }
            for name, panel in panels.items()
        }  # fmt: skip

    def _wear(self) -> Panel:
        bodies = run_panels.worn_bodies(self.result)
        panel = run_panels.worn_faces(self.result, bodies)
        depths = [run_panels.worn_depth(self.result, body) for body in bodies]
        before = [
            _before(
                name, Curve(reference.line.r, run_panels.worn_depth(reference, body)[-1]), "end"
            )
            for name, reference in self.references.items()
            for body in run_panels.worn_bodies(reference)
        ]
        points = []
        for number, readings in enumerate(self.laid):
            if readings.along:
                y = 1e3 * readings.values(self.case, self.result)
                points.append(_points(readings, readings.x, y, number))
        chosen = [run_panels.at_instant(self.result, depth[self.row]) for depth in depths]
        return replace(panel, curves=[*before, *panel.curves, *chosen], points=points)

    def _pressure(self) -> Panel:
        panel = run_panels.pressure(self.result)
        chosen = run_panels.at_instant(self.result, self.result.profiles["pressure"][self.row])
        return replace(panel, curves=[*panel.curves, chosen])

    def _history(self, name: str) -> Panel:
        end = float(self.result.histories["time"][-1])
        try:
            panel = run_panels.history([self.result], ["now"], name)
            before = [
                _before(reference_name, curve, "")
                for reference_name, reference in self.references.items()
                for curve in run_panels.history([reference], [""], name, end).curves
            ]
        except InputError as error:  # no layers
            unit, _ = time_unit(end)
            label = HISTORY_PANELS[name].label
            reason = str(error).rpartition(": ")[2]
            return Panel(Axis(f"time ({unit})"), Axis(label, zero=True), note=reason)
        points = []
        for number, readings in enumerate(self.laid):
            chart, factor = _OVER_TIME.get(readings.quantity.partition(".")[0], ("", 1.0))
            if chart == name:
                y = factor * readings.values(self.case, self.result)
                points.append(_points(readings, readings.x / time_unit(end)[1], y, number))
        return replace(panel, curves=[*before, *panel.curves], points=points)


def _before(reference_name: str, curve: Curve, when: str) -> Curve:
    """Return a curve of the case file or of the pinned numbers."""
    name = ", ".join(filter(None, (reference_name, curve.name, when)))
    colour, dash, width = (COLOURS[3], 1, 2.0) if reference_name == PINNED else (_GREY, 3, 1.6)
    return replace(curve, name=name, colour=colour, dash=dash, width=width)


def _points(readings: MeasuredColumn, x: Any, y: Any, number: int) -> Points:
    """Return readings, whose colour is not that of a curve."""
    colour = COLOURS[(2 + number) % len(COLOURS)]
    return Points(x, y, readings.column, colour, hollow=True)
