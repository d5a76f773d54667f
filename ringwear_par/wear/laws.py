"""Wear laws, eq. (4) of the paper and beyond: functions of the pressure, and their parameters.

A law returns the rate of depth (mm/s) and its slope (mm/s/MPa), at pressures (B, n) MPa of B
histories; one that remembers worn depth also d rate / d wear (1/s). A rate below zero means that
nothing wears: a threshold is a line through zero, which callers clip. Parameters are (B, 1), or
(B, n) where they differ along the radius.
"""

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal, Self

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import Fault, InputError
from ringwear_par.schedules import (
    Quantity,
    Table,
    breakpoints,
    largest,
    quantity_text,
    smallest,
    value,
)
from ringwear_par.wear.at import LocalState
from ringwear_par.wear.user import UserCode, user

Values = tuple[FloatArray, ...]
LawFunction = Callable[..., Values]


def archard(p: FloatArray, at: LocalState, k: FloatArray) -> Values:
    """Wear in proportion to pressure and sliding speed.

    Archard's law. The rate of depth is k times the pressure p times the sliding speed V. k is the
    specific wear rate of test reports, volume lost over load and distance, in mm3/(N mm) = 1/MPa:
    1e-5 mm3/(N m) is 1e-8. The rate does not depend on the friction coefficient.

    Use it where only one wear rate is known, and where twice the load or twice the distance wears
    off twice as much. In the course of wear, p V becomes the same at all radii, so that pressures
    end near c / r for any k.

    The law has no load below which nothing wears, no running-in, and the same k at all pressures
    and speeds: beyond the pressures and speeds of the test that gave k, it is a guess.
    """
    rise = k * at.speed
    return rise * p, rise


def threshold(p: FloatArray, at: LocalState, k: FloatArray, p0: FloatArray) -> Values:
    """Wear by the power of friction above a threshold of the pressure.

    Eq. (4) of the paper. The rate of depth is k mu (p - p0) V where the pressure p is above p0, and
    0 elsewhere; mu is the friction coefficient, V the sliding speed. k is the volume lost over
    friction energy, in mm3/(N mm) = 1/MPa; below p0 (MPa) contact slides without wear. With p0 = 0
    it is Archard's law with a specific wear rate k mu.

    Use it where light loads hardly wear, where wear goes with friction energy, or where it begins
    at the edges and comes to the middle late. Pressures end near p0 + c / r. Tests at one load do
    not determine k and p0 separately; tests at two loads do, if one of them is near p0.

    The onset at p0 is sudden, while measured onsets are rounded. If the mean pressure is below p0,
    only edges wear, until no pressure is above p0.
    """
    rise = (k * at.friction) * at.speed
    return rise * (p - p0), rise


def non_local(p: FloatArray, at: LocalState, k: FloatArray, p0: FloatArray) -> Values:
    """The threshold law of a pressure that is averaged over a length.

    The threshold law, k in 1/MPa and p0 in MPa, with the pressure averaged by a Gaussian of the
    standard deviation ``length`` (mm) along the radius. The wear is averaged in the same way, which
    does not change the worn volume.

    Use it where peaks of pressure narrower than a grain, a particle or the spacing of asperities
    should not wear by themselves. At a sharp edge the elastic pressure is infinite. With the other
    laws, the wear rate there depends on the size of the elements; with this law, on ``length``.

    Speed and friction are not averaged. Profiles cannot bend within ``length``, so grooves and
    steps narrower than ``length`` are smoothed too. Fit ``length`` to profiles near edges.
    """
    return threshold(p, at, k, p0)  # of averages, which callers take, see ``averaging``


def power(p: FloatArray, at: LocalState, k: FloatArray, m: FloatArray, n: FloatArray) -> Values:
    """Wear that grows with powers of pressure and sliding speed.

    The rate of depth is k (p / MPa)^m (V / (mm/s))^n: k is the rate in mm/s at a pressure of 1 MPa
    and a speed of 1 mm/s, far from any test. With m = n = 1 it is Archard's law. The rate does not
    depend on the friction coefficient.

    Use it where rates of tests at several loads or speeds lie on a straight line on logarithmic
    axes, steeper than in proportion. Pressures end near c / r^(n/m): the larger m, the more even.

    m is at least 1: rates that rise less than in proportion to the pressure need a table or a law
    of your own. Where m is well above 1, edges and peaks wear much faster than the rest, at
    pressures beyond those of the tests. k and m are correlated: a fit needs loads that are far
    apart, and k on a logarithmic scale.
    """
    p = np.maximum(p, 0.0)  # trials of solvers may be negative
    speed = at.speed if np.all(n == 1.0) else at.speed**n
    slope = (k * speed) * p ** (m - 1.0)
    return p * slope, m * slope


def table(p: FloatArray, at: LocalState, x: FloatArray, y: FloatArray) -> Values:
    """A measured curve: the rate of wear against pressure times sliding speed.

    Pairs are p V in MPa mm/s (1 MPa m/s is 1000) and the rate of depth in mm/s (1 um/h is 2.78e-7),
    the first of them (0, 0). The rate is linear between these points, and continues with the last
    slope beyond the last point.

    Use it where tests at several p V follow no formula, as near the p V limit of a polymer.

    The rate depends on pressure and speed only through their product, and not on the friction
    coefficient. Rates must not fall with p V. The curve passes through all points, with their
    scatter: smooth measured rates first.
    """
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
    """Wear that is faster at first and settles with worn depth or distance slid.

    The threshold law with a coefficient that falls from k_start to k (both in 1/MPa, volume lost by
    friction energy). The difference from k falls by the factor e with every ``depth`` worn off, or
    every ``distance`` slid, at the same place; give one of the two, in mm. With p0 = 0 the specific
    wear rate is k_start mu at first and k mu in the end.

    Use it where the first hours of a test wear faster than the rest at the same load: ``depth`` if
    a layer or the roughness is worn off, ``distance`` if surfaces or a transfer film settle. Fits
    need readings from both parts.

    k_start is at least k: wear that becomes faster with time needs tables in time or a law of your
    own. Depth and distance count at each place from the start of the case: a body that is turned
    to a fresh face, or refilled with lubricant, is a new case.
    """
    if depth is None:
        return threshold(p, at, k + (k_start - k) * np.exp(-at.slid / distance), p0)
    fresh = (k_start - k) * np.exp(-at.wear / depth)
    rate, rise = threshold(p, at, k + fresh, p0)
    slower = (fresh / depth) * (at.friction * at.speed) * np.maximum(p - p0, 0.0)
    return rate, rise, -slower


def no_wear(p: FloatArray, at: LocalState) -> Values:
    """Nothing wears."""
    return 0.0 * at.speed * p, 0.0 * at.speed


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
    """A law that case files may name; the docstring of its function is its page for users."""

    name: str
    function: LawFunction
    #: in the paper's symbols
    formula: str
    declared: tuple[Parameter, ...] = ()
    #: whether the rate is a line above a threshold, unless it depends on worn depth
    linear: bool = False
    #: parameters of which one must be given; with the first the rate depends on worn depth
    one_of: tuple[str, ...] = ()

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """The parameters by name."""
        return {parameter.name: parameter for parameter in self.declared}

    def faults(self, table: str, values: Mapping[str, Any]) -> list[Fault]:
        """Return the faults of parameters that are right one by one, but not together.

        Parameters
        ----------
        table : beginning of their keys, "wear.lower.".
        values : by name; None if the file has none; without those that are wrong by themselves.
        """
        faults = []
        given = [values[name] is not None for name in self.one_of if name in values]
        if self.one_of and len(given) == len(self.one_of) and sum(given) != 1:
            keys = ", ".join(table + name for name in self.one_of)
            sentence = f"{keys}: one of them must be given (mm)"
            faults.append(Fault(sentence, table + self.one_of[0], "missing"))
        for name, parameter in self.parameters.items():
            quantity, least = values.get(name), values.get(parameter.at_least)
            if quantity is not None and least is not None and smallest(quantity) < largest(least):
                sentence = (
                    f"{table}{name} = {quantity_text(quantity)}: must be at least "
                    f"{table}{parameter.at_least} = {quantity_text(least)}"
                )
                faults.append(Fault(sentence, f"{table}{name}", "conflict"))
        return faults

    def law(self, **values: Any) -> "Law":
        """Return the law with these values; those that are None have their defaults.

        Raises
        ------
        InputError : they make no law, or the file none; faults begin with the name of a parameter.
        """
        defaults = {p.name: None if p.default is ... else p.default for p in self.declared}
        values = defaults | {name: value for name, value in values.items() if value is not None}
        if faults := self.faults("", values):
            raise InputError(*faults)
        if "file" not in values:
            return Law(self, values)
        code = UserCode.of_file(values["file"])
        values |= {f"parameters.{name}": q for name, q in values.pop("parameters")}
        return Law(replace(self, formula=f"rate(p, at) of {code.called}"), values, code)


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
    Kind("non-local", non_local, "<k mu max(0, <p> - p0) V> (<> averages over length)", (
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


@dataclass(frozen=True, repr=False)
class Law:
    """A wear law of a body or a layer: its kind and its values."""

    kind: Kind
    #: of its parameters, by name, those of a user's file as "parameters.k"; None of unused ones
    values: Mapping[str, Any]
    #: of a user's law
    code: UserCode | None = None

    @classmethod
    def of(cls, law: Any) -> "Law":
        """Return the law of a user's object, whose numbers are its parameters; a law as it is."""
        if isinstance(law, Law):
            return law
        code, values = UserCode(type(law).__name__, law), {}
        if is_dataclass(law) and not isinstance(law, type):
            values = {field.name: getattr(law, field.name) for field in fields(law)}
        numbers = {name: number for name, number in values.items() if isinstance(number, float)}
        return cls(Kind(code.called, user, f"{code.called}.rate(p, local)"), numbers, code)

    def __repr__(self) -> str:
        values = ", ".join(f"{k}={v!r}" for k, v in self.values.items() if v is not None)
        return f"{self.name}({values})"

    @property
    def laws(self) -> tuple["Law", ...]:
        """Itself, as of a body without layers, see ``LayeredLaw``."""
        return (self,)

    @property
    def name(self) -> str:
        """Value of ``law`` in case files, or the class of a user's object."""
        return self.kind.name

    @property
    def length(self) -> float:
        """Averaging length, mm; 0 for a local law."""
        return self.values.get("length", 0.0) if self.code is None else self.code.length

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on worn depth."""
        if self.code is not None:
            return self.code.remembers
        return any(self.values[name] is not None for name in self.kind.one_of[:1])

    @property
    def linear(self) -> bool:
        """Whether the rate is a line above a threshold, whatever the pressure."""
        return self.kind.linear and not self.remembers

    @property
    def function(self) -> LawFunction:
        """``function(p, at, **arguments)`` returns rate and slope, see the top of this file."""
        return self.kind.function if self.code is None else partial(user, self.code)

    @property
    def faults(self) -> dict[int, str]:
        """What is wrong with a user's code, by number of the history that called it last."""
        return {} if self.code is None else self.code.faults

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """The numbers, tables and profiles that the rate depends on smoothly, by name."""
        return {
            name: q
            for name, q in self.values.items()
            if isinstance(q, float | int | Table) and name != "length"
        }

    @cached_property
    def arguments(self) -> dict[str, Quantity | FloatArray]:
        """What the function takes besides pressure and state."""
        if self.kind.function is table:
            return dict(zip("xy", np.array(self.values["table"], dtype=float).T, strict=True))
        return {name.removeprefix("parameters."): q for name, q in self.quantities.items()}

    @cached_property
    def key(self) -> Hashable:
        """Equal for laws whose arguments may be stacked, for one function of many histories."""
        source = self.code and (self.code.source if self.code.is_file else id(self.code.source))
        shapes = ((name, getattr(q, "shape", ())) for name, q in self.arguments.items())
        return self.name, source, self.length, *sorted(shapes)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times, s, at which a parameter's table bends, and those that a user's law names."""
        times = set(breakpoints(*self.quantities.values()))
        return tuple(sorted(times.union(() if self.code is None else self.code.breakpoints)))

    def at(self, local: LocalState) -> dict[str, Any]:
        """Return the arguments at the time and the radii of a state of one history."""
        return {
            name: q if isinstance(q, np.ndarray) else value(q, local.time, local.r)
            for name, q in self.arguments.items()
        }

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, (n,) mm/s, at pressures (n,) MPa and a state of one history.

        Raises
        ------
        LawError : the code of a user failed, or gave NaN or a negative rate.
        """
        if self.code is not None:
            return self.code.values(p, replace(local, parameters=self.at(local)))[0]
        return np.maximum(self.function(p, local, **self.at(local))[0], 0.0)

    def per_energy(self, friction: float) -> float | None:
        """Return worn volume per dissipated energy, 1/MPa, if it is always the same."""
        k = self.values.get("k")
        if not isinstance(k, float | int) or self.values.get("p0", 0.0) != 0.0:
            return None
        if self.kind.function is threshold:
            return k
        return k / friction if self.kind.function is archard and friction > 0.0 else None

    def ratio(self, friction: Quantity) -> float:
        """Return worn volume per dissipated energy, 1/MPa, 0 where it is not always the same."""
        ends = {self.per_energy(of(friction)) or 0.0 for of in (smallest, largest)}
        return ends.pop() if len(ends) == 1 else 0.0

    def unit(self, name: str) -> str:
        """Return the unit of a quantity, "1" where it is not declared."""
        parameter = self.kind.parameters.get(name)
        return "1" if parameter is None else parameter.unit

    def describe(self) -> str:
        """Return the formula with its numbers and units."""
        if self.kind.function is table:
            (x, y), count = self.values["table"][-1], len(self.values["table"])
            end = f"{y:.10g} mm/s at p V = {x:.10g} MPa mm/s"
            return f"{self.kind.formula}, {count} of them to {end}"
        parts = []
        for name, q in (self.quantities | ({"length": self.length} if self.length else {})).items():
            number = f"{q:.10g}" if isinstance(q, float | int) else quantity_text(q)
            unit = "" if self.unit(name) == "1" else f" {self.unit(name)}"
            parts.append(f"{name.removeprefix('parameters.')} = {number}{unit}")
        return self.kind.formula + (f" with {', '.join(parts)}" if parts else "")


NO_WEAR = Law(Kind("", no_wear, "0", linear=True), {})


@dataclass(frozen=True)
class LayeredLaw:
    """The laws of a body with layers; each reads the depth worn off its own layer."""

    #: of the layers from the contact face inwards, and of the body itself
    laws: tuple[Law, ...]
    #: mm, of the layers
    thicknesses: tuple[float, ...]

    @classmethod
    def of(
        cls, thicknesses: Sequence[float], layer_laws: Sequence[Law | None], body: Law | None
    ) -> Self:
        """Return the law of a body with layers; a layer whose law is None wears as the body."""
        laws = [law or body or NO_WEAR for law in (*layer_laws, body)]
        return cls(tuple(laws), tuple(thicknesses))

    @property
    def length(self) -> float:
        """Averaging length, mm, of the laws; such laws are not for layers."""
        return max(law.length for law in self.laws)

    @cached_property
    def key(self) -> Hashable:
        """Equal for laws that can be in one block, see ``Law.key``."""
        return tuple(law.key for law in self.laws)

    def describe(self) -> str:
        """Return the formulas with their numbers and units, layer by layer."""
        through = [
            f"{law.describe()} through a layer of {1e3 * thickness:.6g} um"
            for law, thickness in zip(self.laws, self.thicknesses, strict=False)
        ]
        return ", then ".join([*through, f"{self.laws[-1].describe()} in the body itself"])


#: most scalings of averages
_SCALINGS = 1000


def averaging(r: FloatArray, area: FloatArray, length: float) -> FloatArray:
    """Return the (n, n) matrix of Gaussian averages over a length, of non-local laws.

    The same average is taken of the pressure and of the rate: pressure felt at a distance wears at
    that distance, without which a step need not have a solution. Rows sum to 1 and
    ``diag(area) A`` is symmetric, so that constants and area integrals are kept (Sinkhorn's
    scaling).
    """
    kernel = np.exp(-0.5 * ((r[:, None] - r) / length) ** 2) * area[:, None] * area
    scale = 1.0 / np.sqrt(kernel.sum(axis=1) / area)
    for _ in range(_SCALINGS):
        sums = scale * (kernel @ scale) / area
        if np.abs(sums - 1.0).max() < 1e-14:
            break
        scale = scale / np.sqrt(sums)
    matrix = scale[:, None] * kernel * scale / area[:, None]
    return matrix / matrix.sum(axis=1)[:, None]
