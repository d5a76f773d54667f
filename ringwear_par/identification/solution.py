"""The posterior of a problem, from outside in: emulators of its tests, and draws.

The first draws are all over the bounds. In each round, emulators are made in the boxes of the
draws, and the likelihood is taken to the power up to which they are right; the new draws are nearer
together, and so are the emulators, until the power is 1. Starting from a mode instead would miss
what lies beyond the box about it.
"""

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
from ringwear_par.identification.sampling import Drawn, draw
from ringwear_par.identification.setting import needs_middle, random_wear, settings_at

#: draws at first; draws that have true histories, a round; points that fill the box of an emulator,
#: for each key
_FIRST, _TRIED, _FILLING = 2048, 48, 24
#: margin of a box, as a share of its edges
_MARGIN = 0.2
#: rms error of a reading, in its sd, that is good enough
_GOOD = 0.005
#: factor by which the power may grow in a round, and power that the first round may reach
_LEAP, _FIRST_LEAP = 100.0, 1e-3
#: largest error of log p by the power, in rms; share of the draws that must count for it
_TRUST, _COUNT = 0.3, 0.0625
#: rounds in all, and with the whole likelihood
_MOST_ROUNDS, _MOST_WHOLE = 20, 6
#: sd of the error of log p, among draws, that is good enough; that of steps, which moves no key by
#: more than 0.2 sd; share of the draws without a history that is small enough
_RIGHT, _MOST_SHIFT, _LOST = 0.1, 0.15, 0.03
#: ends of intervals, which move by less than that, in sd, as emulators are made anew
_ENDS, _SETTLED = (0.025, 0.975), 0.15
#: sd of the error of log p above which draws say nothing
_ASTRAY = 3.0
#: effective number of draws that lead to others
_SOME = 2000.0
#: draws of which none may be no case
_CHECKED = 4000
#: difference of theta, in sd of the draws, by which slopes of log p are found
_MOVED = 1e-4

#: points (P, m) of tests that share an emulator, and readings (P, n) there, by the first test
Known = dict[int, tuple[FloatArray, FloatArray]]


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


def solve(readings: Readings, seed: int = 0, wanted: float = 20_000.0) -> Solution:
    """Return draws of the posterior of ``readings.problem``. On the first rank, within ``lead``.

    Parameters
    ----------
    wanted : effective number of draws.

    Raises
    ------
    ComputationError : no histories, or no emulators that can follow them.
    """
    problem, random = readings.problem, np.random.default_rng(seed)
    settings = [Setting.before(test, problem.settings.loss) for test in problem.experiments]
    posterior = Posterior(problem)
    draws = posterior.anywhere(_FIRST, random)
    drawn = Drawn(draws, posterior.log_prior(draws), draws, 0.0, 0.0, 0.0)
    known: Known = {}
    power, whole, step_error = 0.0, 0, np.inf
    for number in range(_MOST_ROUNDS):
        readings.tell(f"round {number + 1}, likelihood to the power {power:.2g}")
        draws, problem = drawn.draws, readings.problem
        if number and needs_middle(problem):
            middle = np.median(posterior.of_tests(draws), axis=0)
            shares = np.median(posterior.shares(draws), axis=0)
            settings = settings_at(readings, settings, middle, shares)
            if readings.problem.experiments is not problem.experiments:  # friction changed
                known.clear()
        posterior, log_p, left_out = _emulated(readings, settings, drawn, known)
        true, off = log_p.sum(axis=0), (left_out - log_p).sum(axis=0)
        power, error = _trusted(true, off, power), float(np.nanstd(off))
        drawn = _drawn(posterior, drawn, power, random, wanted if power == 1.0 else _SOME)
        if power < 1.0:
            continue
        whole += 1
        before, now = (np.quantile(d, _ENDS, axis=0) for d in (draws, drawn.draws))
        moved = np.abs(now - before) / drawn.draws.std(axis=0)
        if error < _RIGHT and moved.max() < _SETTLED:
            error, step_error, lost = _errors(readings, posterior, drawn.draws)
            if step_error >= _MOST_SHIFT:
                readings.steps *= 2
                known.clear()
                whole = 0
            elif error < _RIGHT and lost < _LOST:
                break
        if whole == _MOST_WHOLE:
            break
    if power < 1.0 or not error < _ASTRAY:
        worst = int(np.nanstd(left_out - log_p, axis=1).argmax())
        raise ComputationError(
            f"{problem.name}: polynomials cannot follow the readings of "
            f"{problem.experiments[worst].name}: narrower bounds of "
            f"{', '.join(problem.keys)}, or priors, would help"
        )
    if readings.failed:
        drawn = _of_cases(posterior, drawn)
    middle = np.median(posterior.of_tests(drawn.draws), axis=0)
    return Solution(
        posterior.problem, posterior, drawn.draws, drawn.effective,
        mode(posterior, drawn.draws, drawn.logs), drawn.log_integral, drawn.error,
        random_wear(readings, middle)[1], error, step_error,
        readings.steps, readings.count, readings.failed, readings.reason,
    )  # fmt: skip


def _emulated(
    readings: Readings, settings: list[Setting], drawn: Drawn, known: Known
) -> tuple[Posterior, FloatArray, FloatArray]:
    """Return the posterior by emulators in boxes about draws that are wider spread.

    Also log p (tests, P) at some of these: by their histories, NaN where there is none, and by
    emulators that do not know them. Emulators are of these histories, of those at points that fill
    the boxes, and of those that are known there, to which the others are added.
    """
    problem, same_as = readings.problem, np.array(readings.same_as)
    posterior, m = Posterior(problem), len(problem.parameters)
    shares = np.median(posterior.shares(drawn.draws), axis=0)
    pairs = zip(problem.experiments, settings, strict=True)
    likelihoods = [TestLikelihood(test, setting, shares) for test, setting in pairs]
    every = posterior.of_tests(drawn.spread).swapaxes(0, 1)
    x = posterior.of_tests(np.unique(drawn.spread[:_TRIED], axis=0)).swapaxes(0, 1)
    boxes, filling = dict[int, Box](), dict[int, FloatArray]()
    for owner in np.unique(same_as).tolist():
        of_owner = every[same_as == owner].reshape(-1, m)
        boxes[owner] = Box.about(of_owner, *problem.unknown_bounds, _MARGIN)
        filling[owner] = boxes[owner].design(_FILLING * m)
    blocks = readings([*enumerate(x), *filling.items()])
    log_p, left_out = np.empty((2, *x.shape[:2]))
    emulators = dict[int, Emulator]()
    for (owner, box), filled in zip(boxes.items(), blocks[len(x) :], strict=True):
        tests = np.flatnonzero(same_as == owner)
        old, of_old = known.get(owner, (filling[owner][:0], filled[:0]))
        inside = box.holds(old)
        points = np.concatenate([*x[tests], filling[owner], old[inside]])
        y = np.concatenate([*(blocks[i] for i in tests), filled, of_old[inside]])
        points, first, places = np.unique(points, axis=0, return_index=True, return_inverse=True)
        y = y[first]
        known[owner] = points, y
        good = np.isfinite(y).all(axis=1)
        if good.sum() < 2 * m + 2:
            test, reason = problem.experiments[owner].name, readings.reason
            raise ComputationError(f"{problem.name}: {test}: hardly any histories: {reason}")
        by_test = np.array([likelihoods[i](y) for i in tests])
        best = np.nanmax(by_test, axis=1, keepdims=True)
        near = nearness(np.sqrt(2.0 * (best - by_test)).min(axis=0)[good])
        emulators[owner], without = emulate(box, points, y, settings[owner].sd, near, _GOOD)
        for place, i in enumerate(tests):
            rows = places.ravel()[place * x.shape[1] : (place + 1) * x.shape[1]]
            log_p[i], left_out[i] = by_test[place, rows], likelihoods[i](without[rows])
    if np.isnan(log_p.sum(axis=0)).all():
        raise ComputationError(f"{problem.name}: no history at any draw: {readings.reason}")
    fitted = [i for i, p in enumerate(problem.settings.process.values()) if p.fitted]
    owners = zip(likelihoods, same_as.tolist(), strict=True)
    emulated = [EmulatedLikelihood(f, emulators[owner], fitted) for f, owner in owners]
    return Posterior(problem, emulated), log_p, left_out


def _trusted(true: FloatArray, off: FloatArray, power: float) -> float:
    """Return the largest power of the likelihood at which errors of log p do no harm.

    Errors may be half of what log p is less than the largest; some of the draws must count for
    it, unless the best ones have no errors at all. It is not below the power of now.

    Parameters
    ----------
    true, off : (P,) log p at draws by the power of now, and its errors.
    """
    good = np.isfinite(true) & np.isfinite(off)
    true, off = true[good] - true[good].max(), off[good]
    known = off[true >= np.quantile(true, 1.0 - _COUNT)].std()
    for new in min(1.0, max(_LEAP * power, _FIRST_LEAP)) * 0.8 ** np.arange(150):
        w = np.exp((new - power) * true)
        w /= w.sum()
        wrong = np.maximum(np.abs(off - w @ off) + 0.5 * true, 0.0)
        counts = new * known < _TRUST or 1.0 / (w @ w) > _COUNT * len(w)
        if new <= power or (counts and new * np.sqrt(w @ wrong**2) < _TRUST):
            break
    return max(float(new), power)


def _drawn(
    posterior: Posterior, before: Drawn, power: float, random: np.random.Generator, want: float
) -> Drawn:
    """Return new draws, of the likelihood to a power; ``want`` so many effective ones."""
    bent = len(posterior.shared) + len(posterior.sizes)
    try:
        return draw(posterior.parts, before.draws, before.logs, power, bent, random, want)
    except np.linalg.LinAlgError as error:
        problem = posterior.problem
        raise ComputationError(
            f"{problem.name}: hardly any values of {', '.join(problem.keys)} within their "
            "bounds agree with the readings: narrower bounds, or the right units of readings, "
            "would help"
        ) from error


def _errors(
    readings: Readings, posterior: Posterior, draws: FloatArray
) -> tuple[float, float, float]:
    """Return the sd of errors of log p at some draws, by emulators and by time steps.

    By their histories, and by those of steps half as long; also the share without a history.
    """
    x = posterior.of_tests(np.unique(draws[:_TRIED], axis=0)).swapaxes(0, 1)
    every = [readings([*enumerate(x)], steps=times * readings.steps) for times in (1, 2)]
    every.append([one.emulator(at) for one, at in zip(posterior.likelihoods, x, strict=True)])
    true, finer, emulated = (
        np.sum([f.likelihood(y) for f, y in zip(posterior.likelihoods, of, strict=True)], axis=0)
        for of in every
    )
    error, step_error = (float(np.nanstd(log_p - true)) for log_p in (emulated, finer))
    return error, step_error, float(np.isnan(true).mean())


def _of_cases(posterior: Posterior, drawn: Drawn) -> Drawn:
    """Return only draws that the rules of cases and laws allow, of some of all."""
    problem, draws, logs = posterior.problem, drawn.draws[:_CHECKED], drawn.logs[:_CHECKED]
    x, good = posterior.of_tests(draws), np.ones(len(draws), dtype=bool)
    for i, test in enumerate(problem.experiments):
        found = cases_at(test.case, problem.keys, problem.values(x[:, i]))
        good &= [isinstance(case, Case) for case in found]
    effective = min(drawn.effective, float(good.sum()))
    return drawn._replace(draws=draws[good], logs=logs[good], effective=effective)


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
