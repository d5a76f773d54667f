"""Panels of keys: what a fit knows of each, of pairs and of specimens; what designs would tell."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.schema import quantity_label, quantity_name
from ringwear_par.pictures.panel import Axis, Band, Bars, Curve, Label, Panel, Points
from ringwear_par.pictures.style import COLOURS

#: most specimens whose names have room
_NAMED = 12
#: probabilities between which axes show draws, bars of a density, most dots of a pair
_SHOWN, _BINS, _DOTS = (0.001, 0.999), 30, 1000
_LINE = "#808080"


def users_unit(entry: Mapping[str, Any]) -> tuple[str, float]:
    """Return the unit in which a key is drawn, "" for none, and how much it is in the case's.

    Parameters
    ----------
    entry : of the key, as in fit.json.
    """
    if (converted := entry.get("told")) is not None:
        return str(converted["unit"]), float(converted["scale"])
    return "" if entry["unit"] in ("1", "-") else str(entry["unit"]), 1.0


@dataclass(frozen=True)
class FittedKey:
    """A fitted key on an axis."""

    #: of the case key
    name: str
    #: of fit.json
    entry: Mapping[str, Any]
    #: (s,) draws of its values
    draws: FloatArray

    def scaled(self, values: Any) -> FloatArray:
        """Return values in the unit of the axis."""
        return np.asarray(values, dtype=float) / users_unit(self.entry)[1]

    @property
    def axis(self) -> Axis:
        """The axis of its values."""
        low, high = self.scaled(np.quantile(self.draws, _SHOWN)).tolist()
        ends = (low, high) if low < high else None
        return Axis(quantity_label(self.name, users_unit(self.entry)[0]), ends=ends)


def fitted_keys(outcome: Mapping[str, Any], draws: Mapping[str, FloatArray]) -> list[list[Panel]]:
    """Return the draws of each key, and before each of them its pairs with the keys before it.

    Parameters
    ----------
    outcome : the contents of fit.json.
    draws : values (s,), by key.
    """
    entries = outcome["parameters"].items()
    keys = [FittedKey(name, entry, draws[name]) for name, entry in entries]
    return [
        [*(_pair(first, key) for first in keys[:j]), _density(key, outcome["level"])]
        for j, key in enumerate(keys)
    ]


def _density(key: FittedKey, level: float) -> Panel:
    """Return the panel of the density of a key, relative to its largest, and its interval."""
    low, high = np.quantile(key.draws, _SHOWN)
    heights, borders = np.histogram(key.draws, bins=_BINS, range=(low, high))
    heights = np.repeat(heights / heights.max(initial=1), 2)
    x, upright = key.scaled(np.repeat(borders, 2)[1:-1]), np.array([0.0, 1.05])
    band = Band(x, 0.0 * heights, heights, "draws", _LINE, 0.35)
    curves = [
        Curve(key.scaled([end, end]), upright, f"{100 * level:g} % interval", _LINE, 1, 1.2)
        for end in key.entry["interval"] if end is not None
    ]  # fmt: skip
    curves.append(Curve(key.scaled([key.entry["estimate"]] * 2), upright, "median", COLOURS[1]))
    labels, verdict = [], key.entry["verdict"]
    if verdict != "identified":
        middle = float(key.scaled(0.5 * (low + high)))
        labels.append(Label(middle, 1.0, verdict))
    return Panel(
        key.axis, Axis("relative density", ends=(0.0, 1.1)), curves=curves, bands=[band],
        labels=labels,
    )  # fmt: skip


def _pair(first: FittedKey, second: FittedKey) -> Panel:
    """Return the panel of the draws of two keys."""
    every = max(1, len(first.draws) // _DOTS)
    x, y = (key.scaled(key.draws[::every]) for key in (first, second))
    middle = [np.atleast_1d(key.scaled(key.entry["estimate"])) for key in (first, second)]
    points = [Points(x, y, "", _LINE, 2.0), Points(middle[0], middle[1], "", COLOURS[1], 9.0)]
    return Panel(first.axis, second.axis, points=points)


def specimens(key: str, estimate: Mapping[str, Any], level: float) -> Panel:
    """Return the values of a key in each specimen, and the intervals of the material and the next.

    Parameters
    ----------
    estimate : of a key that scatters, as in fit.json.
    level : of its intervals.
    """
    entries, (unit, scale) = estimate["each"], users_unit(estimate)
    places = np.arange(len(entries), dtype=float)
    ends = np.array([-0.6, len(entries) - 0.4])
    bands = []
    for name, (low, high), opacity in (
        ("the next specimen", estimate["next"], 0.15),
        ("the material", estimate["interval"], 0.35),
    ):
        if low is not None and high is not None:
            name = f"{100 * level:g} % of {name}"
            low, high = np.full(2, low / scale), np.full(2, high / scale)
            bands.append(Band(ends, low, high, name, opacity=opacity))
    rows = [(entry["estimate"], *entry["interval"]) for entry in entries.values()]
    values, low, high = np.array(rows, dtype=float).T / scale
    drawn = [
        Points(places, values, "a specimen", COLOURS[1], 6.0,
               errors=np.array([values - low, high - values]))
    ]  # fmt: skip
    names = (
        tuple(entries) if len(entries) <= _NAMED else tuple(map(str, range(1, len(entries) + 1)))
    )
    material = Curve(ends, np.full(2, estimate["estimate"] / scale), "the material", COLOURS[0])
    return Panel(
        Axis("specimen", ends=(ends[0], ends[1]), categories=names),
        Axis(quantity_label(key, unit)), f"{quantity_name(key)}, of specimens",
        curves=[material], bands=bands, points=drawn,
    )  # fmt: skip


def design_panels(outcome: Mapping[str, Any]) -> list[Panel]:
    """Return bars of the predicted standard deviations of each key by the best designs."""
    names = tuple(design["name"].replace(" + ", "\n+ ") for design in outcome["designs"])
    places, panels = np.arange(len(names), dtype=float), []
    for key, scale in outcome["sd_scales"].items():
        values = np.array([design["sd"][key] for design in outcome["designs"]], dtype=float)
        bars = Bars(places, scale["factor"] * np.nan_to_num(values), "", COLOURS[0])
        label = f"sd of {quantity_label(key, scale['unit'])}"
        axes = Axis(label, zero=True), Axis("", reversed=True, categories=names)
        panels.append(Panel(*axes, bars=[bars]))
    return panels
