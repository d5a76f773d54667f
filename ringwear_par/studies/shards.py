"""What a sweep has computed, case by case, while it is at work: one SQLite file a team.

A case is done once its row is committed. A process that is killed leaves a file that SQLite mends
by itself; what a power failure can take is what was committed in the last second.
"""

import fcntl
import json
import math
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.results.variables import HISTORIES, LINE, PROFILES

FOLDER = "shards"
#: what SQLite says of a disk, or of another process
_UNREADABLE = (
    sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_FULL, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_NOMEM,
)  # fmt: skip
_SYNC_SECONDS = 1.0
#: how long to wait for processes of a killed sweep to end
_BUSY_SECONDS = 5.0
_COLUMNS = {
    "id": "TEXT PRIMARY KEY", "toml": "TEXT", "status": "TEXT", "error": "TEXT", "seconds": "REAL",
    "imbalance": "REAL", "layout": "TEXT", "data": "BLOB", "version": "TEXT", "flags": "TEXT",
}  # fmt: skip
#: what cases have that were stored before these columns were
_DEFAULTS = {"version": "unknown", "flags": ""}
#: version of such cases
UNKNOWN_VERSION = _DEFAULTS["version"]
#: between the flags of a case
_SEPARATOR = ", "


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
    arrays : variables by name: histories (steps,), fields (steps, elements) or (elements,), ``r``
        and ``width`` (elements,), ``step`` (steps,).
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


def join_flags(flags: Sequence[str]) -> str:
    """Return the flags of a case as files store them."""
    return _SEPARATOR.join(flags)


def split_flags(text: str) -> tuple[str, ...]:
    """Return the flags that a file stores of a case."""
    return tuple(text.split(_SEPARATOR)) if text else ()


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


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, timeout=_BUSY_SECONDS, isolation_level=None)
    connection.text_factory = partial(str, encoding="utf-8", errors="replace")
    # one process a file: its index needs no memory shared with others, which not all disks offer
    connection.execute("PRAGMA locking_mode=EXCLUSIVE")
    return connection


def _columns_there(connection: sqlite3.Connection) -> set[str]:
    return {row[1] for row in connection.execute("PRAGMA table_info(cases)")}


def _selected(connection: sqlite3.Connection, names: Sequence[str]) -> str:
    """Return the columns of a query, with defaults where an older file has none."""
    there = _columns_there(connection)
    return ", ".join(name if name in there else f"'{_DEFAULTS[name]}'" for name in names)


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
            table = ", ".join(f"{name} {kind}" for name, kind in _COLUMNS.items())
            self._connection.execute(f"CREATE TABLE IF NOT EXISTS cases ({table})")
            for name in _DEFAULTS.keys() - _columns_there(self._connection):
                default = f"{_COLUMNS[name]} DEFAULT '{_DEFAULTS[name]}'"
                self._connection.execute(f"ALTER TABLE cases ADD COLUMN {name} {default}")
            at_failure.pop_all()
        self._synced = time.monotonic()

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise ComputationError(f"{self.path}: cannot be written: {error}") from error

    def add(self, record: Record) -> None:
        """Store a case for good.

        Raises
        ------
        ComputationError : the disk, or somebody has removed the file.
        """
        layout = json.dumps({name: array.shape for name, array in record.arrays.items()})
        data = b"".join(
            np.asarray(array, dtype=float).tobytes() for array in record.arrays.values()
        )
        with self._told():
            self._connection.execute(
                f"INSERT OR REPLACE INTO cases ({', '.join(_COLUMNS)}) "
                f"VALUES ({', '.join('?' for _ in _COLUMNS)})",
                (
                    record.id, record.toml, record.status, record.error, record.seconds,
                    record.imbalance, layout, data, record.version, join_flags(record.flags),
                ),
            )  # fmt: skip
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


@dataclass(frozen=True)
class Entry:
    """What is known of a stored case without reading its history.

    Parameters
    ----------
    status : "done", "failed" or "incomplete".
    rows, elements : stored steps and contact elements.
    fields : the fields along the contact line that are stored.
    deep : whether they are stored at every stored step.
    path : the file that holds it.
    version, flags : as in Record.
    """

    status: str
    rows: int
    elements: int
    fields: tuple[str, ...]
    deep: bool
    path: Path
    version: str
    flags: tuple[str, ...] = ()


def read_index(path: Path) -> tuple[dict[str, Entry], int] | None:
    """Return the cases of a shard by id, and how many rows are damaged. Not collective.

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
            there = _columns_there(connection)
            if not there:
                return {}, 0
            if _COLUMNS.keys() - _DEFAULTS.keys() - there:
                return None
            entries, bad = _read_rows(path, connection)
            return entries, len(bad)
    except sqlite3.DatabaseError as error:
        if not is_damage(error):
            raise ComputationError(f"{path}: cannot be read: {error}") from error
        return None


def is_damage(error: sqlite3.DatabaseError) -> bool:
    """Tell whether a file is damaged, or cannot be read now and may be whole."""
    return error.sqlite_errorcode & 0xFF not in _UNREADABLE


def drop_damaged_rows(path: Path) -> None:
    """Drop rows that ``read_index`` counts as damaged. Not collective."""
    with closing(_connect(path)) as connection:
        _, bad = _read_rows(path, connection)
        connection.executemany("DELETE FROM cases WHERE rowid = ?", bad)


def _read_rows(
    path: Path, connection: sqlite3.Connection
) -> tuple[dict[str, Entry], list[tuple[int]]]:
    names = _selected(connection, ("id", "status", "layout", "version", "flags"))
    rows = connection.execute(
        f"SELECT rowid, {names}, typeof(toml), typeof(error), typeof(seconds), typeof(imbalance), "
        "CASE typeof(data) WHEN 'blob' THEN length(data) END FROM cases"
    )
    entries: dict[str, Entry] = {}
    bad: list[tuple[int]] = []
    for row, identity, status, layout, version, flags, *types, size in rows:
        try:
            texts = all(isinstance(text, str) for text in (identity, layout, version, flags))
            fit = types in (["text", "text", "real", kind] for kind in ("real", "null"))  # NaN
            if not texts or not fit or status not in ("done", "failed"):
                raise ValueError(identity)
            if size != 8 * sum(map(math.prod, _layout(layout).values())):
                raise ValueError(identity)
            entries[identity] = _entry(path, status, layout, version, flags)
        except ValueError:
            bad.append((row,))
    return entries, bad


def _entry(path: Path, status: str, layout: str, version: str, flags: str) -> Entry:
    shapes = _layout(layout)
    fields = tuple(name for name in PROFILES if name in shapes)
    deep = any(len(shapes[name]) == 2 for name in fields)
    stored, elements = (shapes.get(name, (0,))[0] for name in ("time", "r"))
    return Entry(status, stored, elements, fields, deep, path, version, split_flags(flags))


def read_records(path: Path, ids: Sequence[str]) -> Iterator[Record]:
    """Yield some cases of a shard, of those that its index has. Not collective."""
    with closing(_connect(path)) as connection:
        query = f"SELECT {_selected(connection, tuple(_COLUMNS))} FROM cases WHERE id = ?"
        for identity in ids:
            row = connection.execute(query, (identity,)).fetchone()
            _, toml, status, error, seconds, imbalance, layout, data, version, flags = row
            yield Record(
                identity, toml, status, error, seconds,
                math.nan if imbalance is None else imbalance,
                _unpacked(layout, data), version, split_flags(flags),
            )  # fmt: skip


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
