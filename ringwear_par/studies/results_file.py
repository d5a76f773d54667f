"""The files of a sweep: one for each block, then ``results.h5`` and ``cases.csv`` of all of them.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Cases are in the order of their
blocks, which is that of the design where only numbers vary; ``number`` is their place in it.
"""

import csv
import hashlib
import logging
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.cases.case import Case
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.files.text import toml_text
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.fields import side_words
from ringwear_par.results.files import UnreadableError, atomic_hdf5, reading
from ringwear_par.results.progress import Progress
from ringwear_par.results.result import HistoryColumns
from ringwear_par.results.variables import LINE, Variable, edge_elements
from ringwear_par.results.variables import axis as axis_of
from ringwear_par.studies import ensemble
from ringwear_par.studies.blocks import Block
from ringwear_par.studies.ensemble import END_VALUES, FILE_KIND, RESULTS, SOFTWARE, TABLE, VARIABLES
from ringwear_par.studies.study import Study
from ringwear_par.studies.variations import cell, own_key
from ringwear_par.version import __version__, versions

log = logging.getLogger(__name__)

#: how variables of the results are compressed; files of blocks, which are read once, are not
_PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
#: bytes that results may take beside their blocks
_MORE_BYTES = 1e6

#: shape without the axis of cases, and type, of each array
Layout = dict[str, tuple[tuple[int, ...], "np.dtype[Any]"]]


# -- of a block --------------------------------------------------------------------------------


def arrays_of(
    cases: Sequence[Case | InputError],
    parts: Sequence[tuple[IntArray, HistoryColumns]],
    errors: Mapping[int, Exception],
) -> dict[str, Any]:
    """Return what is stored of a block's cases, by name, (cases, ...), but their ids.

    Parameters
    ----------
    parts : places of cases in the block, and their histories.
    errors : why the others have none, by place.
    """
    tables = [(at, _stored(cases[at[0]], columns)) for at, columns in parts]
    if n := len(errors):
        failed = {
            "status": _encoded(["failed"] * n), "flags": _encoded([""] * n),
            "error": _encoded(map(reason_of, errors.values())),
            "seconds": np.zeros(n), "imbalance": np.zeros(n),
            "steps_stored": np.zeros(n, int), "elements": np.zeros(n, int),
        }  # fmt: skip
        tables.append((np.array([*errors]), failed))
    arrays: dict[str, Any] = {}
    for name, (shape, kind) in _layout(table for _, table in tables).items():
        fill = np.nan if kind.kind == "f" else kind.type()
        arrays[name] = np.full((len(cases), *shape), fill, kind)
        for at, table in tables:
            if name in table:
                _put(arrays[name], at, table[name], name)
    return derived(arrays)


def _stored(case: Any, columns: HistoryColumns) -> dict[str, Any]:
    """Return what is stored of cases with the contact line of one, (cases, ...) by name."""
    rows, line = np.diff(columns.offsets), case.line
    table = {
        "status": _encoded(columns.status),
        "error": _encoded(columns.reason),
        "flags": _encoded(map(", ".join, columns.flags)),
        "steps_stored": rows,
        "elements": np.where(rows, line.n, 0),
        "seconds": columns.seconds,
        "imbalance": columns.imbalance,
        **{name: np.tile(getattr(line, name), (len(rows), 1)) for name in LINE},
        **columns.whole,
    }
    there = np.arange(rows.max(initial=1)) < rows[:, None]
    for name, values in columns.data.items():
        table[name] = np.full((*there.shape, *values.shape[1:]), np.nan)
        table[name][there] = values
    return table


def derived(arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays of cases with what follows from them: end values, edges, words."""
    if "pressure" in arrays:
        edges = edge_elements(pressure := arrays["pressure"])
        arrays["edge_element"] = np.where(np.isnan(pressure), np.nan, edges)
    arrays |= ensemble.end_values(arrays)
    if "point_side" in arrays:
        arrays["point_side"] = side_words(arrays["point_side"])
    return arrays


def _encoded(texts: Iterable[str]) -> Any:
    return np.array([text.encode() for text in texts], dtype="S")


def _layout(tables: Iterable[Mapping[str, Any]]) -> Layout:
    """Return the least shape and type that the arrays of each name fit into."""
    layout: Layout = {}
    for table in tables:
        for name, values in table.items():
            shape, kind = layout.get(name, (values.shape[1:], values.dtype))
            largest = max(kind, values.dtype, key=lambda each: int(each.itemsize))
            layout[name] = tuple(map(max, shape, values.shape[1:])), largest
    return layout


def _put(whole: Any, at: Any, values: Any, name: str) -> None:
    """Write the values of some cases into an array with space for more states or elements."""
    cells = tuple(map(slice, values.shape[1:]))
    if VARIABLES[name].dimensions[-1].startswith("layer"):  # the body itself is the last
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
        file.attrs.update(software=SOFTWARE, version=__version__)
        for name, values in arrays.items():
            file.create_dataset(name, data=values, chunks=True, fletcher32=True)


# -- of all ------------------------------------------------------------------------------------


@contextmanager
def _opened(block: Block) -> Iterator[h5py.File]:
    """Yield the file of a block to read, see ``reading``; remove it if it is damaged."""
    try:
        with reading(block.path, SOFTWARE, "a block of a sweep") as file:
            yield file
    except UnreadableError:
        raise
    except InputError as error:
        log.warning("%s; it is removed, and its cases are computed anew", error)
        block.path.unlink()
        raise


def fingerprint(blocks: Sequence[Block]) -> str:
    """Return the name of all blocks of a study together."""
    return hashlib.sha256("".join(block.path.stem for block in blocks).encode()).hexdigest()[:16]


def is_merged(folder: Path, blocks: Sequence[Block]) -> bool:
    """Tell whether the results of these blocks are in a folder; InputError for others' files."""
    if not (folder / RESULTS).exists():
        return False
    with reading(folder / RESULTS, SOFTWARE, FILE_KIND) as file:
        return bool(file.attrs.get("blocks") == fingerprint(blocks))


def merge(study: Study, blocks: Sequence[Block], folder: Path, ranks: int) -> None:
    """Write the results of a study whose blocks are all there. On one rank.

    No more than a block is in memory; both files appear by rename.

    Raises
    ------
    InputError : a block cannot be read; one that is damaged is removed.
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
        closing(Progress(len(blocks))) as progress,
    ):  # fmt: skip
        _make(file, study, blocks)
        writer, first = csv.writer(table), 0
        for done, block in enumerate(blocks):
            progress.show(done, "%d of %d blocks are merged", done, len(blocks))
            some = slice(first, first + len(block.numbers))
            with _opened(block) as part:
                arrays = {name: data[()] for name, data in part.items()}
            for name, values in arrays.items():
                _put(file[name], some, values.astype(file[name].dtype), name)
            columns = _columns(file, study, block, some)
            if not first:
                writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
            first = some.stop
        file.attrs.update(
            software=SOFTWARE, study=study.text, case=toml_text(study.base), method=study.method,
            coordinates=" ".join(study.columns), status="complete", ranks=ranks,
            blocks=fingerprint(blocks), **versions(),
        )  # fmt: skip


def _make(file: h5py.File, study: Study, blocks: Sequence[Block]) -> None:
    """Make axes and variables of all blocks, as yet without values; varied keys with theirs."""

    def contents() -> Iterator[Mapping[str, Any]]:
        for block in blocks:
            with _opened(block) as part:
                yield part

    order = np.concatenate([block.numbers for block in blocks])
    keys = {name: study.stored(name)[order] for name in study.columns}
    layout = _layout(chain(contents(), [keys]))
    variables = {
        name: Variable(name, ("case",), unit or "1", own_key(name).meaning)
        for name, unit in study.units().items()
    }
    sizes = {"step": 1, "element": 1}
    for name, (shape, kind) in layout.items():
        if name not in keys:
            is_whole = len(VARIABLES[name].dimensions) == 1 + len(shape)
            variables[name] = VARIABLES[name] if is_whole else VARIABLES[name].at_last_step()
        sizes |= zip(variables[name].dimensions[1:], shape, strict=True)
        text = kind.kind == "S"
        data = file.create_dataset(
            name, (len(study), *shape), h5py.string_dtype("utf-8", kind.itemsize) if text else kind,
            fillvalue=np.nan if kind.kind == "f" else None, **_PACKED,
        )  # fmt: skip
        # with it xarray takes bytes for the texts that they are
        encoding = {"_Encoding": "utf-8"} if text else {}
        data.attrs.update(variables[name].attributes | encoding)
        if name in keys:
            data[...] = keys[name].astype(data.dtype)
        if name in study.ranges:
            data.attrs.update(zip(("spacing", "low", "high"), study.ranges[name], strict=True))
    for axis, size in sizes.items():
        file.create_dataset(axis, data=np.arange(size)).make_scale(axis)
        file[axis].attrs.update(axis_of(axis).attributes)
    file["step"].attrs["long_name"] = "stored state of each case"
    file["case"].make_scale("case")
    for name, variable in variables.items():
        for i, axis in enumerate(variable.dimensions):
            if name != axis:
                file[name].dims[i].attach_scale(file[axis])


def _columns(file: h5py.File, study: Study, block: Block, some: slice) -> dict[str, list[str]]:
    """Return the columns of the table of a block's cases, which are some of those in the file."""
    columns = {"case": file["case"][some]}
    columns |= {name: column[block.numbers] for name, column in study.columns.items()}
    columns |= {name: file[name][some] for name in ("status", "error")}
    for name, variable in END_VALUES.items():
        if variable.name in file:
            columns |= ensemble.columns_of(name, file[variable.name][some])
    columns["seconds"] = file["seconds"][some].round(4)
    columns |= {name: file[name][some] for name in ("flags", "number")}
    return {name: _texts(values) for name, values in columns.items()}


def _texts(values: Any) -> list[str]:
    """Return the texts of raw values, "" for NaN, or of bytes."""
    if values.dtype.kind == "S":
        return np.char.decode(values, "utf-8").tolist()
    return ["" if value != value else cell(value) for value in values.tolist()]
