"""Tests reduced to normal equations: readings are looked at once, whatever scatters.

Noise, nuisances and the random part of wear are integrated here; what is left of a test speaks of
its fitted keys alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.model.noise import NuisanceProjection


@dataclass(frozen=True, eq=False)
class ReducedTest:
    """Normal equations of a test's unknowns, nuisances projected out."""

    #: (m, m) float, ``J' V^-1 J``
    information: FloatArray
    #: (m,) float, ``J' V^-1 z``, of the linearised readings z = y - h + J x
    score: FloatArray
    #: ``z' V^-1 z``
    square: float
    #: log determinants of V, and of the nuisances' normal matrix
    log_volume: float
    log_nuisances: float = 0.0


def with_fixed(test: ReducedTest, values: Mapping[int, float]) -> ReducedTest:
    """Return the normal equations of the other unknowns, where some have values, by number."""
    if not values:
        return test
    fixed = list(values)
    free = [j for j in range(len(test.score)) if j not in values]
    at, across = np.array([values[j] for j in fixed]), test.information[np.ix_(free, fixed)]
    square = test.square - 2.0 * at @ test.score[fixed]
    square += at @ test.information[np.ix_(fixed, fixed)] @ at
    return replace(
        test, information=test.information[np.ix_(free, free)],
        score=test.score[free] - across @ at, square=float(square),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class LinearisedTest:
    """A test linearised at its unknowns x, in units of its noise and without its correlation."""

    #: (n,) float, z = y - h(x) + J x
    readings: FloatArray
    #: (n, m) float, J
    jacobian: FloatArray
    #: (n, c) float, what unit nuisances add to the readings
    nuisances: FloatArray
    #: (r, c) and (r,) float, the nuisances' priors in units of their sd
    prior_rows: FloatArray
    prior_values: FloatArray
    #: log determinant of the noise's covariance
    log_volume: float
    #: (n, n) float of each body whose wear is random: the covariance that this adds, for a size of
    #: 1 mm
    process: tuple[FloatArray, ...] = ()

    @property
    def nuisance_projection(self) -> NuisanceProjection:
        """Least squares over the nuisances, of the readings and then the priors."""
        return NuisanceProjection(np.concatenate([self.nuisances, self.prior_rows]))


def uncorrelated(test: LinearisedTest, sizes: FloatArray) -> tuple[LinearisedTest, FloatArray]:
    """Return a test in units of all its noise, that of its wear, of sizes in mm, included.

    Without process; and the matrix (n, n) that its rows were multiplied by.
    """
    covariance = np.eye(len(test.readings))
    for size, kernel in zip(sizes, test.process, strict=True):
        covariance += size * kernel
    factor = np.linalg.cholesky(covariance)
    inverse = solve_triangular(factor, np.eye(len(factor)), lower=True)
    volume = test.log_volume + 2.0 * float(np.log(np.diag(factor)).sum())
    return replace(
        test, readings=inverse @ test.readings, jacobian=inverse @ test.jacobian,
        nuisances=inverse @ test.nuisances, log_volume=volume,
        process=tuple(inverse @ kernel @ inverse.T for kernel in test.process),
    ), inverse  # fmt: skip


def reduce_test(test: LinearisedTest, sizes: FloatArray | None = None) -> list[ReducedTest]:
    """Return the normal equations of a test at each size (G, bodies) mm of the noise of its wear.

    Nuisances are integrated: those without a prior as if it were infinitely wide.
    """
    if sizes is None or not test.process:
        return [_reduce(test, np.zeros(len(test.readings)))]
    reduced: list[ReducedTest | None] = [None] * len(sizes)
    # one decomposition makes the covariances of all sizes of the first body diagonal
    for other_sizes in np.unique(sizes[:, 1:], axis=0):
        alone = uncorrelated(test, np.append(0.0, other_sizes))[0] if other_sizes.any() else test
        variances, vectors = np.linalg.eigh(alone.process[0])
        variances = np.maximum(variances, 0.0)
        turned = replace(
            alone, readings=vectors.T @ alone.readings, jacobian=vectors.T @ alone.jacobian,
            nuisances=vectors.T @ alone.nuisances,
        )  # fmt: skip
        for i in np.flatnonzero((sizes[:, 1:] == other_sizes).all(axis=1)):
            reduced[i] = _reduce(turned, sizes[i, 0] * variances)
    return [one for one in reduced if one is not None]


def _reduce(test: LinearisedTest, variances: FloatArray) -> ReducedTest:
    """Return the normal equations of a test whose readings have more, uncorrelated variances."""
    m, root = test.jacobian.shape[1], np.sqrt(1.0 + variances)[:, None]
    rows = np.column_stack([test.readings, test.jacobian, test.nuisances]) / root
    no_keys = np.zeros((len(test.prior_values), m))
    priors = np.column_stack([test.prior_values, no_keys, test.prior_rows])
    scaled = np.concatenate([rows, priors])
    projection = NuisanceProjection(scaled[:, 1 + m :])
    rest = projection.rest(scaled[:, : 1 + m])
    products = rest.T @ rest
    return ReducedTest(
        products[1:, 1:], products[1:, 0], float(products[0, 0]),
        test.log_volume + float(np.log1p(variances).sum()), projection.log_volume,
    )  # fmt: skip
