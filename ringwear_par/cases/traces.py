"""Traces of a profilometer as contact faces."""

from pathlib import Path

import numpy as np

from ringwear_par.cases.units import factor, unit_of_column
from ringwear_par.errors import InputError, legible
from ringwear_par.measurements import read_measurements


def read_trace(path: Path) -> list[list[float]]:
    """Return the radii and heights, mm, of a table of two columns. Not collective.

    Columns are in mm unless their names end with another unit, such as ``height_um``; heights count
    towards the other body, from anywhere. Empty cells are left out.

    Raises
    ------
    InputError : it cannot be read, or is no such table.
    """
    table = read_measurements(path)
    if len(table.columns) != 2:
        shown = legible(", ".join(table.columns))
        raise InputError(f"{path}: has the columns {shown}; must have two, radii and heights")
    rows = table.filled(*table.columns)
    columns = [
        factor(unit_of_column(name, "mm") or "mm", "mm") * table.numbers(name, rows)
        for name in table.columns
    ]
    order = np.argsort(columns[0], kind="stable")
    points: list[list[float]] = np.round(np.stack(columns, axis=1)[order], 12).tolist()
    return points
