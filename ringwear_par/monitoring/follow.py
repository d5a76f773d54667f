"""``ringwear follow``: what the readings of a running test say of its specimen, as they come.

Answers are written, and printed, as text and as a page, whenever the test's files change.
"""

import logging
import time
from collections.abc import Callable, Container, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, counted, legible, reason_of, warning_lines
from ringwear_par.files.folders import FIT, FOLLOW, check_folder, json_bytes, write_outcome
from ringwear_par.identification.definition.problem import Problem, ProcessNoise
from ringwear_par.identification.draws import NEXT, Draws
from ringwear_par.identification.fit import fit_problem
from ringwear_par.identification.histories import Readings, StoppedError
from ringwear_par.identification.summary import users_numbers
from ringwear_par.monitoring.follower import Follower, frame_of
from ringwear_par.monitoring.monitor import Monitor, Question
from ringwear_par.monitoring.running_test import RunningTest
from ringwear_par.parallel import on_first_rank
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.predict import check_predicted, doubts_of, fit_draws
from ringwear_par.prediction.prediction import depth_line, read_depth
from ringwear_par.reports import blocks
from ringwear_par.reports.fit_page import stored_outcome
from ringwear_par.reports.report import check_page, write_page
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.signals import StopSignals
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: page of a running test
PAGE = "follow.html"
#: s between two looks at the files; between two pages, and two answers that are printed
_LOOK, _PAUSE = 0.2, 5.0
#: s, after which a browser loads the page anew
_REFRESH = 10
#: fewest draws
_FEWEST = 2000


def run_follow(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    after: Path | None = None,
    test: str | None = None,
    to: str = "10%",
    depth: str | None = None,
    draws: int = 100_000,
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
    depth : of penetration, with its unit.
    once : whether only what there is now is read.

    Raises
    ------
    InputError : the file, the folder, or a fit of other keys.
    ComputationError : the histories.
    """

    def begin() -> tuple[RunningTest, float, float | None]:
        faults = [
            f"--{name} = {number}: must be a whole number >= {least}"
            for name, number, least in (("draws", draws, _FEWEST), ("seed", seed, 0))
            if number < least
        ]
        percent, mm = _percent(to, faults), None if depth is None else read_depth(depth, faults)
        if faults:
            raise InputError(*faults)
        check_folder(folder, (FOLLOW, PAGE), "follow")
        running = RunningTest.of(source, test)
        running.read()
        return running, percent, mm

    running, percent, mm = on_first_rank(comm, begin)
    fit = after or fit_problem(on_first_rank(comm, running.other_tests), comm)
    known = on_first_rank(comm, lambda: fit_draws(fit))
    read = partial(_followed, running, after, known, percent, mm)
    with StopSignals() as signals:
        readings = Readings(on_first_rank(comm, read)[0], comm, signals)

        def monitor_of(problem: Problem, question: Question) -> Monitor:
            readings.tell(f"histories of {legible(running.name)}")
            return Monitor(Follower(known, question.of, problem, readings, draws, seed), question)

        lines = readings.lead(lambda: _loop(running, read, monitor_of, folder, once, signals))
    if comm.rank == 0:
        print("\n".join(lines))


def _followed(
    running: RunningTest, after: Path | None, draws: Draws, percent: float, depth: float | None
) -> tuple[Problem, Question]:
    """Return the problem of a test, with the random wear that the fit knows, and what is asked.

    On one rank; InputError for the test of another fit.
    """
    problem, place = running.read(), f"{running.source}: {legible(running.name)}"
    tested: Container[str] = ()
    if after:
        with stored_outcome(after / FIT, "the outcome of ringwear fit") as outcome:
            tested = dict(outcome["experiments"])
    if running.name in tested:
        raise InputError(
            f"{place}: is among the tests of {after}, so that its readings would count twice; "
            "must be followed after a fit without it"
        )
    if problem.keys != draws.keys:
        raise InputError(
            f"{problem.name}: fits {', '.join(problem.keys)}; must be {', '.join(draws.keys)}, as "
            "the fit of earlier tests"
        )
    (test,) = problem.experiments
    of = test.groups[0] if test.groups[0] in draws.specimens else NEXT
    check_predicted(draws, test.case, problem.name, of)
    sizes = zip(BODIES, draws.process.T, strict=True)
    process = {f"wear.{body}": ProcessNoise() for body, size in sizes if size.any()}
    problem = replace(problem, settings=replace(problem.settings, process=process))
    doubts = tuple(doubt.text for doubt in doubts_of(draws, test.case, of))
    # the interval of the first wear rate is to become narrow
    rates = [n for n, p in enumerate(problem.parameters) if p.log and "wear." in p.key]
    return problem, Question((*rates, 0)[0], percent, depth, of, doubts)


def _loop(
    running: RunningTest,
    read: Callable[[], tuple[Problem, Question]],
    monitor_of: Callable[[Problem, Question], Monitor],
    folder: Path,
    once: bool,
    signals: StopSignals,
) -> list[str]:
    """Answer whenever the files change, until the end of the test; return the last words."""
    answer: dict[str, Any] = {}
    stamps, warned, frame, printed, alarmed, ended = None, "", None, -_PAUSE, False, False
    while not (ended or signals.received):
        if (present := running.file_stamps) == stamps:
            time.sleep(_LOOK)
            continue
        stamps = present
        try:
            problem, question = read()
            if frame_of(problem) != frame:
                monitor, frame = monitor_of(problem, question), frame_of(problem)
        except InputError as error:  # it is being written, or was replaced
            if once:
                raise
            if (reason := reason_of(error)) != warned:
                log.warning("%s; the last answer stays until that changes", reason)
            warned = reason
            continue
        except StoppedError:
            break
        answer = {**monitor.answer(problem), "versions": versions()}
        answer["summary"], ended = lines_of(answer), once or answer["ended"]
        write_outcome(folder, "follow", {FOLLOW: partial(json_bytes, answer)})
        alarm = answer["alarm"] is not None
        if not ended and (alarm > alarmed or time.monotonic() - printed > _PAUSE):
            _write_page(folder / PAGE, answer, monitor)
            print("\n".join(_printed(answer)), flush=True)
            printed, alarmed = time.monotonic(), alarm
    if not answer:
        raise StoppedError("stopped before the first answer")
    written = _write_page(folder / PAGE, answer, monitor)
    return [*_printed(answer), *written, f"written: {folder / FOLLOW}"]


def _printed(answer: Mapping[str, Any]) -> list[str]:
    return [*answer["summary"], *warning_lines(answer["doubts"])]


def _write_page(page: Path, answer: dict[str, Any], monitor: Monitor) -> list[str]:
    """Write the page of an answer; return a line about it."""
    try:
        check_page(page)
    except InputError as error:
        return warning_lines([str(error)])
    return [f"written: {write_page(page_of(answer, monitor.record()), page)}"]


def _percent(text: str, faults: list[str]) -> float:
    with suppress(ValueError):
        if 1.0 <= (percent := float(text.strip().removesuffix("%"))) < 100.0:
            return percent
    faults.append(f"--to = {legible(text)}: must be a percentage, 1% to 99%, such as 15%")
    return np.nan


def lines_of(answer: Mapping[str, Any]) -> list[str]:
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


def page_of(answer: Mapping[str, Any], record: Panel | None) -> blocks.Page:
    """Return the page, which a browser loads anew while the test runs.

    Parameters
    ----------
    record : the readings with their band; None: there is none.
    """
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
    if record is not None:
        charts.append(blocks.Chart("record", record, "Readings, and histories of this specimen"))
    summary: list[blocks.Block] = [blocks.Lines([*map(with_signs, answer["summary"])])]
    summary += [blocks.Lines(answer["doubts"], warning=True)] * bool(answer["doubts"])
    over_time = blocks.Section("Over time", [blocks.Charts(charts)])
    sections = [blocks.Section("Summary", summary), over_time]
    refresh = 0 if answer["ended"] else _REFRESH
    return blocks.Page("Running test", answer["test"], sections, refresh=refresh)
