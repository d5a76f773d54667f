"""Least squares with errors that are correlated with the one before, AR(1)."""

from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray

_ROUNDS, _MOST = 3, 0.95
#: bias of a coefficient from n residuals is -(1 + 3 phi) / n; phi is taken to be this for it
_USUAL = 0.8


class Regression(NamedTuple):
    """A linear regression."""

    #: (m,) float
    coefficients: FloatArray
    #: (m, m) float
    covariance: FloatArray
    #: of the errors, from one to the next
    autocorrelation: float
    #: of an error
    sd: float


def regress(columns: FloatArray, values: FloatArray) -> Regression:
    """Return the regression of values on columns, with AR(1) errors.

    The coefficient is that of the residuals with its small-sample bias, at most 0.95, in three
    rounds (Prais and Winsten 1954).

    Parameters
    ----------
    columns : (n, m) float, n > m.
    values : (n,) float.
    """
    n, m = columns.shape
    autocorrelation = 0.0
    for _ in range(_ROUNDS):
        white_columns, white = (_whiten(a, autocorrelation) for a in (columns, values))
        normal = np.linalg.inv(white_columns.T @ white_columns)
        coefficients = normal @ (white_columns.T @ white)
        residuals = values - columns @ coefficients
        squares = float(residuals @ residuals)
        before = autocorrelation
        if squares > 0.0:
            lagged = float(residuals[1:] @ residuals[:-1]) / squares
            autocorrelation = min(max(lagged + (1.0 + 3.0 * _USUAL) / n, 0.0), _MOST)
    errors = _whiten(values, before) - white_columns @ coefficients
    variance = float(errors @ errors) / (n - m)
    sd = float(np.sqrt(squares / (n - m)))
    return Regression(coefficients, normal * variance, autocorrelation, sd)


def extrapolate(
    x: FloatArray,
    values: FloatArray,
    place: float,
    degree: int,
    *,
    autocorrelation: float,
    sd: float,
) -> tuple[float, float]:
    """Return the value at a place of a polynomial near values, and its standard uncertainty.

    Parameters
    ----------
    x, values : (n,) float, n > degree, in order.
    autocorrelation, sd : of the values' AR(1) errors, which so few of them do not tell.
    """
    distance = (x - place) / np.ptp(x)
    weights = np.linalg.pinv(np.vander(distance, degree + 1, increasing=True))[0]
    order = np.arange(len(x))
    correlation = autocorrelation ** np.abs(order[:, None] - order)
    return float(weights @ values), sd * float(np.sqrt(weights @ correlation @ weights))


def _whiten(rows: FloatArray, autocorrelation: float) -> FloatArray:
    """Return rows less what they remember of the row before."""
    first = rows[:1] * np.sqrt(1.0 - autocorrelation**2)
    return np.concatenate([first, rows[1:] - autocorrelation * rows[:-1]])
