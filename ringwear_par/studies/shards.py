"""What a sweep has computed while it is at work, in blocks of cases: one SQLite file a team.

A case is done once its block is committed. A process that is killed leaves a file that SQLite mends
by itself; what a power failure can take is what was committed in the last second. Earlier versions
stored a row a case, in a table of another name, which is still read.
"""

import fcntl
import json
import math
import sqlite3
import time
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.results.variables import HISTORIES, LINE, PROFILES
from ringwear_par.studies.blocks import Block, Record
from ringwear_par.studies.index import (
    DONE,
    FAILED,
    STATUS,
    Index,
    Kind,
    Piece,
    Source,
    index_of,
    is_damage,
    join,
    split_flags,
)
from ringwear_par.studies.texts import Texts

FOLDER = "shards"
_SYNC_SECONDS = 1.0
#: how long to wait for processes of a killed sweep to end
_BUSY_SECONDS = 5.0
#: of a block: ids, one a line; see ``Texts``; what is not a column as JSON; columns of its cases;
#: a checksum of these. Its arrays are by themselves, to be read one by one
_BLOCKS = {
    "number": "INTEGER PRIMARY KEY", "ids": "TEXT", "texts": "TEXT", "about": "TEXT",
    "status": "BLOB", "rows": "BLOB", "seconds": "BLOB", "imbalance": "BLOB", "crc": "INTEGER",
}  # fmt: skip
_ARRAYS = {"block": "INTEGER", "name": "TEXT", "data": "BLOB"}
#: the table of earlier versions
_CASES = (
    "id", "toml", "status", "error", "seconds", "imbalance", "layout", "data", "version", "flags",
)  # fmt: skip
#: what cases have that were stored before these columns were
_DEFAULTS = {"version": "unknown", "flags": ""}
#: version of such cases
UNKNOWN_VERSION = _DEFAULTS["version"]
#: how the arrays of a block are laid out: a value a stored step, a case, or a block
_ROWS, _EACH, _ONCE = "rows", "cases", "block"


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, timeout=_BUSY_SECONDS, isolation_level=None)
    connection.text_factory = partial(str, encoding="utf-8", errors="replace")
    # one process a file: its index needs no memory shared with others, which not all disks offer
    connection.execute("PRAGMA locking_mode=EXCLUSIVE")
    return connection


def _columns_there(connection: sqlite3.Connection, table: str) -> set[str]:
    return {row[1] for row in connection.execute(f"PRAGMA table_info({table})")}


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
        with self._told(), ExitStack() as at_failure:
            self._connection = _connect(path)
            at_failure.callback(self._connection.close)
            self._connection.execute("PRAGMA journal_mode=WAL")
            self._connection.execute("PRAGMA synchronous=NORMAL")
            for name, columns in (("arrays", _ARRAYS), ("blocks", _BLOCKS)):
                table = ", ".join(f"{column} {kind}" for column, kind in columns.items())
                key = ", PRIMARY KEY (block, name)" if name == "arrays" else ""
                self._connection.execute(f"CREATE TABLE IF NOT EXISTS {name} ({table}{key})")
            at_failure.pop_all()
        self._synced = time.monotonic()

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise ComputationError(f"{self.path}: cannot be written: {error}") from error

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
        texts = block.texts
        about = {
            "version": block.version,
            "elements": len(block.line.get("r", ())),
            "layout": layout,
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
        with self._told():
            execute = self._connection.execute
            execute("BEGIN")
            try:
                number = execute(
                    f"INSERT INTO blocks ({', '.join(row)}) VALUES ({', '.join('?' for _ in row)})",
                    tuple(row.values()),
                ).lastrowid
                for name, values in arrays.items():
                    data = np.ascontiguousarray(values, dtype=_dtype(name)).tobytes()
                    execute("INSERT INTO arrays VALUES (?, ?, ?)", (number, name, data))
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
        with self._told():
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


class _File:
    """A shard that is read, opened when it is asked for the first time.

    Parameters
    ----------
    path : of the shard.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._connection: sqlite3.Connection | None = None

    def ask(self, query: str, *values: Any) -> Any:
        """Return a row, which must be there.

        Raises
        ------
        ValueError : it is not.
        """
        if self._connection is None:
            self._connection = _connect(self.path)
        row = self._connection.execute(query, values).fetchone()
        if row is None:
            raise ValueError(query)
        return row

    def close(self) -> None:
        """Let the file go."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None


class _Blocks:
    """The blocks of a shard, see ``Source``."""

    def __init__(self, file: _File) -> None:
        self.path, self._file = file.path, file
        #: by block: number of elements, layout of the arrays
        self.layouts: dict[int, tuple[int, dict[str, str]]] = {}
        self.offsets: dict[int, IntArray] = {}

    def read(self, block: int, name: str) -> Piece | None:
        """Return a variable of the cases of a block; None where it is not stored."""
        elements, layout = self.layouts[block]
        if name not in layout:
            return None
        query = "SELECT data FROM arrays WHERE block = ? AND name = ?"
        (data,) = self._file.ask(query, block, name)
        values = np.frombuffer(data, dtype=_dtype(name))
        if name in PROFILES or name in LINE:
            values = values.reshape(-1, elements)
        return Piece(values, self.offsets[block] if layout[name] == _ROWS else None)

    def texts(self, block: int, places: Sequence[int]) -> list[str]:
        """Return the texts of some cases of a block."""
        (packed,) = self._file.ask("SELECT texts FROM blocks WHERE number = ?", block)
        return Texts.unpacked(packed, len(self.offsets[block]) - 1).each(places)

    def close(self) -> None:
        """Let the file go."""
        self._file.close()


class _Cases:
    """The rows of an earlier version's shard, each a block of one case, see ``Source``."""

    def __init__(self, file: _File, selected: str) -> None:
        self.path, self._file, self._selected = file.path, file, selected
        self._known: tuple[int, Record] | None = None

    def _record(self, row: int) -> Record:
        if self._known is None or self._known[0] != row:
            query = f"SELECT {self._selected} FROM cases WHERE rowid = ?"
            identity, toml, status, error, seconds, imbalance, *rest = self._file.ask(query, row)
            layout, data, version, flags = rest
            record = Record(
                identity, toml, status, error, seconds,
                math.nan if imbalance is None else imbalance,
                _unpacked(layout, data), version, split_flags(flags),
            )  # fmt: skip
            self._known = row, record
        return self._known[1]

    def read(self, block: int, name: str) -> Piece | None:
        """Return a variable of a case; None where it is not stored."""
        return piece_of(self._record(block), name)

    def texts(self, block: int, places: Sequence[int]) -> list[str]:
        """Return the text of a case."""
        return [self._record(block).toml] * len(places)

    def close(self) -> None:
        """Let the file go."""
        self._file.close()


def piece_of(record: Record, name: str) -> Piece | None:
    """Return a variable of a case; None where it is not stored."""
    values = record.arrays.get(name)
    if values is None:
        return None
    if name in LINE or (name in PROFILES and values.ndim == 1):
        return Piece(values[None])
    return Piece(values, np.array([0, len(values)]))


def index_record(record: Record, source: Source, block: int) -> Index:
    """Return the index of a case by itself."""
    return index_of(
        source, block, np.array([record.id.encode()]), np.array([STATUS.index(record.status)]),
        np.array([record.rows]), np.array([len(record.arrays.get("r", ()))]),
        np.array([record.seconds]), np.array([record.imbalance]),
        [Kind(record.version, record.flags, record.fields, record.deep)],
        errors={0: record.error} if record.error else {}, longest=len(record.toml.encode()),
    )  # fmt: skip


def read_index(path: Path) -> tuple[Index, int] | None:
    """Return the cases of a shard, and how many rows are damaged. Not collective.

    None if it is damaged as a whole. A file without contents, or without a table, holds nothing:
    its sweep was killed before its first case.

    Raises
    ------
    ComputationError : it is in use, or cannot be read.
    """
    tail = Path(f"{path}-wal")
    if not path.stat().st_size and tail.exists() and tail.stat().st_size:
        return None  # SQLite would take it for new
    try:
        with closing(_connect(path)) as connection:
            if connection.execute("PRAGMA quick_check").fetchone()[0] != "ok":
                return None
            parts, bad = [], 0
            file = _File(path)
            for read in (_read_cases, _read_blocks):  # the newer ones are the later
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
    """Drop rows that ``read_index`` counts as damaged. Not collective."""
    with closing(_connect(path)) as connection:
        for table, read in (("cases", _read_cases), ("blocks", _read_blocks)):
            found = read(_File(path), connection)
            for row in found[1] if found is not None else ():
                if table == "blocks":
                    connection.execute("DELETE FROM arrays WHERE block = ?", (row,))
                connection.execute(f"DELETE FROM {table} WHERE rowid = ?", (row,))


def _read_blocks(
    file: _File, connection: sqlite3.Connection
) -> tuple[list[Index], list[int]] | None:
    """Return the indices of the blocks of a shard, and which are damaged; None if all of it is."""
    there = _columns_there(connection, "blocks")
    if not there:
        return [], []
    if _BLOCKS.keys() - there or _ARRAYS.keys() - _columns_there(connection, "arrays"):
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
    if _checksum(row) != crc:
        raise ValueError("checksum")
    ids, _, text, status, *numbers = row
    rows = np.frombuffer(numbers[0], dtype=np.int64)
    seconds, imbalance = (np.frombuffer(data) for data in numbers[1:])
    about = json.loads(text)
    elements, layout = about["elements"], about["layout"]
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
        wide = elements if name in PROFILES or name in LINE else 1
        if sizes[name] != 8 * wide * count[how]:
            raise ValueError(name)
    flags = {int(i): tuple(own) for i, own in about["flags"].items()}
    fields = tuple(name for name in PROFILES if name in layout)
    deep = any(layout[name] == _ROWS for name in fields)
    plain = Kind(version, (), fields, deep)
    kinds = [plain] if not flags else [
        plain._replace(flags=flags.get(i, ())) for i in range(len(names))
    ]  # fmt: skip
    source.layouts[number] = elements, layout
    source.offsets[number] = np.concatenate([[0], np.cumsum(rows)])
    return index_of(
        source, number, names, states, rows, np.where(rows > 0, elements, 0), seconds, imbalance,
        kinds, errors={int(i): error for i, error in about["errors"].items()},
        longest=longest,
    )  # fmt: skip


# -- rows of earlier versions ----------------------------------------------------------------------


@lru_cache(maxsize=256)
def _layout(text: str) -> dict[str, tuple[int, ...]]:
    """Return the shapes of arrays by name.

    Raises
    ------
    ValueError : they are none, or not those of a history.
    """
    try:
        shapes = {name: tuple(shape) for name, shape in json.loads(text).items()}
        steps, elements = (shapes.get(name, (0,)) for name in ("time", "r"))
        flat = len(steps) == len(elements) == 1
        allowed = {
            **dict.fromkeys(("step", *HISTORIES), (steps,)),
            **dict.fromkeys(LINE, (elements,)),
            **dict.fromkeys(PROFILES, (elements, steps + elements)),
        }
        fit = flat and all(shape in allowed[name] for name, shape in shapes.items())
        whole = all(isinstance(n, int) and n >= 0 for shape in shapes.values() for n in shape)
    except (AttributeError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(str(error)) from error
    if not fit or not whole:
        raise ValueError(text)
    return shapes


def _unpacked(layout: str, data: bytes) -> dict[str, FloatArray]:
    values, arrays, start = np.frombuffer(data), {}, 0
    for name, shape in _layout(layout).items():
        size = math.prod(shape)
        arrays[name] = values[start : start + size].reshape(shape)
        start += size
    return arrays


def _read_cases(
    file: _File, connection: sqlite3.Connection
) -> tuple[list[Index], list[int]] | None:
    """Return the indices of rows, and which are damaged; None if the table is."""
    there = _columns_there(connection, "cases")
    if not there:
        return [], []
    if set(_CASES) - _DEFAULTS.keys() - there:
        return None
    names = {name: name if name in there else f"'{_DEFAULTS[name]}'" for name in _CASES}
    source = _Cases(file, ", ".join(names.values()))
    asked = ", ".join(names[name] for name in _CASES if name not in ("toml", "data"))
    rows = connection.execute(
        f"SELECT rowid, {asked}, typeof(toml), typeof(error), typeof(seconds), typeof(imbalance), "
        "CASE typeof(data) WHEN 'blob' THEN length(data) END, length(CAST(toml AS BLOB)) FROM cases"
    )
    parts, bad = [], []
    for row, identity, status, error, seconds, imbalance, layout, version, flags, *rest in rows:
        *types, size, longest = rest
        try:
            texts = all(isinstance(text, str) for text in (identity, layout, version, flags))
            fit = types in (["text", "text", "real", kind] for kind in ("real", "null"))  # NaN
            if not texts or not fit or status not in ("done", "failed"):
                raise ValueError(identity)
            shapes = _layout(layout)
            if size != 8 * sum(map(math.prod, shapes.values())):
                raise ValueError(identity)
        except ValueError:
            bad.append(row)
            continue
        fields = tuple(name for name in PROFILES if name in shapes)
        deep = any(len(shapes[name]) == 2 for name in fields)
        steps, elements = (shapes.get(name, (0,))[0] for name in ("time", "r"))
        parts.append(
            index_of(
                source,
                row,
                np.array([identity.encode()]),
                np.array([STATUS.index(status)]),
                np.array([steps]),
                np.array([elements]),
                np.array([seconds]),
                np.array([math.nan if imbalance is None else imbalance]),
                [Kind(version, split_flags(flags), fields, deep)],
                errors={0: error} if error else {},
                longest=longest,
            )
        )  # fmt: skip
    return parts, bad


@contextmanager
def locked(folder: Path, part: str) -> Iterator[None]:
    """Hold a sweep's folder, or one slice of it, for this process. Call on one rank.

    Parameters
    ----------
    folder : of the sweep.
    part : name of the slice, "" for the whole, which excludes every slice.

    Raises
    ------
    InputError : another sweep is at work there.
    """
    with ExitStack() as held:
        whole = held.enter_context((folder / "lock").open("a"))
        _lock(whole, fcntl.LOCK_SH if part else fcntl.LOCK_EX, folder)
        if part:  # only now: who has the whole may remove it
            own = held.enter_context((folder / f"lock{part}").open("a"))
            _lock(own, fcntl.LOCK_EX, folder)
        yield


def forget_slices(folder: Path) -> None:
    """Remove the locks of slices. Needs the lock of the whole folder."""
    for path in folder.glob("lock[0-9]*-[0-9]*"):
        path.unlink(missing_ok=True)


def _lock(file: object, kind: int, folder: Path) -> None:
    try:
        fcntl.flock(file.fileno(), kind | fcntl.LOCK_NB)  # type: ignore[attr-defined]
    except BlockingIOError:
        raise InputError(
            f"{folder}: another sweep is at work in this folder; wait for its end, or use another"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: its disk cannot lock files: {error.strerror}") from error
