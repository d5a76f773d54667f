"""The folder of a measurement: its numbers, a table of them, the figure of records."""

import csv
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ringwear_par.files.folders import (
    MEASURE,
    MEASURED_ROWS,
    RECORDS,
    json_bytes,
    write_outcome,
)
from ringwear_par.measuring.measure_numbers import QUANTITIES
from ringwear_par.measuring.measure_result import MeasureResult
from ringwear_par.pictures.style import picture

FILES = (MEASURE, MEASURED_ROWS, RECORDS)


def save(result: MeasureResult, folder: Path) -> None:
    """Write all files, see ``write_outcome``."""
    contents: dict[str, Callable[[], bytes | None]] = {
        RECORDS: lambda: picture(result.plot, str(folder / RECORDS)),
        MEASURED_ROWS: lambda: table(result).encode(),
        MEASURE: lambda: json_bytes(result.to_dict()),
    }
    write_outcome(folder, "measure", contents)


def table(result: MeasureResult) -> str:
    """Return the contents of measure.csv: a row a test; empty cells for what was not measured."""
    text = io.StringIO()
    header, rows = table_of(result.to_dict())
    digits = [
        ["" if v is None else f"{v:.6g}" if isinstance(v, float) else v for v in row]
        for row in rows
    ]
    csv.writer(text, lineterminator="\n").writerows([header, *digits])
    return text.getvalue()


def table_of(outcome: Mapping[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Return names of columns and rows of tests; None for what was not measured.

    Parameters
    ----------
    outcome : the contents of measure.json.
    """
    columns = [
        (q, part) for q in QUANTITIES for part in (("value", "u") if q.measured else ("value",))
    ]
    header = [f"{'u of ' * (part == 'u')}{q.name} / {q.unit}" for q, part in columns]
    rows = []
    for name, entry in outcome["tests"].items():
        numbers = [quantity.of(entry, part) for quantity, part in columns]
        codes = " ".join(doubt["code"] for doubt in entry["doubts"])
        rows.append([name, "yes" if entry["steady"] else "no", *numbers, codes])
    return ["test", "steady", *header, "doubts"], rows
