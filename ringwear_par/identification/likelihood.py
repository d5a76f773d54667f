"""How probable the readings of a test are at values of its keys.

Nuisances (offsets, drifts, the amplitude of thermal growth) are linear and have normal or flat
priors, noise is normal: both are integrated out by linear algebra. What is left is, by an emulator,
a quadratic form in a few coordinates. The time of a thermal growth is summed over nodes, at each of
which the growth takes one direction out of the form; an sd that is to be fitted is integrated out
(flat in its logarithm); the share of random wear, which readings of all series of a test feel
together, is interpolated between nodes.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.polynomial.legendre import leggauss
from scipy.linalg import block_diag, solve_triangular
from scipy.special import gammaln, log_ndtr, logsumexp

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import Experiment, Loss, Nuisance, records
from ringwear_par.identification.emulator import Emulator
from ringwear_par.identification.noise import log_volume, student_weights, whitened
from ringwear_par.identification.readings import growth, nuisance_columns

#: logarithms of the least and the largest share of random wear
LOG_SHARES = np.log([1e-3, 1.0])
#: nodes of each share by the number of bodies whose share is fitted
_SHARE_NODES = {1: 24, 2: 20}
#: nodes of a growth time: of one alone, beside random wear or calibrations, and of each of several
_TIME_NODES, _JOINT_NODES, _EACH_NODES = 128, 32, 12
#: range of the readings that is an sd of a growth without a prior
_FREE = 100.0
#: sd of the prior of a growth time within which they are
_PRIOR_SDS = 4.5
#: nodes whose log likelihood is less than the largest by more count nowhere
_COUNTS = 15.0
#: singular value of nuisances, over the largest, below which they are not distinct
_DEPENDENT = 1e-10
#: (nodes, weights) by their number
_nodes = cache(leggauss)


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
    def before(cls, test: Experiment, loss: Loss = "gaussian", bodies: int = 0) -> "Setting":
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
        scales = setting.scales if len(numbers) == len(test.series) else ()
        #: (n, k) what a unit of each nuisance adds to the readings
        self.columns = np.column_stack(
            [block_diag(*(nuisance_columns(s, test.case) for s in self._series)), *scales]
        )
        #: these, but for the calibrations of measured inputs, which follow them
        self.nuisances: list[Nuisance] = [n for s in self._series for n in s.linear_nuisances]
        self._means, known = np.zeros(self.columns.shape[1]), np.ones(self.columns.shape[1])
        for j, nuisance in enumerate(self.nuisances):
            self._means[j], known[j] = _prior(nuisance)
        priors = np.diag(known)[known > 0.0]
        self._factor = None
        if setting.clocks:
            covariance = np.eye(len(self.rows))
            for (slope, depth), share in zip(setting.clocks, shares, strict=True):
                slope, depth = slope[self.rows, None], depth[self.rows]
                wear = self._over_noise(slope * np.minimum.outer(depth, depth))
                covariance += share**2 * self._over_noise(slope * wear.T)
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
        volume -= np.log(known[known > 0.0]).sum()
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


def _prior(nuisance: Nuisance) -> tuple[float, float]:
    """Return the mean of a nuisance's prior and 1 over its sd; 0 and 0 where it is flat.

    Bounds at both sides count as a normal distribution of their mean and sd.
    """
    if nuisance.prior is not None:
        return nuisance.prior.mean, 1.0 / nuisance.prior.sd
    low, high = nuisance.bounds
    if not np.isfinite(high - low):
        return 0.0, 0.0
    return 0.5 * (low + high), float(np.sqrt(12.0)) / (high - low)


class Growth:
    """Thermal growth of some series at nodes (K,) of their growth times, over white noise.

    Its amplitudes (g,) are linear: at each node they take g directions out of the squares. One node
    without directions where nothing grows.
    """

    def __init__(
        self, test: Experiment, numbers: Sequence[int], setting: Setting, noise: Noise
    ) -> None:
        #: numbers of the series
        self.series = [i for i in numbers if i in setting.times]
        alone = _JOINT_NODES if setting.clocks or setting.scales else _TIME_NODES
        at, weights = _nodes(alone if len(self.series) < 2 else _EACH_NODES)
        means, known, told = np.zeros((3, len(self.series)))
        places = [part for _, part in records([test.series[i] for i in numbers])]
        nodes: list[list[tuple[float, float, FloatArray]]] = []
        for place, i in enumerate(self.series):
            series, (low, high) = test.series[i], np.log(setting.times[i])
            amplitude = next(n for n in series.nuisances if n.kind == "thermal")
            means[place], told[place] = _prior(amplitude)
            # one that is free is not far beyond the readings: it would be an offset else
            spread = _FREE * float(np.ptp(series.value)) + float(series.sd.max())
            known[place] = told[place] or series.factor / spread
            times = np.exp(low + 0.5 * (at + 1.0) * (high - low))
            logs = np.log(0.5 * (high - low) * weights * times)
            if series.growth_time is not None and series.growth_time.prior is not None:
                prior = series.growth_time.prior
                logs = logs - 0.5 * ((times - prior.mean) / prior.sd) ** 2 - np.log(prior.sd)
            rows = np.zeros((len(at), len(noise.rows)))
            part = places[list(numbers).index(i)]
            for row, time in zip(rows, times.tolist(), strict=True):
                row[part] = series.factor * growth(amplitude, test.case, series.x, time)
            nodes.append(list(zip(times.tolist(), logs.tolist(), rows, strict=True)))
        chosen = list(itertools.product(*nodes))
        #: (K, g) s, growth times
        self.times = np.array([[time for time, _, _ in node] for node in chosen])
        #: (K, g, n) what an amplitude of 1 adds to the readings
        shape = len(chosen), len(self.series), len(noise.rows)
        self.columns = np.array([[rows for _, _, rows in node] for node in chosen]).reshape(shape)
        white = noise(self.columns.reshape(-1, shape[2]).T).T
        self._white = white.reshape(*shape[:2], white.shape[1])
        gram = np.einsum("kgn,khn->kgh", self._white, self._white) + np.diag(known**2)
        factor = np.linalg.cholesky(gram)
        #: (K, g, g) whose square is the covariance of the amplitudes
        self._root = np.linalg.inv(factor)
        self._shift = known**2 * means
        #: of the squares, by the means of priors
        self.constant = float(np.square(known * means).sum())
        logs = np.array([sum(log for _, log, _ in node) for node in chosen])
        volume = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        #: (K,) what each node adds to the constant of the noise
        self.log_constants = logs - volume + np.log(told[told > 0.0]).sum()
        #: number of amplitudes that have no prior
        self.free = int((told == 0.0).sum())

    def directions(self, rows: FloatArray, data: FloatArray) -> FloatArray:
        """Return (K, g, ...) whose squares are less in white rows (n', ...) of ``Noise``.

        Parameters
        ----------
        data : (...) 1 where the rows are of data, 0 where of a mode.
        """
        along = np.tensordot(self._white, rows, axes=1)
        along += np.multiply.outer(self._shift, data)
        taken: FloatArray = np.einsum("kgh,kh...->kg...", self._root, along)
        return taken

    def squares(self, rows: FloatArray) -> FloatArray:
        """Return the sums of squares (K, P) at each node of white rows (n', P) of data."""
        taken = np.square(self.directions(rows, np.ones(rows.shape[1]))).sum(axis=1)
        return np.square(rows).sum(axis=0) + self.constant - taken

    def amplitudes(self, rows: FloatArray, node: int) -> tuple[FloatArray, FloatArray]:
        """Return the best amplitudes (g, P) by white rows (n', P) of data at a node, and a root.

        The root' root (g, g) is their covariance.
        """
        root = self._root[node]
        return root.T @ self.directions(rows, np.ones(rows.shape[1]))[node], root


def drawn_nodes(logs: FloatArray, count: int, random: np.random.Generator) -> IntArray:
    """Return draws (count,) of nodes by their log p (K, count), or by (K, 1) of all."""
    chance = np.cumsum(np.exp(logs - logsumexp(logs, axis=0)), axis=0)
    nodes: IntArray = (chance < random.random(count)).sum(axis=0)
    return np.minimum(nodes, len(logs) - 1)


def sides(test: Experiment) -> FloatArray:
    """Return (n,) -1 where the true value is at most the reading, 1 where at least, else 0."""
    parts = [np.zeros(s.n) if s.censored is None else s.censored for s in test.series]
    return np.concatenate(parts).astype(float)


class TestLikelihood:
    """log p(readings of a test | unknowns), by the readings of the model there.

    Readings of several series are judged together, but for those that grow thermally or have an sd
    that is fitted; random wear and the calibration of an input are felt by all.

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
        apart = [
            i for i in numbers if not joint and (i in setting.times or test.series[i].sd_fitted)
        ]
        rest = tuple(i for i in numbers if i not in apart)
        #: numbers of the series that are judged together
        self.parts = [*([rest] if rest else []), *((i,) for i in apart)]
        #: noise and thermal growth of each part
        self.noises = [self.noise_at(part, shares) for part in self.parts]

    def noise_at(self, part: Sequence[int], shares: FloatArray) -> tuple[Noise, Growth]:
        """Return noise and thermal growth of a part, at shares (bodies,) of random wear."""
        noise = Noise(self.test, part, self.setting, shares)
        return noise, Growth(self.test, part, self.setting, noise)

    def log_p(self, part: Sequence[int], freedom: float, squares: FloatArray) -> FloatArray:
        """Return log p (...) of a part at sums of squares (...), but for the constants of noise.

        Where the sd is fitted it is integrated out.
        """
        fitted = len(part) == 1 and self.test.series[part[0]].sd_fitted and not self.setting.clocks
        if not fitted:
            return -0.5 * squares
        half = 0.5 * max(freedom, 1.0)
        logs: FloatArray = gammaln(half) - half * np.log(np.maximum(0.5 * squares, 1e-300))
        return logs

    def of_limits(self, readings: FloatArray) -> FloatArray:
        """Return log p (...) of the limits, by the model's readings (..., limits) there."""
        at = self.limits
        t = (readings + self.setting.expected[at] - self.data[at]) / self.setting.sd[at]
        logs: FloatArray = log_ndtr(self._side[at] * t).sum(axis=-1)
        return logs

    def _rows(self, noise: Noise, readings: FloatArray) -> FloatArray:
        """Return data less readings (P, n) of the model, as a part has them, (n of the part, P)."""
        return noise.data(self.data[noise.rows])[:, None] - readings.T[noise.rows]

    def by_node(self, readings: FloatArray) -> list[FloatArray]:
        """Return log p (K, P) of each part at its growth times by readings (P, n) of the model."""
        every = []
        for part, (noise, grown) in zip(self.parts, self.noises, strict=True):
            squares = grown.squares(noise(self._rows(noise, readings)))
            logs = self.log_p(part, noise.freedom - grown.free, squares)
            every.append(noise.log_constant + grown.log_constants[:, None] + logs)
        return every

    def __call__(self, readings: FloatArray) -> FloatArray:
        """Return log p (P,) by readings (P, n) of the model."""
        total = self.of_limits(readings[:, self.limits])
        for logs in self.by_node(readings):
            total = total + logsumexp(logs, axis=0)
        return total

    def nuisance_draws(
        self, readings: FloatArray, random: np.random.Generator | None = None
    ) -> tuple[FloatArray, dict[tuple[int, str], FloatArray], dict[int, FloatArray]]:
        """Return nuisances by readings (P, n) of the model: a draw each, or else the best.

        What they add to the readings (P, n); values (P,) by the series' number and kind, those of
        the calibrations of inputs, in their sd, by -1 and their number; and growth times (P,) s.
        """
        added, count = np.zeros_like(readings), len(readings)
        values: dict[tuple[int, str], FloatArray] = {}
        times: dict[int, FloatArray] = {}
        for part, (noise, grown), logs in zip(
            self.parts, self.noises, self.by_node(readings), strict=True
        ):
            nodes = logs.argmax(axis=0) if random is None else drawn_nodes(logs, count, random)
            rows, amplitudes = self._rows(noise, readings), np.zeros((count, len(grown.series)))
            white = noise(rows)
            for node in np.unique(nodes).tolist():
                some = nodes == node
                best, root = grown.amplitudes(white[:, some], node)
                if random is not None:
                    best = best + root.T @ random.standard_normal(best.shape)
                amplitudes[some] = best.T
                rows[:, some] -= grown.columns[node].T @ best
            linear = noise.best_nuisances(rows).T
            if random is not None and linear.shape[1]:
                zero = np.zeros(linear.shape[1])
                linear = linear + random.multivariate_normal(
                    zero, noise.covariance, count, method="eigh"
                )
            added[:, noise.rows] = linear @ noise.columns.T + np.einsum(
                "pg,pgn->pn", amplitudes, grown.columns[nodes]
            )
            owners = [(i, n.kind) for i in part for n in self.test.series[i].linear_nuisances]
            owners += [(-1, str(j)) for j in range(linear.shape[1] - len(owners))]
            values.update(zip(owners, linear.T, strict=True))
            for place, i in enumerate(grown.series):
                values[i, "thermal"] = amplitudes[:, place]
                times[i] = grown.times[nodes, place]
        return added, values, times

    def adapted(self, readings: FloatArray, loss: Loss) -> Setting:
        """Return the setting about readings (n,) of the model: sd and nuisances.

        An sd that is fitted becomes that of the residuals; weights of the loss "student" are in the
        sd; growth times stay.
        """
        expected = self.nuisance_draws(readings[None])[0][0]
        sd = np.concatenate([series.sd for series in self.test.series])
        for series, whole in records(self.test.series):
            rows = whole.start + np.flatnonzero(self._side[whole] == 0.0)
            rest = (self.data - readings - expected)[rows] / sd[rows]
            if series.sd_fitted and len(rest) > 2:
                white = whitened(series, rest) if len(rest) == series.n else rest
                # differences of neighbours hardly feel random wear
                squares = 0.5 * np.diff(white) ** 2 if self.setting.clocks else white**2
                scale = max(float(np.sqrt(np.mean(squares))), 1e-9)
                sd[whole], rest = sd[whole] * scale, rest / scale
            if loss == "student":
                if self.setting.clocks and len(rest) > 2:  # random wear is no outlier
                    rest[1:-1] -= 0.5 * (rest[:-2] + rest[2:])
                    rest[1:-1] /= np.sqrt(1.5)
                sd[rows] /= np.sqrt(student_weights(rest))
        return replace(self.setting, sd=sd, expected=expected)

    def with_times_that_count(self, readings: FloatArray) -> Setting:
        """Return the setting with growth times (s) that matter at some of the readings (P, n)."""
        times = dict(self.setting.times)
        for (_, grown), logs in zip(self.noises, self.by_node(readings), strict=True):
            counts = (logs - logs.max(axis=0)).max(axis=1) > -_COUNTS
            for place, i in enumerate(grown.series):
                every = np.unique(grown.times[:, place])
                kept = grown.times[counts, place]
                first, last = np.searchsorted(every, [kept.min(), kept.max()])
                low, high = times[i]
                times[i] = (
                    float(every[first - 1]) if first else low,
                    float(every[last + 1]) if last + 1 < len(every) else high,
                )
        return replace(self.setting, times=times)


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
        if not len(self._fitted):
            #: of each part: freedom, roots R of its squares |R (1, z)|^2, and of those which growth
            #: takes out at each node, with constants
            self._forms = [self._form(*noises) for noises in likelihood.noises]
            return
        at, (low, high) = np.cos(np.pi * (np.arange(self._count) + 0.5) / self._count), LOG_SHARES
        inverse, weights = np.linalg.inv(chebvander(at, self._count - 1)), np.ones((1, 1))
        for _ in self._fitted:
            weights = np.kron(weights, inverse)
        (part,) = likelihood.parts
        grams, constants = [], []
        for chosen in itertools.product(at, repeat=len(self._fitted)):
            shares = known.copy()
            shares[self._fitted] = np.exp(low + 0.5 * (np.array(chosen) + 1.0) * (high - low))
            _, root, taken, constant = self._form(*likelihood.noise_at(part, shares))
            grams.append(root.T @ root - np.einsum("kgi,kgj->kij", taken, taken))
            constants.append(constant)
        #: Chebyshev coefficients (K, nodes, q q) of matrices of squares at each growth time, and
        #: (K, nodes) of constants
        self._grams = np.einsum("cs,skij->kcij", weights, grams).reshape(
            len(constants[0]), len(weights), -1
        )
        self._constants = np.einsum("cs,sk->kc", weights, constants)

    def _form(
        self, noise: Noise, growth: Growth
    ) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Return freedom, R (q, 1 + r), what growth takes out (K, g, 1 + r), and constants (K,)."""
        emulator, data = self.emulator, noise.data(self.likelihood.data[noise.rows])
        rows = np.column_stack([data - emulator.mean[noise.rows], -emulator.modes[:, noise.rows].T])
        rows = noise(rows)
        taken = growth.directions(rows, np.eye(1, rows.shape[1])[0])
        constants = noise.log_constant + growth.log_constants
        root: FloatArray = rows
        if len(rows) > rows.shape[1]:
            root = np.linalg.qr(rows)[1]
        return noise.freedom - growth.free, root, taken, constants - 0.5 * growth.constant

    def __call__(self, coordinates: FloatArray, shares: FloatArray) -> FloatArray:
        """Return log p (s,) at coordinates (s, r) of the emulator and shares (s, bodies)."""
        likelihood, total = self.likelihood, np.zeros(len(coordinates))
        v = np.concatenate([np.ones((len(coordinates), 1)), coordinates], axis=1)
        if len(self._fitted):
            terms = self._share_terms(shares)
            products = (v[:, :, None] * v[:, None]).reshape(len(v), -1)
            logs = [
                terms @ constants - 0.5 * np.einsum("sc,sc->s", terms, products @ grams.T)
                for grams, constants in zip(self._grams, self._constants, strict=True)
            ]
            total = logsumexp(logs, axis=0) if len(logs) > 1 else logs[0]
        else:
            for part, (freedom, root, taken, constants) in zip(
                likelihood.parts, self._forms, strict=True
            ):
                squares = np.square(v @ root.T).sum(axis=1)
                if taken.shape[1]:
                    less = np.square(v @ taken.reshape(-1, v.shape[1]).T)
                    less = less.reshape(len(v), *taken.shape[:2]).sum(axis=2)
                    log_p = constants + likelihood.log_p(part, freedom, squares[:, None] - less)
                    total += logsumexp(log_p, axis=1)
                else:
                    total += constants[0] + likelihood.log_p(part, freedom, squares)
        if len(at := likelihood.limits):
            emulator = self.emulator
            total += likelihood.of_limits(emulator.mean[at] + coordinates @ emulator.modes[:, at])
        return total

    def _share_terms(self, shares: FloatArray) -> FloatArray:
        """Return the Chebyshev polynomials (s, nodes) of the shares that are fitted."""
        low, high = LOG_SHARES
        terms = np.ones((len(shares), 1))
        for column in np.log(shares[:, self._fitted]).T:
            more = chebvander(2.0 * (column - low) / (high - low) - 1.0, self._count - 1)
            terms = (terms[:, :, None] * more[:, None]).reshape(len(terms), -1)
        return terms
