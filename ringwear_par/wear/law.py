"""Wear laws, eq. (4) of the paper and beyond.

A law gives the rate of wear and its derivative with respect to pressure. It may know the instant,
the sliding, and what is local memory: the depth worn off this body and the distance slid. Rates
must not be negative and not fall with pressure, so that the implicit step is a convex problem.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.schedules import Quantity, Table, knots, value


@dataclass(frozen=True)
class LocalState:
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

    def part(self, here: slice) -> "LocalState":
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

    def rate(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        ...

    def slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        ...

    def wear_slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``at.wear``, 1/s."""
        ...

    def onset(self, at: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        ...

    def potential(self, p: FloatArray, at: LocalState) -> FloatArray | None:
        """Return the integral of the rate from 0 to p, MPa mm/s; None: by quadrature."""
        ...


class LocalLaw:
    """What laws without memory, without a closed integral and without a length share."""

    @property
    def length(self) -> float:
        """Averaging length, mm: none."""
        return 0.0

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on ``at.wear``: not."""
        return False

    @property
    def knots(self) -> tuple[float, ...]:
        """Times at which a parameter's table bends."""
        return knots(*(getattr(self, name, None) for name in ("k", "p0", "k_start")))

    def per_energy(self, friction: float) -> float | None:
        """Return worn volume per dissipated energy: not always the same."""
        return None

    def wear_slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``at.wear``: 0."""
        return np.zeros_like(p)

    def onset(self, at: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears: 0."""
        return 0.0

    def potential(self, p: FloatArray, at: LocalState) -> FloatArray | None:
        """Return None: the integral of the rate is left to quadrature."""
        return None


class _AboveThreshold(LocalLaw):
    """What laws of the form rise x max(0, p - p0) share; they give the rise."""

    p0: Quantity

    def _rise(self, at: LocalState) -> FloatArray:
        """Return the slope above the threshold, mm/s/MPa."""
        raise NotImplementedError

    def _excess(self, p: FloatArray, at: LocalState) -> FloatArray:
        return np.maximum(p - value(self.p0, at.time, at.r), 0.0)

    def rate(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self._rise(at) * self._excess(p, at)

    def slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._rise(at) * (p > value(self.p0, at.time, at.r))

    def potential(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return 0.5 * self._rise(at) * self._excess(p, at) ** 2

    def onset(self, at: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        return value(self.p0, at.time, at.r)


@dataclass(frozen=True)
class ThresholdLaw(_AboveThreshold):
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

    def _rise(self, at: LocalState) -> FloatArray:
        return value(self.k, at.time, at.r) * at.power


@dataclass(frozen=True)
class ArchardLaw(LocalLaw):
    """``k p V``, without friction coefficient.

    Parameters
    ----------
    k : wear coefficient, 1/MPa (volume per force and distance, mm3/(N mm)).
    """

    k: Quantity

    def per_energy(self, friction: float) -> float | None:
        """Return k / mu, 1/MPa, where k is a number and there is friction."""
        return self.k / friction if not isinstance(self.k, Table) and friction > 0.0 else None

    def rate(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return value(self.k, at.time, at.r) * at.speed * p

    def slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return value(self.k, at.time, at.r) * at.speed

    def potential(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return 0.5 * value(self.k, at.time, at.r) * at.speed * p * p


@dataclass(frozen=True)
class PowerLaw(LocalLaw):
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

    def _rise(self, at: LocalState) -> FloatArray:
        return value(self.k, at.time, at.r) * at.speed**self.n

    def rate(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self._rise(at) * p**self.m

    def slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._rise(at) * self.m * p ** (self.m - 1.0)

    def potential(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return self._rise(at) * p ** (self.m + 1.0) / (self.m + 1.0)


@dataclass(frozen=True)
class TableLaw(LocalLaw):
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

    def _piece(self, p: FloatArray, at: LocalState) -> tuple[Any, FloatArray]:
        """Return the piece that the left of every p V lies on, as slopes jump up or down there."""
        pv = p * at.speed
        x = self._points[0]
        return np.maximum(np.searchsorted(x, pv, side="left") - 1, 0), pv

    def rate(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        x, y, slopes = self._points
        i, pv = self._piece(p, at)
        return y[i] + slopes[i] * (pv - x[i])

    def slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._points[2][self._piece(p, at)[0]] * at.speed

    def potential(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        x, y, slopes = self._points
        i, pv = self._piece(p, at)
        before = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])
        past = pv - x[i]
        area = before[i] + past * (y[i] + 0.5 * slopes[i] * past)
        return np.divide(area, at.speed, out=np.zeros_like(area), where=at.speed > 0.0)


@dataclass(frozen=True)
class RunningInLaw(_AboveThreshold):
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

    def _fresh(self, at: LocalState) -> FloatArray:
        """Return (k_start - k) exp(-s)."""
        fall = value(self.k_start, at.time, at.r) - value(self.k, at.time, at.r)
        s = at.wear / self.depth if self.depth is not None else at.slid / (self.distance or 1.0)
        return fall * np.exp(-s)

    def _rise(self, at: LocalState) -> FloatArray:
        return (value(self.k, at.time, at.r) + self._fresh(at)) * at.power

    def wear_slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``at.wear``, 1/s."""
        if self.depth is None:
            return np.zeros_like(p)
        return -self._fresh(at) / self.depth * at.power * self._excess(p, at)


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
