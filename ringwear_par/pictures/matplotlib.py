"""Panels in files, drawn by matplotlib."""

import math
import string
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.legend import Legend
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from ringwear_par.pictures.panel import Axis, Curve, Panel
from ringwear_par.pictures.style import (
    DASHES,
    STYLE,
    NotebookFigure,
    number_text,
    plain,
    svg,
)

#: letters of labels in a line of a legend, letters that the mark beside each takes, and most
#: columns
_LETTERS, _GLYPH, _MOST_COLUMNS = 54, 5, 3
#: letters of an inch of a legend above many panels
_LETTERS_OF_INCH = 15.0
#: factors from widths of lines and sizes of points in panels to points of matplotlib
_WIDTH, _SIZE = 0.65, 0.7
_MARKERS = {"dot": "o", "level": "_", "up": "^", "down": "v"}
#: width of the edges of bands, whose fillings are pale
_EDGE = 0.6
#: most intervals between numbers of an axis below, whose labels would run together
_MOST_INTERVALS = 6
#: most points that vector drawings draw one by one; more are a picture, else files would be large
_MANY = 200
#: numbers below which all of an axis have their exponents, and how these are written
_SMALL, _NUMBERS = 1e-3, FuncFormatter(lambda value, _: number_text(value, 6))
#: length of an axis from 0 over that of what is drawn
_ROOM = 1.05
#: most words of categories side by side, and their letters above which they are slanted
_MOST_CATEGORIES, _LEVEL_LETTERS = 12, 34


def draw(axes: Any, panel: Panel, columns: int = _MOST_COLUMNS) -> None:
    """Draw a panel, with a legend above it.

    Parameters
    ----------
    columns : most columns of the legend, 0 for no legend.
    """
    for band in panel.bands:
        axes.fill_between(
            band.x, band.low, band.high, facecolor=to_rgba(band.colour, band.opacity),
            edgecolor=band.colour if band.name else "none", linewidth=_EDGE,
            linestyle=":" if band.dotted else "-", label=plain(band.name),
        )  # fmt: skip
    for curve in panel.curves:
        _draw_curve(axes, curve)
    for points in panel.points:
        axes.plot(
            points.x, points.y, linestyle="none", marker=_MARKERS[points.marker],
            color=points.colour, markersize=_SIZE * points.size,
            markerfacecolor="none" if points.hollow else points.colour, label=plain(points.name),
            markeredgewidth=1.0 if points.hollow or points.marker == "level" else 0.0,
            rasterized=len(points.x) > _MANY,
            zorder=1.5,  # behind curves, which many of them would hide
        )  # fmt: skip
        if points.errors is not None:
            axes.errorbar(
                points.x, points.y, points.errors, fmt="none", ecolor=points.colour,
                elinewidth=0.8, zorder=1.5,
            )  # fmt: skip
    dotted = {"color": "0.2", "linewidth": 0.8, "linestyle": ":"}
    across, upwards = axes.get_yaxis_transform(), axes.get_xaxis_transform()
    if panel.levels:
        axes.hlines(panel.levels, 0.0, 1.0, transform=across, **dotted)
    if panel.uprights:
        axes.vlines(panel.uprights, 0.0, 1.0, transform=upwards, **dotted)
    for bars in panel.bars:
        starts = np.zeros(len(bars.values)) if bars.starts is None else bars.starts
        axes.barh(
            bars.places, bars.values - starts, bars.height, starts, xerr=bars.errors,
            color=to_rgba(bars.colour, bars.opacity), edgecolor=bars.colour, linewidth=_EDGE,
            label=plain(bars.name),
            error_kw={"ecolor": "0.1", "elinewidth": 0.9, "capsize": 2.0},
        )  # fmt: skip
    for label in panel.labels:
        axes.text(label.x, label.y, label.words, color="0.3", fontsize=7.0, ha="center")
    _set_axis(axes, "x", panel.x)
    _set_axis(axes, "y", panel.y)
    if columns:
        add_legend(axes, panel.legend, columns)


def panel_figure(
    rows: Sequence[Sequence[Panel]], size: tuple[float, float], heights: Sequence[float] = ()
) -> NotebookFigure:
    """Return a figure of rows of panels under one legend, see ``panel_grid``.

    Parameters
    ----------
    size : inches.
    """
    with matplotlib.rc_context(STYLE):
        chart = NotebookFigure(figsize=size, layout="constrained")
        panel_grid(chart, rows, heights)
        add_letters(chart)
    return chart


def panel_svg(panel: Panel, size: tuple[float, float]) -> bytes:
    """Return a panel as a drawing (SVG) with its legend, for pages, which have its title.

    Parameters
    ----------
    size : inches.
    """
    with matplotlib.rc_context(STYLE):
        chart = NotebookFigure(figsize=size, layout="constrained")
        axes = chart.add_subplot()
        draw(axes, panel)
        return svg(chart)


def add_letters(figure: Any) -> None:
    """Name the panels of a figure (a), (b) and so on, before their titles, if it has several.

    Beside a legend above a panel there is no room: there the letter is in its title.
    """
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    for axes, letter in zip(panels, _letters(len(panels)), strict=False):
        legend = axes.get_legend()
        above = legend is not None and legend._loc == Legend.codes["lower center"]
        if title := axes.get_title():
            axes.set_title(f"{letter} {title}")
        elif above:
            legend.set_title(f"{letter} {legend.get_title().get_text()}".rstrip())
        else:
            axes.set_title(f"{letter} {axes.get_title(loc='left')}".rstrip(), loc="left")


def _letters(count: int) -> list[str]:
    """Return (a) to (z), (aa) and so on; none for a single panel."""
    alphabet = ["", *string.ascii_lowercase]
    names = [first + second for first in alphabet for second in alphabet[1:]]
    return [f"({name})" for name in names[:count]] if count > 1 else []


def panel_grid(
    chart: Any,
    rows: Sequence[Sequence[Panel]],
    heights: Sequence[float] = (),
    *,
    legend: bool = True,
) -> None:
    """Draw rows of panels under one legend.

    Parameters
    ----------
    chart : a figure, or a part of one.
    heights : of the rows, relative; () for equal ones.
    legend : whether there is one.
    """
    across = max(map(len, rows))
    grid = chart.add_gridspec(len(rows), across, height_ratios=heights or None)
    entries: dict[str, Any] = {}
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            axes = chart.add_subplot(grid[i, j])
            draw(axes, panel, 0)
            axes.set_title(plain(panel.title), loc="left")
            entries |= legend_entries(axes)
    if legend:
        add_shared_legend(chart, entries)


def add_shared_legend(chart: Any, entries: Mapping[str, Any], title: str = "") -> None:
    """Add a legend of several panels above them.

    Parameters
    ----------
    chart : a figure, or a part of one, of which the panels are.
    entries : handles by label.
    """
    if entries:
        widest = max(map(len, entries)) + _GLYPH
        letters = _LETTERS_OF_INCH * chart.bbox.width / chart.figure.dpi
        legend = chart.legend(
            entries.values(), entries.keys(), loc="outside upper center", frameon=False,
            ncols=max(1, min(len(entries), int(letters / widest))), title=title,
            title_fontsize=8.0,
        )  # fmt: skip
        legend.get_title().set_multialignment("center")


def _draw_curve(axes: Any, curve: Curve) -> None:
    if not len(curve.y):  # one state has no means of the time between two
        return
    style = {
        "color": curve.colour, "linestyle": DASHES[curve.dash % len(DASHES)],
        "linewidth": _WIDTH * curve.width, "label": plain(curve.name),
    }  # fmt: skip
    if len(curve.y) < len(curve.x):
        axes.step(curve.x, np.append(curve.y[:1], curve.y), where="pre", **style)
    else:
        axes.plot(curve.x, curve.y, marker="o" if curve.marked else "", markersize=2.5, **style)


def _set_axis(axes: Any, name: str, axis: Axis) -> None:
    """Set label, scale and ends of an axis."""
    getattr(axes, f"set_{name}label")(plain(axis.label))
    if axis.log:
        getattr(axes, f"set_{name}scale")("log")
    low, high = getattr(axes.dataLim, f"interval{name}")
    if axis.ends is not None:
        getattr(axes, f"set_{name}lim")(*axis.ends)
    elif axis.zero and low >= 0.0 and not axis.log:
        getattr(axes, f"set_{name}lim")(0.0, _ROOM * high if high > 0.0 else 1.0)
    if axis.categories:
        _set_categories(axes, name, axis.categories)
    elif name == "x" and not axis.log:
        axes.xaxis.set_major_locator(MaxNLocator(_MOST_INTERVALS, steps=[1, 2, 5, 10]))
    elif axis.log:
        _label_decades(getattr(axes, f"{name}axis"))
    scale = getattr(axes, f"{name}axis")
    if not axis.log and 0.0 < max(map(abs, scale.get_view_interval())) < _SMALL:
        scale.set_major_formatter(_NUMBERS)
    if axis.reversed:
        scale.set_inverted(True)


def _set_categories(axes: Any, name: str, categories: Sequence[str]) -> None:
    """Write the words of categories, or some of them where there are many."""
    every = -(-len(categories) // _MOST_CATEGORIES) if name == "x" else 1
    places = range(0, len(categories), every)
    words = ["\n".join(map(plain, categories[i].split("\n"))) for i in places]
    getattr(axes, f"set_{name}lim")(-0.6, len(categories) - 0.4)
    getattr(axes, f"set_{name}ticks")(places, words)
    if name == "x" and sum(len(word) + 2 for word in words) > _LEVEL_LETTERS:
        axes.tick_params(axis="x", rotation=35.0)
        for text in axes.get_xticklabels():
            text.set_horizontalalignment("right")


def _label_decades(axis: Any) -> None:
    """Label more than the decades of a logarithmic axis that has few of them."""
    low, high = axis.get_view_interval()
    decades = math.log10(high / low)
    if decades >= 3.0:
        return
    few = MaxNLocator(4, steps=[1, 2, 5, 10])
    subs = (1.0, 2.0, 5.0) if decades < 1.2 else (1.0, 3.0)
    axis.set_major_locator(few if decades < 0.7 else LogLocator(subs=subs))
    axis.set_major_formatter(_NUMBERS)
    axis.set_minor_locator(NullLocator())


def legend_shape(panel: Panel, letters: int) -> tuple[int, int]:
    """Return the columns of a panel's legend, as even as may be, and its lines with its title.

    Parameters
    ----------
    letters : that a line has room for.
    """
    labels = {curve.name for curve in panel.curves}
    labels |= {mark.name for marks in (panel.bands, panel.points, panel.bars) for mark in marks}
    labels -= {""}
    widest = max(map(len, labels), default=0) + _GLYPH
    columns = max(1, min(len(labels), letters // widest))
    lines = -(-len(labels) // columns)
    return -(-len(labels) // max(lines, 1)), lines + len(panel.legend.splitlines())


def legend_entries(axes: Any) -> dict[str, Any]:
    """Return the handles of a panel's legend by label."""
    handles, labels = axes.get_legend_handles_labels()
    entries = zip(reversed(handles), reversed(labels), strict=True)  # the first of a label
    return dict(reversed({label: handle for handle, label in entries if label}.items()))


def add_legend(axes: Any, title: str = "", columns: int = _MOST_COLUMNS) -> None:
    """Add a legend above a panel, where it covers nothing; a label stands there once."""
    entries = legend_entries(axes)
    if entries or title:
        letters = max(map(len, entries), default=0) + _GLYPH
        legend = axes.legend(
            entries.values(), entries, frameon=False, loc="lower center",
            bbox_to_anchor=(0.5, 1.0), ncols=max(1, min(columns, _LETTERS // letters)),
            title=title, title_fontsize=8.0, columnspacing=1.0, handlelength=1.8,
            borderaxespad=0.2,
        )  # fmt: skip
        legend.get_title().set_multialignment("center")
