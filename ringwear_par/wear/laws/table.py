"""A law given by points of a measured curve."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.wear.law import Law, Parameter
from ringwear_par.wear.local_state import LocalState


@dataclass(frozen=True)
class TableLaw(Law):
    """A measured curve: the rate of wear against pressure times sliding speed.

    Pairs are p V in MPa mm/s (1 MPa m/s is 1000) and the rate of depth in mm/s (1 um/h is 2.78e-7),
    the first of them (0, 0). The rate is linear between these points, and continues with the last
    slope beyond the last point.

    Use it where tests at several p V follow no formula, as near the p V limit of a polymer.

    The rate depends on pressure and speed only through their product, and not on the friction
    coefficient. Rates must not fall with p V. The curve passes through all points, with their
    scatter: smooth measured rates first.
    """

    name = "table"
    formula = "linear between points of p V"
    steady = True

    table: Annotated[
        tuple[tuple[float, float], ...],
        Parameter(
            "MPa mm/s and mm/s", "rate of wear; beyond its end the last slope goes on", "rates"
        ),
    ]

    @cached_property
    def _points(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y = np.array(self.table).T
        slopes = np.diff(y) / np.diff(x)
        return x, y, np.append(slopes, slopes[-1])

    def _piece(self, p: FloatArray, local: LocalState) -> tuple[Any, FloatArray]:
        """Return the piece that the left of every p V lies on, as slopes jump up or down there."""
        pv = p * local.speed
        x = self._points[0]
        return np.maximum(np.searchsorted(x, pv, side="left") - 1, 0), pv

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        x, y, slopes = self._points
        i, pv = self._piece(p, local)
        return y[i] + slopes[i] * (pv - x[i])

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._points[2][self._piece(p, local)[0]] * local.speed

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, MPa mm/s."""
        x, y, slopes = self._points
        i, pv = self._piece(p, local)
        before = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])
        past = pv - x[i]
        area = before[i] + past * (y[i] + 0.5 * slopes[i] * past)
        return np.divide(area, local.speed, out=np.zeros_like(area), where=local.speed > 0.0)

    def describe(self) -> str:
        """Return between which points it is linear."""
        (x, y), count = self.table[-1], len(self.table)
        return f"{self.formula}, {count} of them to {y:.10g} mm/s at p V = {x:.10g} MPa mm/s"
