"""Wear laws, eq. (4) of the paper, and the wear of one time step."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ringwear_par.geometry import FloatArray


class WearLaw(Protocol):
    """Local rate of wear as a non-decreasing function of contact pressure.

    ``p`` : (n,) float, MPa; ``power`` : (n,) float, mm/s, friction coefficient times sliding speed.
    """

    @property
    def proportional(self) -> float | None:
        """Ratio of the rate to the dissipated power, 1/MPa, if it is the same at every pressure."""
        ...

    def rate(self, p: FloatArray, power: FloatArray) -> FloatArray:
        """Return the rate of wear, mm/s."""
        ...

    def slope(self, p: FloatArray, power: FloatArray) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        ...

    def potential(self, p: FloatArray, power: FloatArray) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        ...


@dataclass(frozen=True)
class ThresholdLaw:
    """``k mu max(0, p - p0) V``, eq. (4).

    Parameters
    ----------
    k : wear coefficient, 1/MPa.
    p0 : threshold pressure, MPa.
    """

    k: float
    p0: float = 0.0

    @property
    def proportional(self) -> float | None:
        """Ratio of the rate to the dissipated power, 1/MPa: k, where p0 = 0."""
        return self.k if self.p0 == 0.0 else None

    def rate(self, p: FloatArray, power: FloatArray) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self.k * power * np.maximum(p - self.p0, 0.0)

    def slope(self, p: FloatArray, power: FloatArray) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self.k * power * (p > self.p0)

    def potential(self, p: FloatArray, power: FloatArray) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return 0.5 * self.k * power * np.maximum(p - self.p0, 0.0) ** 2


@dataclass(frozen=True)
class StepWear:
    """Wear of both bodies over one implicit step, as a function of the pressure at its end.

    Parameters
    ----------
    laws : laws of the bodies that wear, one at least.
    power : (n,) float, mm/s, friction coefficient times sliding speed.
    step : s.
    """

    laws: tuple[WearLaw, ...]
    power: FloatArray
    step: float

    def depth(self, p: FloatArray) -> FloatArray:
        """Return the growth of the gap, mm."""
        return self.step * _total([law.rate(p, self.power) for law in self.laws])

    def slope(self, p: FloatArray) -> FloatArray:
        """Return d depth / d p, mm/MPa."""
        return self.step * _total([law.slope(p, self.power) for law in self.laws])

    def potential(self, p: FloatArray) -> FloatArray:
        """Return the integral of the depth from 0 to p, MPa mm."""
        return self.step * _total([law.potential(p, self.power) for law in self.laws])

    def part(self, here: slice) -> "StepWear":
        """Return the same for some of the elements."""
        return StepWear(self.laws, self.power[here], self.step)


def _total(parts: list[FloatArray]) -> FloatArray:
    return sum(parts[1:], parts[0])
