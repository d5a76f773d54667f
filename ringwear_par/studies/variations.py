"""Study files: the keys that vary, how they are named, and the designs that draw their values."""

import csv
import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.files.key_values import unknown_key
from ringwear_par.cases.files.keys import base_keys, in_full, kinds, source_tables
from ringwear_par.cases.layers import LAYERS, entries_of
from ringwear_par.cases.schema import BY_PATH, key_of, layer_entry, pair_entry
from ringwear_par.cases.tables import Key, TableReader, keys_of_table, name_unknown_keys
from ringwear_par.cases.values import (
    RejectedError,
    anything,
    is_finite,
    one_of,
    text,
    whole,
)
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.text import parse_value, read_text, shortened, toml_value

#: most cases of a design
MOST_CASES = 10**6
_RULE = (
    "must be { values = [...] }, { linear = [low, high] } or { log = [low, high] }, increasing "
    f"numbers, > 0 for log; a range has a count from 2 to {MOST_CASES} in a grid, and in no other "
    "design"
)
#: an entry of a table in the name of a varied key
_TABLE = re.compile(r"(wear\.(?:lower|upper)\.parameters|(?:lower|upper)\.profile)\.(.+)")

METHODS = ("grid", "sobol", "latin-hypercube", "random", "list")
_RANGE = anything("two increasing numbers, > 0 for log")

#: the keys of a study: one list that reading, messages and ``info --schema study`` follow
KEYS: tuple[Key, ...] = (
    Key("case", *text("the name of a case file, relative to this one; in Python a dict too"), "-",
        "base case, whose keys [vary] changes"),
    Key("vary.KEY.values", *anything("a list of values"), "KEY's",
        "list of values of a case key, or of an entry of a key, such as upper.r[1], "
        "upper.profile.crown, lower.layers[0].wear.k; each key has values, linear or log", None),
    Key("vary.KEY.linear", *_RANGE, "KEY's",
        "range [low, high], in equal steps (grid) or sampled uniformly", None),
    Key("vary.KEY.log", *_RANGE, "KEY's",
        "range [low, high], in equal ratios (grid) or sampled uniformly in the logarithm", None),
    Key("vary.KEY.count", *whole(2, MOST_CASES), "-",
        "number of values of a linear or log range (method = grid)", None),
    Key("design.method", *one_of(*METHODS), "-",
        "grid: all combinations; sobol, latin-hypercube, random: count samples; list: the rows of "
        "file, without [vary]", "grid"),
    Key("design.count", *whole(1, MOST_CASES), "-",
        "number of cases (method = sobol, latin-hypercube or random)", None),
    Key("design.seed", *whole(0, 10**18), "-",
        "seed of the random samples: the same seed gives the same cases", 0),
    Key("design.file", *text("the name of a CSV file, relative to this one"), "-",
        "table of cases: a line of case keys, then one line a case (method = list)", None),
)  # fmt: skip
DESIGN = keys_of_table(KEYS, "design")


# -- columns: the values of a key in all cases -----------------------------------------------------


def column_of(values: Sequence[Any]) -> NDArray[Any]:
    """Return raw values, (cases,): float64 where all are floats, else objects."""
    if all(type(value) is float for value in values):
        return np.array(values, dtype=float)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column


def mapped(column: NDArray[Any], function: Callable[[Any], Any]) -> list[Any]:
    """Return a function of the value of each case, called once for each object."""
    values = column.tolist()
    if column.dtype != object:
        return list(map(function, values))
    known = {key: function(value) for key, value in {id(v): v for v in values}.items()}
    return [known[id(value)] for value in values]


def cell(value: Any) -> str:
    """Return the text of a value in tables."""
    if isinstance(value, str):
        return value
    return "" if value is None else toml_value(value)


# -- names of keys and their entries ---------------------------------------------------------------


def split_key(name: str) -> tuple[str, int | str | None]:
    """Return the case key of a varied one, and which entry of a pair, table or layer it is.

    That of a layer is "[0].wear.k" of "lower.layers"; None for the whole value.
    """
    if (layer := layer_entry(name)) is not None:
        return layer[0], f"{layer[1]}.{layer[2]}"
    if (pair := pair_entry(name)) is not None:
        return pair
    match = _TABLE.fullmatch(name)
    return (match[1], match[2]) if match else (name, None)


def own_key(name: str) -> Key:
    """Return the key of a varied one: of a layer's entry its own, else that of the whole."""
    return key_of(name) or BY_PATH[split_key(name)[0]]


def without_units(name: str, value: Any) -> Any:
    """Return a raw value of a varied key in the case's units; RejectedError for a wrong unit."""
    path, entry = split_key(name)
    part = entry if isinstance(entry, str) and path not in LAYERS else None
    return own_key(name).without_units(value, part)


def name_fault(place: str, name: str, loc: str) -> Fault | None:
    """Return why a key cannot vary, None where it can."""
    path, index = split_key(name)
    key = key_of(name) or (None if path in LAYERS else BY_PATH.get(path))
    if key is None:
        reason = unknown_key(name if path in LAYERS else path)
    elif name == "title":
        reason = "a title makes no other case; must be another key"
    elif index in ("file", "trace") or (isinstance(index, int) and key.kind != "pair"):
        reason = f"{path} has no such entries; must be the key itself"
    else:
        return None
    return Fault(f"{place}: {reason}", loc, "unknown_key")


def value_of(case_keys: Mapping[str, Any], name: str) -> Any:
    """Return the value of a varied key in a case; None where it has none."""
    path, index = split_key(name)
    value = case_keys.get(path, BY_PATH[path].default if path in BY_PATH else None)
    if index is None:
        return None if value is ... else value
    if path in LAYERS:
        value = entries_of(value)
    elif isinstance(value, list | tuple):
        value = dict(enumerate(value))
    return value.get(index) if isinstance(value, dict) else None


def unnested(table: Mapping[str, Any], names: Set[str]) -> dict[str, Any]:
    """Return entries, tables of some names, by dotted key, whether written quoted or not."""
    flat: dict[str, Any] = {}
    for key, entry in table.items():
        if isinstance(entry, Mapping) and entry and not names & entry.keys():
            flat |= {f"{key}.{inner}": value for inner, value in unnested(entry, names).items()}
        else:
            flat[key] = entry
    return flat


# -- the table [vary]: values of a key, or its range ----------------------------------------------


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
    count: int

    def column(self, shares: FloatArray | None = None) -> NDArray[Any]:
        """Return the values of a grid, or those at shares (cases,) from 0 to 1 of range or list."""
        if self.spacing == "values":
            values = column_of(self.values)
            return values if shares is None else values[(shares * len(values)).astype(int)]
        low, high = self.values
        if shares is None:
            space: Any = np.geomspace if self.spacing == "log" else np.linspace
            values = space(low, high, self.count)
        elif self.spacing == "log":
            values = low * (high / low) ** shares
        else:
            values = low + (high - low) * shares
        key = key_of(self.name)
        if key is not None and key.kind == "whole":
            return column_of(np.rint(values).astype(int).tolist())
        return values


def _read_variations(
    name: str, vary: Mapping[str, Any], method: str, folder: Path, faults: list[str]
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
            variations.append(_variation(key, entry, method == "grid", folder))
        except RejectedError as reason:
            because = f" ({reason})" if str(reason) else ""
            sentence = f"{place} = {shortened(entry)}: {_RULE}{because}"
            faults.append(Fault(sentence, f"vary.{key}", "not_allowed"))
    return variations


def _variation(key: str, entry: Any, in_grid: bool, folder: Path) -> Variation:
    """Return a varied key; RejectedError where its entry breaks the rule, perhaps with why."""
    match entry:
        case {"values": [_, *_] as values, **more} if not more:
            complete = tuple(_in_full(key, folder, value) for value in values)
            return Variation(key, "values", complete, 0)
        case {"linear": [_, _] as ends, **more} | {"log": [_, _] as ends, **more}:
            low, high = (without_units(key, end) for end in ends)
            is_log, count = "log" in entry, entry.get("count")
            good_count = isinstance(count, int) and 2 <= count <= MOST_CASES
            counted = good_count if in_grid else count is None
            finite = is_finite(low) and is_finite(high) and low < high
            if finite and (low > 0 or not is_log) and counted and more.keys() <= {"count"}:
                spacing = "log" if is_log else "linear"
                return Variation(key, spacing, (float(low), float(high)), count or 0)
    raise RejectedError


def _in_full(name: str, folder: Path, value: Any) -> Any:
    """Return a raw value, names of files in it in full: they are relative to the study."""
    (complete,) = in_full({name: value}, folder).values()
    return complete


# -- designs ---------------------------------------------------------------------------------------


def read_draft(source: Path | str | Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a ``Study``; refuse all faults but those of single cases."""
    name, folder, tables, text = source_tables(source, "study")
    if kinds(tables) == {"case"}:
        raise InputError(f"{name}: is a case, not a study; ringwear run computes it")
    faults: list[str] = []
    name_unknown_keys(name, tables, ["case", "vary", "design"], faults)
    base = base_keys(name, folder, tables, isinstance(source, Mapping), faults) or {}
    vary, table = tables.get("vary", {}), tables.get("design", {})
    for key, value in (("vary", vary), ("design", table)):
        if not isinstance(value, dict):
            sentence = f"{name}: {key} = {shortened(value)}: must be a table, [{key}]"
            raise InputError(*faults, Fault(sentence, key, "not_allowed"))
    design = _read_design(name, table, faults)
    variations = _read_variations(name, vary, design["method"], folder, faults)
    if faults:
        raise InputError(*faults)
    if design["method"] == "list":
        columns = _listed(folder, design["file"])
    else:
        columns = _drawn(name, variations, **design)
    for key, column in columns.items():  # what sweeps do not store, or must store alike of all
        differ = key == "output.profiles" and len(set(map(str, column))) > 1
        if differ or key.startswith(("stress.", "output.boundary")):
            sentence = f"{name}: {key}: must not vary; must be the same in all cases"
            raise InputError(Fault(sentence, key, "not_allowed"))
    base.pop("output.boundary", None)
    ranges = {v.name: (v.spacing, *v.values) for v in variations if v.spacing != "values"}
    return {
        "name": name, "text": text, "method": design["method"], "base": base, "columns": columns,
        "ranges": ranges,
    }  # fmt: skip


def _read_design(name: str, table: Mapping[str, Any], faults: list[str]) -> dict[str, Any]:
    """Return the values of the table [design], and add its faults; refuse a wrong method."""
    before, reader = len(faults), TableReader(f"{name}: [design]", table, faults, DESIGN)
    method = reader.read("method")
    if len(faults) > before:
        raise InputError(*faults)
    needed = {"grid": (), "list": ("file",)}.get(method, ("count",))
    design = {"method": method, **{key: reader.read(key) for key in needed}}
    for key in needed:
        if key not in reader:
            reader.wrong(key, DESIGN[key].rule)
    if "count" in needed:
        design["seed"] = reader.read("seed")
    reader.finish(f'unknown key of method = "{method}"')
    return design


def _drawn(
    name: str, variations: Sequence[Variation], method: str, count: int = 0, seed: int = 0
) -> dict[str, NDArray[Any]]:
    """Return the columns of a grid, whose last key varies fastest, or of a sampled design."""
    if method == "grid":
        values = [variation.column() for variation in variations]
        sizes = [len(each) for each in values]
        if (total := math.prod(sizes)) > MOST_CASES:
            raise InputError(f"{name}: the grid has {total} cases; must be at most {MOST_CASES}")
        places = np.unravel_index(np.arange(total), sizes)
        return {v.name: of[at] for v, of, at in zip(variations, values, places, strict=True)}
    if method == "random":
        points = np.random.default_rng(seed).random((count, len(variations)))
    else:
        from scipy.stats import qmc  # slow to import

        sampler = qmc.Sobol if method == "sobol" else qmc.LatinHypercube
        with warnings.catch_warnings():  # of numbers of points that are no powers of two
            warnings.simplefilter("ignore", UserWarning)
            points = sampler(len(variations), seed=seed).random(count)
    return {v.name: v.column(shares) for v, shares in zip(variations, points.T, strict=True)}


def _listed(folder: Path, file: str) -> dict[str, NDArray[Any]]:
    """Return the columns of a CSV file: a line of case keys, and one line for each case."""
    table = folder / file
    names, *lines = [line for line in csv.reader(read_text(table).splitlines()) if line] or [[]]
    names = [word.strip() for word in names]
    faults: list[str] = [
        f"{table}: line {number}: has {len(line)} values; must have {len(names)}, as the first line"
        for number, line in enumerate(lines, start=2)
        if len(line) != len(names)
    ]
    if not lines or len({*names}) < len(names):
        faults.append(f"{table}: must be a line of case keys, each once, and then one line a case")
    faults += filter(None, (name_fault(f"{table}: column {legible(n)}", n, n) for n in names))
    if faults:
        raise InputError(*faults)
    columns = {}
    for name, words in zip(names, zip(*lines, strict=True), strict=True):
        try:
            columns[name] = np.array(words, dtype=float)
        except ValueError:  # anything that TOML knows, and texts
            known = {word: _in_full(name, folder, parse_value(word.strip())) for word in {*words}}
            columns[name] = column_of([known[word] for word in words])
    return columns
