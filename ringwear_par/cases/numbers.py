"""Cases that differ in numbers only: looked at by column, and made without reading them anew.

The numbers are those whose keys stand for one number of a case, whatever the others are: moduli,
friction, loads, the end and tolerances of adaptive steps, parameters of wear laws. They are called
by their key and, for a parameter of a user's law or of a layer's, its name in table or list.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case, Ring
from ringwear_par.cases.laws import make_law
from ringwear_par.cases.layers import LAYERS
from ringwear_par.cases.schema import BY_PATH, LAYER_KEYS, Key, key_of
from ringwear_par.cases.values import Interval, magnitude_fault
from ringwear_par.wear.law import Law
from ringwear_par.wear.parameters import parameters_of
from ringwear_par.wear.user import UserLaw

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
    "time.pressure_tolerance": ("time", "pressure_tolerance"),
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
    """Return what a number may be by itself; None if it is none of those told above."""
    path, entry = number
    if entry is not None and path in LAYERS:
        key = key_of(f"{path}{entry}")  # elasticity is that of the other entries
        return key.numbers if key is not None and key.path.startswith("wear.") else None
    if entry is not None:
        return _ANY if path in _TABLES else None
    return BY_PATH[path].numbers if path in _PLACES else None


def number_faults(case: Case, name: str) -> list[str]:
    """Return what is wrong with the numbers of a case that was not read, one sentence each.

    Parameters
    ----------
    name : what messages call the case.
    """
    faults = _layer_faults(case, name)
    for path, (part, attribute) in _PLACES.items():
        key, whole = BY_PATH[path], getattr(case, part) if part else case
        value = getattr(whole, attribute, None)
        other = (
            path == "load.pressure"
            or (part == "time" and not case.time.adaptive)
            or (isinstance(whole, Law) and attribute not in parameters_of(type(whole)))
        )
        if other or not isinstance(value, float | int) or key.numbers is None:
            continue
        if not key.numbers.holds(np.array(float(value))):
            faults.append(f"{name}: {path} = {value:g}: {_rule(key, value)}")
    return faults


def _rule(key: Key, value: float) -> str:
    """Return what is allowed, with the reason where it is the magnitude."""
    fault = magnitude_fault(value)
    return f"{key.rule} ({fault})" if fault else key.rule


def _layer_faults(case: Case, name: str) -> list[str]:
    """Return the same of layers."""
    return [
        f"{name}: {body}.layers[{i}].{key.path} = {value:g}: {_rule(key, value)}"
        for body, ring in zip(("lower", "upper"), case.rings, strict=True)
        for i, layer in enumerate(ring.layers)
        for key in LAYER_KEYS
        if isinstance(value := getattr(layer, key.path, None), float | int)
        and key.numbers is not None
        and not key.numbers.holds(np.array(float(value)))
    ]


def doubtful(case: Case, numbers: Mapping[Number, FloatArray]) -> BoolArray:
    """Return which cases have to be made and checked one by one, (cases,).

    The others are good if one of them is, and have its steps and rows.

    Parameters
    ----------
    case : a good one of them.
    numbers : of each, (cases,), all of them right by themselves.
    """
    found = np.zeros(len(next(iter(numbers.values()))), dtype=bool)
    if any(isinstance(law, UserLaw) for law in (case.wear_lower, case.wear_upper)):
        return ~found  # they are tried
    if ("time.end", None) in numbers and (case.output.times or _bends(case)):
        return ~found
    deepest = numbers.get(("load.displacement", None))
    if deepest is not None:
        found |= case.interpenetration > deepest
    for table, law in _laws(case).items():
        found |= _refused(table, law, numbers, len(found))
    return found


def _laws(case: Case) -> dict[str, Law]:
    """Return the laws of bodies, and of layers that have their own, by their tables of keys."""
    found = {"wear.lower": case.wear_lower, "wear.upper": case.wear_upper}
    for body, ring in zip(("lower", "upper"), case.rings, strict=True):
        found |= {f"{body}.layers[{i}].wear": layer.wear for i, layer in enumerate(ring.layers)}
    return {table: law for table, law in found.items() if isinstance(law, Law)}


def _refused(table: str, law: Law, numbers: Mapping[Number, FloatArray], count: int) -> BoolArray:
    """Return which cases' parameters make no law together, (cases,): the law is asked of each."""
    columns = {}
    for (path, entry), column in numbers.items():
        key = path if entry is None else f"{path}{entry}"
        if key.startswith(f"{table}."):
            columns[key.removeprefix(f"{table}.")] = column.tolist()
    if not columns:
        return np.zeros(count, dtype=bool)
    values = {name: getattr(law, name) for name in parameters_of(type(law))}
    rows = zip(*columns.values(), strict=True)
    return np.array(
        [
            make_law(type(law), table, values | dict(zip(columns, row, strict=True)))[0] is None
            for row in rows
        ]
    )


def _bends(case: Case) -> bool:
    """Tell whether a schedule or a parameter bends at any time."""
    return bool(replace(case, time=replace(case.time, until=math.inf)).breakpoints)


def with_numbers(
    case: Case, numbers: Mapping[Number, Sequence[float]], texts: Sequence[str]
) -> list[Case]:
    """Return cases with other numbers, that are known to be good; see ``make_case``.

    Parameters
    ----------
    case : one of them, made of keys.
    numbers : of each case.
    texts : of each case.
    """
    fields: dict[str, dict[str, Sequence[Any]]] = {"": {"text": texts}}
    for (path, entry), values in numbers.items():
        if entry is not None:
            part = path.partition(".")[0] if path in LAYERS else _TABLES[path]
            fields.setdefault(part, {})[entry] = values
            continue
        part, name = _PLACES[path]
        if path == "load.pressure":
            area = case.area
            values = [pressure * area for pressure in values]
        fields.setdefault(part, {})[name] = values
    whole = fields.pop("")
    for part, own in fields.items():
        there = getattr(case, part)
        if isinstance(there, UserLaw):
            own = {"parameters": _parameters(there, own)}
        if isinstance(there, Ring):
            own = _with_layers(there, own)
        whole[part] = _copies(there, own)
    return _copies(case, whole)


def _with_layers(ring: Ring, own: Mapping[str, Sequence[Any]]) -> dict[str, Sequence[Any]]:
    """Return values of fields of a ring, those of entries of its layers made whole layers."""
    found = {name: values for name, values in own.items() if not name.startswith("[")}
    entries = {name: values for name, values in own.items() if name.startswith("[")}
    if entries:
        columns = []
        for i, layer in enumerate(ring.layers):
            begin = f"[{i}].wear."
            laws = {k.removeprefix(begin): v for k, v in entries.items() if k.startswith(begin)}
            count = len(next(iter(entries.values())))
            made = _copies(layer.wear, laws) if laws else [layer.wear] * count
            columns.append(_copies(layer, {"wear": made}))
        found["layers"] = list(zip(*columns, strict=True))
    return found


def _parameters(law: UserLaw, own: Mapping[str, Sequence[float]]) -> list[Any]:
    rows = zip(*own.values(), strict=True)
    changed = (dict(zip(own, row, strict=True)) for row in rows)
    return [tuple((name, new.get(name, q)) for name, q in law.parameters) for new in changed]


def _copies(whole: Any, own: Mapping[str, Sequence[Any]]) -> list[Any]:
    """Return frozen dataclasses with other values of fields, quicker than ``replace``.

    What one has worked out of its fields is forgotten, but for what no number changes.
    """
    kind = type(whole)
    same = {*(field.name for field in fields(whole)), *_OF_SHAPES.get(kind, ())}
    there = {name: value for name, value in whole.__dict__.items() if name in same}
    names, made = tuple(own), []
    for row in zip(*own.values(), strict=True):
        copy = object.__new__(kind)
        copy.__dict__.update(there)
        copy.__dict__.update(zip(names, row, strict=True))
        made.append(copy)
    return made
