"""``cases.csv``: numbers, defined in ``end_values``, and words of each case."""

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.values import is_number
from ringwear_par.errors import InputError
from ringwear_par.files.text import toml_value
from ringwear_par.parallel import results_of_tasks
from ringwear_par.results.variables import Variable
from ringwear_par.studies.definition.variations import Column, own_key, value_of
from ringwear_par.studies.storage.case_variables import (
    WINDOW,
    CaseVariable,
    stretches,
    text_dtype,
)
from ringwear_par.studies.storage.end_values import END_VALUES, entries
from ringwear_par.studies.storage.stored_variables import OF_CASES

#: columns of the table before and after the end values
_BEFORE, _AFTER = ("status", "error"), ("seconds", "in_study", "version", "flags")


@dataclass(frozen=True, eq=False)
class CaseTable:
    """Numbers and words of all cases."""

    #: (cases,) bytes
    ids: Any
    #: varied keys, None where a case has no such
    varied: Mapping[str, Column]
    #: by name, see ``OF_CASES``
    words: Mapping[str, Column]
    #: by name, see ``OF_CASES``, too
    numbers: Mapping[str, Any]
    #: by name, see ``END_VALUES``: (cases,) or (cases, layers or points)
    end_values: Mapping[str, FloatArray]
    #: of the varied keys, "" for none
    units: Mapping[str, str]

    def store(self, file: h5py.File) -> None:
        """Write the variables into a results file that does not have them yet."""
        for name, words in self.words.items():
            _store_texts(file, OF_CASES[name], words)
        for name, values in self.numbers.items():
            _store(file, OF_CASES[name], values)
        for name, values in self.end_values.items():
            stored = END_VALUES[name].stored
            if stored.name not in file:  # a time of a layer is an end value, and stored as it is
                _store(file, stored, values)
        for name, column in self.varied.items():
            self._store_varied(file, name, column)
        file.attrs["coordinates"] = " ".join(self.varied)

    def _store_varied(self, file: h5py.File, name: str, column: Column) -> None:
        """Write a varied key, as texts where its values are not all numbers."""
        variable = Variable(name, ("case",), self.units[name] or "1", own_key(name).meaning)
        if column.numbers is not None:
            _store(file, variable, column.numbers)
        elif all(value is None or is_number(value) for value in column.distinct):
            values = column.by_case(lambda value: math.nan if value is None else float(value))
            _store(file, variable, np.array(values))
        else:
            _store_texts(file, variable, column.mapped(_cell))

    def part(self, cases: slice) -> "CaseTable":
        """Return the table of some of the cases."""
        return CaseTable(
            self.ids[cases],
            {name: column.part(cases) for name, column in self.varied.items()},
            {name: column.part(cases) for name, column in self.words.items()},
            {name: values[cases] for name, values in self.numbers.items()},
            {name: values[cases] for name, values in self.end_values.items()},
            self.units,
        )

    def write_csv(self, path: Path, comm: MPI.Comm, window: int) -> None:
        """Write the table, so many rows at a time, which all ranks write out. On rank 0 of comm.

        Within ``parallel.with_help_of_all``.
        """
        header = ("case", *self.varied, *_BEFORE, *self._columns(), *_AFTER)
        parts = (self.part(cases).csv_rows for cases in stretches(len(self.ids), window))
        with (
            path.open("w", newline="", encoding="utf-8") as handle,
            closing(results_of_tasks(comm, parts)) as texts,
        ):
            csv.writer(handle).writerow(header)
            handle.writelines(texts)

    def csv_rows(self) -> str:
        """Return the rows as CSV, without a header. Not collective."""
        text = StringIO()
        csv.writer(text).writerows(self._rows())
        return text.getvalue()

    def _columns(self) -> dict[str, FloatArray]:
        """Return the end values by column of the table, in its order."""
        columns: dict[str, FloatArray] = {}
        for name, end_value in END_VALUES.items():
            if name in self.end_values:
                columns |= entries(end_value, self.end_values[name])
        return columns

    def _rows(self) -> Iterator[tuple[str, ...]]:
        seconds = self.numbers["seconds"].tolist()
        words = {name: column.by_case() for name, column in self.words.items()}
        return zip(
            self.ids.astype(str).tolist(),
            *(column.by_case(_cell) for column in self.varied.values()),
            *(words[name] for name in _BEFORE),
            *map(_cells, self._columns().values()),
            ["" if v != v else f"{v:.4f}" for v in seconds],
            *(words[name] for name in _AFTER[1:]),
            strict=True,
        )


def _store(file: h5py.File, variable: Variable, values: Any) -> None:
    """Write numbers of all cases, (cases,) or more."""
    column = CaseVariable(file, variable, values.dtype, WINDOW)
    column.write_all(lambda cases: values[cases])


def _store_texts(file: h5py.File, variable: Variable, column: Column) -> None:
    texts = [text.encode() for text in column.distinct]
    kind = text_dtype(max(map(len, texts), default=1))
    distinct = np.array(texts, dtype=kind)
    stored = CaseVariable(file, variable, kind, WINDOW)
    stored.write_all(lambda cases: distinct[column.codes[cases]])


def extended(varied: Mapping[str, Column], texts: Iterable[str]) -> dict[str, Column]:
    """Return columns of varied keys with more cases, by their texts; None where one has none."""
    rows = [_values_in(text, tuple(varied)) for text in texts]
    if not rows:
        return dict(varied)
    values_of_keys = zip(*rows, strict=True)
    return {
        name: _joined(column, values)
        for (name, column), values in zip(varied.items(), values_of_keys, strict=True)
    }


def _values_in(text: str, names: Sequence[str]) -> tuple[Any, ...]:
    try:
        keys = read_keys(text)
        return tuple(value_of(keys, name) for name in names)
    except InputError:
        return (None,) * len(names)


def _joined(column: Column, values: Sequence[Any]) -> Column:
    """Return a column with further cases, each with a value of its own."""
    distinct = column.distinct
    more = len(distinct) + np.arange(len(values))
    return Column.chosen([*distinct, *values], np.concatenate([column.codes, more]))


def _cells(values: FloatArray) -> list[str]:
    """Return the texts of numbers, "" for NaN."""
    texts = list(map(repr, values.tolist()))
    for unknown in np.flatnonzero(np.isnan(values)).tolist():
        texts[unknown] = ""
    return texts


def _cell(value: Any) -> str:
    """Return the text of a varied key's value."""
    if isinstance(value, str):
        return value
    return "" if value is None else toml_value(value)
