"""Curves through readings over time: smoothing splines, or lines between the readings."""

import math
from typing import Literal

import numpy as np
from scipy.interpolate import BSpline, make_smoothing_spline
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar

from ringwear_par.arrays import FloatArray
from ringwear_par.schedules import Table

#: "auto", "none" (lines between readings), or the period (s) of which half of a wave stays
Smoothing = Literal["auto", "none"] | float
#: most readings that are joined by lines
MOST_POINTS = 2000
#: numbers of knots that are tried; how many times earlier than the end time changes from
#: logarithmic to linear
_KNOTS, _EARLY = (12, 24, 48, 96), 36.0
#: more knots are taken only if their cross-validated square is below this share of that of fewer
_WORTH = 0.95
#: fewest points of a curve as a table, and points of a period
_POINTS, _OF_PERIOD = 200, 60.0
#: logarithms of penalties that are tried
_PENALTIES = np.linspace(math.log(1e-9), math.log(1e9), 120)


def curve(time: FloatArray, value: FloatArray, smooth: Smoothing, end: float) -> Table:
    """Return the curve through readings as a table, constant beyond them.

    Parameters
    ----------
    time, value : (n,) s, increasing, and readings, 10 at least.
    end : s, of the test.
    """
    if smooth == "none":
        return Table(tuple(time.tolist()), tuple(value.tolist()))
    if smooth == "auto":
        start, last = np.log1p(_EARLY * time[[0, -1]] / end)
        at = np.linspace(start, last, _POINTS)
        values = cross_validated(np.log1p(_EARLY * time / end), value)(at)
        at = np.expm1(at) * end / _EARLY
        at[[0, -1]] = time[[0, -1]]  # to the last bit
    else:
        assert isinstance(smooth, float)
        length = float(np.ptp(time))
        count = int(np.clip(_OF_PERIOD * length / smooth, _POINTS, MOST_POINTS))
        at = np.linspace(time[0], time[-1], count)
        # of the equivalent kernel, whose response is 1 / (1 + (2 pi h / period)^4)
        penalty = len(time) / length * (smooth / (2.0 * math.pi)) ** 4
        values = make_smoothing_spline(time, value, lam=penalty)(at)
    values = np.clip(values, value.min(), value.max())
    return Table(tuple(at.tolist()), tuple(values.tolist()))


def cross_validated(x: FloatArray, value: FloatArray) -> BSpline:
    """Return the cubic spline with equal knots that fits readings, of little curvature.

    Knots are few, unless the readings follow more of them.
    """
    best, least = penalised(x, value, max(2, min(_KNOTS[0], len(x) // 2)))
    for count in _KNOTS[1:]:
        if count > len(x) // 2:
            break
        spline, square = penalised(x, value, count)
        if square < _WORTH * least:
            best, least = spline, square
    return best


def penalised(x: FloatArray, value: FloatArray, count: int) -> tuple[BSpline, float]:
    """Return the spline with a number of knots, and its square by generalised cross-validation.

    The penalty on the integral of its squared second derivative is that of the least such square
    (P. H. C. Eilers and B. D. Marx, Statistical Science 11 (1996) 89-121).
    """
    knots = np.linspace(x[0], x[-1], count)
    padded = np.concatenate([[x[0]] * 3, knots, [x[-1]] * 3])
    basis = BSpline.design_matrix(x, padded, 3).toarray()
    functions = basis.shape[1]
    # second derivatives are straight between knots: Simpson's rule is exact
    step = knots[1] - knots[0]
    places = np.linspace(x[0], x[-1], 2 * len(knots) - 1)
    weights = np.full(len(places), 2.0)
    weights[1::2], weights[[0, -1]] = 4.0, 1.0
    bends = BSpline(padded, np.eye(functions), 3).derivative(2)(places)
    bending = bends.T @ (step / 6.0 * weights[:, None] * bends)
    gram, middle = basis.T @ basis, float(value.mean())
    scale = float(np.trace(gram) / np.trace(bending))
    # with both in one eigenbasis every penalty is diagonal
    shares, vectors = eigh(gram, gram + scale * bending)
    shares = np.clip(shares, 0.0, 1.0)
    right = vectors.T @ (basis.T @ (value - middle))
    square = float(((value - middle) ** 2).sum())

    def damped(log_penalty: float) -> FloatArray:
        ratio: FloatArray = 1.0 / (shares + math.exp(log_penalty) * (1.0 - shares))
        return ratio

    def cross_validation(log_penalty: float) -> float:
        damping = damped(log_penalty)
        part = damping * right
        rest = max(square - 2.0 * float(right @ part) + float(part @ (shares * part)), 0.0)
        freedom = len(x) - float((shares * damping).sum())
        return len(x) * rest / freedom**2

    best = int(np.argmin([cross_validation(float(log)) for log in _PENALTIES]))
    around = _PENALTIES[[max(best - 1, 0), min(best + 1, len(_PENALTIES) - 1)]]
    minimum = minimize_scalar(cross_validation, bounds=around, method="bounded")
    values = middle + vectors @ (damped(float(minimum.x)) * right)
    return BSpline(padded, values, 3), float(minimum.fun)
