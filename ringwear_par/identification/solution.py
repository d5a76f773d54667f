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

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.emulator import Box, Emulator, emulate, nearness
from ringwear_par.identification.histories import Readings, cases_at
from ringwear_par.identification.likelihood import EmulatedLikelihood, TestLikelihood
from ringwear_par.identification.noise import Setting
from ringwear_par.identification.posterior import Posterior
from ringwear_par.identification.sampling import Drawn, draw, many_for
from ringwear_par.identification.setting import needs_middle, random_wear, settings_at

#: draws at first; draws that have true histories, a round, and how many of them count most; points
#: that fill the box of an emulator, for each key
_FIRST, _TRIED, _HEAVY, _FILLING = 2048, 48, 12, 24
#: margin of a box, as a share of its edges
_MARGIN = 0.15
#: factor by which the power may grow in a round, and power that the first round may reach
_LEAP, _FIRST_LEAP = 100.0, 0.01
#: rms error of a reading, in its sd, that is good enough
_GOOD = 0.005
#: rounds in all, and with the whole likelihood
_MOST_ROUNDS, _MOST_WHOLE = 20, 6
#: sd of the error of log p, among draws, that is good enough; that of steps, which moves no key by
#: more than 0.2 sd; share of draws at faces of boxes
_RIGHT, _MOST_SHIFT, _AT_FACES = 0.1, 0.15, 3e-4
#: ends of intervals, which move by less than that, in sd, as emulators are made anew
_ENDS, _SETTLED = (0.025, 0.975), 0.15
#: effective number of draws that lead to others
_SOME = 1000.0
#: sd of the error of log p above which draws say nothing
_ASTRAY = 3.0
#: share of the draws without a history that is small enough; draws of which none may be no case
_LOST, _CHECKED = 0.03, 4000
#: difference of theta, in sd of the draws, by which slopes of log p are found
_MOVED = 1e-4
#: largest error of log p by the power, in rms; share of the draws that must count for it
_TRUST, _COUNT = 0.3, 0.0625


@dataclass(frozen=True, eq=False)
class Solution:
    """Draws of the posterior of a problem."""

    #: with friction as torques tell it at the middle of the draws
    problem: Problem
    posterior: Posterior
    #: (s, d), see ``Posterior``, in no order
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


def solve(readings: Readings, seed: int = 0, wanted: float = 4000.0) -> Solution:
    """Return draws of the posterior of ``readings.problem``. On the first rank, within ``lead``.

    Parameters
    ----------
    wanted : effective number of draws.

    Raises
    ------
    ComputationError : no histories, or no emulators that can follow them.
    """
    search, whole = _Search(readings, seed), 0
    for number in range(_MOST_ROUNDS):
        readings.tell(f"round {number + 1}, likelihood to the power {search.power:.2g}")
        search.read(adapt=number > 0)
        if search.power == 1.0:
            whole, steps = whole + 1, readings.steps
            # the first emulators for it are of wider boxes, at whose faces they err
            right = whole > 1 and search.is_right()
            if readings.steps > steps:  # histories of finer steps need emulators anew
                whole = 0
            elif right or whole == _MOST_WHOLE:
                break
        search.emulate()
        search.draw(wanted if search.power == 1.0 else _SOME)
    return search.solution()


class _Search:
    """Draws that come nearer to the posterior, and emulators about them."""

    def __init__(self, readings: Readings, seed: int) -> None:
        self.readings, self._random = readings, np.random.default_rng(seed)
        problem, prior = readings.problem, Posterior(readings.problem)
        loss, tests = problem.settings.loss, problem.experiments
        self._settings = [Setting.before(test, loss) for test in tests]
        self.power, draws = 0.0, prior.anywhere(_FIRST * many_for(prior.dimension), self._random)
        self._drawn = Drawn(draws, prior.log_prior(draws), 0.0, 0.0, 0.0)
        #: tests with an emulator of their own, by number, and those that are like each
        self._members: dict[int, list[int]] = {}
        for i, owner in enumerate(readings.same_as):
            self._members.setdefault(owner, []).append(i)
        #: points (P, m) with readings (P, n) of each of these
        self._known: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._error = self._step_error = np.inf
        #: number of the test whose emulator has the largest error
        self._worst = 0

    def _log_p(self, every: Sequence[FloatArray]) -> FloatArray:
        """Return log p (tests, P) by the readings (P, n) of all, NaN without a history."""
        return np.array([f(y) for f, y in zip(self._likelihoods, every, strict=True)])

    def _read(
        self, more: Sequence[tuple[int, FloatArray]] = (), *, finer: int = 1
    ) -> list[FloatArray]:
        """Return readings (P, n) of all tests at the draws that are tried, and of more points."""
        wanted = [(i, self._tried[:, i]) for i in range(self._tried.shape[1])]
        return self.readings([*wanted, *more], steps=finer * self.readings.steps)

    def read(self, *, adapt: bool) -> None:
        """Make boxes about the draws, and histories of some of the draws and of points there.

        What likelihoods take from where the draws are is taken anew at their middle.
        """
        readings, before = self.readings, self.readings.problem
        posterior = Posterior(before)
        x = posterior.of_tests(self._drawn.draws)
        if adapt and needs_middle(before):
            middle = np.median(x, axis=0)
            shares = np.median(posterior.shares(self._drawn.draws), axis=0)
            self._settings = settings_at(readings, self._settings, middle, shares)
            if readings.problem.experiments is not before.experiments:  # friction changed
                self._known = {}
        problem = readings.problem
        shares = np.median(Posterior(problem).shares(self._drawn.draws), axis=0)
        pairs = zip(problem.experiments, self._settings, strict=True)
        self._likelihoods = [TestLikelihood(test, setting, shares) for test, setting in pairs]
        rows, counts = np.unique(self._drawn.draws, axis=0, return_counts=True)
        most = np.argsort(-counts)[:_HEAVY]  # perhaps by an error of emulators
        others = self._random.permutation(np.delete(rows, most, axis=0))
        some = np.concatenate([rows[most], others[: _TRIED - _HEAVY]])
        #: (P, tests, m) draws that have histories, and readings (P, n) of all tests there
        self._tried, m = posterior.of_tests(some), len(problem.parameters)
        self._boxes = {
            o: Box.about(x[:, tests].reshape(-1, m), *problem.unknown_bounds, _MARGIN)
            for o, tests in self._members.items()
        }
        filling = {o: box.design(_FILLING * m) for o, box in self._boxes.items()}
        blocks = self._read([*filling.items()])
        self._true, filled = blocks[: len(self._settings)], blocks[len(self._settings) :]
        if not np.isfinite(self._log_p(self._true).sum(axis=0)).any():
            raise ComputationError(f"{problem.name}: no history at any draw: {readings.reason}")
        for (o, tests), y in zip(self._members.items(), filled, strict=True):
            known = self._known.get(o, (filling[o][:0], y[:0]))
            points = np.concatenate([*(self._tried[:, i] for i in tests), filling[o], known[0]])
            every = np.concatenate([*(self._true[i] for i in tests), y, known[1]])
            inside = self._boxes[o].holds(points)
            inside[: len(some) * len(tests)] = True
            self._known[o] = points[inside], every[inside]

    def is_right(self) -> bool:
        """Tell whether log p, by emulators and time steps, is right where the draws are."""
        true = self._log_p(self._true)
        emulated = enumerate(self._posterior.likelihoods)
        off = true - [f.likelihood(f.emulator(self._tried[:, i])) for i, f in emulated]
        self._error = float(np.nanstd(off.sum(axis=0)))
        self._worst = int(np.argmax(np.nanstd(off, axis=1)))
        x = self._posterior.of_tests(self._drawn.draws)
        at_faces = max(
            (np.abs(f.emulator.box.inside(x[:, i])) > 0.97).any(axis=1).mean()
            for i, f in enumerate(self._posterior.likelihoods)
        )
        lost = np.isnan(off.sum(axis=0)).mean()
        settled = at_faces < _AT_FACES and self._moved < _SETTLED
        if self._error >= _RIGHT or not settled or lost >= _LOST:
            return False
        finer = self._read(finer=2)
        self._step_error = float(np.nanstd((self._log_p(finer) - true).sum(axis=0)))
        if self._step_error < _MOST_SHIFT:
            return True
        self.readings.steps *= 2
        for o, tests in self._members.items():
            points = np.concatenate([self._tried[:, i] for i in tests])
            self._known[o] = points, np.concatenate([finer[i] for i in tests])
        self._true = finer
        return False

    def emulate(self) -> None:
        """Make emulators in the boxes, and find the power up to which they hold."""
        problem, count = self.readings.problem, len(self._tried)
        emulators: dict[int, Emulator] = {}
        without: dict[int, FloatArray] = {}
        for o, tests in self._members.items():
            points, every = self._known[o]
            good = np.isfinite(every).all(axis=1)
            if good.sum() < 2 * points.shape[1] + 2:
                test, reason = problem.experiments[o].name, self.readings.reason
                raise ComputationError(f"{problem.name}: {test}: hardly any histories: {reason}")
            log_p = np.array([self._likelihoods[i](every[good]) for i in tests])
            distance = np.sqrt(2.0 * (log_p.max(axis=1, keepdims=True) - log_p)).min(axis=0)
            sd, near = self._settings[o].sd, nearness(distance)
            emulators[o], left_out = emulate(self._boxes[o], points, every, sd, near, _GOOD)
            without |= {i: left_out[n * count : (n + 1) * count] for n, i in enumerate(tests)}
        true = self._log_p(self._true)
        off = self._log_p([without[i] for i in range(len(without))]) - true
        self._worst = int(np.argmax(np.nanstd(off, axis=1)))
        trusted = _trusted(true.sum(axis=0), off.sum(axis=0), self.power)
        trusted = min(trusted, max(_LEAP * self.power, _FIRST_LEAP))
        self.power = max(self.power, trusted)
        fitted = [i for i, p in enumerate(problem.settings.process.values()) if p.fitted]
        owners = zip(self._likelihoods, self.readings.same_as, strict=True)
        emulated = [EmulatedLikelihood(f, emulators[owner], fitted) for f, owner in owners]
        self._posterior = Posterior(problem, emulated)

    def draw(self, want: float) -> None:
        """Draw anew, with the likelihood to the power; ``want`` so many effective draws."""
        posterior, (draws, logs, *_) = self._posterior, self._drawn
        bent = len(posterior.shared) + len(posterior.sizes)
        try:
            self._drawn = draw(posterior.parts, draws, logs, self.power, bent, self._random, want)
        except np.linalg.LinAlgError as error:
            problem = posterior.problem
            raise ComputationError(
                f"{problem.name}: hardly any values of {', '.join(problem.keys)} within their "
                "bounds agree with the readings: narrower bounds, the right units of readings, or "
                "fewer specimens, would help"
            ) from error
        before, now = (np.quantile(d, _ENDS, axis=0) for d in (draws, self._drawn.draws))
        #: by how much ends of intervals moved, in sd
        self._moved = float((np.abs(now - before) / self._drawn.draws.std(axis=0)).max())

    def solution(self) -> Solution:
        """Return the draws, or ComputationError where emulators cannot follow histories."""
        readings, posterior, problem = self.readings, self._posterior, self.readings.problem
        if not self._error < _ASTRAY:
            raise ComputationError(
                f"{problem.name}: polynomials cannot follow the readings of "
                f"{problem.experiments[self._worst].name}: narrower bounds of "
                f"{', '.join(problem.keys)}, or priors, would help"
            )
        if readings.failed:
            self._keep_cases()
        draws, logs, effective, evidence, evidence_error = self._drawn
        middle = np.median(posterior.of_tests(draws), axis=0)
        return Solution(
            problem, posterior, draws, effective,
            mode(posterior, draws, logs), evidence, evidence_error,
            random_wear(readings, middle)[1], self._error, self._step_error,
            readings.steps, readings.count, readings.failed, readings.reason,
        )  # fmt: skip

    def _keep_cases(self) -> None:
        """Keep only draws that the rules of cases and laws allow."""
        problem, count = self.readings.problem, min(_CHECKED, len(self._drawn.draws))
        draws, logs = self._drawn.draws[:count], self._drawn.logs[:count]
        x, good = self._posterior.of_tests(draws), np.ones(count, dtype=bool)
        for i, test in enumerate(problem.experiments):
            found = cases_at(test.case, problem.keys, problem.values(x[:, i]))
            good &= [isinstance(case, Case) for case in found]
        effective = min(self._drawn.effective, float(good.sum()))
        self._drawn = self._drawn._replace(draws=draws[good], logs=logs[good], effective=effective)


def _trusted(true: FloatArray, off: FloatArray, power: float) -> float:
    """Return the largest power of the likelihood at which errors of log p do no harm.

    Errors may be half of what log p is less than the largest; some of the draws must count for
    it, unless the best ones have no errors at all.

    Parameters
    ----------
    true, off : (P,) log p at draws by another power, and its errors.
    """
    good = np.isfinite(true) & np.isfinite(off)
    true, off = true[good] - true[good].max(), off[good]
    known = off[true >= np.quantile(true, 1.0 - _COUNT)].std()
    for new in 0.8 ** np.arange(150):
        w = np.exp((new - power) * true - ((new - power) * true).max())
        w /= w.sum()
        wrong = np.maximum(np.abs(off - w @ off) + 0.5 * true, 0.0)
        counts = new * known < _TRUST or 1.0 / (w @ w) > _COUNT * len(w)
        if counts and new * np.sqrt(w @ wrong**2) < _TRUST:
            break
    return float(new)


def mode(posterior: Posterior, theta: FloatArray, density: FloatArray) -> FloatArray:
    """Return theta (d,) of the largest posterior where sizes are at their medians.

    With sizes free, it has no largest: they vanish where all specimens are alike.
    """
    sizes = [size.place for size in posterior.sizes if size.place is not None]
    best, scale = theta[np.argmax(density)].copy(), theta.std(axis=0)
    best[sizes], scale[sizes] = np.median(theta[:, sizes], axis=0), 0.0

    def minus_log_p(t: FloatArray) -> tuple[float, FloatArray]:
        moved = t + _MOVED * np.eye(len(t) + 1, len(t), -1)
        values = -np.maximum(sum(posterior.parts(best + scale * moved)), -1e10)
        return values[0], (values[1:] - values[0]) / _MOVED

    start = np.zeros(len(best))
    found = minimize(minus_log_p, start, jac=True, method="L-BFGS-B")
    return best + scale * found.x if found.fun < minus_log_p(start)[0] else best
