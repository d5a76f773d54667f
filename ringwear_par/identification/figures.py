"""The figure of a fit: data and model of every series with its band, and the residuals below.

A series of one reading is a narrow panel of its own.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from ringwear_par.arrays import IntArray
from ringwear_par.identification.problem import Experiment, Series
from ringwear_par.results.drawing import COLOURS

if TYPE_CHECKING:
    from ringwear_par.identification.outcome import FitResult

_COLUMNS = 3
_WIDTH, _NARROW, _HEIGHT = 4.3, 0.5, 3.9
_DATA, _MODEL, _BAND = "0.55", COLOURS[1], COLOURS[0]
_RESIDUAL = "(data - model) / sd"
#: what readings are called, by the first part of their quantity, if not by that
_WORDS = {"profile": "depth", "mass": "mass loss", "volume": "volume loss"}
#: of the median distance between radii: where they are further apart nothing was read
_GAP = 3.0
#: relative distance within which a radius is that of an edge
_CLOSE = 1e-9


def figure(found: "FitResult") -> Figure:
    """Return the figure of data, model, its band at the fit's level, and residuals."""
    squares = found.squares
    drawn = [
        (experiment, series, part)
        for (experiment, series), part in zip(squares.series, squares.parts, strict=True)
    ]
    across = 2 if len(drawn) == 4 else min(_COLUMNS, len(drawn))
    down = math.ceil(len(drawn) / across)
    widths = [
        _WIDTH * (1.0 if any(series.n > 1 for _, series, _ in drawn[column::across]) else _NARROW)
        for column in range(across)
    ]
    chart = Figure(figsize=(sum(widths), _HEIGHT * down), layout="constrained")
    grid = chart.add_gridspec(2 * down, across, width_ratios=widths, height_ratios=[5, 2] * down)
    quantile = float(norm.ppf(0.5 + 0.5 * squares.problem.settings.level))
    explained = False
    for place, (experiment, series, part) in enumerate(drawn):
        row, column = divmod(place, across)
        if series.n == 1:
            above = chart.add_subplot(grid[2 * row : 2 * row + 2, column])
            _draw_one(above, found, series, part, quantile)
        else:
            above = chart.add_subplot(grid[2 * row, column])
            below = chart.add_subplot(grid[2 * row + 1, column], sharex=above)
            _draw(above, below, found, experiment, series, part, quantile)
            if not explained:
                above.legend(fontsize=7, frameon=False)
                explained = True
        above.set_title(f"{experiment.name}: {series.name}", fontsize=8)
        above.set_ylabel(label(series), fontsize=8)
    return chart


def label(series: Series) -> str:
    """Return what an axis of readings is called."""
    kind, _, body = series.quantity.partition(".")
    of = f" of {body}" if body else ""
    unit = series.unit.replace("\N{MICRO SIGN}", "u").replace("\N{GREEK SMALL LETTER MU}", "u")
    return f"{_WORDS.get(kind, kind)}{of} ({unit})"


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


def _draw_one(axes: Any, found: "FitResult", series: Series, part: slice, quantile: float) -> None:
    """Draw a single reading beside the model's."""
    scale, reach = 1.0 / series.factor, quantile / series.factor
    bars = (
        ("data", series.value, reach * found.squares.sd[part], _DATA),
        ("model", found.evaluation.model[part], reach * found.band[part], _MODEL),
    )
    for x, (_, value, bar, colour) in enumerate(bars):
        axes.errorbar([x], scale * value, bar, fmt="o", color=colour, ms=4, capsize=4)
    axes.set_xticks([0, 1], [name for name, *_ in bars])
    axes.set_xlim(-0.6, 1.6)
    axes.set_box_aspect(2.0)
    level = f"{100 * found.squares.problem.settings.level:g} %"
    axes.set_xlabel(
        f"{_RESIDUAL} = {-found.evaluation.noise[part][0]:.2g}\nbars: {level}", fontsize=7
    )
    axes.tick_params(labelsize=7)


def _draw(
    above: Any,
    below: Any,
    found: "FitResult",
    experiment: Experiment,
    series: Series,
    part: slice,
    quantile: float,
) -> None:
    scale = 1.0 / series.factor
    data, sd = scale * series.value, scale * found.squares.sd[part]
    model, residuals = scale * found.evaluation.model[part], -found.evaluation.noise[part]
    band = quantile * scale * found.band[part]
    predicted = np.hypot(band, quantile * sd)
    level = f"{100 * found.squares.problem.settings.level:g} %"
    above.plot(series.x, data, ".", color=_DATA, ms=3, label="data")
    for number, own in enumerate(pieces(series, experiment.case.contact)):
        named = number == 0
        for values, shade, what in ((predicted, 0.15, "of readings"), (band, 0.5, "of the model")):
            above.fill_between(
                series.x[own], (model - values)[own], (model + values)[own], color=_BAND,
                alpha=shade, lw=0, label=f"{level} {what}" if named else None,
            )  # fmt: skip
        above.plot(series.x[own], model[own], color=_MODEL, lw=1, label="model" if named else None)
    if series.profile:
        above.invert_yaxis()  # downwards is into the body
    below.axhspan(-quantile, quantile, color=_BAND, alpha=0.15, lw=0)
    below.plot(series.x, residuals, ".", color=_DATA, ms=3)
    below.set_ylabel(_RESIDUAL, fontsize=7)
    below.set_xlabel("radius (mm)" if series.profile else "time (s)", fontsize=8)
    reach = max(4.0, 1.1 * float(np.abs(residuals).max()))
    below.set_ylim(-reach, reach)
    # ticks that change with the height of a panel would leave no room for its label
    tick = math.floor(0.75 * reach)
    below.set_yticks([-tick, 0, tick])
    for axes in (above, below):
        axes.tick_params(labelsize=7)
    above.tick_params(labelbottom=False)
