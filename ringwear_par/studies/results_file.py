"""The files of a sweep: one for each block, then ``results.h5`` and ``cases.csv`` of all of them.

Blocks hold the variables of the results for their cases, in chunks of the same shape and
compressed by the rank that computed them: to merge them is to copy their chunks as they are.
Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Cases are in the order of their
blocks, which is that of the design where only numbers vary; ``number`` is their place in it.
"""

import csv
import hashlib
import math
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.fields import side_words
from ringwear_par.results.hdf5 import atomic_hdf5, reading
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

#: how variables are compressed, and most bytes of a chunk
_PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
_CHUNK_BYTES = 256e3
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
    texts = {
        "status": ["failed"] * count,
        "error": [reason_of(errors[i]) if i in errors else "" for i in range(count)],
        "flags": [""] * count,
    }
    arrays: dict[str, Any] = {name: np.zeros(count, dtype) for name, dtype in _NUMBERS.items()}
    tables: list[dict[str, Any]] = []
    for at, columns in parts:
        rows, line = np.diff(columns.offsets), cases[at[0]].line
        for i, place in enumerate(at.tolist()):
            texts["status"][place] = columns.status[i]
            texts["error"][place] = columns.reason[i]
            texts["flags"][place] = ", ".join(columns.flags[i])
        arrays["steps_stored"][at], arrays["elements"][at] = rows, np.where(rows, line.n, 0)
        arrays["seconds"][at], arrays["imbalance"][at] = columns.seconds, columns.imbalance
        stored = np.arange(rows.max(initial=1)) < rows[:, None]
        table = {n: np.tile(getattr(line, n), (len(rows), 1)) for n in LINE} | {**columns.whole}
        for name, values in columns.data.items():
            table[name] = np.full((*stored.shape, *values.shape[1:]), np.nan)
            table[name][stored] = values
        tables.append(table)
    shapes: dict[str, tuple[int, ...]] = {}
    for table in tables:
        for name, values in table.items():
            shapes[name] = _larger(values.shape[1:], shapes.get(name))
    for name, shape in shapes.items():
        arrays[name] = np.full((count, *shape), np.nan)
        for (at, _), table in zip(parts, tables, strict=True):
            if name in table:
                arrays[name][at] = _padded(name, table[name], shape)
    return derived(arrays) | {name: np.array([t.encode() for t in v]) for name, v in texts.items()}


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


def _larger(shape: tuple[int, ...], other: tuple[int, ...] | None) -> tuple[int, ...]:
    """Return the shape that both fit into."""
    return shape if other is None else tuple(map(max, shape, other))


def _padded(name: str, values: Any, shape: tuple[int, ...]) -> Any:
    """Return the values of cases, (cases, *shape), NaN where they have fewer states or elements."""
    if values.shape[1:] == shape:
        return values
    table = np.full((len(values), *shape), np.nan)
    cells = tuple(map(slice, values.shape[1:]))
    if has_layers(VARIABLES[name]):  # the body itself is the last
        table[(slice(None), *cells)][..., :-1] = values[..., :-1]
        table[(slice(None), *cells[:-1], -1)] = values[..., -1]
    else:
        table[(slice(None), *cells)] = values
    return table


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
            variable = _variable(name, values.ndim)
            lengths = [block.chunk[axis] for axis in variable.dimensions]
            most = int(_CHUNK_BYTES / (8 * math.prod(lengths[1:]))) or 1
            lengths[0] = min(lengths[0], 1 << (most.bit_length() - 1))
            data = _create(file, variable, values.shape, values.dtype, lengths)
            data[...] = values.astype(data.dtype)  # of texts their encoding


def _variable(name: str, ndim: int) -> Variable:
    """Return the variable of an array (cases, ...); fields of the last states have no steps."""
    variable = VARIABLES[name]
    last = "step" in variable.dimensions and ndim < len({"case", *variable.dimensions})
    variable = variable.at_last_step() if last else variable
    axes = tuple(axis for axis in variable.dimensions if axis != "case")
    return Variable(name, ("case", *axes), variable.unit, variable.meaning)


def _create(
    file: h5py.File, variable: Variable, shape: Sequence[int], kind: Any, chunk: Sequence[int]
) -> h5py.Dataset:
    """Return a new variable, NaN or empty texts so far."""
    text = kind.kind == "S"
    data = file.create_dataset(
        variable.name, shape, h5py.string_dtype("utf-8", max(kind.itemsize, 1)) if text else kind,
        chunks=tuple(chunk), maxshape=tuple(map(max, shape, chunk)),
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
    """Tell whether the results of these blocks are in a folder. On one rank."""
    try:
        with reading(folder / RESULTS, SOFTWARE, FILE_KIND) as file:
            return bool(file.attrs.get("blocks") == fingerprint(blocks))
    except InputError:
        return False


def merge(study: Study, blocks: Sequence[Block], folder: Path, ranks: int) -> None:
    """Write the results of a study whose blocks are all there. On one rank.

    No more than a block is in memory; both files appear by rename.

    Raises
    ------
    InputError : a block is damaged.
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
            values = _append(file, block, first)
            columns = _columns(study, block, values)
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
    kinds: dict[str, tuple[Any, Any]] = {}
    for block in blocks:
        with _opened(block) as part:
            for name, data in part.items():
                shapes[name] = _larger(data.shape[1:], shapes.get(name))
                if name not in kinds or data.dtype.itemsize > kinds[name][0].itemsize:
                    kinds[name] = data.dtype, data.chunks
    sizes = {"step": 1, "element": 1}
    variables = {name: _variable(name, 1 + len(shape)) for name, shape in shapes.items()}
    for name, shape in shapes.items():
        sizes |= zip(variables[name].dimensions[1:], shape, strict=True)
    for axis, size in sizes.items():
        file.create_dataset(axis, data=np.arange(size)).make_scale(axis)
        file[axis].attrs.update({"step": _STATE, "element": ELEMENT, **AXES}[axis].attributes)
    for name, variable in variables.items():
        _create(file, variable, (len(study), *shapes[name]), *kinds[name])
    file["case"].make_scale("case")
    order = np.concatenate([block.numbers for block in blocks])
    for name, unit in study.units().items():
        values = study.stored(name)[order]
        variables[name] = Variable(name, ("case",), unit or "1", own_key(name).meaning)
        data = _create(file, variables[name], values.shape, values.dtype, kinds["case"][1])
        data[...] = values.astype(data.dtype)
        if name in study.ranges:
            data.attrs.update(zip(("spacing", "low", "high"), study.ranges[name], strict=True))
    for name, variable in variables.items():
        for i, axis in enumerate(variable.dimensions):
            if name != axis:
                file[name].dims[i].attach_scale(file[axis])


def _opened(block: Block) -> Any:
    """Return the file of a block to read, as a context."""
    return reading(block.path, SOFTWARE, "a block of a sweep", "; must be removed")


def _append(file: h5py.File, block: Block, first: int) -> dict[str, Any]:
    """Write the cases of a block to the results, from a case on; return what the table needs."""
    chunks: dict[str, list[tuple[tuple[int, ...], bytes]]] = {}
    values: dict[str, Any] = {}
    with _opened(block) as part:
        for name, data in part.items():
            whole = file[name]
            alike = (data.dtype, data.chunks) == (whole.dtype, whole.chunks)
            if has_layers(VARIABLES[name]):  # the body itself is the last
                alike = alike and data.shape[1:] == whole.shape[1:]
            if alike and first % data.chunks[0] == 0:
                places = (data.id.get_chunk_info(i) for i in range(data.id.get_num_chunks()))
                offsets = [place.chunk_offset for place in places]
                chunks[name] = [(at, data.id.read_direct_chunk(at)[1]) for at in offsets]
            if name not in chunks or name in _IN_TABLE:
                values[name] = data[()]
    for name, packed in chunks.items():
        for (case, *rest), content in packed:
            file[name].id.write_direct_chunk((first + case, *rest), content)
    for name in values.keys() - chunks.keys():
        table = _padded(name, values[name], file[name].shape[1:])
        file[name][first : first + len(table)] = table.astype(file[name].dtype)
    for name in _IN_TABLE & file.keys():
        shape = file[name].shape[1:]
        missing = np.full((len(block.numbers), *shape), np.nan)
        values[name] = _padded(name, values.get(name, missing), shape)
    return values


# -- the table ---------------------------------------------------------------------------------

_IN_TABLE = {
    "case", "status", "error", "seconds", "flags", "number",
    *(end_value.stored.name for end_value in END_VALUES.values()),
}  # fmt: skip


def _columns(study: Study, block: Block, values: Mapping[str, Any]) -> dict[str, Sequence[str]]:
    """Return the columns of the table of a block's cases."""
    columns: dict[str, Sequence[str]] = {"case": _cells(values["case"])}
    for name, column in study.columns.items():
        columns[name] = [cell(value) for value in column[block.numbers].tolist()]
    columns |= {name: _cells(values[name]) for name in ("status", "error")}
    for end_value in END_VALUES.values():
        if end_value.stored.name in values:
            for name, ends in entries(end_value, values[end_value.stored.name]).items():
                columns[name] = _cells(ends)
    columns["seconds"] = [f"{seconds:.4f}" for seconds in values["seconds"].tolist()]
    return columns | {name: _cells(values[name]) for name in ("flags", "number")}


def _cells(values: Any) -> list[str]:
    """Return the texts of numbers, "" for NaN, or of bytes."""
    if values.dtype.kind == "S":
        return np.char.decode(values, "utf-8").tolist()
    return ["" if value != value else repr(value) for value in values.tolist()]
