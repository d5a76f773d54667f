"""Noise of the readings of a test, and what else is in them beside the model's.

Nuisances (offsets, drifts, the amplitude of thermal growth) are linear and have normal priors, wide
ones where nothing is known; so has random wear, which all series of a test feel together. All are
integrated out by linear algebra, at each node of the time of a thermal growth.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import gammaln, logsumexp

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import Experiment, Loss, Series, records
from ringwear_par.identification.nuisances import Nuisances

#: degrees of freedom of the loss "student"
_NU = 4.0
#: Fisher information of such noise over that of normal noise
STUDENT = (_NU + 1.0) / (_NU + 3.0)
#: nodes of a growth time, and beside random wear
_TIME_NODES, _JOINT_NODES = 192, 48


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


def student_weights(residuals: FloatArray) -> FloatArray:
    """Return weights (n,) by which normal noise stands for that of the loss "student".

    Those of the squares in its steps, times its Fisher information over that of normal noise.
    """
    return (_NU + 1.0) / (_NU + residuals * residuals) * STUDENT


def sides(test: Experiment) -> FloatArray:
    """Return (n,) -1 where the true value is at most the reading, 1 where at least, else 0."""
    parts = [np.zeros(s.n) if s.censored is None else s.censored for s in test.series]
    return np.concatenate(parts).astype(float)


@dataclass(frozen=True, eq=False)
class Setting:
    """What the likelihood of a test takes from where the draws are, among which it hardly moves."""

    #: (n,) sd of the readings
    sd: FloatArray
    #: (n,) what nuisances add to the readings, for limits
    expected: FloatArray
    #: (n,) each, of each body whose wear is random: how readings follow a factor on its rates, over
    #: its share of the largest depth of all tests; and that share
    clocks: tuple[tuple[FloatArray, FloatArray], ...] = ()
    #: (n,) each: what the readings gain by one sd of the calibration of each measured input
    scales: tuple[FloatArray, ...] = ()

    @classmethod
    def before(cls, test: Experiment, loss: Loss = "gaussian") -> "Setting":
        """Return the setting before any draws, when readings may be outliers."""
        sd = np.concatenate([series.sd for series in test.series]) * (1.0 + (loss == "student"))
        return cls(sd, np.zeros(test.n))


class Noise:
    """Noise of some series of a test, random wear and nuisances, at K nodes of a growth time.

    Of rows of data less model log p is ``log_constants``, (K,), plus ``density`` of ``squares``.
    """

    def __init__(
        self, test: Experiment, numbers: Sequence[int], setting: Setting, shares: FloatArray
    ) -> None:
        self._series, among = [test.series[i] for i in numbers], records(test.series)
        #: (n,) of these readings among all of the test
        self.rows: IntArray = np.r_[tuple(among[i][1] for i in numbers)]
        self._sd, self._limit = setting.sd[self.rows], sides(test)[self.rows] != 0.0
        #: share, response and depth of each body whose wear is random, see ``Setting``
        self._clocks = [
            (share, slope[self.rows], depth[self.rows])
            for share, (slope, depth) in zip(shares, setting.clocks, strict=False)
        ]
        self._factor = self._of_wear() if self._clocks else None
        #: whether the sd is integrated out, flat in its logarithm
        self.sd_fitted = len(numbers) == 1 and self._series[0].sd_fitted and not self._clocks
        scales = setting.scales if len(numbers) == len(test.series) else ()
        of = Nuisances.of(test, numbers, scales, _JOINT_NODES if self._clocks else _TIME_NODES)
        self.nuisances = of
        #: degrees of freedom of the readings less free nuisances
        self.freedom = float((~self._limit).sum() - of.free.sum())
        # over their noise, and below them priors: least squares in standard normal nuisances
        white = self.white((of.columns * of.sds).transpose(1, 0, 2)).transpose(1, 0, 2)
        prior = np.repeat(np.eye(len(of.sds))[None], len(white), axis=0)
        basis, root = np.linalg.qr(np.concatenate([white, prior], axis=1))
        self._top, bottom = np.split(np.swapaxes(basis, 1, 2), [len(self.rows)], axis=2)
        self._solution = of.sds[:, None] * np.linalg.inv(root)
        # the data are less the means, but that of a growth, which differs between nodes
        grows = np.array([kind == "thermal" for _, kind in of.owners], dtype=bool) & (of.sds > 0.0)
        self._means, pull = np.where(grows, 0.0, of.means), np.zeros(len(of.means))
        pull[grows] = of.means[grows] / of.sds[grows]
        self._shift, self._constant = bottom @ pull, float(pull @ pull)
        given = np.concatenate([s.sd for s in self._series])
        volume = np.log(self._sd / given)[~self._limit].sum() - np.log(of.sds[of.free]).sum()
        volume += sum(log_volumes(s).sum() for s in self._series)
        if self._factor is not None:
            volume += np.log(np.diag(self._factor)).sum()
        roots = np.abs(np.diagonal(root, axis1=1, axis2=2))
        #: (K,)
        self.log_constants = of.log_weights - np.log(roots).sum(axis=1) - volume

    def _of_wear(self) -> FloatArray:
        """Return the Cholesky factor of the covariance of instruments' noise and random wear."""
        covariance = np.eye(len(self.rows))
        for share, slope, depth in self._clocks:
            wear = self._over_noise(slope[:, None] * np.minimum.outer(depth, depth))
            covariance += share**2 * self._over_noise(slope[:, None] * wear.T)
        factor: FloatArray = np.linalg.cholesky(covariance)
        return factor

    def _over_noise(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) over the noise of instruments, uncorrelated; 0 of limits."""
        rows = (rows.T / self._sd).T
        parts = [whitened(series, rows[part]) for series, part in records(self._series)]
        white: FloatArray = np.concatenate(parts)
        white[self._limit] = 0.0
        return white

    def white(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) uncorrelated, over their sd with random wear."""
        rows = self._over_noise(rows)
        if self._factor is None:
            return rows
        flat = rows.reshape(len(rows), -1)
        white = solve_triangular(self._factor, flat, lower=True, check_finite=False)
        return np.reshape(white, rows.shape)

    def data(self, data: FloatArray) -> FloatArray:
        """Return data (n,) less what nuisances are expected to add."""
        return data - self.nuisances.columns[0] @ self._means

    def squares(self, rows: FloatArray) -> FloatArray:
        """Return sums of squares (K, P), priors' too, of rows (n, P) of ``data`` less model."""
        white = self.white(rows)
        along = self._top @ white + self._shift[:, :, None]
        squares: FloatArray = np.square(white).sum(axis=0) - np.square(along).sum(axis=1)
        return squares + self._constant

    def grams(
        self, rows: FloatArray, data: FloatArray, nodes: slice | int = slice(None)
    ) -> FloatArray:
        """Return matrices (K, q, q) of the ``squares`` of combinations of rows (n, q).

        Parameters
        ----------
        data : (q,) 1 where the rows are of data, 0 where they are of derivatives or modes.
        nodes : some of the nodes; one: its matrix (q, q).
        """
        white = self.white(rows)
        along = self._top[nodes] @ white + self._shift[nodes][..., None] * data
        outer = np.swapaxes(along, -1, -2) @ along
        return white.T @ white - outer + self._constant * np.outer(data, data)

    def density(self, squares: FloatArray) -> FloatArray:
        """Return log p (...) at sums of squares (...), but for the constants."""
        if not self.sd_fitted:
            return -0.5 * squares
        half = 0.5 * max(self.freedom, 1.0)
        logs: FloatArray = gammaln(half) - half * np.log(np.maximum(0.5 * squares, 1e-300))
        return logs

    def explained(
        self, rows: FloatArray, nodes: IntArray, random: np.random.Generator | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the nuisances that suit rows of ``data`` less model best, or draws of them.

        What they add to the readings (n, P), and their values (c, P).

        Parameters
        ----------
        rows : (n, P)
        nodes : (P,) of the growth time.
        random : None: the best ones.
        """
        white, count = self.white(rows), rows.shape[1]
        added, values = np.empty_like(rows), np.empty((len(self._means), count))
        noise = np.zeros_like(values) if random is None else random.standard_normal(values.shape)
        for node in np.unique(nodes):
            at = nodes == node
            along = self._top[node] @ white[:, at] + self._shift[node][:, None] + noise[:, at]
            values[:, at] = self._solution[node] @ along + self._means[:, None]
            added[:, at] = self.nuisances.columns[node] @ values[:, at]
        return added, values

    def random_wear(
        self, rows: FloatArray, random: np.random.Generator | None = None
    ) -> FloatArray:
        """Return what bodies have worn by chance, over their largest depth, (bodies, n, P).

        The mean by rows (n, P) of data less model and nuisances, or draws.
        """
        own = [share**2 * np.minimum.outer(depth, depth) for share, _, depth in self._clocks]
        felt = [slope[:, None] * of for (_, slope, _), of in zip(self._clocks, own, strict=True)]
        across = self.white(np.hstack(felt))
        worn = across.T @ self.white(rows)
        if random is not None:
            left = block_diag(*own) - across.T @ across
            left[np.diag_indices_from(left)] += 1e-9 * np.diag(block_diag(*own)).max()
            worn += np.linalg.cholesky(left) @ random.standard_normal(worn.shape)
        return worn.reshape(len(own), -1, rows.shape[1])


def drawn_nodes(logs: FloatArray, random: np.random.Generator) -> IntArray:
    """Return draws (P,) of nodes by their log p (K, P)."""
    chance = np.cumsum(np.exp(logs - logsumexp(logs, axis=0)), axis=0)
    nodes: IntArray = (chance < random.random(logs.shape[1])).sum(axis=0)
    return np.minimum(nodes, len(logs) - 1)
