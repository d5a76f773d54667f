"""Noise of the readings of a test, and what else is in them beside the model's.

Nuisances (offsets, drifts, the amplitude of thermal growth) are linear and have normal priors, wide
ones where nothing is known; so has random wear, which all series of a test feel together. All are
integrated out by linear algebra, at each node of the time of a thermal growth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import gammaln

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import (
    GROWTH_TIME,
    Experiment,
    Loss,
    Series,
    records,
)
from ringwear_par.identification.nuisances import Nuisances

#: degrees of freedom of the loss "student"
NU = 4.0
#: Fisher information of such noise over that of normal noise
STUDENT = (NU + 1.0) / (NU + 3.0)
#: nodes of a growth time, and beside random wear
_TIME_NODES, _JOINT_NODES = 256, 64


def _memory(series: Series) -> tuple[FloatArray, FloatArray]:
    """Return what readings keep of the noise of the one before, and the sd of the rest, (n,)."""
    keeps, rest = np.zeros(series.n), np.ones(series.n)
    if series.correlation_time and series.n > 1:
        steps = np.diff(series.x) / series.correlation_time
        keeps[1:], rest[1:] = np.exp(-steps), np.sqrt(-np.expm1(-2.0 * steps))
    return keeps, rest


def whitened(series: Series, rows: FloatArray) -> FloatArray:
    """Return rows (n, ...) of a series over its sd, AR(1), uncorrelated in time."""
    if not series.correlation_time:
        return rows
    keeps, rest = (v.reshape(-1, *(1,) * (rows.ndim - 1)) for v in _memory(series))
    return (rows - keeps * np.concatenate([rows[:1], rows[:-1]])) / rest


def coloured(series: Series, white: FloatArray) -> FloatArray:
    """Return rows (n, ...) that ``whitened`` makes white."""
    rows = white.copy()
    for i, (keeps, rest) in enumerate(zip(*_memory(series), strict=True)):
        rows[i] = rest * white[i] + (keeps * rows[i - 1] if i else 0.0)
    return rows


def log_volumes(series: Series) -> FloatArray:
    """Return the logarithms (n,) of the factors that ``whitened`` divides volumes by."""
    return np.log(_memory(series)[1])


def sides(test: Experiment) -> FloatArray:
    """Return (n,) -1 where the true value is at most the reading, 1 where at least, else 0."""
    parts = [np.zeros(s.n) if s.censored is None else s.censored for s in test.series]
    return np.concatenate(parts).astype(float)


#: (n,) each, of each body whose wear is random: how readings follow a factor on its rates, over its
#: share of the largest depth of all tests; and that share
Clocks = tuple[tuple[FloatArray, FloatArray], ...]


@dataclass(frozen=True, eq=False)
class Setting:
    """What the likelihood of a test takes from where the draws are, among which it hardly moves."""

    #: (n,) sd of the readings
    sd: FloatArray
    #: (n,) what nuisances add to the readings, for limits
    expected: FloatArray
    clocks: Clocks = ()
    #: (n,) each: what the readings gain by one sd of the calibration of each measured input
    scales: tuple[FloatArray, ...] = ()

    @classmethod
    def before(cls, test: Experiment, loss: Loss = "gaussian") -> "Setting":
        """Return the setting before any draws, when readings may be outliers."""
        sd = np.concatenate([series.sd for series in test.series]) * (1.0 + (loss == "student"))
        return cls(sd, np.zeros(test.n))


class Reduced(NamedTuple):
    """What log p of q rows of data less model takes from them, or of rows that combine into these.

    They are white, and less the nuisances that suit best, of which what is known counts as a
    reading of each.
    """

    #: (rows, q) less all nuisances but a growth; and how far they go along that of each of K times,
    #: (K, 1, q), or (1, 0, q) without
    rest: FloatArray
    growing: FloatArray
    #: (K,)
    log_constants: FloatArray
    #: degrees of freedom, where an sd is integrated out, flat in its logarithm
    freedom: float | None

    def combined(self, weights: FloatArray) -> "Reduced":
        """Return the same of combinations of the rows, by weights (q, s)."""
        return self._replace(rest=self.rest @ weights, growing=self.growing @ weights)

    def squares(self) -> FloatArray:
        """Return sums of squares (K, q), those of priors too."""
        total: FloatArray = np.square(self.rest).sum(axis=0) - np.square(self.growing).sum(axis=1)
        return total

    def grams(self) -> FloatArray:
        """Return matrices (K, q, q) of the squares of combinations."""
        return self.rest.T @ self.rest - np.swapaxes(self.growing, 1, 2) @ self.growing

    def log_p(self) -> FloatArray:
        """Return log p (K, q)."""
        squares, constants = self.squares(), self.log_constants[:, None]
        if self.freedom is None:
            return constants - 0.5 * squares
        half = 0.5 * max(self.freedom, 1.0)
        logs: FloatArray = gammaln(half) - half * np.log(np.maximum(0.5 * squares, 1e-300))
        return constants + logs


class Noise:
    """Noise of some series of a test, random wear and nuisances, at K nodes of a growth time."""

    def __init__(
        self, test: Experiment, numbers: Sequence[int], setting: Setting, shares: FloatArray
    ) -> None:
        self.series, among = [test.series[i] for i in numbers], records(test.series)
        #: (n,) of these readings among all of the test
        self.rows: IntArray = np.r_[tuple(among[i][1] for i in numbers)]
        self._sd, self._limit = setting.sd[self.rows], sides(test)[self.rows] != 0.0
        #: of each body whose wear is random, which all series feel: how readings follow it, and its
        #: covariance (n, n)
        self._clocks = [
            (slope[:, None], share**2 * np.minimum.outer(depth, depth))
            for share, (slope, depth) in zip(shares, setting.clocks, strict=False)
        ]
        given = np.concatenate([s.sd for s in self.series])
        volume = np.log(self._sd / given)[~self._limit].sum()
        volume += sum(log_volumes(s).sum() for s in self.series)
        self._factor: FloatArray | None = None
        if self._clocks:
            covariance = np.eye(len(self.rows))
            for slope, wear in self._clocks:
                covariance += self.white(slope * self.white(slope * wear).T)
            self._factor = np.linalg.cholesky(covariance)
            volume += np.log(np.diag(self._factor)).sum()
        nodes = _JOINT_NODES if self._clocks else _TIME_NODES
        of = self.nuisances = Nuisances(test, numbers, setting.scales, nodes)
        #: degrees of freedom of the readings less free nuisances
        self.freedom = float((~self._limit).sum() - of.free.sum())
        rows = np.swapaxes(of.columns * of.sds, 0, 1)
        white = np.swapaxes(self.white(rows.reshape(len(rows), -1)).reshape(rows.shape), 0, 1)
        priors = np.broadcast_to(np.eye(len(of.sds)), (len(white), len(of.sds), len(of.sds)))
        self._basis, root = np.linalg.qr(np.concatenate([white, priors], axis=1))
        self._solution = of.sds[:, None] * np.linalg.inv(root)
        #: number of nuisances that are the same at all growth times, the first ones
        self._constant = len(of.owners) - (len(of.times) > 1)
        roots = np.log(np.abs(np.diagonal(root, axis1=1, axis2=2))).sum(axis=1)
        #: (K,)
        self._log_constants = of.log_weights - roots - volume + np.log(of.sds[of.free]).sum()

    def white(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, q) uncorrelated, over their sd with random wear; 0 of limits."""
        rows = rows / self._sd[:, None]
        white = np.concatenate([whitened(s, rows[part]) for s, part in records(self.series)])
        white[self._limit] = 0.0
        if self._factor is not None:
            white = solve_triangular(self._factor, white, lower=True, check_finite=False)
        return white

    def _read(self, rows: FloatArray, data: FloatArray | float = 1.0) -> FloatArray:
        """Return rows (n, q) white, and below them what is known of nuisances, (n + c, q)."""
        of = self.nuisances
        known = (of.means / of.sds)[:, None] * np.broadcast_to(data, rows.shape[1])
        return np.concatenate([self.white(rows), known])

    def reduced(self, rows: FloatArray, data: FloatArray | float = 1.0) -> Reduced:
        """Return what log p takes from rows (n, q).

        Parameters
        ----------
        data : (q,) 1 where the rows are of data less model, 0 where they are of derivatives.
        """
        rest, constant = self._read(rows, data), self._basis[0, :, : self._constant]
        rest = rest - constant @ (constant.T @ rest)
        growing = np.swapaxes(self._basis[:, :, self._constant :], 1, 2) @ rest
        alone = len(self.series) == 1 and self.series[0].sd_fitted and not self._clocks
        return Reduced(rest, growing, self._log_constants, self.freedom if alone else None)

    def explained(
        self, rows: FloatArray, random: np.random.Generator | None = None
    ) -> tuple[FloatArray, dict[tuple[int, str], FloatArray]]:
        """Return the nuisances that suit rows (n, P) of data less model best, or draws of them.

        What they add to the readings (n, P), and values (P,) by their owners, growth times too.
        """
        of, read, added = self.nuisances, self._read(rows), np.empty_like(rows)
        logs, values = self.reduced(rows).log_p(), np.zeros((len(of.owners), rows.shape[1]))
        if random is not None:
            logs = logs + random.gumbel(size=logs.shape)  # the largest is a draw of the node
            values = random.standard_normal(values.shape)
        nodes = logs.argmax(axis=0)
        for node in np.unique(nodes):
            at = nodes == node
            along = self._basis[node].T @ read[:, at] + values[:, at]
            values[:, at] = np.where(of.idle[:, None], 0.0, self._solution[node] @ along)
            added[:, at] = of.columns[node] @ values[:, at]
        by_owner = dict(zip(of.owners, values, strict=True))
        if len(of.times) > 1:
            by_owner[of.owners[-1][0], GROWTH_TIME] = of.times[nodes]
        return added, by_owner

    def random_wear(
        self, rows: FloatArray, random: np.random.Generator | None = None
    ) -> FloatArray:
        """Return what bodies have worn by chance, over their largest depth, (bodies, n, P).

        The mean by rows (n, P) of data less model and nuisances, or draws.
        """
        own = block_diag(*(wear for _, wear in self._clocks))
        across = self.white(np.hstack([slope * wear for slope, wear in self._clocks]))
        worn = across.T @ self.white(rows)
        if random is not None:
            left = own - across.T @ across
            left[np.diag_indices_from(left)] += max(1e-9 * np.diag(own).max(), 1e-30)
            worn += np.linalg.cholesky(left) @ random.standard_normal(worn.shape)
        return worn.reshape(len(self._clocks), -1, rows.shape[1])
