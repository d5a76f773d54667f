"""Numbers of keys in the units of their users, and as specific wear rates."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import base_unit
from ringwear_par.cases.units import CUSTOMARY, SPECIFIC, factor
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.fitted_parameters import unit_scale
from ringwear_par.identification.definition.problem import FittedParameter, Problem

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
    if law is not None and "p0" in law.kind.parameters and base_unit(parameter.key) == "1/MPa":
        unit["per"] = "friction energy"
    return {**unit, **{name: converted(entry.get(name)) for name in names}}


def specific_wear_rate(
    problem: Problem, key: str, entries: Mapping[str, Entry], values: FloatArray
) -> dict[str, Any] | None:
    """Return the specific wear rate of a fitted wear coefficient; None where there is no one.

    That is where wear goes with friction energy or load, without a threshold: k mu, or k itself.
    The values (s, m) are draws of the keys.
    """
    body, entry = key.removeprefix("wear.").removesuffix(".k"), entries[key]
    threshold = entries.get(f"wear.{body}.p0", {}).get("estimate")
    cases = [experiment.case for experiment in problem.experiments]
    shares = {_share(case, body, threshold) for case in cases} if body in BODIES else {None}
    (share, *others) = shares
    if share is None or others:
        return None
    unit = factor(SPECIFIC, None)
    if share == 1.0 or _FRICTION not in problem.keys:
        ends = [None if end is None else share * end / unit for end in entry["interval"]]
        estimate, sd = (share * entry[name] / unit for name in ("estimate", "sd"))
    else:
        share = float(entries[_FRICTION]["estimate"])
        products = values[:, problem.keys.index(key)] * values[:, problem.keys.index(_FRICTION)]
        level, (estimate, sd) = problem.settings.level, (np.median(products), products.std())
        tails = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
        ends = (np.quantile(products, tails) / unit).tolist()
        estimate, sd = float(estimate) / unit, float(sd) / unit
    rate = {"unit": SPECIFIC, "estimate": estimate, "sd": sd, "interval": ends}
    if share != 1.0:
        rate["mu"] = share
    return {**rate, CUSTOMARY: estimate * unit / factor(CUSTOMARY, None)}


def _share(case: Case, body: str, threshold: float | None) -> float | None:
    """Return the specific wear rate over k in a case, mu or 1; None where k is no such number."""
    law, mu = case.laws_by_table[f"wear.{body}"], case.friction
    if law is None or not isinstance(mu, float) or not isinstance(law.values.get("k"), float):
        return None
    if threshold is not None:
        law = replace(law, values={**law.values, "p0": threshold})
    ratio = law.per_energy(mu)
    return None if ratio is None else round(float(ratio * mu / law.values["k"]), 12)
