"""The results of a sweep, ``results.h5`` and ``cases.csv``: all blocks, one after the other.

Cases are in the order of their blocks, which is that of the design where only numbers vary;
``number`` is their place in the design. Histories shorter than the longest, and contact lines of
fewer elements than the finest, are padded with NaN; ``steps_stored`` and ``elements`` say how much
is there. Both files appear by rename. No more than a block is in memory.
"""

import csv
import hashlib
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.text import toml_value
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.fields import side_words
from ringwear_par.results.hdf5 import reading
from ringwear_par.results.variables import (
    EDGE_ELEMENT,
    ELEMENT,
    POINT_SIDE,
    POINT_SIDES,
    Variable,
    edge_elements,
)
from ringwear_par.studies.block_files import PACKED, axes_of, opened, padded
from ringwear_par.studies.blocks import Block
from ringwear_par.studies.end_values import AXES, END_VALUES, OF_CASES, STORED, entries
from ringwear_par.studies.ensemble import FILE_KIND, RESULTS, SOFTWARE, TABLE
from ringwear_par.studies.study import Study
from ringwear_par.studies.variations import own_key
from ringwear_par.version import versions

#: bytes of a chunk of a variable
_CHUNK_BYTES = 256e3
#: bytes that results may take more than their blocks, as a part of these, and in all
_MORE, _MORE_BYTES = 0.2, 1e6
_STATE = Variable("step", ("step",), "1", "stored state of each case", integer=True)
#: with which xarray takes bytes for the texts that they are
_ENCODED = {"_Encoding": "utf-8"}
#: the variables of a results file by name, with their types
_Variables = dict[str, tuple[Variable, Any]]


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

    Raises
    ------
    DamagedError : a block is not whole.
    ComputationError : there is not enough space for them.
    OSError, UnreadableError : the disk.
    """
    needed = (1.0 + _MORE) * sum(block.path.stat().st_size for block in blocks) + _MORE_BYTES
    if (free := shutil.disk_usage(folder).free) < needed:
        raise ComputationError(
            f"{folder}: the disk is too full for the results: {1e-6 * free:.0f} MB are free, "
            f"{1e-6 * needed:.0f} MB are needed"
        )
    variables, sizes = _variables_of(study, blocks)
    with (
        atomic_write(folder / RESULTS) as path, atomic_write(folder / TABLE) as rows,
        rows.open("w", newline="", encoding="utf-8") as table,
        h5py.File(path, "w", libver=("v110", "v110")) as file,
    ):  # fmt: skip
        _make(file, variables, sizes)
        data = {name: file[name] for name in variables}  # open: chunks stay until they are full
        writer, first = csv.writer(table), 0
        for block in blocks:
            values = _values(study, block, variables, sizes)
            for name, array in values.items():
                data[name][first : first + len(array)] = array
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


def _variables_of(study: Study, blocks: Sequence[Block]) -> tuple[_Variables, dict[str, int]]:
    """Return the variables of the results of some blocks, and the sizes of all axes by name."""
    shapes: dict[tuple[str, tuple[int, ...]], None] = {}
    kinds: dict[str, Any] = {}
    for block in blocks:
        with opened(block.path) as file:
            for name, data in file.items():
                if name in STORED:
                    shapes[name, data.shape] = None
                elif name not in kinds or data.dtype.itemsize > kinds[name].itemsize:
                    kinds[name] = data.dtype
    axes, sizes = axes_of(shapes)
    sizes = {"step": 1, "element": 1, **sizes, "case": len(study)}
    variables: _Variables = {"case": (OF_CASES["case"], _text_type(kinds["case"].itemsize))}
    for name, column in zip(study.names, study.columns, strict=True):
        kind = np.dtype(float)
        if column.numbers is None:
            kind = _text_type(max(len(_cell(value).encode()) for value in column.distinct))
        unit = study.units()[name] or "1"
        variables[name] = Variable(name, ("case",), unit, own_key(name).meaning), kind
    if "pressure" in axes:
        axes[EDGE_ELEMENT.name] = axes["pressure"]
    for name, dimensions in axes.items():
        variable = STORED.get(name, EDGE_ELEMENT)
        if "step" in variable.dimensions and "step" not in dimensions:
            variable = variable.at_last_step()
        variable = replace(variable, dimensions=("case", *dimensions), integer=False)
        side = name == POINT_SIDE.name
        kind = _text_type(max(map(len, POINT_SIDES))) if side else np.dtype(float)
        variables[name] = variable, kind
    for end_value in END_VALUES.values():
        if end_value.source in axes:
            variables.setdefault(end_value.stored.name, (end_value.stored, np.dtype(float)))
    for name, variable in OF_CASES.items():
        kind = kinds[name]
        variables[name] = variable, _text_type(kind.itemsize) if kind.kind == "S" else kind
    return variables, sizes


def _text_type(size: int) -> Any:
    """Return the type of texts of so many bytes."""
    return h5py.string_dtype("utf-8", max(size, 1))


def _make(file: h5py.File, variables: _Variables, sizes: Mapping[str, int]) -> None:
    """Make the axes and the variables, without values."""
    for axis, size in sizes.items():
        if axis != "case":
            scale = {"step": _STATE, "element": ELEMENT, **AXES}[axis]
            file.create_dataset(axis, data=np.arange(size)).make_scale(axis)
            file[axis].attrs.update(scale.attributes)
    for name, (variable, kind) in variables.items():
        shape = tuple(sizes[axis] for axis in variable.dimensions)
        chunk = list(shape)
        for i in range(len(shape)):  # as many whole cases as are small, else parts of one
            rest = kind.itemsize * math.prod(chunk[i + 1 :])
            chunk[i] = min(shape[i], max(1, int(_CHUNK_BYTES // rest)))
        data = file.create_dataset(
            name, shape, kind, chunks=tuple(chunk),
            fillvalue=np.nan if kind.kind == "f" else None, **PACKED,
        )  # fmt: skip
        data.attrs.update({**variable.attributes, **(_ENCODED if kind.kind == "S" else {})})
        if name == "case":
            data.make_scale(name)
        for i, dimension in enumerate(variable.dimensions):
            if dimension != name:
                data.dims[i].attach_scale(file[dimension])


def _values(
    study: Study, block: Block, variables: _Variables, sizes: Mapping[str, int]
) -> dict[str, Any]:
    """Return the values of a block's cases by name, (cases, ...); raises as ``merge``."""
    with opened(block.path) as file:
        tables: dict[str, Any] = {name: data[()] for name, data in file.items()}
    count, rows = len(block.numbers), tables["steps_stored"]
    for name, (variable, _) in variables.items():
        if name in STORED:
            shape = tuple(sizes[axis] for axis in variable.dimensions[1:])
            known = tables.get(name, np.full((count, *shape), np.nan))
            tables[name] = padded(name, known, shape, rows)
    if "pressure" in tables:
        pressure = tables["pressure"]
        edges = np.where(np.isnan(pressure), np.nan, edge_elements(pressure))
        tables[EDGE_ELEMENT.name] = edges
    for end_value in END_VALUES.values():
        if end_value.source in tables:
            tables.setdefault(end_value.stored.name, end_value.of(tables))
    if POINT_SIDE.name in tables:
        tables[POINT_SIDE.name] = side_words(tables[POINT_SIDE.name])
    for name, column in zip(study.names, study.columns, strict=True):
        part = column.part(block.numbers)
        tables[name] = part.numbers
        if column.numbers is None:
            tables[name] = np.array([cell.encode() for cell in part.by_case(_cell)])
    return {name: tables[name].astype(kind) for name, (_, kind) in variables.items()}


def _columns(study: Study, block: Block, values: Mapping[str, Any]) -> dict[str, Sequence[str]]:
    """Return the columns of the table of a block's cases."""
    columns: dict[str, Sequence[str]] = {"case": _cells(values["case"])}
    for name, column in zip(study.names, study.columns, strict=True):
        columns[name] = column.part(block.numbers).by_case(_cell)
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


def _cell(value: Any) -> str:
    """Return the text of a varied key's value."""
    if isinstance(value, str):
        return value
    return "" if value is None else toml_value(value)
