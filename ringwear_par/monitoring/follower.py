"""What the readings of a running test say of its specimen: a fit's draws, weighed by them.

Polynomials of the keys tell its histories at the ends of steps; readings, whenever they come, lie
between these. Readings weigh the draws by the likelihood of fits, at once or, where that would
leave few, by one power of it after another: after each, draws are made anew about those that are
left, by normal kernels that keep mean and covariance (Liu and West 2001, in Sequential Monte Carlo
Methods in Practice, 197-223). All of it starts from the draws before the test, whatever was asked
before.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from ringwear_par.arrays import FloatArray
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
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.emulator import Box, Emulator, emulate
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.likelihood import (
    LOG_SHARES,
    EmulatedLikelihood,
    TestLikelihood,
)
from ringwear_par.identification.noise import Setting
from ringwear_par.identification.readings import interpolation
from ringwear_par.identification.setting import needs_middle, settings_at

#: histories that polynomials are made of, for each fitted key and most; margin of their box
_HISTORIES, _MOST_HISTORIES, _MARGIN = 128, 448, 0.1
#: scale of a quantity over its spread, and error of polynomials in it that is small enough
_SCALE, _CLOSE = 1e-3, 0.03
#: share of random wear where clocks are found, which hardly depend on it
_TYPICAL_SHARE = 0.05
#: effective share of the draws that is enough; factor between powers that are tried
_ENOUGH, _LESS = 0.1, 0.8
#: width of kernels over the best one of a normal density; variance of what is known exactly
_WIDTH, _EXACT = 0.5, 1e-12


@dataclass(frozen=True, eq=False)
class Specimen:
    """Draws (s,) of the keys of the specimen under test, by its readings."""

    #: (s, m + bodies) unknowns, and logarithms of the sizes of random wear
    unknowns: FloatArray
    #: (s, 1 + r) 1 and the coordinates of their histories
    v: FloatArray
    #: (bodies,) rms share of random wear
    shares: FloatArray
    #: of the readings, at these shares
    likelihood: TestLikelihood

    @property
    def test(self) -> Experiment:
        """The test, with these readings."""
        return self.likelihood.test

    def some(self, count: int) -> "Specimen":
        """Return about so many of the draws."""
        rows = slice(None, None, max(1, len(self.v) // count))
        return replace(self, unknowns=self.unknowns[rows], v=self.v[rows])


class Follower:
    """What is known of the specimen of a running test, at any of its readings.

    On the first rank, within ``Readings.lead``. Raises ComputationError where hardly any draw has a
    history.

    Parameters
    ----------
    draws : of the fit before.
    of : the next specimen, or one of the fit's.
    problem : of the running test.
    count, seed : number of draws, and their seed.
    """

    def __init__(
        self,
        draws: Draws,
        of: str,
        problem: Problem,
        readings: Readings,
        count: int,
        seed: int,
    ) -> None:
        values, sizes = draws.values(of, count, np.random.default_rng(seed))
        x = problem.unknowns(values)
        self.draws, self.of, self.problem, self._seed = draws, of, problem, seed
        #: draws at the end of a window, and how probable its readings were, by all until then
        self.windows: dict[bytes, tuple[Specimen, float]] = {}
        bodies = [body_of_wear(key) for key in problem.settings.process]
        self.m, (test,) = x.shape[1], problem.experiments
        plan = _plan(test, bodies)
        readings.problem = replace(problem, experiments=(plan,))
        #: of the readings of the plan; how these follow random wear and calibrations of inputs
        self.emulator, self.setting = _emulated(readings, x)
        #: (steps,) s, ends of steps, the start included
        self.time = plan.series[0].x
        #: readings (n, 1 + r) of the plan by 1 and the coordinates; where those of series are
        self.columns = np.column_stack([self.emulator.mean, self.emulator.modes.T])
        self.places = {series.name: part for series, part in records(plan.series)}
        sizes = np.log(sizes[:, [BODIES.index(body) for body in bodies]])
        #: (s, m + bodies) before the test, see ``Specimen``
        self.before = np.column_stack([x, sizes])[self.emulator.holds(x)]
        self._v = self._coordinates(self.before)
        # (bodies, 1 + r) mm, worn at the end of the test
        ends = [self.places[f"volume.{body}"].stop - 1 for body in bodies]
        self._depths = self.columns[ends] / test.case.area
        #: (bodies,) mm, worn at the end at the middle of the draws, to which shares are relative
        self.most = self._depths @ self._coordinates(np.median(x, axis=0)[None])[0]

    def _coordinates(self, x: FloatArray) -> FloatArray:
        return np.insert(self.emulator.coordinates(x[:, : self.m]), 0, 1.0, axis=1)

    def _shares(self, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return the shares (s, bodies) of random wear: by its size, and the depth of the draw."""
        sizes, depths = np.exp(x[:, self.m :]), np.maximum(v @ self._depths.T, 0.0)
        return np.clip(np.sqrt(sizes * depths) / self.most, *np.exp(LOG_SHARES))

    def weights(self, test: Experiment) -> FloatArray:
        """Return what readings (n,) of a test are of those of the plan, (n, n of the plan)."""
        breaks = (0.0, *test.case.breakpoints, test.case.time.end)
        weights = np.zeros((test.n, len(self.columns)))
        for series, rows in records(test.series):
            part = interpolation(self.time, series.x, breaks) if series.timed else np.eye(series.n)
            weights[rows, self.places[series.name]] = part
        return weights

    def readings(self, specimen: Specimen, test: Experiment) -> FloatArray:
        """Return the readings (s, n) of a test by the draws of a specimen."""
        return specimen.v @ (self.weights(test) @ self.columns).T

    def _setting_of(self, test: Experiment, loss: Loss) -> Setting:
        """Return the setting of a test before its readings are looked at."""
        clocks, weights = [], self.weights(test)
        for felt, share in self.setting.clocks:
            depth = np.interp(test.times, self.time, share[: len(self.time)])
            answer = weights @ (felt * share)
            slope = np.divide(answer, depth, out=np.zeros_like(depth), where=depth > 0.0)
            clocks.append((slope, depth))
        scales = tuple(weights @ scale for scale in self.setting.scales)
        before = Setting.before(test, loss)
        return replace(before, clocks=tuple(clocks), scales=scales)

    def update(self, test: Experiment) -> Specimen:
        """Return the draws by the readings of a test."""
        loss, shares = self.problem.settings.loss, _rms(self._shares(self.before, self._v))
        specimen = self._weighed(TestLikelihood(test, self._setting_of(test, loss), shares))
        if needs_middle(self.problem):  # which these draws tell
            middle = self.readings(specimen, test).mean(axis=0)
            setting = specimen.likelihood.adapted(middle, loss)
            specimen = self._weighed(TestLikelihood(test, setting, specimen.shares))
        return specimen

    def _weighed(self, likelihood: TestLikelihood) -> Specimen:
        """Return the draws by a likelihood."""
        both = self.weights(likelihood.test) @ self.columns
        emulator = replace(self.emulator, mean=both[:, 0], modes=both[:, 1:].T)
        emulated = EmulatedLikelihood(likelihood, emulator)
        random = np.random.default_rng(self._seed + 1)
        x, v, left = self.before, self._v, 1.0
        while left:
            log_p = emulated(v[:, 1:], self._shares(x, v))
            power, weights = left, softmax(left * log_p)
            while 1.0 / (weights @ weights) < _ENOUGH * len(x):
                power *= _LESS
                weights = softmax(power * log_p)
            left -= power
            if left:
                x = self._made_anew(x, weights, random)
                v = self._coordinates(x)
        # each as often as it weighs
        rows = np.searchsorted(np.cumsum(weights), (np.arange(len(x)) + 0.5) / len(x))
        x, v = x[rows], v[rows]
        return Specimen(x, v, _rms(self._shares(x, v)), likelihood)

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
        return x[self.emulator.holds(x[:, : self.m])]

    def likelihood_like(self, specimen: Specimen, test: Experiment) -> TestLikelihood:
        """Return the likelihood of other readings, whose noise is that of the specimen's."""
        old = specimen.likelihood
        known = {
            s.name: np.median(old.setting.sd[part] / s.sd) for s, part in records(old.test.series)
        }
        sd = [known.get(s.name, 1.0) * s.sd for s in test.series]
        setting = replace(self._setting_of(test, "gaussian"), sd=np.concatenate(sd))
        return TestLikelihood(test, setting, specimen.shares)


def _plan(test: Experiment, bodies: Sequence[str]) -> Experiment:
    """Return a test whose readings over time are at all steps, its approach and volumes too."""
    times = np.append(0.0, step_times(test))
    quantities = ("approach", *(f"volume.{body}" for body in bodies))
    always = [(quantity, quantity, 1.0) for quantity in quantities]
    timed = [(s.name, s.quantity, s.density) for s in test.series if s.timed]
    at_steps = {
        name: Series(name, quantity, times, 0.0 * times, 0.0 * times + 1.0, density=density)
        for name, quantity, density in (*always, *timed)
    }
    return replace(test, series=(*at_steps.values(), *(s for s in test.series if not s.timed)))


def _emulated(readings: Readings, x: FloatArray) -> tuple[Emulator, Setting]:
    """Return the emulator and the setting of the one test of ``readings``, at draws (s, m)."""
    problem, (plan,) = readings.problem, readings.problem.experiments
    bodies, count = len(problem.settings.process), min(_HISTORIES * x.shape[1], _MOST_HISTORIES)
    settings = [Setting.before(plan)]
    if needs_middle(problem):
        middle, shares = np.median(x, axis=0)[None], np.full(bodies, _TYPICAL_SHARE)
        settings = settings_at(readings, settings, middle, shares)
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
    return emulator, settings[0]


def _rms(shares: FloatArray) -> FloatArray:
    rms: FloatArray = np.sqrt(np.square(shares).mean(axis=0))
    return rms
