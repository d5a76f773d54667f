"""Cases that are stored together: as they are computed, and packed into bytes.

A packed block is a header and its data::

    marker | bytes of the words | number of cases | bytes of the data | checksum | words | cases
    data of each array, one after another

The header (the first line, its checksum is of all of it) is what an index needs: ``cases`` has a
row of ``_CASE`` each, the words are JSON: where each array is, its checksum, versions, errors.
"""

import json
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.files.ordinary import open_ordinary
from ringwear_par.results.result import HistoryColumns
from ringwear_par.results.variables import LAYER_PROFILES, LINE
from ringwear_par.studies.definition.texts import Texts
from ringwear_par.studies.storage.index import (
    ENTRY,
    STATUS,
    Index,
    Kind,
    Piece,
    StoredBlock,
    reporting_damage,
)
from ringwear_par.studies.storage.stored_variables import (
    EACH,
    FIELDS,
    OPTIONAL,
    ROWS,
    is_wide,
    sizes_of,
    width,
)

#: with which each block begins: no text, and not in numbers but by chance
MARKER = bytes.fromhex("d2ff5257b10c0a1a8e5be0c4f3079d61")
_HEAD = struct.Struct("<16sIIQI")
_CASE = np.dtype([
    ("id", "S16"), ("status", "i1"), ("rows", "<i8"), ("seconds", "<f8"), ("imbalance", "<f8"),
    ("kind", "<i4"),
])  # fmt: skip
#: how an array is laid out: a value a stored step, a case, or a block
_ROWS, _EACH, _ONCE = "rows", "cases", "block"
_TEXTS = "toml"


@dataclass(frozen=True)
class Record:
    """A case and its history.

    Parameters
    ----------
    id : of the case.
    toml : the case's text.
    status : "done", "failed" or "incomplete".
    error : reason of a failure, "" without one.
    seconds : wall time of the case, assembly excluded.
    imbalance : worst balance or KKT residual of its steps (0 where it has no history).
    arrays : variables by name: histories (steps,) or (steps, layers or points), fields
        (steps, elements) or (elements,), ``r`` and ``width`` (elements,), ``step`` (steps,), what
        there is one of () or (points,).
    version : of ringwear-par that computed it.
    flags : short names of what makes the answer doubtful.
    """

    id: str
    toml: str
    status: str
    error: str
    seconds: float
    imbalance: float
    arrays: dict[str, FloatArray]
    version: str
    flags: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Number of the stored steps."""
        return len(self.arrays.get("time", ()))


@dataclass(frozen=True, eq=False)
class Block:
    """Cases of one contact pair that have ended, with the same fields stored as often.

    Parameters
    ----------
    ids, texts : of the cases.
    version : of ringwear-par that computed them.
    line : ``r`` and ``width`` of the contact elements, (n,) each.
    deep : whether fields are stored at every stored step, or at the last one only.
    step : (rows,) int, numbers of the stored steps.
    columns : their histories.
    """

    ids: tuple[str, ...]
    texts: Texts
    version: str
    line: Mapping[str, FloatArray]
    deep: bool
    step: IntArray
    columns: HistoryColumns

    @classmethod
    def of(cls, records: Sequence[Record], texts: Texts | None = None) -> "Block":
        """Return records, of one version and with the same fields, as a block.

        Parameters
        ----------
        texts : of the cases, if they have something in common.
        """
        full = [record for record in records if record.rows]
        first: dict[str, Any] = full[0].arrays if full else {}
        deep = any(first[name].ndim == 2 for name in FIELDS if name in first)

        def rows(name: str) -> Any:
            return np.concatenate([record.arrays[name] for record in full]) if full else np.zeros(0)

        def last(name: str) -> FloatArray:
            nothing = np.full_like(first[name], np.nan)
            return np.array([record.arrays.get(name, nothing) for record in records])

        columns = HistoryColumns(
            offsets=np.cumsum([0, *(record.rows for record in records)]),
            steps=rows("step").astype(np.int64),
            histories={name: rows(name) for name in ROWS if name in first},
            profiles={name: rows(name) if deep else last(name) for name in FIELDS if name in first},
            imbalance=np.array([record.imbalance for record in records]),
            flags=tuple(record.flags for record in records),
            seconds=np.array([record.seconds for record in records]),
            status=tuple(record.status for record in records),
            reason=tuple(record.error for record in records),
            whole={name: last(name) for name in EACH if name in first},
        )
        return cls(
            tuple(record.id for record in records),
            texts or Texts.whole([record.toml for record in records]),
            records[0].version,
            {name: first[name] for name in LINE if name in first},
            deep,
            columns.steps,
            columns,
        )

    @classmethod
    def of_columns(
        cls, columns: HistoryColumns, case: Case, ids: Sequence[str], texts: Texts, version: str
    ) -> "Block":
        """Return histories as they were computed as a block.

        Parameters
        ----------
        case : one of theirs.
        ids, texts : of the cases.
        version : of ringwear-par that computed them.
        """
        step = columns.steps
        if case.output.times:
            first = columns.offsets[:-1]
            step = np.arange(len(step)) - np.repeat(first, np.diff(columns.offsets))
        if columns.layers or columns.stress:
            left = {name: v for name, v in columns.layers.items() if name in LAYER_PROFILES}
            rest = {name: v for name, v in columns.layers.items() if name not in left}
            columns = replace(
                columns,
                histories={**columns.histories, **rest, **columns.stress},
                profiles={**columns.profiles, **left},
            )
        line = {"r": case.line.r, "width": case.line.width}
        deep = case.output.profiles == "all"
        return cls(tuple(ids), texts, version, line, deep, step, columns)

    def packed(self) -> bytes:
        """Return the block as ``unpack_header`` reads it."""
        columns = self.columns
        tables: tuple[tuple[str, Mapping[str, Any]], ...] = (
            (_ROWS, {"step": self.step, **columns.histories}),
            (_ROWS if self.deep else _EACH, columns.profiles),
            (_ONCE, self.line),
            (_EACH, columns.whole),
        )
        arrays = {name: values for _, table in tables for name, values in table.items()}
        data = [np.ascontiguousarray(v, dtype=_dtype(n)).tobytes() for n, v in arrays.items()]
        data.append(self.texts.packed().encode())
        layouts = [layout for layout, table in tables for _ in table] + [_ONCE]
        layout = {
            name: (how, len(part), zlib.crc32(part))
            for name, how, part in zip((*arrays, _TEXTS), layouts, data, strict=True)
        }
        kinds: dict[Kind, int] = {}
        cases = np.zeros(len(self.ids), dtype=_CASE)
        cases["id"], cases["rows"] = self.ids, np.diff(columns.offsets)
        cases["status"] = [STATUS.index(status) for status in columns.status]
        cases["seconds"], cases["imbalance"] = columns.seconds, columns.imbalance
        cases["kind"] = [
            kinds.setdefault(Kind(self.version, tuple(flags), reason), len(kinds))
            for flags, reason in zip(columns.flags, columns.reason, strict=True)
        ]
        words = {
            "elements": len(self.line.get("r", ())),
            "sizes": sizes_of(arrays),
            "longest": self.texts.longest,
            "kinds": list(kinds),
            "arrays": layout,
        }
        header = json.dumps(words).encode() + cases.tobytes()
        size = sum(map(len, data))
        numbers = len(header) - cases.nbytes, len(cases), size
        head = _HEAD.pack(MARKER, *numbers, _checksum(numbers, header))
        return b"".join((head, header, *data))


def _checksum(numbers: tuple[int, int, int], header: bytes) -> int:
    return zlib.crc32(header, zlib.crc32(repr(numbers).encode()))


def _dtype(name: str) -> Any:
    return np.dtype("<i8" if name == "step" else "<f8")


@dataclass(frozen=True, eq=False)
class PackedBlock(StoredBlock):
    """A packed block of a file, or in memory.

    Parameters
    ----------
    start, stop : where its data begin, and end.
    rows : (cases,) stored steps.
    elements : number of them.
    arrays : layout, bytes and checksum of each.
    memory : the file's bytes, if there is no such file.
    """

    start: int
    stop: int
    rows: IntArray
    elements: int
    arrays: Mapping[str, tuple[str, int, int]]
    memory: bytes | None = None

    def read(self, names: Iterable[str]) -> dict[str, Piece]:
        """Return those of some variables that are stored."""
        offsets = np.concatenate([[0], np.cumsum(self.rows)])
        pieces = {}
        for name, data in self._bytes(names).items():
            values = np.frombuffer(data, dtype=_dtype(name))
            if is_wide(name):
                values = values.reshape(-1, width(name, self.elements, self.sizes))
            by_row = self.arrays[name][0] == _ROWS
            pieces[name] = Piece(values, offsets if by_row else None)
        return pieces

    def texts(self, places: Sequence[int]) -> list[str]:
        """Return the TOML texts of some of the cases."""
        packed = self._bytes([_TEXTS])[_TEXTS]
        with reporting_damage(self.path):
            return Texts.unpacked(packed.decode(), len(self.rows)).of_cases(places)

    def check(self) -> None:
        """Raise DamagedError if any of the data is damaged."""
        self.read(name for name in self.arrays if name != _TEXTS)
        self.texts(())

    def _bytes(self, names: Iterable[str]) -> dict[str, bytes]:
        """Return the bytes of those of some arrays that are stored."""
        wanted, at, found = set(names), self.start, {}
        with reporting_damage(self.path):
            file = None if self.memory is not None else open_ordinary(self.path)
            try:
                for name, (_, size, checksum) in self.arrays.items():
                    if name in wanted:
                        if file is None:
                            assert self.memory is not None
                            data = self.memory[at : at + size]
                        else:
                            file.seek(at)
                            data = file.read(size)
                        if len(data) != size or zlib.crc32(data) != checksum:
                            raise ValueError(name)
                        found[name] = data
                    at += size
            finally:
                if file is not None:
                    file.close()
        return found


def unpack_header(
    content: Any, at: int, path: Path, memory: bytes | None = None
) -> tuple[PackedBlock, Index] | None:
    """Return the block that begins at a place of a file, and its index; None if it is damaged.

    Parameters
    ----------
    content : bytes of the file, of which no more than the header are looked at.
    path, memory : see ``PackedBlock``.
    """
    begin = at + _HEAD.size
    if begin > len(content):
        return None
    marker, size, count, data, checksum = _HEAD.unpack(content[at:begin])
    start = begin + size + count * _CASE.itemsize
    if marker != MARKER or start + data > len(content):
        return None
    header = content[begin:start]
    if _checksum((size, count, data), header) != checksum:
        return None
    try:
        words = json.loads(header[:size])
        cases = np.frombuffer(header[size:], dtype=_CASE)
        arrays = {name: (how, size, crc) for name, (how, size, crc) in words["arrays"].items()}
        fields = tuple(name for name in OPTIONAL if name in arrays)
        deep = any(arrays[name][0] == _ROWS for name in fields if name in FIELDS)
        sizes = {axis: int(length) for axis, length in words["sizes"].items()}
        block = PackedBlock(
            path, fields, deep, sizes, int(words["longest"]), start, start + data,
            cases["rows"], int(words["elements"]), arrays, memory,
        )  # fmt: skip
        kinds = tuple(
            Kind(str(version), tuple(map(str, flags)), str(error))
            for version, flags, error in words["kinds"]
        )
        return block, _index(block, cases, kinds)
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
        return None


def _index(block: PackedBlock, cases: Any, kinds: tuple[Kind, ...]) -> Index:
    """Return the index of a block.

    Raises
    ------
    ValueError, TypeError, LookupError : the header makes no sense, for all its right checksum.
    """
    count = {_ROWS: int(block.rows.sum()), _EACH: len(cases), _ONCE: 1}
    for name, (how, size, _) in block.arrays.items():
        if name == _TEXTS:
            continue
        if size != 8 * width(name, block.elements, block.sizes) * count[how]:
            raise ValueError(name)
    if sum(size for _, size, _ in block.arrays.values()) != block.stop - block.start:
        raise ValueError("arrays")
    good = (cases["status"] >= 0) & (cases["status"] < len(STATUS)) & (cases["rows"] >= 0)
    if not (good & (cases["kind"] >= 0) & (cases["kind"] < len(kinds))).all():
        raise ValueError("cases")
    entries = np.zeros(len(cases), dtype=ENTRY)
    for name in _CASE.names or ():
        entries[name] = cases[name]
    entries["elements"] = np.where(block.rows > 0, block.elements, 0)
    entries["place"] = np.arange(len(cases))
    return Index(entries, kinds, (block,))


def is_torn(tail: bytes) -> bool:
    """Tell whether the last bytes of a file are the beginning of a block that has no end."""
    if len(tail) < _HEAD.size:
        return MARKER.startswith(tail[: len(MARKER)])
    marker, size, count, data, _ = _HEAD.unpack(tail[: _HEAD.size])
    whole: int = _HEAD.size + size + count * _CASE.itemsize + data
    return bool(marker == MARKER and whole > len(tail))
