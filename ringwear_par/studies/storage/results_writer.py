"""The results of a sweep: ``results.h5``, one file for xarray, and ``cases.csv``, one row a case.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Both files appear by rename.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.files.writing import atomic_write
from ringwear_par.parallel import results_of_tasks
from ringwear_par.results.hdf5 import atomic_hdf5
from ringwear_par.results.variables import (
    EDGE_ELEMENT,
    HISTORIES,
    LINE,
    POINT_SIDE,
    POINT_SIDES,
    Variable,
)
from ringwear_par.studies.definition.variations import Column
from ringwear_par.studies.storage.blocks import STATUS, CaseBlock, Kind
from ringwear_par.studies.storage.case_index import ENTRY, CaseIndex
from ringwear_par.studies.storage.case_table import CaseTable, extended
from ringwear_par.studies.storage.case_variables import (
    WINDOW,
    CaseVariable,
    make_scales,
    stretches,
    text_dtype,
)
from ringwear_par.studies.storage.case_windows import CaseWindow, texts_of
from ringwear_par.studies.storage.results_file import (
    RESULTS,
    SOFTWARE,
    TABLE,
    cases_at_once,
    join_flags,
    power_of_2,
)
from ringwear_par.studies.storage.stored_variables import (
    AXES,
    FIELDS,
    OF_CASES,
    STORED,
    over_cases,
)

#: fewest cases that a rank fills together
_LEAST_WINDOW = 1024
#: of the longest name of a point's side
_SIDE_BYTES = max(map(len, POINT_SIDES))


@dataclass(frozen=True, eq=False)
class CaseList:
    """The cases as the files list them, in arrays (cases,)."""

    #: by key, raw values in the first of the cases; those of the rest are looked up in their texts
    varied: Mapping[str, Column]
    #: bytes
    ids: Any
    #: whether the study still has the case
    in_study: BoolArray
    #: the stored cases, and where each case is among them, -1: it was not begun
    index: CaseIndex
    entry: IntArray
    #: returns the texts of cases by their numbers, where they are not stored
    texts: Callable[[IntArray], list[str]]
    #: of the varied keys, "" for none
    units: Mapping[str, str]


def write_results(
    folder: Path, cases: CaseList, attributes: Mapping[str, Any], comm: MPI.Comm
) -> None:
    """Write results of cases by rename. On rank 0 of comm only.

    Within ``parallel.with_help_of_all``.
    """
    with (
        atomic_write(folder / TABLE) as rows,  # both are whole before one is replaced
        atomic_hdf5(folder / RESULTS) as file,
    ):
        writer = _Writer(file, cases)
        table = writer.case_table(writer.write_histories(comm))
        table.store(file)
        file.attrs.update({"software": SOFTWARE, **attributes})
        table.write_csv(rows, comm, _window(len(cases.ids), comm))


class _Writer:
    """Fills an empty results file, window by window of cases."""

    def __init__(self, file: h5py.File, cases: CaseList) -> None:
        self._file, self._list = file, cases
        #: the entry of each case
        self._cases = np.zeros(len(cases.entry), dtype=ENTRY)
        self._cases["seconds"] = self._cases["imbalance"] = np.nan
        self._cases["kind"] = self._cases["block"] = -1
        self._stored = cases.entry >= 0
        self._cases[self._stored] = cases.index.entries[cases.entry[self._stored]]
        numbers = np.unique(self._cases["block"][self._stored]).tolist()
        self._blocks = {number: cases.index.blocks[number] for number in numbers}
        axes: dict[str, int] = {}
        for block in self._blocks.values():
            for axis, size in block.sizes.items():
                if axis in AXES:
                    axes[axis] = max(size, axes.get(axis, 0))
        make_scales(
            file, cases.ids, int(self._cases["rows"].max(initial=0)) or 1,
            int(self._cases["elements"].max(initial=0)) or 1, axes,
        )  # fmt: skip

    def _variables(self) -> dict[str, Variable]:
        """Return the variables that the file is to have of each case's history."""
        names = {name for block in self._blocks.values() for name in block.axes}
        deep = any(block.deep for block in self._blocks.values())
        variables = {
            name: v for name, v in STORED.items() if name in names | HISTORIES.keys() | LINE.keys()
        }
        if "pressure" in names:
            variables[EDGE_ELEMENT.name] = EDGE_ELEMENT
        if not deep:
            for name in {*FIELDS, EDGE_ELEMENT.name} & variables.keys():
                variables[name] = variables[name].at_last_step()
        return variables

    def write_histories(self, comm: MPI.Comm) -> dict[str, FloatArray]:
        """Write the histories and texts of the cases, window by window, which all ranks fill.

        Return the end values by name, (cases,) or (cases, layers or points).
        """
        variables, count = self._variables(), len(self._cases)
        longest = max((block.longest for block in self._blocks.values()), default=1)
        for part in stretches(count, WINDOW):
            longest = max(longest, *(len(text.encode()) for text in self._missing_texts(part)), 1)
        size = longest + sum(
            8 * math.prod(len(self._file[axis]) for axis in variable.dimensions)
            for variable in variables.values()
        )
        window = min(cases_at_once(size), _window(count, comm))
        columns = {
            name: CaseVariable(
                self._file, over_cases(variable),
                text_dtype(_SIDE_BYTES) if name == POINT_SIDE.name else np.dtype(float), window,
            )
            for name, variable in variables.items()
        }  # fmt: skip
        texts = CaseVariable(self._file, OF_CASES["case_toml"], text_dtype(longest), window)
        chunks = {name: column.chunks for name, column in columns.items()}
        columns[texts.chunks.name] = texts
        windows = (
            CaseWindow(
                self._cases[part], self._blocks_of(part), chunks, self._missing_texts(part),
                texts.chunks,
            )
            for part in stretches(count, window)
        )  # fmt: skip
        end_values: dict[str, FloatArray] = {}
        with closing(results_of_tasks(comm, (cases.fill for cases in windows))) as filled:
            for part, window_values in zip(stretches(count, window), filled, strict=True):
                for name, packed in window_values.chunks.items():
                    columns[name].write(part.start, packed)
                for name, values in window_values.end_values.items():
                    if not part.start:
                        end_values[name] = np.full((count, *values.shape[1:]), np.nan)
                    end_values[name][part] = values
        return end_values

    def _blocks_of(self, cases: slice) -> dict[int, CaseBlock]:
        numbers = np.unique(self._cases["block"][cases]).tolist()
        return {number: self._blocks[number] for number in numbers if number >= 0}

    def _missing_texts(self, cases: slice) -> list[str]:
        """Return the texts of those of some cases that were not begun."""
        missing = np.flatnonzero(~self._stored[cases])
        return self._list.texts(cases.start + missing) if len(missing) else []

    def case_table(self, end_values: Mapping[str, FloatArray]) -> CaseTable:
        """Return the numbers and words of all cases."""
        varied, count = self._list.varied, len(self._cases)
        known = min((len(column) for column in varied.values()), default=count)
        gone = (self._cases[known:][part] for part in stretches(count - known, WINDOW))
        used, code = np.unique(self._cases["kind"], return_inverse=True)
        none = Kind("")
        kinds = [self._list.index.kinds[i] if i >= 0 else none for i in used.tolist()]
        return CaseTable(
            self._list.ids,
            extended(varied, (text for cases in gone for text in texts_of(cases, self._blocks))),
            {
                "status": Column.chosen(STATUS, self._cases["status"]),
                "error": Column.chosen([kind.error for kind in kinds], code),
                "in_study": Column.chosen(("no", "yes"), self._list.in_study.astype(int)),
                "version": Column.chosen([kind.version for kind in kinds], code),
                "flags": Column.chosen([join_flags(kind.flags) for kind in kinds], code),
            },
            {
                name: self._cases[{"steps_stored": "rows"}.get(name, name)]
                for name in ("seconds", "imbalance", "steps_stored", "elements")
            },
            end_values,
            self._list.units,
        )


def _window(count: int, comm: MPI.Comm) -> int:
    """Return how many of so many cases a rank works on together, at most."""
    return min(WINDOW, max(power_of_2(count / comm.size), _LEAST_WINDOW))
