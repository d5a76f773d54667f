"""Tables of loggers as texts: stamps and clock times, and where in a file the table is.

Its encoding, what is between its cells, its first line.
"""

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError

#: ISO, day first with dots, and slashes whose order the whole column tells
_DATE = (
    r"(?:(?P<iso>\d{4}-\d\d?-\d\d?)|(?P<dots>\d\d?\.\d\d?\.(?:\d{4}|\d\d))|"
    r"(?P<slashes>\d\d?/\d\d?/\d{4}))"
)
_STAMP = re.compile(
    rf"{_DATE}"
    r"(?:[T ]|,? +)(?P<h>\d\d?):(?P<min>[0-5]\d)(?::(?P<s>[0-5]\d(?:[.,]\d*)?))?"
    r" ?(?:(?P<half>[AaPp])[Mm]|Z|(?P<zone>[+-]\d\d:?\d\d))?",
    re.ASCII,
)
_DATE_ALONE = re.compile(_DATE, re.ASCII)
#: h:mm:ss, or two of them
_CLOCK = re.compile(r"(?:(\d+):(?=[0-5]\d:))?(\d+):([0-5]\d(?:[.,]\d*)?)", re.ASCII)
#: marks at the beginning of files in UTF-16
UTF_16 = b"\xff\xfe", b"\xfe\xff"
_DAY, _HOUR, _MONTHS, _NOON = 86400.0, 3600.0, 12, 12
#: century of years of two digits
_CENTURY = 2000


class StampError(ValueError):
    """A cell that is no stamp of its column; ``row`` says which."""

    def __init__(self, row: int, rule: str) -> None:
        super().__init__(rule)
        self.row = row


def is_stamp(cell: str) -> bool:
    """Tell whether a cell looks like a date with a time of day."""
    return _STAMP.fullmatch(cell) is not None


def is_date(cell: str) -> bool:
    """Tell whether a cell is a date without a time of day."""
    return _DATE_ALONE.fullmatch(cell) is not None


def ambiguous_date(cells: Sequence[str]) -> str:
    """Return a date of different ones that may be read day first or month first, "" for none."""
    matches = (_STAMP.match(cell) for cell in cells)
    dates = dict.fromkeys(match["slashes"] for match in matches if match and match["slashes"])
    certain = any(int(part) > _MONTHS for date in dates for part in date.split("/")[:2])
    return "" if certain or len(dates) < 2 else next(iter(dates))


def is_clock(cell: str) -> bool:
    """Tell whether a cell is a clock time, h:mm:ss, or h:min or min:s."""
    return _CLOCK.fullmatch(cell) is not None


def has_hours(cell: str) -> bool:
    """Tell whether a cell is a clock time of three parts, h:mm:ss."""
    clock = _CLOCK.fullmatch(cell)
    return clock is not None and clock[1] is not None


def clock_time(cell: str, hour: float) -> float:
    """Return a clock time in the unit of which an hour is ``hour``.

    Of two parts the first is in this unit: h:min or min:s.

    Raises
    ------
    ValueError : it is none, or of two parts in another unit.
    """
    clock = _CLOCK.fullmatch(cell)
    if clock is None:
        raise ValueError(f"{cell} is no clock time")
    hours, minutes = float(clock[1] or 0), float(clock[2])
    seconds = float(clock[3].replace(",", "."))
    if clock[1] is None and math.isclose(hour, 1.0):
        hours, minutes, seconds = minutes, seconds, 0.0
    elif clock[1] is None and not math.isclose(hour, 60.0):
        raise ValueError(f"{cell} may be h:min or min:s")
    return hour * (hours + minutes / 60.0 + seconds / 3600.0)


def across_midnight(times: FloatArray, day: float) -> FloatArray:
    """Return times of day with a day added at each midnight: where they fall by half a day.

    Parameters
    ----------
    times : (n,) in order; those of more than a day are no times of day, and stay.
    day : in their unit.
    """
    if len(times) == 0 or times.max() >= day:
        return times
    return times + day * np.concatenate([[0], np.cumsum(np.diff(times) < -0.5 * day)])


def seconds_of(cells: Sequence[str]) -> FloatArray:
    """Return the seconds of stamps, counted from an arbitrary day, (n,) float.

    The day is first in dates with slashes, unless one above 12 in the second place says that the
    month is.

    Raises
    ------
    StampError : one is no stamp.
    """
    matches = []
    for row, cell in enumerate(cells):
        match = _STAMP.fullmatch(cell)
        if match is None:
            raise StampError(row, "must be a date with a time, as the lines above")
        matches.append(match)
    month_first = any(
        int(match["slashes"].split("/")[1]) > _MONTHS for match in matches if match["slashes"]
    )
    days: dict[str, int] = {}
    seconds = np.empty(len(matches))
    for row, match in enumerate(matches):
        text = match["iso"] or match["dots"] or match["slashes"]
        if text not in days:
            days[text] = _day_number(text, month_first, row)
        seconds[row] = _DAY * days[text] + _time_of_day(match, row)
    return seconds


def _day_number(text: str, month_first: bool, row: int) -> int:
    first, second, third = (int(part) for part in re.split(r"[-./]", text))
    year, month, day = third, second, first
    if "-" in text:
        year, month, day = first, second, third
    elif "/" in text and month_first:
        month, day = first, second
    try:
        return date(year if year >= 100 else _CENTURY + year, month, day).toordinal()
    except ValueError as error:
        order = "; the month is first here" if "/" in text and month_first else ""
        raise StampError(row, f"there is no such day{order}; 2026-03-14 08:15:00 is") from error


def _time_of_day(match: re.Match[str], row: int) -> float:
    hours = int(match["h"])
    if match["half"]:
        if hours > _NOON:
            raise StampError(row, "there is no such hour; AM and PM are of hours up to 12")
        hours = hours % _NOON + (_NOON if match["half"] in "Pp" else 0)
    seconds = float((match["s"] or "0").replace(",", "."))
    if hours + int(match["min"]) / 60.0 + seconds / _HOUR > 24.0:
        raise StampError(row, "there is no such hour; must be from 0:00 to 24:00")
    zone = (match["zone"] or "").replace(":", "")
    offset = int(f"{zone[0]}1") * (60 * int(zone[1:3]) + int(zone[3:])) if zone else 0
    return _HOUR * hours + 60.0 * (int(match["min"]) - offset) + seconds


#: read one way only, so that the time of long cells is linear in their length
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
#: cells that say that there is nothing, in small letters
EMPTY = frozenset({"", "nan", "n.a.", "na", "n/a", "#n/a", "-", "--", "---"})
#: what Excel writes above a table
_SEPARATOR = re.compile(r'"?sep=([,;\t])"?', re.IGNORECASE)
#: number of successive lines with equally many cells that show where a table is
_ALIKE = 5
#: what looks like a unit, perhaps in brackets; the reader of the table decides which one it is, and
#: of what
_ATOM = (
    r"(?:[munkcM\N{MICRO SIGN}\N{GREEK SMALL LETTER MU}]?(?:m|s|N|g|Pa|Hz|V|A|W|J|bar)|sec|min|h|d|"
    r"hh:mm:ss|in|inch|ft|lbf|psi|\N{DEGREE SIGN}?[CFK]|deg[CF]?|rpm|U|rev|rad|1|%)"
    r"(?:\^?-?[1-3])?"
)
_UNIT = re.compile(
    rf"[\[(]?(?:-|{_ATOM}(?:[ */\N{{MIDDLE DOT}}]{{1,3}}\(?{_ATOM}\)?|{_ATOM}){{0,3}})[\])]?"
)


@dataclass(frozen=True)
class TableText:
    """A table as texts."""

    #: between its cells
    delimiter: str
    #: cells of the line of names, and of that of units below it; () for none
    names: list[str]
    units: list[str]
    #: cells of the other lines
    rows: list[list[str]]
    #: number of the line of names
    first: int
    #: of the rows
    lines: list[int]
    #: whether there is anything above the line of names
    preamble: bool


def decode(path: str, content: bytes) -> str:
    """Return the text of a file in UTF-8, in UTF-16 with its mark, or as older Windows writes.

    Raises
    ------
    InputError : it is no text.
    """
    marked = content.startswith(UTF_16)
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252", "latin-1"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    excel = content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0"))
    hint = "; is it a workbook? its sheet must be saved as CSV" if excel else ""
    raise InputError(f"{path}: is not a text file{hint}")


def table_in(text: str, path: str, *, labelled: bool = False, skip: int = 0) -> TableText:
    """Return the table of a text.

    It begins at the line of names above the first lines that have equally many cells and begin
    with a number or a stamp. Lines that begin with # and empty ones are skipped; so is ``sep=;``,
    which says what is between cells.

    Parameters
    ----------
    path : what messages call the file.
    labelled : whether lines begin with a name, and numbers are among what follows it.
    skip : lines at the beginning that are left out.

    Raises
    ------
    InputError : there is none.
    """
    numbered = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if number > skip and line.strip(" \t,;") and not line.lstrip().startswith("#")
    ]
    separator = _SEPARATOR.fullmatch(numbered[0][1].strip(" ")) if numbered else None
    if separator is not None:
        del numbered[0]
    if not numbered:
        raise InputError(f"{path}: is empty; must be a line of column names, and lines of numbers")
    content = [line for _, line in numbered]
    delimiters = "\t;," if separator is None else separator[1]
    delimiter, names, start = _start(content, delimiters, labelled)
    try:
        cells = [
            [cell.strip() for cell in row]
            for row in csv.reader(content[names:], delimiter=delimiter)
        ]
    except csv.Error as error:
        raise InputError(f"{path}: is not a table: {error}") from error
    if len(cells) != len(content) - names:
        raise InputError(f"{path}: a quoted cell goes on over several lines; must be on one")
    return TableText(
        delimiter, cells[0], cells[1] if start - names > 1 else [], cells[start - names :],
        numbered[names][0], [number for number, _ in numbered[start:]], names > 0,
    )  # fmt: skip


def _start(lines: Sequence[str], delimiters: str, labelled: bool) -> tuple[str, int, int]:
    """Return the delimiter, the place of the line of names, and that of the first row."""
    loose: tuple[str, int, int] | None = None
    for delimiter in delimiters:
        row = _first_row(lines, delimiter, labelled)
        if row is None:
            continue
        first = _cells(lines[row], delimiter)
        names = row - 1
        if names and _is_row_of_units(*(_cells(lines[i], delimiter) for i in (names - 1, names))):
            names -= 1
        width = len(_cells(lines[names], delimiter))
        if 1 < width <= len(first) and not any(first[width:]):
            return delimiter, names, row
        if loose is None and width > 1:
            loose = delimiter, names, row
    if loose is not None:
        return loose
    delimiter = (
        next((c for c in "\t;" if c in lines[0]), ",") if len(delimiters) > 1 else delimiters
    )
    return delimiter, 0, 1


def _first_row(lines: Sequence[str], delimiter: str, labelled: bool) -> int | None:
    """Return the place of the first row of numbers, None where there are none below a line."""
    width, alike, longest, row = 0, 0, 0, 0
    for i, line in enumerate(lines):
        cells = _cells(line, delimiter)
        count = len(cells) if len(cells) > 1 and _is_row(cells, labelled) else 0
        alike = alike + 1 if count and count == width else min(count, 1)
        width = count
        if alike > longest:
            longest, row = alike, i - alike + 1
        if longest == _ALIKE:
            break
    return _above(lines, row, delimiter, labelled) if longest else None


def _above(lines: Sequence[str], row: int, delimiter: str, labelled: bool) -> int | None:
    """Return the first of the rows above one, broken ones too: names are lines without numbers."""
    while row > 0:
        cells = _cells(lines[row - 1], delimiter)
        if not (any(map(is_value, cells)) or _is_row(cells, labelled)):
            return row
        row -= 1
    return None


def _is_row(cells: Sequence[str], labelled: bool) -> bool:
    """Tell whether cells are those of a row: a number or a stamp is the first, or none is."""
    if labelled:
        return any(map(is_value, cells[1:]))
    if cells[0].lower() in EMPTY:
        return any(map(is_value, cells)) or all(cell.lower() in EMPTY for cell in cells)
    return is_value(cells[0]) or is_date(cells[0])


def is_limit(cell: str) -> bool:
    """Tell whether a cell is a number with a sign that makes it a limit: "<15"."""
    number = cell[1:].strip("= ").replace(",", ".")
    return cell[:1] in tuple("<>\u2264\u2265") and NUMBER.fullmatch(number) is not None


def is_value(cell: str) -> bool:
    """Tell whether a cell is a number, a stamp or a clock time."""
    number = NUMBER.fullmatch(cell.replace(",", "."))
    return number is not None or is_stamp(cell) or is_clock(cell)


def _is_row_of_units(names: Sequence[str], cells: Sequence[str]) -> bool:
    """Tell whether cells are the units of the names above them."""

    def units(row: Sequence[str]) -> bool:
        return all(not cell or _UNIT.fullmatch(cell) for cell in row) and any(row)

    return len(names) == len(cells) and units(cells) and not units(names)


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:
        return []
