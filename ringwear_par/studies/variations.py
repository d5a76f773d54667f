"""Varied keys: the names of keys of a case and of their entries, and the values they get."""

import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.files.key_values import unknown_key
from ringwear_par.cases.files.keys import override
from ringwear_par.cases.layers import LAYERS, entries_of
from ringwear_par.cases.schema import BY_PATH, key_of, layer_entry
from ringwear_par.cases.tables import Key
from ringwear_par.cases.values import RejectedError, is_finite, is_number
from ringwear_par.errors import Fault, legible
from ringwear_par.files.text import shortened, toml_value

#: most cases of a design
MOST_CASES = 10**6
_RULE = (
    "must be { values = [...] }, { linear = [low, high] } or { log = [low, high] }, increasing "
    f"numbers, > 0 for log; a range has a count from 2 to {MOST_CASES} in a grid, and in no other "
    "design"
)
#: an entry of a pair, or of a table, in the name of a varied key
_PAIR = re.compile(r"(.+)\[([01])\]")
_TABLE = re.compile(r"(wear\.(?:lower|upper)\.parameters|(?:lower|upper)\.profile)\.(.+)")


@dataclass(frozen=True, eq=False)
class Column:
    """The raw values of a varied key in all cases."""

    #: the distinct ones, float64 where all are floats, else of objects
    values: NDArray[Any]
    #: (cases,) which of the values each case has
    codes: NDArray[np.int32]

    @classmethod
    def of(cls, values: Sequence[Any] | FloatArray) -> "Column":
        """Return the column of one value for each case; values of the same text are one."""
        if isinstance(values, np.ndarray) or all(type(value) is float for value in values):
            distinct, codes = np.unique(np.asarray(values, dtype=float), return_inverse=True)
            return cls(distinct, codes.astype(np.int32))
        known: dict[str, tuple[int, Any]] = {}
        codes = [known.setdefault(toml_value(value), (len(known), value))[0] for value in values]
        return cls.chosen([value for _, value in known.values()], np.array(codes))

    @classmethod
    def chosen(cls, values: Sequence[Any], codes: NDArray[Any]) -> "Column":
        """Return the column of some values, by number."""
        array = np.empty(len(values), dtype=object)
        array[:] = values
        return cls(array, codes.astype(np.int32))

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, case: int) -> Any:
        value = self.values[self.codes[case]]
        return value.item() if isinstance(value, np.generic) else value

    def part(self, cases: slice | IntArray) -> "Column":
        """Return the column of some of the cases."""
        return Column(self.values, self.codes[cases])

    def mapped(self, function: Callable[[Any], Any]) -> "Column":
        """Return the column of a function of each value."""
        return Column.chosen(list(map(function, self.distinct)), self.codes)

    def by_case(self, function: Callable[[Any], Any] | None = None) -> list[Any]:
        """Return the value of each case, or a function of it."""
        used, codes = np.unique(self.codes, return_inverse=True)
        values = self.values[used].tolist()
        values = values if function is None else list(map(function, values))
        return [values[code] for code in codes.tolist()]

    @property
    def distinct(self) -> list[Any]:
        """The distinct values."""
        return self.values.tolist()

    @cached_property
    def numbers(self) -> FloatArray | None:
        """(cases,) the values, where all are numbers."""
        if self.values.dtype == object and not all(map(is_number, self.values)):
            return None
        return self.values.astype(np.float64)[self.codes]


# -- names of keys and their entries ---------------------------------------------------------------


def split_key(name: str) -> tuple[str, int | str | None]:
    """Return the case key of a varied one, and which entry of a pair, table or layer it is.

    That of a layer is "[0].wear.k" of "lower.layers"; None for the whole value.
    """
    if (layer := layer_entry(name)) is not None:
        return layer[0], f"{layer[1]}.{layer[2]}"
    if match := _PAIR.fullmatch(name):
        return match[1], int(match[2])
    match = _TABLE.fullmatch(name)
    return (match[1], match[2]) if match else (name, None)


def whole_name(path: str, entry: str) -> str:
    """Return the name of an entry of a table or of layers, as ``split_key`` takes it."""
    return f"{path}{entry}" if path in LAYERS else f"{path}.{entry}"


def path_of(name: str) -> str:
    """Return the case key of a varied one, which may be an entry of it."""
    return split_key(name)[0]


def own_key(name: str) -> Key:
    """Return the key of a varied one: of a layer's entry its own, else that of the whole."""
    return key_of(name) or BY_PATH[path_of(name)]


def without_units(name: str, value: Any) -> Any:
    """Return a raw value of a varied key in the case's units; RejectedError for a wrong unit."""
    path, entry = split_key(name)
    part = entry if isinstance(entry, str) and path not in LAYERS else None
    return own_key(name).without_units(value, part)


def name_fault(place: str, name: str, loc: str) -> Fault | None:
    """Return why a key cannot vary, None where it can."""
    path, index = split_key(name)
    if (key_of(name) or BY_PATH.get(path)) is None or (path in LAYERS and key_of(name) is None):
        reason = unknown_key(name if path in LAYERS else path)
        return Fault(f"{place}: {reason}", loc, "unknown_key")
    if name == "title":
        sentence = f"{place}: a title makes no other case; must be another key"
        return Fault(sentence, loc, "not_allowed")
    file = index in ("file", "trace") and path.endswith(".profile")
    if file or (isinstance(index, int) and BY_PATH[path].kind != "pair"):
        sentence = f"{place}: {path} has no such entries; must be the key itself"
        return Fault(sentence, loc, "unknown_key")
    return None


def value_of(case_keys: Mapping[str, Any], name: str) -> Any:
    """Return the value of a varied key in a case; None where it has none."""
    path, index = split_key(name)
    value = case_keys.get(path, BY_PATH[path].default if path in BY_PATH else None)
    if index is None:
        return None if value is ... else value
    if isinstance(index, str):
        entries = (entries_of(value) or {}) if path in LAYERS else value
        return entries.get(index) if isinstance(entries, dict) else None
    return value[index] if isinstance(value, list | tuple) and len(value) > index else None


def varied_keys(
    base: Mapping[str, Any], parts: Sequence[tuple[str, int | str | None]], row: Sequence[Any]
) -> dict[str, Any]:
    """Return the dotted keys of a case: those of the base, with a row of values at its parts."""
    changed: dict[str, Any] = {}
    for (path, index), value in zip(parts, row, strict=True):
        if index is None:
            changed[path] = value
        elif isinstance(index, str):
            changed[whole_name(path, index)] = value
        else:
            before = changed.get(path, base.get(path))
            pair = list(before) if isinstance(before, list) and len(before) == 2 else [None, None]
            pair[index] = value
            changed[path] = pair
    return override(base, changed)


def is_whole(value: Any) -> bool:
    """Tell whether a value is a whole number, which true and false are not."""
    return isinstance(value, int) and not isinstance(value, bool)


def unnested(table: Mapping[str, Any], names: Set[str]) -> dict[str, Any]:
    """Return entries, tables of some names, by dotted key, whether written quoted or not."""
    flat: dict[str, Any] = {}
    for key, entry in table.items():
        if isinstance(entry, Mapping) and entry and not names & entry.keys():
            flat |= {f"{key}.{inner}": value for inner, value in unnested(entry, names).items()}
        else:
            flat[key] = entry
    return flat


# -- the table [vary] ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Variation:
    """One varied key, and its values or its range."""

    #: as in the study: a case key, or an entry of a pair, such as ``upper.r[1]``, a table or layers
    name: str
    #: "values", "linear" or "log"
    spacing: str
    #: raw values, or both ends of a range in the case's units
    values: tuple[Any, ...]
    #: number of values of a range in a grid
    count: int = 0

    def grid(self) -> list[Any]:
        """Return the values of a grid."""
        if self.spacing == "values":
            return list(self.values)
        space: Any = np.geomspace if self.spacing == "log" else np.linspace
        return self._whole(space(*self.values, self.count)).tolist()

    def at(self, shares: FloatArray) -> Column:
        """Return the values at shares from 0 to 1 of the range or the list, (cases,)."""
        if self.spacing == "values":
            return Column.chosen(self.values, (shares * len(self.values)).astype(np.int64))
        low, high = self.values
        log = self.spacing == "log"
        values = low * (high / low) ** shares if log else low + (high - low) * shares
        return Column.of(self._whole(values).tolist())

    def _whole(self, values: FloatArray) -> NDArray[Any]:
        """Return whole numbers where only these will do."""
        path, index = split_key(self.name)
        whole = index is None and BY_PATH[path].kind == "whole"
        return np.rint(values).astype(np.int64) if whole else values


def read_variations(
    name: str, vary: Mapping[str, Any], method: str, faults: list[str]
) -> list[Variation]:
    """Return the varied keys of a study, and add their faults."""
    entries = unnested(vary, {"values", "linear", "log", "count"})
    if method == "list" and vary:
        sentence = f'{name}: [vary]: must be absent where design.method = "list"'
        faults.append(Fault(sentence, "vary", "conflict"))
    elif method != "list" and not entries:
        sentence = f"{name}: [vary]: is missing or empty; must name one case key at least"
        faults.append(Fault(sentence, "vary", "missing"))
    variations = []
    for key, entry in entries.items():
        place = f'{name}: vary."{legible(key)}"'
        if fault := name_fault(place, key, f"vary.{key}"):
            faults.append(fault)
            continue
        try:
            variations.append(_variation(key, entry, method))
        except RejectedError as reason:
            because = f" ({reason})" if str(reason) else ""
            sentence = f"{place} = {shortened(entry)}: {_RULE}{because}"
            faults.append(Fault(sentence, f"vary.{key}", "not_allowed"))
    return variations


def _variation(key: str, entry: Any, method: str) -> Variation:
    """Return a varied key; RejectedError where its entry breaks the rule, perhaps with why."""
    table = dict(entry) if isinstance(entry, Mapping) else {}
    count = table.pop("count", None)
    spacing, values = table.popitem() if len(table) == 1 else ("", None)
    if spacing not in ("values", "linear", "log") or not isinstance(values, list) or not values:
        raise RejectedError
    in_grid = method == "grid" and spacing != "values"
    if not (is_whole(count) and 2 <= count <= MOST_CASES if in_grid else count is None):
        raise RejectedError
    if spacing == "values":
        return Variation(key, spacing, tuple(values))
    ends = [without_units(key, value) for value in values]
    if len(ends) != 2 or not all(map(is_finite, ends)) or not ends[0] < ends[1]:
        raise RejectedError
    if spacing == "log" and ends[0] <= 0:
        raise RejectedError
    return Variation(key, spacing, tuple(map(float, ends)), count or 0)
