"""How probable readings are beside the model: correlated noise, the losses, nuisances.

A residual is a reading less the model's over its noise, without correlation (``whitened``). Each
loss is what a residual adds to twice the negative logarithm of the likelihood, but for a constant.
``NuisanceProjection`` leaves of residuals and their derivatives what nuisances cannot make. Other
distributions of noise belong here.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import lsq_linear
from scipy.special import erfcx, gammaln, log_ndtr

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import Loss, Prior, Series

#: degrees of freedom of the loss "student"
_NU = 4.0
#: singular value of nuisances, over the largest, below which they are not distinct
_DEPENDENT = 1e-10


def whitened(series: Series, rows: FloatArray) -> FloatArray:
    """Return rows (n, ...) of a series in units of its noise, AR(1), uncorrelated in time."""
    if not series.correlation_time or series.n < 2:
        return rows
    steps = (np.diff(series.x) / series.correlation_time).reshape(-1, *(1,) * (rows.ndim - 1))
    rest = (rows[1:] - np.exp(-steps) * rows[:-1]) / np.sqrt(-np.expm1(-2.0 * steps))
    return np.concatenate([rows[:1], rest])


def log_volume(series: Series) -> float:
    """Return the logarithm of the factor that ``whitened`` divides volumes by."""
    if not series.correlation_time or series.n < 2:
        return 0.0
    steps = np.diff(series.x) / series.correlation_time
    return float(0.5 * np.log(-np.expm1(-2.0 * steps)).sum())


def student_loss(residuals: FloatArray) -> FloatArray:
    """Return the loss "student" of residuals (n,)."""
    return (_NU + 1.0) * np.log1p(residuals * residuals / _NU)


def student_weights(residuals: FloatArray) -> FloatArray:
    """Return the weights (n,) of squares that make steps of the loss "student"."""
    return (_NU + 1.0) / (_NU + residuals * residuals)


def loss_roots(loss: Loss, residuals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the square roots (n,) of the loss, with the residuals' signs, and their derivative."""
    if loss == "gaussian":
        return residuals, np.ones(len(residuals))
    roots = np.sign(residuals) * np.sqrt(student_loss(residuals))
    small = np.abs(residuals) < 1e-6
    square = residuals * residuals
    slope = (_NU + 1.0) * residuals / ((_NU + square) * np.where(small, 1.0, roots))
    return roots, np.where(small, np.sqrt((_NU + 1.0) / _NU), slope)


def mills_ratio(z: FloatArray) -> FloatArray:
    """Return the standard normal density at z over the probability below z, to round-off."""
    ratio: FloatArray = np.sqrt(2.0 / np.pi) / erfcx(-z / np.sqrt(2.0))
    return ratio


def censored_rows(
    side: IntArray, residuals: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return rows in the place of readings (n,) that are limits of normal distributions.

    The residual with the same gradient and curvature, and the factor of its derivatives; the square
    root of twice the negative log likelihood, and its derivative. ``side`` is -1 where the true
    value is at most the reading, 1 where at least; residuals are of the model less the limit, over
    the noise.
    """
    t = side * residuals
    log_probability, ratio = log_ndtr(t), mills_ratio(t)
    curvature = np.sqrt(np.maximum(ratio * (ratio + t), 0.0))
    root = np.sqrt(np.maximum(-2.0 * log_probability, 0.0))
    # both vanish where the model is far on the right side
    over_curvature, over_root = (
        np.divide(ratio, divisor, out=np.zeros_like(ratio), where=divisor > 0.0)
        for divisor in (curvature, root)
    )
    return -side * over_curvature, curvature, -side * root, over_root


def weights(loss: Loss, residuals: FloatArray) -> FloatArray:
    """Return how much each reading (n,) counts for its series' scatter."""
    return np.ones(len(residuals)) if loss == "gaussian" else student_weights(residuals)


def log_constant(loss: Loss) -> float:
    """Return the part of the negative logarithm of a reading's likelihood that never changes."""
    if loss == "gaussian":
        return float(0.5 * np.log(2.0 * np.pi))
    return float(0.5 * np.log(_NU * np.pi) + gammaln(_NU / 2.0) - gammaln((_NU + 1.0) / 2.0))


def information_share(loss: Loss) -> float:
    """Return the Fisher information of a reading under a loss, over that of Gaussian noise."""
    return (_NU + 1.0) / (_NU + 3.0) if loss == "student" else 1.0


def prior_rows(priors: Sequence[tuple[int, Prior]], count: int) -> tuple[FloatArray, FloatArray]:
    """Return rows (r, count) and values (r,) of priors of some of so many numbers, by their sd."""
    rows = np.zeros((len(priors), count))
    for row, (number, prior) in zip(rows, priors, strict=True):
        row[number] = 1.0 / prior.sd
    return rows, np.array([prior.mean / prior.sd for _, prior in priors])


def bounded_solution(
    columns: FloatArray, right: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return the numbers (k,) within bounds by which columns (n, k) come nearest to values (n,)."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0  # one that does nothing
    return lsq_linear(columns / size, right, (low * size, high * size)).x / size


class NuisanceProjection:
    """Least squares with linear nuisances eliminated; nuisances that do the same count once.

    Columns C (n, k) are what a unit of each nuisance adds to residuals y (n,). With C = U S V' and
    P = 1 - U U', y = P y + U U' y are orthogonal parts, of which C b can only cancel the second:
    the least ||y - C b|| is ||P y||, for b = V S^-1 U' y. What y says of other unknowns with
    columns J is therefore in P y and P J: (P J)'(P J) = J'J - J'C (C'C)^+ C'J is their information.
    """

    def __init__(self, columns: FloatArray) -> None:
        size = np.linalg.norm(columns, axis=0)
        self._size = np.where(size > 0.0, size, 1.0)  # one that does nothing
        basis, values, right = np.linalg.svd(columns / self._size, full_matrices=False)
        independent = values > _DEPENDENT * values.max(initial=0.0)
        self._basis, self._values = basis[:, independent], values[independent]
        self._right = right[: len(self._values)]

    @property
    def log_volume(self) -> float:
        """Logarithm of the determinant of the normal matrix of those that do something."""
        return float(2.0 * (np.log(self._values).sum() + np.log(self._size).sum()))

    @property
    def leverage(self) -> FloatArray:
        """(n,) share of each residual that nuisances take away."""
        return np.einsum("ij,ij->i", self._basis, self._basis)

    def rest(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) less the part that nuisances explain, P rows."""
        return rows - self._basis @ (self._basis.T @ rows)

    def solution(self, residuals: FloatArray) -> FloatArray:
        """Return the nuisances (k,) that fit residuals (n,) best, b."""
        solution: FloatArray = self._right.T @ ((self._basis.T @ residuals) / self._values)
        return solution / self._size
