"""Which cases a sweep has stored, and where; how their histories come into tables."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.results.storage.hdf5 import UnreadableError

#: a case's status is a place in this
STATUS = ("incomplete", "failed", "done")
INCOMPLETE, FAILED, DONE = range(3)
#: what an index has of each case: ``rows`` stored steps of so many contact ``elements``; wall time;
#: worst balance or KKT residual of the steps; places in ``Index.kinds`` and ``Index.blocks``, and
#: in the block
ENTRY = np.dtype([
    ("id", "S16"), ("status", "i1"), ("rows", "i8"), ("elements", "i8"), ("seconds", "f8"),
    ("imbalance", "f8"), ("kind", "i4"), ("block", "i4"), ("place", "i4"),
])  # fmt: skip
#: between the flags of a case
_SEPARATOR = ", "
#: what reading a damaged file ends in
DAMAGE = (
    RuntimeError, LookupError, AttributeError, TypeError, ValueError, OverflowError, InputError,
)  # fmt: skip


def join_flags(flags: Sequence[str]) -> str:
    """Return the flags of a case as files store them."""
    return _SEPARATOR.join(flags)


def split_flags(text: str) -> tuple[str, ...]:
    """Return the flags that a file stores of a case."""
    return tuple(text.split(_SEPARATOR)) if text else ()


class DamagedError(ComputationError):
    """A file whose contents cannot be read.

    Parameters
    ----------
    path : of the file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is damaged")
        self.path = path


@contextmanager
def reporting_damage(path: Path) -> Iterator[None]:
    """Name the file that turns out to be damaged while it is read.

    Raises
    ------
    DamagedError : it is.
    ComputationError, UnreadableError : it cannot be read now.
    """
    try:
        yield
    except UnreadableError:
        raise
    except DAMAGE as error:
        raise DamagedError(path) from error
    except OSError as error:
        raise ComputationError(f"{path}: cannot be read: {error.strerror or error}") from error


class Piece(NamedTuple):
    """A stored variable of some cases.

    Parameters
    ----------
    values : (rows, ...), those of case i from ``offsets[i]`` to ``offsets[i + 1]``; without
        offsets (cases, ...), or (1, ...) for all of them.
    offsets : (cases + 1,) int, or None.
    """

    values: Any
    offsets: IntArray | None = None


class Kind(NamedTuple):
    """Words that many cases have in common.

    Parameters
    ----------
    version : of ringwear-par that computed them.
    flags : short names of what makes their answers doubtful.
    error : why they failed, "" where they have not.
    """

    version: str
    flags: tuple[str, ...] = ()
    error: str = ""


@dataclass(frozen=True, eq=False)
class StoredBlock(ABC):
    """Cases that are stored together, and are read together.

    Parameters
    ----------
    path : of their file.
    fields : stored variables that not all cases have.
    deep : whether profiles are stored at every stored step.
    sizes : of the axes beside steps and elements.
    longest : bytes of the longest text.
    """

    path: Path
    fields: tuple[str, ...]
    deep: bool
    sizes: Mapping[str, int]
    longest: int

    @abstractmethod
    def read(self, names: Iterable[str]) -> dict[str, Piece]:
        """Return those of some variables that are stored.

        Raises
        ------
        DamagedError : the file is damaged.
        ComputationError : it cannot be read now.
        """

    @abstractmethod
    def texts(self, places: Sequence[int]) -> list[str]:
        """Return the TOML texts of some of the cases; raises as ``read``."""


@dataclass(frozen=True, eq=False)
class Index:
    """Stored cases.

    Parameters
    ----------
    entries : (cases,) of ``ENTRY``.
    kinds, blocks : that the entries name by their places.
    """

    entries: Any
    kinds: tuple[Kind, ...] = ()
    blocks: tuple[StoredBlock, ...] = ()

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, name: str) -> Any:
        return self.entries[name]

    def only(self, entries: IntArray) -> "Index":
        """Return the index of some of the cases."""
        return Index(self.entries[entries], self.kinds, self.blocks)

    def find(self, ids: Any) -> IntArray:
        """Return where each of some ids is in the index, -1 where it is not."""
        if not len(self) or not len(ids):
            return np.full(len(ids), -1)
        order = np.argsort(self["id"], kind="stable")
        stored = self["id"][order]
        at = np.minimum(np.searchsorted(stored, ids), len(stored) - 1)
        return np.where(stored[at] == ids, order[at], -1)


#: no case
NOTHING = Index(np.zeros(0, dtype=ENTRY))


def join(parts: Iterable[Index]) -> Index:
    """Return all cases of several indices, one after another."""
    parts = [part for part in parts if len(part)]
    if len(parts) < 2:
        return parts[0] if parts else NOTHING
    kinds: dict[Kind, int] = {}
    blocks: list[StoredBlock] = []
    joined = np.concatenate([part.entries for part in parts])
    start = 0
    for part in parts:
        entries = joined[start : start + len(part)]
        codes = [kinds.setdefault(kind, len(kinds)) for kind in part.kinds]
        entries["kind"] = np.array(codes, dtype=np.int32)[entries["kind"]]
        entries["block"] += len(blocks)
        blocks += part.blocks
        start += len(part)
    return Index(joined, tuple(kinds), tuple(blocks))


def latest(index: Index) -> Index:
    """Return each case once: as it was done first, else as it was stored last."""
    n = np.arange(len(index))
    rank = np.where(index["status"] == DONE, 2 * len(index) - n, n)
    order = np.lexsort((rank, index["id"]))
    ids = index["id"][order]
    last = np.ones(len(ids), dtype=bool)
    last[:-1] = ids[:-1] != ids[1:]
    return index if last.all() else index.only(np.sort(order[last]))


def put(table: Any, at: IntArray, piece: Piece, places: IntArray, rows: IntArray) -> None:
    """Put a stored variable of some cases into a table that is padded with NaN.

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
    to, taken = _run(at), _run(places)
    if isinstance(to, slice) and isinstance(taken, slice):
        part = values[starts[0] : starts[0] + lengths.sum()]
        longest = int(lengths.max())
        inside = table[(to, slice(longest), *columns)]
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
