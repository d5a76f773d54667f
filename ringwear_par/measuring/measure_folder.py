"""The folder of a measurement: its numbers, a table of them, the figure of records."""

import csv
import io
from collections.abc import Callable
from pathlib import Path

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
    rows = csv.writer(text, lineterminator="\n")
    columns = [
        (q, part) for q in QUANTITIES for part in (("value", "u") if q.measured else ("value",))
    ]
    header = [f"{'u of ' * (part == 'u')}{q.name} / {q.unit}" for q, part in columns]
    rows.writerow(["test", "steady", *header, "doubts"])
    for name, entry in result.to_dict()["tests"].items():
        numbers = [quantity.of(entry, part) for quantity, part in columns]
        cells = ["" if number is None else f"{number:.6g}" for number in numbers]
        codes = " ".join(doubt["code"] for doubt in entry["doubts"])
        rows.writerow([name, "yes" if entry["steady"] else "no", *cells, codes])
    return text.getvalue()
