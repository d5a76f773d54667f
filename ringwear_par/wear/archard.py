"""Archard's law: wear in proportion to pressure and sliding speed."""

from dataclasses import dataclass

from ringwear_par.arrays import FloatArray
from ringwear_par.schedules import Stacked, Table, value
from ringwear_par.wear.law import Law, LocalState
from ringwear_par.wear.parameters import Coefficient


@dataclass(frozen=True)
class ArchardLaw(Law):
    """``k p V``, without friction coefficient; k in 1/MPa: mm3 of wear per N mm."""

    name = "archard"
    formula = "k p V"

    k: Coefficient

    def _per_energy(self, friction: float) -> float | None:
        """Return k / mu, 1/MPa, where k is a number and there is friction."""
        if isinstance(self.k, Table | Stacked) or friction <= 0.0:
            return None
        return self.k / friction

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return value(self.k, local.time, local.r) * local.speed * p

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return value(self.k, local.time, local.r) * local.speed

    def d_rate_dparameter(self, name: str, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to a numeric parameter's value there."""
        if name == "k":
            return local.speed * p
        return super().d_rate_dparameter(name, p, local)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return 0.5 * value(self.k, local.time, local.r) * local.speed * p * p
