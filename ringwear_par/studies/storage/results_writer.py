"""The results of a sweep: ``results.h5``, one file for xarray, and ``cases.csv``, one row a case.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Both files appear by rename.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.values import is_number
from ringwear_par.errors import InputError
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.storage.hdf5 import atomic_hdf5
from ringwear_par.results.stress_variables import side_words
from ringwear_par.results.variables import (
    EDGE_ELEMENT,
    HISTORIES,
    LINE,
    POINT_SIDE,
    STEP,
    Variable,
    edge_elements,
)
from ringwear_par.studies.definition.variations import Column, value_of
from ringwear_par.studies.storage.blocks import BY_STATE, STATUS, CaseBlock, Kind
from ringwear_par.studies.storage.case_index import ENTRY, CaseIndex
from ringwear_par.studies.storage.case_table import TABLE_MEANINGS, CaseTable, Words
from ringwear_par.studies.storage.case_variables import (
    WINDOW,
    CaseVariable,
    make_scales,
    text_dtype,
    write_texts,
)
from ringwear_par.studies.storage.end_values import BY_SOURCE, STRESS_STATES, last_with_stress
from ringwear_par.studies.storage.results_file import (
    RESULTS,
    SAME_STEPS,
    SOFTWARE,
    TABLE,
    cases_at_once,
    join_flags,
)
from ringwear_par.studies.storage.stored_variables import (
    AXES,
    FIELDS,
    OF_CASES,
    STORED,
    STRESS,
    has_layers,
    over_cases,
)


@dataclass(frozen=True, eq=False)
class CaseList:
    """The cases as the files list them, in arrays (cases,).

    Parameters
    ----------
    varied : by key, raw values in the first of the cases; those of the rest are looked up in their
        texts.
    ids : bytes.
    in_study : whether the study still has the case.
    index, entry : the stored cases, and where each case is among them, -1: it was not begun.
    texts : returns the texts of cases by their numbers, where they are not stored.
    """

    varied: Mapping[str, Column]
    ids: Any
    in_study: BoolArray
    index: CaseIndex
    entry: IntArray
    texts: Callable[[IntArray], list[str]]


def write_results(folder: Path, cases: CaseList, attributes: Mapping[str, Any]) -> None:
    """Write the files by rename, the units of the table beside it. Call on one rank only.

    Parameters
    ----------
    folder : of the sweep.
    cases : to be listed.
    attributes : of the HDF5 file.

    Raises
    ------
    DamagedError : one of the files that are read.
    OSError : the disk or the folder.
    """
    with (
        atomic_write(folder / TABLE) as rows,  # all are whole before one is replaced
        atomic_write(folder / TABLE_MEANINGS) as meanings,
        atomic_hdf5(folder / RESULTS) as (file, check_disk),
    ):
        writer = _Writer(file, cases, check_disk)
        end_values = writer.write_histories()
        writer.write_texts()
        table = writer.case_table(end_values)
        table.store(file)
        file.attrs.update({"software": SOFTWARE, **attributes})
        table.write_csv(rows)
        meanings.write_text(table.meanings(file), encoding="utf-8")


class _Writer:
    """Fills a results file, window by window of cases.

    Parameters
    ----------
    file : empty.
    cases : to be listed.
    check_disk : raises the error that the disk has failed with.
    """

    def __init__(self, file: h5py.File, cases: CaseList, check_disk: Callable[[], None]) -> None:
        self._file, self._list, self._check_disk = file, cases, check_disk
        #: the entry of each case
        self._cases = np.zeros(len(cases.entry), dtype=ENTRY)
        self._cases["seconds"] = self._cases["imbalance"] = np.nan
        self._cases["kind"] = self._cases["block"] = -1
        self._stored = cases.entry >= 0
        self._cases[self._stored] = cases.index.entries[cases.entry[self._stored]]
        self._rows = self._cases["rows"]
        numbers = np.unique(self._cases["block"][self._stored])
        self._blocks = [cases.index.blocks[block] for block in numbers.tolist()]
        axes: dict[str, int] = {}
        for block in self._blocks:
            for axis in AXES.keys() & block.sizes.keys():
                axes[axis] = max(block.sizes[axis], axes.get(axis, 0))
        make_scales(
            file, cases.ids, int(self._rows.max(initial=0)) or 1,
            int(self._cases["elements"].max(initial=0)) or 1, axes,
        )  # fmt: skip

    def _by_block(self, cases: IntArray) -> Iterator[tuple[CaseBlock, IntArray]]:
        """Yield the blocks of some stored cases, with the cases of each."""
        cases = cases[np.argsort(self._cases["block"][cases], kind="stable")]
        numbers = self._cases["block"][cases]
        for part in np.split(cases, np.flatnonzero(np.diff(numbers)) + 1) if len(cases) else ():
            yield self._list.index.blocks[self._cases["block"][part[0]]], part

    # -- histories ---------------------------------------------------------------------------------

    def _variables(self) -> dict[str, Variable]:
        """Return the variables that the file is to have of each case's history."""
        names = {name for block in self._blocks for name in block.axes}
        deep = any(block.deep for block in self._blocks)
        variables = {
            name: v for name, v in STORED.items() if name in names | HISTORIES.keys() | LINE.keys()
        }
        if "pressure" in names:
            variables[EDGE_ELEMENT.name] = EDGE_ELEMENT
        if not deep:
            for name in variables.keys() & {*FIELDS, EDGE_ELEMENT.name}:
                variables[name] = variables[name].at_last_step()
        return variables

    def write_histories(self) -> dict[str, FloatArray]:
        """Write the variables of the cases' histories, block by block of a window of cases.

        Return the end values by name, (cases,) or (cases, layers or points).
        """
        variables, count = self._variables(), len(self._cases)
        shapes = {
            name: tuple(len(self._file[axis]) for axis in variable.dimensions)
            for name, variable in variables.items()
        }
        window = cases_at_once(8 * sum(map(math.prod, shapes.values())))
        columns: dict[str, CaseVariable] = {}
        end_values: dict[str, FloatArray] = {}
        steps = _CommonSteps()
        for start in range(0, max(count, 1), window):
            stop = min(start + window, count)
            tables = {
                name: np.full((stop - start, *shape), np.nan) for name, shape in shapes.items()
            }
            for block, cases in self._by_block(start + np.flatnonzero(self._rows[start:stop])):
                places, stored = self._cases["place"][cases], block.read((STEP.name, *variables))
                steps.add(stored.pop(STEP.name, None), block.offsets, places)
                for name, values in stored.items():
                    if has_layers(variables[name]):
                        values = body_last(values, tables[name].shape[-1])
                    fill(tables[name], cases - start, values, block, name, places)
            if EDGE_ELEMENT.name in tables:
                pressure = tables["pressure"]
                edges = np.where(np.isnan(pressure), np.nan, edge_elements(pressure))
                tables[EDGE_ELEMENT.name] = edges
            for name, values in self._end_values(start, tables):
                if not start:
                    end_values[name] = np.full((count, *values.shape[1:]), np.nan)
                end_values[name][start:stop] = values
            for name, table in tables.items():
                kind: Any = float
                if name == POINT_SIDE.name:
                    table = side_words(table)
                    kind = text_dtype(table.dtype.itemsize)
                    table = table.astype(kind)
                if not start:
                    columns[name] = CaseVariable(
                        self._file, over_cases(variables[name]), kind, window, sample=table
                    )
                columns[name].write(start, table)
                self._check_disk()
        if steps.names is not None and len(steps.names) == len(self._file["step"]):
            self._file["step"][:] = steps.names.astype(int)
            self._file["step"].attrs.update({"long_name": STEP.meaning, SAME_STEPS: 1})
        return end_values

    def _end_values(
        self, start: int, tables: Mapping[str, FloatArray]
    ) -> Iterator[tuple[str, FloatArray]]:
        """Yield the end values of a window of cases."""
        stressed = tables.get(STRESS_STATES)
        for source in tables.keys() & BY_SOURCE.keys():
            end_value, table = BY_SOURCE[source], tables[source]
            last = self._rows[start : start + len(table)] - 1
            if source in STRESS and stressed is not None:
                last = last_with_stress(stressed)
            yield end_value.name, end_value.of(table, last)

    # -- one of each case --------------------------------------------------------------------------

    def _texts(self, cases: IntArray) -> list[str]:
        """Return the texts of some cases."""
        texts = np.empty(len(cases), dtype=object)
        stored = self._stored[cases]
        where = np.flatnonzero(stored)
        for block, part in self._by_block(cases[stored]):
            at = where[np.searchsorted(cases[stored], part)]
            texts[at] = block.texts(self._cases["place"][part].tolist())
        if not stored.all():
            texts[~stored] = self._list.texts(cases[~stored])
        return texts.tolist()

    def write_texts(self) -> None:
        """Write the texts of all cases."""
        longest = max((block.longest for block in self._blocks), default=1)
        missing = np.flatnonzero(~self._stored)
        for start in range(0, len(missing), WINDOW):
            texts = self._list.texts(missing[start : start + WINDOW])
            longest = max(longest, *(len(text.encode()) for text in texts))

        def part(cases: slice) -> Any:
            texts = self._texts(np.arange(cases.start, cases.stop))
            return np.array([text.encode() for text in texts], dtype=text_dtype(longest))

        write_texts(self._file, OF_CASES["case_toml"], longest, part)
        self._check_disk()

    def case_table(self, end_values: Mapping[str, FloatArray]) -> CaseTable:
        """Return the numbers and words of all cases."""
        used, code = np.unique(self._cases["kind"], return_inverse=True)
        none = Kind("")
        kinds = [self._list.index.kinds[i] if i >= 0 else none for i in used.tolist()]
        return CaseTable(
            self._list.ids,
            self._varied(),
            {
                "status": Words.of(STATUS, self._cases["status"]),
                "error": Words.of([kind.error for kind in kinds], code),
                "in_study": Words.of(("no", "yes"), self._list.in_study.astype(int)),
                "version": Words.of([kind.version for kind in kinds], code),
                "flags": Words.of([join_flags(kind.flags) for kind in kinds], code),
            },
            {
                name: self._cases[{"steps_stored": "rows"}.get(name, name)]
                for name in ("seconds", "imbalance", "steps_stored", "elements")
            },
            end_values,
        )

    def _varied(self) -> dict[str, Column]:
        """Return the varied keys of all cases, None where a case has no such."""
        varied, count = self._list.varied, len(self._cases)
        known = min((len(column) for column in varied.values()), default=count)
        looked_up: list[tuple[Any, ...]] = []
        for start in range(known, count, WINDOW):
            texts = self._texts(np.arange(start, min(start + WINDOW, count)))
            looked_up += [_values_in(text, tuple(varied)) for text in texts]
        rest = zip(*looked_up, strict=True) if looked_up else [()] * len(varied)
        return {
            name: _extended(column, values)
            for (name, column), values in zip(varied.items(), rest, strict=True)
        }


def _values_in(text: str, names: Sequence[str]) -> tuple[Any, ...]:
    """Return the varied keys of a case that the study no longer has, None where it has no such."""
    try:
        keys = read_keys(text)
        return tuple(value_of(keys, name) for name in names)
    except InputError:
        return (None,) * len(names)


def _extended(column: Column, values: Sequence[Any]) -> Column:
    """Return a column with further cases, which have values of their own."""
    if not values:
        return column
    if (
        isinstance(column.values, np.ndarray)
        and column.codes is None
        and all(map(is_number, values))
    ):
        return Column(np.concatenate([column.values, np.array(values, dtype=np.float64)]))
    codes = np.arange(len(column)) if column.codes is None else column.codes
    more = len(column.values) + np.arange(len(values))
    return Column((*column.there, *values), np.concatenate([codes, more]))


# -- columns of blocks in padded tables ------------------------------------------------------------


def fill(
    table: Any, at: IntArray, values: Any, block: CaseBlock, name: str, places: IntArray
) -> None:
    """Put a column of a block into a table of some of its cases that is padded with NaN.

    Parameters
    ----------
    table : (cases, ...), changed.
    at : rows of the table, those of the cases.
    values : the column.
    block, name : that it is of.
    places : of the cases in the block.
    """
    lengths = block.offsets[places + 1] - block.offsets[places]
    cells = tuple(map(slice, np.minimum(table.shape[2:], values.shape[1:]).tolist()))
    if block.axes[name] != BY_STATE:
        values = values if len(values) == 1 else values[places]
        if "step" not in STORED[name].dimensions or table.ndim == values.ndim:
            cells = tuple(map(slice, np.minimum(table.shape[1:], values.shape[1:]).tolist()))
            table[(_run(at), *cells)] = values[(slice(None), *cells)]
        else:  # the last of a field that the table has at all states
            table[(at, lengths - 1, *cells)] = values[(slice(None), *cells)]
        return
    if not lengths.sum():
        return
    values = values[(slice(None), *cells)]
    starts, to, taken = block.offsets[places], _run(at), _run(places)
    if isinstance(to, slice) and isinstance(taken, slice):
        part, longest = values[starts[0] : starts[0] + lengths.sum()], int(lengths.max())
        inside = table[(to, slice(longest), *cells)]
        if (lengths == longest).all():
            inside[...] = part.reshape(inside.shape)
        else:
            inside[np.arange(longest) < lengths[:, None]] = part
        return
    step = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    table[(np.repeat(at, lengths), step, *cells)] = values[step + np.repeat(starts, lengths)]


def body_last(values: FloatArray, width: int) -> FloatArray:
    """Return a column by layer with so many of these, the body itself the last of them.

    Cases may have fewer layers than others of their sweep: these have NaN before the body.
    """
    layers = values.shape[-1] - 1
    if layers + 1 == width:
        return values
    wider = np.full((*values.shape[:-1], width), np.nan)
    wider[..., :layers], wider[..., -1] = values[..., :-1], values[..., -1]
    return wider


def _run(numbers: IntArray) -> slice | IntArray:
    """Return increasing numbers without gaps as a slice, others as they are."""
    first, last = int(numbers[0]), int(numbers[-1])
    if last - first + 1 == len(numbers) and (np.diff(numbers) == 1).all():
        return slice(first, last + 1)
    return numbers


class _CommonSteps:
    """Names of the stored states, as long as all cases begin with the same."""

    def __init__(self) -> None:
        self.names: FloatArray | None = np.empty(0)

    def add(self, steps: Any, offsets: IntArray, places: IntArray) -> None:
        """Compare with those of some cases of a block, None where they differ among these."""
        if self.names is None or steps is None:
            self.names = None
            return
        starts, rows = offsets[places], offsets[places + 1] - offsets[places]
        longest = int(rows.argmax())
        if rows[longest] > len(self.names):
            longer = steps[starts[longest] : starts[longest] + rows[longest]]
            if not np.array_equal(longer[: len(self.names)], self.names):
                self.names = None
                return
            self.names = np.array(longer)
        step = np.arange(rows.sum()) - np.repeat(np.cumsum(rows) - rows, rows)
        if not np.array_equal(steps[step + np.repeat(starts, rows)], self.names[step]):
            self.names = None
