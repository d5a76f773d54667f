"""Archard's law: wear in proportion to pressure and sliding speed."""

from dataclasses import dataclass

from ringwear_par.arrays import FloatArray
from ringwear_par.schedules import Stacked, Table, value
from ringwear_par.wear.law import Coefficient, Law
from ringwear_par.wear.local_state import LocalState


@dataclass(frozen=True)
class ArchardLaw(Law):
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

    name = "archard"
    formula = "k p V"
    steady = True

    k: Coefficient

    def per_energy(self, friction: float) -> float | None:
        """Return k / mu, 1/MPa, where k is a number and there is friction."""
        if isinstance(self.k, Table | Stacked) or friction <= 0.0:
            return None
        return self.k / friction

    def line(self, local: LocalState) -> tuple[FloatArray, float | FloatArray] | None:
        """Return rise, mm/s/MPa, and onset, 0 MPa."""
        return value(self.k, local.time, local.r) * local.speed, 0.0

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return value(self.k, local.time, local.r) * local.speed * p

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return value(self.k, local.time, local.r) * local.speed

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return 0.5 * value(self.k, local.time, local.r) * local.speed * p * p
