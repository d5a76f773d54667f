"""Keys of numbers that histories have derivatives with respect to."""

from collections.abc import Sequence
from typing import Any

from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import UNITS, key_of
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, legible
from ringwear_par.wear.law import Law, parameters_of
from ringwear_par.wear.layered import LayeredLaw

#: names, like keys of a case, of a factor on all rates of a body, whose value is 1
RATES = tuple(f"wear.{body}" for body in BODIES)
#: keys whose number is a factor on the whole of a table in time, of value 1, where they have one
SCHEDULES = ("contact.friction", "load.force", "load.omega")


def elastic_numbers(case: Case) -> dict[str, str]:
    """Return the keys of numbers that need a compliance for each value, and their units."""
    units = {}
    for body, ring in zip(BODIES, case.rings, strict=True):
        for i in range(len(ring.layers)):
            for entry in ("thickness", "young", "poisson"):
                key = key_of(name := f"{body}.layers[{i}].{entry}")
                assert key is not None
                units[name] = key.unit
        if ring.layers:
            units[f"{body}.young"] = "MPa"
    return units


def is_elastic(case: Case, keys: Sequence[str]) -> bool:
    """Tell whether any of these keys is one of ``elastic_numbers``."""
    return not elastic_numbers(case).keys().isdisjoint(keys)


def differentiable(case: Case) -> dict[str, str]:
    """Return the keys of a case that histories have derivatives with respect to, and their units.

    Its plain numbers: of a law's parameters, those that rates have derivatives with respect to.
    """
    units: dict[str, str] = {}
    for body, law in zip(BODIES, case.laws, strict=True):
        if law is None:
            continue
        for name in law.numeric:
            if _is_number(law.quantity(name)):
                units[_key_of_parameter(body, name)] = _unit(law, name)
        if law.length and "length" in parameters_of(type(law)):
            units[f"wear.{body}.length"] = "mm"
    load = case.load
    for key, number in (
        ("contact.friction", case.friction),
        ("load.pressure", load.force),
        ("load.force", load.force),
        ("load.displacement", load.displacement),
        ("load.omega", load.omega),
        ("lower.young", case.lower.young),
        ("upper.young", case.upper.young),
    ):
        if _is_number(number):
            units[key] = UNITS[key]
    return units | elastic_numbers(case)


def _key_of_parameter(body: str, name: str) -> str:
    """Return the key of a parameter of a body's law, or of one of its layers' laws."""
    layer, _, parameter = name.rpartition("].")
    return f"{body}.{layer}].wear.{parameter}" if layer else f"wear.{body}.{name}"


def _unit(law: Law, name: str) -> str:
    """Return the unit of a parameter, "1" where it is not declared."""
    if isinstance(law, LayeredLaw):
        return next(_unit(law.laws[i], parameter) for i, parameter in law.laws_with(name))
    parameter = parameters_of(type(law)).get(name)
    return "1" if parameter is None else parameter.unit


def _is_number(quantity: Any) -> bool:
    return isinstance(quantity, float | int) and not isinstance(quantity, bool)


def units_of(case: Case, keys: Sequence[str]) -> dict[str, str]:
    """Return the units of some of these keys."""
    units = dict.fromkeys((*RATES, *SCHEDULES), "1") | differentiable(case) if keys else {}
    return {key: units[key] for key in keys}


def check_derivatives(case: Case, keys: Sequence[str]) -> None:
    """Refuse keys that histories have no derivatives with respect to. Not collective.

    Raises
    ------
    InputError : one sentence a key, or why this case has none at all.
    """
    if isinstance(keys, str) or not all(isinstance(key, str) for key in keys):
        raise InputError(f"derivatives = {keys!r}: must be a list of keys, as ['wear.lower.k']")
    if not keys:
        return
    if case.follows_wear:
        raise InputError(
            'derivatives: are not known with mesh.geometry = "updated"; must be "fixed" with them'
        )
    allowed = differentiable(case)
    faults = [
        f"derivatives: {legible(key)}: is no plain number of this case that its history depends "
        f"on smoothly; must be one of {', '.join(allowed)}"
        for key in keys
        if key not in allowed
    ]
    twice = dict.fromkeys(key for key in keys if list(keys).count(key) > 1)
    faults += [f"derivatives: {legible(key)}: must be named once" for key in twice]
    if faults:
        raise InputError(*faults)
