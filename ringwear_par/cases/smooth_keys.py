"""Keys of the plain numbers of a case that its history depends on smoothly: they may be fitted."""

from collections.abc import Sequence

from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import UNITS, key_of
from ringwear_par.cases.values import is_number
from ringwear_par.elasticity.sections import BODIES


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
    for table, law in case.laws_by_table.items():
        own = law.quantities.items()
        units |= {f"{table}.{k}": law.unit(k) for k, q in own if is_number(q)}
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
        if is_number(number):
            units[key] = UNITS[key]
    return units | elastic_numbers(case)
