"""Readings of a test as polynomials of the unknowns, from one block of histories.

Readings of a test differ by a few modes (their principal components), whose coordinates are smooth
in the unknowns: polynomials in a box tell them. Each point in turn, left out of the polynomials,
tells their error.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.spatial import cKDTree
from scipy.stats import qmc

from ringwear_par.arrays import BoolArray, FloatArray, IntArray

#: number of points that fill a box, most of which may be beyond the bounds
_SOBOL = 8192
#: highest degree, and most terms over the number of points
_MOST_DEGREE, _MOST_TERMS = 14, 0.6
#: modes are kept whose rms is that many sd of the readings, or this share of the largest
_SMALL_MODE, _SMALL_SHARE = 1e-4, 1e-6
#: a higher degree must have a smaller error by this factor
_BETTER = 0.8
#: sd from the data beyond which points count less: there polynomials need not be good
_NEAR = 5.0


@dataclass(frozen=True, eq=False)
class Box:
    """Where unknowns (m,) are: within bounds, and in a parallelepiped along what is known."""

    #: (m,) bounds
    low: FloatArray
    high: FloatArray
    centre: FloatArray
    #: (m, m) half edges, one a column
    axes: FloatArray

    @classmethod
    def about(cls, points: FloatArray, low: FloatArray, high: FloatArray, margin: float) -> "Box":
        """Return the box of points (s, m) along their covariance, wider by a share of its edges."""
        width = (high - low)[:, None]
        turned = np.linalg.eigh(np.cov(points.T / width).reshape(len(low), -1))[1] * width
        t = np.linalg.solve(turned, points.T)
        a, b = t.min(axis=1), t.max(axis=1)
        half = (0.5 + margin) * np.maximum(b - a, 1e-9)
        return cls(low, high, turned @ (0.5 * (a + b)), turned * half)

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.linalg.inv(self.axes).T

    def inside(self, x: FloatArray) -> FloatArray:
        """Return coordinates (..., m) of points, -1 to 1 in the box."""
        return (x - self.centre) @ self._inverse

    def holds(self, x: FloatArray) -> BoolArray:
        """Tell which points (..., m) are inside, (...)."""
        within: BoolArray = (x >= self.low) & (x <= self.high) & (np.abs(self.inside(x)) <= 1.0)
        return within.all(axis=-1)

    def design(self, count: int) -> FloatArray:
        """Return points (count, m) that fill the box, denser near its faces.

        There polynomials err most (Chebyshev). Of a box that is mostly beyond the bounds there may
        be fewer.
        """
        fractions = qmc.Sobol(len(self.low), seed=0).random(_SOBOL)
        x = self.centre - np.cos(np.pi * fractions) @ self.axes.T
        return x[((x >= self.low) & (x <= self.high)).all(axis=1)][:count]

    def polynomials(self, x: FloatArray, degree: int) -> FloatArray:
        """Return all products (..., p) of Legendre polynomials up to a total degree."""
        t = self.inside(x)
        orders = orders_of(len(self.low), degree)
        products = legvander(t[..., 0], degree)[..., orders[:, 0]]
        for j in range(1, t.shape[-1]):
            products *= legvander(t[..., j], degree)[..., orders[:, j]]
        return products


@cache
def orders_of(m: int, degree: int) -> IntArray:
    """Return the degrees (p, m) in each of m unknowns of all products up to a total degree."""
    if m == 1:
        return np.arange(degree + 1)[:, None]
    rows = [(d, *rest) for d in range(degree + 1) for rest in orders_of(m - 1, degree - d).tolist()]
    return np.array(rows)


@dataclass(frozen=True, eq=False)
class Emulator:
    """Readings (n,) of a test in a box of its unknowns: a mean, and coordinates along modes."""

    box: Box
    degree: int
    #: (p, r)
    coefficients: FloatArray
    #: (n,) and (r, n), in the units of the readings
    mean: FloatArray
    modes: FloatArray
    #: largest rms error of a reading, in its sd
    error: float
    #: points (P, m) in the box, and whether each has a history
    points: FloatArray
    good: BoolArray

    @cached_property
    def _nearest(self) -> cKDTree:
        return cKDTree(self.box.inside(self.points))

    def holds(self, x: FloatArray) -> BoolArray:
        """Tell which unknowns (..., m) are in the box, and nearest to one with a history, (...)."""
        inside = self.box.holds(x)
        if not self.good.all() and inside.any():
            inside[inside] = self.good[self._nearest.query(self.box.inside(x[inside]))[1]]
        return inside

    def coordinates(self, x: FloatArray) -> FloatArray:
        """Return the coordinates (..., r) along the modes at unknowns (..., m)."""
        return self.box.polynomials(x, self.degree) @ self.coefficients

    def __call__(self, x: FloatArray) -> FloatArray:
        """Return readings (..., n) at unknowns (..., m)."""
        return self.mean + self.coordinates(x) @ self.modes


def nearness(distance: FloatArray) -> FloatArray:
    """Return how much points at distances (P,) from the data, in sd, count in an emulator."""
    near = max(_NEAR, float(np.quantile(distance, 0.1)))
    return 1.0 / np.maximum(1.0, distance / near) ** 2


def emulate(
    box: Box,
    points: FloatArray,
    readings: FloatArray,
    sd: FloatArray,
    weights: FloatArray,
    tolerance: float,
) -> tuple[Emulator, FloatArray]:
    """Return the emulator of least degree that is as good as wanted, or the best one.

    Also return the readings (P, n) at each point by polynomials that do not know that point.

    Parameters
    ----------
    points : (P, m) within the box.
    readings : (P, n) there, NaN where there is no history.
    sd : (n,) of the readings.
    weights : how much each point with a history counts.
    tolerance : rms error of a reading, in its sd, that is good enough.
    """
    good = np.isfinite(readings).all(axis=1)
    left_out, y, weights = readings.copy(), readings[good], weights[:, None]
    scale = np.square(weights).sum()
    mean = (np.square(weights) * y).sum(axis=0) / scale
    left, values, modes = np.linalg.svd(weights * (y - mean) / sd, full_matrices=False)
    least = max(_SMALL_MODE * np.sqrt(scale), _SMALL_SHARE * values[0])
    kept = max(int((values > least).sum()), 1)
    wanted, modes = left[:, :kept] * values[:kept], modes[:kept]
    best: tuple[float, int, FloatArray, FloatArray] | None = None
    for degree in range(1, _MOST_DEGREE + 1):
        if best is not None and len(orders_of(points.shape[1], degree)) > _MOST_TERMS * len(y):
            break
        terms = weights * box.polynomials(points[good], degree)
        q = np.linalg.qr(terms)[0]
        leverage = np.minimum(np.square(q).sum(axis=1), 1.0 - 1e-3)
        off = (wanted - q @ (q.T @ wanted)) / (1.0 - leverage)[:, None]
        error = float(np.sqrt(np.square(off @ modes).sum(axis=0).max() / scale))
        if best is None or error < _BETTER * best[0]:
            best = error, degree, terms, off
        if error < tolerance:
            break
    assert best is not None
    error, degree, terms, off = best
    left_out[good] = y - off / weights @ modes * sd
    coefficients = np.linalg.lstsq(terms, wanted, rcond=1e-12)[0]
    return Emulator(box, degree, coefficients, mean, modes * sd, error, points, good), left_out
