"""The search for a material: tests move to their posterior means until they stay.

Lindstrom and Bates (1990), Biometrics 46, 673-687.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import (
    GROUPS,
    FittedParameter,
    Prior,
    Problem,
)
from ringwear_par.identification.definition.scatter import group_numbers
from ringwear_par.identification.estimation.intervals import is_vague
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.histories import HistoryError
from ringwear_par.identification.model.noise import log_constant, weights
from ringwear_par.identification.scatter.likelihood import (
    Level,
    MixedModel,
    uncorrelated,
    with_fixed,
)
from ringwear_par.identification.scatter.linearisation import Linearisation, projected_precision
from ringwear_par.identification.scatter.material import BestFit, Material, MixedRound
from ringwear_par.identification.scatter.posterior import ScatterPosterior, Size, integrate
from ringwear_par.identification.scatter.random_wear import RandomWear, confounded_with_drift

#: sd below which the moves of all tests' unknowns end the search, and most rounds until then
_STILL, _MOST_ROUNDS = 1e-3, 60
#: rounds after which the depths that shares refer to stay fixed
_SETTLING = 3
#: largest move in a round, of a logarithm, and as a share of the width of the bounds; least share
#: of a move
_LOG_MOVE, _MOVE, _LEAST_SHARE = 1.0, 0.25, 0.05
#: how often the move of a test is halved where there is no history
_HALVINGS = 6


def estimate_material(
    misfit: Misfit, x: FloatArray, sizes: Mapping[tuple[str, str], float] | None = None
) -> Material:
    """Return the material behind the specimens of a fit, from unknowns x (u,) on. Not collective.

    Noise that is fitted is estimated along; ``misfit`` has it afterwards. In a plan, sizes of
    scatters are known, by key and group, and readings are those of x. ComputationError where
    readings do not determine the material, or no history could be computed.
    """
    problem, m = misfit.problem, len(misfit.problem.parameters)
    levels, scatters, names = levels_of(problem, sizes)
    low, high = misfit.lower[:m], misfit.upper[:m]
    longest = np.array([_LOG_MOVE if p.log else np.inf for p in problem.parameters])
    longest = np.minimum(longest, _MOVE * (high - low))
    test_unknowns = before = np.tile(x[:m], (len(problem.experiments), 1))
    fitted_noise = np.array([record.series.sd_fitted for record in misfit.records])
    share, farthest = 1.0, np.inf
    wear, weighed = RandomWear.of(misfit, x, test_unknowns, plan=sizes is not None), None
    for number in range(_MOST_ROUNDS):
        x, evaluation, test_unknowns = _evaluated(misfit, x, before, test_unknowns)
        if number < _SETTLING:  # without the noise of wear, x may have been far off
            wear = RandomWear.of(misfit, x, test_unknowns, plan=sizes is not None)
        prior = prior_of_keys(problem.parameters, x)
        if sizes is not None:
            x[m:] = misfit.expected_nuisances
            evaluation = replace(evaluation, noise=np.zeros(misfit.n))
            prior = prior[0], x[:m].copy()
        linear = Linearisation(misfit, evaluation, x, test_unknowns, weighed)
        mixed = _solve(problem, linear, levels, prior, scatters, wear)
        best_fit = _best_fit(misfit, x, evaluation, test_unknowns, linear, mixed)
        growth = np.ones(len(misfit.records))
        if sizes is None:
            growth = misfit.noise_growth(best_fit.evaluation, best_fit.leverage)
            growth = np.where(fitted_noise, growth, 1.0)
            misfit.noise_scale = growth * misfit.noise_scale
            weighed = best_fit.evaluation.noise if wear.shares else None
        x = best_fit.x
        move = np.clip(mixed.of_tests, low, high) - test_unknowns
        distance = float((np.abs(move) / mixed.sds).max())
        converged = max(distance, float(np.abs(growth - 1.0).max())) <= _STILL
        if converged:
            break
        # linearised tests may be far off: where rounds do not come nearer, they go less far
        share = min(1.0, 1.5 * share) if distance < farthest else max(_LEAST_SHARE, 0.5 * share)
        farthest, before = distance, test_unknowns
        if distance > _STILL:
            test_unknowns = test_unknowns + np.clip(share * move, -longest, longest)
    alone, alone_sd = _alone(problem.parameters, mixed)
    constant = loss_beyond_squares(misfit, best_fit.evaluation)
    return Material(
        problem.parameters, mixed, best_fit, tuple(scatters), tuple(names), alone, alone_sd,
        problem.settings.level, before if not converged else test_unknowns,
        _covariance(linear, mixed, x), misfit.sd * np.sqrt(best_fit.leverage),
        float(mixed.posterior.solutions.marginal.min()) + constant, converged, wear,
        confounded_with_drift(problem),
    )  # fmt: skip


def _evaluated(
    misfit: Misfit, x: FloatArray, before: FloatArray, test_unknowns: FloatArray
) -> tuple[FloatArray, Evaluation, FloatArray]:
    """Return unknowns with the best nuisances, residuals there, and the unknowns of tests.

    Where there is no history, tests go half as far from where they were before; HistoryError in the
    end.
    """
    # with the noise of wear, time constants are those of its last round
    times_of = x if misfit.problem.settings.process else None
    for halvings_left in reversed(range(_HALVINGS + 1)):
        try:
            misfit.linearise_inputs(x, test_unknowns)
            x = misfit.with_best_nuisances(misfit.values(x), test_unknowns, times_of)
            return x, misfit.evaluate(x, test_unknowns), test_unknowns
        except HistoryError:
            if not halvings_left:
                raise
            test_unknowns = 0.5 * (before + test_unknowns)
    raise AssertionError


def _solve(
    problem: Problem,
    linear: Linearisation,
    levels: Sequence[Level],
    prior: tuple[FloatArray, FloatArray],
    sizes: Sequence[Size],
    wear: RandomWear,
) -> MixedRound:
    """Return the mixed model, in which keys that would leave their bounds stay at them.

    Those that scatter stay free: it is the material's mean that has no bound.
    """
    precision, mean = prior
    low, high = problem.unknown_bounds
    at_bounds: dict[int, float] = {}
    unbounded = None
    while True:
        free = [j for j in range(len(low)) if j not in at_bounds]
        present = [replace(level, key=free.index(level.key)) for level in levels]
        models_at = partial(
            models_at_shares, linear, wear, at_bounds.copy(), present, (precision[free], mean[free])
        )
        posterior = integrated(problem.name, models_at, sizes, wear.shares)
        unbounded = posterior if unbounded is None else unbounded
        means = posterior.weights @ posterior.means_of()
        material = dict(zip(free, means.tolist(), strict=True))
        beyond = {
            j: float(np.clip(value, low[j], high[j]))
            for j, value in material.items()
            if problem.parameters[j].scatter is None and not low[j] <= value <= high[j]
        }
        if not beyond:
            break
        at_bounds |= beyond
    process_sizes = wear.sizes(wear.estimated_shares(posterior)[None])
    reduced = [with_fixed(test, at_bounds) for test in linear.reduced(process_sizes)[0]]
    count = len(reduced)
    of_tests, sds = np.empty((count, len(low))), np.ones((count, len(low)))
    for j, value in at_bounds.items():
        of_tests[:, j] = value
    for i in range(count):
        of_tests[i, free] = posterior.weights @ posterior.means_of(i)
        sds[i, free] = np.sqrt(np.diag(posterior.covariance(i, i)))
    means = np.array([{**material, **at_bounds}[j] for j in range(len(low))])
    return MixedRound(
        tuple(free), posterior, unbounded, process_sizes[0], reduced, means, of_tests, sds
    )


def models_at_shares(
    linear: Linearisation,
    wear: RandomWear,
    at_bounds: Mapping[int, float],
    levels: Sequence[Level],
    prior: tuple[FloatArray, FloatArray],
    shares: FloatArray,
) -> list[MixedModel]:
    """Return the model of the free keys for each of (G, bodies) shares of the process noise."""
    return [
        MixedModel([with_fixed(test, at_bounds) for test in tests], levels, *prior)
        for tests in linear.reduced(wear.sizes(shares))
    ]


def loss_beyond_squares(misfit: Misfit, evaluation: Evaluation) -> float:
    """Return -2 log likelihood of readings, less the weighed squares that stand for it."""
    loss, noise = misfit.problem.settings.loss, evaluation.noise
    beyond = evaluation.residuals[: misfit.n] ** 2 - weights(loss, noise) * noise**2
    values = np.count_nonzero(misfit.censored == 0)
    beyond[misfit.integrated_limits] = 0.0
    return float(beyond.sum()) + 2.0 * values * log_constant(loss)


def prior_of_keys(
    parameters: Sequence[FittedParameter], x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return precision and mean (m,) of each key's unknown by its prior, which is of its value."""
    precision, mean = np.zeros(len(parameters)), np.zeros(len(parameters))
    for key, parameter in enumerate(parameters):
        prior: Prior | None = parameter.prior
        if prior is not None:
            value = parameter.value(x[key])
            slope = parameter.slope(value)
            precision[key] = (slope / prior.sd) ** 2
            mean[key] = x[key] + (prior.mean - value) / slope
    return precision, mean


def integrated(
    name: str,
    models_at: Callable[[FloatArray], list[MixedModel]],
    sizes: Sequence[Size],
    shares: Sequence[Size],
) -> ScatterPosterior:
    """Return the posterior over sizes, see ``integrate``, of a problem by its name.

    Raises
    ------
    ComputationError : tests and priors together do not determine the material.
    """
    try:
        return integrate(models_at, sizes, shares)
    except np.linalg.LinAlgError as error:
        raise ComputationError(
            f"{name}: readings do not determine all keys of the material; leave out scatter and "
            "process to see which are not identified"
        ) from error


def _best_fit(
    misfit: Misfit,
    x: FloatArray,
    evaluation: Evaluation,
    test_unknowns: FloatArray,
    linear: Linearisation,
    mixed: MixedRound,
) -> BestFit:
    m, posterior = len(misfit.problem.parameters), mixed.posterior
    leverage, free = np.zeros(misfit.n), list(mixed.free)
    best = x.copy()
    best[:m] = np.clip(mixed.material, misfit.lower[:m], misfit.upper[:m])
    if not linear.clocks:
        for number, test in enumerate(linear.tests):
            keys, projection = test.jacobian[:, free], test.nuisance_projection
            padding = np.zeros((len(test.prior_rows), keys.shape[1]))
            rest = projection.rest(np.concatenate([keys, padding]))[: len(test.readings)]
            by_keys = np.einsum("ij,jk,ik->i", rest, posterior.covariance(number, number), rest)
            leverage[linear.rows[number]] = projection.leverage[: len(test.readings)] + by_keys
        variances = np.diagonal(posterior.solutions.covariance, axis1=1, axis2=2)
        # what limits alone determine takes nothing from the readings
        read = np.array([test.jacobian.any() for test in linear.tests])
        levels = zip(posterior.model.levels, posterior.model.offsets, strict=False)
        groups = np.concatenate([offset + np.unique(v.group[read]) for v, offset in levels])
        effective_groups = posterior.weights @ (1.0 - variances[:, groups]).sum(axis=1)
        none = np.zeros((misfit.n, 0))
        return BestFit(best, evaluation, leverage, m + float(effective_groups), none, none)
    fitted = posterior.model.precision[: len(free)] @ np.diag(posterior.covariance())
    fitted -= len(x) - m - int(misfit.idle.sum())
    excess, excess_sd = np.zeros((2, misfit.n, len(mixed.sizes)))
    for number, (test, clocks) in enumerate(zip(linear.tests, linear.clocks, strict=True)):
        b, rows, nuisances = len(test.readings), linear.rows[number], linear.nuisances_of(number)
        test_free = replace(test, jacobian=test.jacobian[:, free])
        of_keys = posterior.covariance(number, number)
        precision = projected_precision(test_free, mixed.sizes, of_keys)
        leverages = 1.0 - np.diag(precision)
        leverage[rows], fitted = clocks.spread(leverages[:b]), fitted + leverages.sum()
        alone, whitening = uncorrelated(test, mixed.sizes)
        readings = alone.readings - alone.jacobian @ test_unknowns[number]
        right = np.concatenate([readings, test.prior_values])
        solution = alone.nuisance_projection.solution(right)
        best[nuisances] = np.clip(solution, misfit.lower[nuisances], misfit.upper[nuisances])
        rest = whitening.T @ (readings - alone.nuisances @ best[nuisances])
        excess[rows], excess_sd[rows] = clocks.smoothed(mixed.sizes, rest, precision[:b, :b])
    random_part = (misfit.clocks(x, test_unknowns)[0] * excess).sum(axis=1)
    nuisances_best = np.append(x[:m], best[m:])  # priors of keys are at those of the round before
    evaluation = misfit.evaluate(nuisances_best, test_unknowns, random_part)
    return BestFit(best, evaluation, leverage, float(fitted), excess, excess_sd)


def _alone(
    parameters: Sequence[FittedParameter], mixed: MixedRound
) -> tuple[FloatArray, FloatArray]:
    """Return estimate and sd (tests, m) of each unknown by one test, the others as estimated.

    NaN and infinity where a test does not tell it.
    """
    estimate = np.full_like(mixed.of_tests, np.nan)
    sd = np.full_like(mixed.of_tests, np.inf)
    free = list(mixed.free)
    for i, test in enumerate(mixed.reduced):
        present = mixed.of_tests[i, free]
        for place, j in enumerate(free):
            information = float(test.information[place, place])
            if information <= 0.0 or is_vague(parameters[j], 2.0 * information**-0.5):
                continue
            by_other_keys = np.delete(test.information[place] * present, place).sum()
            estimate[i, j] = (test.score[place] - by_other_keys) / information
            sd[i, j] = information**-0.5
    return estimate, sd


def _covariance(linear: Linearisation, mixed: MixedRound, x: FloatArray) -> FloatArray:
    """Return the covariance (u, u) of the unknowns.

    Nuisances follow the keys of their test; those of different tests are given as independent.
    Keys at their bounds are known.
    """
    posterior, free = mixed.posterior, list(mixed.free)
    covariance = np.zeros((len(x), len(x)))
    covariance[np.ix_(free, free)] = posterior.covariance()
    for number, correlated in enumerate(linear.tests):
        test = uncorrelated(correlated, mixed.sizes)[0] if linear.clocks else correlated
        nuisances = linear.nuisances_of(number)
        jacobian = test.jacobian[:, free]
        stacked = np.concatenate([test.nuisances, test.prior_rows])
        normal = np.linalg.pinv(stacked.T @ stacked, hermitian=True)
        follow = -normal @ test.nuisances.T @ jacobian
        keys = posterior.covariance(number, number)
        covariance[np.ix_(nuisances, nuisances)] = normal + follow @ keys @ follow.T
        across = follow @ posterior.covariance(number)
        covariance[np.ix_(nuisances, free)] = across
        covariance[np.ix_(free, nuisances)] = across.T
    return covariance


def levels_of(
    problem: Problem, sizes: Mapping[tuple[str, str], float] | None
) -> tuple[list[Level], list[Size], list[tuple[str, ...]]]:
    """Return the levels of all keys that scatter, their sizes, and the names of their groups."""
    levels, scatters, names = [], [], []
    for key, parameter in enumerate(problem.parameters):
        if parameter.scatter is None:
            continue
        for group, size in parameter.scatter.sizes.items():
            named = dict.fromkeys(e.groups[GROUPS.index(group)] for e in problem.experiments)
            levels.append(Level(key, group, group_numbers(problem.experiments, group)))
            known = size if sizes is None else sizes[parameter.key, group]
            scatters.append(Size(known, parameter.scatter.scale))
            names.append(tuple(named))
    return levels, scatters, names
