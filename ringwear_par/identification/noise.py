"""Noise of readings: correlated in time, with long tails, and random wear.

A residual is a reading less the model's over its sd; ``whitened`` takes out what neighbours share.
"""

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import Series

#: degrees of freedom of the loss "student"
_NU = 4.0
#: Fisher information of such noise over that of normal noise
STUDENT = (_NU + 1.0) / (_NU + 3.0)


def whitened(series: Series, rows: FloatArray) -> FloatArray:
    """Return rows (n, ...) of a series over its sd, AR(1), uncorrelated in time."""
    if not series.correlation_time or series.n < 2:
        return rows
    steps = (np.diff(series.x) / series.correlation_time).reshape(-1, *(1,) * (rows.ndim - 1))
    rest = (rows[1:] - np.exp(-steps) * rows[:-1]) / np.sqrt(-np.expm1(-2.0 * steps))
    return np.concatenate([rows[:1], rest])


def coloured(series: Series, white: FloatArray) -> FloatArray:
    """Return rows (n, ...) that ``whitened`` makes white."""
    if not series.correlation_time or series.n < 2:
        return white
    rows = white.copy()
    for i, step in enumerate((np.diff(series.x) / series.correlation_time).tolist(), start=1):
        rows[i] = np.exp(-step) * rows[i - 1] + np.sqrt(-np.expm1(-2.0 * step)) * white[i]
    return rows


def log_volume(series: Series) -> float:
    """Return the logarithm of the factor that ``whitened`` divides volumes by."""
    if not series.correlation_time or series.n < 2:
        return 0.0
    steps = np.diff(series.x) / series.correlation_time
    return float(0.5 * np.log(-np.expm1(-2.0 * steps)).sum())


def student_weights(residuals: FloatArray) -> FloatArray:
    """Return weights (n,) by which normal noise stands for that of the loss "student".

    Those of the squares in its steps, times its Fisher information over that of normal noise.
    """
    return (_NU + 1.0) / (_NU + residuals * residuals) * STUDENT
