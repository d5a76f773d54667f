"""What draws say of the fitted keys, of their scatter and of random wear: numbers and verdicts."""

import math
from typing import Any, Literal

import numpy as np
from scipy.stats import t as student_t

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.definition.problem import (
    GROUPS,
    FittedParameter,
    Problem,
    reflected,
)
from ringwear_par.identification.posterior import Scattering
from ringwear_par.identification.solution import Solution
from ringwear_par.identification.users_units import in_users_unit, specific_wear_rate

Verdict = Literal["identified", "at bound", "not identified"]
#: a key is at its bound where the density there is more than this share of the largest
_AT_BOUND = 0.25
#: parts of an interval of 95 %, in which densities are counted
_WINDOWS = 20
#: correlation of two keys above which a bound of one is what the other is known by
_CONDITIONAL = 0.87
#: fewest readings of a record
_SEVERAL = 5
#: share of the prior's sd above which an sd says hardly more
VAGUE = 0.5
#: share of the largest component of a direction above which keys are mentioned
_MENTIONED = 0.15
#: correlation of a vague key with a nuisance that is to blame
_TOGETHER = 0.9
#: half width, relative, of the interval of the material that specimens are counted for; most
_WANTED, _MOST_SPECIMENS = 0.1, 10_000


def judged(
    draws: FloatArray, low: float, high: float, prior_sd: float, level: float
) -> tuple[Verdict, list[float | None]]:
    """Return the verdict on a number by its draws (s,), and its interval; None: no limit there.

    Parameters
    ----------
    low, high : its bounds, infinite for none.
    prior_sd : of what was known of it before.
    """
    draws, tail = np.sort(draws), 0.5 * (1.0 - level)
    width = float(np.diff(np.quantile(draws, [0.025, 0.975]))[0]) / _WINDOWS
    largest = (np.searchsorted(draws, draws + width) - np.arange(len(draws))).max()
    at_low = np.searchsorted(draws, low + width) > _AT_BOUND * largest
    at_high = len(draws) - np.searchsorted(draws, high - width) > _AT_BOUND * largest
    one = at_low != at_high
    ends = np.quantile(draws, [2.0 * tail, 1.0 - 2.0 * tail] if one else [tail, 1.0 - tail])
    low_end, high_end = ends.tolist()
    interval = [None if at_low else low_end, None if at_high else high_end]
    if (at_low and at_high) or draws.std() > VAGUE * prior_sd:
        return "not identified", interval
    return "at bound" if one else "identified", interval


def prior_sd(parameter: FittedParameter) -> float:
    """Return the standard deviation of a key's unknown before any reading."""
    low, high = map(parameter.unknown, parameter.bounds)
    flat, prior = (high - low) / math.sqrt(12.0), parameter.prior
    if prior is None:
        return flat
    middle = min(max(prior.mean, parameter.bounds[0]), parameter.bounds[1])
    return min(flat, prior.sd / parameter.slope(middle))


def key_entries(
    solution: Solution,
    material: FloatArray,
    own_sds: FloatArray,
    some: FloatArray,
    nuisances: dict[str, FloatArray],
) -> dict[str, dict[str, Any]]:
    """Return what fit.json tells of each key.

    Parameters
    ----------
    material : (s, m) unknowns, a draw for each of the solution's.
    own_sds : (tests, m) of the unknowns by each test's own readings, given the others.
    some : (t, m) of them, beside which nuisances were drawn.
    nuisances : draws (t,) by their names.
    """
    problem, posterior = solution.problem, solution.posterior
    level, units, entries = problem.settings.level, units_of(problem), {}
    scatterings = {s.key: s for s in posterior.scatterings}
    values = np.where([p.log for p in problem.parameters], np.exp(material), material)
    for j, parameter in enumerate(problem.parameters):
        low, high = map(parameter.unknown, parameter.bounds)
        verdict, ends = judged(material[:, j], low, high, prior_sd(parameter), level)
        entry = entries[parameter.key] = {
            "estimate": parameter.value(float(np.median(material[:, j]))),
            "sd": float(values[:, j].std()),
            "interval": [None if end is None else parameter.value(end) for end in ends],
            "verdict": verdict,
            "bounds": list(parameter.bounds),
            "of": "specimens",
            "unit": units[parameter.key],
        }
        if verdict == "not identified":
            entry["direction"] = direction(problem, np.atleast_2d(np.cov(material.T)), j, {
                name: float(np.corrcoef(some[:, j], draws)[0, 1])
                for name, draws in nuisances.items() if draws.std() > 0.0
            })  # fmt: skip
        if j in scatterings:
            own = float(np.median(own_sds[:, j]))
            entry.update(_scatter(solution, scatterings[j], parameter, material[:, j], own))
    tied = np.abs(np.atleast_2d(np.corrcoef(material.T))) > _CONDITIONAL
    for row, parameter in zip(tied, problem.parameters, strict=True):
        entry = entries[parameter.key]
        others = [key for key, known_by in zip(problem.keys, row, strict=True) if known_by]
        bounded = [key for key in others if entries[key]["verdict"] == "at bound"]
        if entry["verdict"] == "identified" and bounded:
            entry["conditional_on"] = bounded
        if told := in_users_unit(parameter, entry, problem.experiments[0].case):
            entry["told"] = told
        if rate := specific_wear_rate(problem, parameter.key, entries, values):
            entry["specific_wear_rate"] = rate
    return entries


def _scatter(
    solution: Solution, s: Scattering, parameter: FittedParameter, material: FloatArray, own: float
) -> dict[str, Any]:
    """Return what fit.json tells of a key that scatters, by the unknown of the material (s,)."""
    theta, problem = solution.theta, solution.problem
    level, spread = problem.settings.level, s.spread(theta)
    scatter: dict[str, dict[str, Any]] = {}
    for (name, size), same in zip(s.levels.items(), s.same, strict=True):
        scatter[name] = {"known": size.known}
        if size.place is not None:
            verdict, _ = judged(size(theta), 0.0, np.inf, size.scale, level)
            scatter[name] = {**_quantiles(size(theta), level), "verdict": verdict}
        scatter[name]["groups"] = len(np.unique(same, axis=0))
    following = material + spread * np.random.default_rng(0).standard_normal(len(theta))
    bounds = map(np.array, map(parameter.unknown, parameter.bounds))
    following = reflected(following, *bounds)
    entry: dict[str, Any] = {
        "of": "material", "scatter": scatter,
        "next": _quantiles(following, level, parameter)["interval"],
        "each": {},
    }  # fmt: skip
    if parameter.log:
        entry["mean"] = float(np.median(np.exp(material + 0.5 * spread**2)))
    total = float(np.median(spread))
    if "specimen" in s.levels:
        s_r = float(np.median(s.levels["specimen"](theta)))
        entry["repeatability"] = {"s_r": s_r, "r": 2.8 * s_r}
    if {*s.levels} != {"specimen"}:
        entry["reproducibility"] = {"s_R": total, "R": 2.8 * total}
    place = min(map(GROUPS.index, s.levels))
    for number, unknown in enumerate(theta[:, s.places].T):
        name = problem.experiments[int(np.argmax(s.group == number))].groups[place]
        sd = float((np.exp(unknown) if parameter.log else unknown).std())
        entry["each"][name] = {**_quantiles(unknown, level, parameter), "sd": sd}
    # the smallest number whose interval is narrow enough, by Student's t
    wanted = _WANTED * (1.0 if parameter.log else abs(float(np.median(material))))
    n = np.arange(2, _MOST_SPECIMENS)
    reach = student_t.ppf(0.5 + 0.5 * level, n - 1) / np.sqrt(n)
    enough = reach * math.hypot(total, own) <= wanted
    entry["specimens_for_10_percent"] = int(n[enough.argmax()]) if enough.any() else None
    return entry


def _quantiles(
    draws: FloatArray, level: float, parameter: FittedParameter | None = None
) -> dict[str, Any]:
    """Return the median of draws (s,), those of unknowns as values, and their interval."""
    tail = 0.5 * (1.0 - level)
    found = np.quantile(draws, [tail, 0.5, 1.0 - tail]).tolist()
    low, median, high = found if parameter is None else map(parameter.value, found)
    return {"estimate": median, "interval": [low, high]}


def process_entries(solution: Solution) -> dict[str, dict[str, Any]]:
    """Return what fit.json tells of each body whose wear is random."""
    problem, posterior, entries = solution.problem, solution.posterior, {}
    level, depths = problem.settings.level, solution.depths.tolist()
    shares = posterior.shares(solution.theta)
    records = [s for test in problem.experiments for s in test.series if not s.profile]
    most = max((record.n for record in records), default=0)
    for (key, process), share, depth in zip(
        problem.settings.process.items(), shares.T, depths, strict=True
    ):
        between = depth / (most - 1) if most > _SEVERAL else None
        entry: dict[str, Any] = {"depth": depth, "verdict": "identified"}
        entries[key] = entry
        entry["between_readings"] = between
        if not process.fitted:
            known = float(share[0])
            size = process.size or known**2 * depth
            entry |= {"size": {"known": size}, "share": {"known": known}}
            continue
        found = _quantiles(share, level)
        low, high = found["interval"]
        before = student_t.ppf([0.75 - 0.25 * level, 0.75 + 0.25 * level], 4)
        if math.log(high / low) >= VAGUE * math.log(before[1] / before[0]):
            entry["verdict"] = "not identified"
        entry |= {"size": _quantiles(share**2 * depth, level), "share": found}
        if between is not None and entry["size"]["estimate"] > between:  # not normal
            entry["size"]["interval"] = entry["share"]["interval"] = [None, None]
    return entries


def direction(
    problem: Problem, covariance: FloatArray, j: int, nuisances: dict[str, float] | None = None
) -> str:
    """Return in words what the readings determine instead of a key.

    Parameters
    ----------
    covariance : (m, m) of the unknowns.
    nuisances : their correlation with the key, by name.
    """
    parameters = problem.parameters
    size = np.array([prior_sd(p) for p in parameters])
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    weak = vectors[:, np.argmax(vectors[j] ** 2 * values)]
    taking = np.flatnonzero(np.abs(weak) > _MENTIONED * np.abs(weak).max()).tolist()
    others = [parameters[i].key for i in taking if i != j]
    if len(taking) == 2 and others and all(parameters[i].log for i in taking):
        (first, one), (second, two) = sorted((parameters[i].key, weak[i] * size[i]) for i in taking)
        # of the product whose logarithm does not change along the weak direction
        power = -one / two
        exponent = "" if abs(abs(power) - 1.0) < 0.05 else f"^{abs(power):.2g}"
        return f"only {first} {'x' if power > 0 else '/'} {second}{exponent} is known"
    if nuisances:
        name = max(nuisances, key=lambda name: abs(nuisances[name]))
        others += [name] * (abs(nuisances[name]) > _TOGETHER)
    if not others:
        return f"the readings hardly respond to {parameters[j].key}"
    return f"{parameters[j].key} against {' and '.join(others)}"
