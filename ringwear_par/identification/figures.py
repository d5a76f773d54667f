"""Figures of a fit, of the panels that its page has: readings, fitted keys, specimens."""

import math
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from ringwear_par.errors import InputError
from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.fitted_tests import FittedTest
from ringwear_par.pictures import fit_panels, key_panels
from ringwear_par.pictures.matplotlib import add_letters, panel_figure, panel_grid
from ringwear_par.pictures.panel import Panel
from ringwear_par.pictures.style import STYLE, NotebookFigure

_COLUMNS = 3
#: inches of readings with their residuals, of a legend above all, and of an input
_WIDTH, _HEIGHT, _LEGEND, _INPUT = 4.3, 3.9, 0.4, 2.4
#: inches of the strip of single readings: height of a row, margin around them, least width
_ROW, _MARGIN, _NARROWEST = 0.5, 0.9, 6.5


def plot(fit: FitResult) -> Figure:
    """Return the figure of data, model, its band at the fit's level, and residuals.

    Series of one reading, such as weighings, share a strip below: a line each.
    """
    every = [drawn_series(fit, test, *record) for test in fit.tests for record in test.records]
    curves = [series for series in every if len(series.x) > 1]
    single = [series for series in every if len(series.x) == 1]
    across = 2 if len(curves) == 4 else min(_COLUMNS, max(len(curves), 1))
    down = math.ceil(len(curves) / across)
    heights = _LEGEND + _HEIGHT * down, _MARGIN + _ROW * len(single)
    inputs = [fit_panels.measured_input(*entry) for entry in fit.input_readings]
    heights = heights[0] + _INPUT * math.ceil(len(inputs) / across), heights[1]
    size = max(_WIDTH * across, _NARROWEST), heights[0] + bool(single) * heights[1]
    rows: list[list[Panel]] = []
    for first in range(0, len(curves), across):
        beside = curves[first : first + across]
        rows += [[*map(fit_panels.readings, beside)], [*map(fit_panels.residuals, beside)]]
    rows += [inputs[first : first + across] for first in range(0, len(inputs), across)]
    shares = [5, 2] * down + [4] * (len(rows) - 2 * down)
    if not single:
        return panel_figure(rows, size, shares)
    strip = [[fit_panels.single_readings(single)]]
    if not rows:
        return panel_figure(strip, (size[0], _LEGEND + heights[1]))
    with matplotlib.rc_context(STYLE):
        chart = NotebookFigure(figsize=size, layout="constrained")
        # labels of the strip make no panel above it narrower
        parts: Any = chart.subfigures(2, 1, height_ratios=heights)
        panel_grid(parts[0], rows, shares)
        panel_grid(parts[1], strip, legend=False)
        add_letters(chart)
    return chart


def drawn_series(
    fit: FitResult, test: FittedTest, series: Series, part: slice
) -> fit_panels.Series:
    """Return a series with its model, in the unit of its readings."""
    scale = 1.0 / series.factor
    return fit_panels.Series(
        test.experiment.name, series.name, series.quantity, series.unit, series.x,
        scale * series.value, scale * test.model[part], scale * test.sd[part],
        scale * test.band[part], test.residuals[part], fit.problem.settings.level,
        test.experiment.case.contact, test.censored[part].astype(int),
    )  # fmt: skip


def plot_specimens(fit: FitResult) -> Figure:
    """Return the values of specimens and material of each key that scatters, or InputError."""
    outcome = fit.to_dict()
    scattering = {k: entry for k, entry in outcome["parameters"].items() if "each" in entry}
    if not scattering:
        raise InputError("plot_specimens: no key of the fit has scatter; must be a fit with one")
    widest = max(len(entry["each"]) for entry in scattering.values())
    size = max(_NARROWEST, 0.7 * min(widest, 16)), _LEGEND + _HEIGHT * len(scattering)
    panels = [[key_panels.specimens(k, entry, outcome["level"])] for k, entry in scattering.items()]
    return panel_figure(panels, size)
