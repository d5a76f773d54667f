"""``ringwear follow``: what the readings of a running test say of its specimen, as they come.

Answers are written, and printed, as text and as a page, whenever the test's files have changed:
whether readings are as expected, when they will be enough, and when a depth is reached. They depend
on the readings alone, however these came.
"""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.errors import InputError, counted, legible, reason_of, warning_lines
from ringwear_par.files.folders import FOLLOW, check_folder, json_bytes, write_outcome
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem, records
from ringwear_par.identification.definition.series import averaged
from ringwear_par.identification.fit import fit_problem
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.key_estimates import in_users_unit
from ringwear_par.identification.summary import users_numbers
from ringwear_par.monitoring.follower import Follower, Specimen
from ringwear_par.parallel import on_first_rank
from ringwear_par.pictures.panel import Axis, Points
from ringwear_par.prediction.predict import doubts_of, fit_draws
from ringwear_par.prediction.prediction import TimeTo, over_time, tails
from ringwear_par.reports import blocks
from ringwear_par.reports.report import check_page, write_page
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.progress import StopSignals
from ringwear_par.results.variables import DISPLAY_UNITS
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: page of a running test
PAGE = "follow.html"
#: s between two looks at the files, and after which a browser loads the page anew
_PAUSE, _REFRESH = 2.0, 10
#: share of its time from which on a test has ended
_ENDED = 0.999


def run_follow(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    after: Path | None = None,
    test: str | None = None,
    to: float = 10.0,
    depth: float | None = None,
    draws: int = 20_000,
    seed: int = 0,
    once: bool = False,
) -> None:
    """Follow a running test into a folder until its end, or until a signal comes. Collective.

    Parameters
    ----------
    source : the fit file, one of whose experiments runs.
    after : folder of the fit of earlier tests; None: the other tests of the file are fitted first.
    test : name of the experiment; None: the last one.
    to : half width of the interval that is wished, in percent.
    depth : mm, of penetration, whose time is predicted.
    once : whether only what there is now is read.

    Raises
    ------
    InputError : the file, the folder, or a fit of other keys.
    ComputationError : the histories.
    """
    on_first_rank(comm, lambda: check_folder(folder, (FOLLOW, PAGE), "follow"))
    running = on_first_rank(comm, lambda: read_running(source, test or ""))
    name = running.experiments[0].name
    others = partial(read_fit, source, running=name, others=True)
    fit = after or fit_problem(on_first_rank(comm, others), comm)
    known = on_first_rank(comm, lambda: fit_draws(fit))

    def answer() -> None:
        """Write and print an answer whenever the files have changed."""
        follower, frame = None, None
        for problem in map(known.ordered, _changes(source, name, once, signals)):
            (test,) = problem.experiments
            # histories are for all of a problem but its readings over time
            fixed = [s.name if s.timed else s.x.tobytes() for s in test.series]
            if follower is None or frame != (problem.text, test.case.text, fixed):
                readings.tell(f"histories of {legible(name)}")
                follower = Follower(known, problem, readings, draws, seed)
                frame = problem.text, test.case.text, fixed
            found, specimen = answer_of(follower, problem, to, depth)
            _write(folder, found, page_of(found, follower, specimen))
            if once or found["ended"]:
                return

    with StopSignals() as signals:
        readings = Readings(running, comm, signals)
        readings.lead(answer)


def _changes(source: Path, name: str, once: bool, signals: StopSignals) -> Iterator[Problem]:
    """Yield the problem of a running test, again whenever its files have changed."""
    seen, warned = None, ""
    while not signals.received:
        try:
            problem = read_running(source, name)
        except InputError as error:  # it is being written, or was replaced
            if once:
                raise
            if (reason := reason_of(error)) != warned:
                log.warning("%s; the last answer stays until that changes", reason)
            warned = reason
        else:
            files = problem.text, problem.experiments[0].case.text, problem.hashes
            if files != seen:
                yield problem
            seen, warned = files, ""
        sleep(_PAUSE)


def _write(folder: Path, answer: Mapping[str, Any], page: blocks.Page) -> None:
    """Write and print an answer and its page."""
    contents = {**answer, "versions": versions()}
    write_outcome(folder, "follow", {FOLLOW: partial(json_bytes, contents)})
    lines = [*answer["summary"], *warning_lines(answer["doubts"]), f"written: {folder / FOLLOW}"]
    try:
        check_page(folder / PAGE)
        lines.append(f"written: {write_page(page, folder / PAGE)}")
    except InputError as error:
        lines += warning_lines([str(error)])
    print("\n".join(lines), flush=True)


def read_running(source: Path, name: str = "") -> Problem:
    """Return the problem of one experiment of a fit file, "" the last, with its readings so far.

    Raises
    ------
    InputError : there is none, its faults, and what cannot be followed.
    """
    problem = read_fit(source, running=name)
    (test,) = problem.experiments
    series = tuple(averaged(record, test.case.time.end) for record in test.series)
    return replace(problem, experiments=(replace(test, series=series),))


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
    specimens, alarm = follower.followed(test)
    specimen, end, now = specimens[-1], test.case.time.end, float(test.times.max())
    # (keys, 3) before the test, and at the end of each window
    trace = [
        np.quantile(problem.values(x[:, : follower.m]), tails(level), axis=0).T.tolist()
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
    goal = next((n for n, p in enumerate(problem.parameters) if p.log and "wear." in p.key), 0)
    reached = keys[problem.keys[goal]]["percent"]
    time, less = follower.time_to_goal(specimen, goal, percent / reached)
    times = [0.0, *(float(one.likelihood.test.times.max()) for one in specimens)]
    doubts = doubts_of(follower.draws, test.case, follower.of)
    texts = [doubt.text for doubt in doubts]
    if alarm is not None:
        texts.insert(
            0,
            f"alarm: readings leave the predicted band from {time_words(alarm['time'], end)} on "
            f"(p = {alarm['probability']:.1g}): a transition, a layer worn through, or the rig; "
            "all numbers are of the readings before",
        )
    answer = {
        "test": test.name, "whom": follower.of, "time": now, "end": end,
        "ended": now >= _ENDED * end, "readings": test.n, "level": level, "keys": keys,
        "depth": None, "alarm": alarm,
        "trace": [[t, *ends[goal]] for t, ends in zip(times, trace, strict=True)],
        "goal": {"key": problem.keys[goal], "percent": percent, "time": time,
                 "at_end": reached * less},
        "doubts": texts,
    }  # fmt: skip
    if depth is not None:
        depths = follower.penetrations(specimen)
        answer["depth"] = TimeTo.of(follower.time, depths, depth, level)._asdict()
    return {**answer, "summary": _lines(answer)}, specimen


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
        lines.append(f"  {TimeTo(**answer['depth']).line(end)}")
    return lines


def page_of(answer: Mapping[str, Any], follower: Follower, specimen: Specimen) -> blocks.Page:
    """Return the page of an answer, by the draws of the specimen that it is made of."""
    key, end, level = answer["goal"]["key"], answer["end"], f"{100 * answer['level']:g} %"
    numbers, unit = users_numbers(answer["keys"][key])
    time, *ends = np.array(answer["trace"]).T
    axis, quantiles = Axis(f"{key} ({in_signs(unit or '1')})"), np.array(ends) / numbers["scale"]
    panels = [over_time(axis, "by the readings until then", time, end, quantiles, {level: 0.3})]
    test, x = specimen.likelihood.test, specimen.some
    middle = follower.readings(x, test).mean(axis=0)
    added = specimen.likelihood.nuisance_draws(middle[None])[0][0]
    for series, part in (one for one in records(test.series) if one[0].quantity in DISPLAY_UNITS):
        steps = follower.emulator(x[:, : follower.m])[:, follower.places[series.name]]
        symbol, factor = DISPLAY_UNITS[series.quantity]
        quantiles = factor * np.quantile(steps, tails(answer["level"]), axis=0)
        axis, words = Axis(f"{series.quantity} ({symbol})", zero=True), "histories of this specimen"
        panel = over_time(axis, words, follower.time, end, quantiles, {level: 0.3})
        at, values = series.x / time_unit(end)[1], factor * (series.value - added[part])
        points = [Points(at, values, "readings, less offset and drift")]
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
