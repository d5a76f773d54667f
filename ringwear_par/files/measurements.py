"""Tables of measurements: text files as laboratories have them."""

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.errors import InputError, legible
from ringwear_par.files import table_text

#: most columns of a table: loggers have hundreds of channels, files with more are something else
MOST_COLUMNS = 1000
#: numbers whose digits are perhaps in groups of three
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?", re.ASCII)
_GROUPED_BY_POINTS = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d*)?", re.ASCII)
_GROUPED_BY_OTHERS = re.compile(
    r"[+-]?\d{1,3}(?:['\u2019 \u00a0\u202f]\d{3})+(?:[.,]\d*)?", re.ASCII
)


@dataclass(frozen=True)
class Measurements:
    """A table of measurements: columns by name, cells as texts."""

    #: of the file, as messages call it
    name: str
    #: names in the line of names
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...] = field(repr=False)
    #: (rows,) int, numbers of the lines
    lines: IntArray = field(repr=False)
    #: of the file
    sha256: str = ""
    #: of the columns, in the row below their names; () where there is none
    units: tuple[str, ...] = ()
    #: whether cells of the first column are names, perhaps numbers
    labelled: bool = False

    def label(self, name: str) -> str:
        """Return the name of a column with its unit, where that is in the row below."""
        unit = self.units[self.columns.index(name)] if self.units else ""
        bare = unit.strip("[]() ") if unit[:1] in ("[", "(") else unit
        return f"{name} [{bare}]" if bare not in ("", "-", "1", "hh:mm:ss") else name

    def column(self, place: int) -> "Measurements":
        """Return the table of one column, for names that several columns have."""
        rows = tuple((row[place],) for row in self.rows)
        units = self.units[place : place + 1]
        one = Measurements(self.name, (self.columns[place],), rows, self.lines, self.sha256, units)
        vars(one)["_decimals"] = self._decimals  # of all numbers of the table
        return one

    def without(self, texts: Sequence[str]) -> "Measurements":
        """Return the table with nothing in cells that are one of some texts."""
        if not texts:
            return self
        rows = (tuple("" if cell in texts else cell for cell in row) for row in self.rows)
        return replace(self, rows=tuple(rows))

    def cells(self, name: str) -> list[str]:
        """Return the cells of a column."""
        place = self.columns.index(name)
        return [row[place] for row in self.rows]

    def cell_place(self, name: str, row: int, count: int = 1) -> str:
        """Return the file, line, column and text of a cell, the first of so many, for messages."""
        cell = legible(self.cells(name)[row])
        more = and_more(count, "line")
        return f"{self.name}: line {self.lines[row]}: {legible(name)} = {cell}{more}"

    def filled(self, *names: str) -> BoolArray:
        """(rows,) bool, where none of some columns is empty."""
        rows = zip(*map(self.cells, names), strict=True)
        return np.array([table_text.EMPTY.isdisjoint(map(str.lower, row)) for row in rows], bool)

    def numbers(self, name: str, rows: BoolArray, hour: float | None = None) -> FloatArray:
        """Return the numbers of a column in some of the rows.

        Parameters
        ----------
        hour : in the column's unit, which may have stamps then, that count from the first of the
            table; or clock times, over midnight too: h:mm:ss, or h:min where the unit is h, or
            min:s where it is min.

        Raises
        ------
        InputError : cells that are none; the first is shown. Stamps that go back.
        """
        cells, values, wrong = self.cells(name), np.full(len(self.rows), np.nan), []
        clocks, stamps, grouped = [], [], []
        for i in np.flatnonzero(rows).tolist():
            written = cells[i]
            cell = written.replace(",", ".")
            if table_text.NUMBER.fullmatch(cell) and np.isfinite(float(cell)):
                values[i] = float(cell)
                if "," in written and _GROUPED.fullmatch(written):
                    grouped.append((i, True))
                elif "." in written and _GROUPED_BY_POINTS.fullmatch(written):
                    grouped.append((i, False))
            elif hour is not None and table_text.is_clock(written):
                try:
                    values[i] = table_text.clock_time(written, hour)
                except ValueError as error:
                    raise InputError(
                        f"{self.cell_place(name, i)}: may be h:min or min:s; must be h:mm:ss, or "
                        "in a column whose unit says it: h of h:min, min of min:s"
                    ) from error
                clocks.append(i)
            elif hour is not None and table_text.is_stamp(written):
                stamps.append(i)
            else:
                wrong.append(i)
        if stamps and hour is not None:
            values[rows] = hour / 3600.0 * self._stamps(name, rows)
            wrong = []
        if wrong:
            self._refuse(name, wrong, hour is not None)
        for i, by_commas in grouped:
            if line := self._decimals["." if by_commas else ","]:
                self._refuse_groups(name, i, line)
        if clocks and hour is not None:
            values[clocks] = table_text.across_midnight(values[clocks], 24.0 * hour)
        return values[rows]

    def _stamps(self, name: str, rows: BoolArray) -> FloatArray:
        """Return the seconds of stamps in some of the rows, from the first of the table."""
        cells, filled = self.cells(name), np.flatnonzero(self.filled(name))
        try:
            seconds = table_text.seconds_of([cells[i] for i in filled.tolist()])
        except table_text.StampError as error:
            raise InputError(f"{self.cell_place(name, int(filled[error.row]))}: {error}") from error
        self.refuse_fall(name, filled, seconds)
        values = np.full(len(self.rows), np.nan)
        values[filled] = seconds - seconds[0]
        return values[rows]

    def refuse_fall(self, name: str, rows: IntArray, times: FloatArray, more: str = "") -> None:
        """Refuse times of some rows of a column that go back; ``more`` ends the rule.

        Raises
        ------
        InputError : the first one that does.
        """
        back = np.flatnonzero(np.diff(times) < 0.0)
        if len(back):
            before, row = int(rows[back[0]]), int(rows[back[0] + 1])
            raise InputError(
                f"{self.cell_place(name, row, len(back))}: goes back, line {self.lines[before]} "
                f"has {legible(self.cells(name)[before])}; must not fall{more}"
            )

    def _refuse(self, name: str, wrong: list[int], in_time: bool) -> None:
        cell, hint = self.cells(name)[wrong[0]], ""
        patterns = (_GROUPED, _GROUPED_BY_POINTS, _GROUPED_BY_OTHERS)
        if any(pattern.fullmatch(cell) for pattern in patterns):
            hint = "; thousands must not be separated"
        elif table_text.is_limit(cell):
            hint = (
                "; of a limit, the number, and below or above in a column censored, which fits read"
            )
        raise InputError(
            f"{self.cell_place(name, wrong[0], len(wrong))}: must be a "
            f"number{' or a clock time (h:mm:ss)' if in_time else ''}, or empty{hint}"
        )

    def _refuse_groups(self, name: str, row: int, line: int) -> None:
        commas = "," in self.cells(name)[row]
        mark, usual = ("comma", "points") if commas else ("point", "commas")
        raise InputError(
            f"{self.cell_place(name, row)}: has a {mark} "
            f"where other numbers, as in line {line}, have decimal {usual}; must be without "
            "separators of thousands, or with the same decimal mark"
        )

    @cached_property
    def _decimals(self) -> dict[str, int]:
        """The first line with a decimal point, and with a decimal comma, of no group; or 0."""
        marks = {".": 0, ",": 0}
        numbered = zip(self.lines.tolist(), self.rows, strict=True)
        for line, cell in ((line, c) for line, row in numbered for c in row[self.labelled :]):
            for mark, grouped in ((".", _GROUPED_BY_POINTS), (",", _GROUPED)):
                if (
                    mark in cell
                    and not marks[mark]
                    and table_text.NUMBER.fullmatch(cell.replace(mark, "."))
                ):
                    marks[mark] = 0 if grouped.fullmatch(cell) else line
        return marks

    def perhaps_thousands(self) -> int | None:
        """Return the first row of a table of one column whose mark may separate thousands.

        That is a mark before three digits alone. None where other numbers of the whole table tell
        what the mark is, or nothing in the column speaks for thousands: they are all round, or its
        numbers are less far apart by them.
        """
        if any(self._decimals.values()):
            return None
        patterns, cells = (_GROUPED, _GROUPED_BY_POINTS), [cell for (cell,) in self.rows]
        grouped = [any(pattern.fullmatch(cell) for pattern in patterns) for cell in cells]
        decimals = [(c.replace(",", "."), c.replace(",", "").replace(".", "")) for c in cells]
        both = [
            (abs(float(decimal)), abs(float(whole if group else decimal)))
            for (decimal, whole), group in zip(decimals, grouped, strict=True)
            if table_text.NUMBER.fullmatch(decimal) and float(decimal) != 0.0
        ]
        if not any(grouped) or not both:
            return None
        round_ones = all(
            cell.endswith("00") for cell, group in zip(cells, grouped, strict=True) if group
        )
        as_decimals, as_thousands = (max(v) / min(v) for v in zip(*both, strict=True))
        return grouped.index(True) if round_ones or as_thousands < as_decimals else None

    def first_stamps(self, name: str, rows: BoolArray) -> BoolArray:
        """(rows,) bool, some rows without those whose stamp is that of the row before."""
        cells, first, before = self.cells(name), rows.copy(), ""
        for i in np.flatnonzero(rows).tolist():
            cell = cells[i]
            first[i] = cell != before or not table_text.is_stamp(cell)
            before = cell
        return first

    def begins_with_stamp(self, name: str) -> bool:
        """Tell whether the first filled cell of a column is a stamp or a clock time h:mm:ss."""
        cell = self.first_cell(name)
        return table_text.is_stamp(cell) or table_text.has_hours(cell)

    def first_cell(self, name: str) -> str:
        """Return the first filled cell of a column, "" for none."""
        return next((c for c in self.cells(name) if c.lower() not in table_text.EMPTY), "")

    def dates(self, name: str) -> set[str]:
        """Return the different dates of a column; none where it begins with something else."""
        if not table_text.is_date(self.first_cell(name)):
            return set()
        return {cell for cell in self.cells(name) if table_text.is_date(cell)}

    def joined(self, date: str, clock: str) -> "Measurements":
        """Return the table with the dates of a column in front of the times of day of another."""
        first, second = self.columns.index(date), self.columns.index(clock)
        both = self.filled(date, clock)
        rows = tuple(
            (*row[:second], f"{row[first]} {row[second]}", *row[second + 1 :]) if filled else row
            for row, filled in zip(self.rows, both.tolist(), strict=True)
        )
        return replace(self, rows=rows)


def unused_columns(names: Sequence[str]) -> str:
    """Return the sentence about columns of a table of which nothing is taken."""
    return f"columns not used: {legible(', '.join(names), 200)}"


def and_more(count: int, noun: str) -> str:
    """Return how many more have the fault of the one that is named, in brackets; "" for none."""
    return "" if count == 1 else f" (and {count - 1} more {noun}{'s' if count > 2 else ''})"


def read_measurements(
    path: Path, *, labelled: bool = False, skip: int | None = None, growing: bool = False
) -> Measurements:
    """Read a table from a file, see ``measurements_in``; of one that grows, its whole lines.

    Raises
    ------
    InputError : it cannot be read, or is no table.
    """
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error
    if growing and not content.startswith(table_text.UTF_16):
        content = content[: content.rfind(b"\n") + 1] or content
    return measurements_in(content, str(path), labelled=labelled, skip=skip)


def measurements_in(
    content: bytes, path: str, *, labelled: bool = False, skip: int | None = None
) -> Measurements:
    """Return a table: a line of names, then numbers; between them commas, semicolons or tabs.

    Above it there may be anything, and a row of units below the names. Decimal commas are read
    where semicolons, tabs or quotes are around them.

    Parameters
    ----------
    content : of a file.
    path : what messages call it.
    labelled : whether the first column has names of what the numbers behind them are of; several
        columns may have one name then.
    skip : lines at the beginning that are left out; None where a user cannot say so.

    Raises
    ------
    InputError : it is no such table.
    """
    table = table_text.table_in(
        table_text.decode(path, content), path, labelled=labelled, skip=skip or 0
    )
    columns, first = tuple(table.names), table.first
    if len(columns) > MOST_COLUMNS:
        raise InputError(
            f"{path}: line {first}: names {len(columns)} columns; must be at most {MOST_COLUMNS}"
        )
    if any(table_text.NUMBER.fullmatch(name.replace(",", ".")) for name in columns):
        hint = "" if skip is None else "; skip = 3 leaves out three lines above them"
        raise InputError(
            f"{path}: line {first}: {legible(', '.join(columns))}: must be the names of the "
            f"columns, not numbers{hint}"
        )
    if len(columns) == 1:
        raise InputError(
            f"{path}: line {first}: {legible(columns[0])}: is one column; must be two at least, "
            "with commas, semicolons or tabs between them"
        )
    faults = [
        f"{path}: line {first}: {legible(name)}: names two columns; must be one"
        for name, count in Counter(columns).items()
        if name and count > 1 and not labelled
    ]
    rows = table.rows
    wrong = [i for i, row in enumerate(rows) if len(row) < len(columns) or any(row[len(columns) :])]
    if wrong:
        count = len(rows[wrong[0]])
        hint = "; decimal commas need semicolons or tabs between columns"
        faults.append(
            f"{path}: line {table.lines[wrong[0]]}: has {count} values"
            f"{and_more(len(wrong), 'line')}; must have {len(columns)}, as "
            f"{f'line {first}' if table.preamble else 'the first line'}"
            f"{hint if table.delimiter == ',' and count > len(columns) else ''}"
        )
    if faults:
        raise InputError(*faults)
    cells = tuple(tuple(row[: len(columns)]) for row in rows)
    lines, sha256 = np.array(table.lines, dtype=int), hashlib.sha256(content).hexdigest()
    return Measurements(path, columns, cells, lines, sha256, tuple(table.units), labelled)
