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
from ringwear_par.atomic import atomic_write
from ringwear_par.cases.keys import read_keys
from ringwear_par.cases.schema import unit_of
from ringwear_par.cases.text import toml_value
from ringwear_par.cases.values import is_number
from ringwear_par.errors import InputError
from ringwear_par.results.edge_elements import edge_elements
from ringwear_par.results.hdf5 import atomic_hdf5
from ringwear_par.results.stress_variables import POINT_SIDE, side_words
from ringwear_par.results.variables import EDGE_ELEMENT, HISTORIES, LINE, Variable
from ringwear_par.studies.case_variables import (
    WINDOW,
    ColumnWriter,
    make_scales,
    make_variable,
    text_dtype,
    text_window,
)
from ringwear_par.studies.finals import (
    BY_SOURCE,
    FINALS,
    STRESS_ASKED,
    entries,
    last_asked,
)
from ringwear_par.studies.index import (
    STATUS,
    Index,
    Kind,
    Piece,
    join_flags,
    put,
    read_stored,
    telling_damage,
    with_body_last,
)
from ringwear_par.studies.results_file import (
    OF_CASES,
    RESULTS,
    SAME_STEPS,
    SOFTWARE,
    TABLE,
    TABLE_MEANINGS,
    cases_at_once,
    over_cases,
)
from ringwear_par.studies.swept import EACH, FIELDS, ROWS, STRESS, has_layers
from ringwear_par.studies.table_meanings import AFTER, BEFORE, table_meanings
from ringwear_par.studies.variations import Column, own_key, value_of


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
        self._there = entry >= 0
        begun = entry[self._there]
        self._kinds = [index.kinds[kind] for kind in np.unique(index.kind[begun]).tolist()]
        self._deep = any(kind.deep for kind in self._kinds)
        self._rows = self._of_cases(index.rows, 0)
        self._elements = self._of_cases(index.elements, 0)
        #: by name, (cases,) or (cases, layers or points)
        self._final: dict[str, FloatArray] = {}
        #: raw values of the varied keys of the cases that the columns do not have
        self._looked_up: list[tuple[Any, ...]] = []
        # cases that are stored together are read together
        stored = index.source.astype(np.int64) * (int(index.block.max(initial=0)) + 1) + index.block
        self._block = self._of_cases(np.unique(stored, return_inverse=True)[1], -1)
        make_scales(
            file, listing.ids, int(self._rows.max(initial=0)) or 1,
            int(self._elements.max(initial=0)) or 1, self._axes,
        )  # fmt: skip

    @property
    def finals(self) -> dict[str, FloatArray]:
        """The last values of cases by the names of the table's columns."""
        found: dict[str, FloatArray] = {}
        for name in FINALS:
            if name in self._final:
                found |= entries(FINALS[name], self._final[name])
        return found

    @property
    def _axes(self) -> dict[str, int]:
        """Sizes of the axes beside steps and elements."""
        found: dict[str, int] = {}
        for kind in self._kinds:
            for axis, size in kind.sizes:
                found[axis] = max(size, found.get(axis, 0))
        return found

    def _of_cases(self, values: Any, otherwise: Any) -> Any:
        """Return what the index has of each case."""
        found = np.full(len(self._there), otherwise, dtype=values.dtype)
        found[self._there] = values[self._listing.entry[self._there]]
        return found

    def _blocks(self, start: int, stop: int, full: bool) -> Iterator[tuple[Any, int, IntArray]]:
        """Yield source, block and the stored cases of a window that are there, block by block.

        Parameters
        ----------
        full : those only that have any history.
        """
        index, entry = self._listing.index, self._listing.entry
        wanted = self._there[start:stop] & ((self._rows[start:stop] > 0) | (not full))
        cases = start + np.flatnonzero(wanted)
        cases = cases[np.argsort(self._block[cases], kind="stable")]
        cuts = np.flatnonzero(np.diff(self._block[cases])) + 1
        for own in np.split(cases, cuts) if len(cases) else ():
            first = int(entry[own[0]])
            yield index.sources[int(index.source[first])], int(index.block[first]), own

    def write_histories(self) -> None:
        """Write what cases have over steps and elements."""
        file, entry, place = self._file, self._listing.entry, self._listing.index.place
        fields = {name for kind in self._kinds for name in kind.fields}
        variables = [
            *(v for name, v in ROWS.items() if name in HISTORIES or name in fields),
            *LINE.values(),
            *(variable for name, variable in EACH.items() if name in fields),
            *(
                variable if self._deep else variable.at_last_step()
                for name, variable in {**FIELDS, EDGE_ELEMENT.name: EDGE_ELEMENT}.items()
                if name in fields or (variable is EDGE_ELEMENT and "pressure" in fields)
            ),
        ]
        shapes = {v.name: tuple(len(file[axis]) for axis in v.dimensions) for v in variables}
        window = cases_at_once(8 * max(map(math.prod, shapes.values())))
        columns: dict[str, ColumnWriter] = {}
        common = _CommonSteps()
        for start in range(0, max(len(entry), 1), window):
            stop = min(start + window, len(entry))
            asked = self._rows[start:stop] - 1
            blocks = list(self._blocks(start, stop, full=True))
            for source, block, cases in blocks:
                piece = read_stored(source, block, "step")
                common.look(piece, place[entry[cases]], self._rows[cases])
            for variable in variables:
                name = variable.name
                table = np.full((stop - start, *shapes[name]), np.nan)
                for source, block, cases in blocks:
                    piece = read_stored(source, block, name)
                    if piece is not None:
                        if has_layers(variable):
                            piece = with_body_last(piece, table.shape[-1])
                        places = place[entry[cases]]
                        put(table, cases - start, piece, places, self._rows[cases])
                if name == "pressure":
                    pressure = table
                if name == EDGE_ELEMENT.name:  # comes after the pressure, which says it all
                    table = np.where(np.isnan(pressure), np.nan, edge_elements(pressure))
                if name == STRESS_ASKED:
                    asked = last_asked(table)
                if name in BY_SOURCE:
                    last = asked if name in STRESS else self._rows[start:stop] - 1
                    self._take_last(name, start, table, last)
                kind: Any = float
                if name == POINT_SIDE.name:
                    words = side_words(table)
                    kind = text_dtype(words.dtype.itemsize)
                    table = words.astype(kind)
                if not start:
                    own = over_cases(variable)
                    columns[name] = ColumnWriter(
                        make_variable(file, own, kind, window, sample=table)
                    )
                columns[name].write(start, table)
                self._check_disk()
        if common.steps is not None and len(common.steps) == len(file["step"]):
            file["step"][:] = common.steps.astype(int)
            file["step"].attrs["long_name"] = "number of time steps made"
            file["step"].attrs[SAME_STEPS] = 1

    def _take_last(self, source: str, start: int, table: FloatArray, last: IntArray) -> None:
        """Take the last values of a window of cases."""
        final = BY_SOURCE[source]
        values = final.of(table, last)
        if not start:
            self._final[final.name] = np.full((len(self._there), *values.shape[1:]), np.nan)
        self._final[final.name][start : start + len(values)] = values

    def write_cases(self) -> None:
        """Write what cases have one of each, and the varied keys."""
        self._write_texts()
        index, file = self._listing.index, self._file
        for name, words in self._words.items():
            self._write_words(OF_CASES[name], words)
        for name, values in (
            ("seconds", self._of_cases(index.seconds, np.nan)),
            ("imbalance", self._of_cases(index.imbalance, np.nan)),
            ("steps_stored", self._rows),
            ("elements", self._elements),
        ):
            make_variable(file, OF_CASES[name], values.dtype, WINDOW)[:] = values
        for name, values in self._final.items():
            if FINALS[name].stored.name not in file:
                make_variable(file, FINALS[name].stored, float, WINDOW)[:] = values
        self._write_varied()

    @cached_property
    def _words(self) -> dict[str, "_Words"]:
        """The short texts of cases."""
        index = self._listing.index
        kinds = [*index.kinds, Kind("")]  # the last of which nothing is known
        kind = self._of_cases(index.kind, -1)
        reasons, error = {"": 0}, np.zeros(len(index), dtype=np.int64)
        for place, reason in index.errors.items():
            error[place] = reasons.setdefault(reason, len(reasons))
        return {
            "status": _Words(_bytes(STATUS), self._of_cases(index.status, 0)),
            "error": _Words(_bytes(list(reasons)), self._of_cases(error, 0)),
            "in_study": _Words(_bytes(("no", "yes")), self._listing.in_study.astype(int)),
            "version": _Words(_bytes([each.version for each in kinds]), kind),
            "flags": _Words(_bytes([join_flags(each.flags) for each in kinds]), kind),
        }

    def _write_words(self, variable: Variable, words: "_Words") -> None:
        """Write texts of cases, window by window."""
        kind = text_dtype(words.there.dtype.itemsize)
        window = text_window(kind)
        column = ColumnWriter(make_variable(self._file, variable, kind, window, gzip=True))
        for start in range(0, len(words.codes), window):
            column.write(start, words.of(slice(start, start + window)))
        self._check_disk()

    def _write_texts(self) -> None:
        """Write the texts of all cases, and look up varied keys that nobody knows any more."""
        listing, count = self._listing, len(self._there)
        known = len(listing.columns[0]) if listing.columns else count
        longest = listing.index.longest if self._there.any() else 1
        missing = np.flatnonzero(~self._there)
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
            found: list[str] = [""] * (stop - start)
            for source, block, cases in self._blocks(start, stop, full=False):
                places = listing.index.place[listing.entry[cases]].tolist()
                with telling_damage(source.path):
                    texts = source.texts(block, places)
                for case, text in zip((cases - start).tolist(), texts, strict=True):
                    found[case] = text
            here = start + np.flatnonzero(~self._there[start:stop])
            if len(here):
                for case, text in zip((here - start).tolist(), listing.texts(here), strict=True):
                    found[case] = text
            column.write(start, np.array([text.encode() for text in found], dtype=kind))
            self._check_disk()
            self._looked_up += [
                _looked_up(text, listing.names) for text in found[max(known - start, 0) :]
            ]

    def _write_varied(self) -> None:
        """Write the varied keys as coordinates, as texts where they are not all numbers."""
        file, listing = self._file, self._listing
        for i, name in enumerate(listing.names):
            more, key = [row[i] for row in self._looked_up], own_key(name)
            column = listing.columns[i]
            there = more if column.numbers is not None else [*column.there, *more]
            numbers = all(v is None or is_number(v) for v in there)
            variable = Variable(name, ("case",), unit_of(name) or "1", key.meaning)
            if numbers:
                known = column.each(_number) if column.numbers is None else column.numbers
                values = np.concatenate([known, list(map(_number, more))])
                make_variable(file, variable, float, WINDOW)[:] = values
            else:
                there = [*column.there, *more]
                codes = np.arange(len(there))
                if column.codes is not None:
                    codes = np.concatenate([column.codes, codes[len(column.values) :]])
                self._write_words(variable, _Words(_bytes(list(map(_shown, there))), codes))
        file.attrs["coordinates"] = " ".join(listing.names)

    def rows(self) -> Iterator[Iterator[tuple[str, ...]]]:
        """Yield the rows of cases.csv, window by window."""
        listing, count, words = self._listing, len(self._there), self._words
        seconds = self._of_cases(listing.index.seconds, np.nan)
        known = len(listing.columns[0]) if listing.columns else count
        for start in range(0, count, WINDOW):
            here = slice(start, min(start + WINDOW, count))
            more = self._looked_up[max(start - known, 0) : max(here.stop - known, 0)]
            varied = [
                column.part(slice(start, min(here.stop, known))).each(_shown)
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

    there: Any
    codes: IntArray

    def of(self, cases: slice) -> Any:
        """Return the texts of some cases."""
        return self.there[self.codes[cases]]


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
