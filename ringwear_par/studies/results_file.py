"""What the results file of a sweep is called and holds, and how the next sweep reads it."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from ringwear_par.errors import InputError
from ringwear_par.results.reading import (
    UnreadableError,
    find_array,
    find_words,
    read_array,
    read_words,
    reading,
)
from ringwear_par.results.stress_variables import POINT_SIDE, side_numbers
from ringwear_par.results.variables import LINE, STEP, Variable
from ringwear_par.studies.earlier import UNKNOWN_VERSION
from ringwear_par.studies.index import STATUS, Index, Kind, Piece, index_of, split_flags
from ringwear_par.studies.swept import AXES, EACH, FIELDS, OPTIONAL, ROWS

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
    )
}  # fmt: skip


def over_cases(variable: Variable) -> Variable:
    """Return a variable of one case as the results of all have it, padded with NaN."""
    return replace(variable, dimensions=("case", *variable.dimensions), integer=False)


def power_of_2(number: float) -> int:
    """Return the largest power of 2 up to a number, 1 at least."""
    return 1 << max(int(number).bit_length() - 1, 0)


def told_flags(flagged: Mapping[tuple[str, ...], int]) -> str:
    """Return how many cases are flagged, and what for."""
    counts: Counter[str] = Counter()
    for flags, n in flagged.items():
        counts.update(dict.fromkeys(flags, n))
    told = ", ".join(f"{flag.replace('_', ' ')} ({n})" for flag, n in counts.most_common())
    total = sum(flagged.values())
    return f"{total} case{'' if total == 1 else 's'} flagged: {told}; see flags in {TABLE}"


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
    ids, status, errors = (read_words(file, name, sizes) for name in ("case", "status", "error"))
    rows, elements, seconds, imbalance = (
        read_array(file, OF_CASES[name], sizes)
        for name in ("steps_stored", "elements", "seconds", "imbalance")
    )
    fields = tuple(name for name in OPTIONAL if name in file)
    deep = any(file[name].ndim == 3 for name in fields if name in FIELDS)
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
    axes = tuple((axis, sizes[axis]) for axis in AXES if axis in sizes)
    kinds = [
        Kind(version[i].decode(), split_flags(flags[i].decode()), fields, deep, axes) for i in first
    ]
    longest = _longest(file["case_toml"])
    each = [math.prod(table.shape[1:]) * table.dtype.itemsize for table in tables.values()]
    stretch = cases_at_once(max(longest, 1, *each))
    source = Results(path, set(tables), stretch)
    whole = replace(
        index_of(
            source, 0, ids, states, rows, elements, seconds, imbalance, kinds[:1] or [Kind("")],
            errors={int(i): errors[i].decode() for i in np.flatnonzero(errors)},
            longest=longest,
        ),
        kind=which, kinds=tuple(kinds) or (Kind(""),),
        block=np.arange(len(ids)) // stretch, place=np.arange(len(ids)) % stretch,
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
    names : variables of a case that it has.
    stretch : number of cases that are read at once.
    """

    def __init__(self, path: Path, names: set[str], stretch: int) -> None:
        self.path, self._names, self._stretch = path, names, stretch

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
                values = file[name][self._cases(block)]
                return Piece(side_numbers(values) if name == POINT_SIDE.name else values)
            steps = read_array(file, STEP, {}).astype(float)
            # files of before the attribute: only where they are not just numbered does it matter
            same = file["step"].attrs.get(SAME_STEPS, (steps != np.arange(len(steps))).any())
            return Piece(steps[None]) if same else None

    def texts(self, block: int, places: Sequence[int]) -> list[str]:
        """Return the texts of some cases of a stretch.

        Raises
        ------
        InputError : the file is damaged.
        """
        with reading(self.path, SOFTWARE, WHAT) as file:
            words = file["case_toml"][self._cases(block)]
            return [words[place].decode() for place in places]

    def _cases(self, block: int) -> slice:
        return slice(block * self._stretch, (block + 1) * self._stretch)

    def close(self) -> None:
        """Let the file go, which is opened for each answer."""


def _tables(file: h5py.File, sizes: dict[str, int]) -> dict[str, h5py.Dataset]:
    """Return the variables of a case over all of them."""
    found = {}
    for name, variable in {**ROWS, **LINE, **FIELDS, **EACH}.items():
        if name in file:
            last = name in FIELDS and file[name].ndim == 2
            own = over_cases(variable.at_last_step() if last else variable)
            if name == POINT_SIDE.name:
                found[name] = find_words(file, name, sizes, own.dimensions)
            else:
                found[name] = find_array(file, own, sizes)
    return found
