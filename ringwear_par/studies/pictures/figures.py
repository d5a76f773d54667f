"""The figure of a sweep, from its stored results: histories, sensitivity indices, final values.

Below them is what the surrogate of the results tells, see ``surrogate_figures``.

Where a design leaves many cases, they are chosen at random, with a fixed seed: every k-th case of a
Sobol sequence or of a grid is no sample of it.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.errors import InputError
from ringwear_par.pictures.matplotlib import draw
from ringwear_par.pictures.style import STYLE, NotebookFigure, check_format, save_figure
from ringwear_par.studies.analysis.effects import Key, Plan, draw_effects
from ringwear_par.studies.analysis.predictions import Surrogate
from ringwear_par.studies.analysis.surrogate import surrogate
from ringwear_par.studies.pictures.choice import Choice, choose, done
from ringwear_par.studies.pictures.fan import FEW
from ringwear_par.studies.pictures.index_bars import IndexBars, index_bars
from ringwear_par.studies.pictures.panels import histories, indices
from ringwear_par.studies.storage.ensemble import Ensemble, read_ensemble

log = logging.getLogger(__name__)

_COLUMNS, _PANEL, _WIDTH = 4, (2.3, 2.1), 7.2
#: indices of outputs in a row, below the histories where there are more than one
_BARS = 3
#: inches of a line of a legend
_LINE = 0.18


def plot_sweep(folder: Path, output: Path) -> None:
    """Draw a sweep's results. On one rank.

    Parameters
    ----------
    folder : of the sweep.
    output : picture; its ending chooses the format.

    Raises
    ------
    InputError : the folder holds no results or no case that is done, or an unknown format.
    """
    check_format(output)
    figure = draw_sweep_and_surrogate(read_ensemble(folder))
    save_figure(figure, output)


def draw_sweep_and_surrogate(ensemble: Ensemble) -> Figure:
    """Return the figure of a sweep's results, with their surrogate if one can be made.

    Not collective.

    Raises
    ------
    InputError : no case is done.
    """
    done(ensemble)
    try:
        regressions = surrogate(ensemble)
    except InputError as error:
        log.info("no surrogate: %s", error)
        return draw_sweep(ensemble)
    return draw_sweep(ensemble, regressions)


def draw_sweep(ensemble: Ensemble, regressions: Surrogate | None = None) -> Figure:
    """Return the figure of a sweep's results, with that of their surrogate. Not collective.

    Raises
    ------
    InputError : no case is done.
    """
    done(ensemble)
    bars = index_bars(ensemble, regressions)
    chosen = choose(ensemble, regressions, bars)
    drawn, outputs, keys = chosen.cases, chosen.outputs, chosen.keys
    plans, below = chosen.plans, chosen.responses
    if below is not None:  # which has the cases, too
        plans = [plan for plan in plans if plan.kind == "curves" or not below.shows(plan.key.name)]
    blocks = _blocks(plans)
    shapes = [
        (len(outputs), len(block)) if len(keys) > 1 else (1, len(outputs)) for block in blocks
    ]
    with matplotlib.rc_context(STYLE):
        top, *more = _bars_by_row(bars)
        of_bars = max(2.6, 1.8 + 0.3 * len(keys))
        heights = [of_bars if top else 2.6] + [of_bars] * len(more)
        for block, (rows, _) in zip(blocks, shapes, strict=True):
            heights.append(_PANEL[1] * rows + 0.3 + _LINE * max(plan.lines for plan in block))
        if below is not None:
            heights += below.heights
        columns = max((columns for _, columns in shapes), default=0)
        if below is not None:
            columns = max(columns, below.columns)
        width = max(_WIDTH, _PANEL[0] * columns)
        figure = NotebookFigure(figsize=(width, sum(heights) + 0.3), layout="constrained")
        figure.suptitle(chosen.told, fontsize=9.0)
        parts: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_top(parts[0], ensemble, chosen, top)
        for part, row in zip(parts[1:], more, strict=False):
            panels = part.subplots(1, _BARS)
            _draw_bars(panels[: len(row)], row, keys)
            for axes in panels[len(row) :]:
                axes.remove()
        parts = parts[1 + len(more) :]
        for part, block, shape in zip(parts[: len(blocks)], blocks, shapes, strict=True):
            values = {name: ensemble.final[name][drawn] for name in outputs}
            draw_effects(part, block, values, shape, transposed=len(keys) == 1)
        if below is not None:
            below.draw(parts[len(blocks) :])
    return figure


def _blocks(plans: Sequence[Plan]) -> list[Sequence[Plan]]:
    """Return rows of columns, as even as may be."""
    if not plans:
        return []
    columns = -(-len(plans) // -(-len(plans) // _COLUMNS))
    return [plans[start : start + columns] for start in range(0, len(plans), columns)]


def _draw_top(part: Any, ensemble: Ensemble, choice: Choice, bars: Sequence[IndexBars]) -> None:
    panels = np.atleast_1d(
        part.subplots(1, 1 + len(bars), width_ratios=[1.3, *(1.0 for _ in bars)])
    )
    panel = histories(ensemble, choice)
    if len(choice.cases) > FEW:
        draw(panels[0], panel, 2 if bars else 4)
    else:
        draw(panels[0], panel, 0)
        if panel.legend:
            labels = [curve.name for curve in panel.curves]
            panels[0].legend(
                frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), title=panel.legend,
                title_fontsize=8.0, ncols=1 if len(labels) <= 8 else 2,
            )  # fmt: skip
    _draw_bars(panels[1:], bars, choice.keys)


def _bars_by_row(bars: Sequence[IndexBars]) -> list[Sequence[IndexBars]]:
    """Return those beside the histories, whose legend needs room, and rows of the rest."""
    if len(bars) < 2:
        return [bars]
    return [(), *(bars[start : start + _BARS] for start in range(0, len(bars), _BARS))]


def _draw_bars(panels: Any, bars: Sequence[IndexBars], keys: Sequence[Key]) -> None:
    for number, (axes, each) in enumerate(zip(panels, bars, strict=True)):
        draw(axes, indices(each, [key.name for key in keys]), 1)
        axes.grid(axis="x", linewidth=0.4, color="0.85")
        axes.set_axisbelow(True)
        if number and each.keys == bars[0].keys:
            axes.tick_params(labelleft=False)
