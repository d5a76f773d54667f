"""The density of what a mass in a fit file is of: its own, or those that the case tells."""

from collections.abc import Sequence

from ringwear_par.cases.case import Case, density_keys
from ringwear_par.cases.tables import TableReader
from ringwear_par.identification.definition.schema import DENSITIES

#: units of densities, in g/mm3
_OTHERS = {"g/cm3": 1e-3, "kg/m3": 1e-6, "kg/mm3": 1e3, "t/mm3": 1e6}


def density_of(reader: TableReader, quantity: str, case: Case | None) -> float | None:
    """Return the density of all that is lost, g/mm3; None where each layer has its own.

    Refuse one that is not known, or that nothing has, as that in another unit.

    Parameters
    ----------
    quantity : "mass.lower" or "mass.upper".
    case : of the experiment; None where that has faults itself.
    """
    body = quantity.partition(".")[2]
    known = (None,) if case is None else (case.lower if body == "lower" else case.upper).densities
    own = known[0] if len(set(known)) == 1 else None
    if reader.raw("density") is None and len(known) > 1:
        _check_densities(reader, body, known)
        return own
    usual = ... if own is None else own
    density: float | None = reader.read("density", usual)
    if density is not None and (must := _of_no_material(density)):
        reader.wrong("density", must)
    return density


def _check_densities(reader: TableReader, body: str, known: Sequence[float | None]) -> None:
    """Refuse a mass of a body some of whose layers have no density, or one that nothing has."""
    keys = density_keys(body, len(known) - 1)
    if missing := ", ".join(key for key, density in zip(keys, known, strict=True) if not density):
        reader.wrong(
            "density", f"must be that of all that is lost, or the case must have {missing} (g/mm3)"
        )
    for key, density in zip(keys, known, strict=True):
        if density and (must := _of_no_material(density)):
            reader.fault(f"{key} = {density:g}: {must}")


def _of_no_material(density: float) -> str:
    """Return what a density, g/mm3, must be that nothing has; "" where it is none such."""
    low, high = DENSITIES
    if low <= density <= high:
        return ""
    hint = next(
        (f"; {density:g} {unit} would be {density * share:.6g}" for unit, share in _OTHERS.items()
         if low <= density * share <= high), "",
    )  # fmt: skip
    return f"must be from {low:g} to {high:g} g/mm3, as of foams and metals{hint}"
