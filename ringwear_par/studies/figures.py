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

from ringwear_par.arrays import IntArray
from ringwear_par.errors import InputError
from ringwear_par.results.figures import COLOURS, STYLE, check_figure, save_figure
from ringwear_par.studies.axes import set_legend
from ringwear_par.studies.effects import Key, Plan, draw_effects, key_of, plan_of
from ringwear_par.studies.ensemble import Ensemble, read_ensemble
from ringwear_par.studies.fan import draw_fan, draw_histories
from ringwear_par.studies.predictions import Surrogate
from ringwear_par.studies.sensitivity import SENSITIVE, Sensitivity, done_cases, sensitivity
from ringwear_par.studies.surrogate import surrogate
from ringwear_par.studies.surrogate_figures import Responses

log = logging.getLogger(__name__)

#: cases drawn one by one
_FEW = 12
_COLUMNS, _PANEL, _WIDTH = 4, (2.3, 2.1), 7.2
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
    check_figure(output)
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


def draw_sweep(ensemble: Ensemble, regressions: Surrogate | None = None) -> Figure:
    """Return the figure of a sweep's results, with that of their surrogate. Not collective.

    Raises
    ------
    InputError : no case is done.
    """
    drawn = _drawn(ensemble)
    keys = [key_of(name, values[drawn]) for name, values in ensemble.varied.items()]
    keys = [key for key in keys if key.differs] or keys
    method = str(ensemble.attributes.get("method"))
    plans = [plan_of(key, [other for other in keys if other is not key], method) for key in keys]
    outputs = ["penetration", "worn_volume_lower"]
    upper = ensemble.final["worn_volume_upper"][drawn]
    if np.any(upper[np.isfinite(upper)] != 0.0):
        outputs.append("worn_volume_upper")
    found = sensitivity(ensemble)
    blocks = _blocks(plans)
    shapes = [
        (len(outputs), len(block)) if len(keys) > 1 else (1, len(outputs)) for block in blocks
    ]
    with matplotlib.rc_context(STYLE):
        top = max(2.6, 1.5 + 0.3 * len(found[0].keys)) if found else 2.6
        heights = [top]
        for block, (rows, _) in zip(blocks, shapes, strict=True):
            heights.append(_PANEL[1] * rows + 0.3 + _LINE * max(plan.lines for plan in block))
        below = Responses.of(regressions, outputs) if regressions is not None else None
        if below is not None:
            heights += below.heights
        width = max(_WIDTH, _PANEL[0] * max((columns for _, columns in shapes), default=0))
        figure = Figure(figsize=(width, sum(heights) + 0.3), layout="constrained")
        figure.suptitle(_counts(ensemble), fontsize=9.0)
        parts: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_top(parts[0], ensemble, drawn, keys, found)
        for part, block, shape in zip(parts[1 : 1 + len(blocks)], blocks, shapes, strict=True):
            values = {name: ensemble.final[name][drawn] for name in outputs}
            draw_effects(part, block, values, shape, transposed=len(keys) == 1)
        if below is not None:
            below.draw(parts[1 + len(blocks) :])
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
    part: Any, ensemble: Ensemble, drawn: IntArray, keys: Sequence[Key],
    found: Sequence[Sensitivity],
) -> None:  # fmt: skip
    panels = np.atleast_1d(
        part.subplots(1, 1 + len(found), width_ratios=[1.3, *(1.0 for _ in found)])
    )
    if len(drawn) > _FEW:
        draw_fan(panels[0], ensemble, drawn, 2 if found else 4)
    else:
        draw_histories(panels[0], ensemble, drawn, keys)
    for number, (axes, indices) in enumerate(zip(panels[1:], found, strict=True)):
        _draw_indices(axes, indices)
        if number:
            axes.tick_params(labelleft=False)


def _draw_indices(axes: Any, found: Sensitivity) -> None:
    places = np.arange(len(found.keys), dtype=float)
    for shift, colour, values, widths, label in (
        (-0.17, COLOURS[0], found.delta, found.delta_conf, "\N{GREEK SMALL LETTER DELTA}"),
        (0.17, COLOURS[1], found.s1, found.s1_conf, "S\N{SUBSCRIPT ONE}"),
    ):
        axes.barh(
            places + shift, values, 0.3, xerr=widths, color=colour, alpha=0.75, label=label,
            error_kw={"ecolor": "0.1", "elinewidth": 0.9, "capsize": 2.0},
        )  # fmt: skip
    axes.set_yticks(places, found.keys)
    axes.set_ylim(len(places) - 0.5, -0.5)
    axes.set_xlim(0.0, 1.04)
    axes.grid(axis="x", linewidth=0.4, color="0.85")
    axes.set_axisbelow(True)
    axes.set_xlabel("index, 95 % confidence")
    title = f"sensitivity of\n{SENSITIVE[found.output]}"
    if found.used < found.cases:
        title += f"\n({found.used} of {found.cases} cases)"
    set_legend(axes, 2, title)
