"""Blocks of cases whose histories are given, not computed."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from ringwear_par.results.result import HistoryColumns
from ringwear_par.studies.storage.blocks import Block
from ringwear_par.studies.stored_variables import FIELDS, OF_A_CASE


@dataclass
class StoredCase:
    """A case and its history: columns by name, "r" and "width" among them."""

    id: str
    toml: str = ""
    status: str = "done"
    error: str = ""
    seconds: float = 0.1
    imbalance: float = 0.0
    columns: dict = field(default_factory=dict)
    flags: tuple = ()


def block_of(cases, version="1", texts=None):
    """Return a block of cases, the first of which has all columns that others have."""
    first = next((case.columns for case in cases if case.columns), {})
    full = [case.columns for case in cases if case.columns]
    names = [name for name in first if name not in ("r", "width", *OF_A_CASE)]
    states = {name: np.concatenate([columns[name] for columns in full]) for name in names}
    rows = [len(case.columns.get("time", ())) for case in cases]
    histories = HistoryColumns(
        offsets=np.cumsum([0, *rows]),
        steps=np.zeros(0),
        histories=states,
        profiles={},
        imbalance=np.array([case.imbalance for case in cases]),
        flags=tuple(case.flags for case in cases),
        seconds=np.array([case.seconds for case in cases]),
        status=tuple(case.status for case in cases),
        reason=tuple(case.error for case in cases),
    )
    r = first.get("r", np.zeros(0))
    line = SimpleNamespace(n=len(r), r=r, width=first.get("width", r))
    deep = any(name in FIELDS for name in states)
    return Block.of(
        histories, line, [case.id for case in cases],
        texts or [case.toml for case in cases], version, deep=deep,
    )  # fmt: skip
