"""The results of a sweep: ``results.h5``, one file for xarray, and ``cases.csv``, one row a case.

Histories shorter than the longest, and contact lines of fewer elements than the finest, are padded
with NaN; ``steps_stored`` and ``elements`` say how much is there. Both files appear by rename.
"""

import csv
import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.atomic import atomic_write
from ringwear_par.cases.keys import read_keys
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.text import toml_value
from ringwear_par.cases.values import is_number
from ringwear_par.errors import InputError
from ringwear_par.results.hdf5 import atomic_hdf5
from ringwear_par.results.reading import (
    UnreadableError,
    find_array,
    read_array,
    read_words,
    reading,
)
from ringwear_par.results.variables import ELEMENT, HISTORIES, LINE, PROFILES, STEP, Variable
from ringwear_par.studies.index import (
    STATUS,
    Index,
    Kind,
    Piece,
    index_of,
    join_flags,
    put,
    read_stored,
    split_flags,
    telling_damage,
)
from ringwear_par.studies.shards import UNKNOWN_VERSION
from ringwear_par.studies.variations import Column, path_of, value_of

SOFTWARE = "ringwear-par sweep"
#: what messages call the file
WHAT = "a results file of ringwear sweep"
RESULTS, TABLE = "results.h5", "cases.csv"
#: the last values that cases.csv shows
FINAL = ("penetration", "worn_volume_lower", "worn_volume_upper")
_COLUMNS = ("status", "error", *FINAL, "seconds", "in_study", "version", "flags")
#: of the largest table that is filled before it is written, of a chunk in the file
_WINDOW_BYTES, _CHUNK_BYTES = 24e6, 256e3
#: cases that are made texts of, or are rows of a table, at once; and those of a results file that
#: are read at once
_WINDOW, _STRETCH = 2**13, 2**12
#: a variable whose first chunk gzip makes so much smaller is stored so; it takes no time then
_WORTH_IT = 8
#: attribute of ``step``: whether all histories begin with the same numbers of steps made
_SAME_STEPS = "same_in_all_cases"
#: variables that older files do not have, and what is said of their cases
_OLDER = {"version": UNKNOWN_VERSION, "flags": ""}
#: variables with dimension (case,)
OF_CASES = {
    variable.name: variable
    for variable in (
        Variable("case_toml", ("case",), "1", "the case as a case file"),
        Variable("status", ("case",), "1", "done, failed or incomplete"),
        Variable("error", ("case",), "1", "why the case failed"),
        Variable("in_study", ("case",), "1", "whether the study still has the case"),
        Variable("version", ("case",), "1", "version of ringwear-par that computed the case"),
        Variable("flags", ("case",), "1", "what makes the answer doubtful, separated by commas"),
        Variable("seconds", ("case",), "s", "wall time of the case"),
        Variable(
            "imbalance", ("case",), "1",
            "worst balance of force, volume, energy or KKT residual of its steps",
        ),
        Variable("steps_stored", ("case",), "1", "number of stored steps", integer=True),
        Variable("elements", ("case",), "1", "number of contact elements", integer=True),
        *(
            Variable(
                f"final_{name}", ("case",), HISTORIES[name].unit,
                f"{HISTORIES[name].meaning}, at the last stored step",
            )
            for name in FINAL
        ),
    )
}  # fmt: skip


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
    """Write both files by rename. Call on one rank only.

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
        atomic_write(folder / TABLE) as listed,  # both are whole before one is replaced
        atomic_hdf5(folder / RESULTS) as (file, check_disk),
    ):
        writer = _Writer(file, listing, check_disk)
        writer.write_histories()
        writer.write_cases()
        file.attrs.update({"software": SOFTWARE, **attributes})
        with listed.open("w", newline="", encoding="utf-8") as handle:
            table = csv.writer(handle)
            table.writerow(("case", *listing.names, *_COLUMNS))
            for rows in writer.rows():
                table.writerows(rows)


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
        self._final = {name: np.full(len(entry), np.nan) for name in FINAL}
        #: raw values of the varied keys of the cases that the columns do not have
        self._looked_up: list[tuple[Any, ...]] = []
        # cases that are stored together are read together
        stored = index.source.astype(np.int64) * (int(index.block.max(initial=0)) + 1) + index.block
        self._block = self._of_cases(np.unique(stored, return_inverse=True)[1], -1)
        _make_scales(
            file, listing.ids, int(self._rows.max(initial=0)) or 1,
            int(self._elements.max(initial=0)) or 1,
        )  # fmt: skip

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
            *HISTORIES.values(),
            *LINE.values(),
            *(
                variable if self._deep else variable.at_last_step()
                for name, variable in PROFILES.items()
                if name in fields
            ),
        ]
        shapes = {v.name: tuple(len(file[axis]) for axis in v.dimensions) for v in variables}
        window = _power_of_2(_WINDOW_BYTES / (8 * max(map(math.prod, shapes.values()))))
        columns: dict[str, _Column] = {}
        common = _CommonSteps()
        for start in range(0, max(len(entry), 1), window):
            stop = min(start + window, len(entry))
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
                        places = place[entry[cases]]
                        put(table, cases - start, piece, places, self._rows[cases])
                if name in FINAL:
                    some = np.flatnonzero(self._rows[start:stop])
                    last = self._rows[start + some] - 1
                    self._final[name][start + some] = table[some, last]
                if not start:
                    own = over_cases(variable)
                    columns[name] = _Column(_make(file, own, float, window, sample=table))
                columns[name].write(start, table)
                self._check_disk()
        if common.steps is not None and len(common.steps) == len(file["step"]):
            file["step"][:] = common.steps.astype(int)
            file["step"].attrs["long_name"] = "number of time steps made"
            file["step"].attrs[_SAME_STEPS] = 1

    def write_cases(self) -> None:
        """Write what cases have one of each, and the varied keys."""
        self._write_texts()
        index, file = self._listing.index, self._file
        for name, words in self._words().items():
            kind = _text_dtype(words.dtype.itemsize)
            column = _Column(_make(file, OF_CASES[name], kind, _WINDOW, gzip=True))
            for start in range(0, len(words), _WINDOW):
                column.write(start, words[start : start + _WINDOW])
            self._check_disk()
        for name, values in (
            ("seconds", self._of_cases(index.seconds, np.nan)),
            ("imbalance", self._of_cases(index.imbalance, np.nan)),
            ("steps_stored", self._rows),
            ("elements", self._elements),
            *((f"final_{name}", values) for name, values in self._final.items()),
        ):
            _make(file, OF_CASES[name], values.dtype, _WINDOW)[:] = values
        self._write_varied()

    def _words(self) -> dict[str, Any]:
        """Return the short texts of cases, as bytes."""
        index = self._listing.index
        kind = self._of_cases(index.kind, -1)
        kinds = [*index.kinds, Kind("")]  # the last of which nothing is known
        errors = np.zeros(len(kind), dtype=f"S{max(map(_size, index.errors.values()), default=1)}")
        if index.errors:
            for case in np.flatnonzero(self._there).tolist():
                reason = index.errors.get(int(self._listing.entry[case]))
                if reason is not None:
                    errors[case] = reason.encode()
        return {
            "status": _bytes(STATUS)[self._of_cases(index.status, 0)],
            "error": errors,
            "in_study": _bytes(("no", "yes"))[self._listing.in_study.astype(int)],
            "version": _bytes([each.version for each in kinds])[kind],
            "flags": _bytes([join_flags(each.flags) for each in kinds])[kind],
        }

    def _write_texts(self) -> None:
        """Write the texts of all cases, and look up varied keys that nobody knows any more."""
        listing, count = self._listing, len(self._there)
        known = len(listing.columns[0]) if listing.columns else count
        longest = listing.index.longest if self._there.any() else 1
        missing = np.flatnonzero(~self._there)
        for start in range(0, len(missing), _WINDOW):
            texts = listing.texts(missing[start : start + _WINDOW])
            longest = max(longest, *map(_size, texts))
        kind = _text_dtype(longest)
        column = _Column(_make(self._file, OF_CASES["case_toml"], kind, _WINDOW, gzip=True))
        for start in range(0, count, _WINDOW):
            stop = min(start + _WINDOW, count)
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
            more, key = [row[i] for row in self._looked_up], BY_PATH[path_of(name)]
            column = listing.columns[i]
            there = more if column.numbers is not None else [*column.there, *more]
            numbers = all(v is None or is_number(v) for v in there)
            variable = Variable(name, ("case",), "1" if key.unit == "-" else key.unit, key.meaning)
            if numbers:
                known = column.each(_number) if column.numbers is None else column.numbers
                values = np.concatenate([known, list(map(_number, more))])
                _make(file, variable, float, _WINDOW)[:] = values
            else:
                words = _bytes(column.each(_shown) + list(map(_shown, more)))
                kind = _text_dtype(words.dtype.itemsize)
                dataset = _make(file, variable, kind, _WINDOW, gzip=True)
                dataset[:] = words.astype(dataset.dtype)
        file.attrs["coordinates"] = " ".join(listing.names)

    def rows(self) -> Iterator[Iterator[tuple[str, ...]]]:
        """Yield the rows of cases.csv, window by window."""
        listing, count, words = self._listing, len(self._there), self._words()
        seconds = self._of_cases(listing.index.seconds, np.nan)
        known = len(listing.columns[0]) if listing.columns else count
        for start in range(0, count, _WINDOW):
            here = slice(start, min(start + _WINDOW, count))
            more = self._looked_up[max(start - known, 0) : max(here.stop - known, 0)]
            varied = [
                column.part(slice(start, min(here.stop, known))).each(_shown)
                + [_shown(row[i]) for row in more]
                for i, column in enumerate(listing.columns)
            ]
            finals = [self._final[name][here].tolist() for name in FINAL]
            yield zip(
                _texts(listing.ids[here]),
                *varied,
                _texts(words["status"][here]),
                _texts(words["error"][here]),
                *(["" if v != v else repr(v) for v in values] for values in finals),
                ["" if v != v else f"{v:.4f}" for v in seconds[here].tolist()],
                *(_texts(words[name][here]) for name in ("in_study", "version", "flags")),
                strict=True,
            )


def over_cases(variable: Variable) -> Variable:
    """Return a variable of one case as the results of all have it, padded with NaN."""
    return replace(variable, dimensions=("case", *variable.dimensions), integer=False)


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


def _texts(words: Any) -> list[str]:
    """Return what ``_bytes`` was made of."""
    return [word.decode() for word in words.tolist()]


def _text_dtype(size: int) -> Any:
    """Return the type of texts of at most so many bytes, which gzip shrinks as no others."""
    return h5py.string_dtype("utf-8", max(size, 1))


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


def _make_scales(file: h5py.File, ids: Any, steps: int, elements: int) -> None:
    """Make the dimensions; ``step`` is numbered, until it is known to be the same in all cases."""
    kind = _text_dtype(ids.dtype.itemsize)
    file.create_dataset("case", data=ids.astype(kind), dtype=kind)
    meaning = "case, by its content"
    file["case"].attrs.update({"units": "1", "long_name": meaning, **_ENCODED})
    file.create_dataset("step", data=np.arange(steps))
    meaning = "stored step (their numbers differ from case to case)"
    file["step"].attrs.update({"units": "1", "long_name": meaning, _SAME_STEPS: 0})
    file.create_dataset("element", data=np.arange(elements))
    file["element"].attrs.update(ELEMENT.attributes)
    for name in ("case", "step", "element"):
        file[name].make_scale(name)


def _power_of_2(number: float) -> int:
    """Return the largest power of 2 up to a number, 1 at least."""
    return 1 << max(int(number).bit_length() - 1, 0)


class _Column:
    """Writes a variable window by window; what is compressed by itself.

    HDF5 would do it as well; but much of what gzip is worth its time for is the same again and
    again, such as the radii of the contact elements, and then need not be compressed again.

    Parameters
    ----------
    dataset : whose windows are whole chunks, but for the last.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._dataset, self._known = dataset, (b"", b"")
        self._direct = dataset.compression == "gzip" and dataset.chunks[1:] == dataset.shape[1:]

    def write(self, start: int, values: Any) -> None:
        """Write the values of cases from one on."""
        dataset = self._dataset
        if not self._direct:
            dataset[start : start + len(values)] = values
            return
        rows, rest = dataset.chunks[0], (0,) * (dataset.ndim - 1)
        for first in range(0, len(values), rows):
            data = np.ascontiguousarray(values[first : first + rows], dtype=dataset.dtype).tobytes()
            data += bytes(math.prod(dataset.chunks) * dataset.dtype.itemsize - len(data))
            if data != self._known[0]:
                self._known = data, zlib.compress(data, 1)
            dataset.id.write_direct_chunk((start + first, *rest), self._known[1])


def _make(
    file: h5py.File,
    variable: Variable,
    kind: Any,
    window: int,
    *,
    sample: Any = None,
    gzip: bool = False,
) -> h5py.Dataset:
    """Make a variable, in chunks that hold whole histories as far as they are small.

    Parameters
    ----------
    window : cases that are written at once; a chunk has no more.
    sample : its first values, which tell whether gzip is worth it; or else ``gzip``.
    """
    shape = tuple(len(file[name]) for name in variable.dimensions)
    size = np.dtype(kind).itemsize
    chunks = list(shape)
    for axis in range(len(shape)):
        rest = size * math.prod(chunks[axis + 1 :])
        chunks[axis] = min(shape[axis], max(1, int(_CHUNK_BYTES // rest)))
    chunks[0] = min(shape[0], _power_of_2(_CHUNK_BYTES / (size * math.prod(chunks[1:]))), window)
    extra: dict[str, Any] = {}
    if np.dtype(kind).kind == "f":
        extra["fillvalue"] = np.nan
    if sample is not None:
        first = np.ascontiguousarray(sample[tuple(map(slice, chunks))]).tobytes()
        gzip = len(zlib.compress(first, 1)) * _WORTH_IT < len(first)
    if gzip:
        extra |= {"compression": "gzip", "compression_opts": 1}
    dataset = file.create_dataset(variable.name, shape, dtype=kind, chunks=tuple(chunks), **extra)
    dataset.attrs.update(variable.attributes)
    if np.dtype(kind).kind == "S":
        dataset.attrs.update(_ENCODED)
    for axis, name in enumerate(variable.dimensions):
        dataset.dims[axis].attach_scale(file[name])
    return dataset


#: with which xarray takes bytes for the texts that they are
_ENCODED = {"_Encoding": "utf-8"}


def read_entries(path: Path) -> Index | None:
    """Return the begun cases of a results file; None if it is damaged. Not collective.

    Raises
    ------
    UnreadableError : it cannot be read now.
    """
    try:
        with reading(path, SOFTWARE, WHAT) as file:
            return _index(path, file)
    except UnreadableError:
        raise
    except InputError:
        return None


def _index(path: Path, file: h5py.File) -> Index:
    sizes: dict[str, int] = {}
    ids, status, errors = (read_words(file, name, sizes) for name in ("case", "status", "error"))
    rows, elements, seconds, imbalance = (
        read_array(file, OF_CASES[name], sizes)
        for name in ("steps_stored", "elements", "seconds", "imbalance")
    )
    fields = tuple(name for name in PROFILES if name in file)
    deep = any(file[name].ndim == 3 for name in fields)
    version, flags = (
        read_words(file, name, sizes)
        if name in file
        else np.full(len(ids), default.encode() or b"", dtype=f"S{len(default) or 1}")
        for name, default in _OLDER.items()
    )
    tables = _tables(file, sizes)
    for numbers, axis in ((rows, "step"), (elements, "element")):
        if not ((numbers >= 0) & (numbers <= sizes.get(axis, 0))).all():
            raise ValueError(axis)
    there, state = np.unique(status, return_inverse=True)
    states = np.array([STATUS.index(word.decode()) for word in there], dtype=np.int64)[state]
    _, first, which = np.unique(
        np.char.add(np.char.add(version, b"\0x"), flags), return_index=True, return_inverse=True
    )
    kinds = [Kind(version[i].decode(), split_flags(flags[i].decode()), fields, deep) for i in first]
    source = Results(path, set(tables))
    whole = replace(
        index_of(
            source, 0, ids, states, rows, elements, seconds, imbalance, kinds[:1] or [Kind("")],
            errors={int(i): errors[i].decode() for i in np.flatnonzero(errors)},
            longest=_longest(file["case_toml"]),
        ),
        kind=which, kinds=tuple(kinds) or (Kind(""),),
        block=np.arange(len(ids)) // _STRETCH, place=np.arange(len(ids)) % _STRETCH,
    )  # fmt: skip
    begun = np.flatnonzero(~np.isnan(seconds))
    return whole if len(begun) == len(ids) else whole.only(begun)


def _longest(dataset: h5py.Dataset) -> int:
    """Return the bytes of the longest text of a variable."""
    if dataset.dtype.kind == "S":
        return int(dataset.dtype.itemsize)
    return max((len(word) for word in dataset[:].tolist()), default=1)


class Results:
    """The cases of a results file, in stretches of them; see ``Source``.

    Parameters
    ----------
    path : of the file.
    names : variables that it has over steps and elements.
    """

    def __init__(self, path: Path, names: set[str]) -> None:
        self.path, self._names = path, names

    def read(self, block: int, name: str) -> Piece | None:
        """Return a variable of the cases of a stretch; None where it is not stored.

        Raises
        ------
        InputError : the file is damaged.
        """
        if name != "step" and name not in self._names:
            return None
        with reading(self.path, SOFTWARE, WHAT) as file:
            if name != "step":
                return Piece(file[name][block * _STRETCH : (block + 1) * _STRETCH])
            steps = read_array(file, STEP, {}).astype(float)
            # files of before the attribute: only where they are not just numbered does it matter
            same = file["step"].attrs.get(_SAME_STEPS, (steps != np.arange(len(steps))).any())
            return Piece(steps[None]) if same else None

    def texts(self, block: int, places: Sequence[int]) -> list[str]:
        """Return the texts of some cases of a stretch.

        Raises
        ------
        InputError : the file is damaged.
        """
        with reading(self.path, SOFTWARE, WHAT) as file:
            words = file["case_toml"][block * _STRETCH : (block + 1) * _STRETCH]
            return [words[place].decode() for place in places]

    def close(self) -> None:
        """Let the file go, which is opened for each answer."""


def _tables(file: h5py.File, sizes: dict[str, int]) -> dict[str, h5py.Dataset]:
    """Return the variables over cases and steps or elements."""
    found = {}
    for name, variable in {**HISTORIES, **LINE, **PROFILES}.items():
        if name in file:
            last = name in PROFILES and file[name].ndim == 2
            own = over_cases(variable.at_last_step() if last else variable)
            found[name] = find_array(file, own, sizes)
    return found
