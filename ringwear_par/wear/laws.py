"""Wear laws, eq. (4) of the paper and beyond: functions of the pressure, and their parameters.

A law returns the rate of depth (mm/s) and its slope (mm/s/MPa), at pressures (B, n) MPa of B
histories; one that remembers worn depth also d rate / d wear (1/s). A rate below zero means that
nothing wears: a threshold is a line through zero, which callers clip. Parameters are (B, 1), or
(B, n) where they differ along the radius. ``docs/laws.md`` says when to use which.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.wear.at import LocalState
from ringwear_par.wear.user import user

Values = tuple[FloatArray, ...]
LawFunction = Callable[..., Values]


def archard(p: FloatArray, at: LocalState, k: FloatArray) -> Values:
    """Wear in proportion to pressure and sliding speed, k p V."""
    rise = k * at.speed
    return rise * p, rise


def threshold(p: FloatArray, at: LocalState, k: FloatArray, p0: FloatArray) -> Values:
    """Wear by the power of friction above a threshold, eq. (4) of the paper: k mu (p - p0) V."""
    rise = (k * at.friction) * at.speed
    return rise * (p - p0), rise


def power(p: FloatArray, at: LocalState, k: FloatArray, m: FloatArray, n: FloatArray) -> Values:
    """Wear that grows with powers of pressure and sliding speed, k p^m V^n."""
    p = np.maximum(p, 0.0)  # trials of solvers may be negative
    speed = at.speed if np.all(n == 1.0) else at.speed**n
    slope = (k * speed) * p ** (m - 1.0)
    return p * slope, m * slope


def table(p: FloatArray, at: LocalState, x: FloatArray, y: FloatArray) -> Values:
    """Wear at rates y (mm/s) that are linear between points x of p V, and go on with the slope."""
    pv = p * at.speed
    piece = (pv[..., None] > x[..., None, 1:-1]).sum(axis=-1)  # left of points, where slopes jump
    starts, rates, slopes = (
        np.take_along_axis(v, piece, axis=-1)
        for v in (x[..., :-1], y[..., :-1], np.diff(y) / np.diff(x))
    )
    return rates + slopes * (pv - starts), slopes * at.speed


def running_in(
    p: FloatArray,
    at: LocalState,
    k: FloatArray,
    k_start: FloatArray,
    p0: FloatArray,
    depth: Any = None,
    distance: Any = None,
) -> Values:
    """Wear by a threshold law whose coefficient falls from k_start to k, by depth or distance."""
    if depth is None:
        return threshold(p, at, k + (k_start - k) * np.exp(-at.slid / distance), p0)
    fresh = (k_start - k) * np.exp(-at.wear / depth)
    rate, rise = threshold(p, at, k + fresh, p0)
    slower = (fresh / depth) * (at.friction * at.speed) * np.maximum(p - p0, 0.0)
    return rate, rise, -slower


@dataclass(frozen=True)
class Parameter:
    """A parameter of a wear law."""

    name: str
    #: "1" of a plain number, "-" of a file or a table
    unit: str
    #: in a few words
    meaning: str
    #: a quantity is a number, a table in time or a profile along the radius; the others are a
    #: number only, pairs (p V, rate), the name of a Python file, a table of quantities
    kind: Literal["quantity", "number", "rates", "file", "parameters"] = "quantity"
    #: ... where it must be given
    default: Any = ...
    #: least and largest number that is allowed, and whether they are allowed themselves
    low: float = 0.0
    high: float = math.inf
    ends: bool = True
    #: the parameter of the same law that this one must not be less than, "" for none
    at_least: str = ""


@dataclass(frozen=True)
class Kind:
    """A law that case files may name."""

    name: str
    function: LawFunction
    #: in the paper's symbols
    formula: str
    declared: tuple[Parameter, ...] = ()
    #: whether the rate is a line above a threshold, unless it depends on worn depth
    linear: bool = False
    #: parameters of which one must be given; with the first the rate depends on worn depth
    one_of: tuple[str, ...] = ()

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The parameters by name."""
        return {parameter.name: parameter for parameter in self.declared}


_K = Parameter("k", "1/MPa", "wear coefficient")
_P0 = Parameter("p0", "MPa", "threshold pressure", default=0.0)
_START = Parameter("k_start", "1/MPa", "wear coefficient at the start, k or larger", at_least="k")
_FALLS = "over which k_start - k falls by the factor e"
_DEPTH = Parameter("depth", "mm", f"worn depth {_FALLS}", "number", None, ends=False)
_DISTANCE = Parameter(
    "distance", "mm", f"distance slid {_FALLS}, instead of depth", "number", None, ends=False
)
_ALL = (
    Kind("threshold", threshold, "k mu max(0, p - p0) V", (_K, _P0), linear=True),
    Kind("archard", archard, "k p V", (_K,), linear=True),
    Kind("power", power, "k p^m V^n", (
        Parameter("k", "mm/s", "rate where p = 1 MPa and V = 1 mm/s"),
        Parameter("m", "1", "exponent of p", "number", low=1.0, high=10.0),
        Parameter("n", "1", "exponent of V", "number", 1.0, high=10.0, ends=False),
    )),
    Kind("table", table, "linear between points of p V", (
        Parameter("table", "MPa mm/s and mm/s",
                  "rate of wear; beyond its end the last slope goes on", "rates"),
    )),
    Kind("running-in", running_in,
         "(k + (k_start - k) exp(-s)) mu max(0, p - p0) V (s = wear/depth or slid/distance)",
         (_K, _START, _P0, _DEPTH, _DISTANCE), linear=True, one_of=("depth", "distance")),
    # of averages, which callers take
    Kind("non-local", threshold, "<k mu max(0, <p> - p0) V> (<> averages over length)", (
        _K, _P0,
        Parameter("length", "mm", "standard deviation of the Gaussian average of the pressure, and "
                  "of the wear that it causes", "number", ends=False),
    ), linear=True),
    Kind("user", user, "rate(p, at) of a Python file", (
        Parameter("file", "-", "file, relative to the case file, that defines rate(p, at), as "
                  "user_law.py does", "file"),
        Parameter("parameters", "-", "parameters of the law, which rate(p, at) reads from "
                  "at.parameters", "parameters", ()),
    )),
)  # fmt: skip
#: the laws that a case file may name, by the name that ``law`` gives them
LAWS: Mapping[str, Kind] = {kind.name: kind for kind in _ALL}
