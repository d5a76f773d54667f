"""What draws say of the fitted keys, of their scatter and of random wear: numbers and verdicts.

Keys are in the case's units, in those of their users, and as specific wear rates.
"""

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from scipy.stats import t as student_t

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import base_unit
from ringwear_par.cases.units import CUSTOMARY, SPECIFIC, factor
from ringwear_par.identification.definition.fitted_parameters import RANDOM, unit_scale, units_of
from ringwear_par.identification.definition.problem import GROUPS, FittedParameter, Problem
from ringwear_par.identification.posterior import Scattering
from ringwear_par.identification.solution import Solution

Entry = Mapping[str, Any]
Verdict = Literal["identified", "at bound", "not identified"]
#: a key is at its bound where the density there is more than this share of the largest
_AT_BOUND = 0.25
#: parts of an interval of 95 %, in which densities are counted
_WINDOWS = 20
#: correlation of two keys above which a bound of one is what the other is known by
_CONDITIONAL = 0.87
#: fewest readings of a record
_SEVERAL = 5
#: half width of the interval of a material that takes so many specimens, and most of these
_WANTED, _MOST_SPECIMENS = 0.1, 10_000
#: share of the prior's sd above which an sd says hardly more
VAGUE = 0.5
#: share of the largest component of a direction above which keys are mentioned
_MENTIONED = 0.15
#: correlation of a vague key with a nuisance that is to blame
_TOGETHER = 0.9
#: mm3/(N m) in 1/MPa
_RATE, _FRICTION = factor(SPECIFIC, None), "contact.friction"
#: intervals of a key's entry: of a running test the one before too
_INTERVALS = ("interval", "next", "before")


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
    counts = np.searchsorted(draws, low + width), len(draws) - np.searchsorted(draws, high - width)
    # surely: more than by two of its own errors
    at_low, at_high = (count - 2.0 * np.sqrt(count) > _AT_BOUND * largest for count in counts)
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
    return min(flat, prior.sd / (middle if parameter.log else 1.0))


def key_entries(
    solution: Solution,
    material: FloatArray,
    information: FloatArray,
    correlations: Mapping[str, FloatArray],
) -> dict[str, dict[str, Any]]:
    """Return what fit.json tells of each key.

    Parameters
    ----------
    material : (s, m) unknowns, a draw for each of the solution's.
    information : (tests, m) on the unknowns by each test's own readings, given the others.
    correlations : (m,) of the unknowns with nuisances, by their names.
    """
    problem, case = solution.problem, solution.problem.experiments[0].case
    level, units, entries = problem.settings.level, units_of(problem), {}
    values, covariance = problem.values(material), np.atleast_2d(np.cov(material.T))
    for j, parameter in enumerate(problem.parameters):
        low, high = map(parameter.unknown, parameter.bounds)
        verdict, ends = judged(material[:, j], low, high, prior_sd(parameter), level)
        entry = entries[parameter.key] = {
            "estimate": float(np.median(values[:, j])),
            "sd": float(values[:, j].std()),
            "interval": [None if end is None else float(parameter.value(end)) for end in ends],
            "verdict": verdict,
            "bounds": list(parameter.bounds),
            "of": "specimens",
            "unit": units[parameter.key],
        }
        if verdict == "not identified":
            entry["direction"] = direction(problem, covariance, j, correlations)
    for s in solution.posterior.scatterings:
        more = _scatter(solution, s, material[:, s.key], information[:, s.key])
        entries[problem.keys[s.key]] |= more
    tied = np.abs(np.atleast_2d(np.corrcoef(material.T))) > _CONDITIONAL
    at_bound = {key for key, entry in entries.items() if entry["verdict"] == "at bound"}
    for row, parameter in zip(tied, problem.parameters, strict=True):
        entry = entries[parameter.key]
        bounded = [key for key, of in zip(problem.keys, row, strict=True) if of and key in at_bound]
        if entry["verdict"] == "identified" and bounded:
            entry["conditional_on"] = bounded
        if told := in_users_unit(parameter, entry, case):
            entry["told"] = told
        if rate := specific_wear_rate(problem, parameter.key, entry, values):
            entry["specific_wear_rate"] = rate
    return entries


def _scatter(
    solution: Solution, s: Scattering, material: FloatArray, information: FloatArray
) -> dict[str, Any]:
    """Return what fit.json tells of a key that scatters.

    By the unknown (s,) of the material, and what the own readings of each test tell (tests,).
    """
    problem, theta, spread = solution.problem, solution.theta, s.spread(solution.theta)
    parameter, level = problem.parameters[s.key], problem.settings.level
    scatter: dict[str, dict[str, Any]] = {}
    for (name, size), same in zip(s.levels.items(), s.same, strict=True):
        scatter[name] = {"known": size.known}
        if size.place is not None:
            verdict, _ = judged(size(theta), 0.0, np.inf, size.scale, level)
            scatter[name] = {**_quantiles(size(theta), level), "verdict": verdict}
        scatter[name]["groups"] = len(np.unique(same, axis=0))
    following = material + spread * np.random.default_rng(0).standard_normal(len(theta))
    ends = _quantiles(parameter.reflected_value(following), level)["interval"]
    entry = {"of": "material", "scatter": scatter, "next": ends}
    if parameter.log:
        entry["mean"] = float(np.median(np.exp(material + 0.5 * spread**2)))
    x = theta[:, s.places][:, s.group]
    total, place = float(np.median(spread)), min(map(GROUPS.index, s.levels))
    if "specimen" in s.levels:
        s_r = float(np.median(s.levels["specimen"](theta)))
        entry["repeatability"] = {"s_r": s_r, "r": 2.8 * s_r}
    if {*s.levels} != {"specimen"}:
        entry["reproducibility"] = {"s_R": total, "R": 2.8 * total}
    entry["each"] = {
        test.groups[place]: {**_quantiles(of, level), "sd": float(of.std())}
        for test, of in zip(problem.experiments, parameter.value(x).T, strict=True)
    }
    # the smallest number whose interval is narrow enough, by Student's t
    own = float(np.median(np.maximum(information, 1e-300) ** -0.5))
    wanted = _WANTED * (1.0 if parameter.log else abs(float(np.median(material))))
    n = np.arange(2, _MOST_SPECIMENS)
    enough = student_t.ppf(0.5 + 0.5 * level, n - 1) / np.sqrt(n) * math.hypot(total, own) <= wanted
    entry["specimens_for_10_percent"] = int(n[enough.argmax()]) if enough.any() else None
    return entry


def _quantiles(draws: FloatArray, level: float) -> dict[str, Any]:
    """Return the median of draws (s,) and their interval."""
    tail = 0.5 * (1.0 - level)
    low, median, high = np.quantile(draws, [tail, 0.5, 1.0 - tail]).tolist()
    return {"estimate": median, "interval": [low, high]}


def process_entries(solution: Solution) -> dict[str, dict[str, Any]]:
    """Return what fit.json tells of each body whose wear is random."""
    problem, level, entries = solution.problem, solution.problem.settings.level, {}
    shares = solution.posterior.shares(solution.theta)
    records = (s.n for test in problem.experiments for s in test.series if not s.profile)
    most = max(records, default=0)
    low, high = student_t.ppf([0.75 - 0.25 * level, 0.75 + 0.25 * level], 4)  # of the prior
    for (key, process), share, depth in zip(
        problem.settings.process.items(), shares.T, solution.depths.tolist(), strict=True
    ):
        between, verdict = depth / (most - 1) if most > _SEVERAL else None, "identified"
        found: dict[str, Any] = {"known": float(share[0])}
        size: dict[str, Any] = {"known": process.size or float(share[0]) ** 2 * depth}
        if process.fitted:
            size, found = _quantiles(share**2 * depth, level), _quantiles(share, level)
            if np.ptp(np.log(found["interval"])) >= VAGUE * math.log(high / low):
                verdict = "not identified"
            if between is not None and size["estimate"] > between:  # not normal
                size["interval"] = found["interval"] = [None, None]
        entries[key] = {
            "size": size, "share": found, "depth": depth, "verdict": verdict,
            "between_readings": between,
        }  # fmt: skip
    return entries


def direction(
    problem: Problem, covariance: FloatArray, j: int, correlations: Mapping[str, FloatArray]
) -> str:
    """Return in words what the readings determine instead of a key.

    Parameters
    ----------
    covariance : (m, m) of the unknowns.
    correlations : (m,) with nuisances, by their names.
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
    if correlations:
        together, name = max((abs(float(of[j])), name) for name, of in correlations.items())
        others += [name] * (together > _TOGETHER)
    if not others:
        return f"the readings hardly respond to {parameters[j].key}"
    return f"{parameters[j].key} against {' and '.join(others)}"


# -- units of users ------------------------------------------------------------------------------


def _scaled(entry: Entry, scale: float) -> dict[str, Any]:
    """Return numbers of a key's entry in fit.json in another unit, which is ``scale``."""
    numbers = {name: entry[name] / scale for name in ("estimate", "sd") if name in entry}
    return numbers | {
        name: [None if end is None else end / scale for end in entry[name]]
        for name in _INTERVALS
        if name in entry
    }


def in_users_unit(parameter: FittedParameter, entry: Entry, case: Case) -> dict[str, Any] | None:
    """Return the numbers of a key's entry in fit.json in the user's unit; None for the case's.

    Its ``scale`` is how much the unit is in the case's; ``per`` is "friction energy" for wear
    coefficients k of laws whose specific wear rate is k mu.
    """
    if not parameter.unit:
        return None
    scale, law = unit_scale(parameter), case.laws_by_table.get(parameter.key.rpartition(".")[0])
    of_energy = law is not None and "p0" in law.kind.parameters
    per = {"per": "friction energy"} if of_energy and base_unit(parameter.key) == "1/MPa" else {}
    return {"unit": parameter.unit, "scale": scale, **per, **_scaled(entry, scale)}


def specific_wear_rate(
    problem: Problem, key: str, entry: Entry, values: FloatArray
) -> dict[str, Any] | None:
    """Return the specific wear rate of a fitted wear coefficient; None where there is no one.

    That is where wear goes with friction energy or load, without a threshold: k mu, or k itself.
    The values (s, m) are draws of the keys.
    """
    table, _, name = key.rpartition(".")
    if table not in RANDOM or name != "k" or f"{table}.p0" in problem.keys:
        return None
    (mu, *others) = {_mu(test.case, table) for test in problem.experiments}
    if mu is None or others:
        return None
    numbers = _scaled(entry, _RATE / mu)
    if mu != 1.0 and _FRICTION in problem.keys:
        k, friction = (values[:, problem.keys.index(name)] for name in (key, _FRICTION))
        mu, rates = float(np.median(friction)), k * friction / _RATE
        numbers = {**_quantiles(rates, problem.settings.level), "sd": float(rates.std())}
    customary = numbers["estimate"] * _RATE / factor(CUSTOMARY, None)
    rate = {"unit": SPECIFIC, **numbers, CUSTOMARY: customary}
    return rate if mu == 1.0 else {**rate, "mu": mu}


def _mu(case: Case, table: str) -> float | None:
    """Return the specific wear rate over k in a case, mu or 1; None where k is no such number."""
    law, mu = case.laws_by_table.get(table), case.friction
    if law is None or not isinstance(mu, float) or not (ratio := law.ratio(mu)):
        return None
    return round(float(ratio * mu / law.values["k"]), 12)
