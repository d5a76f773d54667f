"""Keys of the plain numbers of a case that its history depends on smoothly: they may be fitted."""

from collections.abc import Sequence
from typing import Any

from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import UNITS, key_of
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.wear.law import Law, parameters_of
from ringwear_par.wear.layered import LayeredLaw


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


def smooth_keys(case: Case) -> dict[str, str]:
    """Return the plain numbers of a case that its history depends on smoothly, with units."""
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
