"""``to_arviz`` of fits: draws of what they know, and the log likelihood of each reading.

Draws are those of predictions: within the bounds, and of all pieces of a posterior. Readings are
linearised at the estimate, or about the place of each piece. The log likelihood of a reading is
that given all others of its test: with the inverse q of their covariance, in which nuisances and
the random part of wear are, and the readings' distance d from the model, it is -log(2 pi)/2 +
log(q_ii)/2 - (q d)_i^2/(2 q_ii) (Sundararajan and Keerthi, Neural Comput. 13 (2001) 1103-1118).
What leaves one reading out is then right for correlated ones.
"""

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.model.histories import Histories
from ringwear_par.identification.model.noise import whitened
from ringwear_par.identification.model.rounds import Responses
from ringwear_par.identification.scatter.likelihood import ReducedTest
from ringwear_par.identification.scatter.linearisation import (
    MOST_READINGS,
    Linearisation,
    projected_precision,
)
from ringwear_par.identification.scatter.material import Material

if TYPE_CHECKING:
    import arviz

#: number of draws where there are no samples, and their seed
DRAWS, _SEED = 4000, 0
#: smallest variance, for round-off
_SMALL = 1e-12


@dataclass(frozen=True, eq=False)
class _FitDraws:
    """Draws of the unknowns of a fit."""

    #: of what the draws are
    kind: str
    #: (draws, m) unknowns, of the material where they scatter
    keys: FloatArray
    #: (draws, tests, m)
    tests: FloatArray
    #: (draws, levels) sizes of scatters
    taus: FloatArray
    #: (draws, bodies) mm, of random wear
    sizes: FloatArray


def to_arviz(fit: FitResult) -> "arviz.InferenceData":
    """Return the groups of a fit as ArviZ has them.

    InputError where arviz is not installed, or readings have no normal distribution.
    """
    try:
        import arviz
    except ImportError as error:
        raise InputError(
            "fit: to_arviz needs the Python package arviz; pip install 'ringwear-par[arviz]'"
        ) from error
    misfit, problem = fit.misfit, fit.misfit.problem
    if problem.settings.loss != "gaussian" or misfit.censored.any():
        raise InputError('fit: to_arviz needs loss = "gaussian" and no censored readings')
    if problem.settings.process and any(r.series.n > MOST_READINGS for r in misfit.records):
        raise InputError(
            f"fit: to_arviz needs records of at most {MOST_READINGS} readings beside process"
        )
    random = np.random.default_rng(_SEED)
    likelihoods, replicas, marginals, drawn = [], [], [], _drawn(fit, random)
    for draws, linear in drawn:
        of_readings = [
            _of_readings(linear, number, draws, random) for number in range(len(linear.rows))
        ]
        likelihood, replica = map(np.hstack, zip(*of_readings, strict=True))
        likelihoods.append(likelihood)
        replicas.append(misfit.data + replica)
        if draws.taus.shape[1]:
            of_tests = [_marginal(fit, linear, n, draws) for n in range(len(linear.rows))]
            marginals.append(np.stack(of_tests, axis=1))
    order = random.permutation(sum(len(draws.keys) for draws, _ in drawn))
    likelihood, replica = (np.vstack(parts)[order] for parts in (likelihoods, replicas))
    keys, taus, sizes = (
        np.vstack([getattr(draws, name) for draws, _ in drawn])[order]
        for name in ("keys", "taus", "sizes")
    )
    names = [
        (r.experiment.name, r.series.name, x) for r in misfit.records for x in r.series.x.tolist()
    ]
    test, series, place = zip(*names, strict=True)
    values = [np.array([problem.values(u) for u in keys])]
    posterior = dict(zip(problem.keys, values[0].T[:, None], strict=True))
    if fit.material is not None:
        for level, tau in zip(fit.material.mixed.posterior.model.levels, taus.T, strict=True):
            key = problem.keys[fit.material.mixed.free[level.key]]
            posterior[f"scatter of {key} between {level.name}s"] = tau[None]
        for key, size in zip(problem.settings.process, sizes.T, strict=True):
            posterior[f"process.{key}"] = size[None]
    groups: dict[str, Any] = {
        "posterior": posterior,
        "posterior_predictive": {"reading": replica[None]},
        "log_likelihood": {"reading": likelihood[None]},
        "observed_data": {"reading": misfit.data},
    }
    dims = {"reading": ["place"]}
    data = arviz.from_dict(**groups, dims=dims)
    data.posterior.attrs.update({"of_draws": drawn[0][0].kind, **fit.versions})
    where = {"test": ("place", list(test)), "series": ("place", list(series)),
             "at": ("place", np.array(place))}  # fmt: skip
    for group in ("posterior_predictive", "log_likelihood", "observed_data"):
        data[group] = data[group].assign_coords(where)
    if marginals:
        tests = [experiment.name for experiment in problem.experiments]
        variables = {"test": np.vstack(marginals)[order][None]}
        marginal = arviz.convert_to_dataset(
            variables, dims={"test": ["name"]}, coords={"name": tests}
        )
        data.add_groups({"log_likelihood_test": marginal}, warn_on_custom_groups=False)
    return data


def _drawn(fit: FitResult, random: np.random.Generator) -> list[tuple[_FitDraws, Linearisation]]:
    """Return draws within the bounds, those of each piece of the posterior, and its tests."""
    misfit, m, tests = fit.misfit, len(fit.parameters), len(fit.misfit.problem.experiments)
    if fit.material is not None:
        return _drawn_of_material(fit.misfit, fit.material, random)
    if fit.posterior is not None:
        samples = fit.posterior.samples
        kind, keys = "samples", np.array([misfit.problem.unknowns(v) for v in samples])
    else:
        if not np.isfinite(fit.covariance[:m, :m]).all():
            raise InputError("fit: to_arviz needs keys that are identified")
        kind = "linear model"
        keys = random.multivariate_normal(fit.x[:m], fit.covariance[:m, :m], DRAWS)
    none, of_tests = np.zeros((len(keys), 0)), np.repeat(keys[:, None], tests, axis=1)
    unknowns = np.tile(fit.x[:m], (tests, 1))
    linear = Linearisation(misfit, misfit.evaluate(fit.x, unknowns), fit.x, unknowns)
    return [(_FitDraws(kind, keys, of_tests, none, none), linear)]


def _drawn_of_material(
    misfit: Misfit, material: Material, random: np.random.Generator
) -> list[tuple[_FitDraws, Linearisation]]:
    problem, kind = misfit.problem, "mixture over sizes of scatter and random wear"
    free, m, drawn = [*material.mixed.free], len(problem.parameters), []
    low, high = (limits[free] for limits in problem.unknown_bounds)
    if material.pieces:  # a result keeps no histories elsewhere than at its estimate
        kind, misfit, steps = f"{kind}, in pieces", copy(misfit), misfit.responses.steps
        misfit.responses = Responses(problem, Histories(problem, MPI.COMM_SELF))
        misfit.responses.steps = steps
    counts = random.multinomial(DRAWS, [piece.weight for piece in material.parts])
    for piece, count in zip(material.parts, counts.tolist(), strict=True):
        draws = piece.posterior.draw(len(piece.test_unknowns), count, random)
        every = np.concatenate([draws.material[:, None], draws.tests], axis=1)
        inside = ((every >= low) & (every <= high)).all(axis=(1, 2))
        if not inside.any():
            continue
        keys = np.tile(material.best_fit.x[:m], (np.count_nonzero(inside), 1))
        tests = np.tile(piece.test_unknowns, (len(keys), 1, 1))
        keys[:, free], tests[:, :, free] = draws.material[inside], draws.tests[inside]
        sizes = material.wear.sizes(draws.shares[inside])
        x = material.best_fit.x
        if material.pieces:
            x = misfit.with_best_nuisances(misfit.values(x), piece.test_unknowns)
        evaluation = misfit.evaluate(x, piece.test_unknowns)
        linear = Linearisation(misfit, evaluation, x, piece.test_unknowns)
        drawn.append((_FitDraws(kind, keys, tests, draws.tau[inside], sizes), linear))
    return drawn


def _of_readings(
    linear: Linearisation, number: int, draws: _FitDraws, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return log likelihoods (draws, n) of a test's readings, and replicas of these less them."""
    test, misfit, rows = linear.tests[number], linear.misfit, linear.rows[number]
    n, roots = len(test.readings), np.diag(1.0 / misfit.sd[rows])
    records = [r for r in misfit.records if rows.start <= r.rows.start < rows.stop]
    parts = [slice(r.rows.start - rows.start, r.rows.stop - rows.start) for r in records]
    root = np.concatenate(
        [whitened(record.series, roots[part]) for record, part in zip(records, parts, strict=True)]
    )
    unroot, m = np.linalg.inv(root), test.jacobian.shape[1]
    residuals = np.tile(np.concatenate([test.readings, test.prior_values]), (len(draws.keys), 1))
    residuals[:, :n] -= draws.tests[:, number] @ test.jacobian.T
    likelihood, replica = np.empty((len(residuals), n)), np.empty((len(residuals), n))
    sizes, size_number = np.unique(draws.sizes, axis=0, return_inverse=True)
    for place, size in enumerate(sizes):
        chosen = size_number.ravel() == place
        precision = projected_precision(test, size, np.zeros((m, m)))
        noise = residuals[chosen] @ precision[:, :n]  # its mean by the readings
        information, slope = ((root.T @ precision[:n, :n]) * root.T).sum(axis=1), noise @ root
        likelihood[chosen] = 0.5 * (np.log(information / (2.0 * np.pi)) - slope**2 / information)
        values, axes = np.linalg.eigh(np.eye(n) - precision[:n, :n])
        spread = axes * np.sqrt(np.maximum(values, _SMALL))
        normal = random.standard_normal((2, len(noise), n))
        replica[chosen] = (normal[0] - noise - normal[1] @ spread.T) @ unroot.T
    return likelihood, replica


def _marginal(fit: FitResult, linear: Linearisation, number: int, draws: _FitDraws) -> FloatArray:
    """Return the log likelihood (draws,) of a test whose own values are integrated."""
    assert fit.material is not None
    m, n = draws.keys.shape[1], len(linear.tests[number].readings)
    sizes, size_number = np.unique(draws.sizes, axis=0, return_inverse=True)
    variances = np.zeros((len(draws.keys), m))
    for level, tau in zip(fit.material.mixed.posterior.model.levels, draws.taus.T, strict=True):
        variances[:, fit.material.mixed.free[level.key]] += tau**2
    logs = np.empty(len(draws.keys))
    for place, tests in enumerate(linear.reduced(sizes if draws.sizes.shape[1] else None)):
        chosen, test = size_number.ravel() == place, tests[number]
        logs[chosen] = _integrated(test, draws.keys[chosen], variances[chosen])
    return logs - 0.5 * n * np.log(2.0 * np.pi)


def _integrated(test: ReducedTest, keys: FloatArray, variances: FloatArray) -> FloatArray:
    """Return log likelihoods of material's keys (draws, m), by variances of a test's own."""
    information = test.information
    rest = test.score - keys @ information
    square = test.square - 2.0 * keys @ test.score + ((keys @ information) * keys).sum(axis=1)
    system = np.eye(len(information)) + information * variances[:, None, :]
    gain = np.linalg.solve(system, rest[:, :, None])[:, :, 0] * variances
    square -= (rest * gain).sum(axis=1)
    volume = np.linalg.slogdet(system)[1] + test.log_volume + test.log_nuisances
    return -0.5 * (square + volume)
