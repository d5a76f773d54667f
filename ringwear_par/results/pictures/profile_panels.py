"""Panels along the radius: worn profiles and contact pressures of a result at some times."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.stress.boundary_fields import BODIES
from ringwear_par.errors import InputError
from ringwear_par.results.instants import pressure_peak, time_words
from ringwear_par.results.layer_ends import ends_near
from ringwear_par.results.pictures.drawing import DASHES, set_legend, stage_colour
from ringwear_par.results.result import Result
from ringwear_par.results.variables import edge_elements

#: columns of the legend
_COLUMNS = 3
#: share of a panel's height that a label of a layer takes
_LABEL = 0.06


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


def _profiles(
    axes: Any, result: Result, rows: Sequence[int], *curves: Callable[[int], Any]
) -> None:
    """Draw curves at some of the stored states, all of them in the style of the state."""
    time = result.histories["time"]
    for number, row in enumerate(rows):
        for place, curve in enumerate(curves):
            axes.plot(
                result.line.r, curve(row), color=stage_colour(number, len(rows)),
                linestyle=DASHES[number % len(DASHES)],
                label=None if place else time_words(time[row], float(time[-1])),
            )  # fmt: skip
    axes.set_xlabel("distance to axis (mm)")


def draw_wear(axes: Any, result: Result, label: str, rows: Sequence[int]) -> None:
    """Draw worn profiles: the face of lower falls below 0, that of upper rises above it."""
    inner, outer = result.line.edges[[0, -1]]
    margin = 0.15 * (outer - inner)
    lower, upper = stored_field(result, "wear_lower"), stored_field(result, "wear_upper")
    ends = max(inner - margin, 0.0), outer + margin
    both = lower.any() and upper.any()
    if both:
        _profiles(axes, result, rows, lambda row: -1e3 * lower[row], lambda row: 1e3 * upper[row])
        axes.set_ylabel("height of worn faces (\N{MICRO SIGN}m)")
        for name, place, where in (("upper", 0.98, "top"), ("lower", 0.02, "bottom")):
            axes.text(
                0.5, place, f"face of {name}", ha="center", va=where, transform=axes.transAxes
            )
    elif upper.any():
        _profiles(axes, result, rows, lambda row: 1e3 * upper[row])
        axes.set_ylabel("height of worn face of upper (\N{MICRO SIGN}m)")
    else:
        _profiles(axes, result, rows, lambda row: -1e3 * lower[row])
        axes.set_ylabel("height of worn face of lower (\N{MICRO SIGN}m)")
    _draw_ends(axes, result)
    if both:
        low, high = axes.get_ylim()
        room = 0.1 * (high - low)
        axes.set_ylim(low - room, high + room)
    for start, end in ((ends[0], inner), (outer, ends[1])):
        axes.plot([start, end], [0, 0], color="0.4", linewidth=0.8)
    axes.set_xlim(*ends)
    set_legend(axes, _COLUMNS, label)


def _draw_ends(axes: Any, result: Result) -> None:
    """Draw where layers end that wear comes near, each with its number beside it."""
    ends = [end for body in BODIES for end in ends_near(result, body)]
    for number, end in enumerate(ends):
        below = end.body == "lower"
        depth = (-1e3 if below else 1e3) * end.depth
        axes.plot(
            result.line.r, depth, color="0.4", linewidth=0.8, linestyle=":",
            label=None if number else "end of layer",
        )  # fmt: skip
        axes.text(
            result.line.edges[-1], depth[-1], f" layer {end.layer}", color="0.3", fontsize=7.0,
            va="top" if below else "bottom", gid=f"layer of {end.body}",
        )  # fmt: skip


def merge_labels(axes: Any, _: Result) -> None:
    """Write numbers of layers together whose ends lie too close on the panel's final scale."""
    close = _LABEL * float(np.ptp(axes.get_ylim()))
    for body in BODIES:
        kept = None
        for text in [text for text in axes.texts if text.get_gid() == f"layer of {body}"]:
            number = text.get_text().split()[-1]
            if kept is None or abs(text.get_position()[1] - kept.get_position()[1]) > close:
                kept = text
                continue
            words = kept.get_text().replace("layer ", "layers ")
            kept.set_text(f"{words}, {number}")
            text.remove()


def draw_pressure(axes: Any, result: Result, label: str, rows: Sequence[int]) -> None:
    """Draw contact pressures; the singular edges of the first instant are cut."""
    pressure = stored_field(result, "pressure")
    _profiles(axes, result, rows, lambda row: pressure[row])
    _mark_edges(axes, result, rows, pressure)
    peak = pressure_peak(result)
    axes.set_ylim(0.0, peak.top(float(pressure[list(rows)].max())))
    axes.set_ylabel("contact pressure (MPa)")
    set_legend(axes, _COLUMNS, label)


def _mark_edges(axes: Any, result: Result, rows: Sequence[int], pressure: FloatArray) -> None:
    """Mark elements beside an edge of contact, whose pressures are the least certain."""
    label: str | None = "contact edge"
    for number, row in enumerate(rows):
        edges = edge_elements(pressure[row]) & (pressure[row] > 0.0)
        if edges.any():
            axes.plot(
                result.line.r[edges], pressure[row][edges], linestyle="", marker="o",
                markersize=4.0, markerfacecolor="none", color=stage_colour(number, len(rows)),
                label=label,
            )  # fmt: skip
            label = None


def draw_peak(axes: Any, result: Result) -> None:
    """Say in the title of the legend which peak is above the panel's final scale."""
    if note := pressure_peak(result).note(axes.get_ylim()[1]):
        title = axes.get_legend().get_title()
        title.set_text(f"{title.get_text()}\n{note}")
