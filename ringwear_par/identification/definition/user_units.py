"""Fitted keys as who reads them knows them: in the unit that he writes, as specific wear rates."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from scipy.stats import norm

from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import base_unit
from ringwear_par.cases.units import CUSTOMARY, SPECIFIC, factor
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import FittedParameter, Problem
from ringwear_par.wear.laws.threshold import AboveThreshold

_FRICTION = "contact.friction"

Entry = Mapping[str, Any]


def unit_scale(parameter: FittedParameter) -> float:
    """Return how much the user's unit of a fitted key is in the case's; 1 where it is that."""
    return factor(parameter.unit, base_unit(parameter.key)) if parameter.unit else 1.0


def in_users_unit(parameter: FittedParameter, entry: Entry, case: Case) -> dict[str, Any] | None:
    """Return the numbers of a key in the user's unit; None where that is the case's.

    Its ``scale`` is how much the unit is in the case's; ``per`` is "friction energy" for wear
    coefficients k of laws whose specific wear rate is k mu.

    Parameters
    ----------
    entry : of the key, as in fit.json; of a running test its interval before too.
    """
    if not parameter.unit:
        return None
    scale = unit_scale(parameter)

    def converted(number: Any) -> Any:
        if isinstance(number, list | tuple):
            return [converted(one) for one in number]
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

    Parameters
    ----------
    entries : of all fitted keys, as in fit.json.
    covariance : (m, m) of their values.
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
