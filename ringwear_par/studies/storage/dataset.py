"""The results of a sweep: ``results.h5``, one file for xarray, and ``cases.csv``, one row a case.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Both files appear by rename.
"""

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.schema import unit_of
from ringwear_par.cases.text import toml_value
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
    Variable,
    edge_elements,
)
from ringwear_par.studies.definition.variations import Column, own_key, value_of
from ringwear_par.studies.storage.case_variables import (
    WINDOW,
    ColumnWriter,
    make_scales,
    make_variable,
    text_dtype,
    text_window,
)
from ringwear_par.studies.storage.end_values import (
    BY_SOURCE,
    FINALS,
    STRESS_ASKED,
    entries,
    last_asked,
)
from ringwear_par.studies.storage.index import (
    ENTRY,
    STATUS,
    Index,
    Kind,
    Piece,
    StoredBlock,
    join_flags,
    put,
    with_body_last,
)
from ringwear_par.studies.storage.results_file import (
    OF_CASES,
    RESULTS,
    SAME_STEPS,
    SOFTWARE,
    TABLE,
    TABLE_MEANINGS,
    cases_at_once,
    over_cases,
)
from ringwear_par.studies.storage.stored_variables import EACH, FIELDS, ROWS, STRESS, has_layers
from ringwear_par.studies.storage.table_meanings import AFTER, BEFORE, table_meanings


@dataclass(frozen=True, eq=False)
class Listing:
    """The cases as the files list them, in arrays (cases,).

    Parameters
    ----------
    names, columns : varied keys, and their raw values in the first of the cases; those of the
        others are looked up in their texts.
    ids : bytes.
    in_study : whether the study still has the case.
    index, entry : what is stored, and where there each case is, -1: it was not begun.
    texts : returns the texts of cases by their numbers, where they are not stored.
    """

    names: tuple[str, ...]
    columns: tuple[Column, ...]
    ids: Any
    in_study: BoolArray
    index: Index
    entry: IntArray
    texts: Callable[[IntArray], list[str]]


def write_ensemble(folder: Path, listing: Listing, attributes: Mapping[str, Any]) -> None:
    """Write the files by rename, the units of the table beside it. Call on one rank only.

    Parameters
    ----------
    folder : of the sweep.
    listing : the cases.
    attributes : of the HDF5 file.

    Raises
    ------
    OSError : the disk or the folder.
    """
    with (
        atomic_write(folder / TABLE) as listed,  # all are whole before one is replaced
        atomic_write(folder / TABLE_MEANINGS) as meanings,
        atomic_hdf5(folder / RESULTS) as (file, check_disk),
    ):
        writer = _Writer(file, listing, check_disk)
        writer.write_histories()
        writer.write_cases()
        file.attrs.update({"software": SOFTWARE, **attributes})
        with listed.open("w", newline="", encoding="utf-8") as handle:
            table = csv.writer(handle)
            table.writerow(("case", *listing.names, *BEFORE, *writer.finals, *AFTER))
            for rows in writer.rows():
                table.writerows(rows)
        told = table_meanings(listing.names, list(writer.finals), file)
        meanings.write_text(told, encoding="utf-8")


class _Writer:
    """Fills a results file, window by window of cases.

    Parameters
    ----------
    file : empty.
    listing : the cases.
    check_disk : raises what the disk has failed with.
    """

    def __init__(self, file: h5py.File, listing: Listing, check_disk: Callable[[], None]) -> None:
        self._file, self._listing, self._check_disk = file, listing, check_disk
        index, entry = listing.index, listing.entry
        #: of each case what is stored; nothing is of a case that was not begun
        self._cases = np.zeros(len(entry), dtype=ENTRY)
        self._cases["seconds"] = self._cases["imbalance"] = np.nan
        self._cases["kind"] = self._cases["block"] = -1
        self._stored = entry >= 0
        self._cases[self._stored] = index.entries[entry[self._stored]]
        numbers = np.unique(self._cases["block"][self._stored])
        self._blocks = [index.blocks[block] for block in numbers.tolist()]
        self._deep = any(block.deep for block in self._blocks)
        self._rows = self._cases["rows"]
        #: by name, (cases,) or (cases, layers or points)
        self._end_values: dict[str, FloatArray] = {}
        #: raw values of the varied keys of the cases that the columns do not have
        self._looked_up: list[tuple[Any, ...]] = []
        axes: dict[str, int] = {}
        for block in self._blocks:
            for axis, size in block.sizes.items():
                axes[axis] = max(size, axes.get(axis, 0))
        make_scales(
            file, listing.ids, int(self._rows.max(initial=0)) or 1,
            int(self._cases["elements"].max(initial=0)) or 1, axes,
        )  # fmt: skip

    @property
    def finals(self) -> dict[str, FloatArray]:
        """The last values of cases by the names of the table's columns."""
        columns: dict[str, FloatArray] = {}
        for name in FINALS:
            if name in self._end_values:
                columns |= entries(FINALS[name], self._end_values[name])
        return columns

    def _by_block(self, cases: IntArray) -> Iterator[tuple[StoredBlock, IntArray]]:
        """Yield the blocks of some stored cases, with the cases of each."""
        cases = cases[np.argsort(self._cases["block"][cases], kind="stable")]
        numbers = self._cases["block"][cases]
        for own in np.split(cases, np.flatnonzero(np.diff(numbers)) + 1) if len(cases) else ():
            yield self._listing.index.blocks[self._cases["block"][own[0]]], own

    def write_histories(self) -> None:
        """Write what cases have over steps and elements, block by block of a window of cases."""
        file, place = self._file, self._cases["place"]
        fields = {name for block in self._blocks for name in block.fields}
        profiles = {**FIELDS, EDGE_ELEMENT.name: EDGE_ELEMENT}
        variables = {
            variable.name: variable
            for variable in (
                *(v for name, v in ROWS.items() if name in HISTORIES or name in fields),
                *LINE.values(),
                *(variable for name, variable in EACH.items() if name in fields),
                *(
                    variable if self._deep else variable.at_last_step()
                    for name, variable in profiles.items()
                    if name in fields or (variable is EDGE_ELEMENT and "pressure" in fields)
                ),
            )
        }
        shapes = {
            name: tuple(len(file[axis]) for axis in variable.dimensions)
            for name, variable in variables.items()
        }
        window = cases_at_once(8 * sum(map(math.prod, shapes.values())))
        columns: dict[str, ColumnWriter] = {}
        common = _CommonSteps()
        for start in range(0, max(len(place), 1), window):
            stop = min(start + window, len(place))
            tables = {
                name: np.full((stop - start, *shape), np.nan) for name, shape in shapes.items()
            }
            for block, cases in self._by_block(start + np.flatnonzero(self._rows[start:stop])):
                pieces = block.read(("step", *variables))
                rows = self._rows[cases]
                common.look(pieces.pop("step", None), place[cases], rows)
                for name, piece in pieces.items():
                    if has_layers(variables[name]):
                        piece = with_body_last(piece, tables[name].shape[-1])
                    put(tables[name], cases - start, piece, place[cases], rows)
            if EDGE_ELEMENT.name in tables:
                pressure = tables["pressure"]
                edges = np.where(np.isnan(pressure), np.nan, edge_elements(pressure))
                tables[EDGE_ELEMENT.name] = edges
            self._note_end_values(start, tables)
            for name, table in tables.items():
                kind: Any = float
                if name == POINT_SIDE.name:
                    words = side_words(table)
                    kind = text_dtype(words.dtype.itemsize)
                    table = words.astype(kind)
                if not start:
                    columns[name] = ColumnWriter(
                        make_variable(file, over_cases(variables[name]), kind, window, sample=table)
                    )
                columns[name].write(start, table)
                self._check_disk()
        if common.steps is not None and len(common.steps) == len(file["step"]):
            file["step"][:] = common.steps.astype(int)
            file["step"].attrs["long_name"] = "number of time steps made"
            file["step"].attrs[SAME_STEPS] = 1

    def _note_end_values(self, start: int, tables: Mapping[str, FloatArray]) -> None:
        """Note the end values of a window of cases."""
        stressed = tables.get(STRESS_ASKED)
        for source in tables.keys() & BY_SOURCE.keys():
            final, table = BY_SOURCE[source], tables[source]
            last = self._rows[start : start + len(table)] - 1
            if source in STRESS and stressed is not None:
                last = last_asked(stressed)
            values = final.of(table, last)
            if not start:
                shape = len(self._cases), *values.shape[1:]
                self._end_values[final.name] = np.full(shape, np.nan)
            self._end_values[final.name][start : start + len(values)] = values

    def write_cases(self) -> None:
        """Write what cases have one of each, and the varied keys."""
        self._write_texts()
        file = self._file
        for name, words in self._words.items():
            self._write_words(OF_CASES[name], words)
        for name, column in (
            ("seconds", "seconds"), ("imbalance", "imbalance"), ("steps_stored", "rows"),
            ("elements", "elements"),
        ):  # fmt: skip
            values = self._cases[column]
            make_variable(file, OF_CASES[name], values.dtype, WINDOW)[:] = values
        for name in FINALS:
            if name in self._end_values and FINALS[name].stored.name not in file:
                own = self._end_values[name]
                make_variable(file, FINALS[name].stored, float, WINDOW)[:] = own
        self._write_varied()

    @cached_property
    def _words(self) -> dict[str, "_Words"]:
        """The short texts of cases."""
        used, code = np.unique(self._cases["kind"], return_inverse=True)
        nothing = Kind("")
        kinds = [self._listing.index.kinds[i] if i >= 0 else nothing for i in used.tolist()]
        return {
            "status": _Words(_bytes(STATUS), self._cases["status"]),
            "error": _Words(_bytes([kind.error for kind in kinds]), code),
            "in_study": _Words(_bytes(("no", "yes")), self._listing.in_study.astype(int)),
            "version": _Words(_bytes([kind.version for kind in kinds]), code),
            "flags": _Words(_bytes([join_flags(kind.flags) for kind in kinds]), code),
        }

    def _write_words(self, variable: Variable, words: "_Words") -> None:
        """Write texts of cases, window by window."""
        kind = text_dtype(words.distinct.dtype.itemsize)
        window = text_window(kind)
        column = ColumnWriter(make_variable(self._file, variable, kind, window, gzip=True))
        for start in range(0, len(words.codes), window):
            column.write(start, words.of(slice(start, start + window)))
        self._check_disk()

    def _write_texts(self) -> None:
        """Write the texts of all cases, and look up varied keys that nobody knows any more."""
        listing, count, stored = self._listing, len(self._cases), self._stored
        known = len(listing.columns[0]) if listing.columns else count
        longest = max((block.longest for block in self._blocks), default=1)
        missing = np.flatnonzero(~stored)
        for start in range(0, len(missing), WINDOW):
            texts = listing.texts(missing[start : start + WINDOW])
            longest = max(longest, *map(_size, texts))
        kind = text_dtype(longest)
        window = text_window(kind)
        column = ColumnWriter(
            make_variable(self._file, OF_CASES["case_toml"], kind, window, gzip=True)
        )
        for start in range(0, count, window):
            stop = min(start + window, count)
            words = np.empty(stop - start, dtype=object)
            for block, cases in self._by_block(start + np.flatnonzero(stored[start:stop])):
                words[cases - start] = block.texts(self._cases["place"][cases].tolist())
            absent = start + np.flatnonzero(~stored[start:stop])
            if len(absent):
                words[absent - start] = listing.texts(absent)
            column.write(start, np.array([text.encode() for text in words], dtype=kind))
            self._check_disk()
            self._looked_up += [
                _looked_up(text, listing.names) for text in words[max(known - start, 0) :]
            ]

    def _write_varied(self) -> None:
        """Write the varied keys as coordinates, as texts where they are not all numbers."""
        file, listing = self._file, self._listing
        for i, name in enumerate(listing.names):
            more, key = [row[i] for row in self._looked_up], own_key(name)
            column = listing.columns[i]
            there = more if column.numbers is not None else [*column.distinct, *more]
            numbers = all(v is None or is_number(v) for v in there)
            variable = Variable(name, ("case",), unit_of(name) or "1", key.meaning)
            if numbers:
                known = column.by_case(_number) if column.numbers is None else column.numbers
                values = np.concatenate([known, list(map(_number, more))])
                make_variable(file, variable, float, WINDOW)[:] = values
            else:
                there = [*column.distinct, *more]
                codes = np.arange(len(there))
                if column.codes is not None:
                    codes = np.concatenate([column.codes, codes[len(column.values) :]])
                self._write_words(variable, _Words(_bytes(list(map(_shown, there))), codes))
        file.attrs["coordinates"] = " ".join(listing.names)

    def rows(self) -> Iterator[Iterator[tuple[str, ...]]]:
        """Yield the rows of cases.csv, window by window."""
        listing, count, words = self._listing, len(self._cases), self._words
        seconds = self._cases["seconds"]
        known = len(listing.columns[0]) if listing.columns else count
        for start in range(0, count, WINDOW):
            here = slice(start, min(start + WINDOW, count))
            more = self._looked_up[max(start - known, 0) : max(here.stop - known, 0)]
            varied = [
                column.part(slice(start, min(here.stop, known))).by_case(_shown)
                + [_shown(row[i]) for row in more]
                for i, column in enumerate(listing.columns)
            ]
            finals = [values[here].tolist() for values in self.finals.values()]
            yield zip(
                _texts(listing.ids[here]),
                *varied,
                _texts(words["status"].of(here)),
                _texts(words["error"].of(here)),
                *(["" if v != v else repr(v) for v in values] for values in finals),
                ["" if v != v else f"{v:.4f}" for v in seconds[here].tolist()],
                *(_texts(words[name].of(here)) for name in ("in_study", "version", "flags")),
                strict=True,
            )


def _looked_up(text: str, names: Sequence[str]) -> tuple[Any, ...]:
    """Return the varied keys of a case that the study no longer has, None where it has no such."""
    try:
        keys = read_keys(text)
        return tuple(value_of(keys, name) for name in names)
    except InputError:
        return (None,) * len(names)


def _size(text: str) -> int:
    return len(text.encode())


def _bytes(texts: Sequence[str]) -> Any:
    """Return texts as bytes, (texts,)."""
    return np.array([text.encode() for text in texts] or [b""])[: len(texts)]


class _Words(NamedTuple):
    """Texts of cases.

    Parameters
    ----------
    there : those that there are, as bytes.
    codes : (cases,) int, which of them each case has.
    """

    distinct: Any
    codes: IntArray

    def of(self, cases: slice) -> Any:
        """Return the texts of some cases."""
        return self.distinct[self.codes[cases]]


def _texts(words: Any) -> list[str]:
    """Return what ``_bytes`` was made of."""
    return [word.decode() for word in words.tolist()]


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return value
    return "" if value is None else toml_value(value)


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


@dataclass
class _CommonSteps:
    """What stored steps are called, as long as all cases begin with the same."""

    steps: FloatArray | None = field(default_factory=lambda: np.empty(0))

    def look(self, piece: Piece | None, places: IntArray, rows: IntArray) -> None:
        """Compare with those of some cases of a block, which have so many stored steps."""
        if self.steps is None or piece is None:
            self.steps = None
            return
        if piece.offsets is None:
            starts, values = np.zeros_like(rows), piece.values[0]
        else:
            starts, values = piece.offsets[places], piece.values
        longest = int(rows.argmax())
        if rows[longest] > len(self.steps):
            first = int(starts[longest])
            longer = values[first : first + int(rows[longest])]
            if not np.array_equal(longer[: len(self.steps)], self.steps):
                self.steps = None
                return
            self.steps = np.array(longer)
        step = np.arange(rows.sum()) - np.repeat(np.cumsum(rows) - rows, rows)
        if not np.array_equal(values[step + np.repeat(starts, rows)], self.steps[step]):
            self.steps = None
