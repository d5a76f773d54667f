"""Ids of cases, by their content: for one case, and for all of a study by column.

An id does not depend on the study that a case belongs to, on the order of its keys or on how a
number is written, so that a study may grow, shrink or change and the cases that stay the same keep
their results.
"""

import hashlib
import itertools
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.layers import LAYERS, entries_of
from ringwear_par.cases.numbers import Number
from ringwear_par.cases.schema import BY_PATH, key_of
from ringwear_par.files.text import read_text
from ringwear_par.studies.definition.varied_columns import CaseColumns, by_kind

#: cases whose ids are made together
_WINDOW = 2**14


def case_id(case_keys: Mapping[str, Any]) -> str:
    """Return the id of a case, from all that its results depend on: 16 hexadecimal digits."""
    pieces = _id_pieces(case_keys, {})
    return _digest("".join(map(str, pieces)))


def _digest(contents: str) -> str:
    """Return the id of JSON pairs, each of which begins with a comma."""
    return hashlib.sha256(f"{{{contents[2:]}}}".encode()).hexdigest()[:16]


def _id_pieces(case_keys: Mapping[str, Any], numbers: Mapping[Number, int]) -> list[str | int]:
    """Return the JSON pairs that an id is made of, Places in keys being numbers of columns."""
    pieces: list[str | int] = []
    for path in sorted(case_keys.keys() - {"title"}):
        raw, key = case_keys[path], BY_PATH[path]
        if (path, None) in numbers:
            pieces.append(numbers[path, None])
        elif path.startswith("wear.") and path.endswith(".file"):  # what it says, not where it is
            pieces.append(_pair(path, read_text(Path(raw))))
        elif path in LAYERS:
            for entry, value in sorted((entries_of(raw) or {}).items()):
                entry_key = key_of(f"{path}{entry}")
                assert entry_key is not None
                if (path, entry) in numbers:
                    pieces.append(numbers[path, entry])
                elif (value := entry_key.read(value)) != entry_key.default:
                    pieces.append(_pair(f"{path}{entry}", value))
        elif isinstance(raw, dict) and any((path, name) in numbers for name in raw):
            entries = key.read({n: 0.0 if (path, n) in numbers else v for n, v in raw.items()})
            pieces.append(f", {json.dumps(path)}: [")
            for i, (name, value) in enumerate(entries):
                pieces.append(f"{', ' if i else ''}[{json.dumps(name)}, ")
                known = (path, name) in numbers
                pieces.append(numbers[path, name] if known else json.dumps(value, default=repr))
                pieces.append("]")
            pieces.append("]")
        else:
            value = key.read(raw)
            if value != key.default:
                pieces.append(_pair(path, value))
    return pieces


def _pair(path: str, value: Any) -> str:
    return f", {json.dumps(path)}: {json.dumps(value, default=repr)}"


def identities_of(rows: CaseColumns, firsts: Mapping[int, int]) -> Any:
    """Return (cases,) bytes, the ids of good cases, by a good case of each kind that has one."""
    identities = np.zeros(len(rows.kinds), dtype="S16")
    for start in range(0, len(identities), _WINDOW):
        window = slice(start, start + _WINDOW)
        part = rows.part(window)
        written: list[list[str]] = [[]] * len(rows.columns)
        for (path, entry), i in rows.numbers.items():
            name = path if entry is None else f"{path}{entry}" if path in LAYERS else ""
            key = key_of(name) if name else None
            begin = f", {json.dumps(name)}: "
            write = partial(_number_pair, begin, key.default) if key else _number_text
            written[i] = part.columns[i].by_case(write)
        for kind, cases in by_kind(rows.kinds[window]):
            if kind in firsts:
                pieces = _id_pieces(rows.keys(firsts[kind], places=True), rows.numbers)
                columns = [
                    itertools.repeat(piece, len(cases))
                    if isinstance(piece, str)
                    else [written[piece][i] for i in cases.tolist()]
                    for piece in pieces
                ]
                texts = map("".join, zip(*columns, strict=True))
                identities[start + cases] = list(map(_digest, texts))
    return identities


def _number_text(raw: Any) -> str:
    """Return a number as JSON has it."""
    return repr(float(raw))


def _number_pair(begin: str, default: Any, raw: Any) -> str:
    """Return the JSON pair of a number, "" for the default of its key."""
    value = float(raw)
    return "" if value == default else begin + repr(value)
