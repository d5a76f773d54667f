"""Varied keys: what a study calls them, and the values that it gives them."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.files.keys import override
from ringwear_par.cases.files.suggestions import unknown_key
from ringwear_par.cases.layers import LAYERS, entries_of
from ringwear_par.cases.schema import BY_PATH, key_of, layer_entry
from ringwear_par.cases.tables import Key
from ringwear_par.cases.text import shortened, toml_value
from ringwear_par.cases.values import RejectedError, is_finite, is_number
from ringwear_par.errors import MOST_FAULTS, legible
from ringwear_par.studies.definition.schema import MOST_CASES

#: samples are not nearer to the ends of a range than this part of it, which may be open ones
_INSIDE = 1e-9


@dataclass(frozen=True, eq=False)
class Column:
    """The raw values of a varied key in all cases.

    Parameters
    ----------
    values : one a case, or those that there are.
    codes : (cases,) which of the values each case has, None: each its own.
    """

    values: FloatArray | tuple[Any, ...]
    codes: IntArray | None = None

    def __len__(self) -> int:
        return len(self.values if self.codes is None else self.codes)

    def __getitem__(self, case: int) -> Any:
        value = self.values[case if self.codes is None else self.codes[case]]
        return value.item() if isinstance(value, np.generic) else value

    def part(self, cases: slice | IntArray) -> "Column":
        """Return the column of some of the cases."""
        if self.codes is not None:
            codes = self.codes[cases]
            if len(codes) >= len(self.values):
                return Column(self.values, codes)
            there, codes = np.unique(codes, return_inverse=True)
            return Column(tuple(self.values[i] for i in there.tolist()), codes)
        if isinstance(self.values, tuple):
            taken = np.arange(len(self.values))[cases].tolist()
            return Column(tuple(self.values[i] for i in taken))
        return Column(self.values[cases])

    def mapped(self, function: Callable[[Any], Any]) -> "Column":
        """Return the column of what a function makes of each value."""
        return Column(tuple(map(function, self.there)), self.codes)

    def each(self, function: Callable[[Any], Any] | None = None) -> list[Any]:
        """Return the values of all cases, or what a function makes of each."""
        listed = self.there
        if function is not None:
            listed = list(map(function, listed))
        return listed if self.codes is None else [listed[i] for i in self.codes.tolist()]

    @property
    def there(self) -> list[Any]:
        """The values that there are."""
        return self.values.tolist() if isinstance(self.values, np.ndarray) else list(self.values)

    @cached_property
    def numbers(self) -> FloatArray | None:
        """(cases,) the values, where all are numbers."""
        whole = isinstance(self.values, np.ndarray)
        if not whole and not all(is_number(value) for value in self.values):
            return None
        values = np.asarray(self.values, dtype=np.float64)
        return values if self.codes is None else values[self.codes]

    @cached_property
    def kinds(self) -> IntArray:
        """(cases,) numbers, the same for the same value."""
        if self.codes is not None:
            return self.codes
        if isinstance(self.values, tuple):
            return np.arange(len(self.values))
        bits = np.ascontiguousarray(self.values, dtype=np.float64).view(np.int64)  # -0.0 is not 0.0
        return np.unique(bits, return_inverse=True)[1].astype(np.int64)


def column_of(values: list[Any]) -> Column:
    """Return the column of a list, one value a case."""
    if all(type(value) is float for value in values):
        return Column(np.array(values))
    known: dict[str, int] = {}  # by what is written: 0, 0.0 and -0.0 are three values
    codes = np.array([known.setdefault(toml_value(value), len(known)) for value in values])
    first = np.unique(codes, return_index=True)[1]
    return Column(tuple(values[i] for i in first.tolist()), codes)


@dataclass(frozen=True)
class Variation:
    """One varied key.

    Parameters
    ----------
    name : as in the study: a case key, or an entry of one that is a pair, such as ``upper.r[1]``,
        a table or a list of layers.
    path : the case key.
    index : which entry, None for the whole value.
    spacing : how values follow from ``values`` (the values, or both ends of a range).
    values : raw values.
    count : number of values of a range in a grid.
    """

    name: str
    path: str
    index: int | str | None
    spacing: Literal["values", "linear", "log"]
    values: tuple[Any, ...]
    count: int = 0

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
            return Column(self.values, (u * len(self.values)).astype(np.int64))
        low, high = self.values
        values = low * (high / low) ** u if self.spacing == "log" else low + (high - low) * u
        if not self.whole:
            return Column(values)
        there, codes = np.unique(np.rint(values), return_inverse=True)
        return Column(tuple(map(int, there.tolist())), codes.astype(np.int64))

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
    """Return what an entry of a table or of layers is called, as ``split_key`` takes it."""
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
    """Tell whether a varied key that is named as an entry is one of a pair, or a shape's size."""
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
    """Return the dotted keys of a case: those of the base with a row of values in their place.

    Parameters
    ----------
    parts : of ``split_key``, one a value of the row.
    """
    changed: dict[str, Any] = {}
    for (path, index), value in zip(parts, row, strict=True):
        if index is None:
            changed[path] = value
        elif isinstance(index, str):
            changed[whole_name(path, index)] = value
        else:
            there = changed.get(path, base.get(path))
            pair = list(there) if isinstance(there, list) and len(there) == 2 else [None, None]
            pair[index] = value
            changed[path] = pair
    return override(base, changed)


def is_whole(value: Any) -> bool:
    """Tell whether a value is a whole number, which true and false are not."""
    return isinstance(value, int) and not isinstance(value, bool)


def read_variations(
    name: str, vary: Mapping[str, Any], method: str, faults: list[str]
) -> list[Variation]:
    """Return the varied keys, and add what is wrong with them to the faults."""
    if method == "list":
        if vary:
            faults.append(f'{name}: [vary]: must be absent where design.method = "list"')
        return []
    entries = _unnested(vary)
    if not entries:
        faults.append(f"{name}: [vary]: is missing or empty; must name one case key at least")
    variations = []
    for key, entry in entries.items():
        path = path_of(key)
        said = f'{name}: vary."{legible(key)}"'
        if not is_known(key):
            near = len(faults) < MOST_FAULTS
            what = unknown_key(key if path in LAYERS else path) if near else "unknown key"
            faults.append(f"{said}: {what}")
        elif path == "title":
            faults.append(f"{said}: a title makes no other case; must be another key")
        elif not has_entry(key):
            faults.append(f"{said}: {path} has no entries; must be the key itself")
        else:
            found = _variation(said, key, entry, method, faults)
            if found is not None:
                variations.append(found)
    return variations


def _unnested(vary: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries by dotted key, whether written quoted or not."""
    flat: dict[str, Any] = {}
    for key, entry in vary.items():
        if isinstance(entry, dict) and not {"values", "linear", "log", "count"} & entry.keys():
            flat.update({f"{key}.{k}": v for k, v in _unnested(entry).items()})
        else:
            flat[key] = entry
    return flat


def _variation(said: str, key: str, entry: Any, method: str, faults: list[str]) -> Variation | None:
    path, index = split_key(key)
    if not isinstance(entry, dict) or len(entry.keys() & {"values", "linear", "log"}) != 1:
        shown = shortened(entry)
        if isinstance(entry, dict):
            shown = legible("{" + ", ".join(entry) + "}")
        faults.append(
            f"{said} = {shown}: must be {{ values = [...] }}, {{ linear = [low, high], count = n }}"
            " or { log = [low, high], count = n }"
        )
        return None
    (spacing,) = entry.keys() & {"values", "linear", "log"}
    values, count = entry[spacing], entry.get("count")
    unknown = entry.keys() - {spacing, "count"}
    if unknown:
        shown = legible(", ".join(sorted(unknown)))
        faults.append(f"{said}: {shown}: must be {spacing} and count only")
    told = "is missing" if count is None else f"= {shortened(count)}"
    if spacing == "values":
        if not isinstance(values, list) or not values:
            faults.append(f"{said}: values = {shortened(values)}: must be a list of values")
            return None
        if count is not None:
            faults.append(f"{said}: count {told}: must be absent beside values")
        return Variation(key, path, index, "values", tuple(values))
    shown = f"{said}: {spacing} = {shortened(values)}"
    try:
        if isinstance(values, list):
            entry = index if isinstance(index, str) and path not in LAYERS else None
            values = [own_key(key).without_units(value, entry) for value in values]
        numbers = isinstance(values, list) and len(values) == 2 and all(map(is_finite, values))
    except RejectedError as reason:
        faults.append(f"{shown}: must be two increasing numbers ({reason})")
        return None
    if not numbers or not values[0] < values[1]:
        faults.append(f"{shown}: must be two increasing numbers")
        return None
    if spacing == "log" and values[0] <= 0:
        faults.append(f"{shown}: must be two increasing numbers > 0")
        return None
    if method == "grid" and not (
        isinstance(count, int) and is_whole(count) and 2 <= count <= MOST_CASES
    ):
        faults.append(
            f"{said}: count {told}: must be a whole number from 2 to {MOST_CASES} in a grid"
        )
        return None
    if method != "grid" and count is not None:
        faults.append(
            f"{said}: count {told}: must be absent; design.count says how many "
            f'cases method = "{method}" draws'
        )
    made = Variation(
        key, path, index, "log" if spacing == "log" else "linear", tuple(map(float, values)),
        count or 0,
    )  # fmt: skip
    if (index is None or path in LAYERS) and (rule := _rule_broken(made, method)):
        faults.append(f"{shown}: all of it {rule}")
        return None
    return made


def _rule_broken(made: Variation, method: str) -> str:
    """Return what a key must be that has a range which reaches beyond that, "" if it does not."""
    key, inside = own_key(made.name), 0.0 if method == "grid" else _INSIDE
    try:
        for value in made.at(np.array([inside, 1.0 - inside])).each():
            key.read(value)
    except RejectedError:
        return key.rule
    return ""
