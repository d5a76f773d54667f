"""The figure of a sweep, from its stored results: histories, sensitivity indices, final values.

Below them is what the surrogate of the results tells, see ``surrogate_figures``.

Where a design leaves many cases, they are chosen at random, with a fixed seed: every k-th case of a
Sobol sequence or of a grid is no sample of it.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import IntArray
from ringwear_par.errors import InputError
from ringwear_par.pictures.style import STYLE, NotebookFigure, check_format, save_figure
from ringwear_par.studies.analysis.effects import Key, Plan, draw_effects, key_of, plan_of
from ringwear_par.studies.analysis.predictions import Surrogate
from ringwear_par.studies.analysis.sensitivity import done_cases, outputs_of
from ringwear_par.studies.analysis.surrogate import surrogate
from ringwear_par.studies.pictures.fan import FEW, draw_fan, draw_histories
from ringwear_par.studies.pictures.index_bars import IndexBars, index_bars, most_important
from ringwear_par.studies.pictures.surrogate_figures import Responses
from ringwear_par.studies.storage.ensemble import Ensemble, read_ensemble

log = logging.getLogger(__name__)

#: keys that are drawn: with more of them the figure is of no use
_MOST_KEYS = 8
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
    _drawn(ensemble)
    try:
        regressions = surrogate(ensemble)
    except InputError as error:
        log.info("no surrogate: %s", error)
        return draw_sweep(ensemble)
    return draw_sweep(ensemble, regressions)


@dataclass(frozen=True)
class Choice:
    """What is drawn of a sweep.

    Parameters
    ----------
    cases : numbers of those that are done.
    outputs : names of final values.
    keys, plans : the varied keys of the largest indices, and how outputs are drawn against each.
    responses : what the surrogate tells of them; None: nothing, or there is none.
    told : how many cases and keys, in words.
    """

    cases: IntArray
    outputs: list[str]
    keys: list[Key]
    plans: list[Plan]
    responses: Responses | None
    told: str


def choose(ensemble: Ensemble, regressions: Surrogate | None, bars: Sequence[IndexBars]) -> Choice:
    """Choose what is drawn of a sweep. Not collective.

    Raises
    ------
    InputError : no case is done.
    """
    drawn = _drawn(ensemble)
    outputs = outputs_of(ensemble, drawn)
    varied = [
        key_of(name, values[drawn], ensemble.spacings.get(name, (None,))[0])
        for name, values in ensemble.varied.items()
    ]
    varied = [key for key in varied if key.differs] or varied
    names = most_important([key.name for key in varied], bars, _MOST_KEYS)
    keys = [key for key in varied if key.name in names]
    responses = None if regressions is None else Responses.of(regressions, outputs, names)
    method = str(ensemble.attributes.get("method"))
    plans = [plan_of(key, [other for other in varied if other is not key], method) for key in keys]
    told = _counts(ensemble)
    if len(keys) < len(varied):
        why = "of the largest indices" if bars else "the first"
        told += f"; {len(keys)} of {len(varied)} keys, {why}"
    return Choice(drawn, outputs, keys, plans, responses, told)


def draw_sweep(ensemble: Ensemble, regressions: Surrogate | None = None) -> Figure:
    """Return the figure of a sweep's results, with that of their surrogate. Not collective.

    Raises
    ------
    InputError : no case is done.
    """
    _drawn(ensemble)
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
        _draw_top(parts[0], ensemble, drawn, keys, top)
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


def _drawn(ensemble: Ensemble) -> IntArray:
    """Return the numbers of the cases that are drawn."""
    drawn = np.flatnonzero(done_cases(ensemble))
    if not len(drawn):
        raise InputError(
            f"{ensemble.path}: has no case that is done ({_counts(ensemble)}); must have one at "
            "least"
        )
    return drawn


def _counts(ensemble: Ensemble) -> str:
    """Say how many cases there are, and how many of them are not drawn."""
    status = np.array(ensemble.status)[ensemble.in_study]
    said = [f"{len(status)} case{'s' if len(status) != 1 else ''}"]
    for word in ("failed", "incomplete"):
        count = int((status == word).sum())
        if count:
            said.append(f"{count} {word}")
    return ", ".join(said)


def _blocks(plans: Sequence[Plan]) -> list[Sequence[Plan]]:
    """Return rows of columns, as even as may be."""
    if not plans:
        return []
    columns = -(-len(plans) // -(-len(plans) // _COLUMNS))
    return [plans[start : start + columns] for start in range(0, len(plans), columns)]


def _draw_top(
    part: Any, ensemble: Ensemble, drawn: IntArray, keys: Sequence[Key], bars: Sequence[IndexBars]
) -> None:
    panels = np.atleast_1d(
        part.subplots(1, 1 + len(bars), width_ratios=[1.3, *(1.0 for _ in bars)])
    )
    if len(drawn) > FEW:
        draw_fan(panels[0], ensemble, drawn, 2 if bars else 4)
    else:
        draw_histories(panels[0], ensemble, drawn, keys)
    _draw_bars(panels[1:], bars, keys)


def _bars_by_row(bars: Sequence[IndexBars]) -> list[Sequence[IndexBars]]:
    """Return those beside the histories, whose legend needs room, and rows of the rest."""
    if len(bars) < 2:
        return [bars]
    return [(), *(bars[start : start + _BARS] for start in range(0, len(bars), _BARS))]


def _draw_bars(panels: Any, bars: Sequence[IndexBars], keys: Sequence[Key]) -> None:
    for number, (axes, each) in enumerate(zip(panels, bars, strict=True)):
        each.draw(axes, [key.name for key in keys])
        if number and each.keys == bars[0].keys:
            axes.tick_params(labelleft=False)
