"""Units of measurements, by the names that pint knows."""

import re
from functools import cache
from typing import Any

from ringwear_par.cases.values import RejectedError

#: what readings are in here; forces of a compliance are in kN
BASE = {
    "time": "s", "r": "mm", "penetration": "mm", "approach": "mm", "torque": "N mm",
    "profile": "mm", "mass": "g", "volume": "mm^3", "density": "g/mm^3",
}  # fmt: skip
#: more is no unit, and slow to look at
_LONGEST = 40


@cache
def _registry() -> Any:
    from pint import UnitRegistry  # slow to import, and only where data are read

    return UnitRegistry()


def factor(unit: str, base: str) -> float:
    """Return how much a unit is in another.

    Raises
    ------
    RejectedError : pint does not know it, or it is one of something else.
    """
    text = re.sub(r"([A-Za-zµμ])(-?\d)", r"\1^\2", unit.strip())  # mm3
    text = re.sub(r"\b([km]?)N(m|mm|cm)\b", r"\1N \2", text)  # Nm, which pint reads as 1/m
    if not text or len(text) > _LONGEST:
        raise RejectedError
    registry = _registry()
    try:
        return float(registry.Quantity(1.0, registry.Unit(text)).to(base).magnitude)
    except Exception as error:  # a syntax, a name, a dimension: pint has an exception for each
        raise RejectedError from error


def unit_of_column(name: str, base: str) -> str | None:
    """Return the unit that a column's name ends with, as ``z_um`` or ``depth [um]``; or None."""
    match = re.search(r"(?:_|\s*[\[(])\s*([^\s_\[\]()]+(?:\s[^\s_\[\]()]+)?)\s*[\])]?$", name)
    if match is None:
        return None
    try:
        factor(match[1], base)
    except RejectedError:
        return None
    return match[1]
