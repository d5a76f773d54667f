"""Keys of a case file whose numbers are moved: raw ones, texts of numbers put into them."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ringwear_par.cases.files.keys import flatten, override, parse_overrides, read_keys
from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.layers import changed_layers, expanded
from ringwear_par.cases.units import has_unit, in_unit, is_plain, number_and_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, legible
from ringwear_par.explorer.controls import Control
from ringwear_par.files.text import read_text
from ringwear_par.history.refusals import check_case

_PROFILES = ("lower.profile", "upper.profile")
_FILES = ("wear.lower.file", "wear.upper.file", *(f"{table}.file" for table in _PROFILES))


def raw_keys(path: Path, overrides: list[str]) -> dict[str, Any]:
    """Return the dotted keys of a case file as the user wrote them, names of files in full.

    Raises
    ------
    InputError : what ``ringwear run`` refuses, in its words.
    """
    check_case(read_case(path, overrides), 1, str(path))
    file_keys = _files_in_full(read_keys(read_text(path), str(path)), path.parent)
    changes = flatten(parse_overrides(overrides), "--set")
    return override(file_keys, _files_in_full(changes, Path()))


def _files_in_full(keys: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return keys with the whole names of files, so that the text may be saved anywhere."""
    full = dict(keys)
    for path, value in keys.items():
        if path in _FILES:
            full[path] = str((folder / value).resolve())
        elif path in _PROFILES and isinstance(value, Mapping) and "file" in value:
            full[path] = {"file": str((folder / value["file"]).resolve())}
    return full


def changed_keys(
    keys: Mapping[str, Any], controls: Mapping[str, Control], texts: Mapping[str, str]
) -> tuple[dict[str, Any], dict[str, Control]]:
    """Return keys with other numbers, and the controls as they then stand.

    Parameters
    ----------
    keys : raw ones.
    controls : of these keys, by name.
    texts : numbers by the names of controls, perhaps with units, as in a case file.

    Raises
    ------
    InputError : all texts that are no numbers.
    """
    raw_keys, changes, moved, faults = expanded(keys), dict[str, Any](), dict(controls), []
    for name, text in texts.items():
        control = controls.get(name)
        if control is None:
            faults.append(f"{legible(name)}: is no number of this case that can be moved")
            continue
        try:
            raw, value = _read(control, text)
        except RejectedError as reason:
            cause = f" ({reason})" if str(reason) else ""
            unit = f" in {control.unit}" if control.unit else ""
            unit += ", or one with its unit" if control.unit and not control.scales else ""
            faults.append(
                f"{control.name} = {legible(text) or '(empty)'}: must be a number{unit}{cause}"
            )
            continue
        moved[name] = control.at(value)
        changes[control.path] = _put(
            control, changes.get(control.path, raw_keys.get(control.path)), raw
        )
    if faults:
        raise InputError(*faults)
    return {**keys, **changed_layers(keys, changes)}, moved


def _read(control: Control, text: str) -> tuple[Any, float]:
    """Return the raw value of a text, and its number in the unit of the control."""
    text = text.strip().replace("\N{MINUS SIGN}", "-")
    if is_plain(text):
        value = float(text)
        if not math.isfinite(value):
            raise RejectedError
        if control.whole and value.is_integer() and abs(value) < 1e15:
            return int(value), value
        return (f"{text} {control.unit}" if control.written else value), value
    if control.scales or not has_unit(text) or not control.unit:
        raise RejectedError
    return text, float(in_unit(text, control.unit))


def _put(control: Control, before: Any, raw: Any) -> Any:
    """Return the raw value of a key with that of a control in it."""
    if control.scales:
        if isinstance(control.entry, str):
            return {**before, control.entry: _scaled(before[control.entry], raw)}
        return _scaled(before, raw)
    if isinstance(control.entry, int):
        entries = list(before)
        entries[control.entry] = raw
        return entries
    if isinstance(control.entry, str):
        shape, _, place = control.entry.partition("[")
        if place:  # one of the two fillets
            entries = list(before[shape])
            entries[int(place[:-1])] = raw
            return {**before, shape: entries}
        return {**before, control.entry: raw}
    return raw


def _scaled(table: Any, times: float) -> Any:
    """Return a table [[x, value], ...], or { r = such a table }, its values multiplied."""
    if isinstance(table, Mapping):
        return {axis: _scaled(points, times) for axis, points in table.items()}
    return [[x, _times_as_much(value, times)] for x, value in table]


def _times_as_much(value: Any, times: float) -> Any:
    if times == 1.0:
        return value
    if isinstance(value, str):  # with a unit
        number, unit = number_and_unit(value)
        return f"{number * times:.12g} {unit}"
    return float(f"{value * times:.12g}")
