"""``ringwear follow``: what the readings of a running test say of its specimen, as they come.

Answers are written, and printed, as text and as a page, whenever the test's files change.
"""

import logging
import time
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, legible, reason_of, warning_lines
from ringwear_par.files.folders import FIT, FOLLOW, check_folder, json_bytes, write_outcome
from ringwear_par.identification.definition.fit_file import experiment_names, read_fit
from ringwear_par.identification.definition.problem import Problem, ProcessNoise
from ringwear_par.identification.definition.series import averaged
from ringwear_par.identification.draws import NEXT, Draws
from ringwear_par.identification.fit import fit_problem
from ringwear_par.identification.histories import Readings, StoppedError
from ringwear_par.monitoring.answer import Monitor
from ringwear_par.monitoring.follower import Follower
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.predict import check_predicted, doubts_of, fit_draws
from ringwear_par.prediction.prediction import read_depth
from ringwear_par.reports.fit_page import stored_outcome
from ringwear_par.reports.report import check_page, write_page
from ringwear_par.results.progress import StopSignals
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: page of a running test
PAGE = "follow.html"
#: s between two looks at the files; between two pages, and two answers that are printed
_LOOK, _PAUSE = 0.2, 5.0
#: fewest draws
_FEWEST = 2000


class RunningTest:
    """An experiment of a fit file that runs, by its name; None: the last one.

    Raises
    ------
    InputError : there is none of this name.
    """

    def __init__(self, source: Path, name: str | None) -> None:
        #: names of all experiments
        self.names = experiment_names(source)
        if not self.names:  # the fit file's own sentences say why
            read_fit(source)
        #: the fit file, and the name of the experiment
        self.source, self.name = source, self.names[-1] if name is None else name
        if self.name not in self.names:
            known = ", ".join(map(legible, self.names))
            raise InputError(f"--test = {legible(self.name)}: must be one of {known} of {source}")
        self._files = {source.name}

    @property
    def file_stamps(self) -> list[tuple[int, int, int]]:
        """What changes when the fit file or a file that was read is written to."""
        stamps = []
        for name in sorted(self._files):
            with suppress(OSError):  # it may be replaced just now
                status = (self.source.parent / name).stat()
                stamps.append((status.st_ino, status.st_size, status.st_mtime_ns))
        return stamps

    def other_tests(self) -> Problem:
        """Return the problem of the other tests of the fit file, to be fitted before.

        Raises
        ------
        InputError : faults of the file; there is none, or they cannot tell what scatters.
        """
        if len(self.names) == 1:
            raise InputError(
                f"{self.source}: has no test but {legible(self.name)}; --after must name the "
                "folder of a fit of others"
            )
        return read_fit(self.source, running=self.name, others=True)

    def read(self) -> Problem:
        """Return the problem of this test alone, with its readings so far.

        Raises
        ------
        InputError : its faults, and what cannot be followed.
        """
        problem = read_fit(self.source, running=self.name)
        self._files |= {*problem.hashes}
        (test,) = problem.experiments
        faults = [
            f"{self.source}: {legible(self.name)}: {series.file or series.name}: {assumption}; its "
            "unit must be given"
            for series in test.series
            for assumption in series.assumptions
        ]
        if faults:
            raise InputError(*faults)
        series = tuple(averaged(record, test.case.time.end) for record in test.series)
        return replace(problem, experiments=(replace(test, series=series),))


def run_follow(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    after: Path | None = None,
    test: str | None = None,
    to: str = "10%",
    depth: str | None = None,
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
        running = RunningTest(source, test)
        running.read()
        return running, percent, mm

    running, percent, mm = on_first_rank(comm, begin)
    fit = after or fit_problem(on_first_rank(comm, running.other_tests), comm)
    known = on_first_rank(comm, lambda: fit_draws(fit))
    with StopSignals() as signals:
        readings = Readings(on_first_rank(comm, running.read), comm, signals)

        def monitor_of(problem: Problem) -> Monitor:
            problem, of, doubts = _followed(running, problem, after, known)
            readings.tell(f"histories of {legible(running.name)}")
            # the interval of the first wear rate is to become narrow
            rates = [n for n, p in enumerate(problem.parameters) if p.log and "wear." in p.key]
            follower = Follower(known, of, problem, readings, draws, seed)
            return Monitor(follower, ((*rates, 0)[0], percent), mm, doubts)

        readings.lead(lambda: _loop(running, monitor_of, folder, once, signals))


def _percent(text: str, faults: list[str]) -> float:
    with suppress(ValueError):
        if 1.0 <= (percent := float(text.strip().removesuffix("%"))) < 100.0:
            return percent
    faults.append(f"--to = {legible(text)}: must be a percentage, 1% to 99%, such as 15%")
    return np.nan


def _followed(
    running: RunningTest, problem: Problem, after: Path | None, draws: Draws
) -> tuple[Problem, str, list[str]]:
    """Return the problem of a test with the random wear that the fit knows, whose test, and doubts.

    InputError for the test of another fit.
    """
    if after:
        with stored_outcome(after / FIT, "the outcome of ringwear fit") as outcome:
            tested = running.name in outcome["experiments"]
        if tested:
            raise InputError(
                f"{running.source}: {legible(running.name)}: is among the tests of {after}, so "
                "that its readings would count twice; must be followed after a fit without it"
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
    return problem, of, [doubt.text for doubt in doubts_of(draws, test.case, of)]


def frame_of(problem: Problem) -> tuple[Hashable, ...]:
    """Return all of a problem of one test but its readings over time, which histories are for."""
    (test,) = problem.experiments
    return (problem.text, test.case.text, *(s.x.tobytes() for s in test.series if not s.timed))


def _loop(
    running: RunningTest,
    monitor_of: Callable[[Problem], Monitor],
    folder: Path,
    once: bool,
    signals: StopSignals,
) -> None:
    """Answer whenever the files change, until the end of the test."""
    answer: dict[str, Any] = {}
    stamps, warned, frame, printed, alarmed, ended = None, "", None, -_PAUSE, False, False
    while not (ended or signals.received):
        if (present := running.file_stamps) == stamps:
            time.sleep(_LOOK)
            continue
        stamps = present
        try:
            problem = running.read()
            if frame_of(problem) != frame:
                monitor, frame = monitor_of(problem), frame_of(problem)
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
        write_outcome(folder, "follow", {FOLLOW: partial(json_bytes, answer)})
        ended, alarm = once or answer["ended"], answer["alarm"] is not None
        if not ended and (alarm > alarmed or time.monotonic() - printed > _PAUSE):
            _show(folder, monitor, answer)
            printed, alarmed = time.monotonic(), alarm
    if not answer:
        raise StoppedError("stopped before the first answer")
    print("\n".join([*_show(folder, monitor, answer), f"written: {folder / FOLLOW}"]))


def _show(folder: Path, monitor: Monitor, answer: dict[str, Any]) -> list[str]:
    """Print an answer, and write its page; return a line about that."""
    print("\n".join([*answer["summary"], *warning_lines(answer["doubts"])]), flush=True)
    try:
        check_page(folder / PAGE)
    except InputError as error:
        return warning_lines([str(error)])
    return [f"written: {write_page(monitor.page(answer), folder / PAGE)}"]
