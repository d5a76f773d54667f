"""``rw.fit``: values of case keys from measurements."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.definition.scatter import expected_sizes
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.solution import expected_solution, solve
from ringwear_par.identification.estimation.starts import StoredStarts
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.model.rounds import Rounds, StoppedError
from ringwear_par.identification.scatter.pieces import posterior_in_pieces
from ringwear_par.identification.scatter.search import estimate_material
from ringwear_par.parallel import on_first_rank, together
from ringwear_par.results.execution.stop_signals import StopSignals
from ringwear_par.version import versions


def fit(
    source: Path | str | Mapping[str, Any],
    comm: MPI.Intracomm | None = None,
    *,
    compare: bool = False,
) -> FitResult:
    """Return the values of case keys that suit measurements best, with intervals.

    Collective on comm, the world's where none is given; the same on all ranks.

    Parameters
    ----------
    source : the name of a fit file, or the same as a dict.
    compare : whether the laws of ``[compare]`` are fitted as well.

    Returns
    -------
    FitResult : ``.parameters`` with intervals, ``.doubts``, ``.summary()``, ``.save(folder)``.

    Raises
    ------
    InputError : all faults of the file and its data.
    ComputationError : no start leads to an optimum.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    problem = on_first_rank(comm, lambda: read_fit(source))
    return fit_problem(problem, comm, compare=compare)


def fit_problem(
    problem: Problem, comm: MPI.Intracomm, *, compare: bool = False, folder: Path | None = None
) -> FitResult:
    """Return the fit of a problem that was read. Collective on comm.

    Other laws follow the first one, with linear intervals; one that fails does not end the fit.
    Optima of starts are stored in the folder until the fit is done.
    """
    with StopSignals() as signals:
        result = _fit_law(problem, "", StoredStarts(folder, problem.key), signals, comm)
        alternatives: dict[str, FitResult] = {}
        failed: dict[str, str] = {}
        for number, (law, alternative) in enumerate(
            problem.alternatives.items() if compare else (), 1
        ):
            stored = StoredStarts(folder, f"{alternative.key} {law}", number)
            try:
                alternatives[law] = _fit_law(alternative, law, stored, signals, comm)
            except StoppedError:
                raise
            except (ComputationError, InputError) as error:
                failed[law] = reason_of(error)
        return replace(result, alternatives=alternatives, failed=failed)


def expected_result(problem: Problem, comm: MPI.Intracomm) -> FitResult:
    """Return the result of a fit whose optimum is the start. Collective on comm."""
    with StopSignals() as signals:
        return _fit_law(problem, "", StoredStarts(None, ""), signals, comm, expected=True)


def _fit_law(
    problem: Problem,
    law: str,
    stored: StoredStarts,
    signals: StopSignals,
    comm: MPI.Intracomm,
    *,
    expected: bool = False,
) -> FitResult:
    """Return the result under one law, its start where only ``expected``. Collective on comm."""
    rounds = Rounds(problem, comm, signals, lambda: stored.hint)
    misfit = Misfit(problem, rounds)
    if not expected:
        with together(comm):
            rounds.operators.interpolate(comm)

    def lead() -> FitResult:
        solution = expected_solution(misfit) if expected else solve(misfit, rounds, law, stored)
        material = None
        if problem.mixed:
            rounds.tell("specimens" if problem.scatters else "random wear")
            sizes = expected_sizes(problem) if expected else None
            material = estimate_material(misfit, solution.x, sizes)
            if not expected:
                pieces, doubt = posterior_in_pieces(misfit, material)
                material = replace(material, pieces=pieces, doubt_of_pieces=doubt)
            solution = replace(
                solution, x=material.best_fit.x, evaluation=material.best_fit.evaluation,
                parameters=tuple(map(material.estimate, range(len(problem.parameters)))),
                covariance=material.covariance,
            )  # fmt: skip
        solution = replace(solution, histories=rounds.count)
        test_unknowns = None if material is None else material.test_unknowns
        misfit.responses.keep_only(misfit.values_of_tests(solution.x, test_unknowns))
        return FitResult(**vars(solution), misfit=misfit, material=material, versions=versions())

    return rounds.lead(lead)
