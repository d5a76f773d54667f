"""The figure of a sweep, from its stored results: histories, Sobol' indices, final values."""

import logging
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from ringwear_par.pictures.matplotlib import (
    add_letters,
    add_shared_legend,
    draw,
    legend_entries,
    legend_shape,
)
from ringwear_par.pictures.panel import Panel
from ringwear_par.pictures.style import STYLE, NotebookFigure, plain
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.pictures.effects import choose, effects, index_panels
from ringwear_par.studies.pictures.histories import histories

log = logging.getLogger(__name__)

#: most panels in a row, and inches of a panel and of a line of a legend
_COLUMNS, _PANEL, _LINE = 4, (2.3, 2.1), 0.18
#: letters of a line in a title, of a legend for each inch, and of a label along a panel's height
_TITLE_LETTERS, _LEGEND_LETTERS, _LABEL_LETTERS = 100, 14, 26


def draw_sweep(ensemble: Ensemble) -> Figure:
    """Return the figure of a sweep's results. Not collective."""
    choice = choose(ensemble)
    if choice.absence:
        log.info("no surrogate: %s", choice.absence)
    panels, bars = effects(ensemble, choice), [*index_panels(choice).values()]
    keys = [key.name for key in choice.keys]
    grids = [[[histories(ensemble, choice)]]]
    grids += [[bars[i : i + 3]] for i in range(0, len(bars), 3)]
    grids += [
        [[panels[output, key] for key in keys[i : i + _COLUMNS]] for output in choice.outputs]
        for i in range(0, len(keys), _COLUMNS)
    ]
    width = _PANEL[0] * max(3, *(len(row) for grid in grids for row in grid))
    letters = [int(_LEGEND_LETTERS * width / len(grid[0])) for grid in grids]
    heights = [
        _PANEL[1] * len(grid) + 0.4 + _LINE * max(legend_shape(panel, n)[1] for panel in grid[0])
        for grid, n in zip(grids, letters, strict=True)
    ]
    with matplotlib.rc_context(STYLE):
        figure = NotebookFigure(figsize=(width, sum(heights) + 0.5), layout="constrained")
        title = [choice.counts, *textwrap.wrap(choice.remark, _TITLE_LETTERS)]
        figure.suptitle("\n".join(map(plain, title)), fontsize=9.0)
        parts: Any = figure.subfigures(len(grids), 1, height_ratios=heights, squeeze=False)[:, 0]
        for part, grid, n in zip(parts, grids, letters, strict=True):
            _draw_grid(part, grid, n)
        add_letters(figure)
    return figure


def _draw_grid(part: Any, grid: Sequence[Sequence[Panel]], letters: int) -> None:
    """Draw rows of panels on the same scales: a column has one axis below, a row one on the left.

    Legends with a title stand above each column, others together above all.

    Parameters
    ----------
    letters : of a line of a column's legend.
    """
    sharey = "none" if grid[0][0].bars else "row"  # bars have ends, and would be reversed twice
    all_axes = part.subplots(len(grid), len(grid[0]), squeeze=False, sharex="col", sharey=sharey)
    entries: dict[str, Any] = {}
    for i, row in enumerate(grid):
        for j, (axes, panel) in enumerate(zip(all_axes[i], row, strict=True)):
            draw(axes, panel, legend_shape(panel, letters)[0] if panel.legend and not i else 0)
            if not panel.legend:
                entries |= legend_entries(axes)
            across = textwrap.fill(axes.get_xlabel(), _LEGEND_LETTERS * 2)
            axes.set_xlabel(across if i == len(grid) - 1 else "")
            axes.set_ylabel("" if j else textwrap.fill(axes.get_ylabel(), _LABEL_LETTERS))
            axes.tick_params(labelleft=not j)
            if not (panel.x.log or panel.x.categories):
                axes.locator_params(axis="x", nbins=4 if len(row) > 1 else 8)
    part.align_ylabels(all_axes[:, 0])
    add_shared_legend(part, entries)
