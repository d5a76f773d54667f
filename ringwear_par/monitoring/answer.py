"""Answers to the readings of a running test: they depend on these alone, however they came.

Whether readings are as expected, when they will be enough, and when a depth is reached; as numbers,
in lines of text and as a page, which a browser loads anew while the test runs.
"""

import pickle
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.errors import counted
from ringwear_par.identification.definition.problem import Experiment, Problem, Series, records
from ringwear_par.identification.definition.series import averaged
from ringwear_par.identification.doubts import of_units
from ringwear_par.identification.fitted_tests import with_all
from ringwear_par.identification.key_estimates import in_users_unit
from ringwear_par.identification.likelihood import TestLikelihood
from ringwear_par.identification.noise import sides
from ringwear_par.identification.summary import users_numbers
from ringwear_par.monitoring.follower import Follower, Specimen
from ringwear_par.pictures.panel import Axis, Points
from ringwear_par.prediction.predict import doubts_of
from ringwear_par.prediction.prediction import TimeTo, over_time
from ringwear_par.reports import blocks
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.variables import DISPLAY_UNITS

#: windows of a test in which readings are compared with what is expected of them, and the
#: probability below which they are not: 1 of 100 tests without a change has an alarm
WINDOWS = 20
_IMPROBABLE = 0.01 / WINDOWS
#: degrees of freedom of an sd that is known; mm, sd of what is not read
_KNOWN, _UNREAD = 1e9, 1e6
#: draws by which readings are predicted
PREDICTED = 2000
#: times at which the sd of a key is expected
_TIMES = 9
#: share of its time from which on a test has ended
_ENDED = 0.999
#: quantities of records that are drawn; s, after which a browser loads the page anew
_DRAWN, _REFRESH = ("penetration", "approach", "torque"), 10


def part_of(test: Experiment, rows: BoolArray) -> Experiment:
    """Return a test with some of its readings (n,), without series that their nuisances explain."""
    parts = [series.part(rows[place]) for series, place in records(test.series)]
    informative = (
        s for s in parts if s.n > sum(n.free for n in s.nuisances) * (s.censored is None)
    )
    return replace(test, series=tuple(informative))


def answer_of(
    follower: Follower, problem: Problem, percent: float, depth: float | None = None
) -> tuple[dict[str, Any], Specimen]:
    """Return the answer to the readings so far, the contents of follow.json; and the draws.

    Its ``trace`` has the interval of the first wear rate, which is to become narrow, before the
    test and at the end of each window: time, low end, median and high end.

    Parameters
    ----------
    problem : of the running test, with its readings so far.
    percent : half the width of that interval over the median.
    depth : mm, of penetration; None: none is asked for.
    """
    (test,), level = problem.experiments, problem.settings.level
    specimens, alarm = _followed(follower, test)
    specimen, end, now = specimens[-1], test.case.time.end, float(test.times.max())
    # (keys, 3) before the test, and at the end of each window
    trace = [
        np.quantile(follower.draws.values(x[:, : follower.m]), _shares(level), axis=0).T.tolist()
        for x in (follower.before, *(specimen.unknowns for specimen in specimens))
    ]
    keys = {}
    for parameter, unit, (first, _, last), (low, median, high) in zip(
        problem.parameters, follower.draws.units, trace[0], trace[-1], strict=True
    ):
        entry = keys[parameter.key] = {
            "unit": unit, "estimate": median, "interval": (low, high),
            "before": (first, last), "percent": 50.0 * (high - low) / abs(median),
        }  # fmt: skip
        if told := in_users_unit(parameter, entry, test.case):
            entry["told"] = told
    rates = [n for n, p in enumerate(problem.parameters) if p.log and "wear." in p.key]
    goal = (*rates, 0)[0]
    key = problem.keys[goal]
    reached = keys[key]["percent"]
    time, less = time_to_goal(follower, specimen, goal, percent / reached)
    times = [0.0, *(float(one.test.times.max()) for one in specimens)]
    doubts = [*doubts_of(follower.draws, test.case, follower.of), *of_units([test])]
    texts = [doubt.text for doubt in doubts]
    if alarm is not None:
        texts.insert(
            0,
            f"alarm: readings leave the predicted band from {time_words(alarm['time'], end)} on "
            f"(p = {alarm['probability']:.1g}): a transition, a layer worn through, or the rig; "
            "all numbers are of the readings before",
        )
    found = None
    if depth is not None:
        found = TimeTo.of(follower.time, penetrations(follower, specimen), depth, level)
    answer = {
        "test": test.name, "whom": follower.of, "time": now, "end": end,
        "ended": now >= _ENDED * end, "readings": test.n, "level": level, "keys": keys,
        "depth": found and found._asdict(), "alarm": alarm,
        "trace": [[t, *ends[goal]] for t, ends in zip(times, trace, strict=True)],
        "goal": {"key": key, "percent": percent, "time": time, "at_end": reached * less},
        "doubts": texts,
    }  # fmt: skip
    return {**answer, "summary": _lines(answer, found)}, specimen


def _followed(
    follower: Follower, test: Experiment
) -> tuple[list[Specimen], dict[str, float] | None]:
    """Return the draws at the ends of windows and now, or until an alarm, and the alarm."""
    times, end, specimens = test.times, test.case.time.end, list[Specimen]()
    windows = end * np.arange(1, WINDOWS + 1) / WINDOWS
    for window in windows[windows <= times.max() * (1.0 + 1e-9)]:
        part = part_of(test, times <= window * (1.0 + 1e-9))
        if part.n == (specimens[-1].test.n if specimens else 0):
            continue
        content = pickle.dumps(part.series)
        if content not in follower.windows:
            later = follower.update(part)
            p = surprise(follower, specimens[-1], later) if specimens else 1.0
            follower.windows[content] = later, p
        later, probability = follower.windows[content]
        if probability < _IMPROBABLE:
            first = times[times > specimens[-1].test.times.max()].min()
            return specimens, {"time": float(first), "probability": probability}
        specimens.append(later)
    if not specimens or specimens[-1].test.n < test.n:
        specimens.append(follower.update(test))
    return specimens, None


def surprise(follower: Follower, before: Specimen, after: Specimen) -> float:
    """Return how probable new readings are that leave the model of old ones by so much.

    The least sum of squares over histories, nuisances and growth times is larger with the new ones
    by chi squared of as many degrees of freedom: by the squares of recursive residuals (Brown,
    Durbin and Evans 1975). Draws are by the old readings before, and by all after.
    """
    old, both = before.likelihood, follower.likelihood_like(before, after.test)
    if follower.problem.settings.loss == "student":
        middle = follower.readings(after, after.test).mean(axis=0)
        both = TestLikelihood(after.test, both.adapted(middle, "student"), before.shares)
    new = int((sides(after.test) == 0.0).sum() - (sides(before.test) == 0.0).sum())
    square = _least_squares(follower, both, after) - _least_squares(follower, old, before)
    if new == 0 or square <= 0.0:
        return 1.0
    fitted = (
        max(noise.freedom - follower.m, 1.0) for noise in old.noises if noise.series[0].sd_fitted
    )
    return float(fdtrc(new, min(fitted, default=_KNOWN), square / new))


def _least_squares(follower: Follower, likelihood: TestLikelihood, specimen: Specimen) -> float:
    """Return the least sum of squares of the readings of a test, and of priors, over some draws."""
    known, some = follower.before[:, : follower.m], specimen.some(PREDICTED)
    off = some.unknowns[:, : follower.m] - known.mean(axis=0)
    total = ((off @ np.linalg.inv(np.atleast_2d(np.cov(known.T)))) * off).sum(axis=1)
    readings = follower.readings(some, likelihood.test)
    return float((total + likelihood.least_squares(readings).sum(axis=0)).min())


def time_to_goal(
    follower: Follower, specimen: Specimen, key: int, ratio: float
) -> tuple[float | None, float]:
    """Return when the sd of a key is so much less, s, or None; and how much less at the end.

    Records go on at their rate; histories are linear in the keys, by regression on the draws. The
    ratio is of the sd of key number ``key`` that is wished over that by the readings until now.
    """
    test, m = specimen.test, follower.m
    end = test.case.time.end
    planned = replace(test, series=tuple(_to_end(series, end) for series in test.series))
    unknowns = np.insert(specimen.unknowns[:, :m], 0, 1.0, axis=1)
    slopes = np.linalg.lstsq(unknowns, specimen.v, rcond=None)[0][1:].T
    before = np.linalg.inv(np.atleast_2d(np.cov(follower.before[:, :m].T)))
    at, sds = np.linspace(test.times.max(), end, _TIMES), []
    for time in at:
        information, part = before, part_of(planned, planned.times <= time * (1.0 + 1e-9))
        jacobian = follower.weights(part) @ (follower.columns @ slopes)
        for noise in follower.likelihood_like(specimen, part).noises:
            middle = len(noise.nuisances.times) // 2
            information = information + noise.reduced(jacobian[noise.rows], 0.0).grams()[middle]
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


def penetrations(follower: Follower, specimen: Specimen) -> FloatArray:
    """Return this specimen's penetration (draws, steps) to the end of the test, mm.

    Wear that is random goes on from what the readings tell of it, as if nothing were read later.
    """
    time, approach = follower.time, follower.columns[follower.places["approach"]]
    some, test = specimen.some(PREDICTED), specimen.test
    depths: FloatArray = some.v @ (approach - approach[0]).T
    if follower.setting.clocks:
        later = Series("approach", "approach", time, 0.0 * time, np.full(len(time), _UNREAD))
        both = replace(test, series=(*test.series, later))
        likelihood, random = follower.likelihood_like(specimen, both), np.random.default_rng(1)
        _, worn, _ = with_all(likelihood, follower.readings(some, both), random)
        depths += worn[:, test.n :] @ follower.most
    return depths


def _lines(answer: Mapping[str, Any], depth: TimeTo | None) -> list[str]:
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
    if depth is not None:
        lines.append(f"  {depth.line(end)}")
    return lines


def page_of(answer: Mapping[str, Any], follower: Follower, specimen: Specimen) -> blocks.Page:
    """Return the page of an answer, by the draws of the specimen that it is made of."""
    key, end, level = answer["goal"]["key"], answer["end"], f"{100 * answer['level']:g} %"
    numbers, unit = users_numbers(answer["keys"][key])
    time, *ends = np.array(answer["trace"]).T
    axis, quantiles = Axis(f"{key} ({in_signs(unit or '1')})"), np.array(ends) / numbers["scale"]
    panels = [over_time(axis, "by the readings until then", time, end, quantiles, {level: 0.3})]
    known = [one for one in records(specimen.test.series) if one[0].quantity in _DRAWN]
    for series, part in known[:1]:
        steps = specimen.some(PREDICTED).v @ follower.columns[follower.places[series.name]].T
        middle = follower.readings(specimen, specimen.test).mean(axis=0)
        added = specimen.likelihood.nuisance_draws(middle[None])[0][0, part]
        symbol, factor = DISPLAY_UNITS.get(series.quantity, ("N mm", 1.0))
        quantiles = factor * np.quantile(steps, _shares(answer["level"]), axis=0)
        axis, words = Axis(f"{series.quantity} ({symbol})", zero=True), "histories of this specimen"
        panel = over_time(axis, words, follower.time, end, quantiles, {level: 0.3})
        x, values = series.x / time_unit(end)[1], factor * (series.value - added)
        points = [Points(x, values, "readings, less offset and drift")]
        panels.append(replace(panel, points=points))
    charts = [blocks.chart(panel, f"{panel.y.label}: {panel.title}") for panel in panels]
    summary = [blocks.Lines([*map(with_signs, answer["summary"])])]
    if answer["doubts"]:
        summary.append(blocks.Lines([*map(with_signs, answer["doubts"])], warning=True))
    sections = [
        blocks.Section("Summary", summary),
        blocks.Section("Over time", [blocks.Pictures(charts)]),
    ]
    refresh = 0 if answer["ended"] else _REFRESH
    return blocks.Page("Running test", answer["test"], sections, refresh=refresh)


def _shares(level: float) -> tuple[float, float, float]:
    """Return the probabilities of the ends of intervals, and of the median between them."""
    return 0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level
