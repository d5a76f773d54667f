"""Panels of a fit: readings with the model and its bands, residuals, measured inputs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.stats import norm

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.schema import quantity_label, quantity_name
from ringwear_par.cases.units import in_signs
from ringwear_par.errors import counted, legible
from ringwear_par.pictures.panel import GREY, Axis, Band, Bars, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.key_numbers import time_unit

#: median distances between radii: where they are further apart nothing was read
_GAP = 3.0
#: relative distance within which a radius is that of an edge
_CLOSE = 1e-9
#: least sd that axes of residuals show, and share of an axis at which limits beyond it are drawn
_REACH, _AT_END = 4.0, 0.97
#: most readings whose noise has a bar each
_FEW = 60
#: what readings are called, by the first part of their quantity, if not by that
_WORDS = {"profile": "worn depth", "mass": "mass loss", "volume": "volume loss"}


@dataclass(frozen=True)
class Series:
    """Readings of a series and the model of a fit, in the unit that they are shown in."""

    #: of the series
    experiment: str
    name: str
    #: what was read, as fit files have it
    quantity: str
    #: of its readings
    unit: str
    #: (n,) float, times (s), or radii (mm) of a profile
    x: FloatArray
    #: (n,) float
    data: FloatArray
    model: FloatArray
    #: (n,) float, standard deviations of the noise and of the model
    sd: FloatArray
    band: FloatArray
    #: (n,) float, in standard deviations of the noise
    residuals: FloatArray
    #: confidence of the bands
    level: float
    #: mm, of the contact, where the model of a profile is broken; () if they are not known
    edges: tuple[float, ...]
    #: (n,) int, -1 where the true value is at most the reading, 1 where at least, else 0
    censored: IntArray

    @property
    def profile(self) -> bool:
        """Whether it is over radii."""
        return self.quantity.startswith("profile")

    @property
    def label(self) -> str:
        """The label of an axis of its readings."""
        return f"{self._words} ({in_signs(self.unit)})"

    @property
    def quantile(self) -> float:
        """The standard deviations of half a band."""
        return float(norm.ppf(0.5 + 0.5 * self.level))

    @property
    def title(self) -> str:
        """The experiment and the series."""
        return f"{self.experiment}: {self.name.replace(self.quantity, self._words)}"

    @property
    def _words(self) -> str:
        kind, _, body = self.quantity.partition(".")
        return _WORDS.get(kind, kind) + f" of {body}" * bool(body)

    def along(self) -> tuple[FloatArray, Axis]:
        """Return the abscissae in the unit of their axis, and that axis."""
        unit, length = ("mm", 1.0) if self.profile else time_unit(float(np.max(self.x)))
        return self.x / length, Axis(f"{'radius' if self.profile else 'time'} ({unit})")

    def breaks(self) -> IntArray:
        """Return the readings, in the order of x, before which the model's line is broken.

        Of a profile at the edges of the contact, and where nothing was read.
        """
        x = np.sort(self.x, kind="stable")
        steps = np.diff(x)
        usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
        broken = steps > _GAP * usual
        for edge, outwards in zip(self.edges, (-1.0, 1.0), strict=False):
            beside = outwards * (x - edge) > _CLOSE * edge
            broken |= beside[1:] != beside[:-1]
        return np.flatnonzero(broken & self.profile) + 1


def _data(
    series: Series,
    x: FloatArray,
    y: FloatArray,
    size: float = 4.0,
    errors: FloatArray | None = None,
) -> list[Points]:
    """Return readings as dots, and those that are limits as arrows to where the truth is."""
    arrows: list[Literal["up", "down"]] = ["up", "down"]
    if series.profile:  # depths grow downwards
        arrows.reverse()
    points = []
    kinds: list[tuple[int, str, Literal["dot", "up", "down"]]] = [
        (0, "data", "dot"), (1, "at least", arrows[0]), (-1, "at most", arrows[1])
    ]  # fmt: skip
    for side, name, marker in kinds:
        rows = series.censored == side
        if rows.any():
            words = f"{counted(int(rows.sum()), 'limit')}, {name}" if side else name
            bars = None if side or errors is None else errors[rows]
            points.append(
                Points(x[rows], y[rows], words, GREY, size + 2.0 * abs(side), marker, errors=bars)
            )  # fmt: skip
    return points


def readings(series: Series) -> Panel:
    """Return readings with the model, its band and that of readings; gaps where none were."""
    x, below = series.along()
    order = np.argsort(x, kind="stable")
    gaps = series.breaks()

    def broken(values: Any) -> FloatArray:
        return np.insert(values[order].astype(float), gaps, np.nan)

    percent, bands = f"{100 * series.level:g} %", []
    for name, reach, colour, opacity, dotted in (
        ("readings", np.hypot(series.band, series.sd), COLOURS[0], 0.1, True),
        ("the model", series.band, COLOURS[1], 0.35, False),
    ):
        low, high = (broken(series.model + sign * series.quantile * reach) for sign in (-1.0, 1.0))
        name = f"{percent} of {name}"
        bands.append(Band(broken(x), low, high, name, colour, opacity, dotted))
    noise = series.quantile * series.sd if len(x) <= _FEW else None
    return Panel(
        below, Axis(series.label, reversed=series.profile), series.title,
        curves=[Curve(broken(x), broken(series.model), "model", COLOURS[1])],
        bands=bands, points=_data(series, x, series.data, errors=noise),
    )  # fmt: skip


def measured_input(
    experiment: str, key: str, unit: str, time: FloatArray, value: FloatArray,
    curve: FloatArray,
) -> Panel:  # fmt: skip
    """Return the readings of an input of a test, times in s, and the curve of its case there."""
    word, length = time_unit(float(time[-1]))
    label = quantity_label(key, "" if unit in ("1", "-") else unit)
    return Panel(
        Axis(f"time ({word})"), Axis(label), f"{experiment}: {quantity_name(key)}",
        curves=[Curve(time / length, curve, "smoothed", COLOURS[2])],
        points=[Points(time / length, value, "data", GREY, 4.0)],
    )  # fmt: skip


def _within_axis(
    residuals: FloatArray, censored: IntArray, least: float = _REACH
) -> tuple[FloatArray, float]:
    """Return residuals as they are drawn, and the end of their axis.

    Limits that the model keeps are not drawn beyond its ends: what is far from them is no misfit.
    """
    keeps = censored * residuals < 0.0
    reach = max(least, 1.1 * float(np.abs(residuals[~keeps]).max(initial=0.0)))
    within = np.clip(residuals, -_AT_END * reach, _AT_END * reach)
    return np.where(keeps, within, residuals), reach


def residuals(series: Series) -> Panel:
    """Return the residuals of a series, with the limits of the confidence level."""
    x, below = series.along()
    points, reach = _within_axis(series.residuals, series.censored)
    return Panel(
        below, Axis("residual / sd", ends=(-reach, reach)), f"{series.title}, residuals",
        points=_data(series, x, points),
        levels=(-series.quantile, series.quantile),
    )  # fmt: skip


def single_readings(drawn: Sequence[Series]) -> Panel:
    """Return series of one reading, a line each: how far it is off the model, and both numbers."""
    level, quantile = f"{100 * drawn[0].level:g} %", drawn[0].quantile
    places = np.arange(len(drawn), dtype=float)
    model = quantile * np.array([(series.band / series.sd)[0] for series in drawn])
    spread = np.hypot(model, quantile)
    words = []
    for series in drawn:
        unit, (sd, band) = in_signs(series.unit), (quantile * series.sd, quantile * series.band)
        reading, modelled = (
            f"{value[0]:.4g} {unit}"
            + f" from {(value - reach)[0]:.4g} to {(value + reach)[0]:.4g}" * bool(reach[0])
            for value, reach in ((series.data, sd), (series.model, band))
        )
        if side := int(series.censored[0]):
            reading = f"{'at least' if side > 0 else 'at most'} {series.data[0]:.4g} {unit}"
        words.append("\n".join([legible(series.title), reading, f"model {modelled}"]))
    censored = np.concatenate([series.censored for series in drawn])
    residuals, reach = _within_axis(
        np.concatenate([series.residuals for series in drawn]), censored,
        max(_REACH, 1.1 * float(model.max())),
    )  # fmt: skip
    ends = np.array([-0.6, len(drawn) - 0.4])
    return Panel(
        Axis("(data - model) / sd", ends=(-reach, reach)),
        Axis("", reversed=True, categories=tuple(words)),
        bars=[
            Bars(places, spread, f"{level} of readings", COLOURS[0], None, -spread, 0.7, 0.15),
            Bars(places, model, f"{level} of the model", COLOURS[1], None, -model, 0.7, 0.35),
        ],
        curves=[Curve(np.zeros(2), ends, "model", COLOURS[1])],
        points=_data(replace(drawn[0], quantity="", censored=censored), residuals, places, 6.0),
    )  # fmt: skip
