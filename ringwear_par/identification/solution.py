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
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.likelihood import EmulatedLikelihood, Setting, TestLikelihood
from ringwear_par.identification.posterior import Layout, Posterior
from ringwear_par.identification.sampling import draw, log_evidence
from ringwear_par.identification.setting import needs_middle, settings_at

#: draws at first; points that fill the box of an emulator and draws with true histories, a round
_FIRST, _FILLING, _TRIED = 2048, 96, 48
#: margin of a box, as a share of its edges
_MARGIN = 0.1
#: rms error of a reading, in its sd, that is good enough
_GOOD = 0.005
#: rounds in all, and with the whole likelihood
_MOST_ROUNDS, _MOST_WHOLE = 20, 6
#: sd of the error of log p, among draws, that is good enough, and that moves no key by more than
#: 0.2 sd where steps are halved; share of draws at faces of boxes
_RIGHT, _MOST_SHIFT, _AT_FACES = 0.1, 0.15, 2e-3
#: effective number of draws while emulators are checked, and at the end
_SOME, _WANTED = 1000.0, 4000.0
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


def solve(readings: Readings, seed: int = 0) -> Solution:
    """Return draws of the posterior of ``readings.problem``. On the first rank, within ``lead``.

    Raises
    ------
    ComputationError : no histories, or emulators and draws that cannot follow them.
    """
    random, layout = np.random.default_rng(seed), Layout(readings.problem)
    tests = range(len(readings.problem.experiments))
    loss, bodies = readings.problem.settings.loss, len(layout.share_places)
    settings = [Setting.before(test, loss, bodies) for test in readings.problem.experiments]
    draws, power, whole = layout.anywhere(_FIRST, random), 0.0, 0
    density = layout.log_prior(draws)
    known: dict[int, tuple[FloatArray, FloatArray]] = {}
    emulators: list[Emulator] = []
    settled, steps_right, off, posterior = not needs_middle(readings.problem), np.inf, np.zeros((0, 1)), None
    for number in range(_MOST_ROUNDS):
        readings.tell(f"round {number + 1}, likelihood to the power {power:.2g}")
        xs = layout.of_tests(draws)
        tried = random.permutation(np.unique(draws, axis=0))[:_TRIED]
        tried_x = layout.of_tests(tried)
        blocks = readings([(i, tried_x[:, i]) for i in tests])
        adapts = not settled
        if adapts:
            middle = np.median(xs, axis=0)
            if not number:  # where there is wear
                rough = _likelihoods(readings.problem, settings, np.zeros(bodies))
                middle = tried_x[np.nanargmax(_total(rough, blocks))]
            shares = np.median(layout.shares(draws, _known(settings)), axis=0)
            before, friction = settings, [test.case.friction for test in readings.problem.experiments]
            if emulators:
                some = xs[:: max(1, len(xs) // 256)]
                settings = [
                    TestLikelihood(test, settings[i], shares).with_times_that_count(emulators[i](some[:, i]))
                    for i, test in enumerate(readings.problem.experiments)
                ]
            settings = settings_at(readings, settings, middle, shares, first=not number)
            settled = power == 1.0 and all(map(_is_close, before, settings))
            if friction != [test.case.friction for test in readings.problem.experiments]:
                known = {}
                blocks = readings([(i, tried_x[:, i]) for i in tests])
        same_as, problem = readings.same_as, readings.problem
        shares = np.median(layout.shares(draws, _known(settings)), axis=0)
        likelihoods = _likelihoods(problem, settings, shares)
        true = _total(likelihoods, blocks)
        if not np.isfinite(true).any():
            raise ComputationError(f"{problem.name}: no history at any draw: {readings.reason}")
        if power == 1.0 and not adapts:
            whole += 1
            off = np.array([f(y) - f(emulators[i](tried_x[:, i])) for i, (f, y) in enumerate(zip(likelihoods, blocks, strict=True))])
            at_faces = max(_at_faces(emulators[i].box, xs[:, i]) for i in tests)
            if np.nanstd(off.sum(axis=0)) < _RIGHT and at_faces < _AT_FACES:
                finer = readings([(i, tried_x[:, i]) for i in tests], steps=2 * readings.steps)
                steps_right = float(np.nanstd(_total(likelihoods, finer) - true))
                if steps_right < _MOST_SHIFT or whole >= _MOST_WHOLE:
                    break
                readings.steps, known, blocks = 2 * readings.steps, {}, finer
                true = _total(likelihoods, blocks)
            elif whole >= _MOST_WHOLE:
                break
        owners = sorted({*same_as})
        members = {o: [i for i in tests if same_as[i] == o] for o in owners}
        boxes = {o: Box.about(xs[:, members[o]].reshape(-1, layout.m), layout.low, layout.high, _MARGIN) for o in owners}
        filling = {o: boxes[o].design(_FILLING) for o in owners}
        filled = dict(zip(owners, readings([(o, filling[o]) for o in owners]), strict=True))
        without, by_owner = np.zeros(len(tried)), {}
        for o in owners:
            old_x, old_y = known.get(o, (filling[o][:0], filled[o][:0]))
            x = np.concatenate([*(tried_x[:, i] for i in members[o]), filling[o], old_x])
            y = np.concatenate([*(blocks[i] for i in members[o]), filled[o], old_y])
            inside = boxes[o].holds(x)
            inside[: len(tried) * len(members[o])] = True
            x, y = x[inside], y[inside]
            known[o] = x, y
            good = np.isfinite(y).all(axis=1)
            if good.sum() < 2 * layout.m + 2:
                raise ComputationError(f"{problem.name}: test {problem.experiments[o].name}: hardly any histories: {readings.reason}")
            log_p = np.array([likelihoods[i](y[good]) for i in members[o]])
            distance = np.sqrt(2.0 * (log_p.max(axis=1, keepdims=True) - log_p)).min(axis=0)
            by_owner[o], left_out = emulate(boxes[o], x, y, settings[o].sd, nearness(distance), _GOOD)
            for place, i in enumerate(members[o]):
                rows = slice(place * len(tried), (place + 1) * len(tried))
                without += likelihoods[i](left_out[rows])
        emulators = [by_owner[o] for o in same_as]
        power = max(power, _trusted(true, without - true, power))
        emulated = [EmulatedLikelihood(f, e) for f, e in zip(likelihoods, emulators, strict=True)]
        posterior = Posterior(problem, emulated, _known(settings))
        draws, density, effective = _drawn(posterior, draws, density, power, random, _SOME * (power == 1.0))
    assert posterior is not None
    readings.tell("draws of the posterior")
    weighed = ""
    error = float(np.nanstd(off.sum(axis=0))) if off.size else np.inf
    draws, density, effective = _drawn(posterior, draws, density, 1.0, random, _WANTED)
    if not error < _RIGHT:
        draws, density, effective, weighed = _weighed(readings, likelihoods, posterior, draws, density, off, random)
    evidence, evidence_error = log_evidence(posterior, draws)
    depths = np.array([p.size or 0.0 for p in problem.settings.process.values()])
    return Solution(
        problem, posterior, draws, effective, mode(posterior, draws, density), evidence, evidence_error,
        depths, error, steps_right, readings.steps, readings.count, readings.failed, readings.reason, weighed,
    )  # fmt: skip


def _drawn(
    posterior: Posterior,
    draws: FloatArray,
    density: FloatArray,
    power: float,
    random: np.random.Generator,
    want: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Return draws of a posterior, see ``draw``, in coordinates without funnels."""
    funnel = Funnel(posterior, draws)

    def log_p(flat: FloatArray, power: float) -> FloatArray:
        theta, volume = funnel.theta(flat)
        return posterior(theta, power) + volume

    flat = funnel.flat(draws)
    flat, logs, effective = draw(log_p, flat, density + funnel.theta(flat)[1], power, random, want)
    theta, volume = funnel.theta(flat)
    return theta, logs - volume, effective


def _known(settings: Sequence[Setting]) -> FloatArray:
    """Return the shares of random wear that are known (bodies,); NaN where they are fitted."""
    return settings[0].shares


def _likelihoods(problem: Problem, settings: Sequence[Setting], shares: FloatArray) -> list[TestLikelihood]:
    return [
        TestLikelihood(test, setting, shares)
        for test, setting in zip(problem.experiments, settings, strict=True)
    ]


def _total(likelihoods: Sequence[TestLikelihood], blocks: Sequence[FloatArray]) -> FloatArray:
    """Return log p (P,) of all tests by their readings (P, n); NaN where there is no history."""
    total: FloatArray = np.sum([f(y) for f, y in zip(likelihoods, blocks, strict=True)], axis=0)
    return total


def _is_close(before: Setting, after: Setting) -> bool:
    """Tell whether two settings are so near that likelihoods do not differ."""
    sd = np.abs(np.log(after.sd / before.sd)).max() < 0.05
    times = all(abs(a - b) < 0.25 * (after.times[i][1] - after.times[i][0]) for i in after.times for a, b in zip(after.times[i], before.times[i], strict=True))
    clocks = len(before.clocks) == len(after.clocks) and all(
        np.abs(a[0] - b[0]).max() <= 0.2 * np.abs(b[0]).max() for a, b in zip(after.clocks, before.clocks, strict=True)
    )
    return bool(sd and times and clocks)


def _at_faces(box: Box, x: FloatArray) -> float:
    """Return the share of unknowns (s, m) that are at faces of a box but not at bounds."""
    return float((np.abs(box.inside(x)) > 0.97).any(axis=1).mean())


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


def _weighed(
    readings: Readings,
    likelihoods: Sequence[TestLikelihood],
    posterior: Posterior,
    draws: FloatArray,
    density: FloatArray,
    off: FloatArray,
    random: np.random.Generator,
) -> tuple[FloatArray, FloatArray, float, str]:
    """Return draws weighed by true histories, where emulators cannot follow them; and a sentence.

    ComputationError where too few of them count.
    """
    problem = readings.problem
    worst = problem.experiments[int(np.argmax(np.nanstd(off, axis=1)))].name if off.size else problem.experiments[0].name
    rows = random.choice(len(draws), _WEIGHED, replace=False)
    x = posterior.of_tests(draws[rows])
    blocks = readings([(i, x[:, i]) for i in range(len(likelihoods))])
    emulated = [f(p.emulator(x[:, i])) for i, (f, p) in enumerate(zip(likelihoods, posterior.likelihoods, strict=True))]
    logs = _total(likelihoods, blocks) - np.sum(emulated, axis=0)
    logs = np.where(np.isfinite(logs), logs, -np.inf)
    weights = np.exp(logs - logsumexp(logs))
    effective = float(1.0 / (weights @ weights))
    spread = np.nan_to_num(np.corrcoef(np.column_stack([np.abs(logs - np.median(logs)), x.mean(axis=1)]), rowvar=False)[0, 1:])
    key = problem.keys[int(np.argmax(np.abs(spread)))]
    sentence = (
        f"readings of {worst} are no smooth functions of {key}: draws were weighed by "
        f"{_WEIGHED} histories, and are worth {effective:.0f}"
    )
    if effective < _LEAST:
        raise ComputationError(
            f"{problem.name}: {sentence}; narrower bounds of {key}, or a prior, would help"
        )
    chosen = rows[random.choice(_WEIGHED, 4 * _WEIGHED, p=weights)]
    return draws[chosen], density[chosen], effective, sentence


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
        moved = np.vstack([np.zeros(len(free)), step * np.eye(len(free)), -step * np.eye(len(free))])
        points[:, free] = best[free] + scale * (t + moved)
        logs = np.maximum(posterior(points), -1e10)
        slope = (logs[1 : len(free) + 1] - logs[len(free) + 1 :]) / (2.0 * step)
        return -float(logs[0]), -np.where(np.abs(slope) < 1e6, slope, 0.0)

    found = minimize(minus_log_p, np.zeros(len(free)), jac=True, method="L-BFGS-B")
    start = minus_log_p(np.zeros(len(free)))[0]
    if found.fun < start:
        best[free] += scale * found.x
    return best
