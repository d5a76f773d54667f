"""Cases that differ in numbers only: looked at by column, and made without reading them anew.

The numbers are those whose keys stand for one number of a case, whatever the others are: moduli,
friction, loads, the end and tolerances of adaptive steps, parameters of wear laws. They are called
by their key and, for a parameter of a user's law or of a layer's, its name in table or list.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import SAME_TIME, Case, Ring, RingLayer
from ringwear_par.cases.law import Law, faults_together
from ringwear_par.cases.layers import LAYERS
from ringwear_par.cases.schema import BY_PATH, LAYER_KEYS, key_of
from ringwear_par.cases.values import Interval, magnitude_fault
from ringwear_par.errors import InputError

#: key and name of a parameter of a user's law, or of a layer's ("[0].wear.k"), None elsewhere
Number = tuple[str, str | None]

#: which part of a case has the number of a key, and what it is called there
_PLACES = {
    "contact.friction": ("", "friction"),
    "lower.young": ("lower", "young"),
    "upper.young": ("upper", "young"),
    "load.force": ("load", "force"),
    "load.pressure": ("load", "force"),
    "load.displacement": ("load", "displacement"),
    "load.omega": ("load", "omega"),
    "time.end": ("time", "until"),
    "time.tolerance": ("time", "tolerance"),
    **{
        path: (f"wear_{path.split('.')[1]}", path.split(".")[2])
        for path, key in BY_PATH.items()
        if path.startswith("wear.") and key.numbers is not None
    },
}
_TABLES = {"wear.lower.parameters": "wear_lower", "wear.upper.parameters": "wear_upper"}
_ANY = Interval(-math.inf)
#: cached properties that no such number changes, and that take time to work out
_OF_SHAPES: dict[type, tuple[str, ...]] = {Case: ("line", "smallest_gaps", "initial_gap")}


def interval_of(number: Number) -> Interval | None:
    """Return the interval of a number by itself, None if it is none of those above."""
    path, entry = number
    if entry is not None and path in LAYERS:
        key = key_of(f"{path}{entry}")  # elasticity is that of the other entries
        return key.numbers if key is not None and key.path.startswith("wear.") else None
    if entry is not None:
        return _ANY if path in _TABLES else None
    return BY_PATH[path].numbers if path in _PLACES else None


def number_faults(case: Case, name: str) -> list[str]:
    """Return the faults of the numbers of a case that was not read, sentences with its name."""
    numbers = [
        (f"{table}.{key.path}", key, getattr(layer, key.path, None))
        for table, layer in case.materials.items()
        if isinstance(layer, RingLayer)
        for key in LAYER_KEYS
    ]
    for path, (part, attribute) in _PLACES.items():
        owner = getattr(case, part) if part else case
        if path == "load.pressure" or (part == "time" and not case.time.adaptive):
            continue
        if isinstance(owner, Law):
            numbers.append((path, BY_PATH[path], owner.values.get(attribute)))
        else:
            numbers.append((path, BY_PATH[path], getattr(owner, attribute, None)))
    faults = []
    for path, key, value in numbers:
        if not isinstance(value, float | int) or key.numbers is None:
            continue
        if not key.numbers.holds(np.array(float(value))):
            reason = magnitude_fault(value)
            rule = f"{key.rule} ({reason})" if reason else key.rule
            faults.append(f"{name}: {path} = {value:g}: {rule}")
    return faults


def _refused(case: Case, numbers: Mapping[Number, FloatArray]) -> BoolArray:
    """Return which cases are not known to be good, with steps and rows of a good one, (cases,)."""
    refused = np.zeros(len(next(iter(numbers.values()))), dtype=bool)
    for number, values in numbers.items():
        if (interval := interval_of(number)) is not None:
            refused |= ~interval.holds(values)
    if any(law.code is not None for law in case.laws_by_table.values()):
        return ~refused  # their functions are tried
    ends = numbers.get(("time.end", None))
    if ends is not None:
        whole = replace(case, time=replace(case.time, until=math.inf))  # with all its breakpoints
        refused |= np.searchsorted(whole.breakpoints, ends) != len(case.breakpoints)
        refused |= case.last_stored_time > ends * (1.0 + SAME_TIME)
    displacement = numbers.get(("load.displacement", None))
    if displacement is not None:
        refused |= case.interpenetration > displacement
    for table, law in case.laws_by_table.items():
        refused |= _refused_by(law, table, numbers, len(refused))
    return refused


def _refused_by(
    law: Law, table: str, numbers: Mapping[Number, FloatArray], count: int
) -> BoolArray:
    """Return which cases' parameters break a rule of the law between them, (cases,)."""
    columns = {
        key.removeprefix(f"{table}."): column.tolist()
        for (path, entry), column in numbers.items()
        if (key := path if entry is None else f"{path}{entry}").startswith(f"{table}.")
    }
    if not columns or not any(parameter.at_least for parameter in law.kind.declared):
        return np.zeros(count, dtype=bool)
    rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
    return np.array([bool(faults_together(law.kind, "", {**law.values, **row})) for row in rows])


def cases_with(
    case: Case,
    numbers: Mapping[Number, FloatArray],
    text: str,
    read: Callable[[int], Case | InputError],
) -> list[Case | InputError]:
    """Return cases with other numbers and a text: copies, where these are known to be good.

    Parameters
    ----------
    case : a good one of them, which was made of keys, see ``make_case``.
    numbers : of all cases, (cases,).
    read : returns a case that has to be read and checked, by its place, or why it cannot be.
    """
    refused = _refused(case, numbers)
    columns: dict[str, dict[str, Sequence[Any]]] = {"": {"text": [text] * len(refused)}}
    for (path, entry), of_cases in numbers.items():
        if entry is None:
            part, name = _PLACES[path]
        elif path in LAYERS:
            part, name = path.partition(".")[0], entry
        else:
            part, name = _TABLES[path], f"parameters.{entry}"
        values = of_cases * case.area if path == "load.pressure" else of_cases
        columns.setdefault(part, {})[name] = values.tolist()
    changes = columns.pop("")
    for name, part_columns in columns.items():
        part = getattr(case, name)
        if isinstance(part, Law):
            part_columns = {"values": _values(part, part_columns)}
        if isinstance(part, Ring):
            part_columns = _with_layers(part, part_columns)
        changes[name] = _copies(part, part_columns)
    cases = _copies(case, changes)
    if len(np.unique(numbers.get(("time.end", None), ()))) < 2:
        for copy in cases:  # no number bends
            copy.__dict__["breakpoints"] = cases[0].breakpoints
    for place in np.flatnonzero(refused).tolist():
        cases[place] = read(place)
    return cases


def _with_layers(ring: Ring, columns: Mapping[str, Sequence[Any]]) -> dict[str, Sequence[Any]]:
    """Return the columns of a ring's fields; those of entries of layers become whole layers."""
    fields_of_ring = {name: values for name, values in columns.items() if name[0] != "["}
    if len(fields_of_ring) == len(columns):
        return fields_of_ring
    count = len(next(iter(columns.values())))
    layers = []
    for i, layer in enumerate(ring.layers):
        start = f"[{i}].wear."
        law = {n.removeprefix(start): v for n, v in columns.items() if n.startswith(start)}
        laws: list[Any] = [layer.wear] * count
        if law:
            own = Law.of(layer.wear)
            laws = _copies(own, {"values": _values(own, law)})
        layers.append(_copies(layer, {"wear": laws}))
    return fields_of_ring | {"layers": list(zip(*layers, strict=True))}


def _values(law: Law, columns: Mapping[str, Sequence[float]]) -> list[dict[str, Any]]:
    rows = zip(*columns.values(), strict=True)
    return [{**law.values, **dict(zip(columns, row, strict=True))} for row in rows]


def _copies(original: Any, columns: Mapping[str, Sequence[Any]]) -> list[Any]:
    """Return frozen dataclasses with other values of fields, quicker than ``replace``.

    Cached properties are not copied, but for those of a case's shape, which no number changes.
    """
    kind = type(original)
    names = {*(field.name for field in fields(original)), *_OF_SHAPES.get(kind, ())}
    for name in _OF_SHAPES.get(kind, ()):
        getattr(original, name)  # worked out once for all copies
    state = {name: value for name, value in original.__dict__.items() if name in names}
    copies = []
    for row in zip(*columns.values(), strict=True):
        copy = object.__new__(kind)
        copy.__dict__.update(state, **dict(zip(columns, row, strict=True)))
        copies.append(copy)
    return copies
