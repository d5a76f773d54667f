"""Tables of measurements: text files as laboratories have them."""

import csv
import hashlib
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.errors import InputError, legible
from ringwear_par.files.ordinary import read_bytes

#: read one way only, so that the time of long cells is linear in their length
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
#: h:mm:ss, or two of them
_CLOCK = re.compile(r"(?:(\d+):(?=[0-5]\d:))?(\d+):([0-5]\d(?:\.\d*)?)", re.ASCII)
#: what Excel writes above a table
_SEPARATOR = re.compile(r'"?sep=([,;\t])"?', re.IGNORECASE)
#: cells that say that there is nothing
_EMPTY = frozenset({"", "nan"})
#: columns of a table: loggers have hundreds of channels, files with more are something else
MOST_COLUMNS = 1000


@dataclass(frozen=True)
class Measurements:
    """A table of measurements: columns by name, cells as texts.

    Parameters
    ----------
    name : of the file, as messages call it.
    columns : names in the first line.
    lines : (rows,) int, numbers of the lines.
    sha256 : of the file.
    """

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...] = field(repr=False)
    lines: IntArray = field(repr=False)
    sha256: str = ""

    def filled(self, *names: str) -> BoolArray:
        """(rows,) bool, where none of some columns is empty."""
        places = [self.columns.index(name) for name in names]
        return np.array(
            [all(row[i].lower() not in _EMPTY for i in places) for row in self.rows], dtype=bool
        )

    def numbers(self, name: str, rows: BoolArray, hour: float | None = None) -> FloatArray:
        """Return the numbers of a column in some of the rows.

        Parameters
        ----------
        hour : in the column's unit, which may have clock times then: h:mm:ss, or min:s, or h:min
            where the unit is the hour.

        Raises
        ------
        InputError : cells that are none; the first is shown.
        """
        place = self.columns.index(name)
        values, wrong = np.full(len(self.rows), np.nan), []
        for i in np.flatnonzero(rows).tolist():
            cell = self.rows[i][place].replace(",", ".")
            if _NUMBER.fullmatch(cell) and np.isfinite(float(cell)):
                values[i] = float(cell)
            elif hour is not None and (clock := _CLOCK.fullmatch(cell)):
                values[i] = _clock_time(clock, hour)
            else:
                wrong.append(i)
        if wrong:
            raise InputError(
                f"{self.name}: line {self.lines[wrong[0]]}: {legible(name)} = "
                f"{legible(self.rows[wrong[0]][place])}{and_more(len(wrong), 'line')}: must be a "
                f"number{'' if hour is None else ' or a clock time (h:mm:ss)'}, or empty"
            )
        return values[rows]

    def names_seconds(self, name: str, rows: BoolArray) -> bool:
        """Tell whether a column has clock times with seconds in some of the rows, and no others."""
        place = self.columns.index(name)
        clocks = [_CLOCK.fullmatch(self.rows[i][place]) for i in np.flatnonzero(rows).tolist()]
        return all(clock is not None and clock[1] is not None for clock in clocks)


def _clock_time(clock: re.Match[str], hour: float) -> float:
    """Return a clock time in the unit of which an hour is ``hour``."""
    hours, minutes, seconds = float(clock[1] or 0), float(clock[2]), float(clock[3])
    if clock[1] is None and hour == 1.0:
        hours, minutes, seconds = minutes, seconds, 0.0
    return hour * (hours + minutes / 60.0 + seconds / 3600.0)


def and_more(count: int, noun: str) -> str:
    """Return how many have a fault beside the one that is told, in brackets; "" for none."""
    return "" if count == 1 else f" (and {count - 1} more {noun}{'s' if count > 2 else ''})"


def read_measurements(path: Path) -> Measurements:
    """Read a table from a file, see ``measurements_in``. Not collective.

    Raises
    ------
    InputError : it cannot be read, or is no table.
    """
    try:
        content = read_bytes(path)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error
    return measurements_in(content, str(path))


def measurements_in(content: bytes, path: str) -> Measurements:
    """Return a table: a line of names, then numbers; between them commas, semicolons or tabs.

    Lines that begin with # and empty ones are skipped; so is ``sep=;`` above the names, which says
    what is between them. Decimal commas are read where semicolons, tabs or quotes are around them.

    Parameters
    ----------
    content : of a file.
    path : what messages call it.

    Raises
    ------
    InputError : it is no such table.
    """
    numbered = [
        (number, line)
        for number, line in enumerate(_text(path, content).splitlines(), start=1)
        if line.strip(" \t,;") and not line.lstrip().startswith("#")
    ]
    separator = _SEPARATOR.fullmatch(numbered[0][1].strip(" ")) if numbered else None
    if separator is not None:
        del numbered[0]
    if not numbered:
        raise InputError(f"{path}: is empty; must be a line of column names, and lines of numbers")
    delimiter = next((c for c in "\t;" if c in numbered[0][1]), ",")
    if separator is not None:
        delimiter = separator[1]
    try:
        cells = list(csv.reader((line for _, line in numbered), delimiter=delimiter))
    except csv.Error as error:
        raise InputError(f"{path}: is not a table: {error}") from error
    lines = np.array([number for number, _ in numbered])
    if len(cells) != len(lines):
        raise InputError(f"{path}: a quoted cell goes on over several lines; must be on one")
    columns = tuple(cell.strip() for cell in cells[0])
    if len(columns) > MOST_COLUMNS:
        raise InputError(
            f"{path}: line {lines[0]}: names {len(columns)} columns; must be at most {MOST_COLUMNS}"
        )
    if any(_NUMBER.fullmatch(name.replace(",", ".")) for name in columns):
        raise InputError(
            f"{path}: line {lines[0]}: {legible(', '.join(columns))}: must be the names of the "
            "columns, not numbers"
        )
    faults = [
        f"{path}: line {lines[0]}: {legible(name)}: names two columns; must be one"
        for name, count in Counter(columns).items()
        if name and count > 1
    ]
    rows = [tuple(cell.strip() for cell in row) for row in cells[1:]]
    wrong = [i for i, row in enumerate(rows) if len(row) < len(columns) or any(row[len(columns) :])]
    if wrong:
        count = len(rows[wrong[0]])
        hint = "; decimal commas need semicolons or tabs between columns"
        faults.append(
            f"{path}: line {lines[1 + wrong[0]]}: has {count} values"
            f"{and_more(len(wrong), 'line')}; must have {len(columns)}, as the first line"
            f"{hint if delimiter == ',' and count > len(columns) else ''}"
        )
    if faults:
        raise InputError(*faults)
    rows = [row[: len(columns)] for row in rows]
    return Measurements(path, columns, tuple(rows), lines[1:], hashlib.sha256(content).hexdigest())


def _text(path: str, content: bytes) -> str:
    """Return the text of a file in UTF-8, in UTF-16 with its mark, or as older Windows writes."""
    marked = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise InputError(f"{path}: is not a text file")
