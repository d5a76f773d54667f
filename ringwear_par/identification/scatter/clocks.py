"""Wear that is itself random: the clock of a body's wear in a test, which all its series share.

The mean worn depth S of a body grows in increments of variance size times dS. A reading at S_i
answers to what is worn too much by g_i a millimetre, so that two readings have a covariance of size
g_i g_j min(S_i, S_j). Long records are averaged in blocks for it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

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

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the weighted means of values (n, ...) of readings."""
        share = (self.share**2).reshape(-1, *(1,) * (values.ndim - 1))
        return np.add.reduceat(share * values, self.first, axis=0)


class TestClocks:
    """The clocks of a test's bodies, and its readings in blocks.

    Parameters
    ----------
    series : of the test.
    sd, roots : (n,) noise of its readings, and roots of the weights by the loss.
    answers, depths : (n, bodies) of each reading: its change a mm worn too much, and the mean worn
        depth, mm.
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
        self._series, self._sd, self._roots, self._depths = series, sd, roots, depths
        self._blocks = [
            Blocks.of(one, sd[part] / roots[part])
            for one, part in zip(series, self._parts, strict=True)
        ]
        self._ends = np.cumsum([len(blocks.first) for blocks in self._blocks])[:-1]
        #: (b, bodies) of blocks
        self._answers, self._at = (
            np.concatenate(
                [
                    blocks.mean(v[part])
                    for blocks, part in zip(self._blocks, self._parts, strict=True)
                ]
            )
            for v in (answers, depths)
        )

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

    def _in_noise(self, rows: FloatArray) -> FloatArray:
        """Return rows (b, c) of blocks in units of their noise, without its correlation."""
        scaled = []
        for rows_of_series, series, part, blocks in zip(
            np.split(rows, self._ends), self._series, self._parts, self._blocks, strict=True
        ):
            sd, roots = self._sd[part], self._roots[part]
            if len(blocks.first) == series.n:
                white = whitened(series, rows_of_series / sd[:, None])
                scaled.append(roots[:, None] * white)
            else:  # what a unit of all readings does
                unit = blocks.combine(roots * whitened(series, 1.0 / sd))
                scaled.append(unit[:, None] * rows_of_series)
        return np.concatenate(scaled)

    @property
    def kernels(self) -> tuple[FloatArray, ...]:
        """(b, b) of each body, covariance of the blocks for a size of 1 mm, in units of noise."""
        kernels = []
        for answer, at, depth in zip(self._answers.T, self._at.T, self._depths.T, strict=True):
            shared = np.minimum.outer(at, at) - np.diag(self._within(depth))
            half = self._in_noise(answer[:, None] * shared * answer)
            kernel = self._in_noise(half.T)
            kernels.append(0.5 * (kernel + kernel.T))
        return tuple(kernels)

    def _within(self, depth: FloatArray) -> FloatArray:
        """Return by how much (b,) the mean of a block varies less than a reading at its depth.

        A sixth of the depth that is worn in it, for many equal steps.
        """
        within = []
        for part, blocks in zip(self._parts, self._blocks, strict=True):
            last = blocks.first + blocks.counts - 1
            growth = np.abs(depth[part][last] - depth[part][blocks.first])
            within.append(growth * (1.0 + 1.0 / blocks.counts) / 6.0)
        return np.concatenate(within)

    def smoothed(
        self, sizes: FloatArray, rest: FloatArray, precision: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return by how much bodies have worn more than their mean, and its sd, (n, bodies) mm.

        Parameters
        ----------
        sizes : mm, of the process noise of each.
        rest : (b,) of readings less model and nuisances, in units of noise, times the inverse of
            their covariance.
        precision : (b, b) that inverse, less what model and nuisances take.
        """
        excesses, sds = [], []
        for size, answer, at, depth in zip(
            sizes, self._answers.T, self._at.T, self._depths.T, strict=True
        ):
            points = np.unique(at)
            across = size * self._in_noise(answer[:, None] * np.minimum.outer(at, points))
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

    Readings of the best fit are what is left of them times this, (b + r, b + r).

    Parameters
    ----------
    sizes : mm, of the process noise.
    covariance : (m, m) of the unknowns of the keys.
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
