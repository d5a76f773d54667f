"""The likelihood of the sizes of scatter, and of the values of a material, from reduced tests.

Every test has unknowns of its own, ``x_i = beta + sum over levels of tau u_group``, with u standard
normal for each group of a level (specimen, batch, laboratory). Linearised at its present x_i, a
test says of them no more than its normal equations. Lindstrom and Bates (1990), Biometrics 46,
673-687.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.scatter.reduction import ReducedTest


@dataclass(frozen=True, eq=False)
class Level:
    """A level at which a key scatters: each group has a deviation of its own."""

    #: number of the key among the unknowns
    key: int
    #: "specimen", "batch" or "lab"
    name: str
    #: (tests,) int, the group of each test, from 0
    group: IntArray

    @property
    def count(self) -> int:
        """Number of the groups."""
        return int(self.group.max()) + 1


@dataclass(frozen=True, eq=False)
class Solutions:
    """Solutions of the linear mixed model at G sizes of its scatters."""

    #: (G, levels) float, sizes of the scatters, in the unit of the unknowns
    tau: FloatArray
    #: (G, m + groups) float: beta, then u of all groups of all levels
    effects: FloatArray
    #: (G, m + groups, m + groups) float, of the effects
    covariance: FloatArray
    #: (G,) float, -2 log likelihood of the readings, but for a constant: with beta and nuisances
    #: integrated, and at their best
    restricted: FloatArray
    marginal: FloatArray


class MixedModel:
    """The linear mixed model of reduced tests.

    Parameters
    ----------
    tests : one at least.
    levels : of all keys that scatter.
    prior_precision : (m,) float, of the unknowns of the material; 0 where there is no prior.
    prior_mean : (m,) float.

    Attributes
    ----------
    precision : (m + groups,) float, of the priors of all effects.
    """

    def __init__(
        self,
        tests: Sequence[ReducedTest],
        levels: Sequence[Level],
        prior_precision: FloatArray,
        prior_mean: FloatArray,
    ) -> None:
        self.levels, self.m = tuple(levels), len(prior_mean)
        self.offsets = self.m + np.concatenate([[0], np.cumsum([v.count for v in levels])]).astype(
            int
        )
        size = int(self.offsets[-1])
        self.precision = np.concatenate([prior_precision, np.ones(size - self.m)])
        information = sum(test.information for test in tests) + np.diag(prior_precision)
        score = sum(test.score for test in tests) + prior_precision * prior_mean
        #: (m,) which unknowns are counted from: what tests know well is far from 0 in their sd, and
        #: sums of squares from there would leave no digits
        self._centre: FloatArray = np.linalg.lstsq(information, score, rcond=None)[0]
        self._normal, self._right = np.zeros((size, size)), np.zeros(size)
        self._constant = 0.0
        for i, test in enumerate(tests):
            columns, at = self.columns(i), test.information @ self._centre
            self._normal += columns.T @ test.information @ columns
            self._right += columns.T @ (test.score - at)
            self._constant += test.square + test.log_volume
            self._constant -= float(self._centre @ (2.0 * test.score - at))
        off = prior_mean - self._centre
        self._prior_right = np.zeros(size)
        self._prior_right[: self.m] = prior_precision * off
        self._constant += float(prior_precision @ off**2)
        self._log_nuisances = sum(test.log_nuisances for test in tests)

    def columns(self, test: int) -> FloatArray:
        """Return (m, m + groups) what unit effects are in the unknowns of a test, at tau = 1."""
        columns = np.zeros((self.m, int(self.offsets[-1])))
        columns[:, : self.m] = np.eye(self.m)
        for level, offset in zip(self.levels, self.offsets, strict=False):
            columns[level.key, offset + level.group[test]] = 1.0
        return columns

    def scales(self, tau: FloatArray) -> FloatArray:
        """Return (G, m + groups) by which effects are multiplied at tau (G, levels)."""
        counts = [level.count for level in self.levels]
        return np.concatenate([np.ones((len(tau), self.m)), np.repeat(tau, counts, axis=1)], axis=1)

    def solve(self, tau: FloatArray) -> Solutions:
        """Return the solutions at sizes (G, levels) of the scatters.

        Raises
        ------
        numpy.linalg.LinAlgError : the tests and priors together do not determine the material.
        """
        scale, m = self.scales(tau), self.m
        hessian = scale[:, :, None] * self._normal * scale[:, None, :]
        diagonal = np.arange(len(self._right))
        hessian[:, diagonal, diagonal] += self.precision
        right = scale * self._right + self._prior_right
        factor = np.linalg.cholesky(hessian)
        inverse = np.linalg.inv(factor)
        covariance = np.swapaxes(inverse, 1, 2) @ inverse
        reduced = np.einsum("gij,gj->gi", inverse, right)
        square = self._constant - (reduced**2).sum(axis=1)
        effects = np.einsum("gji,gj->gi", inverse, reduced)
        effects[:, :m] += self._centre
        log_determinant = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        groups = np.linalg.slogdet(hessian[:, m:, m:])[1]
        restricted = square + log_determinant + self._log_nuisances
        return Solutions(tau, effects, covariance, restricted, square + groups)


def of_new_specimen(information: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the information (m, m) on the material in a test of one more specimen.

    Parameters
    ----------
    information : (m, m) float, that of its readings on its own values.
    variances : (m,) float, by which these scatter about the material's.
    """
    scattering = variances > 0.0
    if not scattering.any():
        return information
    columns = information[:, scattering]
    inner = np.diag(1.0 / variances[scattering]) + columns[scattering]
    reduced: FloatArray = information - columns @ np.linalg.solve(inner, columns.T)
    return reduced
