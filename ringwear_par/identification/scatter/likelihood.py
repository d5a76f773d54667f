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
    """The linear mixed model of reduced tests, one at least.

    Priors of the material's unknowns have a precision and a mean (m,), 0 for none; ``precision`` (m
    + groups,) is of the priors of all effects.
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
        self._normal, self._right = np.zeros((size, size)), np.zeros(size)
        for i, test in enumerate(tests):
            columns = self.columns(i)
            self._normal += columns.T @ test.information @ columns
            self._right += columns.T @ test.score
        self.precision = np.concatenate([prior_precision, np.ones(size - self.m)])
        self._prior_right = np.zeros(size)
        self._prior_right[: self.m] = prior_precision * prior_mean
        self._constant = sum(test.square + test.log_volume for test in tests) + float(
            prior_precision @ prior_mean**2
        )
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

        LinAlgError where the tests and priors together do not determine the material.
        """
        scale, m = self.scales(tau), self.m
        hessian = scale[:, :, None] * self._normal * scale[:, None, :]
        diagonal = np.arange(len(self._right))
        hessian[:, diagonal, diagonal] += self.precision
        right = scale * self._right + self._prior_right
        factor = np.linalg.cholesky(hessian)
        inverse = np.linalg.inv(factor)
        covariance = np.swapaxes(inverse, 1, 2) @ inverse
        effects = np.einsum("gij,gj->gi", covariance, right)
        square = self._constant - np.einsum("gi,gi->g", right, effects)
        log_determinant = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        groups = np.linalg.slogdet(hessian[:, m:, m:])[1]
        restricted = square + log_determinant + self._log_nuisances
        return Solutions(tau, effects, covariance, restricted, square + groups)


def of_new_specimen(information: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the information (m, m) on the material in a test of one more specimen.

    Its readings have some on its own values, which scatter about the material's by variances (m,).
    """
    scattering = variances > 0.0
    if not scattering.any():
        return information
    columns = information[:, scattering]
    inner = np.diag(1.0 / variances[scattering]) + columns[scattering]
    reduced: FloatArray = information - columns @ np.linalg.solve(inner, columns.T)
    return reduced
