"""The results of a sweep: ``results.h5``, one file for xarray, and ``cases.csv``, one row a case.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Both files appear by rename.
"""

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.atomic import atomic_write
from ringwear_par.cases.keys import read_keys
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.text import toml_value
from ringwear_par.errors import InputError
from ringwear_par.results.hdf5 import atomic_hdf5
from ringwear_par.results.reading import (
    UnreadableError,
    find_array,
    find_texts,
    read_array,
    reading,
)
from ringwear_par.results.variables import ELEMENT, HISTORIES, LINE, PROFILES, STEP, Variable
from ringwear_par.studies.shards import UNKNOWN_VERSION, Entry, Record, join_flags, split_flags
from ringwear_par.studies.variations import path_of, value_of

SOFTWARE = "ringwear-par sweep"
#: what messages call the file
WHAT = "a results file of ringwear sweep"
RESULTS, TABLE = "results.h5", "cases.csv"
#: the last values that cases.csv shows
FINAL = ("penetration", "worn_volume_lower", "worn_volume_upper")
_COLUMNS = ("status", "error", *FINAL, "seconds", "in_study", "version", "flags")
_BLOCK_BYTES = 32e6
_CHUNK_BYTES = 256e3
_TEXT = h5py.string_dtype()
#: attribute of ``step``: whether all histories begin with the same numbers of steps made
_SAME_STEPS = "same_in_all_cases"
#: variables that older files do not have, and what is said of their cases
_OLDER = {"version": UNKNOWN_VERSION, "flags": ""}
#: variables with dimension (case,)
OF_CASES = {
    variable.name: variable
    for variable in (
        Variable("case_toml", ("case",), "1", "the case as a case file"),
        Variable("status", ("case",), "1", "done, failed or incomplete"),
        Variable("error", ("case",), "1", "why the case failed"),
        Variable("in_study", ("case",), "1", "whether the study still has the case"),
        Variable("version", ("case",), "1", "version of ringwear-par that computed the case"),
        Variable("flags", ("case",), "1", "what makes the answer doubtful, separated by commas"),
        Variable("seconds", ("case",), "s", "wall time of the case"),
        Variable(
            "imbalance", ("case",), "1",
            "worst balance of force, volume, energy or KKT residual of its steps",
        ),
        Variable("steps_stored", ("case",), "1", "number of stored steps", integer=True),
        Variable("elements", ("case",), "1", "number of contact elements", integer=True),
        *(
            Variable(
                f"final_{name}", ("case",), HISTORIES[name].unit,
                f"{HISTORIES[name].meaning}, at the last stored step",
            )
            for name in FINAL
        ),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Row:
    """A case as the files list it.

    Parameters
    ----------
    id : of the case.
    values : of the varied keys, None where the case has no such key; None as a whole where they
        are to be looked up in the stored case.
    toml : its text, "" if it is stored.
    in_study : whether the study still has it.
    entry : what is stored of it, None if it was not begun.
    """

    id: str
    values: tuple[Any, ...] | None
    toml: str
    in_study: bool
    entry: Entry | None


def write_ensemble(
    folder: Path,
    names: Sequence[str],
    rows: Sequence[Row],
    fetch: Callable[[Sequence[Row]], Iterator[Record]],
    attributes: Mapping[str, Any],
) -> None:
    """Write both files by rename. Call on one rank only.

    Parameters
    ----------
    folder : of the sweep.
    names : the varied keys.
    rows : one a case.
    fetch : yields the records of rows that have an entry, in any order.
    attributes : of the HDF5 file.

    Raises
    ------
    OSError : the disk or the folder.
    """
    with (
        atomic_write(folder / TABLE) as listed,  # both are whole before one is replaced
        atomic_hdf5(folder / RESULTS) as (file, check_disk),
    ):
        table = _write_histories(file, names, rows, fetch, check_disk)
        file.attrs.update({"software": SOFTWARE, **attributes})
        with listed.open("w", newline="", encoding="utf-8") as handle:
            writer = csv.writer(handle)
            writer.writerow(("case", *names, *_COLUMNS))
            writer.writerows(table)


def _write_histories(
    file: h5py.File,
    names: Sequence[str],
    rows: Sequence[Row],
    fetch: Callable[[Sequence[Row]], Iterator[Record]],
    check_disk: Callable[[], None],
) -> list[tuple[str, ...]]:
    """Fill the HDF5 file block by block, and return the rows of the table."""
    entries = [row.entry for row in rows if row.entry is not None]
    count, deep = len(rows), any(entry.deep for entry in entries)
    steps = max((entry.rows for entry in entries), default=1) or 1
    elements = max((entry.elements for entry in entries), default=1) or 1
    _make_scales(file, rows, steps, elements)
    variables = [
        *HISTORIES.values(),
        *LINE.values(),
        *(
            variable if deep else variable.at_last_step()
            for name, variable in PROFILES.items()
            if any(name in entry.fields for entry in entries)
        ),
    ]
    shapes = {}
    for variable in variables:
        shapes[variable.name] = _make(file, over_cases(variable), float).shape[1:]
    columns = _empty_columns(rows)
    values = [row.values or (None,) * len(names) for row in rows]
    common: FloatArray | None = np.empty(0)
    block = max(1, int(_BLOCK_BYTES // (8 * sum(math.prod(shape) for shape in shapes.values()))))
    for start in range(0, count, block):
        part = rows[start : start + block]
        where = {row.id: i for i, row in enumerate(part)}
        tables = {name: np.full((len(part), *shape), np.nan) for name, shape in shapes.items()}
        for record in fetch([row for row in part if row.entry is not None]):
            i = where[record.id]
            _note(columns, start + i, record)
            if part[i].values is None:
                values[start + i] = _looked_up(record, names)
            stored = len(record.arrays.get("time", ()))
            for name, array in record.arrays.items():
                if name == "step":
                    common = _common(common, array)
                elif deep and array.ndim == 1 and name in PROFILES:
                    tables[name][i, stored - 1, : len(array)] = array
                else:
                    cells: tuple[int | slice, ...] = (i, *map(slice, array.shape))
                    tables[name][cells] = array
            if stored and "step" not in record.arrays:
                common = None
        for name, table in tables.items():
            file[name][start : start + len(part)] = table
        check_disk()
    if common is not None and len(common) == steps:
        file["step"][:] = common.astype(int)
        file["step"].attrs["long_name"] = "number of time steps made"
        file["step"].attrs[_SAME_STEPS] = 1
    for name, column in columns.items():
        kind = _TEXT if isinstance(column, list) else column.dtype
        _make(file, OF_CASES[name], kind)[:] = column
    _write_varied(file, names, values)
    return _table(rows, values, columns)


def over_cases(variable: Variable) -> Variable:
    """Return a variable of one case as the results of all have it, padded with NaN."""
    return replace(variable, dimensions=("case", *variable.dimensions), integer=False)


def _empty_columns(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the variables of cases of which nothing is stored: lists of texts, or arrays."""
    count = len(rows)
    columns: dict[str, Any] = {name: np.full(count, np.nan) for name in OF_CASES}
    columns["case_toml"] = [row.toml for row in rows]
    columns["status"] = ["incomplete"] * count
    columns["in_study"] = ["yes" if row.in_study else "no" for row in rows]
    for name in ("error", "version", "flags"):
        columns[name] = [""] * count
    for name in ("steps_stored", "elements"):
        columns[name] = np.zeros(count, dtype=int)
    return columns


def _looked_up(record: Record, names: Sequence[str]) -> tuple[Any, ...]:
    """Return the varied keys of a case that the study no longer has, None where it has no such."""
    try:
        keys = read_keys(record.toml)
        return tuple(value_of(keys, name) for name in names)
    except InputError:
        return (None,) * len(names)


def _note(columns: dict[str, Any], n: int, record: Record) -> None:
    """Take what is stored of a case over into the variables of cases."""
    arrays = record.arrays
    columns["case_toml"][n], columns["flags"][n] = record.toml, join_flags(record.flags)
    for name in ("status", "error", "version", "seconds", "imbalance"):
        columns[name][n] = getattr(record, name)
    columns["steps_stored"][n] = len(arrays.get("time", ()))
    columns["elements"][n] = len(arrays.get("r", ()))
    for name in FINAL:
        if len(arrays.get(name, ())):
            columns[f"final_{name}"][n] = arrays[name][-1]


def _table(
    rows: Sequence[Row], values: Sequence[tuple[Any, ...]], columns: Mapping[str, Any]
) -> list[tuple[str, ...]]:
    """Return the rows of cases.csv."""
    shown = [
        columns["status"],
        columns["error"],
        *(["" if np.isnan(v) else repr(v) for v in columns[f"final_{n}"].tolist()] for n in FINAL),
        ["" if np.isnan(v) else f"{v:.4f}" for v in columns["seconds"].tolist()],
        *(columns[name] for name in ("in_study", "version", "flags")),
    ]
    return [
        (row.id, *("" if v is None else _shown(v) for v in varied), *rest)
        for row, varied, *rest in zip(rows, values, *shown, strict=True)
    ]


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else toml_value(value)


def _common(known: FloatArray | None, steps: FloatArray) -> FloatArray | None:
    """Return the longer of two lists of steps if one begins with the other, else None."""
    if known is None:
        return None
    short, long = sorted((known, steps), key=len)
    return long if np.array_equal(short, long[: len(short)]) else None


def _make_scales(file: h5py.File, rows: Sequence[Row], steps: int, elements: int) -> None:
    """Make the dimensions; ``step`` is numbered, until it is known to be the same in all cases."""
    file.create_dataset("case", data=[row.id for row in rows], dtype=_TEXT)
    file["case"].attrs.update({"units": "1", "long_name": "case, by its content"})
    file.create_dataset("step", data=np.arange(steps))
    meaning = "stored step (their numbers differ from case to case)"
    file["step"].attrs.update({"units": "1", "long_name": meaning, _SAME_STEPS: 0})
    file.create_dataset("element", data=np.arange(elements))
    file["element"].attrs.update(ELEMENT.attributes)
    for name in ("case", "step", "element"):
        file[name].make_scale(name)


def _make(file: h5py.File, variable: Variable, kind: Any) -> h5py.Dataset:
    """Make a variable, in chunks that hold whole histories as far as they are small."""
    shape = tuple(len(file[name]) for name in variable.dimensions)
    chunks = list(shape)
    for axis in range(len(shape)):
        rest = 8 * math.prod(chunks[axis + 1 :])
        chunks[axis] = min(shape[axis], max(1, int(_CHUNK_BYTES // rest)))
    extra = {"fillvalue": np.nan} if np.dtype(kind).kind == "f" else {}
    dataset = file.create_dataset(variable.name, shape, dtype=kind, chunks=tuple(chunks), **extra)
    dataset.attrs.update(variable.attributes)
    for axis, name in enumerate(variable.dimensions):
        dataset.dims[axis].attach_scale(file[name])
    return dataset


def _write_varied(file: h5py.File, names: Sequence[str], values: Sequence[tuple[Any, ...]]) -> None:
    """Write the varied keys as coordinates, as texts where they are not all numbers."""
    for i, name in enumerate(names):
        column = [row[i] for row in values]
        key = BY_PATH[path_of(name)]
        numbers = all(
            v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in column
        )
        variable = Variable(name, ("case",), "1" if key.unit == "-" else key.unit, key.meaning)
        _make(file, variable, float if numbers else _TEXT)[:] = (
            [np.nan if v is None else v for v in column]
            if numbers
            else ["" if v is None else _shown(v) for v in column]
        )
    file.attrs["coordinates"] = " ".join(names)


def read_entries(path: Path) -> dict[str, Entry] | None:
    """Return the begun cases of a results file by id; None if it is damaged. Not collective.

    Raises
    ------
    UnreadableError : it cannot be read now.
    """
    try:
        with reading(path, SOFTWARE, WHAT) as file:
            sizes: dict[str, int] = {}
            ids, status = (find_texts(file, name, sizes)[:] for name in ("case", "status"))
            stored, elements, seconds = (
                read_array(file, OF_CASES[name], sizes)
                for name in ("steps_stored", "elements", "seconds")
            )
            begun = ~np.isnan(seconds)
            fields = tuple(name for name in PROFILES if name in file)
            deep = any(file[name].ndim == 3 for name in fields)
            version, flags = (
                find_texts(file, name, sizes)[:] if name in file else [default] * len(ids)
                for name, default in _OLDER.items()
            )
            _tables(file, sizes)  # which read_records will look for
    except UnreadableError:
        raise
    except InputError:
        return None
    return {
        ids[i]: Entry(
            status[i], int(stored[i]), int(elements[i]), fields, deep, path, version[i],
            split_flags(flags[i]),
        )
        for i in np.flatnonzero(begun)
    }  # fmt: skip


def _tables(file: h5py.File, sizes: dict[str, int]) -> dict[str, h5py.Dataset]:
    """Return the variables over cases and steps or elements."""
    found = {}
    for name, variable in {**HISTORIES, **LINE, **PROFILES}.items():
        if name in file:
            last = name in PROFILES and file[name].ndim == 2
            own = over_cases(variable.at_last_step() if last else variable)
            found[name] = find_array(file, own, sizes)
    return found


def read_records(path: Path, ids: Sequence[str]) -> Iterator[Record]:
    """Yield some cases of a results file. Not collective."""
    with reading(path, SOFTWARE, WHAT) as file:
        sizes: dict[str, int] = {}
        places = {i: n for n, i in enumerate(find_texts(file, "case", sizes)[:])}
        wanted = np.array(sorted(places[identity] for identity in ids), dtype=int)
        if not len(wanted):
            return

        def column(table: Any) -> Any:
            low, high = wanted[0], wanted[-1] + 1
            if high - low <= 4 * len(wanted):  # far faster than a choice of rows
                return table[low:high][wanted - low]
            return table[wanted]

        def texts(name: str) -> Any:
            if name in _OLDER and name not in file:
                return [_OLDER[name]] * len(wanted)
            return column(find_texts(file, name, sizes))

        steps = read_array(file, STEP, sizes).astype(float)
        # files of before the attribute: only where they are not just numbered does it matter
        same = file["step"].attrs.get(_SAME_STEPS, (steps != np.arange(len(steps))).any())
        tables = {name: column(table) for name, table in _tables(file, sizes).items()}
        stored, elements, *numbers = (
            column(find_array(file, OF_CASES[name], sizes)).tolist()
            for name in ("steps_stored", "elements", "seconds", "imbalance")
        )
        words = [texts(name) for name in ("case", "case_toml", "status", "error")]
        versions, flags = texts("version"), texts("flags")
        for i, about in enumerate(zip(*words, *numbers, strict=True)):
            identity, toml, status, error, seconds, imbalance = about
            s, e = slice(stored[i]), slice(elements[i])
            arrays = {"step": steps[s]} if same else {}
            for name, table in tables.items():
                if name in HISTORIES:
                    arrays[name] = table[i, s]
                else:
                    arrays[name] = table[i, s, e] if table.ndim == 3 else table[i, e]
            yield Record(
                identity, toml, status, error, seconds, imbalance, arrays, versions[i],
                split_flags(flags[i]),
            )  # fmt: skip
