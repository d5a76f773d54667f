"""Shards of earlier versions: a row a case, in a table of its own. They are read only."""

import json
import math
import sqlite3
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.results.variables import HISTORIES, LAYER_HISTORIES, LINE
from ringwear_par.studies.blocks import Record, piece_of
from ringwear_par.studies.connections import ReadFile, columns_there
from ringwear_par.studies.index import (
    MOST_BLOCKS,
    STATUS,
    Index,
    Kind,
    Piece,
    index_of,
    split_flags,
)
from ringwear_par.studies.swept import FIELDS, OPTIONAL

COLUMNS = (
    "id", "toml", "status", "error", "seconds", "imbalance", "layout", "data", "version", "flags",
)  # fmt: skip
#: what cases have that were stored before these columns were
_DEFAULTS = {"version": "unknown", "flags": ""}
#: version of such cases
UNKNOWN_VERSION = _DEFAULTS["version"]


class _Cases:
    """The rows of an earlier version's shard, each a block of one case, see ``Source``."""

    def __init__(self, file: ReadFile, selected: str) -> None:
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
            **dict.fromkeys(("step", *HISTORIES, *LAYER_HISTORIES), (steps,)),
            **dict.fromkeys(LINE, (elements,)),
            **dict.fromkeys(FIELDS, (elements, steps + elements)),
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


def read_cases(
    file: ReadFile, connection: sqlite3.Connection
) -> tuple[list[Index], list[int]] | None:
    """Return the indices of rows, and which are damaged; None if the table is."""
    there = columns_there(connection, "cases")
    if not there:
        return [], []
    if set(COLUMNS) - _DEFAULTS.keys() - there:
        return None
    names = {name: name if name in there else f"'{_DEFAULTS[name]}'" for name in COLUMNS}
    source = _Cases(file, ", ".join(names.values()))
    asked = ", ".join(names[name] for name in COLUMNS if name not in ("toml", "data"))
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
            sound = status in ("done", "failed") and 0 < row < MOST_BLOCKS
            if not (texts and fit and sound):
                raise ValueError(identity)
            shapes = _layout(layout)
            if size != 8 * sum(map(math.prod, shapes.values())):
                raise ValueError(identity)
        except ValueError:
            bad.append(row)
            continue
        fields = tuple(name for name in OPTIONAL if name in shapes)
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
