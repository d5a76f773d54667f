"""The figure of a sweep, from its stored results: histories, sensitivity indices, final values.

Where a design leaves many cases, they are chosen at random, with a fixed seed: every k-th case of a
Sobol sequence or of a grid is no sample of it.
"""

import logging
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from ringwear_par.errors import InputError
from ringwear_par.pictures.matplotlib import (
    add_letters,
    add_shared_legend,
    draw,
    legend_entries,
    legend_shape,
)
from ringwear_par.pictures.panel import Panel
from ringwear_par.pictures.style import STYLE, NotebookFigure, number_text, plain, set_legend
from ringwear_par.studies.analysis.sensitivity import Indices, sensitivity_indices
from ringwear_par.studies.analysis.surrogate import Surrogate, surrogate
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.pictures.choice import Choice, choose
from ringwear_par.studies.pictures.effects import effects, index_panels, pointed_cases
from ringwear_par.studies.pictures.histories import FEW, histories

log = logging.getLogger(__name__)

#: panels in a row: of final values, of indices
_COLUMNS, _BARS = 4, 3
#: inches of a panel of final values, and of the figure at least
_PANEL, _WIDTH = (2.3, 2.1), 7.2
#: inches of a line of a legend, and of a title
_LEGEND_LINE, _TITLE_LINE = 0.18, 0.15
#: letters of a line in a title, of a legend above a panel, and of a label along its height
_TITLE_LETTERS, _LEGEND_LETTERS, _LABEL_LETTERS = 100, 34, 26


def draw_sweep_and_surrogate(ensemble: Ensemble) -> Figure:
    """Return the figure of a sweep's results, with a surrogate if one can be made.

    Not collective.
    """
    try:
        return draw_sweep(ensemble, surrogate(ensemble))
    except InputError as error:
        log.info("no surrogate: %s", error)
        return draw_sweep(ensemble)


def draw_sweep(ensemble: Ensemble, regressions: Surrogate | None = None) -> Figure:
    """Return the figure of a sweep's results, with that of their surrogate. Not collective."""
    indices = sensitivity_indices(ensemble, regressions)
    choice = choose(ensemble, regressions, indices)
    grids, remarks = _grids(ensemble, choice), _remarks(choice)
    with matplotlib.rc_context(STYLE):
        beside, *below = _index_rows(indices, [key.name for key in choice.keys])
        bars_height = max(2.6, 1.8 + 0.3 * len(choice.keys))
        heights = [bars_height if beside else 2.6] + [bars_height] * len(below)
        for number, grid in enumerate(grids):
            lines = max(legend_shape(panel, _LEGEND_LETTERS)[1] for panel in grid[0])
            titles = 0 if number else len(remarks)
            heights.append(
                _PANEL[1] * len(grid) + 0.3 + _LEGEND_LINE * lines + _TITLE_LINE * titles
            )
        width = max(_WIDTH, _PANEL[0] * max((len(grid[0]) for grid in grids), default=0))
        figure = NotebookFigure(figsize=(width, sum(heights) + 0.3), layout="constrained")
        figure.suptitle(choice.counts, fontsize=9.0)
        parts: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_top(parts[0], histories(ensemble, choice), beside, len(choice.cases))
        for part, row in zip(parts[1:], below, strict=False):
            axes = part.subplots(1, len(below[0]), squeeze=False)[0]
            _draw_bars(axes[: len(row)], row)
            for empty in axes[len(row) :]:
                empty.remove()
        for number, (part, grid) in enumerate(zip(parts[1 + len(below) :], grids, strict=True)):
            _draw_grid(part, grid, "" if number else "\n".join(remarks))
        add_letters(figure)
    return figure


def _grids(ensemble: Ensemble, choice: Choice) -> list[list[list[Panel]]]:
    """Return the panels of final values in grids, their columns as even as may be.

    A column is a key and a row an output, but for a single key, whose outputs stand in a row.
    """
    panels = effects(ensemble, choice)
    keys = [key.name for key in choice.keys]
    if len(keys) == 1:
        return [[[panels[output, keys[0]] for output in choice.outputs]]]
    columns = -(-len(keys) // -(-len(keys) // _COLUMNS))
    return [
        [
            [panels[output, key] for key in keys[start : start + columns]]
            for output in choice.outputs
        ]
        for start in range(0, len(keys), columns)
    ]


def _remarks(choice: Choice) -> list[str]:
    """Return the remarks on final values, in lines."""
    remarks = [] if choice.responses is None else [*choice.responses.remarks]
    pointed = len(pointed_cases(choice))
    if pointed < len(choice.cases):
        remarks.append(f"points: {pointed} of {len(choice.cases)} cases, chosen at random")
    return [plain(line) for text in remarks for line in textwrap.wrap(text, _TITLE_LETTERS)]


def _draw_top(part: Any, panel: Panel, bars: Sequence[Panel], cases: int) -> None:
    """Draw the histories, and bars beside them."""
    axes = part.subplots(1, 1 + len(bars), width_ratios=[1.3, *(1.0 for _ in bars)], squeeze=False)[
        0
    ]
    if cases > FEW:
        draw(axes[0], panel, 2 if bars else 4)
    else:
        draw(axes[0], panel, 0)
        if panel.legend:
            axes[0].legend(
                frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), title=panel.legend,
                title_fontsize=8.0, ncols=1 if cases <= 8 else 2,
            )  # fmt: skip
    _draw_bars(axes[1:], bars)


def _index_rows(indices: Sequence[Indices], keys: Sequence[str]) -> list[Sequence[Panel]]:
    """Return panels beside the histories, whose legend needs room, and rows of the rest."""
    panels = [*index_panels(indices, keys).values()]
    if len(panels) < 2:
        return [panels]
    return [(), *(panels[start : start + _BARS] for start in range(0, len(panels), _BARS))]


def _draw_bars(all_axes: Any, panels: Sequence[Panel]) -> None:
    for axes, panel in zip(all_axes, panels, strict=True):
        draw(axes, panel, 1)
        axes.grid(axis="x", linewidth=0.4, color="0.85")
        axes.set_axisbelow(True)
        if panel is not panels[0] and panel.y == panels[0].y:
            axes.tick_params(labelleft=False)


def _draw_grid(part: Any, grid: Sequence[Sequence[Panel]], remarks: str) -> None:
    """Draw panels of final values: those of a key below each other, an output on one scale.

    They share a legend, but for curves of other keys' values, which each column names for itself.
    """
    all_axes = part.subplots(len(grid), len(grid[0]), squeeze=False, sharex="col")
    entries: dict[str, Any] = {}
    for number, row in enumerate(grid):
        for axes, panel in zip(all_axes[number], row, strict=True):
            draw(axes, panel, 0)
            every, column = legend_entries(axes), _of_column(panel)
            names = [plain(curve.name) for curve in column.curves]
            entries |= {name: handle for name, handle in every.items() if name not in names}
            if names and not number:
                columns = legend_shape(column, _LEGEND_LETTERS)[0]
                set_legend(axes, columns, panel.legend, {name: every[name] for name in names})
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


def _of_column(panel: Panel) -> Panel:
    """Return a panel with what its column alone names: curves at other values of other keys."""
    curves = [curve for curve in panel.curves if panel.legend and curve.cases is not None]
    return replace(panel, curves=curves, bands=(), points=())
