"""What is stored of a sweep's cases, by column, and where; how histories come into tables."""

import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.results.reading import UnreadableError

#: a case's status is a place in this
STATUS = ("incomplete", "failed", "done")
INCOMPLETE, FAILED, DONE = range(3)
#: numbers of blocks are smaller
MOST_BLOCKS = 2**31
#: between the flags of a case
_SEPARATOR = ", "


def join_flags(flags: Sequence[str]) -> str:
    """Return the flags of a case as files store them."""
    return _SEPARATOR.join(flags)


def split_flags(text: str) -> tuple[str, ...]:
    """Return the flags that a file stores of a case."""
    return tuple(text.split(_SEPARATOR)) if text else ()


class Piece(NamedTuple):
    """What is stored of a variable of some cases.

    Parameters
    ----------
    values : (rows, ...), those of case i from ``offsets[i]`` to ``offsets[i + 1]``; without
        offsets (cases, ...), or (1, ...) for all of them.
    offsets : (cases + 1,) int, or None.
    """

    values: Any
    offsets: IntArray | None = None


class Source(Protocol):
    """A file that holds cases, in blocks of them."""

    path: Path

    def read(self, block: int, name: str) -> Piece | None:
        """Return a variable of the cases of a block; None where it is not stored."""
        ...

    def texts(self, block: int, places: Sequence[int]) -> list[str]:
        """Return the texts of some cases of a block."""
        ...

    def close(self) -> None:
        """Let the file go."""
        ...


class DamagedError(ComputationError):
    """A file whose contents cannot be read.

    Parameters
    ----------
    path : of the file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is damaged")
        self.path = path


#: what reading a damaged file ends in
DAMAGE = (
    sqlite3.DatabaseError, RuntimeError, KeyError, IndexError, TypeError, ValueError, InputError,
)  # fmt: skip
#: what SQLite says of a disk, or of another process
_UNREADABLE = (
    sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_FULL, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_NOMEM,
)  # fmt: skip


def is_damage(error: sqlite3.DatabaseError) -> bool:
    """Tell whether a file is damaged, or cannot be read now and may be whole."""
    return error.sqlite_errorcode & 0xFF not in _UNREADABLE


@contextmanager
def telling_damage(path: Path) -> Iterator[None]:
    """Tell what goes wrong in reading a file that was taken for whole.

    Raises
    ------
    DamagedError : it is not.
    ComputationError, UnreadableError : it cannot be read now.
    """
    try:
        yield
    except UnreadableError:
        raise
    except DAMAGE as error:
        if isinstance(error, sqlite3.DatabaseError) and not is_damage(error):
            raise ComputationError(f"{path}: cannot be read: {error}") from error
        raise DamagedError(path) from error


def read_stored(source: Source, block: int, name: str) -> Piece | None:
    """Return a variable of the cases of a block, see ``telling_damage``."""
    with telling_damage(source.path):
        return source.read(block, name)


class Kind(NamedTuple):
    """What many cases have in common.

    Parameters
    ----------
    version : of ringwear-par that computed them.
    flags : short names of what makes their answers doubtful.
    fields : what is stored of what not all cases have.
    deep : whether they are stored at every stored step.
    sizes : of the axes beside steps and elements that what is stored has.
    """

    version: str
    flags: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    deep: bool = False
    sizes: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, eq=False)
class Index:
    """Stored cases, in arrays (cases,).

    Parameters
    ----------
    ids : bytes.
    status : places in STATUS.
    rows, elements : stored steps and contact elements.
    seconds, imbalance : wall time, and worst balance or KKT residual of the steps.
    kind, kinds : what each has in common with others: a place in ``kinds``.
    source, sources, block, place : where each is stored: a place in ``sources``, a block of it, and
        the place there.
    errors : reasons of failures by place in the index.
    longest : bytes of the longest text.
    """

    ids: Any
    status: IntArray
    rows: IntArray
    elements: IntArray
    seconds: FloatArray
    imbalance: FloatArray
    kind: IntArray
    source: IntArray
    block: IntArray
    place: IntArray
    kinds: tuple[Kind, ...] = ()
    sources: tuple[Source, ...] = ()
    errors: Mapping[int, str] = field(default_factory=dict)
    longest: int = 1

    def __len__(self) -> int:
        return len(self.ids)

    def only(self, entries: IntArray) -> "Index":
        """Return some of the cases."""
        arrays = {name: getattr(self, name)[entries] for name in _ARRAYS}
        errors = {}
        if self.errors:
            errors = {i: self.errors[e] for i, e in enumerate(entries.tolist()) if e in self.errors}
        return Index(**arrays, kinds=self.kinds, sources=self.sources, errors=errors,
                     longest=self.longest)  # fmt: skip

    def find(self, ids: Any) -> IntArray:
        """Return where each of some ids is in the index, -1 where it is not."""
        if not len(self) or not len(ids):
            return np.full(len(ids), -1)
        order = np.argsort(self.ids, kind="stable")
        there = self.ids[order]
        at = np.minimum(np.searchsorted(there, ids), len(there) - 1)
        return np.where(there[at] == ids, order[at], -1)

    def paths(self, entries: IntArray) -> Iterator[Path]:
        """Yield the files of some of the cases."""
        return (self.sources[source].path for source in self.source[entries].tolist())


_ARRAYS = (
    "ids", "status", "rows", "elements", "seconds", "imbalance", "kind", "source", "block", "place",
)  # fmt: skip


def index_of(
    source: Source,
    block: int,
    ids: Any,
    status: IntArray,
    rows: IntArray,
    elements: IntArray,
    seconds: FloatArray,
    imbalance: FloatArray,
    kinds: Sequence[Kind],
    *,
    errors: Mapping[int, str] | None = None,
    longest: int = 1,
) -> Index:
    """Return the index of a block of cases.

    Parameters
    ----------
    kinds : of each, or one for all; the others are as in Index.
    """
    there = {kind: n for n, kind in enumerate(dict.fromkeys(kinds))}
    code = np.array([there[kind] for kind in kinds], dtype=np.int32)
    count = len(ids)
    return Index(
        ids, status.astype(np.int8), rows, elements, seconds, imbalance,
        np.broadcast_to(code, count), np.zeros(count, dtype=np.int32),
        np.full(count, block, dtype=np.int32), np.arange(count, dtype=np.int32), tuple(there),
        (source,),
        errors or {}, longest,
    )  # fmt: skip


def join(parts: Iterable[Index]) -> Index:
    """Return all cases of several indices, one after another."""
    parts = [part for part in parts if len(part)]
    if len(parts) < 2:
        return parts[0] if parts else NOTHING
    kinds: dict[Kind, int] = {}
    sources: dict[int, int] = {}
    found: list[Source] = []
    errors: dict[int, str] = {}
    start = 0
    columns: dict[str, list[Any]] = {name: [] for name in _ARRAYS}
    for part in parts:
        for name in _ARRAYS:
            columns[name].append(getattr(part, name))
        own = np.array([kinds.setdefault(kind, len(kinds)) for kind in part.kinds], dtype=np.int32)
        columns["kind"][-1] = own[part.kind]
        for source in part.sources:
            if id(source) not in sources:
                sources[id(source)] = len(found)
                found.append(source)
        places = np.array([sources[id(source)] for source in part.sources], dtype=np.int32)
        columns["source"][-1] = places[part.source]
        errors.update({start + i: error for i, error in part.errors.items()})
        start += len(part)
    arrays = {name: np.concatenate(own) for name, own in columns.items()}
    longest = max(part.longest for part in parts)
    return Index(**arrays, kinds=tuple(kinds), sources=tuple(found), errors=errors,
                 longest=longest)  # fmt: skip


def latest(index: Index) -> Index:
    """Return each case once: as it was done first, else as it was stored last."""
    n = np.arange(len(index))
    rank = np.where(index.status == DONE, 2 * len(index) - n, n)
    order = np.lexsort((rank, index.ids))
    ids = index.ids[order]
    last = np.ones(len(ids), dtype=bool)
    last[:-1] = ids[:-1] != ids[1:]
    return index if last.all() else index.only(np.sort(order[last]))


def _nothing() -> Index:
    none = np.zeros(0, dtype=np.int64)
    number = np.zeros(0)
    return Index(np.zeros(0, dtype="S1"), none, none, none, number, number, *(none,) * 4)


#: no case
NOTHING = _nothing()


def put(table: Any, at: IntArray, piece: Piece, places: IntArray, rows: IntArray) -> None:
    """Put what is stored of some cases into a table that is padded with NaN.

    Parameters
    ----------
    table : (cases, ...), changed.
    at : which rows of the table.
    piece : of a block.
    places : of the cases in the block.
    rows : number of the stored steps of each of them.
    """
    values = piece.values
    if piece.offsets is None:
        values = values if len(values) == 1 else values[places]
        if table.ndim > values.ndim:  # the last of what the table has at all steps
            some = np.flatnonzero(rows)
            cut = values if len(values) == 1 else values[some]
            table[at[some], rows[some] - 1, : values.shape[1]] = cut
            return
        sizes = [min(a, b) for a, b in zip(table.shape[1:], values.shape[1:], strict=True)]
        cells = tuple(slice(size) for size in sizes)
        table[(_run(at), *cells)] = values[(slice(None), *cells)]
        return
    starts = piece.offsets[places]
    lengths = piece.offsets[places + 1] - starts
    if not lengths.sum():
        return
    columns = (slice(values.shape[1]),) if values.ndim > 1 else ()
    there, taken = _run(at), _run(places)
    if isinstance(there, slice) and isinstance(taken, slice):
        part = values[starts[0] : starts[0] + lengths.sum()]
        longest = int(lengths.max())
        inside = table[(there, slice(longest), *columns)]
        if (lengths == longest).all():
            inside[...] = part.reshape(inside.shape)
        else:
            inside[np.arange(longest) < lengths[:, None]] = part
        return
    step = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    table[(np.repeat(at, lengths), step, *columns)] = values[step + np.repeat(starts, lengths)]


def with_body_last(piece: Piece, width: int) -> Piece:
    """Return what is stored by layer with so many columns, the body itself in the last of them.

    Cases may have fewer layers than others of their sweep: these have NaN before the body.
    """
    layers = piece.values.shape[-1] - 1
    if layers + 1 == width:
        return piece
    values = np.full((*piece.values.shape[:-1], width), np.nan)
    values[..., :layers], values[..., -1] = piece.values[..., :-1], piece.values[..., -1]
    return piece._replace(values=values)


def _run(numbers: IntArray) -> slice | IntArray:
    """Return increasing numbers without gaps as a slice, others as they are."""
    first, last = int(numbers[0]), int(numbers[-1])
    if last - first + 1 == len(numbers) and (np.diff(numbers) == 1).all():
        return slice(first, last + 1)
    return numbers
