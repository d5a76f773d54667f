"""The files of a sweep: one for each block, then ``results.h5`` and ``cases.csv`` of all of them.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Cases are in the order of their
blocks, which is that of the design where only numbers vary; ``number`` is their place in it.
"""

import csv
import hashlib
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.fields import side_words
from ringwear_par.results.files import UnreadableError, atomic_hdf5, reading
from ringwear_par.results.result import HistoryColumns
from ringwear_par.results.variables import (
    EDGE_ELEMENT,
    ELEMENT,
    LINE,
    POINT_SIDE,
    Variable,
    edge_elements,
)
from ringwear_par.studies.blocks import Block
from ringwear_par.studies.ensemble import (
    AXES,
    END_VALUES,
    FILE_KIND,
    RESULTS,
    SOFTWARE,
    TABLE,
    VARIABLES,
    entries,
    has_layers,
)
from ringwear_par.studies.study import Study
from ringwear_par.studies.variations import cell, own_key
from ringwear_par.version import __version__, versions

#: how variables are compressed
_PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
#: bytes that results may take beside their blocks
_MORE_BYTES = 1e6
_STATE = Variable("step", ("step",), "1", "stored state of each case", integer=True)
#: of each case, beside its history
_NUMBERS = {"steps_stored": int, "elements": int, "seconds": float, "imbalance": float}


# -- of a block --------------------------------------------------------------------------------


def arrays_of(
    cases: Sequence[Any],
    parts: Sequence[tuple[IntArray, HistoryColumns]],
    errors: Mapping[int, Exception],
) -> dict[str, Any]:
    """Return what is stored of a block's cases, by name, (cases, ...), but their ids.

    Parameters
    ----------
    parts : places of cases in the block, and their histories.
    errors : why the others have none, by place.
    """
    count = len(cases)
    texts = {name: np.full(count, "", dtype=object) for name in ("status", "error", "flags")}
    for place, error in errors.items():
        texts["status"][place], texts["error"][place] = "failed", reason_of(error)
    arrays: dict[str, Any] = {name: np.zeros(count, dtype) for name, dtype in _NUMBERS.items()}
    tables: list[tuple[IntArray, dict[str, Any]]] = []
    for at, columns in parts:
        rows, line = np.diff(columns.offsets), cases[at[0]].line
        texts["status"][at], texts["error"][at] = columns.status, columns.reason
        texts["flags"][at] = [", ".join(flags) for flags in columns.flags]
        arrays["steps_stored"][at], arrays["elements"][at] = rows, np.where(rows, line.n, 0)
        arrays["seconds"][at], arrays["imbalance"][at] = columns.seconds, columns.imbalance
        stored = np.arange(rows.max(initial=1)) < rows[:, None]
        table = {n: np.tile(getattr(line, n), (len(rows), 1)) for n in LINE} | {**columns.whole}
        for name, values in columns.data.items():
            table[name] = np.full((*stored.shape, *values.shape[1:]), np.nan)
            table[name][stored] = values
        tables.append((at, table))
    for name, shape in _largest(_rest(table) for _, table in tables).items():
        arrays[name] = np.full((count, *shape), np.nan)
        for at, table in tables:
            if name in table:
                _put(arrays[name], at, table[name], name)
    encoded = {name: np.array([text.encode() for text in v]) for name, v in texts.items()}
    return derived(arrays) | encoded


def derived(arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays of cases with what follows from them: end values, edges, words."""
    if "pressure" in arrays:
        pressure = arrays["pressure"]
        edges = np.where(np.isnan(pressure), np.nan, edge_elements(pressure))
        arrays[EDGE_ELEMENT.name] = edges
    for end_value in END_VALUES.values():
        if end_value.source in arrays and end_value.stored.name not in arrays:
            arrays[end_value.stored.name] = end_value.of(arrays)
    if POINT_SIDE.name in arrays:
        arrays[POINT_SIDE.name] = side_words(arrays[POINT_SIDE.name])
    return arrays


def _largest(shapes: Iterable[Mapping[str, tuple[int, ...]]]) -> dict[str, tuple[int, ...]]:
    """Return the shapes that those of the same name fit into."""
    largest: dict[str, tuple[int, ...]] = {}
    for name, shape in chain.from_iterable(each.items() for each in shapes):
        largest[name] = tuple(map(max, shape, largest.get(name, shape)))
    return largest


def _rest(arrays: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    """Return the shapes of arrays without the axis of the cases."""
    return {name: values.shape[1:] for name, values in arrays.items()}


def _put(whole: Any, at: Any, values: Any, name: str) -> None:
    """Write the values of some cases into an array with space for more states or elements."""
    cells = tuple(map(slice, values.shape[1:]))
    if has_layers(VARIABLES[name]):  # the body itself is the last
        whole[(at, *cells[:-1], -1)] = values[..., -1]
        values, cells = values[..., :-1], (*cells[:-1], slice(values.shape[-1] - 1))
    if values.size:
        whole[(at, *cells)] = values


def write_block(block: Block, arrays: Mapping[str, Any]) -> None:
    """Write the file of a block. On one rank.

    Raises
    ------
    OSError : the disk.
    """
    with atomic_hdf5(block.path) as file:
        failed = int((arrays["status"] == b"failed").sum())
        file.attrs.update(software=SOFTWARE, version=__version__, failed=failed)
        for name, values in arrays.items():
            data = _create(file, _variable(name, values.ndim), values.shape, values.dtype)
            data[...] = values.astype(data.dtype)  # of texts their encoding


def _variable(name: str, ndim: int) -> Variable:
    """Return the variable of an array (cases, ...); fields of the last states have no steps."""
    variable = VARIABLES[name]
    last = "step" in variable.dimensions and ndim < len({"case", *variable.dimensions})
    variable = variable.at_last_step() if last else variable
    axes = tuple(axis for axis in variable.dimensions if axis != "case")
    return Variable(name, ("case", *axes), variable.unit, variable.meaning)


def _create(file: h5py.File, variable: Variable, shape: Sequence[int], kind: Any) -> h5py.Dataset:
    """Return a new variable, NaN or empty texts so far."""
    text = kind.kind == "S"
    data = file.create_dataset(
        variable.name, shape, h5py.string_dtype("utf-8", max(kind.itemsize, 1)) if text else kind,
        fillvalue=np.nan if kind.kind == "f" else None, **_PACKED,
    )  # fmt: skip
    # with which xarray takes bytes for the texts that they are
    data.attrs.update(variable.attributes | ({"_Encoding": "utf-8"} if text else {}))
    return data


# -- of all ------------------------------------------------------------------------------------


def fingerprint(blocks: Sequence[Block]) -> str:
    """Return the name of all blocks of a study together."""
    return hashlib.sha256("".join(block.path.stem for block in blocks).encode()).hexdigest()[:16]


def is_merged(folder: Path, blocks: Sequence[Block]) -> bool:
    """Tell whether the results of these blocks are in a folder; InputError for others' files."""
    if not (folder / RESULTS).exists():
        return False
    must = "; must be removed, or a new folder"
    with reading(folder / RESULTS, SOFTWARE, FILE_KIND, must) as file:
        return bool(file.attrs.get("blocks") == fingerprint(blocks))


def merge(study: Study, blocks: Sequence[Block], folder: Path, ranks: int) -> None:
    """Write the results of a study whose blocks are all there. On one rank.

    No more than a block is in memory; both files appear by rename.

    Raises
    ------
    DamagedError : a block.
    ComputationError : there is not enough space for them.
    OSError : the disk.
    """
    needed = sum(block.path.stat().st_size for block in blocks) + _MORE_BYTES
    if (free := shutil.disk_usage(folder).free) < needed:  # HDF5 may end the process
        raise ComputationError(
            f"{folder}: the disk is too full for the results: {1e-6 * free:.0f} MB are free, "
            f"{1e-6 * needed:.0f} MB are needed"
        )
    with (
        atomic_write(folder / RESULTS) as path, atomic_write(folder / TABLE) as rows,
        rows.open("w", newline="", encoding="utf-8") as table,
        h5py.File(path, "w", libver=("v110", "v110")) as file,
    ):  # fmt: skip
        _make(file, study, blocks)
        writer, first = csv.writer(table), 0
        for block in blocks:
            _append(file, block, first)
            columns = _columns(file, study, block, first)
            if not first:
                writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
            first += len(block.numbers)
        file.attrs.update(
            software=SOFTWARE, study=study.text, case=study.base_text, method=study.method,
            coordinates=" ".join(study.names), status="complete", ranks=ranks,
            blocks=fingerprint(blocks), **versions(),
        )  # fmt: skip


def _make(file: h5py.File, study: Study, blocks: Sequence[Block]) -> None:
    """Make the axes and the variables of all blocks, which are without values but varied keys."""
    shapes: dict[str, tuple[int, ...]] = {}
    kinds: dict[str, Any] = {}
    for block in blocks:
        with _opened(block) as part:
            shapes = _largest([shapes, _rest(part)])
            for name, data in part.items():
                kinds[name] = max(data.dtype, kinds.get(name, data.dtype), key=_itemsize)
    sizes = {"step": 1, "element": 1}
    variables = {name: _variable(name, 1 + len(shape)) for name, shape in shapes.items()}
    for name, shape in shapes.items():
        sizes |= zip(variables[name].dimensions[1:], shape, strict=True)
    for axis, size in sizes.items():
        file.create_dataset(axis, data=np.arange(size)).make_scale(axis)
        file[axis].attrs.update({"step": _STATE, "element": ELEMENT, **AXES}[axis].attributes)
    for name, variable in variables.items():
        _create(file, variable, (len(study), *shapes[name]), kinds[name])
    file["case"].make_scale("case")
    order = np.concatenate([block.numbers for block in blocks])
    for name, unit in study.units().items():
        values = study.stored(name)[order]
        variables[name] = Variable(name, ("case",), unit or "1", own_key(name).meaning)
        data = _create(file, variables[name], values.shape, values.dtype)
        data[...] = values.astype(data.dtype)
        if name in study.ranges:
            data.attrs.update(zip(("spacing", "low", "high"), study.ranges[name], strict=True))
    for name, variable in variables.items():
        for i, axis in enumerate(variable.dimensions):
            if name != axis:
                file[name].dims[i].attach_scale(file[axis])


def _itemsize(kind: Any) -> int:
    return int(kind.itemsize)


class DamagedError(InputError):
    """A file of a block that is damaged."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(reason)
        self.path = path


@contextmanager
def _opened(block: Block) -> Iterator[h5py.File]:
    """Yield the file of a block to read, see ``reading``; DamagedError if it is damaged."""
    try:
        with reading(block.path, SOFTWARE, "a block of a sweep") as file:
            yield file
    except InputError as error:
        if isinstance(error, UnreadableError) or isinstance(error.__cause__, MemoryError):
            raise
        raise DamagedError(block.path, str(error)) from error


def _append(file: h5py.File, block: Block, first: int) -> None:
    """Write the cases of a block to the results, from a case on."""
    with _opened(block) as part:
        arrays = {name: data[()] for name, data in part.items()}
    for name, values in arrays.items():
        whole = file[name]
        _put(whole, slice(first, first + len(values)), values.astype(whole.dtype), name)


# -- the table ---------------------------------------------------------------------------------


def _columns(file: h5py.File, study: Study, block: Block, first: int) -> dict[str, Sequence[str]]:
    """Return the columns of the table of a block's cases, which are in the file from one on."""

    def stored(name: str) -> Any:
        return file[name][first : first + len(block.numbers)]

    columns: dict[str, Sequence[str]] = {"case": _cells(stored("case"))}
    for name, column in study.columns.items():
        columns[name] = [cell(value) for value in column[block.numbers].tolist()]
    columns |= {name: _cells(stored(name)) for name in ("status", "error")}
    for end_value in END_VALUES.values():
        if end_value.stored.name in file:
            for name, ends in entries(end_value, stored(end_value.stored.name)).items():
                columns[name] = _cells(ends)
    columns["seconds"] = [f"{seconds:.4f}" for seconds in stored("seconds").tolist()]
    return columns | {name: _cells(stored(name)) for name in ("flags", "number")}


def _cells(values: Any) -> list[str]:
    """Return the texts of numbers, "" for NaN, or of bytes."""
    if values.dtype.kind == "S":
        return np.char.decode(values, "utf-8").tolist()
    return ["" if value != value else repr(value) for value in values.tolist()]
