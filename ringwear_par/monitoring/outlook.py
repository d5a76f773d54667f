"""When readings to come will tell enough, and when a depth is reached."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import Experiment, Series
from ringwear_par.identification.likelihood import TestLikelihood
from ringwear_par.monitoring.follower import Follower, Specimen, part_of, times_of
from ringwear_par.prediction.prediction import times_at

#: most readings of a record that are planned to the end; times that a goal may be reached at
_PLANNED, _TIMES = 300, 60
#: draws for the time to a depth
_DRAWS = 2000


def time_to_goal(
    follower: Follower, found: Specimen, test: Experiment, key: int, ratio: float, now: float
) -> tuple[float | None, float]:
    """Return when the sd of a key is so much less, s, or None; and how much less at the end.

    Records go on at their rate; histories are linear in the keys, by regression on the draws.

    Parameters
    ----------
    key : its number.
    ratio : of the sd that is wished over that by the readings (n,) of the test until now.
    """
    end = test.case.time.end
    planned = replace(test, series=tuple(_to_end(series, end) for series in test.series))
    root, rows = np.sqrt(found.weights)[:, None], np.flatnonzero(found.weights > 0.0)
    x = found.unknowns[:, : follower.m] - found.weights @ found.unknowns[:, : follower.m]
    columns = np.column_stack([x, np.ones(len(x))])
    slopes = np.linalg.lstsq((root * columns)[rows], (root * found.coordinates)[rows], rcond=None)[0]
    by_key = slopes[:-1] @ follower.histories.emulator.modes
    before = follower.before.unknowns[:, : follower.m]
    known = np.linalg.inv(np.atleast_2d(np.cov(before.T)))
    times = times_of(planned)

    def sd_at(time: float) -> float:
        part = part_of(planned, times <= time * (1.0 + 1e-9))
        information = known.copy()
        if part.series:
            setting = follower.setting_like(found, part)
            likelihood = TestLikelihood(part, setting, found.shares)
            jacobian = follower.histories.read(by_key.T, part)
            for noise, growth in likelihood.noises:
                white = noise(jacobian[noise.rows])
                taken = growth.directions(white, np.zeros(white.shape[1]))[len(growth.times) // 2]
                information += white.T @ white - taken.T @ taken
        return float(np.sqrt(np.linalg.pinv(information, hermitian=True)[key, key]))

    at, first = np.linspace(now, end, _TIMES), sd_at(now)
    return _first(at, lambda time: sd_at(time) <= ratio * first), sd_at(end) / first


def _first(at: FloatArray, reached: Callable[[float], bool]) -> float | None:
    """Return the first of some times at which something is reached, and then stays so."""
    if not reached(float(at[-1])):
        return None
    low, high = -1, len(at) - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if reached(float(at[middle])) else (middle, high)
    return float(at[high])


def _to_end(series: Series, end: float) -> Series:
    """Return a record that goes on at its rate to the end of the test; what is read once stays."""
    if series.profile or series.n < 2 or series.x[-1] >= end or series.censored is not None:
        return series
    apart = float(np.median(np.diff(series.x)))
    more = np.arange(series.x[-1] + apart, end * (1.0 + 1e-9), apart)
    # fewer readings stand for all; those of correlated noise tell no more where they are many
    every = -(-len(more) // _PLANNED)
    fewer = 1.0 if series.correlation_time else np.sqrt(max(every, 1))
    x = np.append(series.x, more[::-1][:: every or 1][::-1])
    sd = np.append(series.sd, np.full(len(x) - series.n, series.sd[-1] / fewer))
    return replace(series, x=x, value=np.zeros(len(x)), sd=sd, lines=None)


def time_to(follower: Follower, found: Specimen, depth: float, now: float) -> FloatArray:
    """Return times (draws,) at which this specimen's penetration reaches a depth, mm; inf: later.

    Wear that is random goes on from what the readings tell of it: of the wear so far, the excess
    over its mean is normal given the readings; later wear is random anew.

    Parameters
    ----------
    now : s, of the last reading.
    """
    histories, coordinates = follower.histories, found.chosen(_DRAWS)
    plan, time = histories.plan, histories.time
    random = np.random.default_rng(1)
    both = np.column_stack([histories.emulator.mean, histories.emulator.modes.T])
    v = np.column_stack([np.ones(len(coordinates)), coordinates])
    approach = histories.quantities(plan, both)["all approach"]
    depths = v @ (approach - approach[0]).T
    for body, key in enumerate(follower.problem.settings.process):
        worn, most = v @ histories.depth(plan, both, key).T, histories.depths[body]
        size = found.shares[body] ** 2 * most
        at_now = np.array([np.interp(now, time, row) for row in worn])
        excess, variance = np.zeros(len(v)), size * at_now
        if found.likelihood is not None:
            likelihood, emulator = found.likelihood.likelihood, found.likelihood.emulator
            ((noise, growth),), clock = likelihood.noises, likelihood.setting.clocks[body]
            readings = emulator.mean + coordinates @ emulator.modes
            node = int(np.argmax(likelihood.by_node(readings)[0].sum(axis=1)))
            rows = noise.data(likelihood.data)[:, None] - readings.T
            both_rows = noise(np.column_stack([size * clock[0] * clock[1], rows]))
            taken = growth.directions(both_rows, np.append(0.0, np.ones(len(v))))[node]
            along = both_rows.T @ both_rows[:, 0] - taken.T @ taken[:, 0]
            excess, variance = along[1:], np.maximum(variance - along[0], 0.0)
        excess = excess + np.sqrt(variance) * random.standard_normal(len(v))
        later = np.diff(np.maximum(worn, at_now[:, None]), axis=1, prepend=at_now[:, None])
        steps = np.sqrt(size * np.maximum(later, 0.0)) * random.standard_normal(later.shape)
        share = np.minimum(time / now, 1.0) if now > 0.0 else np.ones(len(time))
        depths = depths + share * excess[:, None] + np.cumsum(steps, axis=1)
    return times_at(time, depths, depth)
