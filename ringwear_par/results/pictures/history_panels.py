"""Panels of histories over time, those of all results in one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import in_signs
from ringwear_par.errors import InputError
from ringwear_par.results.instants import time_unit
from ringwear_par.results.key_numbers import nominal_area
from ringwear_par.results.pictures.drawing import COLOURS, DASHES, set_legend
from ringwear_par.results.result import Result
from ringwear_par.results.variables import DISPLAY_UNITS, HISTORIES

#: as many points of a curve, or fewer, are marked
_FEW_POINTS = 20
#: letters of the labels in a line of a legend
_LEGEND_LETTERS = 34


@dataclass(frozen=True)
class HistoryPanel:
    """What is drawn over time.

    Parameters
    ----------
    label : of the axis, with the unit.
    curves : returns the curves of a result by their names, "" where there is one; (stored states,)
        or, between these, one fewer.
    whole : the end of the axis where all is 0.
    """

    label: str
    curves: Callable[[Result], dict[str, FloatArray]]
    whole: float = 1.0


def _stored(name: str, words: str) -> HistoryPanel:
    """Return the panel of a history that is stored."""
    unit, factor = DISPLAY_UNITS.get(name, (HISTORIES[name].unit, 1.0))
    return HistoryPanel(
        f"{words} ({in_signs(unit)})", lambda result: {"": factor * result.histories[name]}
    )


def _volumes(result: Result) -> dict[str, FloatArray]:
    """Return the worn volumes, mm^3, of the bodies that wear; of lower where none does."""
    found = {body: result.histories[f"worn_volume_{body}"] for body in ("lower", "upper")}
    return {body: v for body, v in found.items() if v.any()} or {"lower": found["lower"]}


def _rates(result: Result) -> dict[str, FloatArray]:
    """Return the mean depths worn off between stored states by their time, um/h."""
    hours = np.diff(result.histories["time"]) / 3600.0
    area = nominal_area(result)
    return {body: 1e3 * np.diff(v) / area / hours for body, v in _volumes(result).items()}


def _p_v(result: Result) -> dict[str, FloatArray]:
    """Return pressure times speed, meaned over the nominal area and between states, MPa m/s."""
    friction = result.attributes.get("friction")
    if not friction:
        why = "was stored without it" if friction is None else "is 0"
        raise InputError(
            f"{result.name}: pv needs the friction coefficient, which {why}; must be > 0"
        )
    power = np.diff(result.histories["dissipated_energy"]) / np.diff(result.histories["time"])
    return {"": 1e-3 * power / friction / nominal_area(result)}


def _through(result: Result) -> dict[str, FloatArray]:
    """Return the shares of the contact area that are worn through, %."""
    found = {
        body: 100.0 * result.layers[f"share_through_{body}"]
        for body in ("lower", "upper")
        if f"share_through_{body}" in result.layers
    }
    if not found:
        raise InputError(f"{result.name}: through needs a body with layers, of which it has none")
    return found


#: by name, as ``--panels`` has it
HISTORY_PANELS = {
    "penetration": _stored("penetration", "penetration depth"),
    "approach": _stored("approach", "approach"),
    "force": _stored("force", "axial force"),
    "torque": _stored("torque", "friction torque"),
    "energy": _stored("dissipated_energy", "energy dissipated"),
    "volume": HistoryPanel("worn volume (mm\N{SUPERSCRIPT THREE})", _volumes),
    "rate": HistoryPanel("wear rate, mean depth (\N{MICRO SIGN}m/h)", _rates),
    "through": HistoryPanel("worn through (% of area)", _through, whole=100.0),
    "pv": HistoryPanel("pressure \N{MULTIPLICATION SIGN} speed, mean (MPa m/s)", _p_v),
}


def draw_history(
    axes: Any, panel: HistoryPanel, results: Sequence[Result], labels: Sequence[str]
) -> None:
    """Draw a quantity of all results over time."""
    unit, seconds = time_unit(max(float(result.histories["time"][-1]) for result in results))
    lowest, highest, several = 0.0, 0.0, len(results) > 1
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        curves = panel.curves(result)
        time = result.histories["time"] / seconds
        for place, (name, values) in enumerate(curves.items()):
            between = len(values) < len(time)
            told = ([label] if several else []) + ([name] if len(curves) > 1 else [])
            style: dict[str, Any] = {
                "color": COLOURS[(number if several else place) % len(COLOURS)],
                "linestyle": DASHES[(number + place + number // len(COLOURS)) % len(DASHES)],
                "label": ", ".join(told),
            }
            if not len(values):  # one state has nothing between
                continue
            if between:  # means of the time between two states
                axes.step(time, np.append(values[:1], values), where="pre", **style)
            else:
                marker = "o" if len(time) <= _FEW_POINTS else ""
                axes.plot(time, values, marker=marker, markersize=2.5, **style)
            lowest = min(lowest, float(values.min(initial=0.0)))
            highest = max(highest, float(values.max(initial=0.0)))
    axes.set_xlim(left=0.0)
    if lowest >= 0.0:
        axes.set_ylim(0.0, 1.05 * highest or panel.whole)
    axes.set_xlabel(f"time ({unit})")
    axes.set_ylabel(panel.label)
    words = [text for text in axes.get_legend_handles_labels()[1] if text]
    if words:
        most = max(1, min(3, _LEGEND_LETTERS // (max(map(len, words)) + 5)))
        set_legend(axes, most)
