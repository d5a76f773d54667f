"""Numbers of keys in the units of their users, and as specific wear rates."""

from collections.abc import Mapping, Sequence
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
#: mm3/(N m) in 1/MPa
_UNIT = factor(SPECIFIC, None)

#: numbers of a key's entry: of a running test the interval before too
_NUMBERS = ("estimate", "sd", "interval", "next", "before")

Entry = Mapping[str, Any]


def _scaled(entry: Entry, scale: float, names: Sequence[str] = _NUMBERS) -> dict[str, Any]:
    """Return numbers of a key's entry in fit.json in another unit, which is ``scale``."""

    def converted(number: Any) -> Any:
        if isinstance(number, list | tuple):
            return [converted(entry) for entry in number]
        return None if number is None else number / scale

    return {name: converted(entry[name]) for name in names if name in entry}


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
    problem: Problem, key: str, entries: Mapping[str, Entry], values: FloatArray
) -> dict[str, Any] | None:
    """Return the specific wear rate of a fitted wear coefficient; None where there is no one.

    That is where wear goes with friction energy or load, without a threshold: k mu, or k itself.
    The values (s, m) are draws of the keys.
    """
    body = key.removeprefix("wear.").removesuffix(".k")
    if body not in BODIES or f"wear.{body}.p0" in entries:
        return None
    (share, *others) = {_share(test.case, body) for test in problem.experiments}
    if share is None or others:
        return None
    rate = {"unit": SPECIFIC, **_scaled(entries[key], _UNIT / share, _NUMBERS[:3])}
    if share != 1.0:
        rate["mu"] = share
    if share != 1.0 and _FRICTION in entries:
        rate["mu"], tail = float(entries[_FRICTION]["estimate"]), 0.5 - 0.5 * problem.settings.level
        k, mu = (values[:, problem.keys.index(name)] for name in (key, _FRICTION))
        low, median, high = np.quantile(k * mu / _UNIT, [tail, 0.5, 1.0 - tail]).tolist()
        rate |= {"estimate": median, "sd": float((k * mu / _UNIT).std()), "interval": [low, high]}
    rate[CUSTOMARY] = rate["estimate"] * _UNIT / factor(CUSTOMARY, None)
    return rate


def _share(case: Case, body: str) -> float | None:
    """Return the specific wear rate over k in a case, mu or 1; None where k is no such number."""
    law, mu = case.laws_by_table.get(f"wear.{body}"), case.friction
    if law is None or not isinstance(mu, float) or not isinstance(law.values.get("k"), float):
        return None
    ratio = law.ratio(mu)
    return round(float(ratio * mu / law.values["k"]), 12) if ratio else None
