"""Varied keys: what a study calls them, and the values that it gives them."""

import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

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
from ringwear_par.errors import MOST_FAULTS, Fault, legible
from ringwear_par.files.text import shortened, toml_value
from ringwear_par.studies.definition.schema import MOST_CASES

_FORMS = (
    "must be { values = [...] }, { linear = [low, high], count = n } or "
    "{ log = [low, high], count = n }"
)
#: share of a range by which samples keep off its ends, which may be open
_INSIDE = 1e-9


@dataclass(frozen=True, eq=False)
class Column:
    """The raw values of a varied key in all cases."""

    #: the distinct ones, float64 where all are floats, else of objects
    values: NDArray[Any]
    #: (cases,) which of the values each case has
    codes: NDArray[np.int32]

    @classmethod
    def of(cls, values: Sequence[Any] | FloatArray) -> "Column":
        """Return the column of one value a case; -0.0 and 0.0 are two, and so are 0 and 0.0."""
        if isinstance(values, np.ndarray) or all(type(value) is float for value in values):
            bits = np.array(values, dtype=np.float64).view(np.int64)
            distinct, codes = np.unique(bits, return_inverse=True)
            return cls(distinct.view(np.float64), codes.astype(np.int32))
        known: dict[str, int] = {}  # by their texts
        numbers = [known.setdefault(toml_value(value), len(known)) for value in values]
        codes = np.array(numbers, dtype=np.int32)
        first = np.unique(codes, return_index=True)[1].tolist()
        return cls(_objects([values[i] for i in first]), codes)

    @classmethod
    def chosen(cls, values: Sequence[Any], codes: IntArray) -> "Column":
        """Return the column of some values, by number."""
        return cls(_objects(values), codes.astype(np.int32))

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, case: int) -> Any:
        value = self.values[self.codes[case]]
        return value.item() if isinstance(value, np.generic) else value

    def part(self, cases: slice | IntArray) -> "Column":
        """Return the column of some of the cases, of few of them without the other values."""
        chosen = self.codes[cases]
        if len(chosen) >= len(self.values):
            return Column(self.values, chosen)
        used, codes = np.unique(chosen, return_inverse=True)
        return Column(self.values[used], codes.astype(np.int32))

    def mapped(self, function: Callable[[Any], Any]) -> "Column":
        """Return the column of a function of each value."""
        return Column(_objects(list(map(function, self.distinct))), self.codes)

    def by_case(self, function: Callable[[Any], Any] | None = None) -> list[Any]:
        """Return the value of each case, or a function of it."""
        values = self.distinct if function is None else list(map(function, self.distinct))
        return [values[code] for code in self.codes.tolist()]

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


def _objects(values: Sequence[Any]) -> NDArray[Any]:
    """Return values as an array, lists among them as they are."""
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array


@dataclass(frozen=True)
class Variation:
    """One varied key."""

    #: as in the study: a case key, or an entry of one that is a pair, such as ``upper.r[1]``, a
    #: table or a list of layers
    name: str
    #: the case key
    path: str
    #: which entry, None for the whole value
    index: int | str | None
    #: how values follow from ``values`` (the values, or both ends of a range)
    spacing: Literal["values", "linear", "log"]
    #: raw values
    values: tuple[Any, ...]
    #: number of values of a range in a grid
    count: int = 0
    #: in which the study writes the values, "" for the case's
    unit: str = ""

    @property
    def whole(self) -> bool:
        """Whether only whole numbers will do."""
        return self.index is None and BY_PATH[self.path].kind == "whole"

    def grid(self) -> list[Any]:
        """Return the values of a grid."""
        if self.spacing == "values":
            return list(self.values)
        low, high = self.values
        space = np.geomspace if self.spacing == "log" else np.linspace
        return [self._rounded(float(v)) for v in space(low, high, self.count)]

    def at(self, u: FloatArray) -> Column:
        """Return the values at points u of the unit interval, (cases,)."""
        if self.spacing == "values":
            return Column.chosen(self.values, (u * len(self.values)).astype(np.int64))
        low, high = self.values
        values = low * (high / low) ** u if self.spacing == "log" else low + (high - low) * u
        if not self.whole:  # hardly any are alike
            return Column(values, np.arange(len(values), dtype=np.int32))
        distinct, codes = np.unique(np.rint(values), return_inverse=True)
        return Column.chosen(list(map(int, distinct.tolist())), codes.astype(np.int64))

    def _rounded(self, value: float) -> float | int:
        return round(value) if self.whole else value


def split_key(name: str) -> tuple[str, int | str | None]:
    """Return the case key of a varied one, and which entry of a pair, table or layer it is.

    That of a layer is "[0].wear.k" of "lower.layers".
    """
    layer = layer_entry(name)
    if layer is not None:
        return layer[0], f"{layer[1]}.{layer[2]}"
    match = re.fullmatch(r"(.+)\[([01])\]", name)
    if match:
        return match[1], int(match[2])
    match = re.fullmatch(
        r"(wear\.(?:lower|upper)\.parameters|(?:lower|upper)\.profile)\.(.+)", name
    )
    return (match[1], match[2]) if match else (name, None)


def whole_name(path: str, entry: str) -> str:
    """Return the name of an entry of a table or of layers, as ``split_key`` takes it."""
    return f"{path}{entry}" if path in LAYERS else f"{path}.{entry}"


def own_key(name: str) -> Key:
    """Return the key of a varied one: of a layer's entry its own, else that of the whole."""
    return key_of(name) or BY_PATH[path_of(name)]


def path_of(name: str) -> str:
    """Return the case key of a varied one, which may be an entry of it."""
    return split_key(name)[0]


def is_known(name: str) -> bool:
    """Tell whether there is such a key, or such an entry of layers."""
    return path_of(name) in BY_PATH if layer_entry(name) is None else key_of(name) is not None


def has_entry(name: str) -> bool:
    """Tell whether a varied key that names an entry is one of a pair, or of a shape's size."""
    path, index = split_key(name)
    if index in ("file", "trace") and path.endswith(".profile"):
        return False
    return not isinstance(index, int) or BY_PATH[path].kind == "pair"


def value_of(case_keys: Mapping[str, Any], name: str) -> Any:
    """Return the value of a varied key in a case; None where it has none."""
    path, index = split_key(name)
    value = case_keys.get(path, BY_PATH[path].default if path in BY_PATH else None)
    if index is None:
        return None if value is ... else value
    if isinstance(index, str):
        if path in LAYERS:
            return (entries_of(value) or {}).get(index)
        return value.get(index) if isinstance(value, dict) else None
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


def read_variations(
    name: str, vary: Mapping[str, Any], method: str, faults: list[str]
) -> list[Variation]:
    """Return the varied keys, and add their faults."""
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
        path = path_of(key)
        place = f'{name}: vary."{legible(key)}"'
        table, _, form = key.rpartition(".")
        if not is_known(key) and table in BY_PATH:
            sentence = f'{name}: vary."{table}": {legible(form)}: {_FORMS}'
            faults.append(Fault(sentence, f"vary.{table}", "not_allowed"))
        elif not is_known(key):
            near = len(faults) < MOST_FAULTS
            reason = unknown_key(key if path in LAYERS else path) if near else "unknown key"
            faults.append(Fault(f"{place}: {reason}", f"vary.{key}", "unknown_key"))
        elif path == "title":
            sentence = f"{place}: a title makes no other case; must be another key"
            faults.append(Fault(sentence, f"vary.{key}", "not_allowed"))
        elif not has_entry(key):
            sentence = f"{place}: {path} has no entries; must be the key itself"
            faults.append(Fault(sentence, f"vary.{key}", "unknown_key"))
        else:
            before = len(faults)
            variation = _variation(place, key, entry, method, faults)
            faults[before:] = [Fault(f, f"vary.{key}", "not_allowed") for f in faults[before:]]
            if variation is not None:
                variations.append(replace(variation, unit=_written_unit(entry, key)))
    return variations


def _written_unit(entry: Mapping[str, Any], key: str) -> str:
    """Return the unit in which the values of a varied key are written, "" for the case's."""
    values = next(entry[name] for name in ("values", "linear", "log") if name in entry)
    unit = next((number_and_unit(value)[1] for value in values if has_unit(value)), "")
    try:
        return "" if not unit or factor(unit, base_unit(key)) == 1.0 else unit
    except RejectedError:  # which is reported where values are read
        return ""


def unnested(table: Mapping[str, Any], names: Set[str]) -> dict[str, Any]:
    """Return entries, tables of some names, by dotted key, whether written quoted or not."""
    flat: dict[str, Any] = {}
    for key, entry in table.items():
        if isinstance(entry, Mapping) and entry and not names & entry.keys():
            flat |= {f"{key}.{inner}": value for inner, value in unnested(entry, names).items()}
        else:
            flat[key] = entry
    return flat


def _variation(
    place: str, key: str, entry: Any, method: str, faults: list[str]
) -> Variation | None:
    """Return a varied key, or add its faults."""
    path, index = split_key(key)
    if not isinstance(entry, dict) or len(entry.keys() & {"values", "linear", "log"}) != 1:
        words = shortened(entry)
        if isinstance(entry, dict):
            words = legible("{" + ", ".join(entry) + "}")
        faults.append(f"{place} = {words}: {_FORMS}")
        return None
    (spacing,) = entry.keys() & {"values", "linear", "log"}
    values, count = entry[spacing], entry.get("count")
    unknown = entry.keys() - {spacing, "count"}
    if unknown:
        words = legible(", ".join(sorted(unknown)))
        faults.append(f"{place}: {words}: must be {spacing} and count only")
    count_words = "is missing" if count is None else f"= {shortened(count)}"
    if spacing == "values":
        if not isinstance(values, list) or not values:
            rule = "must not be empty" if values == [] else "must be a list of values"
            faults.append(f"{place}: values = {shortened(values)}: {rule}")
            return None
        if count is not None:
            faults.append(f"{place}: count {count_words}: must be absent beside values")
        return Variation(key, path, index, "values", tuple(values))
    range_words = f"{place}: {spacing} = {shortened(values)}"
    try:
        if isinstance(values, list):
            entry = index if isinstance(index, str) and path not in LAYERS else None
            values = [own_key(key).without_units(value, entry) for value in values]
        numbers = isinstance(values, list) and len(values) == 2 and all(map(is_finite, values))
    except RejectedError as reason:
        faults.append(f"{range_words}: must be two increasing numbers ({reason})")
        return None
    if not numbers or not values[0] < values[1]:
        faults.append(f"{range_words}: must be two increasing numbers")
        return None
    if spacing == "log" and values[0] <= 0:
        faults.append(f"{range_words}: must be two increasing numbers > 0")
        return None
    if method == "grid" and not (
        isinstance(count, int) and is_whole(count) and 2 <= count <= MOST_CASES
    ):
        faults.append(
            f"{place}: count {count_words}: must be a whole number from 2 to {MOST_CASES} in a grid"
        )
        return None
    if method != "grid" and count is not None:
        faults.append(
            f"{place}: count {count_words}: must be absent; design.count says how many "
            f'cases method = "{method}" draws'
        )
    variation = Variation(
        key, path, index, "log" if spacing == "log" else "linear", tuple(map(float, values)),
        count or 0,
    )  # fmt: skip
    if (index is None or path in LAYERS) and (rule := _rule_broken(variation, method)):
        faults.append(f"{range_words}: all of it {rule}")
        return None
    return variation


def _rule_broken(variation: Variation, method: str) -> str:
    """Return the rule of a key that its range breaks, "" for none."""
    key, inside = own_key(variation.name), 0.0 if method == "grid" else _INSIDE
    try:
        for value in variation.at(np.array([inside, 1.0 - inside])).by_case():
            key.read(value)
    except RejectedError:
        return key.rule
    return ""
