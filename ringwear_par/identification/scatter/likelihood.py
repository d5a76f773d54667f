"""The likelihood of the sizes of scatter, and of the values of a material, from reduced tests.

Readings are looked at once, whatever scatters: noise, nuisances and the random part of wear are
integrated as tests are reduced to normal equations of their keys.

Every test has unknowns of its own, ``x_i = beta + sum over levels of tau u_group``, with u standard
normal for each group of a level (specimen, batch, laboratory). Linearised at its present x_i, a
test says of them no more than its normal equations. Lindstrom and Bates (1990), Biometrics 46,
673-687.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.identification.model.noise import NuisanceProjection, mills_ratio

#: of factors that stand for limits: most sweeps, share of a move, and moves that are none; least
#: share of a variance, for round-off
_MOST_SWEEPS, _DAMPED, _STILL, _LEAST = 60, 0.7, 1e-6, 1e-9


@dataclass(frozen=True, eq=False)
class Limits:
    """Readings of a test that are mere limits: with probability Phi(a + J x) these hold."""

    #: (l,) float, a
    offsets: FloatArray
    #: (l, m) float, J
    jacobian: FloatArray


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
    limits: Limits | None = None


def with_fixed(test: ReducedTest, values: Mapping[int, float]) -> ReducedTest:
    """Return the normal equations of the other unknowns, where some have values, by number."""
    if not values:
        return test
    fixed = list(values)
    free = [j for j in range(len(test.score)) if j not in values]
    at, across = np.array([values[j] for j in fixed]), test.information[np.ix_(free, fixed)]
    square = test.square - 2.0 * at @ test.score[fixed]
    square += at @ test.information[np.ix_(fixed, fixed)] @ at
    limits = test.limits
    if limits is not None:
        rows = limits.jacobian
        limits = Limits(limits.offsets + rows[:, fixed] @ at, rows[:, free])
    return replace(
        test, information=test.information[np.ix_(free, free)],
        score=test.score[free] - across @ at, square=float(square), limits=limits,
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
    #: beside these readings; None: there are none
    limits: Limits | None = None

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
    return [test_at_size for test_at_size in reduced if test_at_size is not None]


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
        test.log_volume + float(np.log1p(variances).sum()), projection.log_volume, test.limits,
    )  # fmt: skip


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
    #: (G,) bool, whether the factors that stand for limits have settled
    settled: BoolArray


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
        limited = [(i, test.limits) for i, test in enumerate(tests) if test.limits is not None]
        #: (l, m + groups) and (l,) of all limits, by the effects from the centre on
        self._limit_rows = np.zeros((0, size))
        if limited:
            self._limit_rows = np.vstack([of.jacobian @ self.columns(i) for i, of in limited])
            self._limit_offsets = np.concatenate(
                [of.offsets + of.jacobian @ self._centre for _, of in limited]
            )

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
        beyond, settled = np.zeros(len(tau)), np.ones(len(tau), dtype=bool)
        if len(self._limit_rows):
            beyond, settled = self._add_limits(hessian, right, scale)
        factor = np.linalg.cholesky(hessian)
        inverse = np.linalg.inv(factor)
        covariance = np.swapaxes(inverse, 1, 2) @ inverse
        reduced = np.einsum("gij,gj->gi", inverse, right)
        square = self._constant - (reduced**2).sum(axis=1) + beyond
        effects = np.einsum("gji,gj->gi", inverse, reduced)
        effects[:, :m] += self._centre
        log_determinant = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        groups = np.linalg.slogdet(hessian[:, m:, m:])[1]
        restricted = square + log_determinant + self._log_nuisances
        return Solutions(tau, effects, covariance, restricted, square + groups, settled)

    def _add_limits(
        self, hessian: FloatArray, right: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Add what limits say to the normal equations; return their share of -2 log likelihood.

        A limit cuts the distribution of what it is of, which scatters by more than its noise: its
        mode says little. Each is replaced by the normal factor that has the same moments beside all
        others (expectation propagation; Minka, UAI 17 (2001) 362-369).

        Parameters
        ----------
        hessian, right : (G, m + groups, m + groups) and (G, m + groups), changed in place.
        scale : (G, m + groups), see ``scales``.

        Returns
        -------
        The share, (G,), and whether the factors have settled, (G,).
        """
        rows = scale[:, None, :] * self._limit_rows
        precision, shift = np.zeros((2, *rows.shape[:2]))
        for _ in range(_MOST_SWEEPS):
            whole = hessian + np.einsum("gli,gl,glj->gij", rows, precision, rows, optimize=True)
            covariance = np.linalg.inv(whole)
            across = np.einsum("gli,gij->glj", rows, covariance)
            mean = np.einsum("gli,gi->gl", across, right + np.einsum("gl,gli->gi", shift, rows))
            variance = np.einsum("gli,gli->gl", across, rows)
            # without the limit itself
            cavity_variance = 1.0 / np.maximum(1.0 / variance - precision, _LEAST / variance)
            cavity_shift = mean / variance - shift
            cavity_mean = cavity_variance * cavity_shift
            root = np.sqrt(1.0 + cavity_variance)
            z = (self._limit_offsets + cavity_mean) / root
            ratio = mills_ratio(z)
            cut_mean = cavity_mean + cavity_variance * ratio / root
            lost = cavity_variance * ratio * (z + ratio) / (1.0 + cavity_variance)
            cut = cavity_variance * np.maximum(1.0 - lost, _LEAST)
            new = 1.0 / cut - 1.0 / cavity_variance
            move = _DAMPED * (new - precision)
            precision = precision + move
            shift = shift + _DAMPED * (cut_mean / cut - cavity_shift - shift)
            settled = (np.abs(move) < _STILL * (1.0 / variance + new)).all(axis=1)
            if settled.all():
                break
        hessian += np.einsum("gli,gl,glj->gij", rows, precision, rows, optimize=True)
        right += np.einsum("gl,gli->gi", shift, rows)
        factor = (cavity_shift + shift) ** 2 / (1.0 / cavity_variance + precision)
        factor -= cavity_shift * cavity_mean
        log_factor = 0.5 * (factor - np.log1p(precision * cavity_variance))
        return -2.0 * (log_ndtr(z) - log_factor).sum(axis=1), settled


def of_new_specimen(information: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the information (m, m) on the material in a test of one more specimen.

    Its readings have some on its own values, which scatter about the material's by variances (m,).
    """
    scattering = variances > 0.0
    if not scattering.any():
        return information
    columns = information[:, scattering]
    inner = np.diag(1.0 / variances[scattering]) + columns[scattering]
    return information - columns @ np.linalg.solve(inner, columns.T)
