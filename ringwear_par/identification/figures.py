"""The figure of a fit: data and model of every series with its band, and the residuals below.

Series of one reading, such as weighings, share a strip below: a line each.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ringwear_par.cases.units import in_signs
from ringwear_par.identification.definition.problem import Experiment, Series
from ringwear_par.identification.outcome import FitResult
from ringwear_par.pictures import fits
from ringwear_par.pictures.matplotlib import draw
from ringwear_par.pictures.panels import GREY
from ringwear_par.pictures.style import COLOURS, NotebookFigure

_COLUMNS = 3
_WIDTH, _HEIGHT = 4.3, 3.9
#: of the strip of single readings: a line of it, what is around them, and how narrow it may be
_ROW, _MARGIN, _NARROWEST = 0.28, 0.55, 6.5
#: what readings are called, by the first part of their quantity, if not by that
_WORDS = {"profile": "depth", "mass": "mass loss", "volume": "volume loss"}
#: size of letters
_TITLE, _SMALL = 8, 7


def figure(fit: FitResult) -> Figure:
    """Return the figure of data, model, its band at the fit's level, and residuals."""
    squares = fit.squares
    all_series = [
        _series(fit, experiment, series, part)
        for (experiment, series), part in zip(squares.series, squares.parts, strict=True)
    ]
    curves = [series for series in all_series if len(series.x) > 1]
    single = [series for series in all_series if len(series.x) == 1]
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
    for place, series in enumerate(curves):
        row, column = divmod(place, across)
        above = top.add_subplot(grid[2 * row, column])
        below = top.add_subplot(grid[2 * row + 1, column], sharex=above)
        _draw(above, below, series)
        if place == 0:
            above.legend(fontsize=_SMALL, frameon=False)
    if single:
        _draw_single(strip.add_subplot(), single, explained=not curves)
    return chart


def _series(fit: FitResult, experiment: Experiment, series: Series, part: slice) -> fits.Series:
    """Return a series with its model, in the unit of its readings."""
    scale, squares = 1.0 / series.factor, fit.squares
    return fits.Series(
        experiment.name, series.name, in_signs(series.unit), series.x, series.profile,
        scale * series.value, scale * fit.evaluation.model[part], scale * squares.sd[part],
        scale * fit.band[part], -fit.evaluation.noise[part], squares.problem.settings.level,
        label(series), experiment.case.contact,
    )  # fmt: skip


def label(series: Series) -> str:
    """Return what an axis of readings is called."""
    kind, _, body = series.quantity.partition(".")
    of = f" of {body}" if body else ""
    return f"{_WORDS.get(kind, kind)}{of} ({in_signs(series.unit)})"


def _draw(above: Any, below: Any, series: fits.Series) -> None:
    """Draw readings and model, and the residuals below them."""
    draw(above, fits.readings(series), 0)
    draw(below, fits.residuals(series), 0)
    # ticks that change with the height of a panel would leave no room for its label
    tick = math.floor(0.75 * below.get_ylim()[1])
    below.set_yticks([-tick, 0, tick])
    for axes in (above, below):
        axes.tick_params(labelsize=_SMALL)
    above.tick_params(labelbottom=False)
    above.set_title(series.title, fontsize=_TITLE)
    above.set_xlabel("")
    above.yaxis.label.set_size(_TITLE)
    below.xaxis.label.set_size(_TITLE)
    below.yaxis.label.set_size(_SMALL)


def _draw_single(axes: Any, single: Sequence[fits.Series], *, explained: bool) -> None:
    """Draw series of one reading, a line each: how far it is off the model, and both in words."""
    level, quantile = f"{100 * single[0].level:g} %", single[0].quantile
    residuals, bands = (
        np.array([values(series)[0] for series in single])
        for values in (lambda series: series.residuals, lambda series: series.band / series.sd)
    )
    places, words = np.arange(len(single)), []
    for values, colour, shade, whose in (
        (np.hypot(bands, 1.0), COLOURS[0], 0.15, "of readings"),
        (bands, COLOURS[1], 0.35, "of the model"),
    ):  # fmt: skip
        axes.barh(
            places, 2 * quantile * values, left=-quantile * values, height=0.7, color=colour,
            alpha=shade, lw=0, label=f"{level} {whose}",
        )  # fmt: skip
    axes.axvline(0.0, color=COLOURS[1], lw=1, label="model")
    axes.plot(residuals, places, "o", color=GREY, ms=4, label="data")
    for series in single:
        value, sd = series.data[0], quantile * series.sd[0]
        model, band = series.model[0], quantile * series.band[0]
        words.append(
            f"{value:.4g} \N{PLUS-MINUS SIGN} {sd:.2g} {series.unit}, "
            f"model {model:.4g} \N{PLUS-MINUS SIGN} {band:.2g}"
        )
    reach = max(4.0, 1.1 * float(np.abs(residuals).max()), 1.1 * quantile * float(bands.max()))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(len(single) - 0.4, -0.6)
    axes.set_yticks(places, [series.title for series in single])
    right = axes.secondary_yaxis("right")
    right.set_yticks(places, words)
    for side in (axes, right):
        side.tick_params(labelsize=_SMALL)
    right.tick_params(length=0)
    axes.set_xlabel(fits.RESIDUAL, fontsize=_SMALL)
    if explained:
        axes.legend(fontsize=_SMALL, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0),
                    ncols=4)  # fmt: skip
