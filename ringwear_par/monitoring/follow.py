"""``ringwear follow``: what the readings of a running test say of its specimen, as they come."""

import logging
import re
import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

from ringwear_par.cases.units import number_in
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, legible, reason_of
from ringwear_par.files.folders import FIT, FOLLOW, check_folder
from ringwear_par.files.text import parse_json, read_text
from ringwear_par.history.derivatives.elastic_numbers import is_elastic
from ringwear_par.identification.definition.problem import Problem, ProcessNoise
from ringwear_par.identification.fit import fit_problem
from ringwear_par.identification.model.rounds import Rounds, StoppedError
from ringwear_par.monitoring.answer_files import PAGE, AnswerFiles
from ringwear_par.monitoring.bank import Bank
from ringwear_par.monitoring.histories import planned
from ringwear_par.monitoring.running_test import RunningTest
from ringwear_par.monitoring.watch import Watch, Wishes
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.draws import NEXT
from ringwear_par.prediction.known import FitKnowledge, check_predicted, doubts_of, fit_knowledge
from ringwear_par.results.execution.stopping import StopSignals

log = logging.getLogger(__name__)

#: s between two looks at the files
_LOOK = 0.2
#: fewest draws
_FEWEST = 2000
_NOT_KNOWN = (
    "has neither scatter nor random wear, and a sensor's intervals would stop tests too early: "
    'scatter = "fit" with repeats, a known scatter, or process is needed'
)


@dataclass(frozen=True, eq=False)
class _Job:
    """What is followed.

    Parameters
    ----------
    test : that runs; problem : of it alone, with the random wear that the fit knows.
    known : before the test; of : whom that is about.
    """

    test: RunningTest
    problem: Problem
    known: FitKnowledge
    of: str


def run_follow(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    after: Path | None = None,
    test: str | None = None,
    to: str = "10%",
    depth: str | None = None,
    draws: int = 10_000,
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
    InputError : the file, the folder, or a fit that knows neither scatter nor random wear.
    ComputationError : the histories.
    """

    def begin() -> tuple[RunningTest, float, float | None]:
        for name, number, least in (("draws", draws, _FEWEST), ("seed", seed, 0)):
            if number < least:
                raise InputError(f"--{name} = {number}: must be a whole number >= {least}")
        wishes = _percent(to), None if depth is None else _depth(depth)
        check_folder(folder, (FOLLOW, PAGE), "follow")
        running = RunningTest.of(source, test)
        while not once and (missing := running.missing):
            log.info("waiting for readings in %s", ", ".join(map(str, missing)))
            while running.missing == missing:
                time.sleep(_LOOK)
        running.read()
        return running, *wishes

    running, percent, mm = on_first_rank(comm, begin)
    if after is None:
        rest = on_first_rank(comm, running.others)
        fit = fit_problem(rest, comm)
        job = on_first_rank(comm, lambda: _job(running, fit_knowledge(fit), set()))
    else:
        job = on_first_rank(comm, lambda: _job(running, fit_knowledge(after), _tests_of(after)))
    problem, name = job.problem, legible(running.name)
    plan = replace(problem, experiments=(planned(problem.experiments[0]),))
    files = AnswerFiles(folder, shlex.join(["ringwear", "follow", str(source), "-o", str(folder)]))
    with StopSignals() as signals:
        rounds = Rounds(plan, comm, signals)

        def lead() -> None:
            rounds.tell(f"{draws} draws of {name}")
            bank = Bank(job.known.values, job.of, problem, rounds, draws, seed)
            doubts = doubts_of(job.known, problem.experiments[0].case, job.of)
            whom = job.of if job.of == NEXT else f"specimen {legible(job.of)}"
            wishes = Wishes(_key_of(problem), percent, mm)
            watch = Watch(bank, wishes, whom, tuple(doubt.text for doubt in doubts))
            _follow(job, watch, files, once, lambda: bool(signals.received))

        try:
            rounds.lead(lead)
        except StoppedError:
            if on_first_rank(comm, lambda: files.answer is None):
                raise
    if comm.rank == 0:
        print(files.closing_words())


def _follow(
    job: _Job, watch: Watch, files: AnswerFiles, once: bool, stopped: Callable[[], bool]
) -> None:
    """Answer whenever the files change, until the end of the test."""
    state, said = None, ""
    while not stopped():
        if (present := job.test.state) != state:
            state = present
            try:
                one = job.test.read()
            except InputError as error:  # it is being written, or was replaced
                if once:
                    raise
                if (reason := reason_of(error)) != said:
                    log.warning("%s; the last answer stays until that changes", reason)
                said = reason
            else:
                one = replace(one, settings=job.problem.settings)
                answer = watch.answer(one)
                ended = once or answer.ended
                files.write(answer, watch, one, last=ended)
                if ended:
                    return
        time.sleep(_LOOK)
    files.write_page()


def _job(running: RunningTest, known: FitKnowledge, tests: set[str]) -> _Job:
    """Return what is followed after a fit of tests. On one rank.

    Raises
    ------
    InputError : the fit knows too little, or other things.
    """
    problem, said = running.read(), f"{running.source}: {legible(running.name)}"
    (experiment,), values = problem.experiments, known.values
    if running.name in tests:
        raise InputError(
            f"{said}: is among the tests of {known.name}, so that its readings would count twice; "
            "must be followed after a fit without it"
        )
    if not len(values.scattering) and not values.sizes.any():
        raise InputError(f"{known.name}: {_NOT_KNOWN}")
    if problem.keys != values.keys:
        raise InputError(
            f"{running.source}: fits {', '.join(problem.keys)}; must be {', '.join(values.keys)}, "
            f"as {known.name}"
        )
    if is_elastic(experiment.case, problem.keys):
        raise InputError(
            f"{running.source}: a modulus, a Poisson's ratio or a thickness is fitted; a test is "
            "followed with numbers of wear laws and friction only"
        )
    specimen = experiment.groups[0] or experiment.name
    of = specimen if specimen in values.specimens else NEXT
    check_predicted(known, experiment.case, said, of)
    # the size itself is drawn
    process = {
        f"wear.{body}": ProcessNoise(size=1.0)
        for body, sizes in zip(("lower", "upper"), values.sizes.T, strict=True)
        if sizes.any()
    }
    settings = replace(problem.settings, process=process)
    return _Job(running, replace(problem, settings=settings), known, of)


def _tests_of(folder: Path) -> set[str]:
    """Return the names of the tests of a fit's folder."""
    if not (folder / FIT).is_file():  # told by who reads the fit
        return set()
    content = parse_json(read_text(folder / FIT))
    return set(content.get("experiments", {})) if isinstance(content, dict) else set()


def _key_of(problem: Problem) -> int:
    """Return the number of the key whose interval is to become narrow: the first wear rate."""
    logarithmic = (n for n, p in enumerate(problem.parameters) if p.log and "wear." in p.key)
    return next(logarithmic, 0)


def _percent(text: str) -> float:
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*%?\s*", text)
    if match is None or not 0.0 < float(match[1]) < 100.0:
        raise InputError(f"--to = {legible(text)}: must be a percentage, such as 10%")
    return float(match[1])


def _depth(text: str) -> float:
    try:
        depth = number_in(text, "mm")
    except RejectedError:
        depth = 0.0
    if not depth > 0.0:
        raise InputError(f"--depth = {legible(text)}: must be a length > 0, such as '20 um'")
    return depth
