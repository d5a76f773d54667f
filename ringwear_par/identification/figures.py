"""The figure of a fit: data and model of every series with its band, and the residuals below.

Series of one reading, such as weighings, share a strip below: a line each.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.units import in_signs
from ringwear_par.identification.definition.problem import Experiment, Series
from ringwear_par.identification.outcome import FitResult
from ringwear_par.pictures.style import COLOURS, NotebookFigure
from ringwear_par.results.instants import time_unit

_COLUMNS = 3
_WIDTH, _HEIGHT = 4.3, 3.9
#: of the strip of single readings: a line of it, what is around them, and how narrow it may be
_ROW, _MARGIN, _NARROWEST = 0.28, 0.55, 6.5
_DATA, _MODEL, _BAND = "0.55", COLOURS[1], COLOURS[0]
_RESIDUAL = "(data - model) / sd"
#: what readings are called, by the first part of their quantity, if not by that
_WORDS = {"profile": "depth", "mass": "mass loss", "volume": "volume loss"}
#: of the median distance between radii: where they are further apart nothing was read
_GAP = 3.0
#: relative distance within which a radius is that of an edge
_CLOSE = 1e-9


def figure(found: FitResult) -> Figure:
    """Return the figure of data, model, its band at the fit's level, and residuals."""
    squares = found.squares
    every = [
        _Drawn(experiment, series, part)
        for (experiment, series), part in zip(squares.series, squares.parts, strict=True)
    ]
    curves = [one for one in every if one.series.n > 1]
    single = [one for one in every if one.series.n == 1]
    across = 2 if len(curves) == 4 else min(_COLUMNS, max(len(curves), 1))
    down = math.ceil(len(curves) / across)
    heights = _HEIGHT * down, _MARGIN + _ROW * len(single)
    width = max(_WIDTH * across, _NARROWEST if single else 0.0)
    chart = NotebookFigure(
        figsize=(width, heights[0] + bool(single) * heights[1]), layout="constrained"
    )
    parts: Any = chart, chart
    if single and curves:  # labels of the strip make no panel above it narrower
        parts = chart.subfigures(2, 1, height_ratios=heights)
    top, strip = parts
    grid = top.add_gridspec(max(2 * down, 1), across, height_ratios=[5, 2] * down or [1])
    quantile = float(norm.ppf(0.5 + 0.5 * squares.problem.settings.level))
    for place, one in enumerate(curves):
        row, column = divmod(place, across)
        above = top.add_subplot(grid[2 * row, column])
        below = top.add_subplot(grid[2 * row + 1, column], sharex=above)
        _draw(above, below, found, one, quantile)
        if place == 0:
            above.legend(fontsize=7, frameon=False)
        above.set_title(one.name, fontsize=8)
        above.set_ylabel(label(one.series), fontsize=8)
    if single:
        _draw_single(strip.add_subplot(), found, single, quantile, explained=not curves)
    return chart


@dataclass(frozen=True)
class _Drawn:
    """A series, the experiment that it is of, and which of all readings are its own."""

    experiment: Experiment
    series: Series
    part: slice

    @property
    def name(self) -> str:
        return f"{self.experiment.name}: {self.series.name}"


def label(series: Series) -> str:
    """Return what an axis of readings is called."""
    kind, _, body = series.quantity.partition(".")
    of = f" of {body}" if body else ""
    return f"{_WORDS.get(kind, kind)}{of} ({in_signs(series.unit)})"


def pieces(series: Series, contact: tuple[float, float]) -> list[IntArray]:
    """Return the readings, in the order of their x, that one line may join.

    Of a profile those on one side of an edge of the contact, and without gaps between them.
    """
    order = np.argsort(series.x, kind="stable")
    if not series.profile:
        return [order]
    x, (a, b) = series.x[order], contact
    steps = np.diff(x)
    inside = (x >= a - _CLOSE * b) & (x <= b + _CLOSE * b)
    usual = np.median(steps[steps > 0]) if (steps > 0).any() else np.inf
    ends = np.flatnonzero((steps > _GAP * usual) | (inside[1:] != inside[:-1])) + 1
    return np.split(order, ends)


def _draw_single(
    axes: Any, found: FitResult, single: Sequence[_Drawn], quantile: float, *, explained: bool
) -> None:
    """Draw series of one reading, a line each: how far it is off the model, and both in words."""
    level = f"{100 * found.squares.problem.settings.level:g} %"
    residuals = np.array([-found.evaluation.noise[one.part][0] for one in single])
    places, told = np.arange(len(single)), []
    bands = np.array([(found.band[one.part] / found.squares.sd[one.part])[0] for one in single])
    for values, shade, what in (
        (np.hypot(bands, 1.0), 0.15, "of readings"), (bands, 0.5, "of the model")
    ):  # fmt: skip
        axes.barh(
            places, 2 * quantile * values, left=-quantile * values, height=0.7, color=_BAND,
            alpha=shade, lw=0, label=f"{level} {what}",
        )  # fmt: skip
    axes.axvline(0.0, color=_MODEL, lw=1, label="model")
    axes.plot(residuals, places, "o", color=_DATA, ms=4, label="data")
    for one in single:
        scale, unit = 1.0 / one.series.factor, in_signs(one.series.unit)
        value, sd, model, band = (
            scale * float(values[0])
            for values in (
                one.series.value, quantile * found.squares.sd[one.part],
                found.evaluation.model[one.part], quantile * found.band[one.part],
            )
        )  # fmt: skip
        told.append(
            f"{value:.4g} \N{PLUS-MINUS SIGN} {sd:.2g} {unit}, "
            f"model {model:.4g} \N{PLUS-MINUS SIGN} {band:.2g}"
        )
    reach = max(4.0, 1.1 * float(np.abs(residuals).max()), 1.1 * quantile * float(bands.max()))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(len(single) - 0.4, -0.6)
    axes.set_yticks(places, [one.name for one in single])
    right = axes.secondary_yaxis("right")
    right.set_yticks(places, told)
    for side in (axes, right):
        side.tick_params(labelsize=7)
    right.tick_params(length=0)
    axes.set_xlabel(_RESIDUAL, fontsize=7)
    if explained:
        axes.legend(fontsize=7, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0),
                    ncols=4)  # fmt: skip


def _axis(series: Series) -> tuple[FloatArray, str]:
    """Return where the readings are, and what that is called."""
    if series.profile:
        return series.x, "radius (mm)"
    unit, seconds = time_unit(float(series.x.max()))
    return series.x / seconds, f"time ({unit})"


def _draw(above: Any, below: Any, found: FitResult, one: _Drawn, quantile: float) -> None:
    experiment, series, part = one.experiment, one.series, one.part
    scale = 1.0 / series.factor
    data, sd = scale * series.value, scale * found.squares.sd[part]
    model, residuals = scale * found.evaluation.model[part], -found.evaluation.noise[part]
    band = quantile * scale * found.band[part]
    predicted = np.hypot(band, quantile * sd)
    level = f"{100 * found.squares.problem.settings.level:g} %"
    x, along = _axis(series)
    above.plot(x, data, ".", color=_DATA, ms=3, label="data")
    for number, own in enumerate(pieces(series, experiment.case.contact)):
        named = number == 0
        for values, shade, what in ((predicted, 0.15, "of readings"), (band, 0.5, "of the model")):
            above.fill_between(
                x[own], (model - values)[own], (model + values)[own], color=_BAND,
                alpha=shade, lw=0, label=f"{level} {what}" if named else None,
            )  # fmt: skip
        above.plot(x[own], model[own], color=_MODEL, lw=1, label="model" if named else None)
    if series.profile:
        above.invert_yaxis()  # downwards is into the body
    below.axhspan(-quantile, quantile, color=_BAND, alpha=0.15, lw=0)
    below.plot(x, residuals, ".", color=_DATA, ms=3)
    below.set_ylabel(_RESIDUAL, fontsize=7)
    below.set_xlabel(along, fontsize=8)
    reach = max(4.0, 1.1 * float(np.abs(residuals).max()))
    below.set_ylim(-reach, reach)
    # ticks that change with the height of a panel would leave no room for its label
    tick = math.floor(0.75 * reach)
    below.set_yticks([-tick, 0, tick])
    for axes in (above, below):
        axes.tick_params(labelsize=7)
    above.tick_params(labelbottom=False)
