"""Traces of a profilometer as contact faces."""

import logging
from functools import cache
from pathlib import Path

import numpy as np

from ringwear_par.cases.files.columns import unit_by_name
from ringwear_par.cases.units import factor
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements, read_measurements

log = logging.getLogger(__name__)


def read_trace(path: Path) -> list[list[float]]:
    """Return the radii and heights, mm, of a table of two columns. Not collective.

    Columns are in the units that their names end with, such as ``height_um``; in mm, with a
    warning, where they end with none. Heights count towards the other body, from anywhere. Empty
    cells are left out.

    Raises
    ------
    InputError : it cannot be read, or is no such table, or in units of something else.
    """
    table = read_measurements(path)
    if len(table.columns) != 2:
        names = legible(", ".join(table.columns))
        raise InputError(f"{path}: has the columns {names}; must have two, radii and heights")
    units = [_unit(table, name) for name in table.columns]
    rows = table.filled(*table.columns)
    columns = [
        factor(unit, "mm") * table.numbers(name, rows)
        for unit, name in zip(units, table.columns, strict=True)
    ]
    order = np.argsort(columns[0], kind="stable")
    points: list[list[float]] = np.round(np.stack(columns, axis=1)[order], 12).tolist()
    return points


def _unit(table: Measurements, column: str) -> str:
    """Return the unit of a column of lengths."""
    unit = unit_by_name(table, column, "mm")
    if unit is None:
        _warn(table.name, table.label(column))
    return unit or "mm"


@cache
def _warn(path: str, column: str) -> None:
    # once, whatever the number of cases that have this face
    log.warning("%s: no unit ends the name of the column %s; it is taken in mm", path, column)
