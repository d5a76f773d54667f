"""Tables for spreadsheets: one in a CSV file, several as the sheets of an XLSX file."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from ringwear_par.errors import InputError, legible
from ringwear_par.files.writing import atomic_write

#: most rows of a sheet, that of names among them
MOST_ROWS = 1_048_576
#: longest text of a cell
_LONGEST = 32_767


@dataclass(frozen=True)
class Sheet:
    """A table."""

    name: str
    header: Sequence[str]
    rows: Iterable[Sequence[Any]]
    #: of the rows
    count: int


def write_csv(output: Path, sheet: Sheet, decimal: str = "point") -> None:
    """Write a table by rename; numbers keep all their digits, there is nothing where one is NaN.

    Parameters
    ----------
    decimal : "point", or "comma", where semicolons are between the columns.
    """
    comma = decimal == "comma"
    with (
        atomic_write(output) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file, delimiter=";" if comma else ",", lineterminator="\n")
        writer.writerow(sheet.header)
        for row in sheet.rows:
            writer.writerow([_text(v, comma) if isinstance(v, float) else v for v in row])


def _text(number: float, comma: bool) -> str:
    text = "" if number != number else repr(number)
    return text.replace(".", ",") if comma else text


def check_xlsx(output: Path) -> None:
    """Refuse an XLSX file where nothing can write it.

    Raises
    ------
    InputError : openpyxl is not installed.
    """
    try:
        import openpyxl  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"{output}: .xlsx needs the Python package openpyxl; pip install "
            "'ringwear-par[xlsx]', or write a .csv"
        ) from error


def write_xlsx(output: Path, sheets: Sequence[Sheet]) -> str:
    """Write tables as sheets by rename; return their names, and which are too long for one."""
    from openpyxl import Workbook
    from openpyxl.cell import WriteOnlyCell

    written = [sheet for sheet in sheets if sheet.count < MOST_ROWS]
    book = Workbook(write_only=True)
    for sheet in written:
        page = book.create_sheet(sheet.name)
        page.freeze_panes = "A2"

        def cell(value: Any) -> Any:
            if not isinstance(value, str):
                return None if value != value else value
            text = WriteOnlyCell(page, legible(value, _LONGEST))  # noqa: B023
            text.data_type = "s"  # "=" begins no formula
            return text

        for row in chain([sheet.header], sheet.rows):
            page.append([cell(value) for value in row])
    with atomic_write(output) as temporary:
        book.save(temporary)
    names = f"sheets {', '.join(sheet.name for sheet in written)}"
    long = [f"{s.name} ({s.count} rows)" for s in sheets if s.count >= MOST_ROWS]
    return f"{names}; without {', '.join(long)}: a sheet has {MOST_ROWS} rows" if long else names
