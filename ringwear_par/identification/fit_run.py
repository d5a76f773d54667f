"""One fit of one problem: starts, noise, intervals, the check of time steps, as one sequence."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import Problem
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
from ringwear_par.identification.model.rounds import Rounds
from ringwear_par.identification.model.steps import MOST_SHIFT_SD, STEPS
from ringwear_par.results.execution.stopping import StopSignals
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: relative change of a fitted noise at which it has converged, and most rounds until then
_SAME_NOISE, _MOST_ROUNDS = 1e-4, 20
#: how often steps are halved
_HALVINGS = 3


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
        self._problem, self._law, self._stored = problem, law, stored
        hint = "; the same command with --restart goes on" if stored.is_stored else ""
        self._rounds = Rounds(problem, comm, signals, hint)
        self._misfit = Misfit(problem, self._rounds)

    def solve(self) -> FitResult:
        """Return the best of all starts. Collective."""
        return self._on_all_ranks(self._solve)

    def expect(self) -> FitResult:
        """Return the result of a fit whose optimum is the start. Collective."""
        return self._on_all_ranks(self._expect)

    def _on_all_ranks(self, job: Callable[[], dict[str, Any]]) -> FitResult:
        """Return the result of a job of the first rank on all ranks. Collective."""
        misfit = self._misfit

        def lead() -> tuple[Any, ...]:
            fields = job()
            misfit.keep_only(fields["x"])
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
        starts = solve_starts(misfit, rounds, self._law, self._stored)
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
            "starts": tuple(starts),
            "histories": rounds.count,
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
            "starts": (),
            "histories": self._rounds.count,
            "profiles": {},
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
        fitted_noise = np.array([series.sd_fitted for _, series in misfit.series])
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
