"""Where the table is in a text file: its encoding, what is between its cells, its first line."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ringwear_par.errors import InputError
from ringwear_par.files.stamps import is_clock, is_date, is_stamp

#: read one way only, so that the time of long cells is linear in their length
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
#: cells that say that there is nothing, in small letters
EMPTY = frozenset({"", "nan", "n.a.", "na", "n/a", "#n/a", "-", "--", "---"})
#: what Excel writes above a table
_SEPARATOR = re.compile(r'"?sep=([,;\t])"?', re.IGNORECASE)
#: lines of equally many cells that say where a table is
_ALIKE = 5
#: a unit by its looks, perhaps in brackets: which one it is, and of what, is for who reads it
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
    """A table as texts.

    Parameters
    ----------
    delimiter : between its cells.
    names, units : cells of the line of names, and of that of units below it; () for none.
    rows : cells of the other lines.
    first : number of the line of names; lines : of the rows.
    preamble : whether there is anything above the line of names.
    """

    delimiter: str
    names: list[str]
    units: list[str]
    rows: list[list[str]]
    first: int
    lines: list[int]
    preamble: bool


def decode(path: str, content: bytes) -> str:
    """Return the text of a file in UTF-8, in UTF-16 with its mark, or as older Windows writes.

    Raises
    ------
    InputError : it is no text.
    """
    marked = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252", "latin-1"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise InputError(f"{path}: is not a text file")


def table_in(text: str, path: str, *, labelled: bool = False) -> TableText:
    """Return the table of a text.

    It begins at the line of names above the first lines that have equally many cells and begin
    with a number or a stamp. Lines that begin with # and empty ones are skipped; so is ``sep=;``,
    which says what is between cells.

    Parameters
    ----------
    path : what messages call the file.
    labelled : whether lines begin with a name, and numbers follow it.

    Raises
    ------
    InputError : there is none.
    """
    numbered = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip(" \t,;") and not line.lstrip().startswith("#")
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
        if not (any(map(_is_value, cells)) or _is_row(cells, labelled)):
            return row
        row -= 1
    return None


def _is_row(cells: Sequence[str], labelled: bool) -> bool:
    """Tell whether cells are those of a row: a number or a stamp is the first, or none is."""
    if labelled:
        return any(map(_is_value, cells[1:])) and all(
            _is_value(cell) or cell.lower() in EMPTY for cell in cells[1:]
        )
    if cells[0].lower() in EMPTY:
        return any(map(_is_value, cells)) or all(cell.lower() in EMPTY for cell in cells)
    return _is_value(cells[0]) or is_date(cells[0])


def _is_value(cell: str) -> bool:
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
