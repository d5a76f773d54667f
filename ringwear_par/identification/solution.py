"""The posterior of a problem, from outside in: emulators of its tests, and draws.

The first draws are all over the bounds. In each round, emulators are made in the boxes of the
draws, and the likelihood is taken to the power up to which they are right; the new draws are nearer
together, and so are the emulators, until the power is 1. Starting from a mode instead would miss
what lies beyond the box about it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.emulator import Box, Emulator, emulate, nearness
from ringwear_par.identification.funnel import Funnel
from ringwear_par.identification.histories import HistoryError, Readings, cases_at
from ringwear_par.identification.likelihood import EmulatedLikelihood, Setting, TestLikelihood
from ringwear_par.identification.posterior import Layout, Posterior
from ringwear_par.identification.sampling import draw, log_evidence
from ringwear_par.identification.setting import needs_middle, random_wear, settings_at

#: draws at first; points that fill the box of an emulator, and more for each key; draws that have
#: true histories, a round
_FIRST, _FILLING, _A_KEY, _TRIED = 2048, 32, 16, 40
#: margin of a box, as a share of its edges; it doubles while draws are at faces
_MARGIN = 0.1
#: factor by which the power may grow in a round, and power that the first round may reach
_LEAP, _FIRST_LEAP = 100.0, 0.01
#: sd of the error of log p that says that the draws have gone astray
_ASTRAY = 3.0
#: rms error of a reading, in its sd, that is good enough
_GOOD = 0.005
#: rounds in all, and with the whole likelihood
_MOST_ROUNDS, _MOST_WHOLE = 20, 6
#: sd of the error of log p, among draws, that is good enough, and that moves no key by more than
#: 0.2 sd where steps are halved; share of draws at faces of boxes
_RIGHT, _MOST_SHIFT, _AT_FACES = 0.1, 0.15, 2e-3
#: share of the draws without a history that is small enough; draws of which none may be no case
_LOST, _CHECKED = 0.03, 4000
#: effective number of draws while emulators are checked
_SOME = 1000.0
#: largest error of log p by the power, in rms
_TRUST = 0.3
#: draws that are weighed by true histories where emulators cannot follow, and how many must count
_WEIGHED, _LEAST = 1000, 100.0


@dataclass(frozen=True, eq=False)
class Solution:
    """Draws of the posterior of a problem."""

    #: with friction as torques tell it at the middle of the draws
    problem: Problem
    posterior: Posterior
    #: (s, d), see ``Layout``; states of the sampler one after another
    theta: FloatArray
    #: effective number of draws
    effective: float
    #: of the largest posterior, sizes at their medians, (d,)
    best: FloatArray
    log_evidence: float
    evidence_error: float
    #: (bodies,) mm, largest mean depth of the bodies whose wear is random
    depths: FloatArray
    #: sd of the error of log p among draws: by emulators; and by time steps
    emulator_error: float
    step_error: float
    #: number of steps of a test
    steps: int
    #: computed, failed, and why the first one did
    histories: int
    failed: int
    reason: str
    #: sentence about draws that were weighed by true histories, as emulators could not follow; ""
    weighed: str = ""


def solve(readings: Readings, seed: int = 0, wanted: float = 4000.0) -> Solution:
    """Return draws of the posterior of ``readings.problem``. On the first rank, within ``lead``.

    Parameters
    ----------
    wanted : effective number of draws.

    Raises
    ------
    ComputationError : no histories, or neither emulators nor draws that can follow them.
    """
    search, whole = _Search(readings, seed), 0
    for number in range(_MOST_ROUNDS):
        readings.tell(f"round {number + 1}, likelihood to the power {search.power:.2g}")
        tried = search.try_draws()
        if not search.settled:
            search.adapt(tried, first=not number)
        elif search.power == 1.0:
            whole += 1
            if search.is_right(tried) or whole == _MOST_WHOLE:
                break
        search.emulate(tried)
        search.draw(_SOME * (search.power == 1.0))
    # draws so far tell coordinates and neighbourhoods in which these are easy
    readings.tell("draws of the posterior")
    search.draw(wanted)
    return search.solution()


@dataclass(eq=False)
class _Tried:
    """Draws (P,) with true histories: unknowns (P, tests, m), and readings (P, n) of each test."""

    x: FloatArray
    readings: list[FloatArray]


class _Search:
    """Draws that come nearer to the posterior, and emulators about them."""

    def __init__(self, readings: Readings, seed: int) -> None:
        self.readings, self._layout = readings, Layout(readings.problem)
        self._random = np.random.default_rng(seed)
        problem, bodies = readings.problem, len(self._layout.share_places)
        self._tests = range(len(problem.experiments))
        self._settings = [
            Setting.before(test, problem.settings.loss, bodies) for test in problem.experiments
        ]
        #: whether the settings are those of where the draws are
        self.settled = not needs_middle(problem)
        self.power, self.effective = 0.0, 0.0
        self._draws = self._layout.anywhere(_FIRST, self._random)
        self._density = self._layout.log_prior(self._draws)
        self._emulators: list[Emulator] = []
        #: points and readings there, by the number of the first test of equal ones
        self._known: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._likelihoods = self._at_settings()
        self._error = self._step_error = np.inf
        self._margin = _MARGIN
        #: power, draws and their density before the whole likelihood was taken
        self._before = self.power, self._draws, self._density
        #: number of the test whose emulator has the largest error
        self._worst = 0

    @property
    def _x(self) -> FloatArray:
        """(s, tests, m) unknowns of the draws."""
        return self._layout.of_tests(self._draws)

    @property
    def _shares(self) -> FloatArray:
        """(bodies,) shares of random wear in the middle of the draws."""
        known = self._settings[0].shares
        middle: FloatArray = np.median(self._layout.shares(self._draws, known), axis=0)
        return np.nan_to_num(middle)

    def _at_settings(self) -> list[TestLikelihood]:
        pairs = zip(self.readings.problem.experiments, self._settings, strict=True)
        return [TestLikelihood(test, setting, self._shares) for test, setting in pairs]

    def _log_p(self, every: Sequence[FloatArray]) -> FloatArray:
        """Return log p (tests, P) by the readings (P, n) of all, NaN without a history."""
        return np.array([f(y) for f, y in zip(self._likelihoods, every, strict=True)])

    def _read(self, x: FloatArray, *, finer: int = 1) -> list[FloatArray]:
        """Return readings (P, n) of all tests at unknowns (P, tests, m), by histories."""
        readings = self.readings
        return readings([(i, x[:, i]) for i in self._tests], steps=finer * readings.steps)

    def _emulated(self, x: FloatArray) -> list[FloatArray]:
        """Return readings (P, n) of all tests at unknowns (P, tests, m), by emulators."""
        return [emulator(x[:, i]) for i, emulator in enumerate(self._emulators)]

    def try_draws(self) -> _Tried:
        """Return some of the draws with their histories."""
        some = self._random.permutation(np.unique(self._draws, axis=0))[:_TRIED]
        x = self._layout.of_tests(some)
        tried = _Tried(x, self._read(x))
        if not np.isfinite(np.concatenate(tried.readings, axis=1)).all(axis=1).any():
            name, reason = self.readings.problem.name, self.readings.reason
            raise ComputationError(f"{name}: no history at any draw: {reason}")
        return tried

    def adapt(self, tried: _Tried, *, first: bool) -> None:
        """Take the settings from the middle of the draws, or from the best one tried.

        From that one at first, as it wears, which the middle of the bounds may not, and where the
        middle has no history.
        """
        x, readings = self._x, self.readings
        middle = np.median(x, axis=0)
        if first or not np.isfinite(np.concatenate(self._read(middle[None]), axis=1)).all():
            middle = tried.x[np.nanargmax(self._log_p(tried.readings).sum(axis=0))]
        before, problem = self._settings, readings.problem
        if self._emulators:
            some = self._emulated(x[:: max(1, len(x) // 256)])
            self._settings = [
                likelihood.with_times_that_count(y)
                for likelihood, y in zip(self._at_settings(), some, strict=True)
            ]
        self._settings = settings_at(readings, self._settings, middle, self._shares, first=first)
        self.settled = self.power == 1.0 and all(map(_are_close, before, self._settings))
        self._likelihoods = self._at_settings()
        if readings.problem is not problem:  # friction changed
            self._known = {}
            tried.readings = self._read(tried.x)

    def is_right(self, tried: _Tried) -> bool:
        """Tell whether emulators and time steps are right where the draws are."""
        true = self._log_p(tried.readings)
        off = true - self._log_p(self._emulated(tried.x))
        self._error = float(np.nanstd(off.sum(axis=0)))
        self._worst = int(np.argmax(np.nanstd(off, axis=1)))
        x = self._x
        at_faces = max(
            (np.abs(self._emulators[i].box.inside(x[:, i])) > 0.97).any(axis=1).mean()
            for i in self._tests
        )
        self._margin = 2.0 * self._margin if at_faces >= _AT_FACES else _MARGIN
        if self._error > _ASTRAY:  # emulators know now what is there
            self.power, self._draws, self._density = self._before
        lost = np.isnan(off.sum(axis=0)).mean()
        if self._error >= _RIGHT or at_faces >= _AT_FACES or lost >= _LOST:
            return False
        finer = self._read(tried.x, finer=2)
        self._step_error = float(np.nanstd((self._log_p(finer) - true).sum(axis=0)))
        if self._step_error < _MOST_SHIFT:
            return True
        self.readings.steps, self._known, tried.readings = 2 * self.readings.steps, {}, finer
        return False

    def emulate(self, tried: _Tried) -> None:
        """Make emulators in the boxes of the draws, and find the power up to which they hold."""
        readings, problem, layout = self.readings, self.readings.problem, self._layout
        self._likelihoods = self._at_settings()
        same_as, x = readings.same_as, self._x
        members = {o: [i for i in self._tests if same_as[i] == o] for o in sorted({*same_as})}
        boxes = {
            o: Box.about(x[:, tests].reshape(-1, layout.m), layout.low, layout.high, self._margin)
            for o, tests in members.items()
        }
        filling = {o: box.design(_FILLING + _A_KEY * layout.m) for o, box in boxes.items()}
        filled = dict(zip(members, readings([*filling.items()]), strict=True))
        emulators, without = {}, [np.zeros(0)] * len(same_as)
        for o, tests in members.items():
            known_x, known_y = self._known.get(o, (filling[o][:0], filled[o][:0]))
            points = np.concatenate([*(tried.x[:, i] for i in tests), filling[o], known_x])
            every = np.concatenate([*(tried.readings[i] for i in tests), filled[o], known_y])
            inside = boxes[o].holds(points)
            inside[: len(tried.x) * len(tests)] = True
            points, every = points[inside], every[inside]
            self._known[o] = points, every
            good = np.isfinite(every).all(axis=1)
            if good.sum() < 2 * layout.m + 2:
                test, reason = problem.experiments[o].name, readings.reason
                raise ComputationError(f"{problem.name}: {test}: hardly any histories: {reason}")
            log_p = np.array([self._likelihoods[i](every[good]) for i in tests])
            distance = np.sqrt(2.0 * (log_p.max(axis=1, keepdims=True) - log_p)).min(axis=0)
            sd, near = self._settings[o].sd, nearness(distance)
            emulators[o], left_out = emulate(boxes[o], points, every, sd, near, _GOOD)
            for place, i in enumerate(tests):
                without[i] = left_out[place * len(tried.x) : (place + 1) * len(tried.x)]
        true = self._log_p(tried.readings).sum(axis=0)
        trusted = _trusted(true, self._log_p(without).sum(axis=0) - true, self.power)
        if self.power < 1.0:
            self._before = self.power, self._draws, self._density
        self.power = max(self.power, min(trusted, max(_LEAP * self.power, _FIRST_LEAP)))
        self._emulators = [emulators[o] for o in same_as]
        pairs = zip(self._likelihoods, self._emulators, strict=True)
        emulated = [EmulatedLikelihood(likelihood, emulator) for likelihood, emulator in pairs]
        self._posterior = Posterior(problem, emulated, self._settings[0].shares)

    def draw(self, want: float) -> None:
        """Draw anew, with the likelihood to the power; ``want`` so many effective draws."""
        self._draws, self._density, self.effective = _drawn(
            self._posterior, self._draws, self._density, self.power, self._random, want
        )

    def solution(self) -> Solution:
        """Return the draws, weighed by true histories where emulators cannot follow these."""
        weighed = "" if self.power == 1.0 and self._error < _RIGHT else self._weigh()
        readings, posterior = self.readings, self._posterior
        if readings.failed:
            self._keep_cases()
        evidence, evidence_error = log_evidence(posterior, self._draws)
        evidence += posterior.log_constant
        return Solution(
            readings.problem, posterior, self._draws, self.effective,
            mode(posterior, self._draws, self._density), evidence, evidence_error,
            random_wear(readings, np.median(self._x, axis=0))[1], self._error, self._step_error,
            readings.steps, readings.count, readings.failed, readings.reason, weighed,
        )  # fmt: skip

    def _keep_cases(self) -> None:
        """Keep only draws that the rules of cases and laws allow."""
        problem, count = self.readings.problem, min(_CHECKED, len(self._draws))
        rows = np.sort(self._random.choice(len(self._draws), count, replace=False))
        good = np.ones(count, dtype=bool)
        for i, test in enumerate(problem.experiments):
            x = self._layout.of_tests(self._draws[rows])[:, i]
            values = np.array([problem.values(row) for row in x])
            found = cases_at(test.case, problem.keys, values)
            good &= [not isinstance(case, HistoryError) for case in found]
        self._draws, self._density = self._draws[rows[good]], self._density[rows[good]]

    def _weigh(self) -> str:
        """Weigh draws by true histories and say so, or ComputationError where few count."""
        problem, random = self.readings.problem, self._random
        rows = random.choice(len(self._draws), _WEIGHED, replace=False)
        x = self._layout.of_tests(self._draws[rows])
        true, emulated = (self._log_p(y).sum(axis=0) for y in (self._read(x), self._emulated(x)))
        logs = true - self.power * emulated
        logs[~np.isfinite(logs)] = -np.inf
        weights = np.exp(logs - logsumexp(logs))
        self.effective = float(1.0 / (weights @ weights))
        table = np.column_stack([np.minimum(np.abs(logs), 1e3), x.mean(axis=1)])
        with np.errstate(divide="ignore", invalid="ignore"):  # where all are alike
            along = np.nan_to_num(np.corrcoef(table.T)[0, 1:])
        key = problem.keys[int(np.argmax(np.abs(along)))]
        sentence = (
            f"readings of {problem.experiments[self._worst].name} do not follow {key} smoothly: "
            f"draws were weighed by {_WEIGHED} histories, and are worth {self.effective:.0f}"
        )
        if not self.effective > _LEAST:
            raise ComputationError(
                f"{problem.name}: {sentence}; narrower bounds of {key}, or a prior, would help"
            )
        chosen = rows[random.choice(_WEIGHED, 4 * _WEIGHED, p=weights)]
        self._draws, self._density = self._draws[chosen], self._density[chosen]
        return sentence


def _drawn(
    posterior: Posterior,
    draws: FloatArray,
    density: FloatArray,
    power: float,
    random: np.random.Generator,
    want: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Return draws of a posterior, see ``draw``, in coordinates without funnels.

    A few draws first, where many are wanted, tell better coordinates.
    """
    if want:
        draws, density, _ = _drawn(posterior, draws, density, power, random, 0.0)
    funnel = Funnel(posterior, draws)

    def log_p(flat: FloatArray, power: float) -> FloatArray:
        theta, volume = funnel.theta(flat)
        return posterior(theta, power) + volume

    flat = funnel.flat(draws)
    flat, logs, effective = draw(log_p, flat, density + funnel.theta(flat)[1], power, random, want)
    theta, volume = funnel.theta(flat)
    return theta, logs - volume, effective


def _are_close(before: Setting, after: Setting) -> bool:
    """Tell whether two settings are so near that likelihoods do not differ."""
    if np.abs(np.log(after.sd / before.sd)).max() > 0.05 or len(before.clocks) < len(after.clocks):
        return False
    times = all(
        np.abs(np.subtract(before.times[i], ends)).max() < 0.25 * (ends[1] - ends[0])
        for i, ends in after.times.items()
    )
    return times and all(
        np.abs(new - old).max() <= 0.2 * np.abs(old).max()
        for (new, _), (old, _) in zip(after.clocks, before.clocks, strict=True)
    )


def _trusted(true: FloatArray, off: FloatArray, power: float) -> float:
    """Return the largest power of the likelihood at which errors of log p do no harm.

    Errors may be half of what log p is less than the largest; a quarter of the draws must count
    for it, unless the best quarter has no errors at all.

    Parameters
    ----------
    true, off : (P,) log p at draws by another power, and its errors.
    """
    good = np.isfinite(true) & np.isfinite(off)
    true, off = true[good] - true[good].max(), off[good]
    known = off[true >= np.quantile(true, 0.75)].std()
    for new in 0.8 ** np.arange(150):
        w = np.exp((new - power) * true - ((new - power) * true).max())
        w /= w.sum()
        wrong = np.maximum(np.abs(off - w @ off) + 0.5 * true, 0.0)
        counts = new * known < _TRUST or 1.0 / (w @ w) > 0.25 * len(w)
        if counts and new * np.sqrt(w @ wrong**2) < _TRUST:
            break
    return float(new)


def mode(posterior: Posterior, theta: FloatArray, density: FloatArray) -> FloatArray:
    """Return theta (d,) of the largest posterior where sizes are at their medians.

    With sizes free, it has no largest: they vanish where all specimens are alike.
    """
    sizes = [place for place, _ in posterior.sizes]
    best = theta[np.argmax(density)].copy()
    best[sizes] = np.median(theta[:, sizes], axis=0)
    free = [i for i in range(len(best)) if i not in sizes]
    scale = theta[:, free].std(axis=0)
    scale[scale == 0.0] = 1.0
    step = 1e-4

    def minus_log_p(t: FloatArray) -> tuple[float, FloatArray]:
        points = np.tile(best, (1 + 2 * len(free), 1))
        moved = np.vstack(
            [np.zeros(len(free)), step * np.eye(len(free)), -step * np.eye(len(free))]
        )
        points[:, free] = best[free] + scale * (t + moved)
        logs = np.maximum(posterior(points), -1e10)
        slope = (logs[1 : len(free) + 1] - logs[len(free) + 1 :]) / (2.0 * step)
        return -float(logs[0]), -np.where(np.abs(slope) < 1e6, slope, 0.0)

    found = minimize(minus_log_p, np.zeros(len(free)), jac=True, method="L-BFGS-B")
    start = minus_log_p(np.zeros(len(free)))[0]
    if found.fun < start:
        best[free] += scale * found.x
    return best
