"""``ringwear export``: the numbers of runs, sweeps, fits and measurements for spreadsheets."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.errors import InputError
from ringwear_par.files.folders import FIT, MEASURE, READINGS
from ringwear_par.files.spreadsheets import Table, check_xlsx, write_csv, write_xlsx
from ringwear_par.files.writing import check_writable
from ringwear_par.identification.summary import key_rows
from ringwear_par.measuring.measure_numbers import table_of
from ringwear_par.reports.fit_page import stored_outcome, stored_readings
from ringwear_par.results.export import export as export_run
from ringwear_par.results.export import titled
from ringwear_par.results.variables import HISTORIES
from ringwear_par.studies.ensemble import (
    RESULTS,
    Ensemble,
    end_value_of,
    read_ensemble,
)
from ringwear_par.studies.variations import own_key

_TABLES = (".csv", ".xlsx")


def export(run: Path, output: Path) -> str:
    """Write a run or a folder of results in another format; return what was written.

    On one rank. A .csv has the histories of a run, the cases of a sweep or the tests of a fit or a
    measurement; an .xlsx has all tables.

    Raises
    ------
    InputError : what cannot be read or written, or a package that is missing.
    """
    if not run.is_dir():
        return export_run(run, output)
    if output.suffix not in _TABLES:
        raise InputError(f"{output}: its ending must be {' or '.join(_TABLES)} of a folder")
    check_writable(output)
    if output.suffix == ".xlsx":
        check_xlsx(output)
    sheets = _sheets(run)
    if output.suffix == ".xlsx":
        return f"{output}: {write_xlsx(output, sheets)}"
    write_csv(output, sheets[0])
    return f"{output}: {sheets[0][0]}"


def _sheets(folder: Path) -> list[Table]:
    """Return the tables of a folder, the one for a .csv first."""
    if (folder / FIT).exists():
        return fit_sheets(folder)
    if (folder / RESULTS).exists():
        return sweep_sheets(read_ensemble(folder))
    if (folder / MEASURE).exists():
        with stored_outcome(folder / MEASURE, "the outcome of ringwear measure") as outcome:
            header, rows = table_of(outcome)
        return [("tests", header, rows)]
    raise InputError(
        f"{folder}: holds none of {FIT}, {RESULTS} and {MEASURE}; must be a result file, or a "
        "folder that ringwear sweep, fit or measure has completed"
    )


def sweep_sheets(ensemble: Ensemble) -> list[Table]:
    """Return the cases of a sweep, the meanings of their columns, and all histories."""
    columns: dict[str, tuple[str, str, Any]] = {"case": ("", "id of the case", ensemble.ids)}
    for name, values in ensemble.varied.items():
        columns[name] = ensemble.units[name], own_key(name).meaning, values
    columns["status"] = "", "done or failed", ensemble.status
    columns["error"] = "", "why the case failed", ensemble.error
    for name, values in ensemble.final.items():
        variable = end_value_of(name)[1]
        columns[name] = variable.unit, variable.meaning, values
    columns["seconds"] = "s", "wall time of the case", ensemble.seconds
    flags = ensemble.flags
    columns["flags"] = "", "what makes the answer doubtful or ended the case early", flags
    header = [f"{name} ({unit})" if unit not in ("", "1") else name
              for name, (unit, _, _) in columns.items()]  # fmt: skip
    rows = zip(
        *(v.tolist() if isinstance(v, np.ndarray) else v for _, _, v in columns.values()),
        strict=True,
    )
    meanings = [(name, unit, meaning) for name, (unit, meaning, _) in columns.items()]
    histories = ("case", "state", *(titled(v.name, v.unit) for v in HISTORIES.values()))
    return [
        ("cases", header, rows),
        ("columns", ("column", "unit", "meaning"), meanings),
        ("histories", histories, _states(ensemble)),
    ]


def _states(ensemble: Ensemble) -> Iterator[Sequence[Any]]:
    """Yield the histories of all cases, a row a stored state."""
    every = np.arange(len(ensemble.ids))
    tables = [ensemble.histories(name, every) for name in HISTORIES]
    for case, (identity, count) in enumerate(zip(ensemble.ids, ensemble.steps_stored, strict=True)):
        for state in range(int(count)):
            yield (identity, state, *(float(table[case, state]) for table in tables))


def fit_sheets(folder: Path) -> list[Table]:
    """Return the fitted keys of a fit's folder, and all readings.

    Raises
    ------
    InputError : it is damaged.
    """
    with stored_outcome(folder / FIT, "the outcome of ringwear fit") as outcome:
        rows = [row for key, entry in outcome["parameters"].items() for row in key_rows(key, entry)]
        series = stored_readings(folder / READINGS, float(outcome["level"]))[0]
    header = ("key", "estimate", "sd", "from", "to", "unit", "verdict", "note")
    readings = [
        (curve.experiment, curve.name, *map(float, values), curve.unit)
        for curve in series
        for values in zip(
            curve.x, curve.data, curve.sd, curve.model, curve.band, curve.residuals, strict=True
        )
    ]
    columns = ("test", "series", "time (s) or r (mm)", "data", "sd", "model", "sd of model",
               "residual over noise", "unit")  # fmt: skip
    return [("parameters", header, rows), ("readings", columns, readings)]
