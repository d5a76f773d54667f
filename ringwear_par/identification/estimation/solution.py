"""From least squares to the best optimum: starts, fitted noise, time steps, profiles, samples."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.estimation.intervals import ParameterEstimate, estimates
from ringwear_par.identification.estimation.minimise import Optimum, minimise
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.estimation.posterior import Posterior, sample_posterior
from ringwear_par.identification.estimation.profile import likelihood_profiles
from ringwear_par.identification.estimation.record_checks import refuse_idle, refuse_reversed
from ringwear_par.identification.estimation.starts import (
    StartOutcome,
    StoredStarts,
    fill_planned,
    solve_from,
    solve_starts,
)
from ringwear_par.identification.model.histories import MOST_SHIFT_SD, STEPS
from ringwear_par.identification.model.rounds import Rounds

log = logging.getLogger(__name__)

#: relative change of a fitted noise at which it has converged, and most rounds until then
_SAME_NOISE, _MOST_ROUNDS = 1e-4, 20
#: how often steps are halved
_HALVINGS = 3


@dataclass(frozen=True, eq=False, kw_only=True)
class Solution:
    """The best optimum of a least squares problem, and how well it is known."""

    #: (u,) unknowns at the optimum
    x: FloatArray
    #: residuals there
    evaluation: Evaluation
    #: estimates of the fitted keys
    parameters: tuple[ParameterEstimate, ...]
    #: (u, u) of the unknowns
    covariance: FloatArray
    #: outcome of each start, the best optimum among them
    starts: tuple[StartOutcome, ...] = ()
    #: computed in all
    histories: int = 0
    #: of the likelihood, by key: (2, points) values and what the sum of squares grows by
    profiles: Mapping[str, FloatArray] = field(default_factory=dict)
    #: samples of the fitted keys, where they were asked for
    posterior: Posterior | None = None
    #: how many of them were for likelihood profiles
    histories_of_profiles: int = 0
    #: keys of which a profile's limit is not as close as it should be
    inexact_limits: tuple[str, ...] = ()
    #: sd by which steps half as long would move a key, by key
    discretisation_shift_sd: Mapping[str, float] = field(default_factory=dict)


def expected_solution(misfit: Misfit) -> Solution:
    """Return the solution whose optimum is the start, or refuse its readings. Not collective."""
    x = _begin(misfit)
    evaluation = misfit.evaluate(x)
    parameters, covariance = estimates(misfit, x, evaluation)
    return Solution(x=x, evaluation=evaluation, parameters=parameters, covariance=covariance)


def solve(misfit: Misfit, rounds: Rounds, law: str, stored: StoredStarts) -> Solution:
    """Return the best of all starts, with intervals. Not collective.

    Raises InputError for readings that cannot be what they are called, ComputationError where no
    start leads to an optimum. The law has a name in progress messages, but for the first.
    """
    keys, prefix = misfit.problem.keys, f"{law}: " if law else ""
    _begin(misfit)
    misfit.responses.be_exact(not rounds.operators.are_interpolated)
    starts = solve_starts(misfit, rounds, law, stored)
    misfit.responses.be_exact(True)
    x = np.array(_best(starts, misfit.problem.name).unknowns)
    histories_of_profiles = 0
    renewed = misfit.renew_inputs(x)
    while True:
        optimum = _with_noise(misfit, x)
        if renewed:  # by the torque at the best start; once more at the optimum
            renewed = False
            misfit.renew_inputs(optimum.x)
            optimum = _with_noise(misfit, optimum.x)
        parameters, covariance = estimates(misfit, optimum.x, optimum.evaluation)
        shift = misfit.discretisation_shift(optimum.x, optimum.evaluation, covariance)
        may_halve = misfit.responses.steps < STEPS << _HALVINGS
        if shift is not None and may_halve and np.abs(shift).max() > MOST_SHIFT_SD:
            _refine(misfit, shift)
            x = optimum.x
            continue
        before = rounds.count
        rounds.tell(f"{prefix}intervals")
        profiles = likelihood_profiles(misfit, optimum, parameters, covariance)
        histories_of_profiles += rounds.count - before
        covariance = profiles.covariance
        if profiles.better is None:
            break
        log.info("a likelihood profile has found a better optimum; the fit goes on from there")
        starts.append(solve_from(misfit, len(starts), profiles.better))
        if starts[-1].objective >= optimum.evaluation.objective:
            profiles = replace(profiles, inexact_limits=keys)
            break
        x = np.array(starts[-1].unknowns)
    posterior = None
    if "posterior" in misfit.problem.settings.intervals:
        posterior = sample_posterior(misfit, rounds, optimum.x, covariance, stored.chain)
    return Solution(
        x=optimum.x, evaluation=optimum.evaluation, parameters=profiles.estimates,
        covariance=covariance, starts=tuple(starts), profiles=profiles.tables,
        posterior=posterior, histories_of_profiles=histories_of_profiles,
        inexact_limits=profiles.inexact_limits,
        discretisation_shift_sd={}
        if shift is None
        else dict(zip(keys, shift.tolist(), strict=True)),
    )  # fmt: skip


def _begin(misfit: Misfit) -> FloatArray:
    """Return the unknowns at the start; refuse readings that cannot be what they are called."""
    fill_planned(misfit)
    misfit.linearise_inputs(misfit.problem.unknowns(list(misfit.problem.start.values())))
    start = misfit.with_best_nuisances(list(misfit.problem.start.values()))
    refuse_idle(misfit, start)
    refuse_reversed(misfit, start)
    return start


def _best(starts: Sequence[StartOutcome], name: str) -> StartOutcome:
    """Return the start with the smallest sum of squares; of equal ones the first."""
    solved = [start for start in starts if not start.error]
    if not solved:
        raise ComputationError(
            f"{name}: none of {len(starts)} starts could be fitted: {starts[0].error}"
        )
    smallest = min(start.objective for start in solved)
    return next(start for start in solved if start.objective <= smallest * (1.0 + 1e-9))


def _with_noise(misfit: Misfit, x: FloatArray) -> Optimum:
    """Return the optimum, with the noise that is to be fitted."""
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


def _refine(misfit: Misfit, shift: FloatArray) -> None:
    """Halve the steps, and say why."""
    most = int(np.abs(shift).argmax())
    misfit.responses.refine()
    log.info(
        "steps half as long move %s by %.2g sd; the fit goes on with %d instead of %d a test",
        misfit.problem.keys[most], shift[most], misfit.responses.steps, misfit.responses.steps // 2,
    )  # fmt: skip
