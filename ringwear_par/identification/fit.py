"""``rw.fit`` and ``ringwear fit``: values of case keys from measurements."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.files.folders import check_folder
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.definition.series import BLOCKS, averaged
from ringwear_par.identification.design.information import expectation
from ringwear_par.identification.fit_result import FILES, FitResult, result_of
from ringwear_par.identification.histories import Readings, StoppedError
from ringwear_par.identification.record_checks import refuse_unfit
from ringwear_par.identification.solution import solve
from ringwear_par.parallel import on_first_rank, warn_of_threads
from ringwear_par.results.progress import StopSignals
from ringwear_par.results.result import Outcome

log = logging.getLogger(__name__)


def fit(
    source: Path | str | Mapping[str, Any],
    comm: MPI.Intracomm | None = None,
    *,
    compare: bool = False,
) -> FitResult:
    """Return what measurements say of case keys: draws of their posterior, and intervals.

    Collective on comm, the world's where none is given; the same on all ranks.

    Parameters
    ----------
    source : the name of a fit file, or the same as a dict.
    compare : whether the laws of ``[compare]`` are fitted as well.

    Returns
    -------
    FitResult : ``.parameters`` as in fit.json, ``.doubts``, ``.summary()``, ``.save(folder)``.

    Raises
    ------
    InputError : all faults of the file and its data.
    ComputationError : there are no histories, or draws cannot be had.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    problem = on_first_rank(comm, lambda: read_fit(source))
    return fit_problem(problem, comm, compare=compare)


def fit_problem(problem: Problem, comm: MPI.Intracomm, *, compare: bool = False) -> FitResult:
    """Return the fit of a problem that was read. Collective on comm.

    Other laws follow the first one; one that fails does not end the fit.
    """
    with StopSignals() as signals:
        result = _fit_law(problem, comm, signals)
        for law, alternative in problem.alternatives.items() if compare else ():
            try:
                content = _fit_law(alternative, comm, signals).content
                del content["alternatives"], content["data"]
            except StoppedError:
                raise
            except (ComputationError, InputError) as error:
                content = {"error": reason_of(error)}
            result.content["alternatives"][law] = content
    return result


def _fit_law(problem: Problem, comm: MPI.Intracomm, signals: StopSignals) -> FitResult:
    """Return the result under one law. Collective on comm."""
    if problem.settings.process:  # matrices of all readings of a test
        tests = []
        for test in problem.experiments:
            end = test.case.time.end
            series = [averaged(s, end) if s.n > BLOCKS else s for s in test.series]
            tests.append(replace(test, series=tuple(series)))
        problem = replace(problem, experiments=tuple(tests))
    readings = Readings(problem, comm, signals)

    def lead() -> FitResult:
        refuse_unfit(readings)
        return result_of(solve(readings))

    return readings.lead(lead)


def into_folder(
    folder: Path,
    files: Sequence[str],
    comm: MPI.Intracomm,
    compute: Callable[[], Outcome],
    command: str = "fit",
) -> None:
    """Write the outcome of a command to a folder, and print its summary. Collective.

    Parameters
    ----------
    files : that it has, first the one which says that it is whole.
    compute : returns the outcome; collective.
    command : see ``check_folder``.
    """

    def check() -> None:
        check_folder(folder, files, command)
        announce_replacement(folder / files[0])

    on_first_rank(comm, check)
    result = compute()
    on_first_rank(comm, lambda: result.save(folder))
    if comm.rank == 0:
        print(result.summary())
        print(closing_line(folder, files))


def run_fit(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    dry_run: bool = False,
    compare: bool = False,
) -> None:
    """Fit and write the outcome to a folder, or in a dry run print what to expect. Collective."""
    problem = on_first_rank(comm, lambda: read_fit(source, plans=dry_run))
    if dry_run:
        expected = expectation(problem, comm)
        if comm.rank == 0:
            print(expected)
        return
    if comm.rank == 0:
        warn_of_threads(comm.size)
    into_folder(folder, FILES, comm, lambda: fit_problem(problem, comm, compare=compare))
    if comm.rank == 0 and compare != bool(problem.alternatives):
        hint = "there are none" if compare else f"--compare fits {', '.join(problem.alternatives)}"
        log.info("laws of [compare] were not fitted: %s", hint)
