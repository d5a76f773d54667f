"""The paper's law, eq. (4): wear in proportion to the friction power above a threshold pressure."""

from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.schedules import Quantity, Stacked, Table, value
from ringwear_par.wear.law import Coefficient, Law, Threshold
from ringwear_par.wear.local_state import LocalState


class AboveThreshold(Law):
    """A law of the form rise x max(0, p - p0); subclasses define the rise."""

    p0: Quantity

    def _rise(self, local: LocalState) -> FloatArray:
        """Return the slope above the threshold, mm/s/MPa."""
        raise NotImplementedError

    def _line(self, local: LocalState) -> tuple[FloatArray, float | FloatArray]:
        """Return rise and threshold, kept in the memo: a step needs them several times."""
        memo = local.memo
        if not memo or memo[0] is not self:
            memo[:] = self, self._rise(local), value(self.p0, local.time, local.r)
        return memo[1], memo[2]

    def line(self, local: LocalState) -> tuple[FloatArray, float | FloatArray] | None:
        """Return rise, mm/s/MPa, and onset, MPa."""
        return None if self.remembers else self._line(local)

    def _excess(self, p: FloatArray, local: LocalState) -> FloatArray:
        excess = np.asarray(p - self._line(local)[1])
        return np.maximum(excess, 0.0, out=excess)

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self._line(local)[0] * self._excess(p, local)

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        rise, p0 = self._line(local)
        return rise * (p > p0)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return 0.5 * self._line(local)[0] * self._excess(p, local) ** 2

    def onset(self, local: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        return self._line(local)[1]


@dataclass(frozen=True)
class ThresholdLaw(AboveThreshold):
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

    name = "threshold"
    formula = "k mu max(0, p - p0) V"
    steady = True
    line = AboveThreshold.line

    k: Coefficient
    p0: Threshold = 0.0

    def per_energy(self, friction: float) -> float | None:
        """Return k, 1/MPa, where it is a number and p0 = 0."""
        return self.k if not isinstance(self.k, Table | Stacked) and self.p0 == 0.0 else None

    def _rise(self, local: LocalState) -> FloatArray:
        return value(self.k, local.time, local.r) * local.power
