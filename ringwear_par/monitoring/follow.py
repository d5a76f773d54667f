"""``ringwear follow``: what the readings of a running test say of its specimen, as they come."""

import logging
import re
import shlex
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ringwear_par.errors import InputError, legible, reason_of
from ringwear_par.files.folders import FOLLOW, check_folder
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.model.histories import Histories
from ringwear_par.identification.model.rounds import Rounds, StoppedError
from ringwear_par.monitoring.answer_files import PAGE, AnswerFiles
from ringwear_par.monitoring.bank import Bank
from ringwear_par.monitoring.histories import planned
from ringwear_par.monitoring.prior_knowledge import FollowedTest, followed_test
from ringwear_par.monitoring.running_state import RunningTestState, Targets
from ringwear_par.monitoring.running_test import RunningTest
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.draws import NEXT
from ringwear_par.prediction.prediction import read_depth
from ringwear_par.results.execution.stop_signals import StopSignals

log = logging.getLogger(__name__)

#: s between two looks at the files
_LOOK = 0.2
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
    followed = followed_test(running, after, comm)
    problem, name = followed.problem, legible(running.name)
    options = {"after": after, "test": test, "to": to, "depth": depth, "draws": draws, "seed": seed}
    words = [w for name, v in options.items() if v is not None for w in (f"--{name}", str(v))]
    command = ["ringwear", "follow", str(source), "-o", str(folder), *words]
    files = AnswerFiles(folder, shlex.join(command))
    with StopSignals() as signals:
        rounds = Rounds(planned(problem), comm, signals)

        def lead() -> None:
            rounds.tell(f"{draws} draws of {name}")
            specimen, values = followed.specimen, followed.known.values
            whom = specimen if specimen == NEXT else f"specimen {legible(specimen)}"
            targets = Targets(_key_of(problem), percent, mm)

            def new_bank(law: str) -> Bank:
                if not law:
                    return Bank(values, specimen, problem, rounds, draws, seed)
                other = problem.alternatives[law]
                histories = Histories(planned(other), MPI.COMM_SELF)  # by this rank alone
                law_values = followed.known.laws[law].values
                return Bank(law_values, specimen, other, histories, draws, seed)

            state = RunningTestState(
                new_bank, followed.log_evidences, targets, whom, followed.doubts
            )
            _follow(followed, state, files, once, lambda: bool(signals.received))

        try:
            rounds.lead(lead)
        except StoppedError:
            if on_first_rank(comm, lambda: files.answer is None):
                raise
    if comm.rank == 0:
        print(files.closing_words())


def _follow(
    followed: FollowedTest,
    state: RunningTestState,
    files: AnswerFiles,
    once: bool,
    stopped: Callable[[], bool],
) -> None:
    """Answer whenever the files change, until the end of the test."""
    stamps, warned, waiting = None, "", False
    while not stopped():
        if (present := followed.running.file_stamps) != stamps:
            stamps = present
            try:
                problem = followed.read()
            except InputError as error:  # it is being written, or was replaced
                if once:
                    raise
                if (reason := reason_of(error)) != warned:
                    log.warning("%s; the last answer stays until that changes", reason)
                warned = reason
            else:
                answer = state.answer(problem)
                ended = once or answer.ended
                files.write(answer, state, problem, last=ended)
                if ended:
                    return
                if not waiting:
                    waiting = True
                    end = problem.experiments[0].case.time.end
                    log.info("waiting for readings up to %g s, the end of the test", end)
        time.sleep(_LOOK)
    files.write_page()


def _key_of(problem: Problem) -> int:
    """Return the number of the key whose interval is to become narrow: the first wear rate."""
    logarithmic = (n for n, p in enumerate(problem.parameters) if p.log and "wear." in p.key)
    return next(logarithmic, 0)


def _percent(text: str, faults: list[str]) -> float:
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*%?\s*", text)
    if match is None or not 0.0 < float(match[1]) < 100.0:
        faults.append(f"--to = {legible(text)}: must be a percentage, such as 10%")
        return np.nan
    if float(match[1]) < 1.0 and "%" not in text:
        faults.append(
            f"--to = {legible(text)}: is a share or a percentage; must be "
            f"{100.0 * float(match[1]):g}% or {match[1]}%"
        )
    return float(match[1])
