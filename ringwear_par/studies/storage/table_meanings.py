"""What the columns of the table of a sweep mean, for the file beside it."""

import json
from collections.abc import Sequence
from typing import Any

import h5py
import numpy as np

from ringwear_par.cases.schema import unit_of
from ringwear_par.results.variables import POINT_R, POINT_SIDE, POINT_Z
from ringwear_par.studies.definition.variations import own_key
from ringwear_par.studies.storage.case_variables import WINDOW
from ringwear_par.studies.storage.end_values import entry_of
from ringwear_par.studies.storage.results_file import OF_CASES, TABLE
from ringwear_par.studies.storage.stored_variables import axis_of, told_entry

#: of the table, before and after the last values
BEFORE, AFTER = ("status", "error"), ("seconds", "in_study", "version", "flags")


def table_meanings(names: Sequence[str], finals: Sequence[str], file: h5py.File) -> str:
    """Return units and meanings of the table's columns (W3C, Metadata for Tabular Data).

    Parameters
    ----------
    names : varied keys.
    finals : columns of last values.
    file : the results, with what cases have over steps.
    """
    columns = [{"titles": "case", "dc:description": "id of the case, of its content"}]
    for name in names:
        columns.append(_column(name, own_key(name).meaning, unit_of(name)))
    for name in BEFORE:
        columns.append(_column(name, OF_CASES[name].meaning, OF_CASES[name].unit))
    places = _places(file)
    for name in finals:
        final, entry = entry_of(name)
        meaning = final.stored.meaning
        if entry:
            meaning += f"; {told_entry(final.stored, entry)}"
        if axis_of(final.stored) == "point":
            meaning += places[int(entry)]
        columns.append(_column(name, meaning, final.stored.unit))
    for name in AFTER:
        columns.append(_column(name, OF_CASES[name].meaning, OF_CASES[name].unit))
    table = {
        "@context": ["http://www.w3.org/ns/csvw", {"@language": "en"}],
        "url": TABLE,
        "tableSchema": {"columns": columns},
    }
    return json.dumps(table, indent=1) + "\n"


def _column(name: str, meaning: str, unit: str) -> dict[str, str]:
    told = {} if unit in ("", "1") else {"schema:unitText": unit}
    return {"titles": name, "dc:description": meaning, **told}


def _places(file: h5py.File) -> list[str]:
    """Return where each point is, in words; "" of one that is not in the same place in all."""
    if POINT_R.name not in file:
        return []
    r, z = (_same(file, name, np.nan) for name in (POINT_R.name, POINT_Z.name))
    sides = _same(file, POINT_SIDE.name, b"") if POINT_SIDE.name in file else [None] * len(r)
    return [
        "" if at is None or height is None
        else f" at r = {at:.9g} mm, z = {height:.9g} mm" + (f", {side.decode()}" if side else "")
        for at, height, side in zip(r, z, sides, strict=True)
    ]  # fmt: skip


def _same(file: h5py.File, name: str, unknown: Any) -> list[Any]:
    """Return what each point has in all cases that tell it; None where cases differ."""
    table = file[name]
    found: list[set[Any]] = [set() for _ in range(table.shape[1])]
    for start in range(0, len(table), WINDOW):
        for values, column in zip(found, table[start : start + WINDOW].T, strict=True):
            there = ~np.isnan(column) if unknown is np.nan else column != unknown
            values.update(np.unique(column[there]).tolist())
    return [values.pop() if len(values) == 1 else None for values in found]
