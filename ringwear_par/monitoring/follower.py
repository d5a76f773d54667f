"""What the readings of a running test say of its specimen: a fit's draws, weighed by them.

Histories of the draws are polynomials of the keys, at the ends of steps; readings lie between them.
Readings weigh the draws by the likelihood of fits. Where few draws are left, they are made anew
about those that a power of the likelihood leaves, whose own density stands for the prior there
(population Monte Carlo: Cappe, Guillin, Marin and Robert, J. Comput. Graph. Stat. 13 (2004)
907-929). All of it starts from the draws before the test, whatever was asked before.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.distance import cdist
from scipy.special import logsumexp
from scipy.stats import chi2, multivariate_t
from scipy.stats import f as f_distribution

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import (
    Experiment,
    Problem,
    Series,
    body_of_wear,
)
from ringwear_par.identification.definition.reading_kinds import READING_KINDS, Trajectory
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.emulator import Box, Emulator, emulate, nearness
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.likelihood import (
    LOG_SHARES,
    EmulatedLikelihood,
    Setting,
    TestLikelihood,
)
from ringwear_par.identification.readings import TimeInterpolation
from ringwear_par.identification.setting import needs_middle, settings_at

#: histories for polynomials, by the number of keys that are fitted
_HISTORIES = {1: 64, 2: 192, 3: 320}
_MOST_HISTORIES = 448
#: margin of the box of the draws; of the spread of a quantity: its scale, and error that is enough
_MARGIN, _SCALE, _CLOSE = 0.1, 1e-3, 0.03
#: draws that are tried at first, and in one go; effective number that is enough
_SOME, _ENOUGH = 10_000, 2000.0
#: most rounds of new draws, their number, the share of them that is enough and that a power of the
#: likelihood leaves, and the number of kernels of the prior's density
_ROUNDS, _REDRAWN, _SHARE, _TEMPERED, _KERNELS = 12, 5000, 0.2, 0.4, 1500
#: of new draws: degrees of freedom, and factor of their covariance
_DEGREES, _WIDER = 8.0, 1.3
#: most settings that are tried; draws that growth times are judged by, and those of predictions
_SETTINGS, _JUDGED, _PREDICTED = 4, 64, 1000


def times_of(test: Experiment) -> FloatArray:
    """Return the times (n,) s of all readings of a test."""
    return np.concatenate([np.full(s.n, s.at) if s.profile else s.x for s in test.series])


def part_of(test: Experiment, rows: BoolArray) -> Experiment:
    """Return a test with some of its readings (n,), without series that their nuisances explain."""
    masks = np.split(rows, np.cumsum([s.n for s in test.series])[:-1])
    parts = [s.part(mask) for s, mask in zip(test.series, masks, strict=True)]
    told = (s for s in parts if s.n > sum(n.free for n in s.nuisances) * (s.censored is None))
    return replace(test, series=tuple(told))


@dataclass(frozen=True, eq=False)
class Histories:
    """Histories of a test at unknowns of its keys, from which its readings are taken."""

    #: its approach, torque, volumes and masses at the ends of steps; profiles and times at which
    #: layers are worn through, as they are read
    plan: Experiment
    #: of the readings of the plan
    emulator: Emulator
    #: how these follow random wear and the calibration of measured inputs
    setting: Setting
    #: (bodies,) mm, mean depth of the bodies whose wear is random at the end of the test, at the
    #: middle of the draws
    depths: FloatArray

    @classmethod
    def of(cls, readings: Readings, problem: Problem, x: FloatArray) -> "Histories":
        """Return the histories of a problem of one test at draws (s, m). On the first rank.

        Raises
        ------
        ComputationError : hardly any draw has a history.
        """
        readings.problem = problem.with_experiments((_plan(problem.experiments[0]),))
        middle = np.median(x, axis=0)
        settings = [Setting.before(*readings.problem.experiments, "", len(problem.settings.process))]
        if needs_middle(readings.problem):
            shares = np.full(len(problem.settings.process), 0.05)
            settings = settings_at(readings, settings, middle[None], shares, first=True)
        box = Box.about(x[:_SOME], *problem.unknown_bounds, _MARGIN)
        count = _HISTORIES.get(x.shape[1], _MOST_HISTORIES)
        points = np.concatenate([box.design(count - count // 3), x[: count // 3]])
        points = points[box.holds(points)]
        (y,) = readings([(0, points)])
        good = np.isfinite(y).all(axis=1)
        if good.sum() < 2 * x.shape[1] + 2:
            raise ComputationError(f"{problem.name}: hardly any draw has a history: {readings.reason}")
        (plan,) = readings.problem.experiments
        spreads = np.split(y[good].std(axis=0), np.cumsum([s.n for s in plan.series])[:-1])
        sd = np.concatenate([np.full(len(s), s.max() or 1.0) for s in spreads])
        root = np.linalg.cholesky(np.atleast_2d(np.cov(x.T)))
        distance = np.linalg.norm(np.linalg.solve(root, (points[good] - middle).T), axis=0)
        emulator, _ = emulate(box, points, y, _SCALE * sd, nearness(distance), _CLOSE)
        depths = [cls.depth(plan, emulator(middle[None])[0], key)[-1] for key in problem.settings.process]
        return cls(plan, emulator, settings[0], np.array(depths))

    @property
    def time(self) -> FloatArray:
        """(s,) s, ends of steps, the start included."""
        return self.plan.series[0].x

    @property
    def error(self) -> float:
        """Largest rms error of a quantity, over its spread among the draws."""
        return _SCALE * self.emulator.error

    @staticmethod
    def quantities(plan: Experiment, columns: FloatArray) -> dict[str, FloatArray]:
        """Return readings (n, ...) of a plan by the names of its series."""
        parts = np.split(columns, np.cumsum([s.n for s in plan.series])[:-1])
        return dict(zip((s.name for s in plan.series), parts, strict=True))

    @staticmethod
    def depth(plan: Experiment, columns: FloatArray, key: str) -> FloatArray:
        """Return the mean depths (steps, ...) mm of a body, by readings (n, ...) of a plan."""
        volume = Histories.quantities(plan, columns)[f"all volume.{body_of_wear(key)}"]
        return volume / plan.case.area

    def read(self, columns: FloatArray, test: Experiment) -> FloatArray:
        """Return the readings (n, ...) of a test by those of the plan."""
        case, parts = test.case, self.quantities(self.plan, columns)
        nothing = np.full((len(self.time), *columns.shape[1:]), np.nan)
        volume, mass = (
            np.stack([parts.get(f"all {quantity}.{body}", nothing) for body in BODIES])
            for quantity in ("volume", "mass")
        )
        history = Trajectory(
            self.time, parts["all approach"], parts["all torque"], volume, nothing, mass, nothing
        )
        found = []
        for series in test.series:
            values = READING_KINDS[series.kind].values
            if values is None:
                found.append(parts[series.name])
                continue
            between = TimeInterpolation(
                self.time, series.x, (0.0, *case.breakpoints, case.time.end)
            )
            found.append(between(values(history, BODIES.index(series.body), series.density)))
        return np.concatenate(found)

    def emulator_of(self, test: Experiment) -> Emulator:
        """Return the emulator of the readings of a test."""
        both = self.read(np.column_stack([self.emulator.mean, self.emulator.modes.T]), test)
        return replace(self.emulator, mean=both[:, 0], modes=both[:, 1:].T)

    def setting_of(self, test: Experiment, loss: str) -> Setting:
        """Return the setting of a test before its readings are looked at."""
        clocks = []
        for felt, share in self.setting.clocks:
            depth = np.interp(times_of(test), self.time, share[: len(self.time)])
            answer = self.read(felt * share, test)
            clocks.append((np.divide(answer, depth, out=np.zeros_like(depth), where=depth > 0.0), depth))
        scales = tuple(self.read(scale, test) for scale in self.setting.scales)
        before = Setting.before(test, loss, len(clocks))
        return replace(before, clocks=tuple(clocks), scales=scales)


def _plan(test: Experiment) -> Experiment:
    """Return a test whose readings are all of a history that others are taken from."""
    times = np.append(0.0, step_times(test))
    quantities = ["approach", "torque", *(f"volume.{body}" for body in BODIES)]
    for body, ring in zip(BODIES, test.case.rings, strict=True):
        quantities += [f"mass.{body}"] * (bool(ring.layers) and None not in ring.densities)
    zero, one = np.zeros(len(times)), np.ones(len(times))
    series = [Series(f"all {q}", q, times, zero, one, density=None) for q in quantities]
    fixed = [s for s in test.series if READING_KINDS[s.kind].values is None]
    return replace(test, series=(*series, *fixed))


def _fixed(test: Experiment) -> list[tuple[str, float | None, bytes]]:
    """Return which readings of a test are not between steps."""
    return [(s.name, s.at, s.x.tobytes()) for s in test.series if READING_KINDS[s.kind].values is None]


@dataclass(frozen=True, eq=False)
class Specimen:
    """Draws (s,) of the keys of the specimen under test, by its readings."""

    #: (s, m + bodies) unknowns, and logarithms of the sizes of random wear
    unknowns: FloatArray
    #: (s, r) of their histories
    coordinates: FloatArray
    #: (s,) which sum to 1
    weights: FloatArray
    #: logarithm of the probability density of the readings, but for a constant of theirs
    log_evidence: float
    #: how often they were made anew
    redraws: int
    #: None: of no readings
    likelihood: EmulatedLikelihood | None
    #: (bodies,) rms share of random wear
    shares: FloatArray

    @property
    def effective(self) -> float:
        """How many draws of equal weights they are worth."""
        return float(1.0 / (self.weights @ self.weights))

    def chosen(self, count: int) -> FloatArray:
        """Return the coordinates (count, r) of some draws as probable as their weights are."""
        random = np.random.default_rng(count)
        rows: FloatArray = self.coordinates[random.choice(len(self.weights), count, p=self.weights)]
        return rows


class Follower:
    """What is known of the specimen of a running test, at any of its readings.

    On the first rank, within ``Readings.lead``.

    Parameters
    ----------
    draws : of the fit before.
    of : the next specimen, or one of the fit's.
    problem : of the running test.
    count, seed : number of draws, and their seed.
    """

    def __init__(
        self, draws: Draws, of: str, problem: Problem, readings: Readings, count: int, seed: int
    ) -> None:
        bodies = [BODIES.index(body_of_wear(key)) for key in problem.settings.process]
        x, sizes = draws.unknowns(of, count, np.random.default_rng(seed))
        self.m, self._seed, self._readings = x.shape[1], seed, readings
        self._unknowns = np.column_stack([x, np.log(sizes[:, bodies])])
        self.prepare(problem)

    def suits(self, problem: Problem) -> bool:
        """Tell whether the histories are of a problem's case, and have all that is read of it."""
        (test,), (before,) = problem.experiments, self.problem.experiments
        return before.case.text == test.case.text and _fixed(test) == _fixed(before)

    def prepare(self, problem: Problem) -> None:
        """Compute histories anew: there are profiles, or measured inputs, that were not there."""
        self.problem = problem
        self.histories = Histories.of(self._readings, problem, self._unknowns[:, : self.m])
        inside = self.histories.emulator.holds(self._unknowns[:, : self.m])
        x = self._unknowns[inside]
        lots = np.array_split(x[:, : self.m], 1 + len(x) // _SOME)
        coordinates = np.concatenate([self.histories.emulator.coordinates(lot) for lot in lots])
        weights = np.full(len(x), 1.0 / len(x))
        self.before = Specimen(x, coordinates, weights, 0.0, 0, None, self._rms(x, coordinates, weights))

    def at_edges(self, found: Specimen) -> float:
        """Return the share of the draws that are at edges of the box of histories."""
        inside = self.histories.emulator.box.inside(found.unknowns[:, : self.m])
        return float(found.weights @ (np.abs(inside) > 0.97).any(axis=1))

    def _shares(self, x: FloatArray, coordinates: FloatArray) -> FloatArray:
        """Return the shares (s, bodies) of random wear over the depths of the setting."""
        histories, emulator = self.histories, self.histories.emulator
        shares = np.zeros((len(x), x.shape[1] - self.m))
        for body, key in enumerate(self.problem.settings.process):
            mean, modes = (
                histories.depth(histories.plan, columns, key)[-1]
                for columns in (emulator.mean, emulator.modes.T)
            )
            depth = np.maximum(mean + coordinates @ modes, 0.0)
            shares[:, body] = np.sqrt(np.exp(x[:, self.m + body]) * depth) / histories.depths[body]
        return np.clip(shares, *np.exp(LOG_SHARES))

    def _rms(self, x: FloatArray, coordinates: FloatArray, weights: FloatArray) -> FloatArray:
        rms: FloatArray = np.sqrt(weights @ self._shares(x, coordinates) ** 2)
        return rms

    def update(self, test: Experiment) -> Specimen:
        """Return the draws by the readings of a test."""
        if not test.series:
            return self.before
        loss, found = self.problem.settings.loss, self.before
        emulator = self.histories.emulator_of(test)
        setting = self.histories.setting_of(test, loss)
        for number in range(_SETTINGS if needs_middle(self.problem) else 1):
            likelihood = TestLikelihood(test, setting, found.shares)
            if number:  # which the last draws tell
                some = emulator.mean + found.chosen(_JUDGED) @ emulator.modes
                middle = emulator.mean + found.weights @ found.coordinates @ emulator.modes
                old = setting
                setting = replace(
                    likelihood.adapted(middle, loss), times=likelihood.with_times_that_count(some).times
                )
                if _is_close(old, setting, likelihood.limits):
                    break
                likelihood = TestLikelihood(test, setting, found.shares)
            found = self._weighed(EmulatedLikelihood(likelihood, emulator))
        return found

    def _log_p(
        self, likelihood: EmulatedLikelihood, x: FloatArray, coordinates: FloatArray
    ) -> FloatArray:
        """Return the logarithm (s,) of the likelihood of draws (s, m + bodies)."""
        lots = np.array_split(np.arange(len(x)), 1 + len(x) // _SOME)
        parts = [likelihood(coordinates[i], self._shares(x[i], coordinates[i])) for i in lots]
        return np.concatenate(parts)

    def _weighed(self, likelihood: EmulatedLikelihood) -> Specimen:
        """Return the draws by a likelihood, made anew where few are left."""
        random, before = np.random.default_rng(self._seed + 1), self.before
        for count in (_SOME, 3 * _SOME, len(before.unknowns)):
            x, coordinates = before.unknowns[:count], before.coordinates[:count]
            log_l = self._log_p(likelihood, x, coordinates)
            if _effective(log_l) >= _ENOUGH:
                break
        # of the prior over the density that the draws are of, in logarithms
        ratio, redraws, enough = np.zeros(len(x)), 0, min(_ENOUGH, _SHARE * len(x))
        while redraws < _ROUNDS and _effective(ratio + log_l) < enough:
            tempered = _power(ratio, log_l, min(2.0 * _ENOUGH, _TEMPERED * len(x)))
            w = _normalised(ratio + tempered * log_l)
            if not redraws:
                power, prior = tempered, _Kernels.of(x, w, random)
                scale = logsumexp(power * log_l) - np.log(len(x))
            mean, covariance = _moments(x, w)
            proposal = multivariate_t(mean, _WIDER * covariance, _DEGREES)
            x = proposal.rvs(_REDRAWN, random).reshape(_REDRAWN, -1)
            x = x[self.histories.emulator.holds(x[:, : self.m])]
            coordinates = self.histories.emulator.coordinates(x[:, : self.m])
            log_l = self._log_p(likelihood, x, coordinates)
            ratio = prior(x) + scale - power * log_l - proposal.logpdf(x)
            redraws, enough = redraws + 1, _SHARE * _REDRAWN
        logs = ratio + log_l
        evidence = logsumexp(logs) - np.log(_REDRAWN if redraws else len(x))
        weights = _normalised(logs)
        rms = self._rms(x, coordinates, weights)
        return Specimen(x, coordinates, weights, float(evidence), redraws, likelihood, rms)

    def surprise(self, found: Specimen, test: Experiment, new: BoolArray) -> float:
        """Return how probable it is that new readings are so far from what old ones lead to expect.

        By mean and covariance of the new readings over draws and growth times, nuisances and random
        wear integrated out.

        Parameters
        ----------
        found : by the old readings.
        test : whose readings (n,) are new or old.
        """
        assert found.likelihood is not None
        old, v = found.likelihood.likelihood, found.chosen(_PREDICTED)
        emulator, setting = self.histories.emulator_of(test), self.setting_like(found, test)
        likelihood = TestLikelihood(test, setting, found.shares)
        by_node = {
            old.test.series[i].name: (growth, logs)
            for (_, growth), logs in zip(
                old.noises, old.by_node(found.likelihood.emulator.mean + v @ found.likelihood.emulator.modes),
                strict=True,
            )
            for i in growth.series
        }  # fmt: skip
        v, random = np.column_stack([np.ones(len(v)), v]), np.random.default_rng(0)
        new = new & ~np.isin(np.arange(test.n), likelihood.limits)
        off, spread, freedom = [], [], np.inf
        for part, (noise, growth) in zip(likelihood.parts, likelihood.noises, strict=True):
            here = new[noise.rows]
            if not here.any():
                continue
            data = noise.data(likelihood.data[noise.rows]) - emulator.mean[noise.rows]
            rows = noise(np.column_stack([data, -emulator.modes[:, noise.rows].T]))
            units = noise(np.eye(len(here))[:, here])
            taken = growth.directions(rows, np.eye(1, rows.shape[1])[0])
            from_units = growth.directions(units, np.zeros(units.shape[1]))
            precision = units.T @ units - np.einsum("kgi,kgj->kij", from_units, from_units)
            pull = units.T @ rows - np.einsum("kgi,kgj->kij", from_units, taken)
            covariance = np.linalg.pinv(precision, hermitian=True)
            names = [test.series[i].name for i in growth.series]
            logs = by_node[names[0]][1] if names and names[0] in by_node else growth.log_constants[:, None]
            chance = np.cumsum(np.exp(logs - logsumexp(logs, axis=0)), axis=0)
            nodes = np.minimum((chance < random.random(len(v))).sum(axis=0), len(logs) - 1)
            off.append(np.einsum("sqr,sr->sq", (covariance @ pull)[nodes], v))
            spread.append(covariance[nodes].mean(axis=0))
            if test.series[part[0]].sd_fitted:
                freedom = min(freedom, max(noise.freedom - growth.free - here.sum(), 1.0))
        if not off:
            return 1.0
        each = np.concatenate(off, axis=1)
        variance = block_diag(*spread) + np.cov(each.T).reshape(each.shape[1], -1)
        mean, rank = each.mean(axis=0), np.linalg.matrix_rank(variance, hermitian=True)
        square = mean @ np.linalg.pinv(variance, hermitian=True) @ mean
        if np.isinf(freedom):
            return float(chi2.sf(square, rank))
        return float(f_distribution.sf(square / rank, rank, freedom))

    def setting_like(self, found: Specimen, test: Experiment) -> Setting:
        """Return the setting of a test with other readings: noise and growth times as was found."""
        loss = self.problem.settings.loss
        setting, sd = self.histories.setting_of(test, loss), [series.sd for series in test.series]
        if found.likelihood is None:
            return setting
        old, times = found.likelihood.likelihood, dict(setting.times)
        parts = np.split(old.setting.sd, np.cumsum([s.n for s in old.test.series])[:-1])
        known = {s.name: (i, np.median(part / s.sd))
                 for i, (s, part) in enumerate(zip(old.test.series, parts, strict=True))}  # fmt: skip
        for i, series in enumerate(test.series):
            number, scale = known.get(series.name, (i, 1.0))
            sd[i] = series.sd * (scale if series.sd_fitted else 1.0)
            if i in times and series.name in known:
                times[i] = old.setting.times[number]
        setting = replace(setting, sd=np.concatenate(sd), times=times)
        if loss != "student":
            return setting
        emulator = self.histories.emulator_of(test)
        middle = emulator.mean + found.weights @ found.coordinates @ emulator.modes
        return TestLikelihood(test, setting, found.shares).adapted(middle, loss)


@dataclass(frozen=True, eq=False)
class _Kernels:
    """A density of normal kernels, which has the mean and the covariance of its draws."""

    root: FloatArray
    #: (kernels, d) in units of the root
    centres: FloatArray
    width: float

    @classmethod
    def of(cls, x: FloatArray, weights: FloatArray, random: np.random.Generator) -> "_Kernels":
        """Return the density of weighed draws (s, d): kernels shrink towards the mean by its width."""
        mean, covariance = _moments(x, weights)
        root = np.linalg.cholesky(covariance)
        at = (np.arange(_KERNELS) + random.random()) / _KERNELS
        rows = np.minimum(np.searchsorted(np.cumsum(weights), at), len(x) - 1)
        centres = np.linalg.solve(root, (x[rows] - mean).T).T
        width = _KERNELS ** (-1.0 / (4.0 + x.shape[1]))
        middle = np.linalg.solve(root, mean)
        return cls(root, middle + np.sqrt(1.0 - width**2) * centres, width)

    def __call__(self, x: FloatArray) -> FloatArray:
        """Return the logarithm of the density at x (s, d)."""
        squares = cdist(np.linalg.solve(self.root, x.T).T, self.centres, "sqeuclidean")
        logs: FloatArray = logsumexp(-0.5 * squares / self.width**2, axis=1) - np.log(_KERNELS)
        constant = x.shape[1] * (0.5 * np.log(2.0 * np.pi) + np.log(self.width))
        return logs - constant - np.log(np.diag(self.root)).sum()


def _normalised(logs: FloatArray) -> FloatArray:
    weights: FloatArray = np.exp(logs - logsumexp(logs))
    return weights


def _effective(logs: FloatArray) -> float:
    return float(np.exp(2.0 * logsumexp(logs) - logsumexp(2.0 * logs)))


def _power(ratio: FloatArray, log_l: FloatArray, wanted: float) -> float:
    """Return the power of the likelihood that leaves an effective number of draws."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        enough = _effective(ratio + middle * log_l) >= wanted
        low, high = (middle, high) if enough else (low, middle)
    return low


def _moments(x: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (d,) and covariance (d, d) of weighed draws; sizes may be known exactly."""
    mean = weights @ x
    covariance = (weights[:, None] * (x - mean)).T @ (x - mean)
    return mean, covariance + 1e-12 * np.eye(len(mean))


def _is_close(old: Setting, new: Setting, limits: IntArray) -> bool:
    """Tell whether likelihoods do not differ by their settings."""
    times = all(
        np.diff(new.times[i])[0] > 0.7 * np.diff(ends)[0] for i, ends in old.times.items()
    )
    moved = np.abs(new.expected - old.expected)[limits] / new.sd[limits]
    scaled = np.abs(np.log(new.sd / old.sd))
    return times and bool(scaled.max() < 0.02 and moved.max(initial=0.0) < 0.05)
