"""Quadrature on an element: how many points, and where, for a stated relative accuracy.

Far and near-singular elements: the kernels are analytic but for the source, so n-point Gauss
errors fall like rho^(-2n), rho being the size of the Bernstein ellipse through the source. Foci
are the element's ends, so with d1, d2 the distances from the source to them and L the length,
(d1 + d2) / L = (rho + 1/rho) / 2: no square root and no logarithm decide the order. Elements too
close for ``MAX_POINTS`` are halved until their parts are not.

Elements that hold the source: on each side of it the regularised integrand is
f(t) + g(t) log t with f, g smooth; t = tau^5 turns the logarithm into a weak singularity of high
order for Gauss points in tau.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray

#: also in ``_rings.h``
MAX_POINTS = 16
# the factor before rho^(-2n): the traction kernel has poles of second order
_SAFETY = 0.02
_SINGULAR_POWER = 5


class Quadrature(NamedTuple):
    """Rules on [0, 1]."""

    #: (MAX_POINTS+1,) float, decreasing; n points serve where (d1 + d2)/L >= reach[n]
    reach: FloatArray
    #: (MAX_POINTS+1, MAX_POINTS) float; row n holds the n-point Gauss rule, row 0 that for
    #: f + g log t, from the source outwards
    points: FloatArray
    weights: FloatArray


@cache
def quadrature(tolerance: float) -> Quadrature:
    """Return the rules for a relative accuracy of the element integrals, not to be written to."""
    reach = np.full(MAX_POINTS + 1, np.inf)
    points = np.zeros((MAX_POINTS + 1, MAX_POINTS))
    weights = np.zeros_like(points)
    for n in range(1, MAX_POINTS + 1):
        rho = (_SAFETY * tolerance) ** (-0.5 / n)
        reach[n] = 0.5 * (rho + 1.0 / rho)
        x, w = np.polynomial.legendre.leggauss(n)
        points[n, :n] = 0.5 * (x + 1.0)
        weights[n, :n] = 0.5 * w
    tau, power = points[MAX_POINTS], _SINGULAR_POWER
    points[0], weights[0] = tau**power, weights[MAX_POINTS] * power * tau ** (power - 1)
    return Quadrature(reach, points, weights)
