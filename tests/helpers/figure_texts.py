"""The texts and legends of a figure as drawn: which cover each other, which are keys of files."""

import itertools
import re

from matplotlib.legend import Legend
from matplotlib.text import Text

#: pixels by which boxes of texts may reach into each other, as they are larger than the letters
_CLOSE = 2.0
_KEY = re.compile(r"\b(?:wear|lower|upper|contact|load|time|profile|mass|volume)\.[a-z]")


def drawn_texts(figure):
    """The texts that can be seen, with their boxes."""
    figure.draw_without_rendering()
    ticks = {}
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                inside = low <= tick.get_loc() <= high and axes.get_visible()
                ticks |= {tick.label1: inside, tick.label2: inside}
    seen = [
        text
        for text in figure.findobj(Text)
        if text.get_visible() and text.get_text().strip() and ticks.get(text, True)
    ]
    return [(text.get_text(), text.get_window_extent()) for text in seen]


def check_texts(figure):
    """Check that texts and legends cover no others and stay within, and that no text is a key."""
    texts = drawn_texts(figure)
    frames = [("legend", legend.get_window_extent()) for legend in figure.findobj(Legend)]
    covered = [
        (first, second)
        for boxes in (texts, frames)
        for (first, a), (second, b) in itertools.combinations(boxes, 2)
        if min(a.x1, b.x1) - max(a.x0, b.x0) > _CLOSE and min(a.y1, b.y1) - max(a.y0, b.y0) > _CLOSE
    ]
    assert covered == []
    whole = figure.bbox.padded(_CLOSE)
    ends = [(text, (a.x0, a.y0), (a.x1, a.y1)) for text, a in texts + frames]
    assert [t for t, *corners in ends if not all(whole.contains(*end) for end in corners)] == []
    assert [text for text, _ in texts if _KEY.search(text)] == []
