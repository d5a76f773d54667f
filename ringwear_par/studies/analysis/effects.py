"""Final values of a sweep against each key: curves, bands or points, as its design has it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.files.text import parse_value
from ringwear_par.pictures.style import COLOURS, DASHES, in_words, plain, set_legend
from ringwear_par.studies.analysis.regression import SEED
from ringwear_par.studies.definition.axes import (
    GREY,
    LOG_VALUE,
    labelled,
    least_range,
    number_text,
    set_decades,
    spans,
    upright,
)
from ringwear_par.studies.definition.designs import SAMPLED
from ringwear_par.studies.storage.end_values import display_of

_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*")
#: most curves with a legend
_CURVES = 8
#: keys beside each other span so much before their axis is logarithmic
_LOG_KEY = 20.0
_DISCRETE, _MOST_LEVELS = 12, 50
#: curves of a list show so much of its cases at least, the others as points
_SHARE = 0.25


@dataclass(frozen=True)
class Key:
    """A varied key of the cases drawn.

    Parameters
    ----------
    name : of the key.
    values : (cases,) numbers, or codes of categories; NaN where there is none.
    categories : in words.
    by_log : whether the design spaces it by logarithms; None: it has no spacing.
    """

    name: str
    values: FloatArray
    categories: tuple[str, ...]
    by_log: bool | None = None

    @property
    def label(self) -> str:
        """Its name with its unit."""
        return labelled(self.name)

    @property
    def differs(self) -> bool:
        """Whether cases differ in it."""
        return len(np.unique(self.values)) > 1

    @property
    def logarithmic(self) -> bool:
        """Whether its axis is."""
        if self.by_log is not None and self.differs and spans(self.values, 1.0):
            return self.by_log
        if self.categories or not spans(self.values, _LOG_KEY):
            return False
        known = self.values[np.isfinite(self.values)]  # spread evenly, they stay on a plain axis
        return bool(np.median(known) < 0.3 * (known.min() + known.max()))


@dataclass(frozen=True)
class Plan:
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

    key: Key
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


def key_of(name: str, column: Any, by_log: bool | None = None) -> Key:
    """Return a varied key of some cases."""
    if column.dtype.kind == "f":
        return Key(name, column, (), by_log)
    words = list(dict.fromkeys(column))
    codes = {word: float(i) for i, word in enumerate(words)}
    values = np.array([codes[word] for word in column])
    return Key(name, values, tuple(_categories(words)))


def _categories(words: Sequence[str]) -> list[str]:
    """Return raw values in few words, numbered where these are the same."""
    told = [in_words(parse_value(word)) if word else "none" for word in words]
    numbers = [told[: i + 1].count(text) for i, text in enumerate(told)]
    return [
        f"{text} ({number})" if told.count(text) > 1 else text
        for text, number in zip(told, numbers, strict=True)
    ]


def values_told(key: Key) -> list[str]:
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


def plan_of(key: Key, others: Sequence[Key], method: str) -> Plan:
    """Choose how to draw against a key: in curves as far as its values repeat."""
    known = np.flatnonzero(np.isfinite(key.values))
    x = key.values[known]
    if method in SAMPLED or not len(x):
        return Plan(key, "scatter")
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
        return Plan(key, "band" if band else "scatter")
    order = np.argsort(x, kind="stable")
    curves = [known[order[groups[order] == group]] for group in chosen]
    points = known[~np.isin(groups, chosen)]
    said = [values_told(other) for other in others]
    labels = [", ".join(words[curve[0]] for words in said) for curve in curves] if said else []
    if labels and len(points):
        labels.append("other cases")
    title = ",\n".join(other.label for other in others)
    return Plan(key, "curves", tuple(curves), points, tuple(labels), title)


def draw_effects(
    part: Any, plans: Sequence[Plan], finals: Mapping[str, FloatArray], shape: tuple[int, int],
    *, transposed: bool,
) -> None:  # fmt: skip
    """Draw final values against keys: one column a key and one row an output, or transposed."""
    share = ("none", "none") if transposed else ("col", "row")
    panels = part.subplots(*shape, squeeze=False, sharex=share[0], sharey=share[1])
    panels = panels.T if transposed else panels
    for row, (output, final) in enumerate(finals.items()):
        values, label = display_of(output).factor * final, display_of(output).label
        for column, plan in enumerate(plans):
            axes = panels[row, column]
            _draw_panel(axes, plan, values, legend=row == 0)
            if row == len(panels) - 1 or transposed:
                axes.set_xlabel(plan.key.label)
            if column == 0:
                axes.set_ylabel(upright(f"final {label}" if output == "penetration" else label))
        if spans(values, LOG_VALUE):
            for axes in panels[row]:
                axes.set_yscale("log")
            set_decades(panels[row, 0].yaxis, values)
        else:
            for axes in panels[row]:
                axes.set_ylim(least_range(*axes.get_ylim()))
    if not transposed:
        part.align_ylabels(panels[:, 0])


def _draw_panel(axes: Any, plan: Plan, values: FloatArray, *, legend: bool) -> None:
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


def _draw_curves(axes: Any, plan: Plan, values: FloatArray) -> None:
    """Draw one curve for each combination of the other keys."""
    x = plan.key.values
    for number, curve in enumerate(plan.curves):
        axes.plot(
            x[curve], values[curve], color=COLOURS[number % len(COLOURS)],
            linestyle=DASHES[number // len(COLOURS)], marker=_MARKERS[number], markersize=4.0,
            linewidth=1.0, label=plain(plan.labels[number]) if plan.labels else None,
        )  # fmt: skip
    if plan.points is not None and len(plan.points):
        axes.plot(
            x[plan.points], values[plan.points], color=GREY, marker=".", linestyle="none",
            label="other cases", zorder=1.5,
        )  # fmt: skip


def _draw_band(axes: Any, key: Key, x: FloatArray, y: FloatArray) -> None:
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


def _draw_scatter(axes: Any, key: Key, x: FloatArray, y: FloatArray) -> None:
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
        axes.plot(*running_median(x, y), color=COLOURS[1], label="running median")


def running_median(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return medians of x and y of parts of many points, along x."""
    parts = np.array_split(np.argsort(x, kind="stable"), min(20, len(x) // 50))
    return (
        np.array([np.median(x[part]) for part in parts]),
        np.array([np.median(y[part]) for part in parts]),
    )


def _set_categories(axes: Any, categories: Sequence[str]) -> None:
    every = -(-len(categories) // 12)
    places = range(0, len(categories), every)
    words = [plain(categories[i]) for i in places]
    axes.set_xticks(list(places), words)
    axes.set_xlim(-0.6, len(categories) - 0.4)
    if sum(len(word) + 2 for word in words) > 34:
        axes.tick_params(axis="x", rotation=35.0)
        for text in axes.get_xticklabels():
            text.set_horizontalalignment("right")
