"""How probable the readings of a test are at values of its keys.

Nuisances (offsets, drifts, the amplitude of thermal growth) are linear and have normal or flat
priors, noise is normal: both are integrated out by linear algebra. What is left is, by an emulator,
a quadratic form in a few coordinates. The time of a thermal growth is summed over nodes; an sd that
is to be fitted is integrated out (flat in its logarithm); the share of random wear, which readings
of all series of a test feel together, is interpolated between nodes.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.polynomial.legendre import leggauss
from scipy.linalg import block_diag, solve_triangular
from scipy.special import gammaln, log_ndtr, logsumexp

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import Experiment, Nuisance
from ringwear_par.identification.emulator import Emulator
from ringwear_par.identification.noise import (
    brownian_root,
    log_volume,
    student_weights,
    whitened,
)
from ringwear_par.identification.readings import nuisance_columns

#: logarithms of the least and the largest share of random wear
LOG_SHARES = np.log([1e-3, 1.0])
#: nodes of each share by the number of bodies whose share is fitted
_SHARE_NODES = {1: 24, 2: 10}
#: nodes of a growth time, and sd of its prior within which they are
_TIME_NODES, _PRIOR_SDS = 24, 4.5
#: nodes whose log likelihood is less than the largest by more count nowhere
_COUNTS = 15.0
#: singular value of nuisances, over the largest, below which they are not distinct
_DEPENDENT = 1e-10


@dataclass(frozen=True, eq=False)
class Setting:
    """What the likelihood of a test takes from where the draws are, among which it hardly moves."""

    #: (n,) sd of the readings
    sd: FloatArray
    #: (n,) what nuisances add to the readings, for limits
    expected: FloatArray
    #: (low, high) s, of the growth time of each series that has one, by its number
    times: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    #: (n,) each, of each body whose wear is random: how readings follow a factor on its rates, over
    #: its share of the largest depth of all tests; and that share
    clocks: tuple[tuple[FloatArray, FloatArray], ...] = ()
    #: (bodies,) share of random wear that is known; NaN where it is fitted
    shares: FloatArray = field(default_factory=lambda: np.zeros(0))
    #: (n,) each: what the readings gain by one sd of the calibration of each measured input
    scales: tuple[FloatArray, ...] = ()

    @classmethod
    def before(cls, test: Experiment, loss: str, bodies: int) -> "Setting":
        """Return the setting before any draws, when readings may be outliers.

        Parameters
        ----------
        bodies : number of bodies whose wear is random.
        """
        times = {}
        for number, series in enumerate(test.series):
            if (time := series.growth_time) is not None:
                low, high = time.bounds
                if time.prior is not None:
                    low = max(low, time.prior.mean - _PRIOR_SDS * time.prior.sd)
                    high = min(high, time.prior.mean + _PRIOR_SDS * time.prior.sd)
                times[number] = (low, high)
        sd = np.concatenate([series.sd for series in test.series]) * (1.0 + (loss == "student"))
        shares = np.full(bodies, np.nan)
        return cls(sd, np.zeros(test.n), times, shares=shares)


class Noise:
    """Noise of some series at given growth times and shares of random wear.

    It makes rows (n, ...) of data less model white, and takes out what nuisances explain: the log
    likelihood is ``log_constant`` - |rows|^2 / 2.
    """

    def __init__(
        self,
        test: Experiment,
        numbers: Sequence[int],
        setting: Setting,
        times: Mapping[int, float],
        shares: FloatArray,
    ) -> None:
        starts = np.cumsum([0, *(s.n for s in test.series)])
        self._series = [test.series[i] for i in numbers]
        #: (n,) of these readings among all of the test
        self.rows: IntArray = np.concatenate([np.arange(*starts[[i, i + 1]]) for i in numbers])
        self._sd, self._limit = setting.sd[self.rows], sides(test)[self.rows] != 0.0
        blocks = [
            nuisance_columns(s, test.case, times.get(i))
            for i, s in zip(numbers, self._series, strict=True)
        ]
        scales = setting.scales if len(numbers) == len(test.series) else ()
        #: (n, k) what a unit of each nuisance adds to the readings
        self.columns = np.column_stack([block_diag(*blocks), *scales])
        #: its nuisances, but for the calibrations of measured inputs, which follow them
        self.nuisances: list[Nuisance] = [n for s in self._series for n in s.linear_nuisances]
        count, known = self.columns.shape[1], np.ones(self.columns.shape[1])
        self._means = np.zeros(count)
        for j, nuisance in enumerate(self.nuisances):
            known[j] = 0.0
            if nuisance.prior is not None:
                self._means[j], known[j] = nuisance.prior.mean, 1.0 / nuisance.prior.sd
        priors = np.diag(known)[known > 0.0]
        self._factor = None
        if setting.clocks:
            covariance = np.eye(len(self.rows))
            for (slope, depth), share in zip(setting.clocks, shares, strict=True):
                wear = slope[self.rows, None] * brownian_root(depth[self.rows])
                root = share * self._over_noise(wear)
                covariance += root @ root.T
            self._factor = np.linalg.cholesky(covariance)
        normal = np.concatenate([self.white(self.columns), priors])
        size = np.linalg.norm(normal, axis=0)
        acting = size > 0.0
        basis, values, right = np.linalg.svd(normal / np.where(acting, size, 1.0), False)
        kept = values > _DEPENDENT * values.max(initial=0.0)
        self._top, self._bottom = np.split(basis[:, kept], [len(self.rows)])
        self._solution = right[kept].T / values[kept] / np.where(acting, size, 1.0)[:, None]
        #: (k, k) of the nuisances
        self.covariance = self._solution @ self._solution.T
        #: degrees of freedom of the readings less free nuisances
        self.freedom = float((~self._limit).sum() + len(priors) - kept.sum())
        given = np.concatenate([s.sd for s in self._series])
        volume = np.log(self._sd / given)[~self._limit].sum() + sum(map(log_volume, self._series))
        volume += np.log(values[kept]).sum() + np.log(size[acting]).sum()
        if self._factor is not None:
            volume += np.log(np.diag(self._factor)).sum()
        self.log_constant = -float(volume)

    def _over_noise(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) over the noise of instruments, uncorrelated; 0 of limits."""
        out, start = [], 0
        rows = (rows.T / self._sd).T
        for series in self._series:
            out.append(whitened(series, rows[start : start + series.n]))
            start += series.n
        white: FloatArray = np.concatenate(out)
        white[self._limit] = 0.0
        return white

    def white(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) uncorrelated, over their sd with random wear."""
        rows = self._over_noise(rows)
        return rows if self._factor is None else solve_triangular(self._factor, rows, lower=True)

    def __call__(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) white and without nuisances, (n + priors, ...)."""
        white = self.white(rows)
        along = self._top.T @ white
        return np.concatenate([white - self._top @ along, -self._bottom @ along])

    def data(self, data: FloatArray) -> FloatArray:
        """Return data (n,) less what nuisances are expected to add."""
        return data - self.columns @ self._means

    def best_nuisances(self, rows: FloatArray) -> FloatArray:
        """Return the nuisances (k, ...) that suit rows (n, ...) of ``data`` less the model best."""
        solution = self._solution @ (self._top.T @ self.white(rows))
        return (solution.T + self._means).T

    @property
    def precision(self) -> FloatArray:
        """(n, n) of the readings, nuisances and random wear integrated out."""
        rows = self(np.eye(len(self.rows)))
        return rows.T @ rows


def sides(test: Experiment) -> FloatArray:
    """Return (n,) -1 where the true value is at most the reading, 1 where at least, else 0."""
    parts = [np.zeros(s.n) if s.censored is None else s.censored for s in test.series]
    return np.concatenate(parts).astype(float)


@dataclass(frozen=True, eq=False)
class _Node:
    """Noise of a part at growth times (s) of its series, by number, with the log of their weight."""

    times: Mapping[int, float]
    log_weight: float
    noise: Noise


class TestLikelihood:
    """log p(readings of a test | unknowns), by the readings of the model there.

    Readings of several series are judged together, but for those with a growth time or an sd that
    is fitted; random wear and the calibration of an input are felt by all.

    Parameters
    ----------
    shares : (bodies,) of random wear.
    """

    __test__ = False  # for pytest

    def __init__(self, test: Experiment, setting: Setting, shares: FloatArray) -> None:
        self.test, self.setting, self.shares = test, setting, shares
        self.data = np.concatenate([s.value for s in test.series])
        self._side = sides(test)
        self.limits = np.flatnonzero(self._side)
        numbers = range(len(test.series))
        joint = bool(setting.clocks or setting.scales)
        apart = [i for i in numbers if not joint and (i in setting.times or test.series[i].sd_fitted)]
        rest = tuple(i for i in numbers if i not in apart)
        #: numbers of the series that are judged together, and their noise at each growth time
        self.parts = [*([rest] if rest else []), *((i,) for i in apart)]
        self.nodes = [self.nodes_at(part, shares) for part in self.parts]

    def nodes_at(self, part: Sequence[int], shares: FloatArray) -> list[_Node]:
        """Return the noise of a part at each growth time, at shares (bodies,)."""
        growing = [i for i in part if i in self.setting.times]
        every = []
        for i in growing:
            low, high = self.setting.times[i]
            at, weights = leggauss(_TIME_NODES if len(growing) == 1 else _TIME_NODES // 2)
            at, logs = low + 0.5 * (at + 1.0) * (high - low), np.log(0.5 * (high - low) * weights)
            time = self.test.series[i].growth_time
            if time is not None and time.prior is not None:
                logs = logs - 0.5 * ((at - time.prior.mean) / time.prior.sd) ** 2
            every.append(list(zip(at.tolist(), logs.tolist(), strict=True)))
        nodes = []
        for chosen in itertools.product(*every):
            times = {i: time for i, (time, _) in zip(growing, chosen, strict=True)}
            noise = Noise(self.test, part, self.setting, times, shares)
            nodes.append(_Node(times, sum(log for _, log in chosen), noise))
        return nodes

    def log_p(self, part: Sequence[int], noise: Noise, squares: FloatArray) -> FloatArray:
        """Return log p (...) of a part at sums of squares (...); the sd integrated where fitted."""
        fitted = len(part) == 1 and self.test.series[part[0]].sd_fitted and not self.setting.clocks
        if not fitted:
            return noise.log_constant - 0.5 * squares
        half = 0.5 * max(noise.freedom, 1.0)
        logs: FloatArray = half * np.log(np.maximum(0.5 * squares, 1e-300))
        return noise.log_constant + gammaln(half) - logs

    def of_limits(self, readings: FloatArray) -> FloatArray:
        """Return log p (...) of the limits, by the model's readings (..., limits) there."""
        at = self.limits
        t = (readings + self.setting.expected[at] - self.data[at]) / self.setting.sd[at]
        logs: FloatArray = log_ndtr(self._side[at] * t).sum(axis=-1)
        return logs

    def by_node(self, readings: FloatArray) -> list[FloatArray]:
        """Return log p (nodes, P) of each part by readings (P, n) of the model."""
        every = []
        for part, nodes in zip(self.parts, self.nodes, strict=True):
            logs = []
            for node in nodes:
                noise = node.noise
                rows = noise.data(self.data[noise.rows])[:, None] - readings.T[noise.rows]
                squares = np.square(noise(rows)).sum(axis=0)
                logs.append(node.log_weight + self.log_p(part, noise, squares))
            every.append(np.array(logs))
        return every

    def __call__(self, readings: FloatArray) -> FloatArray:
        """Return log p (P,) by readings (P, n) of the model."""
        total = self.of_limits(readings[:, self.limits])
        for logs in self.by_node(readings):
            total = total + logsumexp(logs, axis=0)
        return total

    def nuisance_draws(
        self, readings: FloatArray, random: np.random.Generator
    ) -> tuple[FloatArray, list[tuple[Noise, FloatArray]], dict[int, FloatArray]]:
        """Return draws of all nuisances by readings (P, n) of the model, one each.

        What they add to the readings (P, n); noise and nuisances (P, k) of each part; and growth
        times (P,) by the number of the series.
        """
        added, parts, times = np.zeros_like(readings), [], {}
        for logs, nodes in zip(self.by_node(readings), self.nodes, strict=True):
            chance = np.cumsum(np.exp(logs - logsumexp(logs, axis=0)), axis=0)
            chosen = np.minimum((chance < random.random(len(readings))).sum(axis=0), len(nodes) - 1)
            first = nodes[0].noise
            values = np.empty((len(readings), first.columns.shape[1]))
            for number in np.unique(chosen).tolist():
                some, noise = chosen == number, nodes[number].noise
                rest = noise.data(self.data[noise.rows])[:, None] - readings[some].T[noise.rows]
                values[some] = noise.best_nuisances(rest).T + random.multivariate_normal(
                    np.zeros(values.shape[1]), noise.covariance, int(some.sum()), method="eigh"
                )
                added[np.ix_(some, noise.rows)] = values[some] @ noise.columns.T
            for i in nodes[0].times:
                times[i] = np.array([node.times[i] for node in nodes])[chosen]
            parts.append((first, values))
        return added, parts, times

    def adapted(self, readings: FloatArray, loss: str) -> Setting:
        """Return the setting about readings (n,) of the model: sd, nuisances, growth times.

        An sd that is fitted becomes that of the residuals; weights of the loss "student" are in the
        sd; growth times stay.
        """
        expected = np.zeros(len(self.data))
        for logs, nodes in zip(self.by_node(readings[None]), self.nodes, strict=True):
            noise = nodes[int(np.argmax(logs[:, 0]))].noise
            rest = noise.data(self.data[noise.rows]) - readings[noise.rows]
            expected[noise.rows] = noise.columns @ noise.best_nuisances(rest)
        sd, start = np.concatenate([series.sd for series in self.test.series]), 0
        for series in self.test.series:
            rows = np.arange(start, start + series.n)[self._side[start : start + series.n] == 0.0]
            start += series.n
            rest = (self.data - readings - expected)[rows] / sd[rows]
            if series.sd_fitted and len(rest) > 2:
                white = whitened(series, rest) if len(rest) == series.n else rest
                # differences of neighbours hardly feel random wear
                squares = 0.5 * np.diff(white) ** 2 if self.setting.clocks else white**2
                scale = max(float(np.sqrt(np.mean(squares))), 1e-9)
                sd[rows], rest = sd[rows] * scale, rest / scale
            if loss == "student":
                sd[rows] /= np.sqrt(student_weights(rest))
        return replace(self.setting, sd=sd, expected=expected)


class EmulatedLikelihood:
    """log p(readings of a test | unknowns, shares of random wear), by an emulator.

    Parameters
    ----------
    likelihood : of the test.
    emulator : of its readings.
    """

    def __init__(self, likelihood: TestLikelihood, emulator: Emulator) -> None:
        self.likelihood, self.emulator = likelihood, emulator
        setting = likelihood.setting
        known = setting.shares if setting.clocks else setting.shares[:0]
        self._fitted = np.flatnonzero(np.isnan(known))
        self._count = _SHARE_NODES.get(len(self._fitted), 1)
        at = np.cos(np.pi * (np.arange(self._count) + 0.5) / self._count)
        low, high = LOG_SHARES
        share_nodes = []
        for chosen in itertools.product(at, repeat=len(self._fitted)):
            shares = known.copy()
            shares[self._fitted] = np.exp(low + 0.5 * (np.array(chosen) + 1.0) * (high - low))
            share_nodes.append(shares)
        inverse = np.linalg.inv(chebvander(at, self._count - 1))
        weights = np.ones((1, 1))
        for _ in self._fitted:
            weights = np.kron(weights, inverse)
        #: of each part and growth time: the weight's log, noise, and matrices of the squares in the
        #: coordinates, or their Chebyshev coefficients with those of the constant
        self._forms: list[list[tuple[float, Noise, FloatArray, FloatArray]]] = []
        for part, nodes in zip(likelihood.parts, likelihood.nodes, strict=True):
            if not len(self._fitted):
                forms = [(n.log_weight, n.noise, self._root(n.noise), np.zeros(0)) for n in nodes]
            else:
                at_shares = [likelihood.nodes_at(part, shares) for shares in share_nodes]
                forms = []
                for number, node in enumerate(nodes):
                    noises = [every[number].noise for every in at_shares]
                    roots = [self._root(noise) for noise in noises]
                    grams = np.einsum("kq,qij->kij", weights, [r.T @ r for r in roots])
                    constants = weights @ [noise.log_constant for noise in noises]
                    forms.append((node.log_weight, node.noise, grams, constants))
            self._forms.append(forms)

    def _root(self, noise: Noise) -> FloatArray:
        """Return R: squares at coordinates z are |R (1, z)|^2."""
        emulator, data = self.emulator, noise.data(self.likelihood.data[noise.rows])
        rows = np.column_stack([data - emulator.mean[noise.rows], -emulator.modes[:, noise.rows].T])
        rows = noise(rows)
        return np.linalg.qr(rows, mode="r") if len(rows) > rows.shape[1] else rows

    def __call__(self, coordinates: FloatArray, shares: FloatArray) -> FloatArray:
        """Return log p (s,) at coordinates (s, r) of the emulator and shares (s, bodies)."""
        likelihood = self.likelihood
        v = np.concatenate([np.ones((len(coordinates), 1)), coordinates], axis=1)
        total = np.zeros(len(v))
        if len(self._fitted):
            low, high = LOG_SHARES
            t = 2.0 * (np.log(shares[:, self._fitted]) - low) / (high - low) - 1.0
            terms = chebvander(t[:, 0], self._count - 1)
            for column in t.T[1:]:
                more = chebvander(column, self._count - 1)
                terms = (terms[:, :, None] * more[:, None]).reshape(len(terms), -1)
        for part, forms in zip(likelihood.parts, self._forms, strict=True):
            logs = []
            for log_weight, noise, matrix, constants in forms:
                if len(self._fitted):
                    products = (v[:, :, None] * v[:, None]).reshape(len(v), -1)
                    squares = np.einsum("sk,sk->s", terms, products @ matrix.reshape(len(matrix), -1).T)
                    log_p = terms @ constants - 0.5 * squares
                else:
                    log_p = likelihood.log_p(part, noise, np.square(v @ matrix.T).sum(axis=1))
                logs.append(log_weight + log_p)
            total += logsumexp(logs, axis=0) if len(logs) > 1 else logs[0]
        if len(at := likelihood.limits):
            emulator = self.emulator
            total += likelihood.of_limits(emulator.mean[at] + coordinates @ emulator.modes[:, at])
        return total


def times_that_count(likelihood: TestLikelihood, readings: FloatArray) -> Setting:
    """Return the setting with growth times (s) that matter at some of the readings (P, n)."""
    times = dict(likelihood.setting.times)
    for logs, nodes in zip(likelihood.by_node(readings), likelihood.nodes, strict=True):
        counts = (logs - logs.max(axis=0)).max(axis=1) > -_COUNTS
        for i in nodes[0].times:
            every = np.array(sorted({node.times[i] for node in nodes}))
            kept = {node.times[i] for node, count in zip(nodes, counts, strict=True) if count}
            first, last = np.searchsorted(every, [min(kept), max(kept)])
            low, high = times[i]
            times[i] = (
                float(every[first - 1]) if first else low,
                float(every[last + 1]) if last + 1 < len(every) else high,
            )
    return replace(likelihood.setting, times=times)
