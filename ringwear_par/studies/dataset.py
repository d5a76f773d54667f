"""The results of a sweep: ``results.h5``, one file for xarray, and ``cases.csv``, one row a case.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Both files appear by rename.
"""

import csv
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.keys import read_keys
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.text import toml_value
from ringwear_par.errors import InputError
from ringwear_par.results.variables import HISTORIES, LINE, PROFILES
from ringwear_par.studies.designs import path_of, value_of
from ringwear_par.studies.shards import Entry, Record

SOFTWARE = "ringwear-par sweep"
RESULTS, TABLE = "results.h5", "cases.csv"
#: the last values that cases.csv shows
FINAL = ("penetration", "worn_volume_lower", "worn_volume_upper")
_BLOCK_BYTES = 32e6
_CHUNK_BYTES = 256e3
_TEXT = h5py.string_dtype()
_COMMON_STEPS = "number of time steps made"


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


@dataclass(frozen=True)
class Ensemble:
    """A sweep's results without their histories, which ``histories`` reads.

    Parameters
    ----------
    path : of results.h5.
    ids, status, error : (cases,) str.
    in_study : (cases,) bool.
    seconds : (cases,) float.
    steps_stored : (cases,) int.
    varied : values by varied key, (cases,) float, or str where they are not numbers.
    final : last stored values of FINAL, (cases,) float, NaN where nothing is stored.
    attributes : of the file: ``method`` of the design, ``study``, ``status``, versions.
    """

    path: Path
    ids: tuple[str, ...]
    status: tuple[str, ...]
    error: tuple[str, ...]
    in_study: BoolArray
    seconds: FloatArray
    steps_stored: IntArray
    varied: dict[str, Any]
    final: dict[str, FloatArray]
    attributes: dict[str, Any]

    def histories(self, name: str, cases: IntArray) -> FloatArray:
        """Read the histories of some cases (increasing numbers), (len(cases), steps)."""
        with h5py.File(self.path, "r") as file:
            return file[name][cases]


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
    target = folder / RESULTS
    temporary = folder / f"{RESULTS}.tmp{os.getpid()}"
    try:
        with h5py.File(temporary, "w") as file:
            table = _write_histories(file, names, rows, fetch)
            file.attrs.update({"software": SOFTWARE, **attributes})
            file.flush()
        _sync(temporary)
        listed = folder / f"{TABLE}.tmp{os.getpid()}"
        with listed.open("w", newline="", encoding="utf-8") as handle:
            writer = csv.writer(handle)
            writer.writerow(("case", *names, "status", "error", *FINAL, "seconds", "in_study"))
            writer.writerows(table)
        _sync(listed)
        temporary.replace(target)
        listed.replace(folder / TABLE)
    except RuntimeError as error:  # what h5py makes of some failures of the disk
        raise OSError(None, str(error), str(target)) from error
    finally:
        for name in (RESULTS, TABLE):
            (folder / f"{name}.tmp{os.getpid()}").unlink(missing_ok=True)


def _sync(path: Path) -> None:
    with path.open("rb+") as handle:
        os.fsync(handle.fileno())


def _write_histories(
    file: h5py.File,
    names: Sequence[str],
    rows: Sequence[Row],
    fetch: Callable[[Sequence[Row]], Iterator[Record]],
) -> list[tuple[Any, ...]]:
    """Fill the HDF5 file block by block, and return the rows of the table."""
    entries = [row.entry for row in rows if row.entry is not None]
    count = len(rows)
    steps = max((entry.rows for entry in entries), default=1) or 1
    elements = max((entry.elements for entry in entries), default=1) or 1
    deep = any(entry.deep for entry in entries)
    fields = [name for name in PROFILES if any(name in entry.fields for entry in entries)]
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(HISTORIES, (steps,))
    shapes.update(dict.fromkeys(("r", "width"), (elements,)))
    shapes.update(dict.fromkeys(fields, (steps, elements) if deep else (elements,)))
    _make_scales(file, rows, steps, elements)
    about = {
        **HISTORIES,
        **LINE,
        **{name: PROFILES[name] if deep else PROFILES[name].at_last_step() for name in fields},
    }
    for name, shape in shapes.items():
        told = about[name]
        dims = ("case", *told.dimensions)
        _make(file, name, (count, *shape), dims, told.unit, told.meaning)
    scalars = {
        "seconds": np.full(count, np.nan),
        "imbalance": np.full(count, np.nan),
        "steps_stored": np.zeros(count, dtype=int),
        "elements": np.zeros(count, dtype=int),
    }
    status, error = ["incomplete"] * count, [""] * count
    values = [row.values or (None,) * len(names) for row in rows]
    finals = np.full((count, len(FINAL)), np.nan)
    common: FloatArray | None = np.empty(0)
    a_case = 8 * sum(int(np.prod(shape)) for shape in shapes.values())
    block = max(1, int(_BLOCK_BYTES // a_case))
    for start in range(0, count, block):
        part = rows[start : start + block]
        where = {row.id: i for i, row in enumerate(part)}
        texts = [row.toml for row in part]
        tables = {name: np.full((len(part), *shape), np.nan) for name, shape in shapes.items()}
        for record in fetch([row for row in part if row.entry is not None]):
            i = where[record.id]
            n = start + i
            status[n], error[n], texts[i] = record.status, record.error, record.toml
            if part[i].values is None:
                keys = read_keys(record.toml)
                values[n] = tuple(value_of(keys, name) for name in names)
            scalars["seconds"][n] = record.seconds
            scalars["imbalance"][n] = record.imbalance
            arrays = record.arrays
            stored = len(arrays.get("time", ()))
            scalars["steps_stored"][n] = stored
            scalars["elements"][n] = len(arrays.get("r", ()))
            for name, array in arrays.items():
                if name == "step":
                    common = _common(common, array)
                elif deep and array.ndim == 1 and name in PROFILES:
                    tables[name][i, stored - 1, : len(array)] = array
                else:
                    tables[name][(i, *map(slice, array.shape))] = array
            if stored and "step" not in arrays:
                common = None
            if stored:
                finals[n] = [arrays[name][-1] for name in FINAL]
        for name, table in tables.items():
            file[name][start : start + len(part)] = table
        file["case_toml"][start : start + len(part)] = texts
    if common is not None and len(common) == steps:
        file["step"][:] = common.astype(int)
        file["step"].attrs["long_name"] = _COMMON_STEPS
    _write_columns(file, names, rows, values, status, error, scalars, finals)
    return [
        (
            row.id, *("" if v is None else _shown(v) for v in values[n]), status[n], error[n],
            *("" if np.isnan(v) else repr(v) for v in finals[n].tolist()),
            "" if np.isnan(scalars["seconds"][n]) else f"{scalars['seconds'][n]:.4f}",
            "yes" if row.in_study else "no",
        )
        for n, row in enumerate(rows)
    ]  # fmt: skip


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else toml_value(value)


def _common(known: FloatArray | None, steps: FloatArray) -> FloatArray | None:
    """Return the longer of two lists of steps if one begins with the other, else None."""
    if known is None:
        return None
    short, long = sorted((known, steps), key=len)
    return long if np.array_equal(short, long[: len(short)]) else None


def _make_scales(file: h5py.File, rows: Sequence[Row], steps: int, elements: int) -> None:
    file.create_dataset("case", data=[row.id for row in rows], dtype=_TEXT)
    file["case"].attrs["long_name"] = "case, by its content"
    file.create_dataset("step", data=np.arange(steps))
    file["step"].attrs["long_name"] = "stored step (their numbers differ from case to case)"
    file.create_dataset("element", data=np.arange(elements))
    file["element"].attrs["long_name"] = "contact element, from the inner edge outwards"
    for name in ("case", "step", "element"):
        file[name].make_scale(name)
        file[name].attrs["units"] = "1"
    _make(file, "case_toml", (len(rows),), ("case",), "1", "the case as a case file", _TEXT)


def _make(
    file: h5py.File, name: str, shape: tuple[int, ...], dims: tuple[str, ...], unit: str, text: str,
    kind: Any = float,
) -> None:  # fmt: skip
    """Make a variable, in chunks that hold whole histories as far as they are small."""
    chunks = list(shape)
    for axis in range(len(shape)):
        rest = 8 * int(np.prod(chunks[axis + 1 :]))
        chunks[axis] = min(shape[axis], max(1, int(_CHUNK_BYTES // rest)))
    extra = {"fillvalue": np.nan} if kind is float else {}
    dataset = file.create_dataset(name, shape, dtype=kind, chunks=tuple(chunks), **extra)
    dataset.attrs["units"], dataset.attrs["long_name"] = unit, text
    for axis, dim in enumerate(dims):
        dataset.dims[axis].attach_scale(file[dim])


def _write_columns(
    file: h5py.File,
    names: Sequence[str],
    rows: Sequence[Row],
    varied: Sequence[tuple[Any, ...]],
    status: Sequence[str],
    error: Sequence[str],
    scalars: Mapping[str, FloatArray | IntArray],
    finals: FloatArray,
) -> None:
    """Write the variables with dimension (case,), the varied keys as coordinates."""
    about = {
        "seconds": ("s", "wall time of the case"),
        "imbalance": ("1", "worst balance of force, volume, energy or KKT residual of its steps"),
        "steps_stored": ("1", "number of stored steps"),
        "elements": ("1", "number of contact elements"),
    }
    n = len(rows)
    for name, values in scalars.items():
        kind = float if values.dtype == float else int
        _make(file, name, (n,), ("case",), *about[name], kind=kind)
        file[name][:] = values
    for name, column in zip(FINAL, finals.T, strict=True):
        told = HISTORIES[name]
        text = f"{told.meaning}, at the last stored step"
        _make(file, f"final_{name}", (n,), ("case",), told.unit, text)
        file[f"final_{name}"][:] = column
    for name, words, text in (
        ("status", status, "done, failed or incomplete"),
        ("error", error, "why the case failed"),
        (
            "in_study",
            ["yes" if row.in_study else "no" for row in rows],
            "whether the study still has the case",
        ),
    ):
        _make(file, name, (n,), ("case",), "1", text, _TEXT)
        file[name][:] = list(words)
    for i, name in enumerate(names):
        column = [values[i] for values in varied]
        key = BY_PATH[path_of(name)]
        unit = "1" if key.unit == "-" else key.unit
        numbers = all(
            v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in column
        )
        _make(file, name, (n,), ("case",), unit, key.meaning, float if numbers else _TEXT)
        file[name][:] = (
            [np.nan if v is None else v for v in column]
            if numbers
            else ["" if v is None else _shown(v) for v in column]
        )
    file.attrs["coordinates"] = " ".join(names)


def read_entries(path: Path) -> dict[str, Entry] | None:
    """Return the begun cases of a results file by id; None if it is damaged. Not collective."""
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("software") != SOFTWARE:
                return None
            ids, status = file["case"].asstr()[:], file["status"].asstr()[:]
            stored, elements = file["steps_stored"][:], file["elements"][:]
            begun = ~np.isnan(file["seconds"][:])
            fields = tuple(name for name in PROFILES if name in file)
            deep = any(file[name].ndim == 3 for name in fields)
    except (OSError, KeyError, RuntimeError):
        return None
    return {
        ids[i]: Entry(status[i], int(stored[i]), int(elements[i]), fields, deep, path)
        for i in np.flatnonzero(begun)
    }


def read_records(path: Path, ids: Sequence[str]) -> Iterator[Record]:
    """Yield some cases of a results file. Not collective."""
    with h5py.File(path, "r") as file:
        numbers = {identity: i for i, identity in enumerate(file["case"].asstr()[:])}
        wanted = np.array(sorted(numbers[identity] for identity in ids), dtype=int)
        if not len(wanted):
            return

        def column(name: str) -> Any:
            table = file[name].asstr() if file[name].dtype.kind == "O" else file[name]
            low, high = wanted[0], wanted[-1] + 1
            if high - low <= 4 * len(wanted):  # far faster than a choice of rows
                return table[low:high][wanted - low]
            return table[wanted]

        texts = {name: column(name) for name in ("case", "case_toml", "status", "error")}
        seconds, stored, elements = map(column, ("seconds", "steps_stored", "elements"))
        imbalance = column("imbalance")
        steps = file["step"][:].astype(float)
        common = file["step"].attrs["long_name"] == _COMMON_STEPS
        names = [name for name in (*HISTORIES, "r", "width", *PROFILES) if name in file]
        tables = {name: column(name) for name in names}
        for i in range(len(wanted)):
            s, e = slice(stored[i]), slice(elements[i])
            arrays = {"step": steps[s]} if common else {}
            for name, table in tables.items():
                if name in HISTORIES:
                    arrays[name] = table[i, s]
                else:
                    arrays[name] = table[i, s, e] if table.ndim == 3 else table[i, e]
            yield Record(
                texts["case"][i], texts["case_toml"][i], texts["status"][i], texts["error"][i],
                float(seconds[i]), float(imbalance[i]), arrays,
            )  # fmt: skip


def read_ensemble(folder: Path) -> Ensemble:
    """Read a sweep's results. Not collective.

    Raises
    ------
    InputError : the folder holds none.
    """
    path = folder / RESULTS
    if not path.exists():
        raise InputError(
            f"{path}: does not exist; must be written by ringwear sweep (without --slice), which "
            "goes on where it was interrupted"
        )
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("software") != SOFTWARE:
                raise KeyError("software")
            names = str(file.attrs["coordinates"]).split()
            texts = {n: tuple(file[n].asstr()[:]) for n in ("case", "status", "error", "in_study")}
            varied = {}
            for name in names:
                plain = file[name].dtype.kind == "f"
                varied[name] = file[name][:] if plain else file[name].asstr()[:]
            return Ensemble(
                path, texts["case"], texts["status"], texts["error"],
                np.array([word == "yes" for word in texts["in_study"]]),
                file["seconds"][:], file["steps_stored"][:], varied,
                {name: file[f"final_{name}"][:] for name in FINAL},
                dict(file.attrs),
            )  # fmt: skip
    except (OSError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{path}: is not a results file of ringwear sweep, or is damaged"
        ) from error
