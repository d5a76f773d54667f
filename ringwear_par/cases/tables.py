"""Tables of study and fit files, read by their keys; faults are collected."""

import difflib
from collections.abc import Iterable, Mapping, Set
from typing import Any

from ringwear_par.cases.schema import Key
from ringwear_par.cases.text import shortened
from ringwear_par.cases.units import in_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import MOST_FAULTS, legible


def keys_of_table(keys: Iterable[Key], table: str) -> dict[str, Key]:
    """Return the keys of a table by their names in it; a table within it counts as one of them."""
    names: dict[str, Key] = {}
    for key in keys:
        if key.path.startswith(f"{table}."):
            names.setdefault(key.path.removeprefix(f"{table}."), key)
    return names


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
        if not isinstance(table, Mapping):
            faults.append(f"{place} = {shortened(table)}: must be a table")

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def keys(self) -> Set[str]:
        """Return the names in the table."""
        return self._table.keys()

    def fault(self, sentence: str) -> None:
        """Add a fault of the table."""
        self.faults.append(f"{self.place}: {sentence}")

    def wrong(self, name: str, rule: str) -> None:
        """Add a fault of a key: its value, or that it is missing, and the rule."""
        value = f"= {shortened(self._table[name])}" if name in self._table else "is missing"
        self.fault(f"{name} {value}: {rule}")

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
        unit = key.unit if unit is None else unit
        try:
            value = in_unit(value, "" if "'" in unit else unit)  # "data's" is not known yet
            return key.read(list(value) if isinstance(value, tuple) else value)
        except RejectedError as reason:
            why = f" ({reason})" if str(reason) else ""
            self.wrong(name, f"must be {key.allowed}{why}")
            return fallback

    def finish(self) -> None:
        """Add a fault for each key that nobody has read."""
        known = list(dict.fromkeys(self._read))
        for name in self._table:
            if name not in known:
                few = len(self.faults) < MOST_FAULTS
                near = difflib.get_close_matches(name.lower(), known, n=1) if few else []
                hint = f" (did you mean {near[0]}?)" if near else ""
                self.fault(f"{legible(name)}: unknown key{hint}; must be one of {', '.join(known)}")
