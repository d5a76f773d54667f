"""Whether readings are as expected, when they will be enough, and when a depth is reached."""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import fdtrc
from scipy.stats import chi2

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.averaging import averaged
from ringwear_par.identification.definition.problem import Experiment, Series, body_of_wear
from ringwear_par.identification.likelihood import drawn_nodes
from ringwear_par.monitoring.follower import Follower, Specimen
from ringwear_par.monitoring.histories import part_of
from ringwear_par.prediction.prediction import times_at

#: draws by which readings are predicted, and for the time to a depth
_PREDICTED, _DRAWS = 1000, 2000
#: times at which the sd of a key is expected
_TIMES = 9


def surprise(follower: Follower, specimen: Specimen, test: Experiment, new: BoolArray) -> float:
    """Return how probable it is that new readings are so far from what old ones lead to expect.

    By mean and covariance of the new readings over draws and growth times, nuisances and random
    wear integrated out; limits apart.

    Parameters
    ----------
    specimen : by the old readings.
    test : whose readings (n,) are new or old.
    """
    if specimen.likelihood is None:
        return 1.0
    random, v = np.random.default_rng(0), specimen.chosen(_PREDICTED)
    old, emulator = specimen.likelihood.likelihood, specimen.likelihood.emulator
    by_node = old.by_node(v @ np.vstack([emulator.mean, emulator.modes]))
    growing = {
        old.test.series[i].name: logs
        for (_, growth), logs in zip(old.noises, by_node, strict=True)
        for i in growth.series
    }
    emulator = follower.histories.emulator_of(test)
    likelihood = follower.likelihood_like(specimen, test)
    new = new & ~np.isin(np.arange(test.n), likelihood.limits)
    off, spread, freedom = [], [], np.inf
    for part, (noise, growth) in zip(likelihood.parts, likelihood.noises, strict=True):
        here = new[noise.rows]
        data = noise.data(likelihood.data[noise.rows]) - emulator.mean[noise.rows]
        rows = noise(np.column_stack([data, -emulator.modes[:, noise.rows].T]))
        units = noise(np.eye(len(here))[:, here])
        taken = growth.directions(rows, np.eye(1, rows.shape[1])[0])
        by_units = growth.directions(units, np.zeros(units.shape[1]))
        precision = units.T @ units - np.einsum("kgi,kgj->kij", by_units, by_units)
        pull = units.T @ rows - np.einsum("kgi,kgj->kij", by_units, taken)
        covariance = np.linalg.pinv(precision, hermitian=True)
        names = [test.series[i].name for i in growth.series]
        logs = growing.get(names[0] if names else "", growth.log_constants[:, None])
        nodes = drawn_nodes(logs, len(v), random)
        off.append(np.einsum("sqr,sr->sq", (covariance @ pull)[nodes], v))
        spread.append(covariance[nodes].mean(axis=0))
        if here.any() and test.series[part[0]].sd_fitted:
            freedom = min(freedom, max(noise.freedom - growth.free - here.sum(), 1.0))
    each = np.concatenate(off, axis=1)
    if not each.size:
        return 1.0
    variance = block_diag(*spread) + np.cov(each.T)
    mean, rank = each.mean(axis=0), np.linalg.matrix_rank(variance, hermitian=True)
    square = mean @ np.linalg.pinv(variance, hermitian=True) @ mean
    known = np.isinf(freedom)
    return float(chi2.sf(square, rank) if known else fdtrc(rank, freedom, square / rank))


def time_to_goal(
    follower: Follower, specimen: Specimen, test: Experiment, key: int, ratio: float, now: float
) -> tuple[float | None, float]:
    """Return when the sd of a key is so much less, s, or None; and how much less at the end.

    Records go on at their rate; histories are linear in the keys, by regression on the draws.

    Parameters
    ----------
    key : its number.
    ratio : of the sd that is wished over that by the readings of the test until now, s.
    """
    end, m = test.case.time.end, follower.m
    planned = replace(test, series=tuple(_to_end(series, end) for series in test.series))
    times, x = planned.times, specimen.unknowns[:, :m]
    x = x - specimen.weights @ x
    weighed = specimen.weights * x.T
    slopes = np.linalg.pinv(weighed @ x, hermitian=True) @ weighed @ specimen.coordinates
    by_key = (slopes @ follower.histories.emulator.modes).T
    before = np.linalg.inv(np.atleast_2d(np.cov(follower.before.unknowns[:, :m].T)))
    at, sds = np.linspace(now, end, _TIMES), []
    for time in at:
        information = before
        part = part_of(planned, times <= time * (1.0 + 1e-9))
        if part.series:
            jacobian = follower.histories.read(by_key, part)
            for noise, growth in follower.likelihood_like(specimen, part).noises:
                white = noise(jacobian[noise.rows])
                taken = growth.directions(white, np.zeros(m))[len(growth.times) // 2]
                information = information + white.T @ white - taken.T @ taken
        sds.append(np.sqrt(np.linalg.pinv(information, hermitian=True)[key, key]))
    less = np.minimum.accumulate(sds) / sds[0]
    reached = None if less[-1] > ratio else float(np.interp(-ratio, -less, at))
    return reached, float(less[-1])


def _to_end(series: Series, end: float) -> Series:
    """Return a record that goes on at its rate to the end of the test; what is read once stays."""
    if series.profile or series.n < 2 or series.censored is not None:
        return series
    apart = float(np.median(np.diff(series.x)))
    more = np.arange(series.x[-1] + apart, end * (1.0 + 1e-9), apart)
    x, sd = np.append(series.x, more), np.append(series.sd, np.full(len(more), series.sd[-1]))
    return averaged(replace(series, x=x, value=np.zeros(len(x)), sd=sd, lines=None), end)


def time_to(follower: Follower, specimen: Specimen, depth: float) -> FloatArray:
    """Return times (draws,) at which this specimen's penetration reaches a depth, mm; inf: later.

    Wear that is random is a Gaussian process here, whose past the readings tell.
    """
    histories, v, random = follower.histories, specimen.chosen(_DRAWS), np.random.default_rng(1)
    approach, time = histories.at_steps("approach"), histories.time
    depths, steps = v @ (approach - approach[0]).T, len(time)
    for body, key in enumerate(follower.problem.settings.process):
        most, share = follower.most[body], specimen.shares[body]
        clock = histories.at_steps(f"depth.{body_of_wear(key)}") @ histories.middle / most
        variance, excess = (share * most) ** 2 * np.minimum.outer(clock, clock), 0.0
        if specimen.likelihood is not None:
            old, emulator = specimen.likelihood.likelihood, specimen.likelihood.emulator
            ((noise, growth),), (slope, worn) = old.noises, old.setting.clocks[body]
            readings = v @ np.vstack([emulator.mean, emulator.modes])
            node = int(np.argmax(old.by_node(readings)[0].sum(axis=1)))
            across = share**2 * most * slope[:, None] * np.minimum.outer(worn, clock)
            rows = noise(np.column_stack([across, noise.data(old.data)[:, None] - readings.T]))
            taken = growth.directions(rows, np.repeat([0.0, 1.0], [steps, len(v)]))[node]
            along = rows[:, :steps].T @ rows - taken[:, :steps].T @ taken
            variance, excess = variance - along[:, :steps], along[:, steps:].T
        drawn = random.multivariate_normal(np.zeros(steps), variance, len(v), method="eigh")
        depths = depths + excess + drawn
    return times_at(time, depths, depth)
