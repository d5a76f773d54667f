"""Panels of a fit: readings with the model and its bands, residuals."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.units import in_signs
from ringwear_par.pictures.panels import GREY, Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.instants import time_unit

#: of the median distance between radii: where they are further apart nothing was read
_GAP = 3.0
#: relative distance within which a radius is that of an edge
_CLOSE = 1e-9
RESIDUAL = "(data - model) / sd"
#: standard deviations that axes of residuals have at least
_REACH = 4.0
#: from the middle of a specimen, its values by its own readings and with the others
_ASIDE = 0.12
#: specimens whose names have room
_NAMED = 12
#: readings whose noise has a bar each
_FEW = 60


@dataclass(frozen=True)
class Series:
    """Readings of a series and the model of a fit, in the unit that they are shown in.

    Parameters
    ----------
    experiment, name : of the series; unit : of its readings.
    x : (n,) float, times (s), or radii (mm) of a profile.
    data, model : (n,) float; sd, band : standard deviations of the noise and of the model.
    residuals : (n,) float, in standard deviations of the noise.
    level : confidence of the bands.
    label : of the axis of readings, with the unit; "" for the name and the unit.
    edges : mm, of the contact, where the model of a profile is broken; () if they are not known.
    """

    experiment: str
    name: str
    unit: str
    x: FloatArray
    profile: bool
    data: FloatArray
    model: FloatArray
    sd: FloatArray
    band: FloatArray
    residuals: FloatArray
    level: float
    label: str = ""
    edges: tuple[float, ...] = ()

    @property
    def quantile(self) -> float:
        """The standard deviations of half a band."""
        return float(norm.ppf(0.5 + 0.5 * self.level))

    @property
    def title(self) -> str:
        """The experiment and the series."""
        return f"{self.experiment}: {self.name}"

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


def readings(series: Series) -> Panel:
    """Return readings with the model, its band and that of readings; gaps where none were."""
    x, below = series.along()
    order = np.argsort(x, kind="stable")
    gaps = series.breaks()

    def broken(values: Any) -> FloatArray:
        return np.insert(values[order].astype(float), gaps, np.nan)

    percent, bands = f"{100 * series.level:g} %", []
    for name, reach, colour, opacity, edge in (
        ("readings", np.hypot(series.band, series.sd), COLOURS[0], 0.1, 1.0),
        ("the model", series.band, COLOURS[1], 0.35, 0.0),
    ):
        low, high = (broken(series.model + sign * series.quantile * reach) for sign in (-1.0, 1.0))
        name = f"{percent} of {name}"
        ends = f"{name}, from", f"{name}, to"
        bands.append(Band(broken(x), low, high, name, ends, colour, opacity, edge))
    noise = series.sd if len(x) <= _FEW else None
    label = series.label or f"{series.name} ({series.unit})"
    return Panel(
        below, Axis(label, reversed=series.profile), series.title,
        curves=[Curve(broken(x), broken(series.model), "model", COLOURS[1])],
        bands=bands, points=[Points(x, series.data, "data", GREY, 4.0, errors=noise)],
    )  # fmt: skip


def residuals(series: Series) -> Panel:
    """Return the residuals of a series, with the limits of the confidence level."""
    x, below = series.along()
    reach = max(_REACH, 1.1 * float(np.abs(series.residuals).max()))
    return Panel(
        below, Axis(RESIDUAL, ends=(-reach, reach)), f"{series.title}, residuals",
        points=[Points(x, series.residuals, "", GREY, 4.0)],
        levels=(-series.quantile, series.quantile),
    )  # fmt: skip


def specimens(key: str, estimate: Mapping[str, Any], level: float) -> Panel:
    """Return the values of a key in each specimen, and the intervals of the material and the next.

    Parameters
    ----------
    estimate : of a key that scatters, as in fit.json.
    level : of its intervals.
    """
    entries, unit = estimate["each"], in_signs(estimate["unit"])
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
            low, high = np.full(2, low), np.full(2, high)
            bands.append(
                Band(ends, low, high, name, (f"{name}, from", f"{name}, to"), opacity=opacity)
            )
    drawn = []
    for name, values_of, colour, shift in (
        ("by its own readings", [one["alone"] for one in entries.values()], GREY, -_ASIDE),
        ("in the light of the others", list(entries.values()), COLOURS[1], _ASIDE),
    ):
        values, sds = (
            np.array([np.nan if one is None else one[n] for one in values_of], dtype=float)
            for n in ("estimate", "sd")
        )
        drawn.append(
            Points(places + shift, values, name, colour, 6.0, hollow=shift < 0.0,
                   errors=quantile * sds)
        )  # fmt: skip
    names = (
        tuple(entries) if len(entries) <= _NAMED else tuple(map(str, range(1, len(entries) + 1)))
    )
    material = Curve(ends, np.full(2, estimate["estimate"]), "the material", COLOURS[0])
    return Panel(
        Axis("specimen", ends=(ends[0], ends[1]), categories=names),
        Axis(f"{key} ({unit})" if unit not in ("1", "-") else key),
        f"{key} of specimens", curves=[material], bands=bands, points=drawn,
    )  # fmt: skip
