"""Readings that no test could give: outside its time, off the body, deeper than it is high."""

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.tables import TableReader
from ringwear_par.files.measurements import and_more
from ringwear_par.identification.definition.problem import Series


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
