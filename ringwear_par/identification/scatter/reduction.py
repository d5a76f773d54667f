"""Tests reduced to normal equations: readings are looked at once, whatever scatters.

Noise, nuisances and the random part of wear are integrated here; what is left of a test speaks of
its fitted keys alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class ReducedTest:
    """What the readings of a test say of its unknowns: normal equations, nuisances projected out.

    Parameters
    ----------
    information : (m, m) float, ``J' V^-1 J``.
    score : (m,) float, ``J' V^-1 z``, of the linearised readings z = y - h + J x.
    square : ``z' V^-1 z``.
    log_volume : log determinant of V, and of the normal matrix of free nuisances.
    """

    information: FloatArray
    score: FloatArray
    square: float
    log_volume: float


@dataclass(frozen=True, eq=False)
class LinearisedTest:
    """A test linearised at its unknowns x, in units of its noise and without its correlation.

    Parameters
    ----------
    readings : (n,) float, z = y - h(x) + J x.
    jacobian : (n, m) float, J.
    nuisances : (n, c) float, what unit nuisances add to the readings.
    prior_rows : (r, c) float, of the nuisances' priors, in units of their sd.
    prior_values : (r,) float.
    log_volume : log determinant of the noise's covariance and of the nuisances' priors.
    process : (n, n) float, covariance of what the random part of wear adds, for a size of 1 mm;
        None without.
    """

    readings: FloatArray
    jacobian: FloatArray
    nuisances: FloatArray
    prior_rows: FloatArray
    prior_values: FloatArray
    log_volume: float
    process: FloatArray | None = None


def reduce_test(test: LinearisedTest, sizes: Sequence[float] = (0.0,)) -> tuple[ReducedTest, ...]:
    """Return the normal equations of a test at each size of the random part of its wear.

    Nuisances are integrated: those without a prior as if it were infinitely wide.

    Parameters
    ----------
    sizes : mm, of the process noise; all 0 where the test has none.

    Raises
    ------
    numpy.linalg.LinAlgError : nuisances that readings and priors do not determine.
    """
    n = len(test.readings)
    rows = np.column_stack([test.readings, test.jacobian, test.nuisances])
    variances = np.zeros(n)
    if test.process is not None:
        # one decomposition makes the covariances of all sizes diagonal
        variances, vectors = np.linalg.eigh(test.process)
        variances, rows = np.maximum(variances, 0.0), vectors.T @ rows
    m = test.jacobian.shape[1]
    priors = np.column_stack(
        [test.prior_values, np.zeros((len(test.prior_values), m)), test.prior_rows]
    )
    return tuple(
        _reduce(rows, priors, 1.0 + size * variances, m, test.log_volume) for size in sizes
    )


def _reduce(
    rows: FloatArray, priors: FloatArray, variances: FloatArray, m: int, log_volume: float
) -> ReducedTest:
    """Return the normal equations of uncorrelated rows: readings, m keys, then the nuisances."""
    scaled = np.concatenate([rows / np.sqrt(variances)[:, None], priors])
    log_volume += float(np.log(variances).sum())
    wanted, nuisances = scaled[:, : 1 + m], scaled[:, 1 + m :]
    if nuisances.shape[1]:
        basis, triangle = np.linalg.qr(nuisances)
        diagonal = np.abs(np.diag(triangle))
        if diagonal.min() <= np.finfo(float).eps * len(scaled) * diagonal.max():
            raise np.linalg.LinAlgError("nuisances are not determined")
        log_volume += 2.0 * float(np.log(diagonal).sum())
        wanted = wanted - basis @ (basis.T @ wanted)
    products = wanted.T @ wanted
    return ReducedTest(products[1:, 1:], products[1:, 0], float(products[0, 0]), log_volume)
