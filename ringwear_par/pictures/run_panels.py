"""Panels of a run: quantities over time, worn faces and pressure along the radius."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import in_signs
from ringwear_par.elasticity.sections import BODIES, BodyName
from ringwear_par.errors import InputError
from ringwear_par.pictures.panel import FEW_POINTS, Axis, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS, stage_colour
from ringwear_par.results import key_numbers
from ringwear_par.results.key_numbers import number_words, time_unit, time_words
from ringwear_par.results.result import Result
from ringwear_par.results.variables import DISPLAY_UNITS, HISTORIES, edge_elements
from ringwear_par.schedules import in_time

RADIUS = "distance to axis (mm)"
#: share of the width of the contact for which unworn faces are drawn beside it
_BESIDE = 0.15
#: multiple of the deepest wear within which the end of a layer below the face is drawn
_FAR = 1.5
#: end of a scale of pressures over the highest one that is drawn
_ROOM = 1.1
#: most times that a legend names
_NAMED = 8


@dataclass(frozen=True)
class HistoryPanel:
    """What is drawn over time."""

    #: of the axis, with the unit
    label: str
    #: returns the curves of a result by their names, "" where there is one; (stored states,) or,
    #: between these, one fewer
    curves: Callable[[Result], dict[str, FloatArray]]
    #: the end of the axis where all is 0
    whole: float = 1.0


def _stored(name: str, words: str) -> HistoryPanel:
    """Return the panel of a history that is stored."""
    unit, factor = DISPLAY_UNITS.get(name, (HISTORIES[name].unit, 1.0))
    return HistoryPanel(
        f"{words} ({in_signs(unit)})", lambda result: {"": factor * result.histories[name]}
    )


def _volumes(result: Result) -> dict[str, FloatArray]:
    """Return the worn volumes, mm^3, of the bodies that wear; of lower where none does."""
    volumes = {body: result.histories[f"worn_volume_{body}"] for body in ("lower", "upper")}
    return {body: v for body, v in volumes.items() if v.any()} or {"lower": volumes["lower"]}


def _rates(result: Result) -> dict[str, FloatArray]:
    """Return the mean depths worn off between stored states by their time, um/h."""
    hours = np.diff(result.histories["time"]) / 3600.0
    area = result.attributes["nominal_area"]
    return {body: 1e3 * np.diff(v) / area / hours for body, v in _volumes(result).items()}


def _through(result: Result) -> dict[str, FloatArray]:
    """Return the shares of the contact area that are worn through, %."""
    shares = {
        body: 100.0 * result.layers[f"share_through_{body}"]
        for body in ("lower", "upper")
        if f"share_through_{body}" in result.layers
    }
    if not shares:
        raise InputError(f"{result.name}: through needs a body with layers, of which it has none")
    return shares


#: by name, as ``--panels`` has it
HISTORY_PANELS = {
    "penetration": _stored("penetration", "penetration depth"),
    "approach": _stored("approach", "approach"),
    "force": _stored("force", "axial force"),
    "torque": _stored("torque", "friction torque"),
    "friction": HistoryPanel(
        "friction coefficient",
        lambda of: {
            "": in_time(key_numbers.schedule_of(of.attributes, "friction"), of.data["time"])
        },
    ),
    "energy": _stored("dissipated_energy", "energy dissipated"),
    "volume": HistoryPanel("worn volume (mm\N{SUPERSCRIPT THREE})", _volumes),
    "rate": HistoryPanel("wear rate, mean depth (\N{MICRO SIGN}m/h)", _rates),
    "through": HistoryPanel("worn through (% of area)", _through, whole=100.0),
    "pv": HistoryPanel(
        "p V at the mean radius (MPa m/s)",
        lambda result: {"": result.data["pressure_velocity"]},
    ),
}


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
            words = [label, name if len(values) > 1 else ""]
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
        except InputError:  # no layers
            continue
    return panels


def stored_field(result: Result, name: str) -> Any:
    """Return a field along the contact line at all stored states.

    Raises
    ------
    InputError : it is not stored, or of the last step only.
    """
    if name not in result.profiles:
        raise InputError(
            f"{result.name}: does not hold {name}; output.fields of its case left it out"
        )
    if result.profiles[name].ndim == 1:
        raise InputError(
            f"{result.name}: holds {name} of the last step only; must be computed with "
            'output.profiles = "all"'
        )
    return result.profiles[name]


def at_all_states(result: Result, field: str) -> bool:
    """Tell whether a field along the radius is stored at all states, not at the last one only."""
    return field in result.profiles and result.profiles[field].ndim == 2


def worn_bodies(result: Result) -> list[BodyName]:
    """Return the bodies whose stored profiles are drawn: those that wear, or the first."""
    bodies: list[BodyName] = [body for body in BODIES if at_all_states(result, f"wear_{body}")]
    return [body for body in bodies if result.profiles[f"wear_{body}"].any()] or bodies[:1]


def worn_faces(
    result: Result, bodies: Sequence[BodyName] | None = None, rows: Sequence[int] | None = None
) -> Panel:
    """Return the panel of worn depths, which grow downwards, with the ends of layers.

    Parameters
    ----------
    bodies : those to be drawn; None: those that wear. Of both, the upper one is dashed.
    rows : stored states; None: the default instants.
    """
    bodies = worn_bodies(result) if bodies is None else bodies
    both = len(bodies) > 1
    label = f"worn depth{'' if both else f' of {bodies[0]}'} (\N{MICRO SIGN}m)"
    r, (inner, outer) = result.line.r, result.line.edges[[0, -1]].tolist()
    curves = []
    for number, body in enumerate(bodies):
        drawn = at_states(result, worn_depth(result, body), rows)
        curves += [replace(curve, dash=number) for curve in drawn] if both else drawn
        deepest = float(result.profiles[f"wear_{body}"].max())
        for layer, end in enumerate(result.data.get(f"layer_end_{body}", ())):
            if end.min() > _FAR * deepest:
                continue
            name = f"end of layer {layer}" + f" of {body}" * both
            curves.append(Curve(r, 1e3 * end, name, "#666666", 3 - layer % 3, 1.0))
    beside = _BESIDE * (outer - inner)
    low, high = max(inner - beside, 0.0), outer + beside
    for ends in ([low, inner], [outer, high]):
        unworn = Curve(np.array(ends), np.zeros(2), "", "#666666", 0, 1.0)
        curves.append(unworn)
    return Panel(
        Axis(RADIUS, ends=(low, high)), Axis(label, reversed=True), label,
        "lower solid, upper dashed" if both else "", curves=curves,
    )  # fmt: skip


def pressure(result: Result, rows: Sequence[int] | None = None, top: float | None = None) -> Panel:
    """Return the panel of the contact pressure; elements at the contact edge are hollow points.

    Parameters
    ----------
    rows : stored states; None: the default instants.
    top : MPa, where the scale ends; None: above the highest pressure of all stored states, or
        where singular edges of the first instant are cut.
    """
    label, values = "contact pressure (MPa)", result.profiles["pressure"]
    time, highest = result.histories["time"], values.max(axis=1)
    top, peak, note = top or pressure_top(result), int(highest.argmax()), ""
    if highest[peak] > top:
        when = time_words(float(time[peak]), float(time[-1]))
        note = f"peak of {number_words(float(highest[peak]))} MPa at {when} not shown"
    drawn = stages(time) if rows is None else rows
    colours = stage_colours(len(drawn))
    marks = [
        Points(result.line.r[edge], values[row][edge], "contact edge", colour, 6.0, hollow=True)
        for row, colour in zip(drawn, colours, strict=True)
        if (edge := edge_elements(values[row]) & (values[row] > 0.0)).any()
    ]  # fmt: skip
    return Panel(
        Axis(RADIUS), Axis(label, ends=(0.0, top)), label, note,
        curves=at_states(result, values, rows), points=marks,
    )  # fmt: skip


def pressure_top(result: Result, rows: Sequence[int] | None = None) -> float:
    """Return where the scale of pressures, MPa, of some stored states ends; None: of all."""
    pressure = result.profiles["pressure"]
    drawn = float((pressure if rows is None else pressure[list(rows)]).max())
    return min(pressure_limit(result.line.area, pressure), _ROOM * drawn) or 1.0


def pressure_limit(area: FloatArray, pressure: FloatArray) -> float:
    """Return the pressure, MPa, that scales of states (s, n) on areas (n,) end with at most.

    Edges of the first instant are infinite: three times the highest mean over what touches.
    """
    touched = (pressure > 0.0) @ area
    return 3.0 * float((pressure @ area / np.where(touched > 0.0, touched, np.inf)).max())


def stages(time: FloatArray) -> list[int]:
    """Return the states (s,) that are drawn by default: the first step, four quarters of time."""
    instants = [time[min(1, len(time) - 1)], *(0.25 * q * time[-1] for q in range(1, 5))]
    return sorted({int(np.abs(time - instant).argmin()) for instant in instants})


def worn_depth(result: Result, body: BodyName) -> FloatArray:
    """Return the worn depth of a face, um, at all stored states."""
    return 1e3 * np.asarray(result.profiles[f"wear_{body}"])


def at_states(result: Result, values: Any, rows: Sequence[int] | None = None) -> list[Curve]:
    """Return a field along the radius at some stored states; None: the default instants."""
    time = result.histories["time"]
    rows = stages(time) if rows is None else rows
    styles = stage_styles(time[rows], float(time[-1]))
    return [
        Curve(result.line.r, values[row], *style) for row, style in zip(rows, styles, strict=True)
    ]


def stage_styles(times: FloatArray, end: float) -> list[tuple[str, str, int]]:
    """Return name, colour and dash of stages in time, s; of many, the last and some others."""
    every = -(-len(times) // _NAMED)
    names = [time_words(time, end) for time in times.tolist()]
    return [
        (names[i] if (len(times) - 1 - i) % every == 0 else "", colour, i if every == 1 else 0)
        for i, colour in enumerate(stage_colours(len(times)))
    ]


def stage_colours(count: int) -> list[str]:
    """Return the colours of stages in time."""
    return [stage_colour(float(share)) for share in np.linspace(1.0, 0.0, count)[::-1]]


def at_instant(result: Result, values: FloatArray) -> Curve:
    """Return a field along the radius at an instant that the reader chooses."""
    return Curve(result.line.r, values, "time chosen", COLOURS[1], 0, 2.5, marked=True)
