"""The figure of a fit: data and model of every series with its band, and the residuals below."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from ringwear_par.identification.problem import Experiment, Series

if TYPE_CHECKING:
    from ringwear_par.identification.outcome import FitResult

_COLUMNS = 3
_DATA, _MODEL, _BAND = "0.55", "C3", "C0"


def figure(found: "FitResult") -> Figure:
    """Return the figure of data, model, its band at the fit's level, and residuals."""
    squares = found.squares
    drawn = [
        (experiment, series, part)
        for (experiment, series), part in zip(squares.series, squares.parts, strict=True)
    ]
    across = min(_COLUMNS, len(drawn))
    down = math.ceil(len(drawn) / across)
    chart = Figure(figsize=(4.3 * across, 3.9 * down), layout="constrained")
    grid = chart.add_gridspec(2 * down, across, height_ratios=[3, 1] * down)
    quantile = float(norm.ppf(0.5 + 0.5 * squares.problem.settings.level))
    for place, (experiment, series, part) in enumerate(drawn):
        row, column = divmod(place, across)
        above = chart.add_subplot(grid[2 * row, column])
        below = chart.add_subplot(grid[2 * row + 1, column], sharex=above)
        _draw(above, below, found, experiment, series, part, quantile)
        if place == 0:
            above.legend(fontsize=7, frameon=False)
    return chart


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
    model = scale * found.evaluation.model[part]
    predicted = quantile * np.hypot(scale * found.band[part], sd)
    band = quantile * scale * found.band[part]
    order = np.argsort(series.x, kind="stable")
    x = series.x[order]
    level = f"{100 * found.squares.problem.settings.level:g} %"
    if series.n == 1:
        above.errorbar(x, data, quantile * sd, fmt="o", color=_DATA, ms=4, label="data")
        above.errorbar(x, model, band, fmt="_", color=_MODEL, ms=14, label="model")
        below.set_xticks(x)
    else:
        above.plot(x, data[order], ".", color=_DATA, ms=3, label="data")
        for values, shade, what in ((predicted, 0.15, "of readings"), (band, 0.5, "of the model")):
            above.fill_between(
                x, (model - values)[order], (model + values)[order], color=_BAND, alpha=shade, lw=0,
                label=f"{level} {what}",
            )  # fmt: skip
        above.plot(x, model[order], color=_MODEL, lw=1, label="model")
    if series.profile:
        above.invert_yaxis()  # downwards is into the body
    above.set_title(f"{experiment.name}: {series.name}", fontsize=8)
    above.set_ylabel(f"{series.quantity} ({series.unit})", fontsize=8)
    below.axhspan(-quantile, quantile, color=_BAND, alpha=0.15, lw=0)
    below.plot(x, found.evaluation.noise[part][order], ".", color=_DATA, ms=3)
    below.set_ylabel("residual / sd", fontsize=8)
    below.set_xlabel("radius (mm)" if series.profile else "time (s)", fontsize=8)
    reach = max(4.0, 1.1 * float(np.abs(found.evaluation.noise[part]).max()))
    below.set_ylim(-reach, reach)
    for axes in (above, below):
        axes.tick_params(labelsize=7)
    above.tick_params(labelbottom=False)
