"""Blocks: cases that a sweep stores together, as they are computed and as its files have them.

A packed block is a header and its data::

    marker | bytes of the words | number of cases | bytes of the data | checksum | words | cases
    data of each column, one after another

The header (the first line, its checksum is of all of it) is enough for an index: ``cases`` has a
row of ``CASE`` each, the words are JSON: where each column is, its checksum, versions, errors. Of a
column that is the same number throughout there is one.
"""

import json
import math
import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import IntArray, is_one_number
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.results.hdf5 import UnreadableError
from ringwear_par.results.result import HistoryColumns
from ringwear_par.results.variables import LINE
from ringwear_par.studies.storage.stored_variables import FIELDS, shape_of, sizes_of

#: statuses of a case, in the order of the numbers that stand for them
STATUS = ("incomplete", "failed", "done")
INCOMPLETE, FAILED, DONE = range(3)
#: of each case: ``rows`` stored states of so many contact ``elements``; wall time; worst balance or
#: KKT residual of the steps; index into the ``kinds`` of its block
CASE = np.dtype([
    ("id", "S16"), ("status", "i1"), ("rows", "<i8"), ("elements", "<i8"), ("seconds", "<f8"),
    ("imbalance", "<f8"), ("kind", "<i4"),
])  # fmt: skip
#: the first axis of a column: it has a value for each stored state, case after case, for each case,
#: or one for all cases
BY_STATE, BY_CASE, SHARED = "state", "case", "block"
#: with which each packed block begins: no text, and not in numbers but by chance
MARKER = bytes.fromhex("d2ff5257b10c0a1a8e5be0c4f3079d61")
_HEAD = struct.Struct("<16sIIQI")
#: name of the compressed texts of all cases, and what separates them: no text of a case has it
_TEXTS, _BETWEEN = "toml", "\0"
#: errors of reading a damaged file
DAMAGE = (
    RuntimeError, LookupError, AttributeError, TypeError, ValueError, OverflowError, InputError,
    zlib.error,
)  # fmt: skip


class DamagedError(ComputationError):
    """A file whose contents cannot be read."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is damaged")
        self.path = path

    def __reduce__(self) -> tuple[type["DamagedError"], tuple[Path]]:
        return type(self), (self.path,)


@contextmanager
def reporting_damage(path: Path) -> Iterator[None]:
    """Name the file that turns out to be damaged (DamagedError), or cannot be read now."""
    try:
        yield
    except UnreadableError:
        raise
    except DAMAGE as error:
        raise DamagedError(path) from error
    except OSError as error:
        raise ComputationError(f"{path}: cannot be read: {error.strerror or error}") from error


class Kind(NamedTuple):
    """Version, flags and error, which many cases have in common."""

    #: of ringwear-par that computed them
    version: str
    #: short names of the reasons to doubt their answers
    flags: tuple[str, ...] = ()
    #: why they failed, "" where they have not
    error: str = ""


@dataclass(frozen=True, eq=False)
class CaseBlock(ABC):
    """Cases that are stored together, and are read together."""

    #: of their file
    path: Path
    #: (cases,) of ``CASE``
    cases: Any
    #: of the cases
    kinds: tuple[Kind, ...]
    #: the first axis of each stored column
    axes: Mapping[str, str]
    #: of the other axes
    sizes: Mapping[str, int]
    #: bytes of the longest text
    longest: int

    @property
    def deep(self) -> bool:
        """Whether fields are stored at every stored state."""
        return any(axis == BY_STATE for name, axis in self.axes.items() if name in FIELDS)

    @cached_property
    def offsets(self) -> IntArray:
        """(cases + 1,) where the states of each case begin and end."""
        return np.concatenate([[0], np.cumsum(self.cases["rows"])])

    @abstractmethod
    def read(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the stored ones of some columns, or DamagedError."""

    @abstractmethod
    def texts(self, places: Sequence[int]) -> list[str]:
        """Return the TOML texts of some of the cases; raises as ``read``."""


@dataclass(frozen=True, eq=False)
class Block:
    """Cases of one contact pair, with the same fields stored as often, to be packed."""

    #: see ``CaseBlock``
    cases: Any
    kinds: tuple[Kind, ...]
    axes: Mapping[str, str]
    #: by name
    columns: Mapping[str, Any]
    #: of the cases, as case files
    texts: Sequence[str]

    @classmethod
    def of(
        cls,
        histories: HistoryColumns,
        line: ContactLine,
        ids: Sequence[str],
        texts: Sequence[str],
        version: str,
        *,
        deep: bool,
    ) -> "Block":
        """Return histories as they were computed as a block, of the contact elements of a line.

        Fields are ``deep`` where they are stored at every stored state, not at the last one only.
        """
        columns = {
            **histories.histories,
            **histories.layers,
            **histories.stress,
            **histories.profiles,
        }
        axes = dict.fromkeys(columns, BY_STATE)
        if not deep:
            axes |= {name: BY_CASE for name in columns if name in FIELDS}
        columns |= {name: getattr(line, name) for name in LINE} | dict(histories.whole)
        axes |= dict.fromkeys(LINE, SHARED) | dict.fromkeys(histories.whole, BY_CASE)
        kinds: dict[Kind, int] = {}
        cases = np.zeros(len(ids), dtype=CASE)
        cases["id"], cases["rows"] = ids, np.diff(histories.offsets)
        cases["elements"] = np.where(cases["rows"] > 0, line.n, 0)
        cases["status"] = [STATUS.index(status) for status in histories.status]
        cases["seconds"], cases["imbalance"] = histories.seconds, histories.imbalance
        cases["kind"] = [
            kinds.setdefault(Kind(version, tuple(flags), reason), len(kinds))
            for flags, reason in zip(histories.flags, histories.reason, strict=True)
        ]
        return cls(cases, tuple(kinds), axes, columns, texts)

    def packed(self) -> list[memoryview]:
        """Return the block as ``unpack_header`` reads it, in parts that follow each other."""
        data = {name: _stored(values).view(np.uint8).data for name, values in self.columns.items()}
        data[_TEXTS] = memoryview(zlib.compress(_BETWEEN.join(self.texts).encode(), 1))
        words = {
            "sizes": sizes_of(self.columns),
            "longest": max(len(text.encode()) for text in self.texts),
            "kinds": self.kinds,
            "columns": {
                name: (self.axes.get(name, SHARED), len(part), zlib.crc32(part))
                for name, part in data.items()
            },
        }
        header = json.dumps(words).encode() + self.cases.tobytes()
        size = sum(map(len, data.values()))
        numbers = len(header) - self.cases.nbytes, len(self.cases), size
        head = _HEAD.pack(MARKER, *numbers, _checksum(numbers, header))
        return [memoryview(head + header), *data.values()]


def _stored(values: Any) -> Any:
    """Return the numbers of a column, or the one that all of them are, to the last bit."""
    if is_one_number(values):
        values = values.flat[:1]
    numbers = np.ascontiguousarray(values, dtype="<f8").reshape(-1)
    bits = numbers.view(np.int64)
    return numbers[:1] if (bits[-1:] == bits[:1]).all() and (bits == bits[:1]).all() else numbers


def _checksum(numbers: tuple[int, int, int], header: bytes) -> int:
    return zlib.crc32(header, zlib.crc32(repr(numbers).encode()))


@dataclass(frozen=True, eq=False)
class PackedBlock(CaseBlock):
    """A packed block of a file."""

    #: where it begins, where its data begin, and end
    begin: int
    start: int
    stop: int
    #: bytes and checksum of each column, and of the texts
    parts: Mapping[str, tuple[int, int]]

    def read(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the stored ones of some columns."""
        counts, columns = _counts(self.cases), {}
        for name, part in self._bytes(names).items():
            shape = counts[self.axes[name]], *shape_of(name, self.sizes)
            numbers = np.frombuffer(part, "<f8")
            alike = len(numbers) < math.prod(shape)
            columns[name] = np.broadcast_to(numbers, shape) if alike else numbers.reshape(shape)
        return columns

    def texts(self, places: Sequence[int]) -> list[str]:
        """Return the TOML texts of some of the cases."""
        packed = self._bytes([_TEXTS])[_TEXTS]
        with reporting_damage(self.path):
            texts = zlib.decompress(packed).decode().split(_BETWEEN)
            if len(texts) != len(self.cases):
                raise ValueError(_TEXTS)
            return [texts[place] for place in places]

    def check(self) -> None:
        """Raise DamagedError if any of the data is damaged."""
        self.read(self.axes)
        self.texts(())

    def _bytes(self, names: Iterable[str]) -> dict[str, bytes]:
        """Return the bytes of those of some columns that are stored."""
        wanted, at, parts = set(names), self.start, {}
        with reporting_damage(self.path), self.path.open("rb") as file:
            for name, (size, checksum) in self.parts.items():
                if name in wanted:
                    file.seek(at)
                    part = file.read(size)
                    if len(part) != size or zlib.crc32(part) != checksum:
                        raise ValueError(name)
                    parts[name] = part
                at += size
        return parts


def unpack_header(content: Any, at: int, path: Path) -> PackedBlock | None:
    """Return the block that begins at a place of a file's content; None for a damaged header."""
    end = at + _HEAD.size
    if end > len(content):
        return None
    marker, size, count, data, checksum = _HEAD.unpack(content[at:end])
    start = end + size + count * CASE.itemsize
    if marker != MARKER or start + data > len(content):
        return None
    header = content[end:start]
    if _checksum((size, count, data), header) != checksum:
        return None
    try:
        words = json.loads(header[:size])
        columns = {name: (axis, size, crc) for name, (axis, size, crc) in words["columns"].items()}
        kinds = tuple(
            Kind(str(version), tuple(map(str, flags)), str(error))
            for version, flags, error in words["kinds"]
        )
        block = PackedBlock(
            path, np.frombuffer(header[size:], dtype=CASE), kinds,
            {name: axis for name, (axis, _, _) in columns.items() if name != _TEXTS},
            {axis: int(length) for axis, length in words["sizes"].items()},
            int(words["longest"]), at, start, start + data,
            {name: (size, crc) for name, (_, size, crc) in columns.items()},
        )  # fmt: skip
        return block if _is_consistent(block) else None
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
        return None


def _counts(cases: Any) -> dict[str, int]:
    """Return the lengths of the first axes of columns of some cases."""
    return {BY_STATE: int(cases["rows"].sum()), BY_CASE: len(cases), SHARED: 1}


def _is_consistent(block: PackedBlock) -> bool:
    """Tell whether a header makes sense, for all its right checksum; may raise instead."""
    cases, counts = block.cases, _counts(block.cases)
    sizes = {
        name: 8 * counts[axis] * math.prod(shape_of(name, block.sizes))
        for name, axis in block.axes.items()
    }
    return bool(
        all(block.parts[name][0] in (size, min(size, 8)) for name, size in sizes.items())
        and sum(size for size, _ in block.parts.values()) == block.stop - block.start
        and ((cases["status"] >= 0) & (cases["status"] < len(STATUS))).all()
        and ((cases["rows"] >= 0) & (cases["elements"] >= 0)).all()
        and ((cases["kind"] >= 0) & (cases["kind"] < len(block.kinds))).all()
    )


def is_torn(tail: bytes) -> bool:
    """Tell whether the last bytes of a file are the beginning of a block that has no end."""
    if len(tail) < _HEAD.size:
        return MARKER.startswith(tail[: len(MARKER)])
    marker, size, count, data, _ = _HEAD.unpack(tail[: _HEAD.size])
    whole: int = _HEAD.size + size + count * CASE.itemsize + data
    return bool(marker == MARKER and whole > len(tail))
