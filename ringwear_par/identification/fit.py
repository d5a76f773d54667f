"""``rw.fit``: values of case keys from measurements."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.definition.problem import Problem, body_of_wear
from ringwear_par.identification.definition.series import BLOCKS, averaged
from ringwear_par.identification.draws import CHAINS, Draws, conditions_of, law_names
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.fitted_tests import fitted_test, scores_and_information
from ringwear_par.identification.histories import Readings, StoppedError
from ringwear_par.identification.key_estimates import key_entries, process_entries
from ringwear_par.identification.record_checks import refuse_unfit
from ringwear_par.identification.solution import Solution, solve
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.signals import StopSignals
from ringwear_par.version import versions

#: draws of each chain that are kept; of them, how many tell bands and nuisances
_KEPT, _BANDS = 500, 500


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
        alternatives: dict[str, FitResult] = {}
        failed: dict[str, str] = {}
        for law, alternative in problem.alternatives.items() if compare else ():
            try:
                alternatives[law] = _fit_law(alternative, comm, signals)
            except StoppedError:
                raise
            except (ComputationError, InputError) as error:
                failed[law] = reason_of(error)
        return replace(result, alternatives=alternatives, failed=failed)


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
        return _result(solve(readings))

    return readings.lead(lead)


def _result(solution: Solution) -> FitResult:
    """Return the result of a solution. On the first rank."""
    problem, posterior = solution.problem, solution.posterior
    random = np.random.default_rng(0)
    x = posterior.of_tests(solution.theta)
    best = posterior.of_tests(solution.best)
    material = posterior.material(solution.theta, random)
    draws, rows = _draws(solution, material)
    some = rows[:: max(1, len(rows) // _BANDS)]
    tests = tuple(
        fitted_test(likelihood, best[i], x[some, i], solution.depths, random)
        for i, likelihood in enumerate(posterior.likelihoods)
    )
    shares = np.median(posterior.shares(solution.theta), axis=0)
    slopes = [
        scores_and_information(likelihood, best[i], shares, x[:, i].std(axis=0))
        for i, likelihood in enumerate(posterior.likelihoods)
    ]
    information = np.stack(slopes, axis=1)
    nuisances = {
        f"{kind} of {t.experiment.series[i].name} ({t.experiment.name})": drawn
        for t in tests for (i, kind), drawn in t.nuisances.items() if i >= 0
    }  # fmt: skip
    return FitResult(
        problem=problem, solution=solution, draws=draws, process=process_entries(solution),
        parameters=key_entries(
            solution, material, np.maximum(information[1], 1e-300) ** -0.5, material[some],
            nuisances,
        ),
        tests=tests, information=information, versions=versions(),
    )  # fmt: skip


def _draws(solution: Solution, material: FloatArray) -> tuple[Draws, FloatArray]:
    """Return the draws that are kept, and their rows in ``theta``.

    States of the sampler follow one another, its walkers, a multiple of the chains, side by side.
    """
    problem, posterior = solution.problem, solution.posterior
    length = len(solution.theta) // CHAINS
    states = np.linspace(0, length - 1, _KEPT).round().astype(int)
    rows = (CHAINS * states + np.arange(CHAINS)[:, None]).ravel()
    theta = solution.theta[rows]
    sizes = np.zeros((len(rows), len(BODIES)))
    shares = posterior.shares(theta)
    for place, (key, process) in enumerate(problem.settings.process.items()):
        found = shares[:, place] ** 2 * solution.depths[place]
        sizes[:, BODIES.index(body_of_wear(key))] = process.size or found
    units = units_of(problem)
    draws = Draws(
        keys=problem.keys, units=tuple(units[key] for key in problem.keys),
        logarithmic=np.array([p.log for p in problem.parameters]),
        bounds=np.array([p.bounds for p in problem.parameters], dtype=float),
        material=material[rows], tests=posterior.of_tests(theta),
        scatter={
            (problem.keys[s.key], level): size(theta)
            for s in posterior.scatterings for level, size in s.levels.items()
        },
        process=sizes,
        specimens=tuple(test.groups[0] for test in problem.experiments),
        laws=law_names(problem.experiments[0].case),
        conditions=np.array([conditions_of(t.case, problem.keys) for t in problem.experiments]),
        effective=min(solution.effective, float(len(rows))),
    )  # fmt: skip
    return draws, rows
