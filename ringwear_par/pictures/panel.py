"""Panels: charts as data, whatever library draws them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ringwear_par.arrays import FloatArray
from ringwear_par.pictures.style import COLOURS

GREY = "#8c8c8c"
#: most points of a curve that are marked one by one
FEW_POINTS = 20


@dataclass(frozen=True)
class Axis:
    """An axis of a panel."""

    #: with the unit
    label: str
    #: low and high end; None: what is drawn, with some room
    ends: tuple[float, float] | None = None
    #: whether it includes 0, if it has no ends
    zero: bool = False
    #: whether it is logarithmic
    log: bool = False
    #: whether it grows downwards, or to the left
    reversed: bool = False
    #: words at 0, 1, ...; () for numbers
    categories: tuple[str, ...] = ()


@dataclass(frozen=True)
class Curve:
    """A line; NaN are gaps."""

    #: (n,) float; of means between points of x, y is shorter by one, and the line has steps
    x: FloatArray
    y: FloatArray
    #: of the legend
    name: str = ""
    colour: str = COLOURS[0]
    #: number of its dashes, 0 for none
    dash: int = 0
    width: float = 1.6
    #: whether its points are
    marked: bool = False


@dataclass(frozen=True)
class Label:
    """Words above a place."""

    x: float
    y: float
    words: str


@dataclass(frozen=True)
class Band:
    """A ribbon between two curves; NaN are gaps."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    #: of the legend
    name: str
    colour: str = COLOURS[0]
    opacity: float = 0.3
    #: whether the lines at its ends are
    dotted: bool = False


@dataclass(frozen=True)
class Points:
    """Points of one kind."""

    x: FloatArray
    y: FloatArray
    name: str = ""
    colour: str = GREY
    #: pixels, as the explorer draws them
    size: float = 5.0
    #: "dot", "level" (a short line), or an arrow "up" or "down"
    marker: Literal["dot", "level", "up", "down"] = "dot"
    #: whether only their outlines are drawn
    hollow: bool = False
    #: (n,) float, half-lengths of upright bars, or (2, n), their parts below and above points
    errors: FloatArray | None = None


@dataclass(frozen=True)
class Bars:
    """Bars to the right."""

    #: (n,) float, their middles on the axis of categories
    places: FloatArray
    #: (n,) float, where they end
    values: FloatArray
    name: str
    colour: str
    #: (n,) float, half-lengths about these
    errors: FloatArray | None = None
    #: (n,) float, where they begin; None: at 0
    starts: FloatArray | None = None
    #: where categories are 1 apart
    height: float = 0.3
    opacity: float = 0.75


@dataclass(frozen=True)
class Panel:
    """A chart."""

    x: Axis
    y: Axis
    #: a line about it
    title: str = ""
    #: of what it does not show, "" for nothing
    note: str = ""
    curves: Sequence[Curve] = ()
    bands: Sequence[Band] = ()
    points: Sequence[Points] = ()
    bars: Sequence[Bars] = ()
    #: values at which dotted lines go across
    levels: tuple[float, ...] = ()
    #: go up
    uprights: tuple[float, ...] = ()
    labels: Sequence[Label] = ()
    #: title of the legend, in lines
    legend: str = ""
