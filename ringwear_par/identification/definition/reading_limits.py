"""Readings that no test could give, and densities that no material has.

Times outside the test, radii off the body, depths beyond its height.
"""

from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.cases.case import Case, density_keys
from ringwear_par.cases.tables import TableReader
from ringwear_par.files.measurements import and_more
from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.definition.schema import DENSITIES

#: units of densities, in g/mm3
_OTHER_UNITS = {"g/cm3": 1e-3, "kg/m3": 1e-6, "kg/mm3": 1e3, "t/mm3": 1e6}


def density_of(reader: TableReader, quantity: str, case: Case | None) -> float | None:
    """Return the density of all that is lost, g/mm3; None where each layer has its own.

    Refuse one that is not known, or that nothing has, as that in another unit.

    Parameters
    ----------
    quantity : "mass.lower" or "mass.upper".
    case : of the experiment; None where that has faults itself.
    """
    body = quantity.partition(".")[2]
    densities = (
        (None,) if case is None else (case.lower if body == "lower" else case.upper).densities
    )
    case_density = densities[0] if len(set(densities)) == 1 else None
    if reader.raw("density") is None and len(densities) > 1:
        _check_densities(reader, body, densities)
        return case_density
    default = ... if case_density is None else case_density
    density: float | None = reader.read("density", default)
    if density is not None and (rule := _density_rule(density)):
        reader.wrong("density", rule)
    return density


def _check_densities(reader: TableReader, body: str, known: Sequence[float | None]) -> None:
    """Refuse a mass of a body some of whose layers have no density, or one that nothing has."""
    keys = density_keys(body, len(known) - 1)
    if missing := ", ".join(key for key, density in zip(keys, known, strict=True) if not density):
        reader.wrong(
            "density", f"must be that of all that is lost, or the case must have {missing} (g/mm3)"
        )
    for key, density in zip(keys, known, strict=True):
        if density and (rule := _density_rule(density)):
            reader.fault(f"{key} = {density:g}: {rule}")


def _density_rule(density: float) -> str:
    """Return the rule that a density (g/mm3) breaks, "" if it is one of a material."""
    low, high = DENSITIES
    if low <= density <= high:
        return ""
    hint = next(
        (
            f"; {density:g} {unit} would be {density * share:.6g}"
            for unit, share in _OTHER_UNITS.items()
            if low <= density * share <= high
        ),
        "",
    )
    return f"must be from {low:g} to {high:g} g/mm3, as of foams and metals{hint}"


def check_times(reader: TableReader, series: Series, case: Case) -> None:
    """Refuse times that do not increase, or that are outside the test."""
    x, end = series.x, case.time.end
    if (late := np.flatnonzero(np.diff(x) <= 0)).size:
        i = int(late[0])
        reader.fault(
            f"{_line(series, i + 1)}time {x[i + 1]:g} s after {x[i]:g} s{_more(late)}: times must "
            "increase"
        )
    if (outside := np.flatnonzero((x < 0) | (x > end))).size:
        i = int(outside[0])
        reader.fault(
            f"{_line(series, i)}time {x[i]:g} s{_more(outside)}: must be within the test, from 0 "
            f"to {end:g} s (time.end)"
        )
    if series.quantity != "torque":
        _check_depths(reader, series, case)


def check_profile(reader: TableReader, series: Series, case: Case) -> None:
    """Refuse radii that are not those of the body."""
    ring = getattr(case, series.body)
    if (outside := np.flatnonzero((series.x < ring.r[0]) | (series.x > ring.r[1]))).size:
        i, hint = int(outside[0]), ""
        if ring.r[0] <= series.x[i] / 1e3 <= ring.r[1]:
            hint = "; it is a thousand times too large: look at units.r"
        reader.fault(
            f"{_line(series, i)}r = {series.x[i]:g} mm{_more(outside)}: must be on the "
            f"{series.body} body, from {ring.r[0]:g} to {ring.r[1]:g} mm{hint}"
        )
    a, b = case.contact
    if not ((series.x >= a) & (series.x <= b)).any():
        reader.fault(
            f"{series.file or 'r'}: has no reading within the contact, {a:g} to {b:g} mm; must "
            "have one at least"
        )
    _check_depths(reader, series, case)


def _check_depths(reader: TableReader, series: Series, case: Case) -> None:
    """Refuse depths that no body has."""
    if series.quantity.startswith(("mass", "volume")):
        return
    highest = min(ring.z[1] - ring.z[0] for ring in case.rings)
    i = int(np.argmax(np.abs(series.value)))
    if abs(series.value[i]) > highest:
        reader.fault(
            f"{_line(series, i)}{series.value[i]:g} mm: must be less than the height of a body, "
            f"{highest:g} mm; look at the unit"
        )


def _more(wrong: IntArray) -> str:
    return and_more(len(wrong), "reading")


def _line(series: Series, i: int) -> str:
    """Return where a reading stands; "" of one that stands in no file."""
    return "" if series.lines is None else f"{series.file}: line {series.lines[i]}: "
