"""The search for a material: tests move to their posterior means until they stay.

Lindstrom and Bates (1990), Biometrics 46, 673-687.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import GROUPS, FittedParameter, Prior
from ringwear_par.identification.definition.scatter import group_numbers
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.noise import NuisanceProjection, log_constant, weights
from ringwear_par.identification.scatter.likelihood import Level, MixedModel
from ringwear_par.identification.scatter.linearisation import Linearisation
from ringwear_par.identification.scatter.material import Material
from ringwear_par.identification.scatter.posterior import ScatterPosterior, Size, integrate
from ringwear_par.identification.scatter.reduction import LinearisedTest, ReducedTest, reduce_test

log = logging.getLogger(__name__)

#: sd by which no test's unknowns move any more, and most rounds until then
_STILL, _MOST_ROUNDS = 1e-3, 20


def estimate_material(
    misfit: Misfit, x: FloatArray, sizes: Mapping[tuple[str, str], float] | None = None
) -> Material:
    """Return the material behind the specimens of a fit. Not collective.

    Noise that is fitted is estimated along; ``misfit`` has it afterwards.

    Parameters
    ----------
    x : (u,) unknowns of the fit with one value for all tests, where the search begins.
    sizes : of scatters, by key and group, that are taken as known, for a plan: readings then are
        those of x; None: as the fit file says, from the readings.

    Raises
    ------
    ComputationError : readings do not determine the material, or no history could be computed.
    """
    problem, m = misfit.problem, len(misfit.problem.parameters)
    linear = Linearisation(misfit, x)
    levels, scatters, names = _levels(problem.parameters, linear.free, misfit)
    if sizes is not None:
        keys = [problem.keys[linear.free[level.key]] for level in levels]
        scatters = [Size(sizes[key, level.name]) for key, level in zip(keys, levels, strict=True)]
    test_unknowns = np.tile(x[:m], (len(problem.experiments), 1))
    low, high = misfit.lower[:m], misfit.upper[:m]
    for _ in range(_MOST_ROUNDS):
        x = misfit.with_best_nuisances(misfit.values(x), test_unknowns)
        evaluation = misfit.evaluate(x, test_unknowns)
        prior = _prior_of_keys(problem.parameters, linear.free, x)
        if sizes is not None:
            x[m:] = _expected_nuisances(misfit)
            evaluation = replace(evaluation, noise=np.zeros(misfit.n))
            prior = prior[0], x[list(linear.free)]
        tests = [linear.test(i, evaluation, x, test_unknowns) for i in range(len(test_unknowns))]
        reduced = [reduce_test(test)[0] for test in tests]
        posterior = _integrated(problem.name, reduced, levels, prior, scatters)
        free, before = list(linear.free), test_unknowns
        test_unknowns, sds = before.copy(), np.empty((len(before), len(free)))
        for i in range(len(test_unknowns)):
            test_unknowns[i, free] = posterior.unknowns(i)
            sds[i] = [posterior.of_test(i, j).sd for j in range(len(free))]
        test_unknowns = np.clip(test_unknowns, low, high)
        x = x.copy()
        x[free] = [posterior.material(j).mean for j in range(len(free))]
        x[:m] = np.clip(x[:m], low, high)
        growth = _noise_growth(misfit, evaluation, tests, posterior)
        misfit.noise_scale = growth * misfit.noise_scale
        moves = np.abs(test_unknowns - before)[:, free] / sds
        if max(moves.max(), np.abs(growth - 1.0).max()) <= _STILL:
            break
    else:
        log.warning(
            "%s: values of specimens still move by %.2g sd after %d rounds",
            problem.name, moves.max(), _MOST_ROUNDS,
        )  # fmt: skip
    alone, alone_sd = _alone(reduced, posterior, test_unknowns[:, free])
    covariance, band = _covariance(misfit, linear, tests, posterior, x)
    constant = 2.0 * misfit.n * log_constant(problem.settings.loss)
    return Material(
        problem.parameters, linear.free, posterior, tuple(scatters), tuple(names), alone, alone_sd,
        problem.settings.level, before, x, evaluation, covariance, band,
        float(posterior.solutions.marginal.min()) + constant,
    )  # fmt: skip


def _prior_of_keys(
    parameters: Sequence[FittedParameter], free: Sequence[int], x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return precision and mean of each key's unknown by its prior, which is of its value."""
    precision, mean = np.zeros(len(free)), np.zeros(len(free))
    for place, key in enumerate(free):
        parameter = parameters[key]
        prior: Prior | None = parameter.prior
        if prior is not None:
            slope = parameter.slope(parameter.value(x[key]))
            precision[place] = (slope / prior.sd) ** 2
            mean[place] = x[key] + (prior.mean - parameter.value(x[key])) / slope
    return precision, mean


def _expected_nuisances(misfit: Misfit) -> FloatArray:
    """Return the nuisances as their priors have them, 0 without."""
    nuisances = np.zeros(len(misfit.names))
    for j, prior in misfit.priors:
        nuisances[j] = prior.mean
    return nuisances[len(misfit.problem.parameters) :]


def _integrated(
    name: str,
    reduced: Sequence[ReducedTest],
    levels: Sequence[Level],
    prior: tuple[FloatArray, FloatArray],
    sizes: Sequence[Size],
) -> ScatterPosterior:
    try:
        model = MixedModel(reduced, levels, *prior)
        return integrate([model], np.ones(1), sizes)
    except np.linalg.LinAlgError as error:
        raise ComputationError(
            f"{name}: readings do not determine all keys of the material; leave out scatter to see "
            "which are not identified"
        ) from error


def _noise_growth(
    misfit: Misfit,
    evaluation: Evaluation,
    tests: Sequence[LinearisedTest],
    posterior: ScatterPosterior,
) -> FloatArray:
    """Return by how much the noise of each series (series,) is larger; 1 where it is given."""
    leverages = []
    for number, test in enumerate(tests):
        priors = np.concatenate([test.nuisances, test.prior_rows])
        padding = np.zeros((len(test.prior_rows), test.jacobian.shape[1]))
        projection = NuisanceProjection(priors)
        rest = projection.rest(np.concatenate([test.jacobian, padding]))[: len(test.readings)]
        by_keys = np.einsum("ij,jk,ik->i", rest, posterior.covariance_of_test(number), rest)
        leverages.append(projection.leverage[: len(test.readings)] + by_keys)
    leverage = np.concatenate(leverages)
    weighted = weights(misfit.problem.settings.loss, evaluation.noise) * evaluation.noise**2
    growth = np.ones(len(misfit.records))
    for i, record in enumerate(misfit.records):
        if record.series.sd_fitted:
            free = max(1.0, float((1.0 - leverage[record.rows]).sum()))
            growth[i] = np.sqrt(weighted[record.rows].sum() / free)
    return growth


def _alone(
    reduced: Sequence[ReducedTest], posterior: ScatterPosterior, test_unknowns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return estimate and sd (tests, free) of each unknown by one test, the others as estimated."""
    count = test_unknowns.shape[1]
    estimate, sd = np.full_like(test_unknowns, np.nan), np.full_like(test_unknowns, np.inf)
    material = np.array([posterior.material(j).mean for j in range(count)])
    scattering = {level.key for level in posterior.model.levels}
    for i, test in enumerate(reduced):
        # what does not scatter is the material's, and as well known as that
        fixed = np.where([j in scattering for j in range(count)], test_unknowns[i], material)
        for j in range(count):
            if test.information[j, j] > 0.0:
                by_other_keys = np.delete(test.information[j] * fixed, j).sum()
                estimate[i, j] = (test.score[j] - by_other_keys) / test.information[j, j]
                sd[i, j] = test.information[j, j] ** -0.5
    return estimate, sd


def _covariance(
    misfit: Misfit,
    linear: Linearisation,
    tests: Sequence[LinearisedTest],
    posterior: ScatterPosterior,
    x: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (u, u) of the unknowns, and the sd (n,) of the model's readings.

    Nuisances follow the keys of their test; those of different tests are given as independent.
    """
    free = list(linear.free)
    covariance, band = np.zeros((len(x), len(x))), np.zeros(misfit.n)
    covariance[np.ix_(free, free)] = posterior.covariance
    for number, test in enumerate(tests):
        nuisances, c = linear.nuisances_of(number), test.nuisances.shape[1]
        stacked = np.concatenate([test.nuisances, test.prior_rows])
        normal = np.linalg.pinv(stacked.T @ stacked, hermitian=True)
        follow = -normal @ test.nuisances.T @ test.jacobian
        keys = posterior.covariance_of_test(number)
        covariance[np.ix_(nuisances, nuisances)] = normal + follow @ keys @ follow.T
        across = follow @ posterior.covariance_of_test_and_material(number)
        covariance[np.ix_(nuisances, free)] = across
        covariance[np.ix_(free, nuisances)] = across.T
        rows = np.concatenate([test.jacobian + test.nuisances @ follow, test.nuisances], axis=1)
        whole = np.zeros((len(free) + c, len(free) + c))
        whole[: len(free), : len(free)], whole[len(free) :, len(free) :] = keys, normal
        sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, whole, rows), 0.0))
        band[linear.rows[number]] = sd * misfit.sd[linear.rows[number]]
    return covariance, band


def _levels(
    parameters: Sequence[FittedParameter], free: Sequence[int], misfit: Misfit
) -> tuple[list[Level], list[Size], list[tuple[str, ...]]]:
    """Return the levels of all keys that scatter, their sizes, and the names of their groups."""
    experiments = misfit.problem.experiments
    levels, sizes, names = [], [], []
    for key, parameter in enumerate(parameters):
        if parameter.scatter is None:
            continue
        for group, size in parameter.scatter.sizes.items():
            numbers = group_numbers(experiments, group)
            place = GROUPS.index(group)
            named = dict.fromkeys(experiment.groups[place] for experiment in experiments)
            levels.append(Level(free.index(key), group, numbers))
            sizes.append(Size(size, parameter.scatter.scale))
            names.append(tuple(named))
    return levels, sizes, names
