"""Cases that are stored together, and a case by itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.results.columns import HistoryColumns
from ringwear_par.results.variables import LAYER_PROFILES, LINE
from ringwear_par.studies.index import STATUS, Index, Kind, Piece, Source, index_of
from ringwear_par.studies.swept import EACH, FIELDS, OPTIONAL, ROWS, sizes_of
from ringwear_par.studies.texts import Texts


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

    @property
    def fields(self) -> tuple[str, ...]:
        """What is stored of what not all cases have."""
        return tuple(name for name in OPTIONAL if name in self.arrays)

    @property
    def deep(self) -> bool:
        """Whether they are stored at every stored step."""
        return any(self.arrays[name].ndim == 2 for name in self.fields if name in FIELDS)


def piece_of(record: Record, name: str) -> Piece | None:
    """Return a variable of a case; None where it is not stored."""
    values = record.arrays.get(name)
    if values is None:
        return None
    if name in LINE or name in EACH or (name in FIELDS and values.ndim == 1):
        return Piece(values[None])
    return Piece(values, np.array([0, len(values)]))


def index_record(record: Record, source: Source, block: int) -> Index:
    """Return the index of a case by itself."""
    return index_of(
        source, block, np.array([record.id.encode()]), np.array([STATUS.index(record.status)]),
        np.array([record.rows]), np.array([len(record.arrays.get("r", ()))]),
        np.array([record.seconds]), np.array([record.imbalance]),
        [
            Kind(record.version, record.flags, record.fields, record.deep,
                 tuple(sizes_of(record.arrays).items()))
        ],
        errors={0: record.error} if record.error else {}, longest=len(record.toml.encode()),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Block:
    """Cases of one contact pair that have ended, with the same fields stored as often.

    Parameters
    ----------
    ids, texts : of the cases.
    version : of ringwear-par that computed them.
    line : ``r`` and ``width`` of the contact elements, (n,) each.
    deep : whether fields are stored at every stored step, or at the last one only.
    step : (rows,) int, what stored steps are called.
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
        deep = any(record.deep for record in full)
        first: dict[str, Any] = full[0].arrays if full else {}

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
            each={name: last(name) for name in EACH if name in first},
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
            there = columns.layers.items()
            left = {name: values for name, values in there if name in LAYER_PROFILES}
            rest = {name: values for name, values in there if name not in left}
            columns = replace(
                columns,
                histories={**columns.histories, **rest, **columns.stress},
                profiles={**columns.profiles, **left},
            )
        line = {"r": case.line.r, "width": case.line.width}
        deep = case.output.profiles == "all"
        return cls(tuple(ids), texts, version, line, deep, step, columns)
