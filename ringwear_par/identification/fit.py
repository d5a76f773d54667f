"""``rw.fit`` and ``ringwear fit``: values of case keys from measurements."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.files.folders import check_folder
from ringwear_par.identification import fit_folder
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.estimation.posterior import missing_package
from ringwear_par.identification.estimation.starts import StoredStarts
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.fit_run import FitRun
from ringwear_par.identification.model.lockstep import StoppedError
from ringwear_par.identification.summary import prediction
from ringwear_par.options import reject_unused_options
from ringwear_par.parallel import on_first_rank, together, warn_of_threads
from ringwear_par.results.execution.stopping import StopSignals

log = logging.getLogger(__name__)

Source = Path | str | Mapping[str, Any]


def fit(source: Source, comm: MPI.Intracomm | None = None, *, compare: bool = False) -> FitResult:
    """Return the values of case keys that suit measurements best, with intervals.

    Collective on comm, the world's where none is given; the same on all ranks.

    Parameters
    ----------
    source : the name of a fit file, or the same as a dict.
    compare : whether the laws of ``[compare]`` are fitted as well.

    Raises
    ------
    InputError : all faults of the file and its data.
    ComputationError : no start leads to an optimum.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    problem = on_first_rank(comm, lambda: _read_complete(source))
    return fit_problem(problem, comm, compare=compare)


def fit_problem(
    problem: Problem, comm: MPI.Intracomm, *, compare: bool = False, folder: Path | None = None
) -> FitResult:
    """Return the fit of a problem that was read. Collective on comm.

    Other laws follow the first one, with linear intervals; one that fails does not end the fit.

    Parameters
    ----------
    folder : where optima of starts are stored until the fit is done; None: nowhere.
    """
    with StopSignals() as signals:
        result = FitRun(problem, "", StoredStarts(folder, problem.key), signals, comm).solve()
        alternatives: dict[str, FitResult] = {}
        failed: dict[str, str] = {}
        linear = replace(problem.settings, intervals=("linear",))
        for number, (law, other) in enumerate(problem.alternatives.items() if compare else (), 1):
            stored = StoredStarts(folder, f"{other.key} {law}", number)
            try:
                run = FitRun(replace(other, settings=linear), law, stored, signals, comm)
                alternatives[law] = run.solve()
            except StoppedError:
                raise
            except (ComputationError, InputError) as error:
                failed[law] = reason_of(error)
        return replace(result, alternatives=alternatives, failed=failed)


def expected_result(problem: Problem, comm: MPI.Intracomm) -> FitResult:
    """Return the result of a fit whose optimum is the start. Collective on comm."""
    with StopSignals() as signals:
        return FitRun(problem, "", StoredStarts(None, ""), signals, comm).expect()


def run_fit(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    dry_run: bool = False,
    restart: bool = False,
    compare: bool = False,
) -> None:
    """Fit and write the outcome to a folder, or in a dry run print what to expect. Collective."""
    if dry_run:
        problem = on_first_rank(comm, lambda: read_fit(source, plans=True))
        expected = expected_result(problem, comm)
        if comm.rank == 0:
            print(prediction(expected))
        return
    problem = on_first_rank(comm, lambda: _read_complete(source))
    on_first_rank(comm, lambda: check_folder(folder, fit_folder.FILES))
    if restart and on_first_rank(
        comm, lambda: fit_folder.complete(folder, problem, compare=compare)
    ):
        if comm.rank == 0:
            log.info("%s: the fit is complete; nothing is left to be done", folder)
        return
    if comm.rank == 0:
        warn_of_threads(comm.size)
    if not restart:
        on_first_rank(comm, lambda: fit_folder.refuse_interrupted(folder))
    result = fit_problem(problem, comm, compare=compare, folder=folder)
    with together(comm):
        reject_unused_options()

    def store() -> None:
        result.save(folder)
        StoredStarts(folder, "").remove()

    on_first_rank(comm, store)
    if comm.rank == 0:
        print(result.summary())
        if problem.alternatives and not compare:
            log.info(
                "[compare] was not looked at: --compare fits %s", ", ".join(problem.alternatives)
            )


def _read_complete(source: Source) -> Problem:
    """Return the problem of a fit file, if the packages for its intervals are there. One rank."""
    problem = read_fit(source)
    if missing := missing_package(problem.settings.intervals):
        raise InputError(f"{problem.name}: {missing}")
    return problem
