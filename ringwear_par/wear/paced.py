"""A law whose rates are multiplied: wear that is random runs faster or slower in each step."""

from dataclasses import dataclass

from ringwear_par.arrays import FloatArray
from ringwear_par.wear.law import Law
from ringwear_par.wear.local_state import LocalState


@dataclass(frozen=True)
class PacedLaw(Law):
    """A law whose rate is that of another one times a factor, in a step.

    Parameters
    ----------
    law : the other one.
    pace : the factor, or (B, 1) of B histories.
    """

    law: Law
    pace: float | FloatArray

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on ``local.wear``."""
        return self.law.remembers

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self.pace * self.law.rate(p, local)

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self.pace * self.law.d_rate_dp(p, local)

    def d_rate_dwear(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``local.wear``, 1/s."""
        return self.pace * self.law.d_rate_dwear(p, local)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray | None:
        """Return the integral of the rate from 0 to p, MPa mm/s; None: by quadrature."""
        potential = self.law.potential(p, local)
        return None if potential is None else self.pace * potential

    def onset(self, local: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        return self.law.onset(local)
