"""Panels in pages, drawn by bokeh.

A figure has one source of data for each kind of mark, the same ones whatever it shows, so that a
page that is open changes a chart by new columns.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from bokeh.embed import json_item
from bokeh.models import (
    ColumnDataSource,
    FixedTicker,
    HoverTool,
    Legend,
    LegendItem,
    PlainText,
    Range1d,
)
from bokeh.plotting import figure

from ringwear_par.arrays import FloatArray
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel, Points

_MARKERS = {"dot": "circle", "level": "dash", "up": "triangle", "down": "inverted_triangle"}
#: in the order of matplotlib's
DASHES = ("solid", "dashed", "dashdot", "dotted", "dotdash")
#: kinds of marks from the hindmost to the foremost, and their columns
_LINE = ("x", "y", "name", "label", "colour", "dash", "width", "opacity", "words", "stepped")
KINDS = {
    "ribbons": ("x", "y", "label", "colour", "opacity"),
    "asides": _LINE,
    "ends": _LINE,
    "levels": ("y",),
    "uprights": ("x",),
    "bars": ("y", "left", "right", "height", "label", "colour", "opacity"),
    "whiskers": ("x0", "y0", "x1", "y1", "colour"),
    "lines": _LINE,
    "dots": ("x", "y", "colour"),
    "points": ("x", "y", "label", "colour", "fill", "size", "opacity", "marker", "words"),
    "labels": ("x", "y", "text", "baseline", "align"),
}
#: kinds with an entry in the legend, in its order
_IN_LEGEND = ("lines", "asides", "points", "bars", "ribbons")
#: kinds of marks in figures that change
_CHANGING = ("asides", "lines", "dots", "points", "labels")
#: share of an axis that is left beyond what is drawn
_ROOM = 0.04
#: decades above which numbers beside an axis have an exponent
_LARGE = 7
#: letters of labels in a line of a legend, and letters that the mark beside a label takes
_LETTERS, _GLYPH = 60, 6
_MOST_COLUMNS = 4
#: digits that a screen can show
_DIGITS = 7
_POINTER = (
    '<div style="max-width: 26em; white-space: pre-line">@words</div>'
    "<div>@label</div><div>($snap_x{%.6g}, $snap_y{%.6g})</div>"
)


def chart(name: str, panel: Panel, height: int, *, changing: bool = False) -> Any:
    """Return the figure of a panel, its sources named by their kinds of marks.

    Parameters
    ----------
    changing : whether the sources get other lines and points, which the legend then follows.
    """
    log = ("log" if axis.log else "linear" for axis in (panel.x, panel.y))
    x_type, y_type = log
    plot = figure(
        name=name, height=height, sizing_mode="stretch_width", x_axis_type=x_type,
        y_axis_type=y_type, x_range=Range1d(), y_range=Range1d(),
        tools="pan,box_zoom,zoom_in,zoom_out,reset,save", toolbar_location="above",
        active_drag="box_zoom",
    )  # fmt: skip
    plot.toolbar.logo = None
    marks = {
        kind: _add_marks(plot, kind, ColumnDataSource(columns, name=f"{name}-{kind}"))
        for kind, columns in columns_of(panel).items()
        if not changing or kind in _CHANGING
    }
    pointed = [marks[kind] for kind in ("lines", "asides", "ends", "points") if kind in marks]
    formats = {"$snap_x": "printf", "$snap_y": "printf"}
    plot.add_tools(
        HoverTool(renderers=pointed, tooltips=_POINTER, formatters=formats, visible=False)
    )
    _add_legend(plot, marks, changing=changing)
    _style(plot, panel)
    return plot


def _add_marks(plot: Any, kind: str, source: Any) -> Any:
    """Add a kind of marks to a figure; return its renderer."""
    line = {
        "line_color": "colour", "line_dash": "dash", "line_width": "width", "line_alpha": "opacity",
    }  # fmt: skip
    dotted = {"line_color": "#222222", "line_dash": "dotted", "line_width": 1.0}
    filled = {"fill_color": "colour", "line_color": None}
    match kind:
        case "ribbons":
            return plot.patches(
                "x", "y", fill_alpha="opacity", fill_color="colour", line_color="colour",
                line_width=0.7, source=source,
            )  # fmt: skip
        case "levels":
            return plot.hspan(y="y", **dotted, source=source)
        case "uprights":
            return plot.vspan(x="x", **dotted, source=source)
        case "bars":
            return plot.hbar(
                "y", left="left", right="right", height="height", fill_alpha="opacity", **filled,
                source=source,
            )  # fmt: skip
        case "whiskers":
            return plot.segment("x0", "y0", "x1", "y1", line_color="colour", source=source)
        case "labels":
            style = {"x_offset": 3, "text_font_size": "11px", "text_color": "#444444"}
            return plot.text(
                "x", "y", text_baseline="baseline", text_align="align", **style, source=source
            )
        case "dots":
            return plot.scatter("x", "y", size=4.0, color="colour", source=source)
        case "points":
            return plot.scatter(
                "x", "y", size="size", line_color="colour", fill_color="fill",
                line_alpha="opacity", fill_alpha="opacity", marker="marker", source=source,
            )  # fmt: skip
    return plot.multi_line("x", "y", **line, source=source)


def _add_legend(plot: Any, marks: Mapping[str, Any], *, changing: bool) -> None:
    """Add a legend above the figure, where it covers nothing; a label stands there once."""
    items: dict[str, Any] = {}
    for kind in [kind for kind in _IN_LEGEND if kind in marks]:
        if changing and kind != "asides":
            items[kind] = LegendItem(label={"field": "label"}, renderers=[marks[kind]])
            continue
        for row, label in enumerate(marks[kind].data_source.data["label"]):
            if label and label not in items:
                items[label] = LegendItem(
                    label={"value": label}, renderers=[marks[kind]], index=row
                )
    letters = max(map(len, items), default=0) + _GLYPH
    columns = max(1, min(_MOST_COLUMNS - changing, _LETTERS // letters))
    legend = Legend(
        name="legend", items=list(items.values()), orientation="horizontal", location="left",
        ncols=columns, border_line_color=None, padding=0, margin=4,
        spacing=6, glyph_width=22, glyph_height=12, label_height=12, visible=bool(items),
        label_text_font_size="12px", label_text_baseline="middle",
    )  # fmt: skip
    plot.add_layout(legend, "above")


def _style(plot: Any, panel: Panel) -> None:
    """Set labels, ticks and ranges of the axes."""
    for panel_axis, axis, drawn, grid, ends in zip(
        (panel.x, panel.y), (plot.xaxis[0], plot.yaxis[0]), (plot.x_range, plot.y_range),
        (plot.xgrid[0], plot.ygrid[0]), ranges_of(panel), strict=True,
    ):  # fmt: skip
        drawn.start, drawn.end = ends
        axis.axis_label = PlainText(text=panel_axis.label)
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = "13px"
        axis.major_label_text_font_size = "12px"
        axis.minor_tick_line_color = None
        if not panel_axis.log:
            axis.formatter.power_limit_high = _LARGE
        grid.grid_line_color = "#e4e4e4"
        if panel_axis.categories:
            axis.ticker = FixedTicker(ticks=list(range(len(panel_axis.categories))))
            axis.major_label_overrides = {
                number: PlainText(text=word) for number, word in enumerate(panel_axis.categories)
            }
    plot.outline_line_color = None


def ranges_of(panel: Panel) -> list[list[float]]:
    """Return the first and the last value of both axes."""
    return [
        _range(axis, np.concatenate([[], *(_flat(v) for v in _values(panel, number))]))
        for number, axis in enumerate((panel.x, panel.y))
    ]


def _flat(values: Any) -> FloatArray:
    return np.ravel(np.asarray(values, dtype=float))


def _values(panel: Panel, number: int) -> Iterator[Any]:
    """Yield all abscissae, or all ordinates, that are drawn."""
    for curve in panel.curves:
        yield curve.y if number else curve.x
    for band in panel.bands:
        yield from (band.low, band.high) if number else (band.x,)
    for points in panel.points:
        yield points.y if number else points.x
        if number and points.errors is not None:
            yield from points.ends
    for bars in panel.bars:
        yield bars.places if number else bars.values
        if bars.starts is not None and not number:
            yield bars.starts


def _range(axis: Axis, values: FloatArray) -> list[float]:
    ends = axis.ends
    if ends is None and axis.categories:
        ends = (-0.6, len(axis.categories) - 0.4)
    if ends is None:
        drawn = values[np.isfinite(values) & ((values > 0.0) | (not axis.log))]
        low, high = (float(drawn.min()), float(drawn.max())) if drawn.size else (0.1, 1.0)
        if axis.log:
            room = (high / low) ** _ROOM if high > low else 2.0
            ends = low / room, high * room
        else:
            if axis.zero or not drawn.size:
                low, high = min(low, 0.0), max(high, 0.0)
            room = _ROOM * ((high - low) or abs(high) or 1.0)
            ends = (
                low - room * (low != 0.0 or not axis.zero),
                high + room * (high != 0.0 or not axis.zero),
            )
            if ends[0] == ends[1]:
                ends = 0.0, 1.0
    return [*ends][:: -1 if axis.reversed else 1]


def columns_of(panel: Panel) -> dict[str, dict[str, list[Any]]]:
    """Return the columns of the sources of all kinds of marks."""
    marked = [curve for curve in panel.curves if curve.marked]
    ends = [curve for band in panel.bands for curve in _ends(band)]
    rows: dict[str, list[tuple[Any, ...]]] = {
        "ribbons": [(*_ribbon(band), band.name, band.colour, band.opacity) for band in panel.bands],
        "asides": [_line(curve) for curve in panel.curves if not curve.tabulated],
        "ends": [_line(curve) for curve in ends],
        "levels": [(level,) for level in panel.levels],
        "uprights": [(upright,) for upright in panel.uprights],
        "bars": [
            (place, start, end, bars.height, bars.name, bars.colour, bars.opacity)
            for bars in panel.bars
            for place, start, end in zip(
                bars.places.tolist(),
                (0.0 * bars.places if bars.starts is None else bars.starts).tolist(),
                bars.values.tolist(),
                strict=True,
            )
        ],
        "whiskers": [*_whiskers(panel)],
        "lines": [_line(curve) for curve in panel.curves if curve.tabulated],
        "dots": [
            (x, y, curve.colour)
            for curve in marked
            for x, y in zip(curve.x.tolist(), curve.y.tolist(), strict=True)
        ],
        "points": [row for points in panel.points for row in _points(points)],
        "labels": [
            (
                label.x,
                label.y,
                label.words,
                "top" if label.below else "bottom",
                "center" if label.centred else "left",
            )
            for label in panel.labels
        ],
    }
    return {
        kind: {
            column: list(values)
            for column, values in zip(
                columns, zip(*rows[kind], strict=True) if rows[kind] else [()] * len(columns),
                strict=True,
            )
        }
        for kind, columns in KINDS.items()
    }  # fmt: skip


def changing_columns(panel: Panel) -> dict[str, dict[str, list[Any]]]:
    """Return the columns of the sources that a figure has that changes."""
    columns = columns_of(panel)
    return {kind: columns[kind] for kind in _CHANGING}


def _line(curve: Curve) -> tuple[Any, ...]:
    x, y = curve.x, curve.y
    stepped = len(y) < len(x)
    if stepped:  # means of the time between two states
        x, y = np.repeat(x, 2)[1:-1], np.repeat(y, 2)
    dash = DASHES[curve.dash % len(DASHES)]
    return (
        x.tolist(), y.tolist(), curve.name, curve.legend or curve.name, curve.colour, dash,
        curve.width, curve.opacity, "", stepped,
    )  # fmt: skip


def _ends(band: Band) -> list[Curve]:
    """Return the low and the high end of a band as curves."""
    return [
        Curve(band.x, end, name, band.colour, 3, band.edge or 1.0, float(band.edge > 0.0))
        for end, name in ((band.low, band.ends[0]), (band.high, band.ends[1]))
    ]


def _ribbon(band: Band) -> tuple[list[float], list[float]]:
    """Return the outlines of a band's parts between gaps, which are told apart by NaN."""
    x: list[float] = []
    y: list[float] = []
    for part in np.ma.clump_unmasked(np.ma.masked_invalid(band.low + band.high + band.x)):
        along = band.x[part].tolist()
        x += [*along, *along[::-1], np.nan]
        y += [*band.low[part].tolist(), *band.high[part][::-1].tolist(), np.nan]
    return x[:-1], y[:-1]


def _whiskers(panel: Panel) -> Iterator[tuple[Any, ...]]:
    """Yield the bars of errors."""
    for points in panel.points:
        if points.errors is not None:
            for x, low, high in zip(points.x, *points.ends, strict=True):
                yield float(x), float(low), float(x), float(high), points.colour
    for bars in panel.bars:
        if bars.errors is not None:
            for place, value, half in zip(bars.places, bars.values, bars.errors, strict=True):
                yield float(value - half), float(place), float(value + half), float(place), "#222"


def _points(points: Points) -> Iterator[tuple[Any, ...]]:
    fill = None if points.hollow or points.marker == "level" else points.colour
    words: Iterator[str] = iter(())
    if points.errors is not None:
        ends = zip(*points.ends, strict=True)
        words = (f"from {low:.4g} to {high:.4g} ({points.probability})" for low, high in ends)
    style = points.size, points.opacity, _MARKERS[points.marker]
    for x, y in zip(points.x.tolist(), points.y.tolist(), strict=True):
        yield x, y, points.name, points.colour, fill, *style, next(words, "")


def embedded(plot: Any) -> dict[str, Any]:
    """Return a figure as a page embeds it; the same panel gives the same."""
    item = _renamed(rounded(json_item(plot)), plot.name, {})
    item["doc"].pop("defs", None)  # of models that others in the process have defined
    return {name: item[name] for name in ("root_id", "doc", "version")}


def rounded(value: Any) -> Any:
    """Return plain data whose numbers have as many digits as a screen shows."""
    if isinstance(value, Mapping):
        return {name: rounded(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(entry) for entry in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _renamed(value: Any, name: str, names: dict[str, str]) -> Any:
    """Return a document whose models are counted from 0: bokeh counts all of the process."""
    if isinstance(value, Mapping):
        return {
            key: names.setdefault(entry, f"{name}-{len(names)}")
            if key in ("id", "root_id") and isinstance(entry, str)
            else _renamed(entry, name, names)
            for key, entry in value.items()
        }
    return [_renamed(entry, name, names) for entry in value] if isinstance(value, list) else value


def script() -> str:
    """Return the program of bokeh that draws embedded figures."""
    from bokeh.resources import Resources

    program: list[str] = Resources(mode="inline", components=["bokeh"]).js_raw
    return "\n".join(program)
