"""Panels: charts as data, without a word of the library that draws them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.pictures.style import COLOURS

GREY = "#8c8c8c"
#: as many points of a curve, or fewer, are marked
FEW_POINTS = 20


@dataclass(frozen=True)
class Axis:
    """An axis of a panel.

    Parameters
    ----------
    label : with the unit.
    ends : low and high end; None: what is drawn, with some room.
    zero : whether it includes 0, if it has no ends.
    log : whether it is logarithmic.
    reversed : whether it grows downwards, or to the left.
    categories : words at 0, 1, ...; () for numbers.
    """

    label: str
    ends: tuple[float, float] | None = None
    zero: bool = False
    log: bool = False
    reversed: bool = False
    categories: tuple[str, ...] = ()


@dataclass(frozen=True)
class Curve:
    """A line; NaN are gaps.

    Parameters
    ----------
    x, y : (n,) float; of means between points of x, y is shorter by one, and the line has steps.
    name : of the legend and of the table of numbers.
    dash : number of its dashes, 0 for none.
    marked : whether its points are.
    tabulated : whether a table of the panel's numbers has it.
    words : at the pointer, before its numbers.
    legend : the name in the legend, if another one.
    cases : (n,) int, of marked points, see ``Points``.
    """

    x: FloatArray
    y: FloatArray
    name: str = ""
    colour: str = COLOURS[0]
    dash: int = 0
    width: float = 1.6
    opacity: float = 1.0
    marked: bool = False
    tabulated: bool = True
    words: str = ""
    legend: str = ""
    cases: IntArray | None = None


@dataclass(frozen=True)
class Label:
    """Words at a place, to its right or centred.

    Parameters
    ----------
    below : whether they stand below it, or else above.
    """

    x: float
    y: float
    words: str
    below: bool = False
    centred: bool = False


@dataclass(frozen=True)
class Band:
    """A ribbon between two curves; NaN are gaps.

    Parameters
    ----------
    name : of the legend.
    ends : names of the low and the high curve in a table of numbers.
    edge : width of the lines at its ends, which are dotted.
    """

    x: FloatArray
    low: FloatArray
    high: FloatArray
    name: str
    ends: tuple[str, str]
    colour: str = COLOURS[0]
    opacity: float = 0.3
    edge: float = 0.0


@dataclass(frozen=True)
class Points:
    """Points of one kind.

    Parameters
    ----------
    size : pixels of a page.
    marker : "dot", "level" (a short line), or an arrow "up" or "down".
    hollow : whether only their outlines are drawn.
    errors : (n,) float, half-lengths of upright bars; probability : of the truth within a bar.
    cases : (n,) int, rows of a list of words that are at the pointer, which panels share, or -1;
        files have such points behind curves.
    """

    x: FloatArray
    y: FloatArray
    name: str = ""
    colour: str = GREY
    size: float = 5.0
    opacity: float = 1.0
    marker: Literal["dot", "level", "up", "down"] = "dot"
    hollow: bool = False
    errors: FloatArray | None = None
    probability: str = "95 %"
    cases: IntArray | None = None


@dataclass(frozen=True)
class Bars:
    """Bars to the right.

    Parameters
    ----------
    places : (n,) float, their middles on the axis of categories.
    values : (n,) float, where they end; errors : (n,) float, half-lengths about these.
    starts : (n,) float, where they begin; None: at 0.
    height : where categories are 1 apart.
    """

    places: FloatArray
    values: FloatArray
    name: str
    colour: str
    errors: FloatArray | None = None
    starts: FloatArray | None = None
    height: float = 0.3
    opacity: float = 0.75


@dataclass(frozen=True)
class Cells:
    """A table of values as colours, the darker the larger.

    Parameters
    ----------
    x : (m,) float; y : (n,) float, middles of the cells.
    values : (n, m) float; NaN are gaps.
    label : of the values, with the unit.
    """

    x: FloatArray
    y: FloatArray
    values: FloatArray
    label: str

    @property
    def log(self) -> bool:
        """Whether the colours are of logarithms, as those of values that differ much."""
        known = self.values[np.isfinite(self.values)]
        return len(known) > 0 and bool(known.max() > 5.0 * known.min() > 0.0)

    def borders(self) -> tuple[FloatArray, FloatArray]:
        """Return the borders of the cells along both axes, (m + 1,) and (n + 1,)."""
        return _borders(self.x), _borders(self.y)


def _borders(middles: FloatArray) -> FloatArray:
    if len(middles) == 1:
        half = 0.1 * abs(middles) or 0.5
        return np.concatenate([middles - half, middles + half])
    between = 0.5 * (middles[1:] + middles[:-1])
    first, last = 1.5 * middles[:1] - 0.5 * middles[1:2], 1.5 * middles[-1:] - 0.5 * middles[-2:-1]
    return np.concatenate([first, between, last])


@dataclass(frozen=True)
class Panel:
    """A chart.

    Parameters
    ----------
    title : a line about it; note : of what it does not show, "" for nothing.
    levels : values at which dotted lines go across; uprights : go up.
    legend : title of the legend, in lines.
    """

    x: Axis
    y: Axis
    title: str = ""
    note: str = ""
    curves: Sequence[Curve] = ()
    bands: Sequence[Band] = ()
    points: Sequence[Points] = ()
    bars: Sequence[Bars] = ()
    cells: Cells | None = None
    levels: tuple[float, ...] = ()
    uprights: tuple[float, ...] = ()
    labels: Sequence[Label] = ()
    legend: str = ""
