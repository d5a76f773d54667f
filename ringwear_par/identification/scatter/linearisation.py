"""Tests of a fit linearised at their own values of the keys, and the clocks of random wear.

All series of a test share the clock of a body's wear, its mean worn depth S, which grows in
increments of variance size times dS. If a body has worn a millimetre more than its mean at S_i, the
reading there changes by g_i, so that two readings have a covariance of size g_i g_j min(S_i, S_j).
Long records are averaged in blocks for it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.noise import log_volume, prior_rows, weights, whitened
from ringwear_par.identification.scatter.likelihood import (
    Limits,
    LinearisedTest,
    ReducedTest,
    reduce_test,
    uncorrelated,
)

#: most readings of a series that is not averaged; longer ones are, in as many blocks of equal time
MOST_READINGS = 500
#: weight of a reading without one, instead of 0
_NO_WEIGHT = 1e-12


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of readings that are averaged, by their weights in units of noise."""

    #: (blocks,) number of the first reading of each
    first: IntArray
    #: (n,) float, of each reading; the squares of a block sum to 1
    share: FloatArray

    @classmethod
    def of(cls, series: Series, sd: FloatArray) -> "Blocks":
        """Return the blocks of a series with noise (n,): one of each reading, or 500 in all."""
        if series.n <= MOST_READINGS:
            return cls(np.arange(series.n), np.ones(series.n))
        reach = float(np.ptp(series.x)) or 1.0
        number = np.floor((series.x - series.x.min()) / reach * MOST_READINGS)
        number = np.minimum(number, MOST_READINGS - 1)
        for low, _ in series.excluded:  # no block on both sides of one
            number += MOST_READINGS * (series.x > low)
        if series.correlation_time:  # the first reading alone tells the level
            number[0] = -0.5
        first = np.flatnonzero(np.diff(number, prepend=-1.0))
        size = np.sqrt(np.add.reduceat(sd**-2, first))
        counts = np.diff(np.append(first, series.n))
        return cls(first, 1.0 / sd / np.repeat(size, counts))

    @property
    def counts(self) -> IntArray:
        """(blocks,) readings of each."""
        return np.diff(np.append(self.first, len(self.share)))

    def combine(self, rows: FloatArray) -> FloatArray:
        """Return the blocks' rows of readings' (n, ...), both in units of their noise."""
        share = self.share.reshape(-1, *(1,) * (rows.ndim - 1))
        return np.add.reduceat(share * rows, self.first, axis=0)


class _Responses(NamedTuple):
    """How blocks respond to the clock of a body, in units of noise without its correlation.

    That is the same whatever the clock does between the ends of blocks, but for a variance.
    """

    #: (b,) mm, depths at the ends of the block before and of its own
    low: FloatArray
    high: FloatArray
    #: (b,) a mm: to what is worn too much until low, and within the block
    before: FloatArray
    within: FloatArray
    #: (b,) variance by what the clock does within the block, for a size of 1 mm
    between: FloatArray

    def of_growth(self, at_low: FloatArray, at_high: FloatArray) -> FloatArray:
        """Return the responses to clocks (..., b) at low and high."""
        return self.before * at_low + self.within * (at_high - at_low)

    def covariance(self, points: FloatArray) -> FloatArray:
        """Return the covariance (b, p) of blocks and the clock at depths (p,), size 1 mm."""
        ends = (np.minimum.outer(points, end) for end in (self.low, self.high))
        return self.of_growth(*ends).T


def _responses(
    series: Series, blocks: Blocks, roots: FloatArray, answer: FloatArray, depth: FloatArray
) -> _Responses:
    """Return how the blocks of a series respond to a clock, of readings' roots and depths (n,).

    The answer (n,) is that of a reading over its noise, a mm.
    """
    last = blocks.first + blocks.counts - 1
    low, high = depth[np.maximum(blocks.first - 1, 0)], depth[last]
    white = roots[:, None] * whitened(series, np.column_stack([answer, answer * depth]))
    before, by_depth = blocks.combine(white).T
    grown = high - low
    within = np.divide(by_depth - before * low, grown, out=before.copy(), where=grown > 0.0)
    # a step of the clock is in its own reading, not in the one before, and in all later ones
    even = np.arange(series.n) % 2 == 0
    present = whitened(series, answer * even) * even + whitened(series, answer * ~even) * ~even
    following = np.cumsum(blocks.share * white[:, 0])
    steps = np.repeat(following[last], blocks.counts) - following + blocks.share * roots * present
    uneven = (steps - np.repeat(within, blocks.counts)) ** 2 * np.diff(depth, prepend=depth[0])
    return _Responses(low, high, before, within, np.add.reduceat(uneven, blocks.first))


class TestClocks:
    """The clocks of a test's bodies, and its readings in blocks.

    Of readings (n,) of all series: their noise, and roots of the weights by the loss; (n, bodies):
    their change a mm worn too much, and the mean worn depth, mm.
    """

    def __init__(
        self,
        series: Sequence[Series],
        sd: FloatArray,
        roots: FloatArray,
        answers: FloatArray,
        depths: FloatArray,
    ) -> None:
        ends = np.cumsum([0, *(record.n for record in series)]).tolist()
        self._parts = [slice(low, high) for low, high in itertools.pairwise(ends)]
        self._depths = depths
        self._blocks = [
            Blocks.of(record, sd[part] / roots[part])
            for record, part in zip(series, self._parts, strict=True)
        ]
        self._ends = np.cumsum([len(blocks.first) for blocks in self._blocks])[:-1]
        self._responses = []
        for answer, depth in zip((answers / sd[:, None]).T, depths.T, strict=True):
            columns = [
                _responses(record, blocks, roots[part], answer[part], depth[part])
                for record, blocks, part in zip(series, self._blocks, self._parts, strict=True)
            ]
            self._responses.append(_Responses(*map(np.concatenate, zip(*columns, strict=True))))

    def combine(self, rows: FloatArray) -> FloatArray:
        """Return the rows of blocks of those (n, ...) of readings, both in units of noise."""
        return np.concatenate(
            [
                blocks.combine(rows[part])
                for blocks, part in zip(self._blocks, self._parts, strict=True)
            ]
        )

    def spread(self, values: FloatArray) -> FloatArray:
        """Return values (b,) of blocks, shared out over their readings, (n,)."""
        return np.concatenate(
            [
                np.repeat(part, blocks.counts) * blocks.share**2
                for part, blocks in zip(np.split(values, self._ends), self._blocks, strict=True)
            ]
        )

    @property
    def kernels(self) -> tuple[FloatArray, ...]:
        """(b, b) of each body, covariance of the blocks for a size of 1 mm, in units of noise."""
        kernels = []
        for response in self._responses:
            kernel = response.of_growth(
                response.covariance(response.low), response.covariance(response.high)
            )
            kernels.append(0.5 * (kernel + kernel.T) + np.diag(response.between))
        return tuple(kernels)

    def smoothed(
        self, sizes: FloatArray, rest: FloatArray, precision: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return by how much bodies have worn more than their mean, and its sd, (n, bodies) mm.

        By the sizes (mm) of the process noise; ``rest`` (b,) are readings less model and nuisances,
        in units of noise, times the inverse of their covariance; the precision (b, b) is that
        inverse, less what model and nuisances take.
        """
        excesses, sds = [], []
        for size, response, depth in zip(sizes, self._responses, self._depths.T, strict=True):
            points = np.unique(response.high)
            across = size * response.covariance(points)
            variance = size * points - np.einsum(
                "ij,ik,kj->j", across, precision, across, optimize=True
            )
            sd = np.sqrt(np.maximum(variance, 0.0))
            excesses.append(
                np.interp(depth, np.append(0.0, points), np.append(0.0, across.T @ rest))
            )
            sds.append(np.interp(depth, np.append(0.0, points), np.append(0.0, sd)))
        return np.stack(excesses, axis=1), np.stack(sds, axis=1)


def projected_precision(
    test: LinearisedTest, sizes: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Return the inverse covariance of readings, nuisances' priors after them, all fitted.

    Readings of the best fit are what is left of them times this, (b + r, b + r); sizes of the
    process noise are in mm, the covariance (m, m) is of the unknowns of the keys.
    """
    alone, whitening = uncorrelated(test, sizes)
    n, r = len(test.readings), len(test.prior_rows)
    padded = np.concatenate([alone.jacobian, np.zeros((r, alone.jacobian.shape[1]))])
    projection = alone.nuisance_projection
    root = np.eye(n + r)
    root[:n, :n] = whitening
    by_keys = projection.rest(padded)
    rest = projection.rest(root)
    keys = root.T @ by_keys
    return rest.T @ rest - keys @ covariance @ keys.T


class Linearisation:
    """The tests of a misfit, linearised at x (u,) and (tests, m) unknowns of the keys in each test.

    Nuisances that are at their bounds stay there. The loss weighs readings by the residuals of the
    evaluation or by others, ``weighed`` (n,); ``roots`` (n,) are by what readings are multiplied
    for it, and where they are limits. ``rows`` are of each test among the readings, ``clocks`` of
    each test where wear is random.
    """

    def __init__(
        self,
        misfit: Misfit,
        evaluation: Evaluation,
        x: FloatArray,
        test_unknowns: FloatArray,
        weighed: FloatArray | None = None,
    ) -> None:
        self.misfit, self._evaluation, self._x = misfit, evaluation, x
        self._test_unknowns, self._m = test_unknowns, len(misfit.problem.parameters)
        self._at_bounds: BoolArray = (x <= misfit.lower) | (x >= misfit.upper)
        ends = np.cumsum([experiment.n for experiment in misfit.problem.experiments])
        self.rows = [
            slice(int(end) - experiment.n, int(end))
            for end, experiment in zip(ends, misfit.problem.experiments, strict=True)
        ]
        residuals = evaluation.noise if weighed is None else weighed
        self._roots = np.sqrt(weights(misfit.problem.settings.loss, residuals))
        self.roots = self._roots * evaluation.roots
        self.clocks: list[TestClocks] = []
        if misfit.problem.settings.process:
            answers, depths = misfit.clocks(x, test_unknowns)
            self.clocks = [
                TestClocks(
                    experiment.series, misfit.sd[rows],
                    self.roots[rows] + _NO_WEIGHT, answers[rows], depths[rows],
                )
                for experiment, rows in zip(misfit.problem.experiments, self.rows, strict=True)
            ]  # fmt: skip
        #: of each test
        self.tests = [self._linearised(number) for number in range(len(self.rows))]
        self._reduced: dict[bytes, list[list[ReducedTest]]] = {}

    def reduced(self, sizes: FloatArray | None = None) -> list[list[ReducedTest]]:
        """Return the normal equations of all tests at sizes (G, bodies) mm of the process noise."""
        key = b"" if sizes is None else sizes.tobytes()
        if key not in self._reduced:
            by_test = [reduce_test(test, sizes) for test in self.tests]
            self._reduced[key] = [list(tests) for tests in zip(*by_test, strict=True)]
        return self._reduced[key]

    def nuisances_of(self, test: int) -> list[int]:
        """Return the numbers of a test's unknown nuisances that no bound holds."""
        name = self.misfit.problem.experiments[test].name
        return [
            j
            for j, unknown in enumerate(self.misfit.names)
            if not isinstance(unknown, str) and unknown[0] == name and not self._at_bounds[j]
        ]

    def priors_of(self, nuisances: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the rows and values of the priors of nuisances, in units of their sd."""
        priors = [(nuisances.index(j), p) for j, p in self.misfit.priors if j in nuisances]
        return prior_rows(priors, len(nuisances))

    def _linearised(self, number: int) -> LinearisedTest:
        misfit, rows, nuisances = self.misfit, self.rows[number], self.nuisances_of(number)
        roots = self._roots[rows, None]
        noise = roots[:, 0] * self._evaluation.noise[rows]
        jacobian = roots * self._evaluation.noise_jacobian[rows]
        limits, limited = None, misfit.integrated_limits[rows]
        if limited.any():
            side = (misfit.censored / misfit.sd)[rows][limited]
            above = (self._evaluation.model - misfit.data)[rows][limited]
            slopes = misfit.columns(self._x, self._test_unknowns)[rows][limited, : self._m]
            slopes = side[:, None] * slopes
            limits = Limits(side * above - slopes @ self._test_unknowns[number], slopes)
            noise[limited], jacobian[limited] = 0.0, 0.0
        records = [r for r in misfit.records if r.experiment is misfit.problem.experiments[number]]
        values = misfit.censored[rows] == 0  # limits have no density
        volume = 2.0 * float(np.log(misfit.sd[rows][values]).sum())
        volume += 2.0 * sum(log_volume(record.series) for record in records)
        kernels: tuple[FloatArray, ...] = ()
        if self.clocks:
            clocks, square = self.clocks[number], float(noise @ noise)
            noise, jacobian = clocks.combine(noise), clocks.combine(jacobian)
            volume += square - float(noise @ noise)  # of readings about the means of blocks
            kernels = clocks.kernels
        keys, columns = jacobian[:, : self._m], jacobian[:, nuisances]
        readings = keys @ self._test_unknowns[number] + columns @ self._x[nuisances]
        return LinearisedTest(
            readings - noise, keys, columns, *self.priors_of(nuisances), volume, kernels, limits
        )
