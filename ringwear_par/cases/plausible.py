"""Numbers of a case that are more likely in another unit than in the case's."""

from collections.abc import Iterator

from ringwear_par.cases.case import Case
from ringwear_par.cases.units import factor
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ValidityWarning
from ringwear_par.schedules import largest

#: unit and plausible range of a number by the last part of its key: moduli from plastics to
#: diamond, densities from foam to osmium, coatings of 0.1 um and more. The largest specific wear
#: rate, 0.1 mm3/(N m), is Archard's K = 0.01 of severe dry sliding (J. F. Archard and W. Hirst,
#: Proc. R. Soc. A 236 (1956) 397) over a hardness of 100 MPa
_PLAUSIBLE = {
    "young": ("MPa", 1e3, 1.3e6), "density": ("g/mm^3", 1e-5, 0.025),
    "thickness": ("mm", 1e-4, 100.0), "r[1]": ("mm", 0.3, 5e3),
    "k": ("1/MPa", 0.0, 1e-4), "k_start": ("1/MPa", 0.0, 1e-4),
}  # fmt: skip
#: what such numbers are usually typed in instead
_OTHER_UNITS = {
    "MPa": ("GPa", "Pa"), "g/mm^3": ("g/cm3", "kg/m3"), "mm": ("um", "m"), "1/MPa": ("mm3/(N m)",),
}  # fmt: skip
#: a material of this Poisson's ratio may be a rubber, or a gel of this modulus (MPa)
_RUBBERY, _SOFTEST = 0.4, 0.1


def implausible_numbers(case: Case) -> tuple[ValidityWarning, ...]:
    """Return the numbers of a case out of their plausible ranges. Not collective.

    One that is written with its unit is meant.
    """
    warnings = []
    for key, number in _numbers(case):
        table, _, name = key.rpartition(".")
        unit, low, high = _PLAUSIBLE[name]
        if name == "young" and case.materials[table].poisson >= _RUBBERY:
            low = _SOFTEST
        if not low <= number <= high and key.removesuffix("[1]") not in case.with_units:
            others = (u for u in _OTHER_UNITS[unit] if low <= number * factor(u, unit) <= high)
            other = next(others, "")
            meant = f"in {other}" if other else "meant"
            text = (
                f"{key} = {number:g} {unit} is out of the plausible {low:g} to {high:g} {unit}; "
                f'if it is {meant}, write "{number:g} {other or unit}"'
            )
            warnings.append(ValidityWarning("implausible_numbers", text, (key,)))
    return tuple(warnings)


def _numbers(case: Case) -> Iterator[tuple[str, float]]:
    """Yield the numbers that have plausible ranges, by key."""
    for table, material in case.materials.items():
        for name in ("young", "density", "thickness"):
            if (number := getattr(material, name, None)) is not None:
                yield f"{table}.{name}", number
    for body, ring in zip(BODIES, case.rings, strict=True):
        yield f"{body}.r[1]", ring.r[1]
    yield from _coefficients(case)


def _coefficients(case: Case) -> Iterator[tuple[str, float]]:
    """Yield the largest values of coefficients of laws that are in 1/MPa, by key."""
    for table, law in case.laws_by_table.items():
        for name, quantity in law.quantities.items():
            if law.unit(name) == "1/MPa":
                yield f"{table}.{name}", largest(quantity)


def wear_question(case: Case, body: str = "") -> str:
    """Return the question of a case that wears much for its coefficient's unit; "" for none.

    Parameters
    ----------
    body : that wears much; "": either.
    """
    asked = [
        (k, key) for key, k in _coefficients(case) if body in key and key not in case.with_units
    ]
    if not asked:
        return ""
    k, key = max(asked)
    return f' ({key} = {k:g} is in 1/MPa: if it is in mm3/(N m), write "{k:g} mm3/(N m)")'
