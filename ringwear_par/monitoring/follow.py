"""``ringwear follow``: what the readings of a running test say of its specimen, as they come."""

import json
import logging
import shlex
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, legible, reason_of, warning_lines
from ringwear_par.files.folders import FIT, FOLLOW, check_folder, json_bytes, write_outcome
from ringwear_par.files.text import read_text
from ringwear_par.identification.definition.problem import Problem, ProcessNoise
from ringwear_par.identification.draws import NEXT
from ringwear_par.identification.fit import fit_problem
from ringwear_par.identification.histories import Readings, StoppedError
from ringwear_par.monitoring.answer import Answer, lines_of, page_of, warnings_of
from ringwear_par.monitoring.follower import Follower
from ringwear_par.monitoring.histories import frame_of
from ringwear_par.monitoring.monitor import Asked, Monitor
from ringwear_par.monitoring.running_test import RunningTest
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.known import FitKnowledge, check_predicted, doubts_of, fit_knowledge
from ringwear_par.prediction.prediction import read_depth
from ringwear_par.reports.report import check_page, write_page
from ringwear_par.results.signals import StopSignals
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: page of a running test
PAGE = "follow.html"
#: s between two looks at the files; between two pages, and two answers that are printed
_LOOK, _PAUSE = 0.2, 5.0
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
        while not once and (missing := running.missing):
            log.info("waiting for readings in %s", ", ".join(map(str, missing)))
            while running.missing == missing:
                time.sleep(_LOOK)
        running.read()
        return running, percent, mm

    running, percent, mm = on_first_rank(comm, begin)
    fit: Any = after
    if after is None:
        fit = fit_problem(on_first_rank(comm, running.other_tests), comm)
    known = on_first_rank(comm, lambda: fit_knowledge(fit))

    def read() -> _Followed:
        return _followed(running, after, known)

    options = {"after": after, "test": test, "to": to, "depth": depth, "draws": draws, "seed": seed}
    words = [w for name, v in options.items() if v is not None for w in (f"--{name}", str(v))]
    command = shlex.join(["ringwear", "follow", str(source), "-o", str(folder), *words])
    with StopSignals() as signals:
        readings = Readings(on_first_rank(comm, read).problem, comm, signals)

        def monitor_of(followed: _Followed) -> Monitor:
            readings.tell(f"histories of {legible(running.name)}")
            problem, of = followed.problem, followed.specimen
            followers = {"": Follower(known.draws, of, problem, readings, draws, seed)}
            for law, other in problem.alternatives.items():  # by this rank alone
                alone = Readings(other, MPI.COMM_SELF, signals)
                followers[law] = Follower(known.laws[law], of, other, alone, draws, seed)
            laws = {"": known.draws, **known.laws} if problem.alternatives else {}
            evidences = {law: laws[law].log_evidence for law in followers if law in laws}
            whom = of if of == NEXT else f"specimen {legible(of)}"
            asked = Asked(_key_of(problem), percent, mm, whom, followed.doubts)
            return Monitor(followers, known.draws, evidences, asked)

        def lead() -> list[str]:
            return _loop(
                running, read, monitor_of, folder, command, once, lambda: bool(signals.received)
            )

        lines = readings.lead(lead)
    if comm.rank == 0:
        print("\n".join(lines))


class _Followed(NamedTuple):
    """A test that is followed, and of whom the draws are before it."""

    #: of it alone, with the random wear that the fit knows, under all laws that are compared
    problem: Problem
    #: the next specimen, or one of the fit's
    specimen: str
    doubts: tuple[str, ...]


def _followed(running: RunningTest, after: Path | None, known: FitKnowledge) -> _Followed:
    """Return a test with what a fit knows before it, or raise InputError. On one rank."""
    problem, place = running.read(), f"{running.source}: {legible(running.name)}"
    if after and running.name in json.loads(read_text(after / FIT)).get("experiments", {}):
        raise InputError(
            f"{place}: is among the tests of {known.name}, so that its readings would count twice; "
            "must be followed after a fit without it"
        )
    (experiment,), asked = problem.experiments, problem.alternatives
    specimen = experiment.groups[0] or experiment.name
    specimen = specimen if specimen in known.draws.specimens else NEXT
    laws = {law: asked[law] for law in known.laws if law in asked}
    if known.laws and (unknown := [law for law in asked if law not in laws]):
        raise InputError(
            f"{running.source}: compare.{legible(unknown[0])}: was not compared by {known.name}; "
            f"must be {' or '.join(map(legible, known.laws))}, as there, or absent"
        )
    doubts = [doubt.text for doubt in doubts_of(known, experiment.case, specimen)]
    doubts += [
        f"law {legible(law)} is not compared: {known.name} has no draws of it"
        for law in asked if not known.laws
    ]  # fmt: skip
    if problem.settings.loss != "gaussian" and laws:
        laws = {}
        doubts.append(f'laws are not compared: loss = "{problem.settings.loss}" has no evidence')
    pairs = [(problem, known.draws), *((law, known.laws[name]) for name, law in laws.items())]
    for of_law, draws in pairs:
        if of_law.keys != draws.keys:
            raise InputError(
                f"{of_law.name}: fits {', '.join(of_law.keys)}; must be {', '.join(draws.keys)}, "
                f"as {known.name}"
            )
        check_predicted(draws, of_law.experiments[0].case, of_law.name, specimen)
    sizes = zip(BODIES, known.draws.process.T, strict=True)
    process = {f"wear.{body}": ProcessNoise() for body, size in sizes if size.any()}
    settings = replace(problem.settings, process=process)
    laws = {name: replace(law, settings=settings) for name, law in laws.items()}
    problem = replace(problem, settings=settings, alternatives=laws)
    return _Followed(problem, specimen, tuple(doubts))


def _loop(
    running: RunningTest,
    read: Callable[[], _Followed],
    monitor_of: Callable[[_Followed], Monitor],
    folder: Path,
    command: str,
    once: bool,
    stopped: Callable[[], bool],
) -> list[str]:
    """Answer whenever the files change, until the end of the test; return the last words."""
    answer: Answer | None = None
    stamps, warned, frame, said, alarmed, ended = None, "", None, -_PAUSE, False, False
    while not (ended or stopped()):
        if (present := running.file_stamps) == stamps:
            time.sleep(_LOOK)
            continue
        stamps = present
        try:
            followed = read()
            if frame_of(followed.problem) != frame:
                monitor, frame = monitor_of(followed), frame_of(followed.problem)
        except InputError as error:  # it is being written, or was replaced
            if once:
                raise
            if (reason := reason_of(error)) != warned:
                log.warning("%s; the last answer stays until that changes", reason)
            warned = reason
            continue
        except StoppedError:
            break
        answer = monitor.answer(followed.problem)
        content, ended = {**answer, "versions": versions()}, once or answer["ended"]
        write_outcome(folder, "follow", {FOLLOW: partial(json_bytes, content)})
        alarm = answer["alarm"] is not None and not alarmed
        if not ended and (alarm or time.monotonic() - said > _PAUSE):
            _write_page(folder, answer, monitor, command)
            warnings = warning_lines(warnings_of(answer) if alarm else [])
            print("\n".join([*lines_of(answer), *warnings]), flush=True)
            said, alarmed = time.monotonic(), alarmed or alarm
    if answer is None:
        raise StoppedError("stopped before the first answer")
    written = _write_page(folder, answer, monitor, command)
    return [*lines_of(answer), *warning_lines(warnings_of(answer)), *written]


def _write_page(folder: Path, answer: Answer, monitor: Monitor, command: str) -> list[str]:
    """Write the page of an answer; return what stands in the folder, and why there is no page."""
    outcome, page = folder / FOLLOW, folder / PAGE
    try:
        check_page(page)
    except InputError as error:
        return [*warning_lines([str(error)]), f"written: {outcome}"]
    write_page(page_of(answer, monitor.record(), command, versions()), page)
    return [f"written: {outcome}, {page}"]


def _key_of(problem: Problem) -> int:
    """Return the number of the key whose interval is to become narrow: the first wear rate."""
    logarithmic = (n for n, p in enumerate(problem.parameters) if p.log and "wear." in p.key)
    return next(logarithmic, 0)


def _percent(text: str, faults: list[str]) -> float:
    with suppress(ValueError):
        if 1.0 <= (percent := float(text.strip().removesuffix("%"))) < 100.0:
            return percent
    faults.append(f"--to = {legible(text)}: must be a percentage, 1% to 99%, such as 15%")
    return np.nan
