"""Columns of tables that files name: measurements, in which units; traces of contact faces."""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ringwear_par.cases.tables import TableReader
from ringwear_par.cases.units import factor, in_unit_where_right, named_unit
from ringwear_par.cases.values import RejectedError, entries, pair
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.measurements import Measurements, read_measurements

log = logging.getLogger(__name__)

T = TypeVar("T")
#: what messages say of units
UNITS = {
    "s": "a time, such as s, min or h", "mm": "a length, such as um, mm or inch",
    "N mm": "a torque, such as N mm or N m", "N": "a force, such as N, kN or lbf",
    "g": "a mass, such as mg or g", "mm^3": "a volume, such as mm^3 or um^3",
    "MPa": "a pressure, such as MPa", "rad/s": "an angular speed, such as rad/s or rpm",
    "degC": "a temperature, such as degC or K",
}  # fmt: skip


class FileStore:
    """The files that a file names, each read once.

    Parameters
    ----------
    folder : from which their names count.
    growing : whether tables are still written to: their last line may not be whole, and what they
        measure may end before the test.
    """

    def __init__(self, folder: Path, growing: bool = False) -> None:
        self.folder, self.growing = folder, growing
        self._read: dict[tuple[str, Any, Any], Any] = {}

    def __call__(self, name: str, skip: int = 0, drop: Sequence[str] = ()) -> Measurements:
        """Return a file's table, see ``read``.

        Parameters
        ----------
        skip : lines at its beginning that are left out.
        drop : texts of cells that count as empty.
        """
        return self.read(name, read_measurements, skip=skip, growing=self.growing).without(drop)

    def read(self, name: str, function: Callable[..., T], **options: Any) -> T:
        """Return the content of a file, which has its ``sha256``.

        Parameters
        ----------
        function : is called with the file's path and the options.

        Raises
        ------
        InputError : it cannot be read; every time it is asked for.
        """
        key = name, function, tuple(options.items())
        if key not in self._read:
            try:
                self._read[key] = function(self.folder / name, **options)
            except InputError as error:
                self._read[key] = error
        content: T = self._read[key]
        if isinstance(content, InputError):
            raise content
        return content

    @property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of what has been read."""
        read = self._read.items()
        return {k: v.sha256 for (k, *_), v in read if not isinstance(v, InputError)}


def read_texts(reader: TableReader, key: str, roles: Sequence[str]) -> Mapping[str, str] | None:
    """Return a table of texts by role, such as ``columns`` and ``units``; None, and a fault."""
    table = reader.raw(key, {})
    wrong = not isinstance(table, Mapping) or set(table) - set(roles)
    if wrong or not all(isinstance(entry, str) for entry in table.values()):
        *most, last = roles
        reader.wrong(key, f"must be a table of texts, for {', '.join(most)} and {last}")
        return None
    texts: Mapping[str, str] = table
    return texts


def read_intervals(reader: TableReader, key: str, unit: str) -> list[tuple[float, float]]:
    """Return increasing pairs in a unit; none, and a fault, where there is something else."""
    value, pairs = in_unit_where_right(reader.raw(key, []), unit), pair(-math.inf).read
    try:
        return [*entries(value, pairs, 0)]
    except RejectedError:
        reader.wrong(key, f"must be a list of increasing pairs ({unit})")
        return []


def missing_column(table: Measurements, column: str, role: str) -> str:
    """Return the fault of a column that a table does not have, "" where it has."""
    if column in table.columns:
        return ""
    sentence = f"{table.name}: has no column {legible(column)} for {role}; must be one of "
    return Fault(sentence + legible(", ".join(table.columns), 200), code="not_found")


def unit_by_name(table: Measurements, column: str, base: str, hint: str = "") -> str | None:
    """Return the unit in the name of a column, or in the row below the names; None for none.

    Parameters
    ----------
    base : a unit of what the column should be of.
    hint : what else the user may do, for the message.

    Raises
    ------
    InputError : it is in a unit of something else.
    """
    try:
        return named_unit(table.label(column), base)
    except RejectedError as reason:
        sentence = f"{table.name}: the column {legible(column)} {reason}; must be in the unit of "
        raise InputError(Fault(f"{sentence}{UNITS[base]}{hint}", code="unit")) from reason


def no_unit(table: Measurements, column: str, unit: str, hint: str = "") -> Fault:
    """Return the fault of a column that names no unit, as this one would be, see above."""
    name, slash, written = column.rpartition(" / ")
    state = f"{legible(written)} is no unit" if slash else "no unit"
    advice = f"name it {legible(name or column)} / {unit}{hint}"
    return Fault(f"{table.name}: {legible(column)}: {state}; {advice}", code="unit")


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
