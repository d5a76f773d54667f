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
from ringwear_par.cases.schema import BY_PATH, base_unit, key_of, layer_entry
from ringwear_par.cases.tables import Key
from ringwear_par.cases.units import factor, has_unit, number_and_unit
from ringwear_par.cases.values import RejectedError, is_finite, is_number
from ringwear_par.errors import Fault, legible
from ringwear_par.files.text import shortened, toml_value

#: most cases of a design
MOST_CASES = 10**6
_FORMS = (
    "must be { values = [...] }, { linear = [low, high], count = n } or "
    "{ log = [low, high], count = n }"
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


def is_known(name: str) -> bool:
    """Tell whether there is such a key, or such an entry of layers."""
    return path_of(name) in BY_PATH if layer_entry(name) is None else key_of(name) is not None


def name_fault(place: str, name: str, loc: str) -> Fault | None:
    """Return why a key cannot vary, None where it can."""
    if not is_known(name):
        reason = unknown_key(name if path_of(name) in LAYERS else path_of(name))
        return Fault(f"{place}: {reason}", loc, "unknown_key")
    if name == "title":
        return Fault(
            f"{place}: a title makes no other case; must be another key", loc, "not_allowed"
        )
    path, index = split_key(name)
    is_pair = BY_PATH[path].kind == "pair"
    file = index in ("file", "trace") and path.endswith(".profile")
    if file or (isinstance(index, int) and not is_pair):
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
    #: raw values, or both ends of a range, without units
    values: tuple[Any, ...]
    #: number of values of a range in a grid
    count: int
    #: in which the study writes the values, "" for the case's
    unit: str

    def grid(self) -> list[Any]:
        """Return the values of a grid."""
        if self.spacing == "values":
            return list(self.values)
        low, high = self.values
        log = self.spacing == "log"
        space = np.geomspace(low, high, self.count) if log else np.linspace(low, high, self.count)
        return list(self._in_kind(space).tolist())

    def at(self, shares: FloatArray) -> Column:
        """Return the values at shares from 0 to 1 of the range or the list, (cases,)."""
        if self.spacing == "values":
            return Column.chosen(self.values, (shares * len(self.values)).astype(np.int64))
        low, high = self.values
        log = self.spacing == "log"
        values = low * (high / low) ** shares if log else low + (high - low) * shares
        values = self._in_kind(values)
        return Column.of(values if values.dtype.kind == "f" else values.tolist())

    def _in_kind(self, values: FloatArray) -> NDArray[Any]:
        """Return whole numbers where only these will do."""
        path, index = split_key(self.name)
        whole = index is None and BY_PATH[path].kind == "whole"
        return np.rint(values).astype(np.int64) if whole else values


def read_variations(
    name: str, vary: Mapping[str, Any], method: str, faults: list[str]
) -> list[Variation]:
    """Return the varied keys of a study, and add their faults."""
    if method == "list":
        if vary:
            sentence = f'{name}: [vary]: must be absent where design.method = "list"'
            faults.append(Fault(sentence, "vary", "conflict"))
        return []
    entries = unnested(vary, {"values", "linear", "log", "count"})
    if not entries:
        sentence = f"{name}: [vary]: is missing or empty; must name one case key at least"
        faults.append(Fault(sentence, "vary", "missing"))
    variations = []
    for key, entry in entries.items():
        place, table = f'{name}: vary."{legible(key)}"', key.rpartition(".")[0]
        if not is_known(key) and table in BY_PATH:  # a form that is unknown, read as a table
            words = legible(key.removeprefix(f"{table}."))
            sentence = f'{name}: vary."{table}": {words}: {_FORMS}'
            faults.append(Fault(sentence, f"vary.{table}", "not_allowed"))
        elif fault := name_fault(place, key, f"vary.{key}"):
            faults.append(fault)
        else:
            try:
                variations.append(_variation(key, entry, method))
            except RejectedError as reason:
                faults.append(Fault(f"{place}{reason}", f"vary.{key}", "not_allowed"))
    return variations


def _variation(key: str, entry: Any, method: str) -> Variation:
    """Return a varied key; RejectedError with what is wrong with its entry."""
    spacings = entry.keys() & {"values", "linear", "log"} if isinstance(entry, dict) else set()
    if len(spacings) != 1 or entry.keys() - spacings - {"count"}:
        words = ", ".join(entry) if isinstance(entry, dict) else shortened(entry)
        raise RejectedError(f" = {legible(words)}: {_FORMS}")
    (spacing,), count = spacings, entry.get("count")
    values, words = entry[spacing], f": {spacing} = {shortened(entry[spacing])}"
    if not isinstance(values, list) or not values:
        raise RejectedError(f"{words}: must be a list, not empty")
    if spacing == "values":
        if count is not None:
            raise RejectedError(f": count = {shortened(count)}: must be absent beside values")
        return Variation(key, spacing, tuple(values), 0, _written_unit(values, key))
    rule = f"must be two increasing numbers{' > 0' if spacing == 'log' else ''}"
    path, index = split_key(key)
    part = index if isinstance(index, str) and path not in LAYERS else None
    try:
        ends = [own_key(key).without_units(value, part) for value in values]
        numbers = len(ends) == 2 and all(map(is_finite, ends))
    except RejectedError as reason:
        raise RejectedError(f"{words}: {rule} ({reason})") from reason
    if not numbers or not ends[0] < ends[1] or (spacing == "log" and ends[0] <= 0):
        raise RejectedError(f"{words}: {rule}")
    if method == "grid" and not (is_whole(count) and 2 <= count <= MOST_CASES):
        state = "is missing" if count is None else f"= {shortened(count)}"
        raise RejectedError(
            f": count {state}: must be a whole number from 2 to {MOST_CASES} in a grid"
        )
    if method != "grid" and count is not None:
        raise RejectedError(
            f": count = {shortened(count)}: must be absent; design.count says how many cases "
            f'method = "{method}" draws'
        )
    return Variation(key, spacing, tuple(map(float, ends)), count or 0, _written_unit(values, key))


def _written_unit(values: Sequence[Any], key: str) -> str:
    """Return the unit in which the values of a varied key are written, "" for the case's."""
    unit = next((number_and_unit(value)[1] for value in values if has_unit(value)), "")
    try:
        return "" if not unit or factor(unit, base_unit(key)) == 1.0 else unit
    except RejectedError:  # which is reported where values are read
        return ""
