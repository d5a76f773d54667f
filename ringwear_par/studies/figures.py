"""The figure of a sweep, from its stored results: histories as a fan, final values against keys.

Below them is what the surrogate of the results tells, see ``surrogate_figures``.

Where a design leaves many cases, they are chosen at random, with a fixed seed: every k-th case of a
Sobol sequence or of a grid is no sample of it.
"""

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import InputError
from ringwear_par.results.figures import COLOURS, STYLE, check_figure, plain, save_figure
from ringwear_par.studies.axes import (
    GREY,
    LOG_VALUE,
    OUTPUTS,
    labelled,
    number_text,
    set_decades,
    set_legend,
    spans,
)
from ringwear_par.studies.designs import SAMPLED
from ringwear_par.studies.ensemble import Ensemble, read_ensemble
from ringwear_par.studies.sensitivity import (
    SEED,
    SENSITIVE,
    Sensitivity,
    chosen_cases,
    done_cases,
    sensitivity,
)
from ringwear_par.studies.surrogate import Surrogate, surrogate
from ringwear_par.studies.surrogate_figures import Responses

log = logging.getLogger(__name__)

_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*")
_DASHES: tuple[Any, ...] = ("-", "--", ":")
#: cases drawn one by one, and curves with a legend
_FEW, _CURVES = 12, 8
_MOST_HISTORIES, _TIMES, _SINGLES = 2000, 200, 8
_BLOCK_BYTES = 16e6
#: keys and values beside each other span so much before their axis is logarithmic
_LOG_KEY = 20.0
_COLUMNS, _PANEL, _WIDTH = 4, (2.3, 2.1), 7.2
_DISCRETE, _MOST_LEVELS = 12, 50
#: inches of a line of a legend
_LINE = 0.18
#: curves of a list show so much of its cases at least, the others as points
_SHARE = 0.25


@dataclass(frozen=True)
class _Key:
    """A varied key of the cases drawn: numbers, or codes of categories; NaN where there is none."""

    name: str
    values: FloatArray
    categories: tuple[str, ...]

    @property
    def label(self) -> str:
        return labelled(self.name)

    @property
    def differs(self) -> bool:
        return len(np.unique(self.values)) > 1

    @property
    def logarithmic(self) -> bool:
        if self.categories or not spans(self.values, _LOG_KEY):
            return False
        known = self.values[np.isfinite(self.values)]  # spread evenly, they stay on a plain axis
        return bool(np.median(known) < 0.3 * (known.min() + known.max()))


@dataclass(frozen=True)
class _Plan:
    """How outputs are drawn against a key.

    Parameters
    ----------
    key : the key.
    kind : "curves", "band" or "scatter".
    curves : cases of each curve, along the key.
    points : cases that are on none.
    labels : of the curves, with their points' behind them; () without a legend.
    title : of the legend.
    """

    key: _Key
    kind: str
    curves: tuple[IntArray, ...] = ()
    points: IntArray | None = None
    labels: tuple[str, ...] = ()
    title: str = ""

    @property
    def columns(self) -> int:
        """Number of columns of the legend, as even as may be."""
        if self.kind != "curves" or not self.labels:
            return 1
        most = max(1, min(4, 34 // (max(map(len, self.labels)) + 5)))
        return -(-len(self.labels) // -(-len(self.labels) // most))

    @property
    def lines(self) -> int:
        """Number of lines of the legend."""
        if self.kind != "curves":
            return 2 if self.kind == "band" else 1
        return -(-len(self.labels) // self.columns) + len(self.title.splitlines())


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
    keys = [_key(name, values[drawn]) for name, values in ensemble.varied.items()]
    keys = [key for key in keys if key.differs] or keys
    method = str(ensemble.attributes.get("method"))
    plans = [_plan(key, [other for other in keys if other is not key], method) for key in keys]
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
            _draw_block(part, block, values, shape, transposed=len(keys) == 1)
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


def _key(name: str, column: Any) -> _Key:
    if column.dtype.kind == "f":
        return _Key(name, column, ())
    words = list(dict.fromkeys(column))
    codes = {word: float(i) for i, word in enumerate(words)}
    values = np.array([codes[word] for word in column])
    return _Key(name, values, tuple(plain(word or "none") for word in words))


def _said(key: _Key) -> list[str]:
    """Return the key's value in each case, as short as its values stay apart."""
    if key.categories:
        return [key.categories[int(code)] for code in key.values]
    values = [float(value) for value in key.values]
    apart = len(set(values))
    for digits in range(3, 18):
        said = [number_text(v, digits) if math.isfinite(v) else "none" for v in values]
        if len(set(said)) >= apart:
            break
    return said


def _plan(key: _Key, others: Sequence[_Key], method: str) -> _Plan:
    """Choose how to draw against a key: in curves as far as its values repeat."""
    known = np.flatnonzero(np.isfinite(key.values))
    x = key.values[known]
    if method in SAMPLED or not len(x):
        return _Plan(key, "scatter")
    others = [other for other in others if len(np.unique(other.values[known])) > 1]
    codes = [np.unique(other.values[known], return_inverse=True)[1] for other in others]
    groups = np.zeros(len(x), dtype=int)
    if codes:
        table = np.stack(codes, axis=1)
        groups = np.unique(table, axis=0, return_inverse=True)[1].reshape(-1)
    sizes = np.bincount(groups)
    repeat = sizes > 1
    chosen = np.flatnonzero(repeat if repeat.any() else sizes)
    enough = repeat.any() and sizes[repeat].sum() >= _SHARE * len(x)
    if len(chosen) > _CURVES or not (enough or method == "grid"):
        levels = len(np.unique(x))
        band = method == "grid" or (len(x) >= 3 * levels and levels <= _MOST_LEVELS)
        return _Plan(key, "band" if band else "scatter")
    order = np.argsort(x, kind="stable")
    curves = [known[order[groups[order] == group]] for group in chosen]
    points = known[~np.isin(groups, chosen)]
    said = [_said(other) for other in others]
    labels = [", ".join(words[curve[0]] for words in said) for curve in curves] if said else []
    if labels and len(points):
        labels.append("other cases")
    title = ",\n".join(other.label for other in others)
    return _Plan(key, "curves", tuple(curves), points, tuple(labels), title)


def _blocks(plans: Sequence[_Plan]) -> list[Sequence[_Plan]]:
    """Return rows of columns, as even as may be."""
    if not plans:
        return []
    columns = -(-len(plans) // -(-len(plans) // _COLUMNS))
    return [plans[start : start + columns] for start in range(0, len(plans), columns)]


def _draw_top(
    part: Any, ensemble: Ensemble, drawn: IntArray, keys: Sequence[_Key],
    found: Sequence[Sensitivity],
) -> None:  # fmt: skip
    panels = np.atleast_1d(
        part.subplots(1, 1 + len(found), width_ratios=[1.3, *(1.0 for _ in found)])
    )
    if len(drawn) > _FEW:
        _draw_fan(panels[0], ensemble, drawn, 2 if found else 4)
    else:
        _draw_histories(panels[0], ensemble, drawn, keys)
    for number, (axes, indices) in enumerate(zip(panels[1:], found, strict=True)):
        _draw_indices(axes, indices)
        if number:
            axes.tick_params(labelleft=False)


def _draw_histories(axes: Any, ensemble: Ensemble, drawn: IntArray, keys: Sequence[_Key]) -> None:
    """Draw one line a case."""
    differ = [key for key in keys if key.differs]
    labels = [", ".join(words) for words in zip(*map(_said, differ), strict=True)]
    title = ",\n".join(key.label for key in differ)
    if len(differ) > 3:
        labels, title = [ensemble.ids[case] for case in drawn], "case"
    time, depth = (ensemble.histories(name, drawn) for name in ("time", "penetration"))
    for number, count in enumerate(ensemble.steps_stored[drawn]):
        axes.plot(
            time[number, :count], 1e3 * depth[number, :count],
            color=COLOURS[number % len(COLOURS)],
            linestyle=_DASHES[number // len(COLOURS)],
            label=labels[number] if labels else None,
        )  # fmt: skip
    _finish_fan(axes)
    if labels:
        axes.legend(
            frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), title=title,
            title_fontsize=8.0, ncols=1 if len(labels) <= 8 else 2,
        )  # fmt: skip


def _draw_fan(axes: Any, ensemble: Ensemble, drawn: IntArray, columns: int) -> None:
    """Draw quantile bands, the median and a few cases."""
    cases = chosen_cases(drawn, _MOST_HISTORIES)
    grid, table, even = _fan_table(ensemble, cases)
    low, lower, median, upper, high = np.nanquantile(table, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
    colour = COLOURS[0]
    by_depth = table[np.argsort(np.nanmax(table, axis=1))]  # the least and the deepest included
    for number, row in enumerate(by_depth[np.linspace(0, len(table) - 1, _SINGLES).astype(int)]):
        axes.plot(
            grid, row, color=GREY, linewidth=0.5, alpha=0.7, zorder=1.5,
            label=None if number else f"{_SINGLES} of the cases",
        )  # fmt: skip
    axes.fill_between(
        grid, low, high, color=colour, alpha=0.16, linewidth=0.0, label="5\N{EN DASH}95 %"
    )
    axes.fill_between(
        grid, lower, upper, color=colour, alpha=0.3, linewidth=0.0, label="25\N{EN DASH}75 %"
    )
    axes.plot(grid, median, color=colour, label="median")
    titles = []
    if len(cases) < len(drawn):
        titles.append(f"{len(cases)} of {len(drawn)} cases, chosen at random")
    if not even:
        titles.append("quantiles of the cases that last so long")
    _finish_fan(axes)
    set_legend(axes, columns, ",\n".join(titles))


def _finish_fan(axes: Any) -> None:
    axes.set_xlim(0.0, axes.dataLim.x1)
    axes.set_ylim(bottom=min(0.0, axes.dataLim.y0))
    axes.set_xlabel("time (s)")
    axes.set_ylabel(OUTPUTS["penetration"][1])


def _fan_table(ensemble: Ensemble, cases: IntArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return common times, penetrations (um) at them, (cases, times), and if all last equally.

    Histories that are shorter have NaN.
    """
    last = ensemble.steps_stored[cases] - 1
    ends = np.empty(len(cases))
    for part in _parts(ensemble, cases):
        time = ensemble.histories("time", cases[part])
        ends[part] = time[np.arange(len(time)), last[part]]
    grid = np.linspace(0.0, ends.max(), _TIMES + 1)
    table = np.empty((len(cases), len(grid)))
    for part in _parts(ensemble, cases):
        time, depth = (ensemble.histories(name, cases[part]) for name in ("time", "penetration"))
        for number, t, d in zip(range(part.start, part.stop), time, depth, strict=True):
            stop, end = last[number] + 1, ends[number] * (1.0 + 1e-9)
            table[number] = 1e3 * np.interp(grid, t[:stop], d[:stop])
            table[number, grid > end] = np.nan
    return grid, table, bool(ends.min() >= ends.max() * (1.0 - 1e-9))


def _parts(ensemble: Ensemble, cases: IntArray) -> Iterator[slice]:
    block = max(1, int(_BLOCK_BYTES // (8 * max(1, int(ensemble.steps_stored.max())))))
    for start in range(0, len(cases), block):
        yield slice(start, min(start + block, len(cases)))


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


def _draw_block(
    part: Any, plans: Sequence[_Plan], finals: Mapping[str, FloatArray], shape: tuple[int, int],
    *, transposed: bool,
) -> None:  # fmt: skip
    """Draw final values against keys: one column a key and one row an output, or transposed."""
    share = ("none", "none") if transposed else ("col", "row")
    panels = part.subplots(*shape, squeeze=False, sharex=share[0], sharey=share[1])
    panels = panels.T if transposed else panels
    for row, (output, final) in enumerate(finals.items()):
        factor, label = OUTPUTS[output]
        values = factor * final
        for column, plan in enumerate(plans):
            axes = panels[row, column]
            _draw_panel(axes, plan, values, legend=row == 0)
            if row == len(panels) - 1 or transposed:
                axes.set_xlabel(plan.key.label)
            if column == 0:
                axes.set_ylabel(f"final {label}" if output == "penetration" else label)
        if spans(values, LOG_VALUE):
            for axes in panels[row]:
                axes.set_yscale("log")
            set_decades(panels[row, 0].yaxis, values)
    if not transposed:
        part.align_ylabels(panels[:, 0])


def _draw_panel(axes: Any, plan: _Plan, values: FloatArray, *, legend: bool) -> None:
    """Draw an output against a key."""
    key = plan.key
    if key.logarithmic:
        axes.set_xscale("log")
        set_decades(axes.xaxis, key.values)
    known = np.isfinite(key.values) & np.isfinite(values)
    if plan.kind == "curves":
        _draw_curves(axes, plan, values)
    elif plan.kind == "band" and known.any():
        _draw_band(axes, key, key.values[known], values[known])
    else:
        _draw_scatter(axes, key, key.values[known], values[known])
    if legend and axes.get_legend_handles_labels()[0]:
        set_legend(axes, plan.columns, plan.title)
    if key.categories:
        _set_categories(axes, key.categories)
    elif not key.logarithmic:
        wide = np.abs(key.values[known]).max(initial=0.0) >= 1e4
        axes.locator_params(axis="x", nbins=3 if wide else 5)


def _draw_curves(axes: Any, plan: _Plan, values: FloatArray) -> None:
    """Draw one curve for each combination of the other keys."""
    x = plan.key.values
    for number, curve in enumerate(plan.curves):
        axes.plot(
            x[curve], values[curve], color=COLOURS[number % len(COLOURS)],
            linestyle=_DASHES[number // len(COLOURS)], marker=_MARKERS[number], markersize=4.0,
            linewidth=1.0, label=plan.labels[number] if plan.labels else None,
        )  # fmt: skip
    if plan.points is not None and len(plan.points):
        axes.plot(
            x[plan.points], values[plan.points], color=GREY, marker=".", linestyle="none",
            label="other cases", zorder=1.5,
        )  # fmt: skip


def _draw_band(axes: Any, key: _Key, x: FloatArray, y: FloatArray) -> None:
    """Draw the median over the other keys, and what lies between."""
    levels = np.unique(x)
    parts = [y[x == level] for level in levels]
    all_of_it = np.median([len(part) for part in parts]) < 20
    ends = (0.0, 1.0) if all_of_it else (0.05, 0.95)
    low, middle, high = np.array([np.quantile(part, [ends[0], 0.5, ends[1]]) for part in parts]).T
    style: dict[str, Any] = {"color": COLOURS[0], "marker": "o", "markersize": 4.0}
    median = "median over the others"
    width = "full range" if all_of_it else "5\N{EN DASH}95 %"
    if key.categories:
        bars = np.array([middle - low, high - middle])
        axes.errorbar(
            levels, middle, yerr=bars, linestyle="none", capsize=3.0, linewidth=1.0,
            label=f"{median},\n{width}", **style,
        )  # fmt: skip
    else:
        axes.fill_between(
            levels, low, high, color=COLOURS[0], alpha=0.2, linewidth=0.0, label=width
        )
        axes.plot(levels, middle, label=median, **style)


def _draw_scatter(axes: Any, key: _Key, x: FloatArray, y: FloatArray) -> None:
    levels = np.unique(x)
    aside = np.random.default_rng(SEED).uniform(-0.2, 0.2, len(x)) if key.categories else 0.0
    many = len(x) > 200
    axes.plot(
        x + aside, y, color=COLOURS[0], marker="o", linestyle="none", rasterized=many,
        markersize=float(np.clip(60.0 / math.sqrt(max(len(x), 1)), 1.2, 4.0)),
        markeredgewidth=0.0, alpha=min(0.8, 11.0 / math.sqrt(len(x))) if many else 0.8,
    )  # fmt: skip
    if len(levels) <= _DISCRETE and len(x) >= 5 * len(levels):
        middle = np.array([np.median(y[x == level]) for level in levels])
        style = {"linestyle": "none", "marker": "_", "markersize": 14.0, "markeredgewidth": 1.6}
        axes.plot(levels, middle, color=COLOURS[1], label="median", **style)
    elif many:
        parts = np.array_split(np.argsort(x, kind="stable"), min(20, len(x) // 50))
        middle = np.array([[np.median(x[part]), np.median(y[part])] for part in parts])
        axes.plot(*middle.T, color=COLOURS[1], label="running median")


def _set_categories(axes: Any, categories: Sequence[str]) -> None:
    every = -(-len(categories) // 12)
    places = range(0, len(categories), every)
    words = [categories[i] for i in places]
    axes.set_xticks(list(places), words)
    axes.set_xlim(-0.6, len(categories) - 0.4)
    if sum(len(word) + 2 for word in words) > 34:
        axes.tick_params(axis="x", rotation=35.0)
        for text in axes.get_xticklabels():
            text.set_horizontalalignment("right")
