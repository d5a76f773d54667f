"""Wear laws, eq. (4) of the paper and beyond, and the wear of one implicit step.

A law gives the rate of wear and its derivative with respect to pressure. It may know the instant,
the sliding, and what is local memory: the depth worn off this body and the distance slid. Rates
must not be negative and not fall with pressure, so that the implicit step is a convex problem.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Protocol

import numpy as np

from ringwear_par.errors import ComputationError, InputError, LawError
from ringwear_par.geometry import FloatArray
from ringwear_par.quantity import Quantity, Table, knots, value

_MEMORY_ITERATIONS = 60
_BISECTIONS = 30
#: relative change at which the wear of a step is found, and below which it may stop falling
_ROUND_OFF, _NOISE = 1e-15, 1e-9
_POTENTIAL_PANELS = 8
_GAUSS = tuple(0.5 * v for v in np.polynomial.legendre.leggauss(8))


@dataclass(frozen=True)
class Sliding:
    """What a law may know besides the pressure, for the elements of the contact line.

    Parameters
    ----------
    time : s.
    r : (n,) float, mm.
    speed : (n,) float, mm/s, sliding speed V.
    friction : Coulomb's mu.
    wear : (n,) float, mm, depth worn off this body so far.
    slid : (n,) float, mm, distance slid so far (speed integrated over time).
    parameters : values of the user's own parameters at this time, each a number or (n,).
    """

    time: float
    r: FloatArray
    speed: FloatArray
    friction: float
    wear: FloatArray
    slid: FloatArray
    parameters: Mapping[str, Any] = field(default_factory=dict)
    #: (n,) mm/s, friction coefficient times sliding speed
    power: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "power", self.friction * self.speed)

    def part(self, here: slice) -> "Sliding":
        """Return the same for some of the elements."""
        return replace(
            self,
            r=self.r[here],
            speed=self.speed[here],
            wear=self.wear[here],
            slid=self.slid[here],
        )


class WearLaw(Protocol):
    """Local rate of wear as a non-decreasing function of contact pressure.

    Built-in laws and the user's own follow it. Pressures ``p`` are (n,) float, MPa, >= 0.
    """

    @property
    def length(self) -> float:
        """Averaging length, mm; 0 for a local law."""
        ...

    @property
    def knots(self) -> tuple[float, ...]:
        """Times at which a parameter's table bends."""
        ...

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on ``at.wear``, which ``wear_slope`` then tells."""
        ...

    def per_energy(self, friction: float) -> float | None:
        """Return worn volume per dissipated energy, 1/MPa, if it is always the same."""
        ...

    def rate(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the rate of wear, mm/s."""
        ...

    def slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        ...

    def wear_slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to ``at.wear``, 1/s."""
        ...

    def onset(self, at: Sliding) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        ...

    def potential(self, p: FloatArray, at: Sliding) -> FloatArray | None:
        """Return the integral of the rate from 0 to p, MPa mm/s; None: by quadrature."""
        ...


class _Local:
    """What laws without memory, without a closed integral and without a length share."""

    @property
    def length(self) -> float:
        return 0.0

    @property
    def remembers(self) -> bool:
        return False

    @property
    def knots(self) -> tuple[float, ...]:
        return knots(*(getattr(self, name, None) for name in ("k", "p0", "k_start")))

    def per_energy(self, friction: float) -> float | None:
        return None

    def wear_slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        return np.zeros_like(p)

    def onset(self, at: Sliding) -> float | FloatArray:
        return 0.0

    def potential(self, p: FloatArray, at: Sliding) -> FloatArray | None:
        return None


@dataclass(frozen=True)
class ThresholdLaw(_Local):
    """``k mu max(0, p - p0) V``, eq. (4) of the paper.

    Parameters
    ----------
    k : wear coefficient, 1/MPa.
    p0 : threshold pressure, MPa.
    """

    k: Quantity
    p0: Quantity = 0.0

    def per_energy(self, friction: float) -> float | None:
        """Return k, 1/MPa, where it is a number and p0 = 0."""
        return self.k if not isinstance(self.k, Table) and self.p0 == 0.0 else None

    def _rise(self, at: Sliding) -> FloatArray:
        return value(self.k, at.time, at.r) * at.power

    def _excess(self, p: FloatArray, at: Sliding) -> FloatArray:
        return np.maximum(p - value(self.p0, at.time, at.r), 0.0)

    def rate(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self._rise(at) * self._excess(p, at)

    def slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._rise(at) * (p > value(self.p0, at.time, at.r))

    def potential(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return 0.5 * self._rise(at) * self._excess(p, at) ** 2


@dataclass(frozen=True)
class ArchardLaw(_Local):
    """``k p V``, without friction coefficient.

    Parameters
    ----------
    k : wear coefficient, 1/MPa (volume per force and distance, mm3/(N mm)).
    """

    k: Quantity

    def per_energy(self, friction: float) -> float | None:
        """Return k / mu, 1/MPa, where k is a number and there is friction."""
        return self.k / friction if not isinstance(self.k, Table) and friction > 0.0 else None

    def rate(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return value(self.k, at.time, at.r) * at.speed * p

    def slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return value(self.k, at.time, at.r) * at.speed

    def potential(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return 0.5 * value(self.k, at.time, at.r) * at.speed * p * p


@dataclass(frozen=True)
class PowerLaw(_Local):
    """``k p^m V^n``.

    Parameters
    ----------
    k : mm/s where p = 1 MPa and V = 1 mm/s.
    m : exponent of pressure, >= 1.
    n : exponent of the sliding speed, > 0.
    """

    k: Quantity
    m: float
    n: float = 1.0

    def _rise(self, at: Sliding) -> FloatArray:
        return value(self.k, at.time, at.r) * at.speed**self.n

    def rate(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self._rise(at) * p**self.m

    def slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._rise(at) * self.m * p ** (self.m - 1.0)

    def potential(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return self._rise(at) * p ** (self.m + 1.0) / (self.m + 1.0)


@dataclass(frozen=True)
class TableLaw(_Local):
    """Rate against p V from a table; linear between its points, on with its last slope.

    Parameters
    ----------
    table : pairs (p V in MPa mm/s, rate in mm/s), both increasing from (0, 0).
    """

    table: tuple[tuple[float, float], ...]

    @cached_property
    def _points(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y = np.array(self.table).T
        slopes = np.diff(y) / np.diff(x)
        return x, y, np.append(slopes, slopes[-1])

    def _piece(self, p: FloatArray, at: Sliding) -> tuple[Any, FloatArray]:
        """Return the piece that the left of every p V lies on, as slopes jump up or down there."""
        pv = p * at.speed
        x = self._points[0]
        return np.maximum(np.searchsorted(x, pv, side="left") - 1, 0), pv

    def rate(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the rate of wear, mm/s."""
        x, y, slopes = self._points
        i, pv = self._piece(p, at)
        return y[i] + slopes[i] * (pv - x[i])

    def slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._points[2][self._piece(p, at)[0]] * at.speed

    def potential(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        x, y, slopes = self._points
        i, pv = self._piece(p, at)
        before = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])
        past = pv - x[i]
        area = before[i] + past * (y[i] + 0.5 * slopes[i] * past)
        return np.divide(area, at.speed, out=np.zeros_like(area), where=at.speed > 0.0)


@dataclass(frozen=True)
class RunningInLaw(_Local):
    """``k(s) mu max(0, p - p0) V``, k(s) falling from k_start to k with worn depth or distance.

    k(s) = k + (k_start - k) exp(-s), s being worn depth / ``depth`` or distance slid / ``distance``
    at the same place.

    Parameters
    ----------
    k, k_start : wear coefficients in the end and at the start, 1/MPa; k_start >= k.
    p0 : threshold pressure, MPa.
    depth, distance : mm; one of them, the other None.
    """

    k: Quantity
    k_start: Quantity
    p0: Quantity = 0.0
    depth: float | None = None
    distance: float | None = None

    @property
    def remembers(self) -> bool:
        """Whether worn depth is what it remembers."""
        return self.depth is not None

    def _fresh(self, at: Sliding) -> FloatArray:
        """Return (k_start - k) exp(-s)."""
        fall = value(self.k_start, at.time, at.r) - value(self.k, at.time, at.r)
        s = at.wear / self.depth if self.depth is not None else at.slid / (self.distance or 1.0)
        return fall * np.exp(-s)

    def rate(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the rate of wear, mm/s."""
        excess = np.maximum(p - value(self.p0, at.time, at.r), 0.0)
        return (value(self.k, at.time, at.r) + self._fresh(at)) * at.power * excess

    def slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        above = p > value(self.p0, at.time, at.r)
        return (value(self.k, at.time, at.r) + self._fresh(at)) * at.power * above

    def onset(self, at: Sliding) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        return value(self.p0, at.time, at.r)

    def wear_slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to ``at.wear``, 1/s."""
        if self.depth is None:
            return np.zeros_like(p)
        excess = np.maximum(p - value(self.p0, at.time, at.r), 0.0)
        return -self._fresh(at) / self.depth * at.power * excess


@dataclass(frozen=True)
class NonLocalLaw(ThresholdLaw):
    """``k mu max(0, <p> - p0) V``, pressure and the wear that it causes averaged over a length.

    The same average, which keeps constants and volumes, is taken of the pressure and of the rate:
    pressure felt at a distance wears at that distance. Taken of the pressure only, the step
    would no longer be a minimisation, nor its solution be sure to exist.

    Parameters
    ----------
    length : mm, standard deviation of the Gaussian average.
    """

    length: float = 0.0

    def per_energy(self, friction: float) -> float | None:
        """Return None: the sliding speed is not averaged."""
        return None


def _guarded(values: FloatArray) -> FloatArray:
    """Return a view that cannot be written to: a user's law may not change what it is given."""
    view = values.view()
    view.flags.writeable = False
    return view


@lru_cache(maxsize=64)
def _compiled(source: str, name: str) -> dict[str, Any]:
    """Return what the source of a user's law defines. On every rank, once."""
    names: dict[str, Any] = {"__name__": "user_law", "__file__": name}
    exec(compile(source, name, "exec"), names)
    return names


@dataclass(frozen=True)
class UserLaw(_Local):
    """A law from a Python file that defines ``rate(p, at)`` and ``slope(p, at)``.

    With ``wear_slope(p, at)`` too, the law remembers worn depth, exactly; ``at`` is a ``Sliding``.
    A list ``knots`` names times (s) at which the rate jumps or bends, where adaptive steps end.
    Whatever the file does wrong is told with time and element.

    Parameters
    ----------
    file : its name.
    source : its text.
    parameters : pairs of name and quantity, which ``at.parameters`` holds at the time.
    """

    file: str
    source: str
    parameters: tuple[tuple[str, Quantity], ...] = ()

    def missing(self) -> str:
        """Return what keeps the file from being a law, "" if nothing does."""
        try:
            names = self._functions
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            return f"cannot be run ({type(error).__name__}: {error}); must be a Python file"
        lacking = [name for name in ("rate", "slope") if not callable(names.get(name))]
        if lacking:
            return f"does not define {' and '.join(lacking)}; must define rate(p, at), slope(p, at)"
        return ""

    @property
    def remembers(self) -> bool:
        """Whether the file defines ``wear_slope``."""
        return "wear_slope" in self._functions

    @property
    def knots(self) -> tuple[float, ...]:
        """Times at which a parameter's table bends, and those that the file names as ``knots``."""
        own = {float(time) for time in self._functions.get("knots", ())}
        return tuple(sorted(own.union(knots(*(q for _, q in self.parameters)))))

    @property
    def _functions(self) -> dict[str, Any]:
        return _compiled(self.source, self.file)

    def _call(self, name: str, p: FloatArray, at: Sliding) -> FloatArray:
        if not np.isfinite(p).all():
            raise ComputationError("contact: pressures are not finite")
        values = {key: value(q, at.time, at.r) for key, q in self.parameters}
        try:
            with np.errstate(all="ignore"):
                there = replace(
                    at,
                    parameters=values,
                    r=_guarded(at.r),
                    speed=_guarded(at.speed),
                    wear=_guarded(at.wear),
                    slid=_guarded(at.slid),
                )
                result = self._functions[name](_guarded(p), there)
            if result is None or np.iscomplexobj(result):
                raise TypeError(f"it returns {type(result).__name__}, not real numbers")
            result = np.array(np.broadcast_to(np.asarray(result, dtype=float), p.shape))
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            raise LawError(
                f"{self.file}: {name}() failed at time {at.time:g} s: "
                f"{type(error).__name__}: {error}"
            ) from error
        bad = ~np.isfinite(result)
        if name != "wear_slope":
            bad |= result < 0.0
        if bad.any():
            e = int(np.flatnonzero(bad)[0])
            what = "rate" if name == "rate" else "derivative of the rate"
            why = "a finite number >= 0"
            if name == "slope" and result[e] < 0.0:
                why += ": rates must not fall with pressure"
            elif name == "wear_slope":
                why = "a finite number"
            raise LawError(
                f"{self.file}: {name}() gives {result[e]:g} as {what} at time {at.time:g} s, "
                f"element {e} (r = {at.r[e]:.6g} mm), p = {p[e]:.6g} MPa; must be {why}"
            )
        return result

    def rate(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the rate of wear, mm/s.

        Raises
        ------
        LawError : the function failed, or gave NaN or a negative rate.
        """
        return self._call("rate", p, at)

    def slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa.

        Raises
        ------
        LawError : the function failed, or gave NaN or a negative slope.
        """
        return self._call("slope", p, at)

    def wear_slope(self, p: FloatArray, at: Sliding) -> FloatArray:
        """Return the derivative of the rate with respect to ``at.wear``, 1/s."""
        return self._call("wear_slope", p, at) if self.remembers else np.zeros_like(p)


def check_user_law(law: UserLaw, at: Sliding, pressure: float) -> None:
    """Refuse a user's law that is no law, tried at pressures up to a given one (MPa).

    Not collective.

    Raises
    ------
    InputError : it wears without pressure, gives NaN or negative rates, or rates that fall or jump.
    """
    p = np.linspace(0.0, 1.0, 33)[:, None] * np.full_like(at.r, pressure)
    rates = []
    for row in p:
        try:
            rates.append(law.rate(row, at))
            law.slope(row, at)
            law.wear_slope(row, at)
        except ComputationError as error:
            raise InputError(str(error)) from error
    table = np.array(rates)
    if table[0].any():
        e = int(np.flatnonzero(table[0])[0])
        raise InputError(
            f"{law.file}: rate() gives {table[0, e]:g} without pressure (time {at.time:g} s, "
            f"element {e}, r = {at.r[e]:.6g} mm); must be 0: no wear without contact"
        )
    fall = np.diff(table, axis=0) < -1e-12 * table.max(initial=0.0)
    if fall.any():
        i, e = (int(v[0]) for v in np.nonzero(fall))
        raise InputError(
            f"{law.file}: rate() falls from {table[i, e]:g} to {table[i + 1, e]:g} between "
            f"p = {p[i, e]:.6g} and {p[i + 1, e]:.6g} MPa (time {at.time:g} s, element {e}, "
            f"r = {at.r[e]:.6g} mm); must not fall with pressure"
        )
    jump = _jump(law, at, p[:, 0], table)
    if jump:
        raise InputError(jump)


def check_user_slope(law: UserLaw, at: Sliding, pressure: float) -> None:
    """Refuse a user's law whose slope is another one than that of its rate. Not collective.

    Raises
    ------
    InputError : it is.
    """
    rng = np.random.default_rng(1)
    tried = pressure * rng.uniform(0.01, 0.99, len(at.r))
    if not taylor_test(law, at, tried, rng.uniform(-1.0, 1.0, len(at.r))).passed:
        raise InputError(
            f"{law.file}: slope() is not the derivative of rate() with respect to p; must be "
            "(see ringwear laws)"
        )


def _jump(law: UserLaw, at: Sliding, p: FloatArray, rates: FloatArray) -> str:
    """Return where the rate jumps with pressure, "" if it does not: by bisection of steep pieces.

    Parameters
    ----------
    p : (k,) float, MPa, increasing.
    rates : (k, n) float, mm/s, at these pressures.
    """
    e = int(rates[-1].argmax())
    rise = np.diff(rates[:, e])
    i = int(rise.argmax())
    low, high, below, above = p[i], p[i + 1], rates[i, e], rates[i + 1, e]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        rate = law.rate(np.full_like(at.r, middle), at)[e]
        if rate - below > above - rate:
            high, above = middle, rate
        else:
            low, below = middle, rate
    if above - below <= 1e-3 * rise[i]:
        return ""
    return (
        f"{law.file}: rate() jumps from {below:g} to {above:g} at p = {low:.6g} MPa "
        f"(time {at.time:g} s, element {e}, r = {at.r[e]:.6g} mm); must be continuous in p"
    )


def averaging(r: FloatArray, area: FloatArray, length: float) -> FloatArray:
    """Return the (n, n) matrix of Gaussian averages over a length.

    Rows sum to 1 and ``diag(area) A`` is symmetric, so that constants and area integrals are
    kept (Sinkhorn's scaling).
    """
    if length <= 0.0:
        return np.eye(len(r))
    kernel = np.exp(-0.5 * ((r[:, None] - r) / length) ** 2) * area[:, None] * area
    scale = 1.0 / np.sqrt(kernel.sum(axis=1) / area)
    for _ in range(1000):
        sums = scale * (kernel @ scale) / area
        if np.abs(sums - 1.0).max() < 1e-14:
            break
        scale = scale / np.sqrt(sums)
    symmetric = scale[:, None] * kernel * scale
    matrix = symmetric / area[:, None]
    return matrix / matrix.sum(axis=1)[:, None]


@dataclass(frozen=True)
class StepWear:
    """Wear of both bodies over one implicit step, as a function of the pressure at its end.

    Parameters
    ----------
    laws : laws of lower and upper, None for a body that does not wear.
    at : sliding for lower and upper at the end of the step, with the wear before it.
    step : s.
    averages : (n, n) matrices of the non-local laws, None for local ones.
    """

    laws: tuple[WearLaw | None, ...]
    at: tuple[Sliding, ...]
    step: float
    averages: tuple[FloatArray | None, ...] = (None, None)

    #: whether all laws are local, so that ``slope`` is the whole derivative
    local: bool = field(init=False, repr=False)
    _each: list[tuple[WearLaw, Sliding, FloatArray | None]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        bodies = zip(self.laws, self.at, self.averages, strict=True)
        each = [(law, at, average) for law, at, average in bodies if law is not None]
        object.__setattr__(self, "_each", each)
        object.__setattr__(self, "local", all(a is None for a in self.averages))

    def _depth(
        self, law: WearLaw, at: Sliding, average: FloatArray | None, p: FloatArray
    ) -> FloatArray:
        """Return what one body loses, mm; solves d = step rate(p, wear + d) where it remembers."""
        p = np.maximum(p, 0.0)
        if average is not None:
            return self.step * (average @ law.rate(average @ p, at))
        return self.step * law.rate(p, self._after(law, at, p) if law.remembers else at)

    def _after(self, law: WearLaw, at: Sliding, p: FloatArray) -> Sliding:
        """Return the sliding with the depth worn at the end of the step (Newton, from below).

        Raises
        ------
        ComputationError : it does not settle: the rate grows with worn depth too fast.
        """
        depth, before = np.zeros_like(p), np.inf
        for _ in range(_MEMORY_ITERATIONS):
            there = replace(at, wear=at.wear + depth)
            rise = 1.0 - self.step * law.wear_slope(p, there)
            if (rise <= 0.0).any():
                e = int(rise.argmin())
                break
            change = (self.step * law.rate(p, there) - depth) / rise
            depth = np.maximum(depth + change, 0.0)
            worst = np.abs(change) / np.maximum(at.wear + depth, 1e-300)
            e, largest = int(worst.argmax()), float(worst.max())
            if largest <= _ROUND_OFF or before <= largest <= _NOISE:  # no better than its round-off
                return replace(at, wear=at.wear + depth)
            before = largest
        raise ComputationError(
            f"wear law at time {at.time:g} s: the wear of element {e} (r = {at.r[e]:.6g} mm) over "
            f"a step of {self.step:g} s does not settle; the rate grows with worn depth too fast"
        )

    def _slope(self, law: WearLaw, at: Sliding, p: FloatArray) -> FloatArray:
        p = np.maximum(p, 0.0)
        if not law.remembers:
            return self.step * law.slope(p, at)
        after = self._after(law, at, p)
        return self.step * law.slope(p, after) / (1.0 - self.step * law.wear_slope(p, after))

    def depths(self, p: FloatArray) -> FloatArray:
        """Return what lower and upper lose, (2, n) mm."""
        depths = np.zeros((2, len(p)))
        for i, law in enumerate(self.laws):
            if law is not None:
                depths[i] = self._depth(law, self.at[i], self.averages[i], p)
        return depths

    def volumes(self, depths: FloatArray, p: FloatArray, area: FloatArray) -> FloatArray:
        """Return step times the area integrals of the rates of lower and upper, (2,) mm^3.

        The rates are those at the end of the step, before any average of them; the volumes of the
        depths are to be the same.
        """
        volumes = depths @ area
        for i, (law, at, average) in enumerate(zip(self.laws, self.at, self.averages, strict=True)):
            if law is not None and average is not None:
                volumes[i] = self.step * float(law.rate(average @ p, at) @ area)
            elif law is not None and law.remembers:
                end = replace(at, wear=at.wear + depths[i])
                volumes[i] = self.step * float(law.rate(p, end) @ area)
        return volumes

    def depth(self, p: FloatArray) -> FloatArray:
        """Return the growth of the gap, mm."""
        return _total([self._depth(*each, p) for each in self._each])

    def slope(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_e, (n,) mm/MPa; of local laws all there is."""
        return _total(
            [
                self._slope(law, at, p)
                if average is None
                else ((average * average.T) * self._slope(law, at, average @ p)).sum(axis=1)
                for law, at, average in self._each
            ]
        )

    def derivative(self, p: FloatArray) -> FloatArray:
        """Return d depth / d p, (n, n) mm/MPa."""
        total = np.zeros((len(p), len(p)))
        for law, at, average in self._each:
            if average is None:
                total[np.diag_indices(len(p))] += self._slope(law, at, p)
            else:
                total += (average * self._slope(law, at, average @ p)) @ average
        return total

    def linear(self, p: FloatArray, change: FloatArray) -> FloatArray:
        """Return what a small change of pressure does to the depth, mm."""
        return self.slope(p) * change if self.local else self.derivative(p) @ change

    def potential(self, p: FloatArray) -> FloatArray:
        """Return the integral of the depth from 0 to p, MPa mm.

        Non-local laws: area integrals of it are those of the potential, not its values.
        """
        parts = []
        for law, at, average in self._each:
            q = np.maximum(p if average is None else average @ p, 0.0)
            part = None if law.remembers else law.potential(q, at)
            parts.append(self._integrated(law, at, q) if part is None else self.step * part)
        return _total(parts)

    def _integrated(self, law: WearLaw, at: Sliding, p: FloatArray) -> FloatArray:
        """Integrate the depth from the onset of wear to p by Gauss rules: exact where smooth."""
        low, total = law.onset(at), np.zeros_like(p)
        span = np.maximum(p - low, 0.0)
        for panel in range(_POTENTIAL_PANELS):
            for x, w in zip(*_GAUSS, strict=True):
                share = (panel + 0.5 + x) / _POTENTIAL_PANELS
                total += w / _POTENTIAL_PANELS * self._depth(law, at, None, low + share * span)
        return total * span

    def part(self, here: slice) -> "StepWear":
        """Return the same for some of the elements.

        Raises
        ------
        InputError : a law is non-local.
        """
        if not self.local:
            raise InputError(
                'law = "non-local": needs a contact problem that every rank solves by itself; '
                "must be used with fewer contact elements or -contact_tao_type python"
            )
        return replace(self, at=tuple(at.part(here) for at in self.at))


def _total(parts: list[FloatArray]) -> FloatArray:
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]


@dataclass(frozen=True)
class Remainders:
    """A Taylor test: ``|f(p + h d) - f(p) - h f'(p) d|`` at halved h falls with order 2.

    Parameters
    ----------
    steps : h, MPa.
    remainders : largest remainder of all elements at each, relative to the largest ``|f'(p) d|``.
    bounded : whether at the smallest h no element's remainder is more than h times what the
        derivative changes on the way, so that kinks, and nothing else, may spoil the order.
    """

    steps: tuple[float, ...]
    remainders: tuple[float, ...]
    bounded: bool

    @property
    def order(self) -> float:
        """Smallest observed order; infinity where no remainder is left but round-off."""
        pairs = [
            math.log(a / b) / math.log(h / k)
            for a, b, h, k in zip(
                self.remainders, self.remainders[1:], self.steps, self.steps[1:], strict=False
            )
            if b > 1e-9 * k
        ]
        return min(pairs, default=math.inf)

    @property
    def passed(self) -> bool:
        """Whether the derivative is one: order near 2, or less because of kinks."""
        return self.order > 1.9 or self.bounded


def taylor_test(
    law: WearLaw, at: Sliding, p: FloatArray, direction: FloatArray, step: float = 0.0
) -> Remainders:
    """Compare a law's derivative with its rate. Not collective.

    Parameters
    ----------
    law : any law, built in or the user's.
    at : sliding at which it is tried.
    p : (n,) float, MPa.
    direction : (n,) float, at most 1.
    step : s; the wear over an implicit step is tried, memory included; 0 for the rate alone.
    """
    average = averaging(at.r, np.ones_like(at.r), float(law.length)) if law.length else None
    wear = StepWear((law, None), (at, at), step or 1.0, (average, None))

    def f(p: FloatArray) -> FloatArray:
        return wear.depth(p) if step else law.rate(p, at)

    def slope_along(p: FloatArray) -> FloatArray:
        return wear.derivative(p) @ direction if step else law.slope(p, at) * direction

    slope, start = slope_along(p), f(p)
    size = float(np.abs(slope).max()) or 1.0
    steps = tuple(float(p.max()) * 2.0**-i for i in range(8, 13))
    off = np.array([np.abs(f(p + h * direction) - start - h * slope) for h in steps])
    change = np.abs(slope_along(p + steps[-1] * direction) - slope)
    bounded = off[-1] <= steps[-1] * (2.0 * change + 1e-9 * size)  # the mean value theorem
    return Remainders(steps, tuple((off.max(axis=1) / size).tolist()), bool(bounded.all()))
