"""``rw.fit`` and ``ringwear fit``: values of case keys from measurements."""

import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError, RingwearError, reason_of
from ringwear_par.files.folders import FIT, check_folder
from ringwear_par.files.writing import announce_replacement
from ringwear_par.identification import fit_folder
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.definition.scatter import expected_sizes
from ringwear_par.identification.estimation.intervals import estimates
from ringwear_par.identification.estimation.minimise import Optimum, minimise
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.posterior import sample_posterior
from ringwear_par.identification.estimation.profile import likelihood_profiles
from ringwear_par.identification.estimation.record_checks import refuse_idle, refuse_reversed
from ringwear_par.identification.estimation.starts import (
    StartOutcome,
    StoredStarts,
    fill_planned,
    solve_from,
    solve_starts,
)
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.model.histories import MOST_SHIFT_SD, STEPS
from ringwear_par.identification.model.rounds import Rounds, StoppedError
from ringwear_par.identification.scatter.search import estimate_material
from ringwear_par.identification.summary import prediction
from ringwear_par.options import reject_unused_options
from ringwear_par.parallel import on_first_rank, together, warn_of_threads
from ringwear_par.results.execution.stopping import StopSignals
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: relative change of a fitted noise at which it has converged, and most rounds until then
_SAME_NOISE, _MOST_ROUNDS = 1e-4, 20
#: how often steps are halved
_HALVINGS = 3

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
    overwrite: bool = False,
    compare: bool = False,
) -> None:
    """Fit and write the outcome to a folder, or in a dry run print what to expect. Collective.

    A fit that fails leaves nothing; one that is stopped leaves what ``restart`` goes on with.
    """
    if restart and overwrite:
        raise InputError("--restart, --overwrite: must be one of them, to go on or to start anew")
    if dry_run:
        problem = on_first_rank(comm, lambda: read_fit(source, plans=True))
        expected = expected_result(problem, comm)
        if comm.rank == 0:
            print(prediction(expected))
        return
    problem = on_first_rank(comm, lambda: _read_complete(source))
    on_first_rank(comm, lambda: check_folder(folder, fit_folder.FILES, "fit"))
    if restart and on_first_rank(
        comm, lambda: fit_folder.complete(folder, problem, compare=compare)
    ):
        if comm.rank == 0:
            log.info("%s: the fit is complete; nothing is left to be done", folder)
        return
    stored = StoredStarts(folder, "")

    def clear() -> None:
        if overwrite:
            stored.remove()
        elif not restart:
            fit_folder.refuse_interrupted(folder)
        announce_replacement(folder / FIT)

    on_first_rank(comm, clear)
    if comm.rank == 0:
        warn_of_threads(comm.size)
    try:
        result = fit_problem(problem, comm, compare=compare, folder=folder)
        with together(comm):
            reject_unused_options()
    except StoppedError:
        raise
    except RingwearError:  # the same command would fail again, and another one must be free to run
        if comm.rank == 0:
            with suppress(OSError):
                stored.remove()
        raise

    def store() -> None:
        result.save(folder)
        stored.remove()

    on_first_rank(comm, store)
    if comm.rank == 0:
        print(result.summary())
        if problem.alternatives and not compare:
            log.info(
                "laws of [compare] were not fitted: --compare fits %s",
                ", ".join(problem.alternatives),
            )


def _read_complete(source: Source) -> Problem:
    """Return the problem of a fit file, if the packages for its intervals are there. One rank."""
    problem = read_fit(source)
    if missing := problem.settings.missing_package:
        raise InputError(f"{problem.name}: {missing}")
    return problem


class FitRun:
    """A problem with its histories. Making one is collective on comm.

    Parameters
    ----------
    law : name of the law in progress messages; "" of the first.
    """

    def __init__(
        self,
        problem: Problem,
        law: str,
        stored: StoredStarts,
        signals: StopSignals,
        comm: MPI.Intracomm,
    ) -> None:
        self._problem, self._law, self._stored, self._comm = problem, law, stored, comm
        hint = "; the same command with --restart goes on" if stored.is_stored else ""
        self._rounds = Rounds(problem, comm, signals, hint)
        self._misfit = Misfit(problem, self._rounds)

    def solve(self) -> FitResult:
        """Return the best of all starts. Collective."""
        with together(self._comm):
            self._rounds.interpolate(self._problem, self._comm)
        return self._on_all_ranks(self._solve)

    def expect(self) -> FitResult:
        """Return the result of a fit whose optimum is the start. Collective."""
        return self._on_all_ranks(self._expect)

    def _on_all_ranks(self, job: Callable[[], dict[str, Any]]) -> FitResult:
        """Return the result of a job of the first rank on all ranks. Collective."""
        misfit = self._misfit

        def lead() -> tuple[Any, ...]:
            fields = job()
            material = fields.get("material")
            misfit.keep_only(fields["x"], None if material is None else material.test_unknowns)
            return fields, misfit.data, misfit.noise_scale, misfit.steps, misfit.response_cache

        fields, *state = self._rounds.lead(lead)
        misfit.data, misfit.noise_scale, misfit.steps, misfit.response_cache = state
        misfit.part_from_histories()
        return FitResult(misfit, **fields, alternatives={}, versions=versions())

    def _begin(self) -> FloatArray:
        """Return the unknowns at the start; refuse readings that cannot be what they are called."""
        fill_planned(self._misfit)
        start = self._misfit.with_best_nuisances(list(self._problem.start.values()))
        refuse_idle(self._misfit, start)
        refuse_reversed(self._misfit, start)
        return start

    def _solve(self) -> dict[str, Any]:
        misfit, rounds, keys = self._misfit, self._rounds, self._problem.keys
        self._begin()
        misfit.be_exact(not rounds.are_interpolated)
        starts = solve_starts(misfit, rounds, self._law, self._stored)
        misfit.be_exact(True)
        x = np.array(self._best(starts).unknowns)
        histories_of_profiles = 0
        while True:
            optimum = self._with_noise(x)
            parameters, covariance = estimates(misfit, optimum.x, optimum.evaluation)
            shift = misfit.discretisation_shift(optimum.x, optimum.evaluation, covariance)
            may_halve = misfit.steps < STEPS << _HALVINGS
            if shift is not None and may_halve and np.abs(shift).max() > MOST_SHIFT_SD:
                self._refine(shift)
                x = optimum.x
                continue
            before = rounds.count
            rounds.tell(f"{self._law}: intervals" if self._law else "intervals")
            profiles = likelihood_profiles(misfit, optimum, parameters, covariance)
            histories_of_profiles += rounds.count - before
            if profiles.better is None:
                break
            log.info("a likelihood profile has found a better optimum; the fit goes on from there")
            starts.append(solve_from(misfit, len(starts), profiles.better))
            if starts[-1].objective >= optimum.evaluation.objective:
                profiles = replace(profiles, inexact_limits=keys)
                break
            x = np.array(starts[-1].unknowns)
        posterior = None
        if "posterior" in self._problem.settings.intervals:
            posterior = sample_posterior(misfit, rounds, optimum.x, covariance, self._stored.chain)
        shifts = {} if shift is None else dict(zip(keys, shift.tolist(), strict=True))
        return {
            "x": optimum.x,
            "evaluation": optimum.evaluation,
            "parameters": profiles.estimates,
            "covariance": covariance,
            **self._material(optimum.x, None),
            "starts": tuple(starts),
            "histories": self._rounds.count,
            "profiles": profiles.tables,
            "posterior": posterior,
            "histories_of_profiles": histories_of_profiles,
            "inexact_limits": profiles.inexact_limits,
            "discretisation_shift_sd": shifts,
        }

    def _expect(self) -> dict[str, Any]:
        x = self._begin()
        evaluation = self._misfit.evaluate(x)
        parameters, covariance = estimates(self._misfit, x, evaluation)
        return {
            "x": x,
            "evaluation": evaluation,
            "parameters": parameters,
            "covariance": covariance,
            **self._material(x, expected_sizes(self._problem)),
            "starts": (),
            "histories": self._rounds.count,
            "profiles": {},
        }

    def _material(
        self, x: FloatArray, sizes: Mapping[tuple[str, str], float] | None
    ) -> dict[str, Any]:
        """Return the fields of a result that are others where specimens or wear are random."""
        if not self._problem.mixed:
            return {}
        self._rounds.tell("specimens" if self._problem.scatters else "random wear")
        material = estimate_material(self._misfit, x, sizes)
        return {
            "x": material.x,
            "evaluation": material.evaluation,
            "parameters": tuple(map(material.estimate, range(len(self._problem.parameters)))),
            "covariance": material.covariance,
            "material": material,
        }

    def _refine(self, shift: FloatArray) -> None:
        """Halve the steps, and say why."""
        most = int(np.abs(shift).argmax())
        self._misfit.refine()
        log.info(
            "steps half as long move %s by %.2g sd; the fit goes on with %d instead of %d a test",
            self._problem.keys[most], shift[most], self._misfit.steps, self._misfit.steps // 2,
        )  # fmt: skip

    def _best(self, starts: list[StartOutcome]) -> StartOutcome:
        """Return the start with the smallest sum of squares; of equal ones the first."""
        solved = [start for start in starts if not start.error]
        if not solved:
            raise ComputationError(
                f"{self._problem.name}: none of {len(starts)} starts could be fitted: "
                f"{starts[0].error}"
            )
        smallest = min(start.objective for start in solved)
        return next(start for start in solved if start.objective <= smallest * (1.0 + 1e-9))

    def _with_noise(self, x: FloatArray) -> Optimum:
        """Return the optimum, with the noise that is to be fitted. Not collective."""
        misfit = self._misfit
        fitted_noise = np.array([record.series.sd_fitted for record in misfit.records])
        for _ in range(_MOST_ROUNDS):
            optimum = minimise(misfit, x)
            if not fitted_noise.any():
                return optimum
            growth = misfit.noise_growth(optimum.evaluation)
            x = optimum.x
            if np.abs(growth[fitted_noise] - 1.0).max() < _SAME_NOISE:
                return optimum
            misfit.noise_scale = np.where(fitted_noise, growth, 1.0) * misfit.noise_scale
        return optimum


log = logging.getLogger(__name__)
