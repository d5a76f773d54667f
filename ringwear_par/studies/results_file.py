"""The results of a sweep, ``results.h5`` and ``cases.csv``: all blocks merged, window by window.

Cases are in the order of the design. Histories shorter than the longest, and contact lines of fewer
elements than the finest, are padded with NaN; ``steps_stored`` and ``elements`` say how much is
there. Both files appear by rename. No more than a window of cases is in memory.
"""

import csv
import hashlib
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.files.text import toml_value
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.fields import side_words
from ringwear_par.results.variables import (
    EDGE_ELEMENT,
    ELEMENT,
    POINT_SIDE,
    POINT_SIDES,
    Variable,
    edge_elements,
)
from ringwear_par.studies.block_files import PACKED, axes_of, opened, put
from ringwear_par.studies.blocks import Block
from ringwear_par.studies.end_values import (
    BY_SOURCE,
    END_VALUES,
    STRESS_STATES,
    entries,
    last_with_stress,
)
from ringwear_par.studies.ensemble import RESULTS, SOFTWARE, TABLE
from ringwear_par.studies.stored_variables import AXES, OF_CASES, STORED, STRESS, over_cases
from ringwear_par.studies.study import Study
from ringwear_par.studies.variations import own_key
from ringwear_par.version import versions

#: bytes of the cases that are in memory, and most of them; bytes of a chunk of a variable
WINDOW_BYTES, _MOST, _CHUNK_BYTES = 16e6, 4096, 256e3
_ID = Variable("case", ("case",), "1", "case, by its content")
_STATE = Variable("step", ("step",), "1", "stored state of each case", integer=True)
#: with which xarray takes bytes for the texts that they are
_ENCODED = {"_Encoding": "utf-8"}


def fingerprint(blocks: Sequence[Block]) -> str:
    """Return the name of all blocks of a study together."""
    return hashlib.sha256("".join(block.path.stem for block in blocks).encode()).hexdigest()[:16]


def merge(study: Study, blocks: Sequence[Block], folder: Path, ranks: int) -> None:
    """Write the results of a study whose blocks are all there. On one rank.

    Raises
    ------
    DamagedError : a block is not whole.
    OSError, UnreadableError : the disk.
    """
    layout = _Layout.of(study, blocks)
    count, window = len(study), layout.window
    with (
        atomic_write(folder / TABLE) as rows, atomic_write(folder / RESULTS) as path,
        rows.open("w", newline="", encoding="utf-8") as table, _Disk(path) as disk,
    ):  # fmt: skip
        with h5py.File(disk, "w", libver=("v110", "v110")) as file:
            layout.make(file)
            for first in range(0, count, window):
                numbers = np.arange(first, min(first + window, count))
                values = layout.read(numbers)
                for name, array in values.items():
                    file[name][first : first + len(array)] = array
                _write_rows(table, study, numbers, values)
                disk.check()
            file.attrs.update(
                software=SOFTWARE, study=study.text, case=study.base_text, method=study.method,
                coordinates=" ".join(study.names), status="complete", ranks=ranks,
                blocks=fingerprint(blocks), **versions(),
            )  # fmt: skip
        disk.check()


@dataclass(frozen=True)
class _Layout:
    """The variables of a results file, and where their values are."""

    study: Study
    blocks: Sequence[Block]
    #: those over cases by name, with their types
    variables: dict[str, tuple[Variable, Any]]
    #: of the axes by name
    sizes: dict[str, int]
    #: (cases,) block of each case, and row in it
    block: IntArray
    row: IntArray

    @classmethod
    def of(cls, study: Study, blocks: Sequence[Block]) -> "_Layout":
        """Return the layout by the heads of all blocks; raises as ``merge``."""
        heads: list[tuple[str, Any]] = []
        for block in blocks:
            with opened(block.path) as file:
                heads += [(n, np.empty((0, *d.shape[1:]), d.dtype)) for n, d in file.items()]
        axes, sizes = axes_of([(name, head) for name, head in heads if name in STORED])
        sizes = {"step": 1, "element": 1, **sizes, "case": len(study)}
        number, text = np.dtype(np.float64), h5py.string_dtype
        variables = {"case": (_ID, text("utf-8", 16))}
        for name, column in zip(study.names, study.columns, strict=True):
            unit = study.units()[name] or "1"
            kind = number
            if column.numbers is None:
                kind = text("utf-8", max(len(_cell(v).encode()) for v in column.distinct) or 1)
            variables[name] = Variable(name, ("case",), unit, own_key(name).meaning), kind
        for name, dimensions in axes.items():
            variables[name] = _over_cases(STORED[name], dimensions), number
        if "pressure" in axes:
            edge = _over_cases(EDGE_ELEMENT, axes["pressure"])
            variables[edge.name] = edge, number
        for source, end_value in BY_SOURCE.items():
            if source in axes:
                variables.setdefault(end_value.stored.name, (end_value.stored, number))
        if POINT_SIDE.name in axes:
            side = variables[POINT_SIDE.name][0]
            variables[side.name] = side, text("utf-8", max(map(len, POINT_SIDES)))
        for name, variable in OF_CASES.items():
            kinds = [head.dtype for other, head in heads if other == name]
            kind = max(kinds, key=lambda dtype: dtype.itemsize)
            kind = text("utf-8", kind.itemsize) if kind.kind == "S" else kind
            variables[name] = variable, kind
        at = np.empty(len(study), dtype=np.int64)
        at[study.order] = np.arange(len(study))
        return cls(study, blocks, variables, sizes, *np.divmod(at, len(blocks[0].numbers)))

    @property
    def window(self) -> int:
        """How many cases to have in memory, a power of 2."""
        size = sum(kind.itemsize * self._of_a_case(v) for v, kind in self.variables.values())
        return min(1 << max(int(WINDOW_BYTES / size).bit_length() - 1, 0), _MOST)

    def _of_a_case(self, variable: Variable) -> int:
        return math.prod(self.sizes[axis] for axis in variable.dimensions[1:])

    def make(self, file: h5py.File) -> None:
        """Make the axes and the variables, without values."""
        for axis, size in self.sizes.items():
            if axis != "case":
                scale = {"step": _STATE, "element": ELEMENT, **AXES}[axis]
                file.create_dataset(axis, data=np.arange(size)).make_scale(axis)
                file[axis].attrs.update(scale.attributes)
        for name, (variable, kind) in self.variables.items():
            shape = tuple(self.sizes[axis] for axis in variable.dimensions)
            chunk = list(shape)
            for i in range(len(shape)):  # as many whole cases as are small, else parts of one
                rest = kind.itemsize * math.prod(chunk[i + 1 :])
                chunk[i] = min(shape[i], max(1, int(_CHUNK_BYTES // rest)))
            chunk[0] = min(chunk[0], self.window)
            data = file.create_dataset(
                name, shape, kind, chunks=tuple(chunk),
                fillvalue=np.nan if kind.kind == "f" else None, **PACKED,
            )  # fmt: skip
            data.attrs.update({**variable.attributes, **(_ENCODED if kind.kind == "S" else {})})
            if name == "case":
                data.make_scale(name)
        for variable, _ in self.variables.values():
            for i, dimension in enumerate(variable.dimensions):
                if dimension != variable.name:
                    file[variable.name].dims[i].attach_scale(file[dimension])

    def read(self, numbers: IntArray) -> dict[str, Any]:
        """Return the values of some cases, (cases, ...), by name; raises as ``merge``."""
        tables: dict[str, Any] = {}
        for name, (variable, kind) in self.variables.items():
            shape = len(numbers), *(self.sizes[axis] for axis in variable.dimensions[1:])
            numeric = kind.kind != "S" or name == POINT_SIDE.name
            fill = np.nan if kind.kind == "f" or name == POINT_SIDE.name else 0
            tables[name] = np.full(shape, fill) if numeric else np.zeros(shape, kind)
            if kind.kind == "i":
                tables[name] = tables[name].astype(kind)
        for number in np.unique(self.block[numbers]).tolist():
            at = np.flatnonzero(self.block[numbers] == number)
            rows = self.row[numbers[at]]
            low, high = int(rows.min()), int(rows.max()) + 1
            with opened(self.blocks[number].path) as file:
                steps = file["steps_stored"][low:high][rows - low]
                for name, data in file.items():
                    if name in STORED:
                        put(name, tables[name], at, data[low:high][rows - low], steps)
                    elif name in tables:
                        tables[name][at] = data[low:high][rows - low]
        if EDGE_ELEMENT.name in tables:
            pressure = tables["pressure"]
            edges = np.where(np.isnan(pressure), np.nan, edge_elements(pressure))
            tables[EDGE_ELEMENT.name] = edges
        last = tables["steps_stored"] - 1
        for source, end_value in BY_SOURCE.items():
            if source in tables:
                final = last if source not in STRESS else last_with_stress(tables[STRESS_STATES])
                tables[end_value.stored.name] = end_value.of(tables[source], final)
        if POINT_SIDE.name in tables:
            tables[POINT_SIDE.name] = side_words(tables[POINT_SIDE.name])
        for name, column in zip(self.study.names, self.study.columns, strict=True):
            known = column.numbers
            if known is not None:
                tables[name] = known[numbers]
            else:
                cells = column.part(numbers).by_case(_cell)
                tables[name] = np.array([cell.encode() for cell in cells])
        return {name: tables[name].astype(kind) for name, (_, kind) in self.variables.items()}


def _over_cases(variable: Variable, dimensions: tuple[str, ...]) -> Variable:
    """Return a variable of a case over all of them, perhaps of the last step alone."""
    last = "step" in variable.dimensions and "step" not in dimensions
    return over_cases(variable.at_last_step() if last else variable)


def _write_rows(file: TextIO, study: Study, numbers: IntArray, values: Mapping[str, Any]) -> None:
    """Write the rows of some cases to the table, a header before the first one."""
    columns: dict[str, Sequence[str]] = {"case": _cells(values["case"])}
    for name, column in zip(study.names, study.columns, strict=True):
        columns[name] = column.part(numbers).by_case(_cell)
    columns |= {name: _cells(values[name]) for name in ("status", "error")}
    for end_value in END_VALUES.values():
        if end_value.stored.name in values:
            for name, ends in entries(end_value, values[end_value.stored.name]).items():
                columns[name] = _cells(ends)
    columns["seconds"] = [f"{seconds:.4f}" for seconds in values["seconds"].tolist()]
    columns["flags"] = _cells(values["flags"])
    writer = csv.writer(file)
    if not numbers[0]:
        writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))


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


class _Disk(io.FileIO):
    """A file for HDF5 to write to, which may end the process where a disk is full.

    What the disk does not take stays in memory, until ``check`` says so.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "r+")
        self._error: OSError | None = None
        self._late: dict[int, bytes] = {}

    def check(self) -> None:
        """Raise the first error of the disk."""
        if self._error is not None:
            raise self._error

    def write(self, data: Any) -> int:
        """Write all of the data, or remember why it cannot be."""
        at, left = self.tell(), memoryview(data)
        size = len(left)
        try:
            while left and self._error is None:
                left = left[super().write(left) :]
        except OSError as error:
            self._error = error
        if left:
            self._late[at] = bytes(data)
            self.seek(at + size)
        return size

    def readinto(self, buffer: Any) -> int:
        """Read what was written, to the disk or not."""
        at, size = self.tell(), len(buffer)
        count = super().readinto(buffer)
        for start, data in self._late.items():
            first, last = max(start, at), min(start + len(data), at + size)
            if first < last:
                memoryview(buffer)[first - at : last - at] = data[first - start : last - start]
                count = size
        self.seek(at + count)
        return count

    def truncate(self, size: int | None = None) -> int:
        """Cut the file, as far as the disk takes it."""
        try:
            return super().truncate(size)
        except OSError as error:
            self._error = self._error or error
            return size or 0
