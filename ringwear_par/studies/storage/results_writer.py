"""The results of a sweep: ``results.h5``, one file for xarray, and ``cases.csv``, one row a case.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Both files appear by rename.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.storage.hdf5 import atomic_hdf5
from ringwear_par.results.storage.result_variables import side_words
from ringwear_par.results.variables import (
    EDGE_ELEMENT,
    HISTORIES,
    LINE,
    POINT_SIDE,
    STEP,
    Variable,
    edge_elements,
)
from ringwear_par.studies.definition.variations import Column
from ringwear_par.studies.storage.blocks import STATUS, CaseBlock, Kind
from ringwear_par.studies.storage.case_index import ENTRY, CaseIndex
from ringwear_par.studies.storage.case_table import TABLE_MEANINGS, CaseTable, Words, extended
from ringwear_par.studies.storage.case_variables import (
    WINDOW,
    CaseVariable,
    make_scales,
    text_dtype,
    write_texts,
)
from ringwear_par.studies.storage.end_values import BY_SOURCE, STRESS_STATES, last_with_stress
from ringwear_par.studies.storage.padded_tables import CommonSteps, body_last, fill
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
            for axis, size in block.sizes.items():
                if axis in AXES:
                    axes[axis] = max(size, axes.get(axis, 0))
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
            for name in {*FIELDS, EDGE_ELEMENT.name} & variables.keys():
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
        steps = CommonSteps()
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
        for source, end_value in BY_SOURCE.items():
            if source not in tables:
                continue
            table = tables[source]
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
        varied, count = self._list.varied, len(self._cases)
        known = min((len(column) for column in varied.values()), default=count)
        windows = (np.arange(at, min(at + WINDOW, count)) for at in range(known, count, WINDOW))
        used, code = np.unique(self._cases["kind"], return_inverse=True)
        none = Kind("")
        kinds = [self._list.index.kinds[i] if i >= 0 else none for i in used.tolist()]
        return CaseTable(
            self._list.ids,
            extended(varied, (text for cases in windows for text in self._texts(cases))),
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
