"""What the results file of a sweep is called and holds, and how the next sweep reads it."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from ringwear_par.errors import InputError
from ringwear_par.results.storage.hdf5 import (
    UnreadableError,
    find_array,
    find_words,
    read_array,
    read_words,
    reading,
)
from ringwear_par.results.stress_variables import side_numbers
from ringwear_par.results.variables import LINE, POINT_SIDE, STEP, Variable
from ringwear_par.studies.storage.index import (
    ENTRY,
    STATUS,
    Index,
    Kind,
    Piece,
    StoredBlock,
    reporting_damage,
    split_flags,
)
from ringwear_par.studies.storage.stored_variables import AXES, EACH, FIELDS, OPTIONAL, ROWS

SOFTWARE = "ringwear-par sweep"
#: what messages call the file
WHAT = "a results file of ringwear sweep"
RESULTS, TABLE = "results.h5", "cases.csv"
#: what the columns of the table mean, named as CSV on the Web has it
TABLE_MEANINGS = "cases.csv-metadata.json"
#: of what is read or written at once
_WINDOW_BYTES = 24e6
#: attribute of ``step``: whether all histories begin with the same numbers of steps made
SAME_STEPS = "same_in_all_cases"
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
    )
}  # fmt: skip


def over_cases(variable: Variable) -> Variable:
    """Return a variable of one case as the results of all have it, padded with NaN."""
    return replace(variable, dimensions=("case", *variable.dimensions), integer=False)


def power_of_2(number: float) -> int:
    """Return the largest power of 2 up to a number, 1 at least."""
    return 1 << max(int(number).bit_length() - 1, 0)


def count_flags(flagged: Mapping[tuple[str, ...], int]) -> str:
    """Return a sentence on how many cases are flagged, and what for."""
    counts: Counter[str] = Counter()
    for flags, n in flagged.items():
        counts.update(dict.fromkeys(flags, n))
    words = ", ".join(f"{flag.replace('_', ' ')} ({n})" for flag, n in counts.most_common())
    total = sum(flagged.values())
    return f"{total} case{'' if total == 1 else 's'} flagged: {words}; see flags in {TABLE}"


def cases_at_once(size: float) -> int:
    """Return how many cases of so many bytes to read or to write at once, a power of 2."""
    return power_of_2(_WINDOW_BYTES / size)


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
    ids, status, error, version, flags = (
        read_words(file, name, sizes) for name in ("case", "status", "error", "version", "flags")
    )
    entries = np.zeros(len(ids), dtype=ENTRY)
    entries["id"] = ids
    for column, name in (
        ("rows", "steps_stored"), ("elements", "elements"), ("seconds", "seconds"),
        ("imbalance", "imbalance"),
    ):  # fmt: skip
        entries[column] = read_array(file, OF_CASES[name], sizes)
    tables = _tables(file, sizes)
    for column, axis in (("rows", "step"), ("elements", "element")):
        numbers = entries[column]
        if not ((numbers >= 0) & (numbers <= sizes.get(axis, 0))).all():
            raise ValueError(axis)
    names, code = np.unique(status, return_inverse=True)
    places = np.array([STATUS.index(name.decode()) for name in names], dtype=np.int8)
    entries["status"] = places[code]
    codes: dict[tuple[bytes, bytes, bytes], int] = {}
    columns = zip(version.tolist(), flags.tolist(), error.tolist(), strict=True)
    entries["kind"] = [codes.setdefault(words, len(codes)) for words in columns]
    kinds = tuple(Kind(v.decode(), split_flags(f.decode()), e.decode()) for v, f, e in codes)
    longest = _longest(file["case_toml"])
    each = [math.prod(table.shape[1:]) * table.dtype.itemsize for table in tables.values()]
    stretch = cases_at_once(max(longest, 1, *each))
    fields = tuple(name for name in OPTIONAL if name in tables)
    deep = any(tables[name].ndim == 3 for name in fields if name in FIELDS)
    axes = {axis: sizes[axis] for axis in AXES if axis in sizes}
    blocks = tuple(
        ResultsBlock(path, fields, deep, axes, longest, slice(first, first + stretch))
        for first in range(0, len(ids), stretch)
    )
    entries["block"], entries["place"] = np.divmod(np.arange(len(ids)), stretch)
    return Index(entries[~np.isnan(entries["seconds"])], kinds, blocks)


def _longest(dataset: h5py.Dataset) -> int:
    """Return the bytes of the longest text of a variable."""
    if dataset.dtype.kind == "S":
        return int(dataset.dtype.itemsize)
    return max((len(word) for word in dataset[:].tolist()), default=1)


@dataclass(frozen=True, eq=False)
class ResultsBlock(StoredBlock):
    """A stretch of the cases of a results file.

    Parameters
    ----------
    cases : which.
    """

    cases: slice

    def read(self, names: Iterable[str]) -> dict[str, Piece]:
        """Return those of some variables that are stored."""
        pieces = {}
        with reporting_damage(self.path), reading(self.path, SOFTWARE, WHAT) as file:
            for name in names:
                if name == "step":
                    if file["step"].attrs[SAME_STEPS]:
                        pieces[name] = Piece(read_array(file, STEP, {}).astype(float)[None])
                elif name in file:
                    values = file[name][self.cases]
                    pieces[name] = Piece(
                        side_numbers(values) if name == POINT_SIDE.name else values
                    )
        return pieces

    def texts(self, places: Sequence[int]) -> list[str]:
        """Return the TOML texts of some of the cases."""
        with reporting_damage(self.path), reading(self.path, SOFTWARE, WHAT) as file:
            words = file["case_toml"][self.cases]
            return [words[place].decode() for place in places]


def _tables(file: h5py.File, sizes: dict[str, int]) -> dict[str, h5py.Dataset]:
    """Return the variables of a case over all of them."""
    tables = {}
    for name, variable in {**ROWS, **LINE, **FIELDS, **EACH}.items():
        if name in file:
            last = name in FIELDS and file[name].ndim == 2
            own = over_cases(variable.at_last_step() if last else variable)
            if name == POINT_SIDE.name:
                tables[name] = find_words(file, name, sizes, own.dimensions)
            else:
                tables[name] = find_array(file, own, sizes)
    return tables
