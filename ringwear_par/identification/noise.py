"""Noise of the readings of a test, and what else is in them beside the model's.

Nuisances (offsets, drifts, the amplitude of thermal growth) are linear and have normal priors, wide
ones where nothing is known; so has random wear, which all series of a test feel together. All are
integrated out by linear algebra. The time of a thermal growth is not linear: it is at nodes, at
each of which the growth takes one direction out of the squares.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.linalg import block_diag, solve_triangular
from scipy.special import logsumexp

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import InputError, legible
from ringwear_par.identification.definition.problem import (
    Experiment,
    Loss,
    Nuisance,
    Series,
    records,
)
from ringwear_par.identification.readings import growth, nuisance_columns

#: degrees of freedom of the loss "student"
_NU = 4.0
#: Fisher information of such noise over that of normal noise
STUDENT = (_NU + 1.0) / (_NU + 3.0)
#: sd of a nuisance without a prior, over the largest reading; that of a growth, over their range
_WIDE, _WIDE_GROWTH = 1e4, 100.0
#: nodes of a growth time, and beside random wear
_TIME_NODES, _JOINT_NODES = 192, 48
#: sd of the prior of a growth time within which they are
_PRIOR_SDS = 4.5
#: (nodes, weights) by their number
_nodes = cache(leggauss)


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


def _prior(nuisance: Nuisance, widest: float) -> tuple[float, float]:
    """Return mean and sd of a nuisance; bounds at both sides count as a normal distribution."""
    if nuisance.prior is not None:
        return nuisance.prior
    low, high = nuisance.bounds
    return (0.0, widest) if nuisance.free else (0.5 * (low + high), (high - low) / np.sqrt(12.0))


class Noise:
    """Noise of some series of a test at shares of random wear.

    It makes rows (n, ...) of data less model white, and takes out what nuisances explain, but for
    thermal growth: the log likelihood is ``log_constant`` - |rows|^2 / 2.
    """

    def __init__(
        self, test: Experiment, numbers: Sequence[int], setting: Setting, shares: FloatArray
    ) -> None:
        self._series, among = [test.series[i] for i in numbers], records(test.series)
        #: (n,) of these readings among all of the test
        self.rows: IntArray = np.r_[tuple(among[i][1] for i in numbers)]
        self._sd, self._limit = setting.sd[self.rows], sides(test)[self.rows] != 0.0
        #: share, response and depth of each body whose wear is random, see ``Setting``
        self.clocks = [
            (share, slope[self.rows], depth[self.rows])
            for share, (slope, depth) in zip(shares, setting.clocks, strict=False)
        ]
        self._factor = None
        if self.clocks:
            covariance = np.eye(len(self.rows))
            for share, slope, depth in self.clocks:
                wear = self._over_noise(slope[:, None] * np.minimum.outer(depth, depth))
                covariance += share**2 * self._over_noise(slope[:, None] * wear.T)
            self._factor = np.linalg.cholesky(covariance)
        scales = setting.scales if len(numbers) == len(test.series) else ()
        #: (n, k) what a unit of each nuisance, and an sd of each calibration, add to the readings
        self.columns = np.column_stack(
            [block_diag(*(nuisance_columns(s, test.case) for s in self._series)), *scales]
        )
        widest = [_WIDE * (np.abs(s.value).max() + s.sd.max()) / s.factor for s in self._series]
        priors = [
            (nuisance.free, *_prior(nuisance, wide))
            for s, wide in zip(self._series, widest, strict=True) for nuisance in s.linear_nuisances
        ] + [(False, 0.0, 1.0)] * len(scales)  # fmt: skip
        free, self._means, sds = np.reshape(priors, (-1, 3)).T.astype(float)
        sds = sds * self.columns.any(axis=0)  # what adds nothing stays where it is
        free = (free > 0.0) & (sds > 0.0)
        normal = np.concatenate([self.white(self.columns * sds), np.eye(len(sds))])
        basis, root = np.linalg.qr(normal)
        self._top, self._bottom = np.split(basis, [len(self.rows)])
        self._solution = sds[:, None] * np.linalg.inv(root)
        #: (k, k) of the nuisances
        self.covariance = self._solution @ self._solution.T
        #: degrees of freedom of the readings less free nuisances
        self.freedom = float((~self._limit).sum() - free.sum())
        given = np.concatenate([s.sd for s in self._series])
        volume = np.log(self._sd / given)[~self._limit].sum() - np.log(sds[free]).sum()
        volume += sum(log_volumes(s).sum() for s in self._series)
        volume += np.log(np.abs(np.diag(root))).sum()
        if self._factor is not None:
            volume += np.log(np.diag(self._factor)).sum()
        self.log_constant = -float(volume)

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
        return (
            rows
            if self._factor is None
            else solve_triangular(self._factor, rows, lower=True, check_finite=False)
        )

    def __call__(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) white and without nuisances, (n + k, ...)."""
        white = self.white(rows)
        along = self._top.T @ white
        return np.concatenate([white - self._top @ along, -self._bottom @ along])

    def data(self, data: FloatArray) -> FloatArray:
        """Return data (n,) less what nuisances are expected to add."""
        return data - self.columns @ self._means

    def nuisances(self, rows: FloatArray, random: np.random.Generator | None = None) -> FloatArray:
        """Return the nuisances (k, P) that suit rows (n, P) of ``data`` less the model best.

        Or draws of them, where there is ``random``.
        """
        along = self._top.T @ self.white(rows)
        if random is not None:
            along += random.standard_normal(along.shape)
        return self._solution @ along + self._means[:, None]

    def random_wear(
        self, rows: FloatArray, random: np.random.Generator | None = None
    ) -> FloatArray:
        """Return what bodies have worn by chance, over their largest depth, (bodies, n, P).

        The mean by rows (n, P) of data less model and nuisances, or draws.
        """
        own = [share**2 * np.minimum.outer(depth, depth) for share, _, depth in self.clocks]
        felt = [slope[:, None] * of for (_, slope, _), of in zip(self.clocks, own, strict=True)]
        across = self.white(np.hstack(felt))
        worn = across.T @ self.white(rows)
        if random is not None:
            left = block_diag(*own) - across.T @ across
            left[np.diag_indices_from(left)] += 1e-9 * np.diag(block_diag(*own)).max()
            worn += np.linalg.cholesky(left) @ random.standard_normal(worn.shape)
        return worn.reshape(len(own), -1, rows.shape[1])


class Growth:
    """Thermal growth of one of some series at nodes (K,) of its growth time, over white noise.

    Its amplitude is linear: at each node it takes g = 1 directions out of the squares. One node
    without directions, g = 0, where nothing grows.
    """

    def __init__(self, test: Experiment, numbers: Sequence[int], noise: Noise) -> None:
        #: numbers of the series
        self.series = [i for i in numbers if test.series[i].growth_time is not None]
        if len(self.series) > 1:
            raise InputError(
                f'experiment "{legible(test.name)}": only one series may have thermal growth where '
                "wear is random or an input has a scale"
            )
        g, n = len(self.series), len(noise.rows)
        #: (K, g) s, growth times; (K, g, n) what an amplitude of 1 adds to the readings
        self.times, self.columns = np.zeros((1, g)), np.zeros((1, g, n))
        logs, mean, sd = np.zeros(1), 0.0, 1.0
        #: number of amplitudes that have no prior
        self.free = 0
        for i in self.series:
            series, time = test.series[i], test.series[i].growth_time
            assert time is not None
            amplitude = next(
                nuisance for nuisance in series.nuisances if nuisance.kind == "thermal"
            )
            # one that is free is not far beyond the readings: it would be an offset else
            widest = _WIDE_GROWTH * float(np.ptp(series.value)) + float(series.sd.max())
            mean, sd = _prior(amplitude, widest / series.factor)
            self.free = int(amplitude.free)
            low, high = time.bounds
            if time.prior is not None:
                at, spread = time.prior
                low, high = max(low, at - _PRIOR_SDS * spread), min(high, at + _PRIOR_SDS * spread)
            low, high = np.log([low, high])
            nodes, weights = _nodes(_JOINT_NODES if noise.clocks else _TIME_NODES)
            times = np.exp(low + 0.5 * (nodes + 1.0) * (high - low))
            logs = np.log(0.5 * (high - low) * weights * times)
            if time.prior is not None:
                logs = logs - 0.5 * ((times - at) / spread) ** 2 - np.log(spread)
            self.times, self.columns = times[:, None], np.zeros((len(times), 1, n))
            part = np.isin(noise.rows, np.r_[records(test.series)[i][1]])
            for column, t in zip(self.columns[:, 0], times.tolist(), strict=True):
                column[part] = series.factor * growth(amplitude, test.case, series.x, t)
        white = noise(self.columns.reshape(-1, n).T).T
        white = white.reshape(len(logs), g, white.shape[1])
        size = np.sqrt(np.square(white).sum(axis=2) + sd**-2)
        self._shift = (mean / sd**2 / size)[..., None]
        self._white, self._size = white / size[..., None], size
        #: of the squares, by the mean of the prior
        self.constant = g * (mean / sd) ** 2
        #: (K,) what each node adds to the constant of the noise
        self.log_constants = logs - np.log(size).sum(axis=1) - (g - self.free) * np.log(sd)

    def directions(self, rows: FloatArray, data: FloatArray) -> FloatArray:
        """Return (K, g, ...) whose squares are less in white rows (n', ...) of ``Noise``.

        Parameters
        ----------
        data : (...) 1 where the rows are of data, 0 where of a mode.
        """
        taken: FloatArray = np.tensordot(self._white, rows, axes=1) + self._shift * data
        return taken

    def squares(self, rows: FloatArray) -> FloatArray:
        """Return the sums of squares (K, P) at each node of white rows (n', P) of data."""
        taken = np.square(self.directions(rows, np.ones(rows.shape[1]))).sum(axis=1)
        return np.square(rows).sum(axis=0) + self.constant - taken

    def amplitudes(
        self, rows: FloatArray, nodes: IntArray, random: np.random.Generator | None
    ) -> FloatArray:
        """Return the best amplitudes (g, P), or draws, by white rows (n', P) at a node each."""
        at = np.arange(rows.shape[1])
        along = self.directions(rows, np.ones(len(at)))[nodes, :, at].T
        if random is not None:
            along = along + random.standard_normal(along.shape)
        return along / self._size[nodes].T


def drawn_nodes(logs: FloatArray, count: int, random: np.random.Generator) -> IntArray:
    """Return draws (count,) of nodes by their log p (K, count), or by (K, 1) of all."""
    chance = np.cumsum(np.exp(logs - logsumexp(logs, axis=0)), axis=0)
    nodes: IntArray = (chance < random.random(count)).sum(axis=0)
    return np.minimum(nodes, len(logs) - 1)
