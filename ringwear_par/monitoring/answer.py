"""Answers to the readings of a running test: they depend on these alone, however they came.

Whether readings are as expected, when they will be enough, and when a depth is reached; as numbers,
in lines of text and on a page.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import fdtrc
from scipy.stats import chi2

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.errors import counted
from ringwear_par.identification.definition.problem import Experiment, Problem, Series, records
from ringwear_par.identification.definition.series import averaged
from ringwear_par.identification.likelihood import TestLikelihood
from ringwear_par.identification.noise import sides
from ringwear_par.identification.summary import users_numbers
from ringwear_par.identification.users_units import in_users_unit
from ringwear_par.monitoring.follower import Follower, Specimen
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import TimeTo, depth_line, times_at
from ringwear_par.reports import blocks
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.variables import DISPLAY_UNITS

#: windows of a test in which readings are compared with what is expected of them, and the
#: probability below which they are not: 1 of 100 tests without a change has an alarm
WINDOWS = 20
_IMPROBABLE = 0.01 / WINDOWS
#: error of histories over their spread above which there is a doubt; share of the draws at edges of
#: what was drawn before above which there is one, and part of the box that is at its edges
_ROUGH, _AT_EDGES, _EDGE = 2e-3, 0.01, 0.97
#: draws by which readings are predicted
_PREDICTED = 2000
#: times at which the sd of a key is expected
_TIMES = 9
#: quantities of records that are drawn
_DRAWN = ("penetration", "approach", "torque")
#: share of its time from which on a test has ended
_ENDED = 0.999
#: s, after which a browser loads the page anew
_REFRESH = 10


def part_of(test: Experiment, rows: BoolArray) -> Experiment:
    """Return a test with some of its readings (n,), without series that their nuisances explain."""
    parts = [series.part(rows[place]) for series, place in records(test.series)]
    informative = (
        s for s in parts if s.n > sum(n.free for n in s.nuisances) * (s.censored is None)
    )
    return replace(test, series=tuple(informative))


class Monitor:
    """Answers to the readings of a running test. On the first rank, within ``Readings.lead``.

    Parameters
    ----------
    goal : number of the key whose interval is to become narrow: half its width over the median,
        in percent.
    depth : mm, of penetration; None: none is asked for.
    doubts : that there are before the test.
    """

    def __init__(
        self,
        follower: Follower,
        goal: tuple[int, float],
        depth: float | None = None,
        doubts: Sequence[str] = (),
    ) -> None:
        self._follower, (self._goal, self._percent), self._depth = follower, goal, depth
        self._doubts, tail = doubts, 0.5 * (1.0 - follower.problem.settings.level)
        self._tails = [tail, 0.5, 1.0 - tail]
        self._before = self._intervals(follower.before)
        #: draws at the end of a window, and probability of its readings, by all until then
        self._windows: dict[Hashable, tuple[Specimen, float]] = {}

    def answer(self, problem: Problem) -> dict[str, Any]:
        """Return the answer to the readings so far, the contents of follow.json but its texts.

        Of ``trace`` an entry is time, low end, median and high end of the goal's key, the first one
        before the test.

        Parameters
        ----------
        problem : of the running test, with its readings so far.
        """
        (test,), follower, goal = problem.experiments, self._follower, self._goal
        times, end, level = test.times, test.case.time.end, problem.settings.level
        trace, alarm, now = [[0.0, *self._before[goal]]], None, float(times.max())
        specimen: Specimen | None = None
        for window in end * np.arange(1, WINDOWS + 1) / WINDOWS:
            part = part_of(test, times <= window * (1.0 + 1e-9))
            if window > now * (1.0 + 1e-9) or part.n == (
                0 if specimen is None else specimen.test.n
            ):
                continue
            later, probability = self._window(specimen, part)
            if specimen is not None and probability < _IMPROBABLE:
                first = times[times > specimen.test.times.max()].min()
                alarm = {"time": float(first), "probability": probability}
                break
            specimen = later
            trace.append(self._trace(specimen))
        if specimen is None or (alarm is None and specimen.test.n < test.n):
            specimen = follower.update(test)
            trace.append(self._trace(specimen))
        self._last, keys = specimen, self._keys(problem, self._intervals(specimen.unknowns))
        key, percent = problem.keys[goal], keys[problem.keys[goal]]["percent"]
        time, less = time_to_goal(follower, specimen, goal, self._percent / percent)
        depth = None
        if self._depth is not None:
            reached = TimeTo.of(time_to(follower, specimen, self._depth), level)
            depth = {"depth": self._depth, **reached._asdict()}
        answer = {
            "test": test.name, "whom": follower.of, "time": now, "end": end,
            "ended": now >= _ENDED * end, "readings": len(times), "level": level, "keys": keys,
            "depth": depth, "alarm": alarm, "trace": trace,
            "goal": {"key": key, "percent": self._percent, "time": time, "at_end": percent * less},
            "interpolated": follower.histories.error,
            "doubts": self._doubts_of(specimen, alarm, end),
        }  # fmt: skip
        return {**answer, "summary": _lines(answer)}

    def _window(self, specimen: Specimen | None, test: Experiment) -> tuple[Specimen, float]:
        """Return the draws by a test, and how probable its new readings are by those before."""
        content = tuple(
            (s.name, s.x.tobytes(), s.value.tobytes(), s.sd.tobytes(), str(s.censored))
            for s in test.series
        )
        if content not in self._windows:
            later = self._follower.update(test)
            p = 1.0 if specimen is None else surprise(self._follower, specimen, later)
            self._windows[content] = later, p
        return self._windows[content]

    def _trace(self, specimen: Specimen) -> list[float]:
        """Return the time of the last reading, and the interval of the goal's key by all."""
        return [
            float(specimen.test.times.max()), *self._intervals(specimen.unknowns)[self._goal]
        ]  # fmt: skip

    def _intervals(self, unknowns: FloatArray) -> list[list[float]]:
        """Return low end, median and high end of each key over draws (s, m)."""
        values = self._follower.draws.values(unknowns[:, : self._follower.m])
        ends: list[list[float]] = np.quantile(values, self._tails, axis=0).T.tolist()
        return ends

    def _keys(self, problem: Problem, intervals: list[list[float]]) -> dict[str, dict[str, Any]]:
        """Return entries of the keys, as in fit.json, with the interval before the test."""
        keys = {}
        for parameter, unit, (low, median, high), (first, _, last) in zip(
            problem.parameters, self._follower.draws.units, intervals, self._before, strict=True
        ):
            entry = {
                "unit": unit, "estimate": median, "interval": (low, high),
                "before": (first, last), "percent": 50.0 * (high - low) / abs(median),
            }  # fmt: skip
            converted = in_users_unit(parameter, entry, problem.experiments[0].case)
            keys[parameter.key] = entry if converted is None else {**entry, "told": converted}
        return keys

    def _doubts_of(
        self, specimen: Specimen, alarm: dict[str, float] | None, end: float
    ) -> list[str]:
        """Return what speaks against the numbers, an alarm first."""
        doubts, histories = [*self._doubts], self._follower.histories
        if alarm is not None:
            doubts.insert(
                0,
                f"alarm: readings leave the predicted band from {time_words(alarm['time'], end)} "
                f"on (p = {alarm['probability']:.1g}): a transition, a layer worn through, or the "
                "rig; all numbers are of the readings before",
            )
        inside = histories.emulator.box.inside(specimen.unknowns[:, : self._follower.m])
        if (np.abs(inside) > _EDGE).any(axis=1).mean() > _AT_EDGES:
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

    def page(self, answer: Mapping[str, Any]) -> blocks.Page:
        """Return the page of the last answer, which a browser loads anew while the test runs."""
        unit, seconds = time_unit(answer["end"])
        key, level = answer["goal"]["key"], f"{100 * answer['level']:g} %"
        numbers, unit_of_key = users_numbers(answer["keys"][key])
        time, *ends = np.array(answer["trace"]).T
        time, (low, median, high) = time / seconds, np.array(ends) / numbers["scale"]
        of_key = Panel(
            Axis(f"time ({unit})"), Axis(f"{key} ({in_signs(unit_of_key or '1')})"),
            "by the readings until then",
            curves=[Curve(time, median, "median", COLOURS[1], marked=True)],
            bands=[Band(time, low, high, level, ("low", "high"))],
        )  # fmt: skip
        charts = [blocks.Chart("key", of_key, f"{key} and its interval over the time of the test")]
        known = [one for one in records(self._last.test.series) if one[0].quantity in _DRAWN][:1]
        charts += [
            blocks.Chart("record", self._record(*one, unit, seconds, level),
                         "Readings, and histories of this specimen")
            for one in known
        ]  # fmt: skip
        summary: list[blocks.Block] = [blocks.Lines([*map(with_signs, answer["summary"])])]
        summary += [blocks.Lines(answer["doubts"], warning=True)] * bool(answer["doubts"])
        sections = [
            blocks.Section("Summary", summary),
            blocks.Section("Over time", [blocks.Charts(charts)]),
        ]
        refresh = 0 if answer["ended"] else _REFRESH
        return blocks.Page("Running test", answer["test"], sections, refresh=refresh)

    def _record(self, series: Series, part: slice, unit: str, seconds: float, level: str) -> Panel:
        """Return the panel of a record, whose readings are a part of the test's."""
        specimen, histories = self._last, self._follower.histories
        steps = specimen.some(_PREDICTED).v @ histories.parts[series.name].T
        middle = self._follower.middle(specimen, specimen.test)
        added = specimen.likelihood.likelihood.nuisance_draws(middle[None])[0][0, part]
        symbol, factor = DISPLAY_UNITS.get(series.quantity, ("N mm", 1.0))
        time, ends = histories.time / seconds, factor * np.quantile(steps, self._tails, axis=0)
        return Panel(
            Axis(f"time ({unit})"), Axis(f"{series.quantity} ({symbol})", zero=True),
            "readings, and histories of this specimen",
            curves=[Curve(time, ends[1], "median", COLOURS[1])],
            bands=[Band(time, ends[0], ends[2], level, ("low", "high"))],
            points=[Points(series.x / seconds, factor * (series.value - added),
                           "readings, less offset and drift")],
        )  # fmt: skip


def surprise(follower: Follower, before: Specimen, after: Specimen) -> float:
    """Return how probable new readings are that leave the model of old ones by so much.

    The least sum of squares over histories, nuisances and growth times is larger with the new ones
    by chi squared of as many degrees of freedom: by the squares of recursive residuals (Brown,
    Durbin and Evans 1975).

    Parameters
    ----------
    before, after : draws by old readings, and by these and the new ones.
    """
    old, both = before.likelihood.likelihood, follower.likelihood_like(before, after.test)
    if follower.problem.settings.loss == "student":
        setting = both.adapted(follower.middle(after, after.test), "student")
        both = TestLikelihood(after.test, setting, before.shares)
    new = int((sides(after.test) == 0.0).sum() - (sides(before.test) == 0.0).sum())
    square = _least_squares(follower, both, after) - _least_squares(follower, old, before)
    if new == 0 or square <= 0.0:
        return 1.0
    freedom = [
        noise.freedom - follower.m
        for part, noise in zip(old.parts, old.noises, strict=True)
        if before.test.series[part[0]].sd_fitted
    ]
    if freedom:
        return float(fdtrc(new, max(min(freedom), 1.0), square / new))
    return float(chi2.sf(square, new))


def _least_squares(follower: Follower, likelihood: TestLikelihood, specimen: Specimen) -> float:
    """Return the least sum of squares of the readings of a test, and of priors, over some draws."""
    test, known = likelihood.test, follower.before[:, : follower.m]
    some = specimen.some(_PREDICTED)
    readings = follower.histories.read(follower.histories.parts, test) @ some.v.T
    off = some.unknowns[:, : follower.m] - known.mean(axis=0)
    total = ((off @ np.linalg.inv(np.atleast_2d(np.cov(known.T)))) * off).sum(axis=1)
    for noise in likelihood.noises:
        rest = noise.data(likelihood.data[noise.rows])[:, None] - readings[noise.rows]
        squares = noise.squares(rest)
        for i, kind in noise.nuisances.owners:
            time = test.series[i].growth_time if kind == "thermal" else None
            if time is not None and time.prior is not None:
                off = (noise.nuisances.times - time.prior.mean) / time.prior.sd
                squares += np.square(off)[:, None]
        total += squares.min(axis=0)
    return float(total.min())


def time_to_goal(
    follower: Follower, specimen: Specimen, key: int, ratio: float
) -> tuple[float | None, float]:
    """Return when the sd of a key is so much less, s, or None; and how much less at the end.

    Records go on at their rate; histories are linear in the keys, by regression on the draws.

    Parameters
    ----------
    key : its number.
    ratio : of the sd that is wished over that by the readings until now.
    """
    test, m, histories = specimen.test, follower.m, follower.histories
    end = test.case.time.end
    planned = replace(test, series=tuple(_to_end(series, end) for series in test.series))
    slopes = np.linalg.lstsq(
        np.insert(specimen.unknowns[:, :m], 0, 1.0, axis=1), specimen.v, rcond=None
    )[0][1:].T
    by_key = {name: part @ slopes for name, part in histories.parts.items()}
    before = np.linalg.inv(np.atleast_2d(np.cov(follower.before[:, :m].T)))
    at, sds = np.linspace(test.times.max(), end, _TIMES), []
    for time in at:
        information, part = before, part_of(planned, planned.times <= time * (1.0 + 1e-9))
        jacobian = histories.read(by_key, part)
        for noise in follower.likelihood_like(specimen, part).noises:
            middle = len(noise.nuisances.times) // 2
            information = information + noise.grams(jacobian[noise.rows], np.zeros(m), middle)
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
    histories, v, random = follower.histories, specimen.some(_PREDICTED).v, np.random.default_rng(1)
    time, approach = histories.time, histories.parts["approach"]
    depths, old = v @ (approach - approach[0]).T, specimen.likelihood.likelihood
    for body, (slope, worn) in enumerate(old.setting.clocks):
        (noise,), share, most = old.noises, specimen.shares[body], follower.most[body]
        clock = histories.setting.clocks[body][1][: len(time)]
        readings = v @ histories.read(histories.parts, old.test).T
        node = int(np.argmax(old.by_node(readings)[0].sum(axis=1)))
        across = share**2 * most * slope[:, None] * np.minimum.outer(worn, clock)
        rows = np.column_stack([across, noise.data(old.data)[:, None] - readings.T])
        along = noise.grams(rows, np.repeat([0.0, 1.0], [len(time), len(v)]), node)[: len(time)]
        variance = (share * most) ** 2 * np.minimum.outer(clock, clock) - along[:, : len(time)]
        zero = np.zeros(len(time))
        depths += random.multivariate_normal(zero, variance, len(v), method="eigh")
        depths += along[:, len(time) :].T
    return times_at(time, depths, depth)


def _lines(answer: Mapping[str, Any]) -> list[str]:
    """Return the contents of follow.json in lines of text, but for its doubts."""
    goal, end, level = answer["goal"], answer["end"], f"{100 * answer['level']:g} %"
    time = f"{time_words(answer['time'], end)} of {time_words(end, end)}"
    lines = [f"{answer['test']}: {counted(answer['readings'], 'reading')} to {time}"]
    for key, entry in answer["keys"].items():
        numbers, unit = users_numbers(entry)
        (low, high), (first, last) = numbers["interval"], numbers["before"]
        estimate = f"{numbers['estimate']:.3g} {unit}".rstrip()
        lines.append(
            f"  {key}  {estimate} of this specimen  from {low:.3g} to {high:.3g} ({level}, "
            f"+-{entry['percent']:.2g} %; before the test {first:.3g} to {last:.3g})"
        )
    when = f"not before the end, +-{goal['at_end']:.2g} % is expected there"
    if goal["time"] is not None:
        left = goal["time"] - answer["time"]
        when = "reached" if left <= 0.0 else f"in {time_words(left, end)}"
    lines.append(f"  {goal['key']} to +-{goal['percent']:g} %: {when}")
    if answer["depth"] is not None:
        lines.append(f"  {depth_line(answer['depth'], end)}")
    return lines
