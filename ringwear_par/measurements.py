"""Tables of measurements: text files as laboratories have them."""

import csv
import hashlib
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.errors import InputError, legible

#: faults of a table told one by one
_FAULTS_TOLD = 5
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
#: cells that say that there is nothing
_EMPTY = frozenset({"", "nan"})


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

    def numbers(self, name: str, rows: BoolArray) -> FloatArray:
        """Return the numbers of a column in some of the rows.

        Raises
        ------
        InputError : the first cells that are none.
        """
        place = self.columns.index(name)
        values, faults = np.full(len(self.rows), np.nan), []
        for i in np.flatnonzero(rows).tolist():
            cell = self.rows[i][place].replace(",", ".")
            if _NUMBER.fullmatch(cell) and np.isfinite(float(cell)):
                values[i] = float(cell)
            else:
                faults.append(
                    f"{self.name}: line {self.lines[i]}: {legible(name)} = "
                    f"{legible(self.rows[i][place])}: must be a number, or empty"
                )
        if faults:
            raise InputError(*faults[:_FAULTS_TOLD])
        return values[rows]


def read_measurements(path: Path) -> Measurements:
    """Read a table: a line of names, then numbers; between them commas, semicolons or tabs.

    Lines that begin with # and empty ones are skipped. Decimal commas are read where semicolons,
    tabs or quotes are around them. Not collective.

    Raises
    ------
    InputError : it cannot be read, or is no such table.
    """
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error
    numbered = [
        (number, line)
        for number, line in enumerate(_text(path, content).splitlines(), start=1)
        if line.strip(" \t,;") and not line.lstrip().startswith("#")
    ]
    if not numbered:
        raise InputError(f"{path}: is empty; must be a line of column names, and lines of numbers")
    delimiter = next((c for c in "\t;" if c in numbered[0][1]), ",")
    try:
        cells = list(csv.reader((line for _, line in numbered), delimiter=delimiter))
    except csv.Error as error:
        raise InputError(f"{path}: is not a table: {error}") from error
    lines = np.array([number for number, _ in numbered])
    if len(cells) != len(lines):
        raise InputError(f"{path}: a quoted cell goes on over several lines; must be on one")
    columns = tuple(cell.strip() for cell in cells[0])
    if any(_NUMBER.fullmatch(name.replace(",", ".")) for name in columns):
        raise InputError(
            f"{path}: line {lines[0]}: {legible(', '.join(columns))}: must be the names of the "
            "columns, not numbers"
        )
    faults = [
        f"{path}: line {lines[0]}: {legible(name)}: names two columns; must be one"
        for name in dict.fromkeys(columns)
        if name and columns.count(name) > 1
    ]
    rows = []
    for line, row in zip(lines[1:].tolist(), cells[1:], strict=True):
        stripped = tuple(cell.strip() for cell in row)
        if len(stripped) < len(columns) or any(stripped[len(columns) :]):
            hint = "; decimal commas need semicolons or tabs between columns"
            faults.append(
                f"{path}: line {line}: has {len(row)} values; must have {len(columns)}, as the "
                f"first line{hint if delimiter == ',' and len(row) > len(columns) else ''}"
            )
        rows.append(stripped[: len(columns)])
    if faults:
        raise InputError(*faults[:_FAULTS_TOLD])
    return Measurements(
        str(path), columns, tuple(rows), lines[1:], hashlib.sha256(content).hexdigest()
    )


def _text(path: Path, content: bytes) -> str:
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
