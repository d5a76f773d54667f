"""Panels of a run: quantities over time, worn faces and pressure along the radius."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.stress.boundary_fields import BODIES, Which
from ringwear_par.errors import InputError
from ringwear_par.pictures.panels import FEW_POINTS, Axis, Curve, Panel, Points
from ringwear_par.results.instants import pressure_peak, stages, time_unit, time_words
from ringwear_par.results.layer_ends import ends_near
from ringwear_par.results.pictures.drawing import COLOURS, stage_colour
from ringwear_par.results.pictures.history_panels import HISTORY_PANELS
from ringwear_par.results.result import Result
from ringwear_par.results.variables import edge_elements

RADIUS = "distance to axis (mm)"


def history(
    results: Sequence[Result], labels: Sequence[str], quantity: str, end: float | None = None
) -> Panel:
    """Return the panel of a quantity over time, see ``HISTORY_PANELS``, of one or more results.

    Parameters
    ----------
    labels : of the results, "" for none.
    end : s, which chooses the unit of time; None: the end of the longest result.

    Raises
    ------
    InputError : a result does not hold it.
    """
    chart, several = HISTORY_PANELS[quantity], len(results) > 1
    end = end or max(float(result.histories["time"][-1]) for result in results)
    unit, seconds = time_unit(end)
    curves = []
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        time, values = result.histories["time"] / seconds, chart.curves(result)
        for place, (name, y) in enumerate(values.items()):
            words = [name if len(values) > 1 else "", label]
            curves.append(
                Curve(
                    time, y, ", ".join(filter(None, words)),
                    COLOURS[(number if several else place) % len(COLOURS)],
                    number + place + number // len(COLOURS), 2.0,
                    marked=len(y) == len(time) <= FEW_POINTS,
                )
            )  # fmt: skip
    flat = not any(curve.y.any() for curve in curves)
    y_axis = Axis(chart.label, ends=(0.0, chart.whole) if flat else None, zero=True)
    return Panel(Axis(f"time ({unit})", zero=True), y_axis, chart.label, curves=curves)


def histories(result: Result) -> dict[str, Panel]:
    """Return the panels of all quantities over time that a result holds, by name."""
    panels = {}
    for name in HISTORY_PANELS:
        try:
            panels[name] = history([result], [""], name)
        except InputError:  # p V without friction
            continue
    return panels


def height(result: Result, body: Which) -> FloatArray:
    """Return the height of a worn face, um, at all stored states: lower's is below 0."""
    sign = -1e3 if body == "lower" else 1e3
    return sign * np.asarray(result.profiles[f"wear_{body}"])


def stored_at_all_states(result: Result, field: str) -> bool:
    """Tell whether a field along the radius is stored at all states, not at the last one only."""
    return field in result.profiles and result.profiles[field].ndim == 2


def worn_bodies(result: Result) -> list[Which]:
    """Return the bodies whose stored profiles are drawn: those that wear, or the first."""
    bodies: list[Which] = [body for body in BODIES if stored_at_all_states(result, f"wear_{body}")]
    return [body for body in bodies if result.profiles[f"wear_{body}"].any()] or bodies[:1]


def worn_faces(result: Result, bodies: Sequence[Which]) -> Panel:
    """Return the panel of worn faces at the default instants, with the ends of their layers."""
    faces = "faces" if len(bodies) > 1 else f"face of {bodies[0]}"
    label = f"height of worn {faces} (\N{MICRO SIGN}m)"
    curves = []
    for body in bodies:
        sign = -1e3 if body == "lower" else 1e3
        curves += [
            Curve(result.line.r, sign * end.depth, f"end of layer {end.layer}", "#666666", 3, 1.0)
            for end in ends_near(result, body)
        ]
        curves += at_stages(result, height(result, body))
    note = "lower below 0, upper above" if len(bodies) > 1 else ""
    return Panel(Axis(RADIUS), Axis(label, zero=True), label, note, curves=curves)


def pressure(result: Result) -> Panel:
    """Return the panel of the contact pressure at the default instants.

    Singular edges of the first instant are cut; elements at the edge of contact are hollow points.
    """
    label, values = "contact pressure (MPa)", result.profiles["pressure"]
    peak = pressure_peak(result)
    top = peak.top(peak.highest)
    rows = stages(result.histories["time"])
    marks = [
        Points(
            result.line.r[edge], values[row][edge], "contact edge", stage(number, len(rows)), 6.0,
            hollow=True,
        )
        for number, row in enumerate(rows)
        if (edge := edge_elements(values[row]) & (values[row] > 0.0)).any()
    ]  # fmt: skip
    return Panel(
        Axis(RADIUS), Axis(label, ends=(0.0, top)), label, peak.note(top),
        curves=at_stages(result, values), points=marks,
    )  # fmt: skip


def at_stages(result: Result, values: Any) -> list[Curve]:
    """Return a field along the radius at the default instants."""
    time = result.histories["time"]
    rows = stages(time)
    return [
        Curve(
            result.line.r, values[row], time_words(time[row], float(time[-1])),
            stage(number, len(rows)), number,
        )
        for number, row in enumerate(rows)
    ]  # fmt: skip


def at_instant(result: Result, values: FloatArray) -> Curve:
    """Return a field along the radius at an instant that the reader chooses."""
    return Curve(result.line.r, values, "time chosen", COLOURS[1], 0, 2.5, marked=True)


@cache
def stage(number: int, count: int) -> str:
    """Return the colour of a stage in time."""
    return str(to_hex(stage_colour(number, count)))
