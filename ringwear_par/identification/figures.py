"""Figures of a fit, of the panels that its page has: readings, fitted keys, specimens."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.draws import Draws
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


def of_readings(tests: Sequence[FittedTest], inputs: Sequence[Panel], level: float) -> Figure:
    """Return the figure of data, model, its band at a level, and residuals; then measured inputs.

    Series of one reading, such as weighings, share a strip below: a line each.
    """
    every = [drawn_series(test, *record, level) for test in tests for record in test.records]
    curves = [series for series in every if len(series.x) > 1]
    single = [series for series in every if len(series.x) == 1]
    across = 2 if len(curves) == 4 else min(_COLUMNS, max(len(curves), 1))
    rows: list[list[Panel]] = []
    for first in range(0, len(curves), across):
        beside = curves[first : first + across]
        rows += [[*map(fit_panels.readings, beside)], [*map(fit_panels.residuals, beside)]]
    shares = [5, 2] * (len(rows) // 2)
    height = _LEGEND + _HEIGHT * len(rows) / 2
    for first in range(0, len(inputs), across):
        rows, shares = [*rows, [*inputs[first : first + across]]], [*shares, 4]
        height += _INPUT
    # two parts: labels of the strip make no panel above it narrower
    parts = [(rows, shares, height)] if rows else []
    if single:
        strip = [[fit_panels.single_readings(single)]]
        parts.append((strip, [1], _LEGEND * (not rows) + _MARGIN + _ROW * len(single)))
    heights = [height for _, _, height in parts]
    with matplotlib.rc_context(STYLE):
        size = max(_WIDTH * across, _NARROWEST), sum(heights)
        chart = NotebookFigure(figsize=size, layout="constrained")
        places = chart.subfigures(len(parts), 1, height_ratios=heights, squeeze=False)[:, 0]
        for place, (panels, shares, _) in zip(places, parts, strict=True):
            panel_grid(place, panels, shares, legend=place is places[0])
        add_letters(chart)
    return chart


def drawn_series(test: FittedTest, series: Series, part: slice, level: float) -> fit_panels.Series:
    """Return a series with its model, in the unit of its readings."""
    scale = 1.0 / series.factor
    return fit_panels.Series(
        test.experiment.name, series.name, series.quantity, series.unit, series.x,
        scale * series.value, scale * test.model[part], scale * test.sd[part],
        scale * test.band[part], test.residuals[part], level,
        test.experiment.case.contact, test.censored[part].astype(int),
    )  # fmt: skip


def of_keys(outcome: Mapping[str, Any], draws: Draws) -> Figure:
    """Return the draws of each key, and of pairs, by the contents of fit.json."""
    by_key = dict(zip(draws.keys, draws.values(draws.material).T, strict=True))
    rows = key_panels.fitted_keys(outcome, by_key)
    return panel_figure(rows, (0.8 + 3.2 * len(rows), 0.8 + 3.1 * len(rows)))


def of_specimens(outcome: Mapping[str, Any]) -> Figure:
    """Return the values of specimens and material of each key that scatters, by fit.json."""
    scattering = {k: entry for k, entry in outcome["parameters"].items() if "each" in entry}
    widest = max(len(entry["each"]) for entry in scattering.values())
    size = max(_NARROWEST, 0.7 * min(widest, 16)), _LEGEND + _HEIGHT * len(scattering)
    panels = [[key_panels.specimens(k, entry, outcome["level"])] for k, entry in scattering.items()]
    return panel_figure(panels, size)
