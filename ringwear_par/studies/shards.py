"""What a sweep has computed while it is at work, in blocks of cases: one SQLite file a team.

A case is done once its block is committed. A process that is killed leaves a file that SQLite mends
by itself; what a power failure can take is what was committed in the last second. Earlier versions
stored a row a case, in a table of another name, which is still read.
"""

import json
import sqlite3
import time
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.errors import ComputationError
from ringwear_par.studies.blocks import Block
from ringwear_par.studies.connections import ReadFile, columns_there, connect, holds_tables_only
from ringwear_par.studies.earlier import read_cases
from ringwear_par.studies.index import (
    DONE,
    FAILED,
    MOST_BLOCKS,
    STATUS,
    Index,
    Kind,
    Piece,
    index_of,
    is_damage,
    join,
)
from ringwear_par.studies.swept import FIELDS, OPTIONAL, is_wide, sizes_of, width
from ringwear_par.studies.texts import Texts

_SYNC_SECONDS = 1.0
#: of a block: ids, one a line; see ``Texts``; what is not a column as JSON; columns of its cases;
#: a checksum of these. Its arrays are by themselves, to be read one by one, each with its checksum
_BLOCKS = {
    "number": "INTEGER PRIMARY KEY", "ids": "TEXT", "texts": "TEXT", "about": "TEXT",
    "status": "BLOB", "rows": "BLOB", "seconds": "BLOB", "imbalance": "BLOB", "crc": "INTEGER",
}  # fmt: skip
_ARRAYS = {"block": "INTEGER", "name": "TEXT", "data": "BLOB", "crc": "INTEGER"}
#: how the arrays of a block are laid out: a value a stored step, a case, or a block
_ROWS, _EACH, _ONCE = "rows", "cases", "block"


@contextmanager
def _telling_unwritable(path: Path) -> Iterator[None]:
    """Tell why a shard cannot be written.

    Raises
    ------
    ComputationError : it cannot be.
    """
    try:
        yield
    except sqlite3.Error as error:
        raise ComputationError(f"{path}: cannot be written: {error}") from error


class Shard:
    """The file that a team writes its cases to; a context manager.

    Parameters
    ----------
    path : made if it is not there.

    Raises
    ------
    ComputationError : the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _telling_unwritable(path), ExitStack() as at_failure:
            self._connection = connect(path)
            at_failure.callback(self._connection.close)
            self._connection.execute("PRAGMA journal_mode=WAL")
            self._connection.execute("PRAGMA synchronous=NORMAL")
            for name, columns in (("arrays", _ARRAYS), ("blocks", _BLOCKS)):
                table = ", ".join(f"{column} {kind}" for column, kind in columns.items())
                key = ", PRIMARY KEY (block, name)" if name == "arrays" else ""
                self._connection.execute(f"CREATE TABLE IF NOT EXISTS {name} ({table}{key})")
            at_failure.pop_all()
        self._synced = time.monotonic()

    def add(self, block: Block) -> None:
        """Store cases for good: all of them, or none if the process is killed meanwhile.

        Raises
        ------
        ComputationError : the disk, or somebody has removed the file.
        """
        columns, layout = block.columns, {}
        arrays: dict[str, Any] = {"step": block.step, **columns.histories}
        layout.update(dict.fromkeys(arrays, _ROWS))
        arrays.update(columns.profiles)
        layout.update(dict.fromkeys(columns.profiles, _ROWS if block.deep else _EACH))
        arrays.update(block.line)
        layout.update(dict.fromkeys(block.line, _ONCE))
        arrays.update(columns.each)
        layout.update(dict.fromkeys(columns.each, _EACH))
        texts = block.texts
        about = {
            "version": block.version,
            "elements": len(block.line.get("r", ())),
            "layout": layout,
            "sizes": sizes_of(arrays),
            "errors": {i: reason for i, reason in enumerate(columns.reason) if reason},
            "flags": {i: flags for i, flags in enumerate(columns.flags) if flags},
            "longest": texts.longest,
        }
        row: dict[str, Any] = {
            "ids": "\n".join(block.ids),
            "texts": texts.packed(),
            "about": json.dumps(about),
            "status": bytes(map(STATUS.index, columns.status)),
            "rows": np.diff(columns.offsets).astype(np.int64).tobytes(),
            "seconds": np.asarray(columns.seconds, dtype=np.float64).tobytes(),
            "imbalance": np.asarray(columns.imbalance, dtype=np.float64).tobytes(),
        }
        row["crc"] = _checksum(row.values())
        with _telling_unwritable(self.path):
            execute = self._connection.execute
            execute("BEGIN")
            try:
                number = execute(
                    f"INSERT INTO blocks ({', '.join(row)}) VALUES ({', '.join('?' for _ in row)})",
                    tuple(row.values()),
                ).lastrowid
                for name, values in arrays.items():
                    data = np.ascontiguousarray(values, dtype=_dtype(name)).tobytes()
                    row_of_array = number, name, data, _checksum([data])
                    execute("INSERT INTO arrays VALUES (?, ?, ?, ?)", row_of_array)
                execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    execute("ROLLBACK")
                raise
            if time.monotonic() - self._synced > _SYNC_SECONDS:
                self._connection.execute("PRAGMA wal_checkpoint")
                self._synced = time.monotonic()
                if not self.path.exists():
                    raise ComputationError(f"{self.path}: was removed while it was written to")

    def close(self) -> None:
        """Bring everything to the disk."""
        with _telling_unwritable(self.path):
            self._connection.close()

    def __enter__(self) -> "Shard":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _dtype(name: str) -> Any:
    return np.int64 if name == "step" else np.float64


def _checksum(values: Iterable[str | bytes]) -> int:
    checksum = 0
    for value in values:
        checksum = zlib.crc32(value.encode() if isinstance(value, str) else value, checksum)
    return checksum


class _Blocks:
    """The blocks of a shard, see ``Source``."""

    def __init__(self, file: ReadFile) -> None:
        self.path, self._file = file.path, file
        #: by block: number of elements, layout of the arrays, sizes of their other axes
        self.layouts: dict[int, tuple[int, dict[str, str], dict[str, int]]] = {}
        self.offsets: dict[int, IntArray] = {}

    def read(self, block: int, name: str) -> Piece | None:
        """Return a variable of the cases of a block; None where it is not stored."""
        elements, layout, sizes = self.layouts[block]
        if name not in layout:
            return None
        query = "SELECT data, crc FROM arrays WHERE block = ? AND name = ?"
        data, crc = self._file.ask(query, block, name)
        if _checksum([data]) != crc:
            raise ValueError(name)
        values = np.frombuffer(data, dtype=_dtype(name))
        if is_wide(name):
            values = values.reshape(-1, width(name, elements, sizes))
        return Piece(values, self.offsets[block] if layout[name] == _ROWS else None)

    def texts(self, block: int, places: Sequence[int]) -> list[str]:
        """Return the texts of some cases of a block."""
        (packed,) = self._file.ask("SELECT texts FROM blocks WHERE number = ?", block)
        return Texts.unpacked(packed, len(self.offsets[block]) - 1).each(places)

    def close(self) -> None:
        """Let the file go."""
        self._file.close()


def read_index(path: Path) -> tuple[Index, int] | None:
    """Return the cases of a shard, and how many rows are damaged. Not collective.

    None if it is damaged as a whole. A file without contents, or without a table, holds nothing:
    its sweep was killed before its first case.

    Raises
    ------
    ComputationError : it is in use, or cannot be read.
    """
    if not path.is_file():  # a pipe may keep its reader waiting
        return None
    tail = Path(f"{path}-wal")
    if not path.stat().st_size and tail.exists() and tail.stat().st_size:
        return None  # SQLite would take it for new
    try:
        with closing(connect(path)) as connection:
            if not holds_tables_only(connection):
                return None
            if connection.execute("PRAGMA quick_check").fetchone()[0] != "ok":
                return None
            parts, bad = [], 0
            file = ReadFile(path)
            for read in (read_cases, _read_blocks):  # the newer ones are the later
                found = read(file, connection)
                if found is None:
                    return None
                parts += found[0]
                bad += len(found[1])
            return join(parts), bad
    except sqlite3.DatabaseError as error:
        if not is_damage(error):
            raise ComputationError(f"{path}: cannot be read: {error}") from error
        return None


def drop_damaged_rows(path: Path) -> None:
    """Drop rows that ``read_index`` counts as damaged. Not collective.

    Raises
    ------
    ComputationError : the file cannot be written.
    """
    with _telling_unwritable(path), closing(connect(path)) as connection:
        for table, read in (("cases", read_cases), ("blocks", _read_blocks)):
            found = read(ReadFile(path), connection)
            for row in found[1] if found is not None else ():
                if table == "blocks":
                    connection.execute("DELETE FROM arrays WHERE block = ?", (row,))
                connection.execute(f"DELETE FROM {table} WHERE rowid = ?", (row,))


def _read_blocks(
    file: ReadFile, connection: sqlite3.Connection
) -> tuple[list[Index], list[int]] | None:
    """Return the indices of the blocks of a shard, and which are damaged; None if all of it is."""
    there = columns_there(connection, "blocks")
    if not there:
        return [], []
    if _BLOCKS.keys() - there or _ARRAYS.keys() - columns_there(connection, "arrays"):
        return None
    sizes: dict[int, dict[str, int]] = {}
    lengths = "CASE typeof(data) WHEN 'blob' THEN length(data) END"
    for block, name, size in connection.execute(f"SELECT block, name, {lengths} FROM arrays"):
        sizes.setdefault(block, {})[name] = size
    source, parts, bad = _Blocks(file), [], []
    for number, *row, crc in connection.execute(f"SELECT {', '.join(_BLOCKS)} FROM blocks"):
        try:
            parts.append(_index_block(source, number, row, crc, sizes.get(number, {})))
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
            bad.append(number)
    return parts, bad


def _index_block(
    source: _Blocks, number: int, row: Sequence[Any], crc: int, sizes: dict[str, int]
) -> Index:
    """Return the index of a block, and note how it is laid out.

    Raises
    ------
    ValueError, TypeError, LookupError, AttributeError : it is damaged.
    """
    if _checksum(row) != crc or not 0 < number < MOST_BLOCKS:
        raise ValueError("checksum")
    ids, _, text, status, *numbers = row
    rows = np.frombuffer(numbers[0], dtype=np.int64)
    seconds, imbalance = (np.frombuffer(data) for data in numbers[1:])
    about = json.loads(text)
    elements, layout = about["elements"], about["layout"]
    axes = about.get("sizes", {})  # which older blocks do not have
    names = np.array(ids.encode().split(b"\n"))
    states = np.frombuffer(status, dtype=np.uint8).astype(np.int64)
    version, longest = about["version"], about["longest"]
    same = len(names) == len(states) == len(rows) == len(seconds) == len(imbalance)
    if not (same and isinstance(version, str) and longest >= 0 and rows.min() >= 0):
        raise ValueError(text)
    if not ((states == FAILED) | (states == DONE)).all():
        raise ValueError(status)
    count = {_ROWS: int(rows.sum()), _EACH: len(names), _ONCE: 1}
    for name, how in layout.items():
        if sizes[name] != 8 * width(name, elements, axes) * count[how]:
            raise ValueError(name)
    flags = {int(i): tuple(own) for i, own in about["flags"].items()}
    fields = tuple(name for name in OPTIONAL if name in layout)
    deep = any(layout[name] == _ROWS for name in fields if name in FIELDS)
    plain = Kind(version, (), fields, deep, tuple(axes.items()))
    kinds = [plain] if not flags else [
        plain._replace(flags=flags.get(i, ())) for i in range(len(names))
    ]  # fmt: skip
    source.layouts[number] = elements, layout, axes
    source.offsets[number] = np.concatenate([[0], np.cumsum(rows)])
    return index_of(
        source, number, names, states, rows, np.where(rows > 0, elements, 0), seconds, imbalance,
        kinds, errors={int(i): error for i, error in about["errors"].items()},
        longest=longest,
    )  # fmt: skip
