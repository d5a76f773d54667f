"""Wear that is itself random: the clock of a body's wear in a test, which all its series share.

The mean worn depth S of a body grows in increments of variance size times dS. A reading at S_i
answers to what is worn too much by g_i a millimetre, so that two readings have a covariance of size
g_i g_j min(S_i, S_j). Long records are averaged in blocks for it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.model.noise import whitened
from ringwear_par.identification.scatter.reduction import LinearisedTest, uncorrelated

#: readings of a series from which on it is averaged, in as many blocks of equal time
MOST_READINGS = 500


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
    of_step = np.repeat(following[last], blocks.counts) - following + blocks.share * roots * present
    uneven = (of_step - np.repeat(within, blocks.counts)) ** 2 * np.diff(depth, prepend=depth[0])
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
        ends = np.cumsum([0, *(one.n for one in series)]).tolist()
        self._parts = [slice(low, high) for low, high in itertools.pairwise(ends)]
        self._depths = depths
        self._blocks = [
            Blocks.of(one, sd[part] / roots[part])
            for one, part in zip(series, self._parts, strict=True)
        ]
        self._ends = np.cumsum([len(blocks.first) for blocks in self._blocks])[:-1]
        self._responses = []
        for answer, depth in zip((answers / sd[:, None]).T, depths.T, strict=True):
            of_series = [
                _responses(one, blocks, roots[part], answer[part], depth[part])
                for one, blocks, part in zip(series, self._blocks, self._parts, strict=True)
            ]
            self._responses.append(_Responses(*map(np.concatenate, zip(*of_series, strict=True))))

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
        for of in self._responses:
            kernel = of.of_growth(of.covariance(of.low), of.covariance(of.high))
            kernels.append(0.5 * (kernel + kernel.T) + np.diag(of.between))
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
        for size, of, depth in zip(sizes, self._responses, self._depths.T, strict=True):
            points = np.unique(of.high)
            across = size * of.covariance(points)
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
    precision: FloatArray = rest.T @ rest - keys @ covariance @ keys.T
    return precision
