"""What the readings of a running test say of its specimen: a fit's draws, weighed by them.

Polynomials of the keys tell its histories at the ends of steps; readings, whenever they come, lie
between these. Readings weigh the draws by the likelihood of fits, at once or, where that would
leave few, by one power of it after another: after each, draws are made anew about those that are
left, by normal kernels that keep mean and covariance (Liu and West 2001, in Sequential Monte Carlo
Methods in Practice, 197-223). All of it starts from the draws before the test, whatever was asked
before.
"""

from collections.abc import Hashable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp, softmax

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import (
    Experiment,
    Loss,
    Problem,
    Series,
    body_of_wear,
    records,
    reflected,
)
from ringwear_par.identification.definition.reading_kinds import READING_KINDS, Trajectory
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.emulator import Box, Emulator, emulate, nearness
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.likelihood import (
    LOG_SHARES,
    EmulatedLikelihood,
    TestLikelihood,
)
from ringwear_par.identification.noise import Setting
from ringwear_par.identification.readings import TimeInterpolation
from ringwear_par.identification.setting import needs_middle, settings_at

#: histories that polynomials are made of by the number of fitted keys, and most of them
_HISTORIES, _MOST_HISTORIES = {1: 64, 2: 192, 3: 320}, 448
#: draws that a box is about, and its margin
_BOXED, _MARGIN = 10_000, 0.1
#: scale of a quantity over its spread, and error of polynomials in it that is small enough
_SCALE, _CLOSE = 1e-3, 0.03
#: share of random wear where clocks are found, which hardly depend on it
_TYPICAL_SHARE = 0.05
#: effective number of draws that is enough, and share of them; factor between powers that are tried
_ENOUGH, _ENOUGH_SHARE, _LESS = 2000.0, 0.2, 0.8
#: draws in one go
_LOT = 2000
#: number of new draws; width of their kernels over the best one of a normal density; variance that
#: they have along what is known exactly
_ANEW, _WIDTH = 20_000, 0.5
_EXACT = 1e-12


def frame_of(problem: Problem) -> tuple[Hashable, ...]:
    """Return all of a problem of one test but its readings over time, which histories are for."""
    (test,) = problem.experiments
    fixed = (s.x.tobytes() for s in test.series if READING_KINDS[s.kind].values is None)
    return (problem.text, test.case.text, *fixed)


def part_of(test: Experiment, rows: BoolArray) -> Experiment:
    """Return a test with some of its readings (n,), without series that their nuisances explain."""
    parts = [series.part(rows[place]) for series, place in records(test.series)]
    informative = (
        s for s in parts if s.n > sum(n.free for n in s.nuisances) * (s.censored is None)
    )
    return replace(test, series=tuple(informative))


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
    #: (1 + r,) 1 and the coordinates of the history at the middle of the draws
    middle: FloatArray

    @classmethod
    def of(cls, readings: Readings, problem: Problem, x: FloatArray) -> "Histories":
        """Return the histories of a problem of one test at draws (s, m). On the first rank.

        Raises
        ------
        ComputationError : hardly any draw has a history.
        """
        (test,), bodies = problem.experiments, len(problem.settings.process)
        plan, middle = _plan(test), np.median(x, axis=0)
        readings.problem = replace(problem, experiments=(plan,))
        settings = [Setting.before(plan, bodies=bodies)]
        if needs_middle(readings.problem):
            shares = np.full(bodies, _TYPICAL_SHARE)
            settings = settings_at(readings, settings, middle[None], shares)
        box = Box.about(x[:_BOXED], *problem.unknown_bounds, _MARGIN)
        count = _HISTORIES.get(x.shape[1], _MOST_HISTORIES)
        points = np.concatenate([box.design(count - count // 3), x[: count // 3]])
        points = points[box.holds(points)]
        (y,) = readings([(0, points)])
        good = np.isfinite(y).all(axis=1)
        if good.sum() < 2 * x.shape[1] + 2:
            reason = f"hardly any draw has a history: {readings.reason}"
            raise ComputationError(f"{problem.name}: {reason}")
        sd = y[good].std(axis=0)
        for _, part in records(plan.series):
            sd[part] = sd[part].max() or 1.0
        root = np.linalg.cholesky(np.atleast_2d(np.cov(x.T)))
        distance = np.linalg.norm(np.linalg.solve(root, (points[good] - middle).T), axis=0)
        emulator, _ = emulate(box, points, y, _SCALE * sd, nearness(distance), _CLOSE)
        return cls(plan, emulator, settings[0], np.append(1.0, emulator.coordinates(middle[None])))

    @property
    def error(self) -> float:
        """Largest rms error of a quantity, over its spread among the draws."""
        return _SCALE * self.emulator.error

    @property
    def columns(self) -> FloatArray:
        """Readings (n, 1 + r) of the plan by 1 and the coordinates."""
        return np.column_stack([self.emulator.mean, self.emulator.modes.T])

    @property
    def time(self) -> FloatArray:
        """(steps,) s, ends of steps, the start included."""
        return self.plan.series[0].x

    def at_steps(self, quantity: str) -> FloatArray:
        """Return (steps, 1 + r) a quantity by 1 and the coordinates; "depth" is mean, in mm."""
        volume = quantity.replace("depth", "volume")
        part = self._parts(self.columns)[f"all {volume}"]
        return part if volume == quantity else part / self.plan.case.area

    def _parts(self, columns: FloatArray) -> dict[str, FloatArray]:
        """Return readings (n, ...) of the plan by the names of its series."""
        return {series.name: columns[part] for series, part in records(self.plan.series)}

    def read(self, columns: FloatArray, test: Experiment) -> FloatArray:
        """Return the readings (n, ...) of a test by those of the plan."""
        parts, nothing = self._parts(columns), np.full((len(self.time), *columns.shape[1:]), np.nan)
        volume, mass = (
            np.stack([parts.get(f"all {quantity}.{body}", nothing) for body in BODIES])
            for quantity in ("volume", "mass")
        )
        history = Trajectory(
            self.time, parts["all approach"], parts["all torque"], volume, nothing, mass, nothing
        )
        breaks, readings = (0.0, *test.case.breakpoints, test.case.time.end), []
        for series in test.series:
            values = READING_KINDS[series.kind].values
            if values is None:
                readings.append(parts[series.name])
            else:
                between = TimeInterpolation(self.time, series.x, breaks)
                read = values(history, BODIES.index(series.body), series.density)
                readings.append(between(read))
        return np.concatenate(readings)

    def emulator_of(self, test: Experiment) -> Emulator:
        """Return the emulator of the readings of a test."""
        both = self.read(self.columns, test)
        return replace(self.emulator, mean=both[:, 0], modes=both[:, 1:].T)

    def setting_of(self, test: Experiment, loss: Loss) -> Setting:
        """Return the setting of a test before its readings are looked at."""
        clocks = []
        for felt, share in self.setting.clocks:
            depth = np.interp(test.times, self.time, share[: len(self.time)])
            answer = self.read(felt * share, test)
            slope = np.divide(answer, depth, out=np.zeros_like(depth), where=depth > 0.0)
            clocks.append((slope, depth))
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


@dataclass(frozen=True, eq=False)
class Specimen:
    """Draws (s,) of the keys of the specimen under test, by its readings."""

    #: (s, m + bodies) unknowns, and logarithms of the sizes of random wear
    unknowns: FloatArray
    #: (s, r) of their histories
    coordinates: FloatArray
    #: (s,) which sum to 1
    weights: FloatArray
    #: (bodies,) rms share of random wear
    shares: FloatArray
    #: None before any reading
    likelihood: EmulatedLikelihood | None = None

    def chosen(self, count: int) -> FloatArray:
        """Return 1 and the coordinates, (count, 1 + r), of draws as often as they weigh."""
        rows = np.random.default_rng(count).choice(len(self.weights), count, p=self.weights)
        return np.column_stack([np.ones(count), self.coordinates[rows]])

    def quantiles(self, values: FloatArray, probabilities: FloatArray) -> FloatArray:
        """Return quantiles of values (s,) of the draws."""
        order = np.argsort(values)
        centred = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
        between: FloatArray = np.interp(probabilities, centred, values[order])
        return between


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
        bodies = [body_of_wear(key) for key in problem.settings.process]
        x, sizes = draws.unknowns(of, count, np.random.default_rng(seed))
        self.draws, self.m, self._seed, self.problem = draws, x.shape[1], seed, problem
        self.histories = histories = Histories.of(readings, problem, x)
        # (bodies, 1 + r) at the end of the test
        depths = np.array([histories.at_steps(f"depth.{body}")[-1] for body in bodies])
        self._depths = depths.reshape(-1, len(histories.middle))
        #: (bodies,) mm, depths of the middle history at the end, of which shares are
        self.most = self._depths @ histories.middle
        every = np.column_stack([x, np.log(sizes[:, [BODIES.index(body) for body in bodies]])])
        every = every[histories.emulator.holds(x)]
        self.before = self._specimen(every, self._coordinates(every), np.zeros(len(every)))

    def _specimen(self, x: FloatArray, coordinates: FloatArray, logs: FloatArray) -> Specimen:
        weights = softmax(logs)
        rms = np.sqrt(weights @ self._shares(x, coordinates) ** 2)
        return Specimen(x, coordinates, weights, rms)

    def _coordinates(self, x: FloatArray) -> FloatArray:
        lots = np.array_split(x[:, : self.m], 1 + len(x) // _LOT)
        return np.concatenate([self.histories.emulator.coordinates(lot) for lot in lots])

    def _shares(self, x: FloatArray, coordinates: FloatArray) -> FloatArray:
        """Return the shares (s, bodies) of random wear: by its size, and the depth of the draw."""
        depths = np.maximum(self._depths[:, 0] + coordinates @ self._depths[:, 1:].T, 0.0)
        shares = np.sqrt(np.exp(x[:, self.m :]) * depths) / self.most
        return np.clip(shares, *np.exp(LOG_SHARES))

    def update(self, test: Experiment) -> Specimen:
        """Return the draws by the readings of a test."""
        specimen, loss = self.before, self.problem.settings.loss
        if not test.series:
            return specimen
        setting = self.histories.setting_of(test, loss)
        specimen = self._weighed(test, setting, specimen)
        if needs_middle(self.problem):  # which these draws tell
            assert specimen.likelihood is not None
            likelihood, middle = specimen.likelihood.likelihood, self.middle(specimen, test)
            setting = likelihood.adapted(middle, loss)
            specimen = self._weighed(test, setting, specimen)
        return specimen

    def middle(self, specimen: Specimen, test: Experiment) -> FloatArray:
        """Return readings (n,) of a test by the mean history."""
        emulator = self.histories.emulator_of(test)
        return emulator.mean + specimen.weights @ specimen.coordinates @ emulator.modes

    def likelihood_like(self, specimen: Specimen, test: Experiment) -> TestLikelihood:
        """Return the likelihood of other readings: noise as of the specimen's."""
        setting, known = self.histories.setting_of(test, "gaussian"), {}
        if specimen.likelihood is not None:
            old = specimen.likelihood.likelihood
            for s, part in records(old.test.series):
                known[s.name] = (
                    float(np.median(old.setting.sd[part] / s.sd)) if s.sd_fitted else 1.0
                )
        sd = np.concatenate([known.get(s.name, 1.0) * s.sd for s in test.series])
        likelihood = TestLikelihood(test, replace(setting, sd=sd), specimen.shares)
        if self.problem.settings.loss == "gaussian":
            return likelihood
        adapted = likelihood.adapted(self.middle(specimen, test), self.problem.settings.loss)
        return TestLikelihood(test, adapted, specimen.shares)

    def _weighed(self, test: Experiment, setting: Setting, about: Specimen) -> Specimen:
        """Return the draws by a likelihood, whose noise is that about some others."""
        likelihood = EmulatedLikelihood(
            TestLikelihood(test, setting, about.shares), self.histories.emulator_of(test)
        )
        random = np.random.default_rng(self._seed + 1)
        x, coordinates = self.before.unknowns, self.before.coordinates
        left = 1.0
        while True:
            lots = np.array_split(np.arange(len(x)), 1 + len(x) // _LOT)
            shares = self._shares(x, coordinates)
            log_p = np.concatenate([likelihood(coordinates[i], shares[i]) for i in lots])
            power, enough = left, min(_ENOUGH, _ENOUGH_SHARE * len(x))
            while _effective(power * log_p) < enough:
                power *= _LESS
            if power == left:
                specimen = self._specimen(x, coordinates, power * log_p)
                return replace(specimen, likelihood=likelihood)
            left -= power
            x = self._made_anew(x, softmax(power * log_p), random)
            coordinates = self._coordinates(x)

    def _made_anew(
        self, x: FloatArray, weights: FloatArray, random: np.random.Generator
    ) -> FloatArray:
        """Return draws about weighed ones (s, m + bodies), which shrink to their mean before."""
        d = x.shape[1]
        mean, rows = weights @ x, random.choice(len(x), _ANEW, p=weights)
        covariance = np.cov(x.T, aweights=weights).reshape(d, d) + _EXACT * np.eye(d)
        width = _WIDTH * (weights @ weights) ** (1.0 / (4.0 + d))
        step = random.standard_normal((_ANEW, d)) @ np.linalg.cholesky(covariance).T
        x = mean + np.sqrt(1.0 - width**2) * (x[rows] - mean) + width * step
        x[:, : self.m] = reflected(x[:, : self.m], *self.problem.unknown_bounds)
        return x[self.histories.emulator.holds(x[:, : self.m])]


def _effective(logs: FloatArray) -> float:
    return float(np.exp(2.0 * logsumexp(logs) - logsumexp(2.0 * logs)))
