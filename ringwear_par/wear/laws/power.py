"""A power law of pressure and sliding speed."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.schedules import Quantity, value
from ringwear_par.wear.law import Law, Parameter
from ringwear_par.wear.local_state import LocalState


@dataclass(frozen=True)
class PowerLaw(Law):
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

    name = "power"
    formula = "k p^m V^n"
    steady = True

    k: Annotated[Quantity, Parameter("mm/s", "rate where p = 1 MPa and V = 1 mm/s")]
    m: Annotated[float, Parameter("1", "exponent of p", "number", low=1.0, high=10.0)]
    n: Annotated[float, Parameter("1", "exponent of V", "number", high=10.0, ends=False)] = 1.0

    def _rise(self, local: LocalState) -> FloatArray:
        return value(self.k, local.time, local.r) * _power(local.speed, self.n)

    def _slope(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate over the pressure; rates and slopes are of the same pressures."""
        memo = local.memo
        if not memo or memo[0] is not self:
            memo[:] = self, self._rise(local), None, None
        if memo[2] is not p:
            memo[2:] = p, memo[1] * _power(p, self.m - 1.0)
        slope: FloatArray = memo[3]
        return slope

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return p * self._slope(p, local)

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self.m * self._slope(p, local)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        return np.divide(self._rise(local) * _power(p, self.m + 1.0), self.m + 1.0)


def _power(x: FloatArray, exponent: float | FloatArray) -> FloatArray:
    """Return (..., n) powers; exponents of B histories, (B, 1), one by one.

    Those of elements, which layers have, are (..., n).

    Squares and roots of a whole array are other operations than those of arrays of exponents, and
    a history is to have the same numbers alone and among others.
    """
    if not isinstance(exponent, np.ndarray) or exponent.shape[-1] > 1:
        return x**exponent
    rows = np.broadcast_to(x, (len(exponent), x.shape[-1]))
    return np.array([row**e for row, e in zip(rows, exponent.ravel().tolist(), strict=True)])
