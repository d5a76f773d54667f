"""The schema of files: keys of cases, studies and fits, how they are read and how they are shown.

Each kind of file has a list of its keys, in a file ``schema.py``.
"""

import difflib
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

from ringwear_par.cases.faces import SHAPE_UNITS
from ringwear_par.cases.units import in_unit
from ringwear_par.cases.values import Interval, Kind, Reader, RejectedError, texts, whole
from ringwear_par.errors import MOST_FAULTS, Code, Fault, legible
from ringwear_par.files.text import shortened, toml_value

#: most lines of a file that may be left out
_MOST_LINES = 1_000_000
#: a number as it may not be written, perhaps with a unit
_COMMA = re.compile(r"[-+]?\d+,\d+(?!,)", re.ASCII)


@dataclass(frozen=True)
class Key:
    """One key of a case, study or fit file."""

    #: its dotted name
    path: str
    #: its values, see ``values.Values``
    kind: Kind
    read: Reader
    allowed: str
    numbers: Interval | None
    #: as ``info --schema`` prints them; "data's": a unit that the key does not tell
    unit: str
    meaning: str
    #: ... where the key must be given.
    default: Any = ...

    @property
    def rule(self) -> str:
        """What a message says of the values allowed, with their unit."""
        unit = "" if self.unit in ("-", "1") else f" ({self.unit})"
        return f"must be {self.allowed}{unit}"

    def without_units(self, value: Any, entry: str | None = None, unit: str | None = None) -> Any:
        """Return a raw value with numbers in the key's unit where they had one of their own.

        Parameters
        ----------
        entry : of the key, such as a shape's name, whose value it is; None: it is the key's.
        unit : in the place of the key's.

        Raises
        ------
        RejectedError : a unit is that of something else.
        """
        unit = self.unit if unit is None else unit
        match self.kind:
            case "points" if entry is not None:
                return _shape(entry, value)
            case "points" if isinstance(value, Mapping):  # a shape with a name
                return {name: _shape(name, size) for name, size in value.items()}
            case "points":
                first, _, second = unit.partition(" and ")
                return _pairs(value, first, second or first)
            case "schedule" | "quantity" if isinstance(value, Mapping):
                return {axis: _pairs(profile, "mm", unit) for axis, profile in value.items()}
            case "schedule" | "quantity" if isinstance(value, list):
                return _pairs(value, "s", unit)
            case "parameters" if entry is not None:
                return _in_case_units(value)
            case "parameters" if isinstance(value, Mapping):  # of a user's law
                return {name: _in_case_units(entry) for name, entry in value.items()}
            case "whole" | "counts" | "choice" | "names" | "text" | "parameters" | "layers":
                return value
        if entry is not None or (self.kind == "times" and isinstance(value, str)):
            return value
        return in_unit(value, "" if "'" in unit else unit)

    def value(self, raw: Any, unit: str | None = None) -> Any:
        """Return the value of a key as it is read, see ``without_units``.

        Raises
        ------
        RejectedError : it is not allowed, perhaps with the reason.
        """
        value = self.without_units(raw, unit=unit)
        try:
            return self.read(list(value) if isinstance(value, tuple) else value)
        except RejectedError as reason:
            comma = _COMMA.match(raw) if isinstance(raw, str) and not str(reason) else None
            if comma is None:
                raise
            point = comma[0].replace(",", ".")
            raise RejectedError(f"decimals have a point, as {point}") from reason


def _shape(name: str, size: Any) -> Any:
    """Return the size of a shape, or the points of a trace, without units."""
    if name == "trace":
        return _pairs(size, "mm", "mm")
    return in_unit(size, SHAPE_UNITS.get(name, ""))


def _in_case_units(value: Any) -> Any:
    """Return a number, table in time or profile whose unit is not declared, see ``in_unit``."""
    if isinstance(value, Mapping):
        return {axis: _pairs(profile, "mm", None) for axis, profile in value.items()}
    return _pairs(value, "s", None) if isinstance(value, list) else in_unit(value, None)


def _pairs(value: Any, first: str, second: str | None) -> Any:
    if not isinstance(value, list):
        return value
    return [
        [in_unit(entry[0], first), in_unit(entry[1], second)]
        if isinstance(entry, list) and len(entry) == 2
        else entry
        for entry in value
    ]


def file_keys(table: str) -> tuple[Key, Key]:
    """Return the keys of a table about lines and cells of a file that are left out."""
    return (
        Key(f"{table}.skip", *whole(0, _MOST_LINES), "-",
            "number of lines at the beginning of file that are left out", 0),
        Key(f"{table}.drop", *texts("a list of texts, such as [\"OVL\", \"9999\"]"), "-",
            "cells of file that are no readings, as they are written there, beside those that are "
            "always skipped", ()),
    )  # fmt: skip


def keys_of_table(keys: Iterable[Key], table: str) -> dict[str, Key]:
    """Return the keys of a table by their names in it; a table within it counts as one of them."""
    names: dict[str, Key] = {}
    for key in keys:
        if key.path.startswith(f"{table}."):
            names.setdefault(key.path.removeprefix(f"{table}."), key)
    return names


def name_unknown_keys(
    place: str,
    names: Iterable[str],
    allowed: Sequence[str],
    faults: list[str],
    fault: str = "unknown key",
    table: str = "",
) -> None:
    """Add a fault for each name that is not known, with the nearest one that is.

    Parameters
    ----------
    place : how the sentences begin: file and table.
    table : dotted, in which the names are.
    """
    for name in names:
        if name not in allowed:
            few = len(faults) < MOST_FAULTS  # no more are shown, and looking takes long
            near = difflib.get_close_matches(name.lower(), allowed, n=1) if few else []
            hint = f" (did you mean {near[0]}?)" if near else ""
            sentence = f"{place}: {legible(name)}: {fault}{hint}; must be one of "
            faults.append(
                Fault(sentence + ", ".join(allowed), f"{table}.{name}".lstrip("."), "unknown_key")
            )


class TableReader:
    """A table whose keys are read one by one; keys that nobody reads are unknown ones.

    Parameters
    ----------
    place : how messages begin: file and table.
    table : its keys and raw values; something else is a fault.
    faults : to which sentences are added.
    keys : of its schema, by their names in the table.
    """

    def __init__(
        self, place: str, table: Any, faults: list[str], keys: Mapping[str, Key] | None = None
    ) -> None:
        self.place, self.faults, self._keys = place, faults, keys or {}
        self._table: Mapping[str, Any] = table if isinstance(table, Mapping) else {}
        self._read: list[str] = []
        #: its dotted name in the schema
        self.loc = next((k.path.removesuffix(f".{name}") for name, k in self._keys.items()), "")
        if not isinstance(table, Mapping):
            sentence = f"{place} = {shortened(table)}: must be a table"
            faults.append(Fault(sentence, self.loc, "not_allowed"))

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def keys(self) -> Set[str]:
        """Return the names in the table."""
        return self._table.keys()

    def fault(self, sentence: str, name: str = "", code: Code | None = None) -> None:
        """Add a fault of the table, or of one of its keys; of a Fault, its code is kept."""
        loc = f"{self.loc}.{name}".strip(".")
        code = code or Fault(sentence).code
        self.faults.append(Fault(f"{self.place}: {sentence}", loc, code))

    def wrong(self, name: str, rule: str, code: Code = "not_allowed") -> None:
        """Add a fault of a key: its value, or that it is missing, and the rule."""
        value = f"= {shortened(self._table[name])}" if name in self._table else "is missing"
        code = code if name in self._table else "missing"
        self.fault(f"{name} {value}: {rule}", name, code)

    def raw(self, name: str, default: Any = None) -> Any:
        """Return the raw value of a key."""
        self._read.append(name)
        return self._table.get(name, default)

    def read(self, name: str, default: Any = None, unit: str | None = None) -> Any:
        """Return the value of a key; its default, None for none, where it is absent or wrong.

        Parameters
        ----------
        default : instead of that of the schema; None: that of the schema.
        unit : instead of that of the schema, for numbers with a unit.
        """
        key, value = self._keys[name], self.raw(name, ...)
        default = key.default if default is None else default
        fallback = None if default is ... else default
        if value is ...:
            if default is ...:
                self.wrong(name, f"must be {key.allowed}")
            return fallback
        try:
            return key.value(value, unit)
        except RejectedError as reason:
            hint = f" ({reason})" if str(reason) else ""
            self.wrong(name, f"must be {key.allowed}{hint}", reason.code)
            return fallback

    def finish(self, fault: str = "unknown key") -> None:
        """Add a fault for each key that nobody has read."""
        allowed = list(dict.fromkeys(self._read))
        name_unknown_keys(self.place, self._table, allowed, self.faults, fault, self.loc)


def key_table(keys: Iterable[Key], words: str = "") -> str:
    """Return a table of keys: path, unit, default, meaning, and the allowed values below.

    Parameters
    ----------
    words : in the rows of the table, in letters of either case; "": all rows.

    Returns
    -------
    str : "" where no row has the words.
    """
    rows = [row for key in keys if words.lower() in " ".join(row := _cells(key)).lower()]
    if not rows:
        return ""
    lines = [("key", "unit", "default", "meaning, and what is allowed")]
    for path, unit, default, meaning, allowed in rows:
        first = textwrap.wrap(meaning, 90)
        below = [f"    {line}" for line in textwrap.wrap(allowed, 86)]
        if len(default) > 20:  # a line of its own
            below.insert(0, f"    default: {default}")
            default = "below"
        lines.append((path, unit, default, first[0]))
        lines += [("", "", "", line) for line in first[1:] + below]
    widths = [max(len(line[i]) for line in lines) for i in range(3)]
    return "\n".join(
        "  ".join([*(c.ljust(w) for c, w in zip(line, widths, strict=False)), line[3]]).rstrip()
        for line in lines
    )


def _cells(key: Key) -> tuple[str, str, str, str, str]:
    default = "required" if key.default is ... else "-"
    if key.default is not ... and key.default is not None:
        default = toml_value(key.default)
    return key.path, key.unit, default, key.meaning, key.allowed
