"""What the readings of a running test say of its specimen: a fit's draws, weighed by them.

Polynomials of the keys tell its histories at the ends of steps; readings, whenever they come, lie
between these. Readings weigh the draws by the likelihood of fits, at once or, where that would
leave few, by one power of it after another: after each, draws are made anew about those that are
left, by normal kernels that keep mean and covariance (Liu and West 2001, in Sequential Monte Carlo
Methods in Practice, 197-223). All of it starts from the draws before the test, whatever was asked
before.
"""

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc, softmax

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError, InputError, legible
from ringwear_par.identification.definition.problem import (
    Experiment,
    Problem,
    ProcessNoise,
    Series,
    body_of_wear,
    records,
    reflected,
)
from ringwear_par.identification.definition.series import averaged
from ringwear_par.identification.draws import NEXT, Draws
from ringwear_par.identification.emulator import Box, Emulator, emulate
from ringwear_par.identification.fitted_tests import with_all
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.likelihood import (
    LOG_SHARES,
    EmulatedLikelihood,
    TestLikelihood,
)
from ringwear_par.identification.noise import Setting
from ringwear_par.identification.readings import interpolation
from ringwear_par.identification.setting import needs_middle, settings_at
from ringwear_par.prediction.predict import check_predicted

#: histories that polynomials are made of, for each fitted key and most; margin of their box
_HISTORIES, _MOST_HISTORIES, _MARGIN = 128, 448, 0.1
#: scale of a quantity over its spread, and error of polynomials in it that is small enough
_SCALE, _CLOSE = 1e-3, 0.03
#: effective share of the draws that is enough; factor between powers that are tried
_ENOUGH, _LESS = 0.1, 0.8
#: width of kernels over the best one of a normal density; variance of what is known exactly
_WIDTH, _EXACT = 0.5, 1e-12
#: draws that are enough to predict readings
_SOME = 2000
#: windows of a test in which readings are compared with what is expected of them, and the
#: probability below which they are not: 1 of 100 tests without a change has an alarm
_WINDOWS = 20
_IMPROBABLE = 0.01 / _WINDOWS
#: degrees of freedom of an sd that is known; mm, sd of what is not read
_KNOWN, _UNREAD = 1e9, 1e6
#: times at which the sd of a key is expected
_TIMES = 9


@dataclass(frozen=True, eq=False)
class Specimen:
    """What readings of a test tell of its specimen."""

    #: (s, m + bodies) draws of the unknowns, and of logarithms of the shares of random wear
    unknowns: FloatArray
    #: of these readings
    likelihood: TestLikelihood

    @property
    def some(self) -> FloatArray:
        """About ``_SOME`` of the draws."""
        return self.unknowns[:: max(1, len(self.unknowns) // _SOME)]


class Follower:
    """What is known of the specimen of a running test, at any of its readings.

    On the first rank, within ``Readings.lead``.

    Parameters
    ----------
    draws : of the fit before.
    problem : of the running test.
    count, seed : number of draws, and their seed.

    Raises
    ------
    InputError : the test of another fit, or one of this fit's.
    ComputationError : hardly any draw has a history.
    """

    def __init__(
        self, draws: Draws, problem: Problem, readings: Readings, count: int, seed: int
    ) -> None:
        (test,) = problem.experiments
        if test.name in draws.experiments:
            raise InputError(
                f"{problem.name}: {legible(test.name)}: is among the tests of the fit, so that its "
                "readings would count twice; must be followed after a fit without it"
            )
        #: the next specimen, or one of the fit's
        self.of = test.groups[0] if test.groups[0] in draws.specimens else NEXT
        check_predicted(draws, test.case, problem.name, self.of)
        process = {key: ProcessNoise() for key in draws.process}
        problem = replace(problem, settings=replace(problem.settings, process=process))
        self.draws, self.problem, self._seed = draws, problem, seed
        #: draws at the end of a window, and how probable its readings were, by all until then:
        #: up to half a second each where wear is random
        self.windows: dict[bytes, tuple[Specimen, float]] = {}
        bodies = [body_of_wear(key) for key in process]
        plan = _plan(test, bodies)
        #: (steps,) s, ends of steps, the start included; where readings of series are in the plan
        self.time = plan.series[0].x
        self.places = {series.name: part for series, part in records(plan.series)}
        readings.problem = replace(problem, experiments=(plan,))
        values, sizes = draws.values(self.of, count, np.random.default_rng(seed))
        x = problem.unknowns(values)
        self.m = x.shape[1]
        #: of the readings of the plan; how these follow random wear and calibrations of inputs
        self.emulator, self._setting = _emulated(readings, x)
        ends = [self.places[f"volume.{body}"].stop - 1 for body in bodies]

        def worn(x: FloatArray) -> FloatArray:
            return np.maximum(self.emulator(x)[:, ends] / test.case.area, 1e-300)

        #: (bodies,) mm, worn at the end at the middle of the draws, to which shares are relative
        self.most = worn(np.median(x, axis=0)[None])[0]
        inside = self.emulator.holds(x)
        x, sizes = x[inside], sizes[inside][:, [BODIES.index(body) for body in bodies]]
        shares = np.log(np.sqrt(sizes * worn(x)) / self.most)
        #: (s, m + bodies) before the test, see ``Specimen``
        self.before = np.column_stack([x, np.clip(shares, *LOG_SHARES)])
        #: (m, m) of the unknowns
        self.precision = np.linalg.inv(np.atleast_2d(np.cov(x.T)))

    def reading(self, test: Experiment) -> tuple[Emulator, Setting]:
        """Return the emulator of the readings of a test, and the setting before they are known."""
        # what they are of those of the plan
        weights = np.zeros((test.n, len(self.emulator.mean)))
        breaks = (0.0, *test.case.breakpoints, test.case.time.end)
        for series, rows in records(test.series):
            part = interpolation(self.time, series.x, breaks) if series.timed else np.eye(series.n)
            weights[rows, self.places[series.name]] = part
        mean, modes = weights @ self.emulator.mean, self.emulator.modes @ weights.T
        clocks = []
        for felt, share in self._setting.clocks:
            depth = np.interp(test.times, self.time, share[: len(self.time)])
            answer = weights @ (felt * share)
            slope = np.divide(answer, depth, out=np.zeros_like(depth), where=depth > 0.0)
            clocks.append((slope, depth))
        scales = tuple(weights @ scale for scale in self._setting.scales)
        setting = Setting.before(test, self.problem.settings.loss)
        emulator = replace(self.emulator, mean=mean, modes=modes)
        return emulator, replace(setting, clocks=tuple(clocks), scales=scales)

    def readings(self, x: FloatArray, test: Experiment) -> FloatArray:
        """Return the readings (s, n) of a test at draws (s, m + bodies)."""
        return self.reading(test)[0](x[:, : self.m])

    def update(self, test: Experiment) -> Specimen:
        """Return the draws by the readings of a test."""
        specimen = self._weighed(test, self.reading(test)[1], self.before)
        if needs_middle(self.problem):  # which these draws tell
            x = specimen.unknowns
            middle, loss = self.readings(x, test).mean(axis=0), self.problem.settings.loss
            specimen = self._weighed(test, specimen.likelihood.adapted(middle, loss), x)
        return specimen

    def _weighed(self, test: Experiment, setting: Setting, typical: FloatArray) -> Specimen:
        """Return the draws by the readings of a test, whose random wear is as of typical draws."""
        shares = np.exp(np.median(typical[:, self.m :], axis=0))
        likelihood = TestLikelihood(test, setting, shares)
        emulated = EmulatedLikelihood(likelihood, self.reading(test)[0])
        random = np.random.default_rng(self._seed + 1)
        x, left = self.before, 1.0
        while left:
            coordinates = self.emulator.coordinates(x[:, : self.m])
            log_p = emulated(coordinates, np.exp(x[:, self.m :]))
            power, weights = left, softmax(left * log_p)
            while 1.0 / (weights @ weights) < _ENOUGH * len(x):
                power *= _LESS
                weights = softmax(power * log_p)
            left -= power
            if left:
                x = self._made_anew(x, weights, random)
        # each as often as it weighs
        rows = np.searchsorted(np.cumsum(weights), (np.arange(len(x)) + 0.5) / len(x))
        return Specimen(x[rows], likelihood)

    def _made_anew(
        self, x: FloatArray, weights: FloatArray, random: np.random.Generator
    ) -> FloatArray:
        """Return draws about weighed ones (s, m + bodies), which shrink to their mean before."""
        count, d = self.before.shape
        mean, rows = weights @ x, random.choice(len(x), count, p=weights)
        covariance = np.cov(x.T, aweights=weights).reshape(d, d) + _EXACT * np.eye(d)
        width = _WIDTH * (weights @ weights) ** (1.0 / (4.0 + d))
        step = random.standard_normal((count, d)) @ np.linalg.cholesky(covariance).T
        x = mean + np.sqrt(1.0 - width**2) * (x[rows] - mean) + width * step
        x[:, : self.m] = reflected(x[:, : self.m], *self.problem.unknown_bounds)
        x[:, self.m :] = np.clip(x[:, self.m :], *LOG_SHARES)
        return x[self.emulator.holds(x[:, : self.m])]

    def likelihood_like(self, specimen: Specimen, test: Experiment) -> TestLikelihood:
        """Return the likelihood of other readings, whose noise is that of the specimen's."""
        old = specimen.likelihood
        known = {
            s.name: np.median(old.setting.sd[part] / s.sd) for s, part in records(old.test.series)
        }
        sd = [known.get(s.name, 1.0) * s.sd for s in test.series]
        setting = replace(self.reading(test)[1], sd=np.concatenate(sd))
        return TestLikelihood(test, setting, old.shares)

    def followed(self, test: Experiment) -> tuple[list[Specimen], dict[str, float] | None]:
        """Return the draws at the ends of windows and now, or until an alarm, and the alarm."""
        times, end, specimens = test.times, test.case.time.end, list[Specimen]()
        ends = end * np.arange(1, _WINDOWS + 1) / _WINDOWS
        for until in (*ends[ends <= times.max() * (1.0 + 1e-9)], np.inf):
            part = part_of(test, times <= until * (1.0 + 1e-9))
            if part.n == (specimens[-1].likelihood.test.n if specimens else 0):
                continue
            content = pickle.dumps(part.series)
            if (found := self.windows.get(content)) is None:
                later = self.update(part)
                found = later, self._surprise(specimens[-1], later) if specimens else 1.0
            if until <= end:
                self.windows[content] = found
                if found[1] < _IMPROBABLE:
                    first = times[times > specimens[-1].likelihood.test.times.max()].min()
                    return specimens, {"time": float(first), "probability": found[1]}
            specimens.append(found[0])
        return specimens, None

    def _surprise(self, before: Specimen, after: Specimen) -> float:
        """Return how probable new readings are that leave the model of old ones by so much.

        The least sum of squares over histories, nuisances and growth times is larger with the new
        ones by chi squared of as many degrees of freedom: by the squares of recursive residuals
        (Brown, Durbin and Evans 1975). Draws are by the old readings before, and by all after.
        """
        old, both = before.likelihood, after.likelihood
        if self.problem.settings.loss == "gaussian":  # whose noise does not tell outliers
            both = self.likelihood_like(before, after.likelihood.test)
        square = self._least_squares(both, after) - self._least_squares(old, before)
        readings, more = (sum(noise.freedom for noise in of.noises) for of in (old, both))
        new = max(more - readings, 1.0)
        fitted = (s.n - len(s.nuisances) - self.m for s in old.test.series if s.sd_fitted)
        return float(fdtrc(new, max(min(fitted, default=_KNOWN), 1.0), max(square, 0.0) / new))

    def _least_squares(self, likelihood: TestLikelihood, specimen: Specimen) -> float:
        """Return the least sum of squares of readings, and of priors, over some draws."""
        x = specimen.some
        off = x[:, : self.m] - self.before[:, : self.m].mean(axis=0)
        prior = ((off @ self.precision) * off).sum(axis=1)
        squares = likelihood.least_squares(self.readings(x, likelihood.test))
        return float((prior + squares.sum(axis=0)).min())

    def time_to_goal(
        self, specimen: Specimen, key: int, ratio: float
    ) -> tuple[float | None, float]:
        """Return when the sd of a key is so much less, s, or None; and how much less at the end.

        Records go on at their rate; histories are linear in the keys, by regression on the draws.
        The ratio is of the sd of key number ``key`` that is wished over that by the readings now.
        """
        test, x, sds = specimen.likelihood.test, specimen.unknowns[:, : self.m], []
        end = test.case.time.end
        planned = replace(test, series=tuple(_to_end(series, end) for series in test.series))
        emulator = self.reading(planned)[0]
        slopes = np.linalg.lstsq(x - x.mean(axis=0), emulator.coordinates(x), rcond=None)[0]
        jacobian = (slopes @ emulator.modes).T
        at = np.linspace(test.times.max(), end, _TIMES)
        for time in at:
            known = planned.times <= time * (1.0 + 1e-9)
            information = self.precision
            for noise in self.likelihood_like(specimen, part_of(planned, known)).noises:
                middle, rows = len(noise.nuisances.times) // 2, jacobian[known][noise.rows]
                information = information + noise.reduced(rows, 0.0).grams()[middle]
            sds.append(np.sqrt(np.linalg.pinv(information, hermitian=True)[key, key]))
        less = np.minimum.accumulate(sds) / sds[0]
        reached = None if less[-1] > ratio else float(np.interp(-ratio, -less, at))
        return reached, float(less[-1])

    def penetrations(self, specimen: Specimen) -> FloatArray:
        """Return this specimen's penetration (draws, steps) to the end of the test, mm.

        Wear that is random goes on from what readings tell of it, as if nothing were read later.
        """
        test, time, x = specimen.likelihood.test, self.time, specimen.some
        later = Series("approach", "approach", time, 0.0 * time, np.full(len(time), _UNREAD))
        both = replace(test, series=(*test.series, later))
        likelihood, readings = self.likelihood_like(specimen, both), self.readings(x, both)
        worn = with_all(likelihood, readings, np.random.default_rng(1))[1]
        approach = (readings + worn @ self.most)[:, test.n :]
        depths: FloatArray = approach - approach[:, :1]
        return depths


def part_of(test: Experiment, rows: BoolArray) -> Experiment:
    """Return a test with some of its readings (n,)."""
    parts = [series.part(rows[place]) for series, place in records(test.series)]
    return replace(test, series=tuple(part for part in parts if part.n))


def _to_end(series: Series, end: float) -> Series:
    """Return a record that goes on at its rate to the end of the test; what is read once stays."""
    if series.profile or series.n < 2 or series.censored is not None:
        return series
    apart = float(np.median(np.diff(series.x)))
    x = np.append(series.x, np.arange(series.x[-1] + apart, end * (1.0 + 1e-9), apart))
    # their values are those of the last one: only noise and times count
    longer = series.part(np.minimum(np.arange(len(x)), series.n - 1))
    return averaged(replace(longer, x=x), end)


def _plan(test: Experiment, bodies: Sequence[str]) -> Experiment:
    """Return a test whose readings over time are at all steps, its approach and volumes too."""
    times, quantities = np.append(0.0, step_times(test)), ["approach"]
    quantities += [f"volume.{body}" for body in bodies]
    none, sd = np.zeros(len(times)), np.ones(len(times))
    series = [Series(quantity, quantity, times, none, sd) for quantity in quantities]
    series += [
        Series(s.name, s.quantity, times, none, sd, density=s.density) if s.timed else s
        for s in test.series
    ]
    return replace(test, series=tuple(series))


def _emulated(readings: Readings, x: FloatArray) -> tuple[Emulator, Setting]:
    """Return the emulator and the setting of the one test of ``readings``, at draws (s, m)."""
    problem, (plan,) = readings.problem, readings.problem.experiments
    count, unread = min(_HISTORIES * x.shape[1], _MOST_HISTORIES), [Setting.before(plan)]
    middle, no_shares = np.median(x, axis=0)[None], np.zeros(len(problem.settings.process))
    (setting,) = settings_at(readings, unread, middle, no_shares)
    box = Box.about(x, *problem.unknown_bounds, _MARGIN)
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
    emulator, _ = emulate(box, points, y, _SCALE * sd, np.ones(good.sum()), _CLOSE)
    return emulator, setting
