"""What the columns of the table of a sweep mean, for the file beside it."""

import json
from collections.abc import Sequence
from typing import Any

import h5py
import numpy as np

from ringwear_par.cases.schema import unit_of
from ringwear_par.results.stress_variables import POINT_R, POINTS
from ringwear_par.studies.case_variables import WINDOW
from ringwear_par.studies.finals import entry_of
from ringwear_par.studies.results_file import OF_CASES, TABLE
from ringwear_par.studies.swept import axis_of, told_entry
from ringwear_par.studies.variations import own_key

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
    cases, count = file[POINT_R.name].shape
    found: list[set[tuple[Any, ...]]] = [set() for _ in range(count)]
    for start in range(0, cases, WINDOW):
        columns = [file[name][start : start + WINDOW] for name in POINTS if name in file]
        there = np.isfinite(columns[0])
        for i, places in enumerate(found):
            places.update(zip(*(c[there[:, i], i].tolist() for c in columns), strict=True))
    return [_told_place(*places.pop()) if len(places) == 1 else "" for places in found]


def _told_place(r: float, z: float, side: bytes = b"") -> str:
    return f" at r = {r:.9g} mm, z = {z:.9g} mm{', ' * bool(side)}{side.decode()}"
