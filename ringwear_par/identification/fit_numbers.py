"""The contents of fit.json, with each key in its user's unit and as a specific wear rate."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.stats import norm

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import base_unit
from ringwear_par.cases.units import CUSTOMARY, SPECIFIC, factor
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.fitted_parameters import unit_scale, units_of
from ringwear_par.identification.definition.problem import SCALE, FittedParameter, Problem
from ringwear_par.identification.estimation.intervals import ParameterEstimate
from ringwear_par.identification.estimation.starts import StartOutcome
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.scatter.posterior import Mixture
from ringwear_par.results.laboratory_numbers import (
    LABORATORY_NUMBERS,
    laboratory_inputs,
    laboratory_numbers,
)
from ringwear_par.results.result import Result
from ringwear_par.studies.execution.many import simulate_all
from ringwear_par.wear.laws.threshold import AboveThreshold

_FRICTION = "contact.friction"

Entry = Mapping[str, Any]


def in_users_unit(parameter: FittedParameter, entry: Entry, case: Case) -> dict[str, Any] | None:
    """Return the numbers of a key's entry in fit.json in the user's unit; None for the case's.

    Its ``scale`` is how much the unit is in the case's; ``per`` is "friction energy" for wear
    coefficients k of laws whose specific wear rate is k mu. Of a running test the interval before
    too.
    """
    if not parameter.unit:
        return None
    scale = unit_scale(parameter)

    def converted(number: Any) -> Any:
        if isinstance(number, list | tuple):
            return [converted(entry) for entry in number]
        return None if number is None else number / scale

    names = ["estimate", "sd", "interval", "next", *(["before"] if "before" in entry else [])]
    unit = {"unit": parameter.unit, "scale": scale}
    law = case.laws_by_table.get(parameter.key.rpartition(".")[0])
    if isinstance(law, AboveThreshold) and base_unit(parameter.key) == "1/MPa":
        unit["per"] = "friction energy"
    return {**unit, **{name: converted(entry.get(name)) for name in names}}


def specific_wear_rate(
    problem: Problem, key: str, entries: Mapping[str, Entry], covariance: Sequence[Sequence[float]]
) -> dict[str, Any] | None:
    """Return the specific wear rate of a fitted wear coefficient; None where there is no one.

    That is where wear goes with friction energy or load, without a threshold: k mu, or k itself.
    The covariance (m, m) is of the values of the keys.
    """
    body, entry = key.removeprefix("wear.").removesuffix(".k"), entries[key]
    share = _share_of_friction(problem, body, entries) if body in BODIES else None
    if share is None or entry["sd"] is None:
        return None
    scale, i = share / factor(SPECIFIC, None), problem.keys.index(key)
    estimate = scale * entry["estimate"]
    rate: dict[str, Any] = {"unit": SPECIFIC, "estimate": estimate}
    relative = entry["sd"] / entry["estimate"]
    rate["interval"] = [None if end is None else scale * end for end in entry["interval"]]
    if share != 1.0:
        rate["mu"] = share
        if _FRICTION in problem.keys:
            j, mu = problem.keys.index(_FRICTION), share
            variance = relative**2 + covariance[j][j] / mu**2
            variance += 2.0 * covariance[i][j] / (mu * entry["estimate"])
            relative = math.sqrt(max(variance, 0.0))
            reach = math.exp(relative * norm.ppf(0.5 + 0.5 * problem.settings.level))
            linear = entry["interval_of"] == "linear model" and None not in entry["interval"]
            rate["interval"] = [estimate / reach, estimate * reach] if linear else [None, None]
    rate["sd"] = relative * estimate
    rate[CUSTOMARY] = estimate * factor(SPECIFIC, None) / factor(CUSTOMARY, None)
    return rate


def _share_of_friction(problem: Problem, body: str, entries: Mapping[str, Entry]) -> float | None:
    """Return the factor of a body's k, mu or 1; None where k is no such coefficient."""
    cases = [experiment.case for experiment in problem.experiments]
    threshold = entries.get(f"wear.{body}.p0")
    shares = {_share(case, body, None if threshold is None else threshold["estimate"])
              for case in cases}  # fmt: skip
    if len(shares) != 1:
        return None
    (share,) = shares
    if share not in (None, 1.0) and _FRICTION in entries:
        return float(entries[_FRICTION]["estimate"])
    return share


def _share(case: Case, body: str, threshold: float | None) -> float | None:
    law, mu = getattr(case, f"wear_{body}"), case.friction
    if not isinstance(mu, float) or not isinstance(getattr(law, "k", None), float):
        return None
    if threshold is not None:
        law = law.with_parameter("p0", threshold)
    ratio = getattr(law, "per_energy", lambda mu: None)(mu)
    return None if ratio is None else round(float(ratio * mu / law.k), 12)


def to_dict(fit: FitResult) -> dict[str, Any]:
    """Return the contents of fit.json."""
    problem = fit.misfit.problem
    return {
        "parameters": _parameters(fit),
        "keys": [p.key for p in fit.parameters],
        "covariance": _finite(fit.natural_covariance),
        "information": fit.information.tolist(),
        "log": [p.log for p in problem.parameters],
        "level": problem.settings.level,
        "chi2": fit.chi2,
        "n_data": fit.n,
        "degrees_of_freedom": fit.freedom,
        "p_value": fit.p_value,
        "flagged": fit.flagged,
        "aic": fit.aic,
        "bic": fit.bic,
        "log_evidence": log_evidence(fit),
        "specimens": len({e.groups[0] for e in problem.experiments}),
        "process": {} if fit.material is None else fit.material.process,
        "experiments": fit.experiments,
        "tests": _tests(fit),
        "nuisance": fit.nuisances,
        "inputs": _inputs(fit),
        "histories": fit.histories,
        "histories_of_profiles": fit.histories_of_profiles,
        "steps": fit.misfit.responses.steps,
        "moved_by_shorter_steps": dict(fit.discretisation_shift_sd),
        "doubts": [doubt.to_dict() for doubt in fit.doubts],
        "warnings": [doubt.text for doubt in fit.doubts],
        "starts": [_started(start, problem.keys) for start in fit.starts],
        "profiles": {key: _finite(table) for key, table in fit.profiles.items()},
        "alternatives": {
            name: {
                k: v
                for k, v in alternative.to_dict().items()
                if k not in ("alternatives", "data", "key")
            }
            for name, alternative in fit.alternatives.items()
        }
        | {name: {"error": reason} for name, reason in fit.failed.items()},
        "method": problem.settings.method,
        "loss": problem.settings.loss,
        "versions": dict(fit.versions),
        "data": dict(problem.hashes),
        "key": problem.key,
    }


def _parameters(fit: FitResult) -> dict[str, Any]:
    problem = fit.misfit.problem
    units, bounds = units_of(problem), {p.key: p.bounds for p in problem.parameters}
    entries = {
        p.key: {
            **_parameter(p),
            "bounds": list(bounds[p.key]),
            "of": "specimens",
            "interval_of": "likelihood profile" if p.key in fit.profiles else "linear model",
            "unit": units[p.key],
        }
        for p in fit.parameters
    }
    if fit.material is not None:
        for j, entry in enumerate(entries.values()):
            entry.update(fit.material.entry(j))
    for doubt in fit.doubts:
        if doubt.code == "conditional-verdict":
            key, bound = doubt.keys
            entries[key].setdefault("conditional_on", []).append(bound)
    if fit.posterior is not None:
        samples = fit.posterior.samples
        ends = fit.posterior.interval(problem.settings.level)
        for j, entry in enumerate(entries.values()):
            entry["posterior"] = {
                "median": float(np.median(samples[:, j])),
                "sd": float(samples[:, j].std(ddof=1)),
                "interval": ends[:, j].tolist(),
                "effective_samples": fit.posterior.effective,
            }
    covariance = fit.natural_covariance.tolist()
    for parameter in problem.parameters:
        entry, case = entries[parameter.key], problem.experiments[0].case
        if (numbers := in_users_unit(parameter, entry, case)) is not None:
            entry["told"] = numbers
        rate = specific_wear_rate(problem, parameter.key, entries, covariance)
        if rate is not None:
            entry["specific_wear_rate"] = rate
    return entries


def _tests(fit: FitResult) -> dict[str, dict[str, Any]]:
    """Return the numbers of laboratories at the end of each test's history, at its estimates."""
    misfit, material = fit.misfit, fit.material
    problem = misfit.problem
    tests = misfit.values_of_tests(fit.x, None if material is None else material.test_unknowns)
    cases = [
        experiment.case.replace(dict(zip(problem.keys, values.tolist(), strict=True)))
        for experiment, values in zip(problem.experiments, tests, strict=True)
    ]
    results = simulate_all(cases, MPI.COMM_SELF)
    return {
        experiment.name: {
            name: {"value": float(values[-1]), "unit": LABORATORY_NUMBERS[name].variable.unit}
            for name, values in laboratory_numbers(laboratory_inputs(result)).items()
            if np.isfinite(values[-1])
        }
        for experiment, result in zip(problem.experiments, results, strict=True)
        if isinstance(result, Result)
    }


def _inputs(fit: FitResult) -> dict[str, dict[str, Any]]:
    """Return curve, scatter of the readings about it, and scale of each input, by test and key.

    The curve is at ``time``, s; the scatter is a relative standard deviation.
    """
    inputs: dict[str, Any] = {}
    names, sds = fit.misfit.names, fit.standard_deviations
    for experiment in fit.misfit.problem.experiments:
        for measured in experiment.inputs:
            curve, readings = measured.curve(experiment.case), measured.readings(experiment.case)
            off = readings / np.maximum(curve(measured.series.x), np.finfo(float).tiny) - 1.0
            entry: dict[str, Any] = {
                "time": list(curve.x), "value": list(curve.y), "unit": measured.unit,
                "n": measured.series.n, "scatter": float(np.sqrt(np.mean(off**2))),
            }  # fmt: skip
            if measured.scale is not None:
                i, mean = names.index((experiment.name, measured.key, SCALE)), measured.scale.mean
                entry["scale"] = {"estimate": mean * (1.0 + float(fit.x[i])),
                                  "sd": mean * float(sds[i])}  # fmt: skip
            inputs.setdefault(experiment.name, {})[measured.key] = entry
    return inputs


def _parameter(estimate: ParameterEstimate) -> dict[str, Any]:
    entry = asdict(estimate)
    del entry["key"]
    entry["interval"] = list(estimate.interval)
    if not estimate.direction:
        del entry["direction"]
    return entry


def _started(outcome: StartOutcome, keys: tuple[str, ...]) -> dict[str, Any]:
    entry = asdict(outcome)
    del entry["unknowns"], entry["number"]
    for name in ("start", "optimum"):
        entry[name] = dict(zip(keys, entry[name], strict=False))
    entry["objective"] = outcome.objective if np.isfinite(outcome.objective) else None
    return entry


def _finite(table: FloatArray) -> list[list[float | None]]:
    return [[v if np.isfinite(v) else None for v in row] for row in table.tolist()]


def log_evidence(fit: "FitResult") -> float | None:
    """Return the logarithm of the evidence, but for a constant of the readings.

    The likelihood is integrated over keys and nuisances by Laplace's approximation at the estimate:
    exact where the model is linear over its intervals. With scatter or random wear, sizes are
    integrated over their grid as well. A key without a prior is uniform within its bounds, or its
    logarithm is where the scale is logarithmic, so that wide bounds make a law less probable; what
    lies beyond the bounds of a key does not count. That share is of each key by itself: where
    several correlated keys are near their bounds, it is multiplied as if they were independent.
    Free nuisances count alike under all laws: of evidences only differences mean anything.

    None where Laplace's approximation does not hold: a key is not identified, or at its bound
    without scatter and random wear; noise is fitted or not normal, readings are limits.
    """
    misfit, m, material = fit.misfit, len(fit.parameters), fit.material
    problem = misfit.problem
    rough = problem.settings.loss != "gaussian" or misfit.censored.any() or fit.noise_fitted
    known = {"identified"} if material is None else {"identified", "at bound"}
    if rough or any(parameter.verdict not in known for parameter in fit.parameters):
        return None
    low, high = problem.unknown_bounds
    prior = 0.0
    for key, (parameter, unknown) in enumerate(zip(problem.parameters, fit.x, strict=False)):
        width, variance = high[key] - low[key], fit.covariance[key, key]
        value = Mixture(np.ones(1), np.array([unknown]), np.array([variance]))
        value = value if material is None else material.mixed.unbounded.unknown(key)
        prior += value.log_probability(low[key], high[key])
        if parameter.prior is None:
            prior -= float(np.log(width))
        else:  # a density of values, its square is among the readings'
            prior += float(np.log(parameter.slope(parameter.value(unknown)) / parameter.prior.sd))
            prior -= 0.5 * float(np.log(2.0 * np.pi))
    if not np.isfinite(prior):
        return None
    if material is not None:
        constant = 0.5 * (m - misfit.n) * np.log(2.0 * np.pi)
        return material.mixed.unbounded.log_mass + prior + float(constant)
    acting = ~misfit.idle
    covariance = fit.covariance[np.ix_(acting, acting)]
    if not np.isfinite(covariance).all():
        return None
    # keys with nuisances; those that are free, or have priors, are the same under all laws
    volume = 0.5 * (np.linalg.slogdet(covariance)[1] + m * np.log(2.0 * np.pi))
    rest = fit.evaluation.residuals[misfit.n :]
    return float(misfit.log_likelihood(fit.evaluation) - 0.5 * rest @ rest + volume + prior)
