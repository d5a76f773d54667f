"""Dotted keys of a case: out of TOML or a dict, and some of them set anew."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.files.columns import read_trace
from ringwear_par.cases.files.faults import LOADS, unread_keys
from ringwear_par.cases.layers import LAYERS, changed_layers, expanded, layers_in_full
from ringwear_par.cases.schema import BY_PATH, TABLES, key_of, law_keys, pair_entry
from ringwear_par.cases.tables import TableReader
from ringwear_par.cases.units import has_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.text import (
    parse_toml,
    parse_value,
    read_text,
    shortened,
    toml_value,
)

#: keys that exclude each other: an overriding one takes the place of the others
_ALTERNATIVES = (
    LOADS,
    frozenset({"upper.chamfer", "upper.profile"}),
    frozenset({"output.every", "output.times"}),
)
_FILES = frozenset({"wear.lower.file", "wear.upper.file"})
_PROFILES = frozenset({"lower.profile", "upper.profile"})
_PARAMETERS = frozenset({"wear.lower.parameters", "wear.upper.parameters"})
#: tables whose mere presence means something
_NEVER_EMPTY = {"stress", "stress.grid"}
_FIXED_STEPS = frozenset({"time.step", "time.steps"})


@contextmanager
def naming(prefix: str) -> Iterator[None]:
    """Begin each fault with where it is, such as "--set" or "case.toml:"."""
    try:
        yield
    except InputError as error:
        raise InputError(*(f.reworded(f"{prefix} {f}") for f in error.faults)) from error


def read_keys(text: str, name: str = "case") -> dict[str, Any]:
    """Return the dotted keys and raw values of a case's TOML text.

    Raises
    ------
    InputError : it is no TOML, or a study.
    """
    tables = parse_toml(text, name)
    refuse_study(tables, name)
    return flatten(tables, name)


def base_keys(
    name: str, folder: Path, tables: Mapping[str, Any], in_python: bool, faults: list[str]
) -> dict[str, Any] | None:
    """Return the dotted keys of the case that a study or a fit file begins from.

    None where something is wrong with it, which is added to the faults.

    Parameters
    ----------
    name : what messages call the file.
    folder : from which names of files count.
    tables : of the file; ``case`` is the name of a case file.
    in_python : whether ``case`` may be the tables of the case.
    """
    base = tables.get("case")
    try:
        if in_python and isinstance(base, Mapping):
            keys = flatten(base, f"{name}: case")
            with naming(f"{name}: case:"):
                return override({}, in_full(keys, folder))
        if isinstance(base, str):
            path = folder / base
            try:
                text = read_text(path)
            except InputError as error:
                sentence = f"{name}: case = {shortened(base)}: {error}"
                faults.append(Fault(sentence, "case", "unreadable"))
                return None
            keys = read_keys(text, str(path))
            with naming(f"{path}:"):
                return in_full(keys, path.parent)
    except InputError as error:
        faults += error.faults
        return None
    state = "is missing" if base is None else f"= {shortened(base)}"
    sentence = f"{name}: case {state}: must be the name of a case file, relative to this one"
    faults.append(Fault(sentence, "case", "missing" if base is None else "not_allowed"))
    return None


def keys_with_units(keys: Mapping[str, Any]) -> frozenset[str]:
    """Return the dotted keys whose numbers are written with a unit, those of layers too."""
    return frozenset(
        path
        for path, value in expanded(keys).items()
        if any(map(has_unit, value if isinstance(value, list) else [value]))
    )


def kinds(tables: Mapping[str, Any]) -> set[str]:
    """Return the kinds of file that tables have keys of: "case", "study", both or neither."""
    names = {path.partition(".")[0] for path in tables}
    case_tables = {path.partition(".")[0] for path in BY_PATH}
    tables_of = {"case": names & case_tables, "study": names & {"case", "vary", "design"}}
    return {kind for kind, keys in tables_of.items() if keys}


def refuse_study(tables: Mapping[str, Any], name: str) -> None:
    """Refuse a study, or a fit file, where a case is to be read.

    Raises
    ------
    InputError : it is one.
    """
    names = {path.partition(".")[0] for path in tables}
    if kinds(tables) <= {"study"} and names & {"fit", "experiment"}:
        raise InputError(f"{name}: is a fit file, not a case; ringwear fit computes it")
    if kinds(tables) == {"study"}:
        raise InputError(f"{name}: is a study, not a case; ringwear sweep computes it")


def parse_overrides(overrides: Sequence[str]) -> dict[str, Any]:
    """Return dotted keys and values of ``--set a.b=value`` options.

    Raises
    ------
    InputError : an option without "=".
    """
    values: dict[str, Any] = {}
    faults = []
    for item in overrides:
        path, equals, text = item.partition("=")
        if not equals or not path.strip():
            sentence = f"--set {legible(item)}: must be KEY=VALUE, such as load.pressure=50"
            faults.append(Fault(sentence, code="not_allowed"))
            continue
        path, value = path.strip(), parse_value(text)
        is_text = path in BY_PATH and BY_PATH[path].kind == "text"
        values[path] = text.strip() if is_text and not isinstance(value, str) else value
    if faults:
        raise InputError(*faults)
    return values


def replacing_tables(changes: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the dotted keys of changes; a table replaces the one before.

    Raises
    ------
    InputError : see ``flatten``.
    """
    tables = [p for p, value in changes.items() if isinstance(value, Mapping) and p not in BY_PATH]
    return {**dict.fromkeys(tables), **flatten(changes, name)}


def flatten(tables: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return dotted keys and plain values of nested tables that messages call ``name``.

    Raises
    ------
    InputError : a key is given twice.
    """
    flat: dict[str, Any] = {}
    twice = []
    for path, value in _entries(tables, ""):
        if path in flat:
            name_text = legible(path)
            sentence = f"{name}: {name_text}: is given twice, in a table and by its dotted name"
            twice.append(Fault(sentence, path, "conflict"))
        flat[path] = value
    if twice:
        raise InputError(*twice)
    return flat


def _entries(tables: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in tables.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping) and path not in BY_PATH:
            yield from _entries(value, f"{path}.")
            if not value and path not in TABLES - _NEVER_EMPTY:  # so that it is reported
                yield path, value
        else:
            yield path, plain(value)


def plain(value: Any) -> Any:
    """Return a value of Python, or tables of them, as TOML would give it."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return str(value) if isinstance(value, Path) else value


def source_tables(
    source: Path | str | Mapping[str, Any], name: str
) -> tuple[str, Path, dict[str, Any], str]:
    """Return the name in messages, the folder, the tables and the text of a file or a dict.

    Parameters
    ----------
    name : of a dict.

    Raises
    ------
    InputError : it cannot be read.
    """
    if isinstance(source, Mapping):
        tables = plain(source)
        text = "".join(
            f"{toml_value(key)} = {toml_value(value)}\n" for key, value in tables.items()
        )
        return name, Path(), tables, text
    text = read_text(Path(source))
    return str(source), Path(source).parent, parse_toml(text, str(source)), text


def changes_of(reader: TableReader, folder: Path) -> dict[str, Any]:
    """Return the case keys of the table ``set`` of a test; its faults are added to the reader's."""
    table = reader.raw("set", {})
    if not isinstance(table, Mapping):
        reader.wrong("set", "must be a table of case keys")
        return {}
    try:
        return in_full(flatten(table, f"{reader.place}: set"), folder)
    except InputError as error:
        reader.faults += error.faults
        return {}


def in_full(keys: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return dotted keys with numbers in the units of a case, and files with their whole names.

    A trace of a profile is in the place of its file.

    Parameters
    ----------
    keys : in which numbers may have units of their own; wrong ones stay, to be refused by readers.
    folder : from which the names of files count.

    Raises
    ------
    InputError : a trace of a profile cannot be read.
    """
    return dict(_in_full(path, value, folder) for path, value in keys.items())


def _in_full(path: str, value: Any, folder: Path) -> tuple[str, Any]:
    table, _, entry = path.rpartition(".")
    if table in _PROFILES:  # an entry, the one of its table
        shape = _face_in_full(table, {entry: value}, folder)
        (name,) = shape
        return f"{table}.{name}", shape[name]
    if table in _PARAMETERS:
        return path, _value_in_full(table, {entry: value}, folder)[entry]
    return path, _value_in_full(path, value, folder)


def _face_in_full(path: str, shape: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the shape of a face, with the points of a trace in the place of its file."""
    file = shape.get("file")
    if len(shape) == 1 and isinstance(file, str):
        try:
            return {"trace": read_trace(folder / file)}
        except InputError as error:
            faults = (Fault(f"{path}: {fault}", path, fault.code) for fault in error.faults)
            raise InputError(*faults) from error
    try:
        return {name: BY_PATH[path].without_units(value, name) for name, value in shape.items()}
    except RejectedError:
        return shape


def _value_in_full(path: str, value: Any, folder: Path) -> Any:
    if path in _FILES and isinstance(value, str):
        try:
            return str((folder / value).resolve())
        except (OSError, RuntimeError, ValueError):  # its reader reports it
            return value
    if path in _PROFILES and isinstance(value, dict):
        return _face_in_full(path, value, folder)
    if path in LAYERS:
        return layers_in_full(path, value)
    key = key_of(path) or BY_PATH.get((pair_entry(path) or (path,))[0])
    if isinstance(value, str | list | dict) and key is not None:
        try:
            return key.without_units(value)
        except RejectedError:
            return value
    return value


def override(keys: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return dotted keys with some of them replaced.

    A new load takes the place of the old one, as do other keys that exclude each other; keys that
    had a meaning and have none any more (of another law, scheme or geometry) go. None takes a key
    away, or all keys of a table. ``wear.lower.parameters.NAME`` is one entry of that table, as are
    ``upper.profile.crown``, ``upper.r[1]`` and ``lower.layers[0].wear.k``.

    Raises
    ------
    InputError : a layer is changed that is not there.
    """
    changes = changed_layers(keys, _with_parameters(keys, changes))
    gone = {path for path, value in changes.items() if value is None}
    # of "wear.lower.k" it and its tables, "wear" and "wear.lower"
    keys = {
        path: value
        for path, value in keys.items()
        if gone.isdisjoint(itertools.accumulate(path.split("."), "{}.{}".format))
    }
    changes = {path: value for path, value in changes.items() if value is not None}
    for table in ("wear.lower", "wear.upper"):
        own_keys = law_keys(table, changes.get(f"{table}.law"))
        if own_keys:
            keys = {p: v for p, v in keys.items() if not p.startswith(f"{table}.") or p in own_keys}
    for group in _ALTERNATIVES:
        if not group.isdisjoint(changes):
            keys = {path: value for path, value in keys.items() if path not in group}
    if changes.keys() >= _FIXED_STEPS:  # they say the end of an adaptive history too
        keys.pop("time.end", None)
    merged = {**keys, **changes}
    lost = unread_keys(merged).keys() - changes.keys()
    if lost:  # keys that had no meaning in the file before stay, and are reported
        lost -= unread_keys(keys).keys()
    return {path: value for path, value in merged.items() if path not in lost}


def _with_parameters(keys: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return changes of which those of single parameters are one of their whole table.

    So is the size of a face's shape, ``upper.profile.crown``; it takes the place of another shape.
    A number of a pair, ``upper.r[1]``, is a change of the pair.
    """
    changes = dict(changes)
    for path in [*changes]:
        table, place = pair_entry(path) or ("", 0)
        if table in BY_PATH and BY_PATH[table].kind == "pair":
            before = changes.get(table, keys.get(table))
            pair = [*before] if isinstance(before, list) and len(before) == 2 else [None, None]
            pair[place] = changes.pop(path)
            changes[table] = pair
    for table in (*_PARAMETERS, *_PROFILES):
        named = {path: v for path, v in changes.items() if path.startswith(f"{table}.")}
        if named:
            before = None if table in _PROFILES else changes.get(table, keys.get(table))
            entries = dict(before) if isinstance(before, dict) else {}
            for path, value in named.items():
                entries[path.removeprefix(f"{table}.")] = value
                del changes[path]
            changes[table] = {name: value for name, value in entries.items() if value is not None}
    return changes
