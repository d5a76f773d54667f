"""Panels of keys: what a fit knows of each, of pairs and of specimens; what designs would tell."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.schema import quantity_label, quantity_name
from ringwear_par.cases.units import in_signs
from ringwear_par.pictures.panel import GREY, Axis, Band, Bars, Cells, Curve, Label, Panel, Points
from ringwear_par.pictures.style import COLOURS

#: distance of a specimen's values, by its own readings and by all, from its middle
_ASIDE = 0.12
#: from an estimate to the ends of a symmetric interval
_BOTH = np.array([-1.0, 1.0])
#: most specimens whose names have room
_NAMED = 12
#: probabilities of ellipses
_LEVELS = (0.68, 0.95)
#: sd on both sides of an estimate that an axis of a key shows, and points of a curve over it
_WIDTH_SD, _FINE = 4.0, 161
#: share of a limit that an axis shows on both sides of it
_AROUND = 0.5
_LINE, _DIGITS = "#808080", str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074"
                                          "\u2075\u2076\u2077\u2078\u2079")  # fmt: skip


def users_unit(entry: Mapping[str, Any]) -> tuple[str, float]:
    """Return the unit in which a key is drawn, "" for none, and how much it is in the case's.

    Parameters
    ----------
    entry : of the key, as in fit.json.
    """
    if (converted := entry.get("told")) is not None:
        return str(converted["unit"]), float(converted["scale"])
    return "" if entry["unit"] in ("1", "-") else str(entry["unit"]), 1.0


def _power(largest: float) -> int:
    """Return the power of ten that numbers beside an axis leave out."""
    power = math.floor(math.log10(largest)) if largest else 0
    return 0 if -3 <= power < 4 else power


def _unit_with_power(unit: str, power: int) -> str:
    times = f"10{str(power).translate(_DIGITS)}" if power else ""
    return " ".join(filter(None, (times, in_signs(unit))))


@dataclass(frozen=True)
class FittedKey:
    """A fitted key on an axis."""

    #: of the case key
    name: str
    #: of fit.json
    entry: Mapping[str, Any]
    #: whether its unknown is the logarithm of its value
    log: bool
    #: of the unknown, infinite where the readings give none
    sd: float
    #: of the posterior, (s,) float; None for none
    samples: FloatArray | None

    def values(self, shifts: FloatArray) -> FloatArray:
        """Return values that are so many of the unknown's units off the estimate, within bounds."""
        at = self.entry["estimate"]
        moved = at * np.exp(np.clip(shifts, -700.0, 700.0)) if self.log else at + shifts
        return np.clip(moved, *self.entry["bounds"])

    @property
    def is_known(self) -> bool:
        """Whether the readings give it an interval."""
        return self.entry["verdict"] != "not identified" and math.isfinite(self.sd)

    @property
    def is_bare_limit(self) -> bool:
        """Whether limits alone bound it, on one side."""
        return self.entry["verdict"] == "at bound" and self.entry["sd"] is None

    @property
    def ends(self) -> tuple[float, float] | None:
        """The ends of its axis; None: what is drawn there."""
        ends = [float(self.entry["estimate"])]
        if self.is_bare_limit:
            (limit,) = (end for end in self.entry["interval"] if end is not None)
            ends = [(1.0 - _AROUND) * limit, (1.0 + _AROUND) * limit]
        elif self.is_known:
            ends += self.values(self.sd * np.array([-_WIDTH_SD, _WIDTH_SD])).tolist()
        if self.samples is not None:
            ends += np.quantile(self.samples, [0.001, 0.999]).tolist()
        low, high = min(ends), max(ends)
        return (low, high) if low < high else None

    @property
    def power(self) -> int:
        """The power of ten that numbers beside its axis leave out."""
        largest = max(map(abs, self.ends or (float(self.entry["estimate"]),)))
        return _power(largest / users_unit(self.entry)[1])

    def scaled(self, values: Any) -> FloatArray:
        """Return values in the unit of the axis, without that power of ten."""
        return np.asarray(values, dtype=float) / (users_unit(self.entry)[1] * 10.0**self.power)

    @property
    def axis(self) -> Axis:
        """The axis of its values."""
        unit = _unit_with_power(users_unit(self.entry)[0], self.power)
        ends = None if self.ends is None else tuple(self.scaled(self.ends).tolist())
        return Axis(quantity_label(self.name, unit), ends=ends)


def fitted_keys(outcome: Mapping[str, Any], samples: Mapping[str, FloatArray]) -> list[list[Panel]]:
    """Return likelihoods by key, and before each of them its pairs with the keys before it.

    Parameters
    ----------
    outcome : the contents of fit.json.
    samples : of the posterior, by key; {} for none.
    """
    keys = []
    for j, (name, entry) in enumerate(outcome["parameters"].items()):
        variance, log = outcome["covariance"][j][j], outcome["log"][j]
        sd = np.inf if variance is None else np.sqrt(variance) / (entry["estimate"] if log else 1.0)
        keys.append(FittedKey(name, entry, log, float(sd), samples.get(name)))
    return [
        [*(_pair(outcome, keys[i], keys[j], i, j) for i in range(j)), _likelihood(outcome, key)]
        for j, key in enumerate(keys)
    ]


def _likelihood(outcome: Mapping[str, Any], key: FittedKey) -> Panel:
    """Return the panel of likelihoods over a key, relative to the best fit's."""
    entry, level, bands, points = key.entry, outcome["level"], [], []
    curves: list[Curve] = []
    shifts = np.linspace(-_WIDTH_SD, _WIDTH_SD, _FINE)
    if key.is_known:
        values = key.scaled(key.values(key.sd * shifts))
        curves.append(Curve(values, np.exp(-0.5 * shifts**2), "linear"))
    if key.samples is not None:
        # more bins than so many independent samples fill show but their scatter
        bins = max(math.ceil(2.0 * entry["posterior"]["effective_samples"] ** (1.0 / 3.0)), 5)
        heights, borders = np.histogram(key.samples, bins=bins, density=True)
        # of a normal distribution the largest density is 1 / (sd sqrt(2 pi))
        heights = np.repeat(heights * np.sqrt(2.0 * np.pi) * key.samples.std(), 2)
        words = "posterior, from", "posterior, to"
        x = key.scaled(np.repeat(borders, 2)[1:-1])
        bands.append(Band(x, 0.0 * heights, heights, "posterior", words, _LINE, 0.35))
    if key.name in outcome["profiles"]:
        x, growth = np.array(outcome["profiles"][key.name], dtype=float)
        # the root of the growth is nearly linear between points
        low, high = key.ends if key.is_bare_limit and key.ends else (x[0], x[-1])
        between = np.linspace(max(x[0], low), min(x[-1], high), _FINE)
        roots = np.interp(between, x, np.sign(x - entry["estimate"]) * np.sqrt(growth))
        name, colour = "likelihood profile", COLOURS[2]
        curves.append(Curve(key.scaled(between), np.exp(-0.5 * roots**2), name, colour))
        points.append(Points(key.scaled(x), np.exp(-0.5 * growth), "", colour, 4.5))
    ends = key.axis.ends
    if outcome["loss"] == "gaussian" and entry["verdict"] != "not identified" and ends:
        half = float(norm.ppf(level if entry["verdict"] == "at bound" else 0.5 + 0.5 * level))
        curves.append(
            Curve(np.array(ends), np.full(2, np.exp(-0.5 * half * half)),
                  f"likelihood at {100 * level:g} % limits", _LINE, 3, 1.2)
        )  # fmt: skip
    upright = np.array([0.0, 1.05])
    limits = [end for end in entry["interval"] if end is not None]
    curves += [
        Curve(key.scaled([end, end]), upright, f"{100 * level:g} % interval", _LINE, 1, 1.2)
        for end in limits
    ]
    at = key.scaled(entry["estimate"])
    if not key.is_bare_limit:
        curves.append(Curve(np.full(2, at), upright, "best fit", COLOURS[1]))
    labels = []
    if entry["verdict"] == "not identified":
        middle = float(at) if ends is None else 0.5 * (ends[0] + ends[1])
        labels.append(Label(middle, 0.9, entry["verdict"], centred=True))
    return Panel(
        key.axis, Axis("relative likelihood", ends=(0.0, 1.1)), curves=curves, bands=bands,
        points=points, labels=labels,
    )  # fmt: skip


def _pair(outcome: Mapping[str, Any], first: FittedKey, second: FittedKey, i: int, j: int) -> Panel:
    """Return the panel of two keys: ellipses and samples."""
    points, curves, labels = [], [], []
    if first.samples is not None and second.samples is not None:
        x, y = first.scaled(first.samples), second.scaled(second.samples)
        points.append(Points(x, y, "", _LINE, 2.0))
    pair = first, second
    unknown = [key for key in pair if key.entry["verdict"] != "identified"]
    at = [key.scaled(key.entry["estimate"]) for key in pair]
    if unknown:
        verdicts = "\n".join(
            f"{quantity_name(key.name)}: {key.entry['verdict']}" for key in unknown
        )
        (left, right), (_, top) = (key.axis.ends or (v, v) for key, v in zip(pair, at, strict=True))
        labels.append(Label(0.5 * float(left + right), float(top), verdicts, True, centred=True))
    else:
        table = np.array(outcome["covariance"], dtype=float)[np.ix_([i, j], [i, j])]
        slopes = np.array([key.entry["estimate"] if key.log else 1.0 for key in pair])
        variances, vectors = np.linalg.eigh(table / np.outer(slopes, slopes))
        angle = np.linspace(0.0, 2.0 * np.pi, 181)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        for dash, level in enumerate(_LEVELS):
            radii = np.sqrt(np.maximum(variances, 0.0) * chi2.ppf(level, 2))
            shifts = vectors @ (radii[:, None] * circle)
            x, y = (key.scaled(key.values(s)) for key, s in zip(pair, shifts, strict=True))
            curves.append(Curve(x, y, f"{100 * level:g} % ellipse", dash=dash))
    points.append(Points(np.atleast_1d(at[0]), np.atleast_1d(at[1]), "", COLOURS[1], 9.0))
    return Panel(first.axis, second.axis, curves=curves, points=points, labels=labels)


def specimens(key: str, estimate: Mapping[str, Any], level: float) -> Panel:
    """Return the values of a key in each specimen, and the intervals of the material and the next.

    Parameters
    ----------
    estimate : of a key that scatters, as in fit.json.
    level : of its intervals.
    """
    entries, (unit, scale) = estimate["each"], users_unit(estimate)
    known = [end for name in ("next", "interval") for end in estimate[name] if end is not None]
    power = _power(max(map(abs, (estimate["estimate"], *known))) / scale)
    unit, scale = _unit_with_power(unit, power), scale * 10.0**power
    quantile = float(norm.ppf(0.5 + 0.5 * level))
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
            bands.append(
                Band(ends, low, high, name, (f"{name}, from", f"{name}, to"), opacity=opacity)
            )
    drawn = []
    alone = [entry["alone"] for entry in entries.values()]
    for name, values_of, colour, shift in (
        ("a specimen, by its own readings", alone, GREY, -_ASIDE),
        ("a specimen, by all readings", list(entries.values()), COLOURS[1], _ASIDE),
    ):
        rows = [
            (np.nan,) * 3 if v is None
            else (v["estimate"], *v.get("interval", v["estimate"] + quantile * v["sd"] * _BOTH))
            for v in values_of
        ]  # fmt: skip
        values, low, high = np.array(rows, dtype=float).T / scale
        drawn.append(
            Points(places + shift, values, name, colour, 6.0, hollow=shift < 0.0,
                   errors=np.array([values - low, high - values]), probability=f"{100 * level:g} %")
        )  # fmt: skip
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
    """Return the predicted standard deviations of each key: a map, or bars of the best designs."""
    panels = []
    for key, scale in outcome["sd_scales"].items():
        label = f"predicted sd of {quantity_label(key, scale['unit'])}"
        if outcome["map"] is None:
            panels.append(_bars(outcome, key, scale["factor"], label))
        else:
            panels.append(_map(outcome, key, scale["factor"], label))
    return panels


def _map(outcome: Mapping[str, Any], key: str, factor: float, label: str) -> Panel:
    table, best = outcome["map"], outcome["map"]["best"]
    x, y = (np.array(table[name]["values"]) for name in ("x", "y"))
    cells = Cells(x, y, factor * np.array(table["sd"][key], dtype=float), label)
    name = f"best: {outcome['designs'][0]['name']}"
    marks = [Points(np.array(best["x"]), np.array(best["y"]), name, COLOURS[4], 14.0, hollow=True)]
    axes = Axis(table["x"]["label"]), Axis(table["y"]["label"])
    return Panel(*axes, cells=cells, points=marks if best["x"] else [])


def _bars(outcome: Mapping[str, Any], key: str, factor: float, label: str) -> Panel:
    names = tuple(design["name"].replace(" + ", "\n+ ") for design in outcome["designs"])
    values = np.array([design["sd"][key] for design in outcome["designs"]], dtype=float)
    bars = Bars(np.arange(len(values), dtype=float), factor * np.nan_to_num(values), "", COLOURS[0])
    return Panel(Axis(label, zero=True), Axis("", reversed=True, categories=names), bars=[bars])
