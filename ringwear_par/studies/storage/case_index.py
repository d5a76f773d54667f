"""Which cases a sweep has stored, and where."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.studies.storage.blocks import CASE, DONE, FAILED, CaseBlock, Kind

#: of each case the columns of its block, where ``kind`` is a place in ``CaseIndex.kinds``; the
#: block, a place in ``CaseIndex.blocks``, and the place in it
ENTRY = np.dtype([*CASE.descr, ("block", "<i4"), ("place", "<i4")])


@dataclass(frozen=True, eq=False)
class CaseIndex:
    """The stored cases; ``index["status"]`` is a column of its entries."""

    #: (cases,) of ``ENTRY``
    entries: Any
    #: versions, flags and errors that cases have in common
    kinds: tuple[Kind, ...] = ()
    #: where the cases are
    blocks: tuple[CaseBlock, ...] = ()

    @classmethod
    def of(cls, blocks: Sequence[CaseBlock]) -> "CaseIndex":
        """Return each case of some blocks once.

        As it was done first, else as it failed last, else as it was interrupted last.
        """
        kinds: dict[Kind, int] = {}
        entries = np.zeros(sum(len(block.cases) for block in blocks), dtype=ENTRY)
        start = 0
        for number, block in enumerate(blocks):
            part = entries[start : start + len(block.cases)]
            for name in CASE.names or ():
                part[name] = block.cases[name]
            codes = [kinds.setdefault(kind, len(kinds)) for kind in block.kinds]
            part["kind"] = np.array(codes, dtype=np.int32)[block.cases["kind"]]
            part["block"], part["place"] = number, np.arange(len(part))
            start += len(part)
        begun = entries[~np.isnan(entries["seconds"])]
        return cls(begun[_latest(begun)], tuple(kinds), tuple(blocks))

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, name: str) -> Any:
        return self.entries[name]

    def find(self, ids: Any) -> IntArray:
        """Return where each of some ids is in the index, -1 where it is not."""
        if not len(self) or not len(ids):
            return np.full(len(ids), -1)
        order = np.argsort(self["id"], kind="stable")
        stored = self["id"][order]
        at = np.minimum(np.searchsorted(stored, ids), len(stored) - 1)
        return np.where(stored[at] == ids, order[at], -1)


def _latest(entries: Any) -> Any:
    """Return which entries count, where some are of the same case."""
    count, n, status = len(entries), np.arange(len(entries)), entries["status"]
    rank = np.where(status == DONE, 3 * count - n, np.where(status == FAILED, count + n, n))
    order = np.lexsort((rank, entries["id"]))
    ids = entries["id"][order]
    last = np.ones(len(ids), dtype=bool)
    last[:-1] = ids[:-1] != ids[1:]
    return slice(None) if last.all() else np.sort(order[last])


#: no case
EMPTY = CaseIndex(np.zeros(0, dtype=ENTRY))
