"""The results file of a sweep: its name, and how the next sweep reads its cases, as blocks."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.errors import InputError, counted
from ringwear_par.results.fields import side_numbers
from ringwear_par.results.hdf5 import (
    UnreadableError,
    find_array,
    find_words,
    read_array,
    read_words,
    reading,
)
from ringwear_par.results.variables import POINT_SIDE
from ringwear_par.studies.storage.blocks import (
    BY_CASE,
    BY_STATE,
    CASE,
    STATUS,
    CaseBlock,
    Kind,
    reporting_damage,
)
from ringwear_par.studies.storage.stored_variables import (
    AXES,
    FIELDS,
    OF_CASES,
    STORED,
    over_cases,
)

SOFTWARE = "ringwear-par sweep"
#: the kind of the file in messages
FILE_KIND = "a results file of ringwear sweep"
RESULTS, TABLE = "results.h5", "cases.csv"
#: bytes of the cases that are read or written together
_WINDOW_BYTES = 24e6
#: separator of the flags of a case
_SEPARATOR = ", "


def join_flags(flags: Sequence[str]) -> str:
    """Return the flags of a case as files store them."""
    return _SEPARATOR.join(flags)


def split_flags(text: str) -> tuple[str, ...]:
    """Return the flags that a file stores of a case."""
    return tuple(text.split(_SEPARATOR)) if text else ()


def count_flags(flagged: Mapping[tuple[str, ...], int]) -> str:
    """Return a sentence on how many cases are flagged, and for which reasons."""
    counts: Counter[str] = Counter()
    for flags, n in flagged.items():
        counts.update(dict.fromkeys(flags, n))
    words = ", ".join(f"{flag.replace('_', ' ')} ({n})" for flag, n in counts.most_common())
    total = sum(flagged.values())
    return f"{counted(total, 'case')} flagged: {words}; see flags in {TABLE}"


def power_of_2(number: float) -> int:
    """Return the largest power of 2 up to a number, 1 at least."""
    return 1 << max(int(number).bit_length() - 1, 0)


def cases_at_once(size: float) -> int:
    """Return how many cases of so many bytes to read or to write at once, a power of 2."""
    return power_of_2(_WINDOW_BYTES / size)


@dataclass(frozen=True, eq=False)
class ResultsBlock(CaseBlock):
    """A stretch of the cases of a results file."""

    #: places of the cases in the file
    stretch: slice

    @cached_property
    def _is_state(self) -> Any:
        """(cases, steps) bool, which rows of the padded tables are stored states."""
        return np.arange(self.sizes["step"]) < self.cases["rows"][:, None]

    def read(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the stored ones of some columns."""
        columns = {}
        with reporting_damage(self.path), reading(self.path, SOFTWARE, FILE_KIND) as file:
            for name in names:
                if name not in self.axes:
                    continue
                values = file[name][self.stretch]
                if name == POINT_SIDE.name:
                    values = side_numbers(values)
                columns[name] = values[self._is_state] if self.axes[name] == BY_STATE else values
        return columns

    def texts(self, places: Sequence[int]) -> list[str]:
        """Return the TOML texts of some of the cases."""
        with reporting_damage(self.path), reading(self.path, SOFTWARE, FILE_KIND) as file:
            words = file["case_toml"][self.stretch]
            return [words[place].decode() for place in places]


def read_results_blocks(path: Path) -> list[CaseBlock] | None:
    """Return the cases of a results file; None if it is damaged. Not collective.

    Cases that were not begun have NaN for seconds. UnreadableError where it cannot be read now.
    """
    try:
        with reading(path, SOFTWARE, FILE_KIND) as file:
            return _blocks(path, file)
    except UnreadableError:
        raise
    except InputError:
        return None


def _blocks(path: Path, file: h5py.File) -> list[CaseBlock]:
    sizes: dict[str, int] = {}
    ids, status, error, version, flags = (
        read_words(file, name, sizes) for name in ("case", "status", "error", "version", "flags")
    )
    cases = np.zeros(len(ids), dtype=CASE)
    cases["id"] = ids
    for column, name in (
        ("rows", "steps_stored"), ("elements", "elements"), ("seconds", "seconds"),
        ("imbalance", "imbalance"),
    ):  # fmt: skip
        cases[column] = read_array(file, OF_CASES[name], sizes)
    tables = _tables(file, sizes)
    for column, axis in (("rows", "step"), ("elements", "element")):
        numbers = cases[column]
        if not ((numbers >= 0) & (numbers <= sizes.get(axis, 0))).all():
            raise ValueError(axis)
    names, code = np.unique(status, return_inverse=True)
    places = np.array([STATUS.index(name.decode()) for name in names], dtype=np.int8)
    cases["status"] = places[code]
    codes: dict[tuple[bytes, bytes, bytes], int] = {}
    words = zip(version.tolist(), flags.tolist(), error.tolist(), strict=True)
    cases["kind"] = [codes.setdefault(triple, len(codes)) for triple in words]
    kinds = tuple(Kind(v.decode(), split_flags(f.decode()), e.decode()) for v, f, e in codes)
    axes = dict.fromkeys(tables, BY_CASE)
    axes |= {
        name: BY_STATE
        for name, table in tables.items()
        if "step" in STORED[name].dimensions and table.ndim == 1 + len(STORED[name].dimensions)
    }
    longest = _longest(file["case_toml"])
    widths = [math.prod(table.shape[1:]) * table.dtype.itemsize for table in tables.values()]
    stretch = cases_at_once(max(longest + sum(widths), 1))  # about as many as are written together
    sizes = {axis: sizes[axis] for axis in ("step", "element", *AXES) if axis in sizes}
    return [
        ResultsBlock(
            path, cases[first : first + stretch], kinds, axes, sizes, longest,
            slice(first, first + stretch),
        )
        for first in range(0, len(ids), stretch)
    ]  # fmt: skip


def _longest(dataset: h5py.Dataset) -> int:
    """Return the bytes of the longest text of a variable."""
    if dataset.dtype.kind == "S":
        return int(dataset.dtype.itemsize)
    return max((len(word) for word in dataset[:].tolist()), default=1)


def _tables(file: h5py.File, sizes: dict[str, int]) -> dict[str, h5py.Dataset]:
    """Return the variables of a case over all of them."""
    tables = {}
    for name, variable in STORED.items():
        if name in file:
            last = name in FIELDS and file[name].ndim == 2
            padded = over_cases(variable.at_last_step() if last else variable)
            if name == POINT_SIDE.name:
                tables[name] = find_words(file, name, sizes, padded.dimensions)
            else:
                tables[name] = find_array(file, padded, sizes)
    return tables
