"""``ringwear follow``: what the readings of a running test say of its specimen, as they come.

Answers are written, and printed, as text and as a page, whenever the test's files have changed.
"""

import logging
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ringwear_par.errors import InputError, legible, reason_of, warning_lines
from ringwear_par.files.folders import FOLLOW, check_folder, json_bytes, write_outcome
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.definition.series import averaged
from ringwear_par.identification.fit import fit_problem
from ringwear_par.identification.histories import Readings, StoppedError
from ringwear_par.monitoring.answer import answer_of, page_of
from ringwear_par.monitoring.follower import Follower
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.predict import fit_draws
from ringwear_par.reports.blocks import Page
from ringwear_par.reports.report import check_page, write_page
from ringwear_par.results.progress import StopSignals
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: page of a running test
PAGE = "follow.html"
#: s between two looks at the files
_PAUSE = 2.0


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

    def begin() -> Problem:
        check_folder(folder, (FOLLOW, PAGE), "follow")
        return read_running(source, test or "")

    running = on_first_rank(comm, begin)
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
            fixed = [series.x.tobytes() for series in test.series if not series.timed]
            if follower is None or frame != (problem.text, test.case.text, fixed):
                readings.tell(f"histories of {legible(name)}")
                follower = Follower(known, problem, readings, draws, seed)
                frame = problem.text, test.case.text, fixed
            found, specimen = answer_of(follower, problem, to, depth)
            _write(folder, found, page_of(found, follower, specimen))
            if once or found["ended"]:
                return
        if follower is None:
            raise StoppedError("stopped before the first answer")

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
                seen = files
                yield problem
        time.sleep(_PAUSE)


def _write(folder: Path, answer: Mapping[str, Any], page: Page) -> None:
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
