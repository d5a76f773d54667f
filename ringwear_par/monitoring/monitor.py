"""Answers to the readings of a running test: they depend on these alone, however they came.

Whether readings are as expected, when they will be enough, and when a depth is reached.
"""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.special import fdtrc
from scipy.stats import chi2

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.averaging import averaged
from ringwear_par.identification.definition.problem import (
    Experiment,
    Problem,
    Series,
    body_of_wear,
    records,
)
from ringwear_par.identification.draws import NEXT
from ringwear_par.identification.noise import drawn_nodes
from ringwear_par.identification.users_units import in_users_unit
from ringwear_par.monitoring.follower import Follower, Specimen, part_of
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import TimeTo, times_at
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.variables import DISPLAY_UNITS

#: precision, over the largest, of what nuisances without a prior leave open
_UNKNOWN = 1e-9
#: windows of a test in which readings are compared with what is expected of them, and the
#: probability below which they are not: 1 of 100 tests without a change has an alarm
WINDOWS = 20
_IMPROBABLE = 0.01 / WINDOWS
#: error of histories over their spread above which there is a doubt; share of the draws at edges of
#: what was drawn before above which there is one, and part of the box that is at its edges
_ROUGH, _AT_EDGES, _EDGE = 2e-3, 0.01, 0.97
#: draws by which readings are predicted, and of which a band is drawn; for the time to a depth
_PREDICTED, _DRAWS = 1000, 2000
#: times at which the sd of a key is expected
_TIMES = 9
#: quantities of records that are drawn
_RECORDED = ("penetration", "approach", "torque")
#: share of its time from which on a test has ended
_ENDED = 0.999


@dataclass(frozen=True)
class Question:
    """What is asked of a running test."""

    #: number of the key whose interval is to become narrow: half its width over the median
    key: int
    percent: float
    #: mm, of penetration; None: none
    depth: float | None
    #: of whom the draws are before the test, and the doubts that there are then
    of: str = NEXT
    doubts: tuple[str, ...] = ()


class Monitor:
    """Answers to the readings of a running test. On the first rank, within ``Readings.lead``."""

    def __init__(self, follower: Follower, question: Question) -> None:
        self._follower, self._draws, self._question = follower, follower.draws, question
        tail = 0.5 * (1.0 - follower.problem.settings.level)
        self._tails = np.array([tail, 0.5, 1.0 - tail])
        self._before = self._intervals(follower.before)
        #: entry of the trace and probability of a window, by the readings until its end
        self._windows: dict[Hashable, tuple[list[float], float]] = {}

    def answer(self, problem: Problem) -> dict[str, Any]:
        """Return the answer to the readings so far, the contents of follow.json but its texts.

        Of ``trace`` an entry is time, low end, median and high end of the goal's key, the first one
        before the test.

        Parameters
        ----------
        problem : of the running test, with its readings so far.
        """
        (test,), question, follower = problem.experiments, self._question, self._follower
        times, end, window = test.times, test.case.time.end, test.case.time.end / WINDOWS
        key, level, now = problem.keys[question.key], problem.settings.level, float(times.max())
        trace, alarm = [[0.0, *self._before[question.key].tolist()]], None
        for number in range(1, WINDOWS):
            low, high = np.array([number, number + 1]) * window * (1.0 + 1e-9)
            old, new = times <= low, (times > low) & (times <= high)
            if high > now * (1.0 + 2e-9) or not old.any() or not new.any():
                continue
            entry, probability = self._window(test, old, new)
            trace.append(entry)
            if probability < _IMPROBABLE:
                alarm = {"time": float(times[new].min()), "probability": probability}
                break
        counted = times < (np.inf if alarm is None else alarm["time"])
        until, part = float(times[counted].max()), part_of(test, counted)
        specimen = follower.update(part)
        if len(trace) > 1 and trace[-1][0] >= until:
            del trace[-1]
        intervals = self._intervals(specimen)
        trace.append([until, *intervals[question.key].tolist()])
        self._last, keys = (specimen, part), self._keys(problem, intervals)
        percent = keys[key]["percent"]
        time, less = time_to_goal(
            follower, specimen, part, question.key, question.percent / percent, until
        )
        depth = None
        if question.depth is not None:
            reached = TimeTo.of(time_to(follower, specimen, question.depth), level)
            depth = {"depth": question.depth, **reached._asdict()}
        return {
            "test": test.name, "whom": question.of, "time": now, "end": end,
            "ended": now >= _ENDED * end, "readings": len(times), "level": level, "keys": keys,
            "depth": depth, "alarm": alarm, "trace": trace,
            "goal": {"key": key, "percent": question.percent, "time": time,
                     "at_end": percent * less},
            "interpolated": follower.histories.error,
            "doubts": self._doubts(specimen, alarm, end),
        }  # fmt: skip

    def _window(
        self, test: Experiment, old: BoolArray, new: BoolArray
    ) -> tuple[list[float], float]:
        """Return what old readings say, and how probable new ones are by them."""
        both = part_of(test, old | new)
        content = tuple(
            (s.name, s.x.tobytes(), s.value.tobytes(), s.sd.tobytes(), str(s.censored))
            for s in both.series
        )
        if content not in self._windows:
            specimen, last = self._follower.update(part_of(test, old)), test.times[old].max()
            p = surprise(self._follower, specimen, both, both.times > last)
            interval = self._intervals(specimen)[self._question.key].tolist()
            self._windows[content] = [float(last), *interval], p
        return self._windows[content]

    def _intervals(self, specimen: Specimen) -> FloatArray:
        """Return low end, median and high end of each key, (m, 3)."""
        columns = self._draws.values(specimen.unknowns[:, : len(self._draws.keys)]).T
        return np.array([specimen.quantiles(column, self._tails) for column in columns])

    def _keys(self, problem: Problem, intervals: FloatArray) -> dict[str, dict[str, Any]]:
        """Return entries of the keys, as in fit.json, with the interval before the test."""
        keys, case = {}, problem.experiments[0].case
        units = dict(zip(self._draws.keys, self._draws.units, strict=True))
        for parameter, (low, median, high), (first, _, last) in zip(
            problem.parameters, intervals.tolist(), self._before.tolist(), strict=True
        ):
            entry = {
                "unit": units[parameter.key], "estimate": median, "interval": (low, high),
                "before": (first, last), "percent": 50.0 * (high - low) / abs(median),
            }  # fmt: skip
            converted = in_users_unit(parameter, entry, case)
            keys[parameter.key] = entry if converted is None else {**entry, "told": converted}
        return keys

    def _doubts(self, specimen: Specimen, alarm: dict[str, float] | None, end: float) -> list[str]:
        """Return what speaks against the numbers, an alarm first."""
        doubts, histories = [*self._question.doubts], self._follower.histories
        if alarm is not None:
            time = time_words(alarm["time"], end)
            sentence = (
                f"alarm: readings leave the predicted band from {time} on "
                f"(p = {alarm['probability']:.1g}): a transition, a layer worn through, or the "
                "rig; all numbers are of the readings before"
            )
            doubts = [sentence, *doubts]
        box = histories.emulator.box
        inside = box.inside(specimen.unknowns[:, : len(box.centre)])
        if specimen.weights @ (np.abs(inside) > _EDGE).any(axis=1) > _AT_EDGES:
            doubts.append(
                "this specimen is beyond almost all that the earlier tests let expect: intervals "
                "are cut off there; check that they are of the same material and rig"
            )
        if histories.error > _ROUGH:
            doubts.append(
                f"histories between draws are known to {100 * histories.error:.2g} % of their "
                "spread: a layer is worn through, or a threshold is reached, at some draws"
            )
        return doubts

    def record(self) -> Panel | None:
        """Return the panel of the first record of penetration, approach or torque."""
        (specimen, test), follower = self._last, self._follower
        known = [one for one in records(test.series) if one[0].quantity in _RECORDED]
        if not known:
            return None
        assert specimen.likelihood is not None
        (series, part), quantity = known[0], known[0][0].quantity
        steps = follower.histories.at_steps(quantity.replace("penetration", "approach"))
        steps = steps - steps[0] if quantity == "penetration" else steps
        curves = np.quantile(specimen.chosen(_PREDICTED) @ steps.T, self._tails, axis=0)
        middle = follower.middle(specimen, test)
        added = specimen.likelihood.likelihood.nuisance_draws(middle[None])[0][0]
        value = series.value - added[part]
        symbol, factor = DISPLAY_UNITS.get(quantity, ("N mm", 1.0))
        unit, seconds = time_unit(test.case.time.end)
        time, (low, median, high) = follower.histories.time / seconds, factor * curves
        level = f"{100 * follower.problem.settings.level:g} %"
        return Panel(
            Axis(f"time ({unit})"), Axis(f"{quantity} ({symbol})", zero=True),
            "readings, and histories of this specimen",
            curves=[Curve(time, median, "median", COLOURS[1])],
            bands=[Band(time, low, high, level, ("low", "high"))],
            points=[Points(series.x / seconds, factor * value, "readings, less offset and drift")],
        )  # fmt: skip


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
        covariance = np.linalg.pinv(precision, rcond=_UNKNOWN, hermitian=True)
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
