"""Tables for spreadsheets: one in a CSV file, several as the sheets of an XLSX file."""

import csv
from collections.abc import Iterable, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

from ringwear_par.errors import InputError, legible
from ringwear_par.files.writing import atomic_write

#: most rows of a sheet below that of names, and longest text of a cell
_MOST_ROWS, _LONGEST = 1_048_575, 32_767
#: name, names of the columns, and rows
Table = tuple[str, Sequence[str], Iterable[Sequence[Any]]]


def write_csv(output: Path, table: Table) -> None:
    """Write a table by rename; numbers keep all their digits, there is nothing where one is NaN."""
    _, header, rows = table
    with atomic_write(output) as temporary, temporary.open("w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        writer.writerow(header)
        for row in rows:
            writer.writerow("" if value != value else value for value in row)


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


def write_xlsx(output: Path, tables: Sequence[Table]) -> str:
    """Write tables as sheets by rename; return their names, and which were cut."""
    from openpyxl import Workbook
    from openpyxl.cell import WriteOnlyCell

    book, names = Workbook(write_only=True), []
    for name, header, rows in tables:
        page, left = book.create_sheet(name), iter(rows)
        page.freeze_panes = "A2"
        for row in chain([header], islice(left, _MOST_ROWS)):
            cells = [None if value != value else value for value in row]
            for i, text in enumerate(cells):
                if isinstance(text, str):
                    cells[i] = cell = WriteOnlyCell(page, legible(text, _LONGEST))
                    cell.data_type = "s"  # "=" begins no formula
            page.append(cells)
        cut = next(left, None) is not None
        names.append(f"{name} (its first {_MOST_ROWS} rows)" if cut else name)
    with atomic_write(output) as temporary:
        book.save(temporary)
    return f"sheets {', '.join(names)}"
