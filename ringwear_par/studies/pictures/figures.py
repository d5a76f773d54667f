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
from ringwear_par.pictures.style import STYLE, NotebookFigure, number_text, plain, set_legend
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.pictures.effects import Choice, choose, effects, index_panels
from ringwear_par.studies.pictures.histories import histories

log = logging.getLogger(__name__)

#: most panels in a row: of final values, of indices
_COLUMNS, _BARS = 4, 3
#: inches of a panel of final values, of the figure at least, of the histories
_PANEL, _WIDTH, _TOP = (2.3, 2.1), 7.2, 2.3
#: inches of a line of a legend, and of a title
_LEGEND_LINE, _TITLE_LINE = 0.18, 0.15
#: letters of a line in a title, of a legend above a panel, and of a label along its height
_TITLE_LETTERS, _LEGEND_LETTERS, _LABEL_LETTERS = 100, 34, 26


def draw_sweep(ensemble: Ensemble) -> Figure:
    """Return the figure of a sweep's results. Not collective."""
    choice = choose(ensemble)
    if choice.absence:
        log.info("no surrogate: %s", choice.absence)
    bars, grids = [*index_panels(choice).values()], _grids(ensemble, choice)
    remarks = [
        plain(line) for text in choice.remarks() for line in textwrap.wrap(text, _TITLE_LETTERS)
    ]
    over_time = histories(ensemble, choice)
    heights = [_TOP + _LEGEND_LINE * legend_shape(over_time, _TITLE_LETTERS)[1]]
    heights += [1.3 + 0.3 * len(choice.keys)] * -(-len(bars) // _BARS)
    for number, grid in enumerate(grids):
        lines = max(legend_shape(panel, _LEGEND_LETTERS)[1] for panel in grid[0])
        titles = 0 if number else len(remarks)
        heights.append(_PANEL[1] * len(grid) + 0.3 + _LEGEND_LINE * lines + _TITLE_LINE * titles)
    width = max(_WIDTH, *(_PANEL[0] * len(grid[0]) for grid in grids))
    with matplotlib.rc_context(STYLE):
        figure = NotebookFigure(figsize=(width, sum(heights) + 0.3), layout="constrained")
        figure.suptitle(choice.counts, fontsize=9.0)
        parts: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        draw(parts[0].subplots(), over_time, 4)
        for start, part in zip(range(0, len(bars), _BARS), parts[1:], strict=False):
            _draw_bars(part, bars[start : start + _BARS])
        for number, grid in enumerate(grids):
            _draw_grid(parts[number - len(grids)], grid, "" if number else "\n".join(remarks))
        add_letters(figure)
    return figure


def _grids(ensemble: Ensemble, choice: Choice) -> list[list[list[Panel]]]:
    """Return the panels of final values in grids: a column is a key and a row an output.

    Their columns are as even as may be; the outputs of a single key stand in a row.
    """
    panels = effects(ensemble, choice)
    keys = [key.name for key in choice.keys]
    if len(keys) == 1:
        return [[[*panels.values()]]]
    columns = -(-len(keys) // -(-len(keys) // _COLUMNS))
    parts = [keys[start : start + columns] for start in range(0, len(keys), columns)]
    return [[[panels[output, key] for key in part] for output in choice.outputs] for part in parts]


def _draw_bars(part: Any, panels: Sequence[Panel]) -> None:
    """Draw bars of indices beside each other, for the same keys."""
    all_axes = part.subplots(1, len(panels), squeeze=False)[0]
    for axes, panel in zip(all_axes, panels, strict=True):
        draw(axes, panel, 2)
        axes.grid(axis="x", linewidth=0.4, color="0.85")
        axes.set_axisbelow(True)
        axes.tick_params(labelleft=panel is panels[0])


def _draw_grid(part: Any, grid: Sequence[Sequence[Panel]], remarks: str) -> None:
    """Draw panels of final values: those of a key below each other, an output on one scale.

    They share a legend, but for curves of other keys' values, which each column names for itself.
    """
    all_axes = part.subplots(len(grid), len(grid[0]), squeeze=False, sharex="col")
    entries: dict[str, Any] = {}
    for number, row in enumerate(grid):
        for axes, panel in zip(all_axes[number], row, strict=True):
            draw(axes, panel, 0)
            if not panel.legend:
                entries |= legend_entries(axes)
            elif not number:
                columns = legend_shape(panel, _LEGEND_LETTERS)[0]
                set_legend(axes, columns, panel.legend, legend_entries(axes))
            axes.set_ylabel(textwrap.fill(axes.get_ylabel(), _LABEL_LETTERS))
            below = textwrap.fill(axes.get_xlabel(), _LABEL_LETTERS)
            axes.set_xlabel(below if number == len(grid) - 1 else "")
            if not (panel.x.log or panel.x.categories):
                axes.locator_params(axis="x", nbins=3 if max(axes.get_xlim()) >= 1e4 else 5)
                axes.xaxis.set_major_formatter(lambda value, _: number_text(value, 6))
        if row[0].y.label == row[-1].y.label:
            low, high = zip(*(axes.get_ylim() for axes in all_axes[number]), strict=True)
            for axes in all_axes[number]:
                axes.set_ylim(min(low), max(high))
            for axes in all_axes[number, 1:]:
                axes.set_ylabel("")
                axes.tick_params(labelleft=False)
    part.align_ylabels(all_axes[:, 0])
    add_shared_legend(part, entries, remarks)
