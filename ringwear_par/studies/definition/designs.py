"""Study files: a base case, the keys that vary, and the design that draws rows of values."""

import csv
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.key_values import unknown_key
from ringwear_par.cases.files.keys import base_keys, in_full, kinds, source_tables
from ringwear_par.cases.layers import LAYERS
from ringwear_par.cases.tables import TableReader
from ringwear_par.errors import MOST_FAULTS, Code, Fault, InputError, legible
from ringwear_par.files.text import (
    parse_value,
    read_text,
    shortened,
)
from ringwear_par.studies.definition.samples import MOST_AXES, latin_hypercube, sobol
from ringwear_par.studies.definition.schema import DESIGN, MOST_CASES
from ringwear_par.studies.definition.variations import (
    Column,
    Variation,
    has_entry,
    is_known,
    path_of,
    read_variations,
    split_key,
    whole_name,
)

SAMPLED = ("sobol", "latin-hypercube", "random")
#: faults of a table that are named one by one
_MOST_NAMED = 5
#: numbers as TOML has them, without its rarer spellings
_WHOLE = re.compile(r"-?(0|[1-9][0-9]{0,17})", re.ASCII)
_DECIMAL = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]+)?(e[-+]?[0-9]+)?", re.ASCII)


@dataclass(frozen=True)
class Draft:
    """A study whose cases have not been looked at yet."""

    #: what messages call it
    name: str
    #: the TOML text of the study
    text: str
    #: of the design
    method: str
    #: dotted keys and raw values of the base case
    base: Mapping[str, Any]
    #: the varied keys, and their raw values in all cases
    names: tuple[str, ...]
    columns: tuple[Column, ...]


def read_draft(source: Path | str | Mapping[str, Any]) -> Draft:
    """Read a study: its name or its tables; refuse faults but for single cases. Not collective."""
    if isinstance(source, Mapping) and isinstance(source.get("case"), Case):
        raise InputError(
            "study: case is a Case; must be the name of a case file, or its tables as a dict"
        )
    name, folder, tables, text = source_tables(source, "study")
    if kinds(tables) == {"case"}:
        raise InputError(f"{name}: is a case, not a study; ringwear run computes it")
    no = "unknown key; must be one of case, vary, design"
    faults: list[str] = [
        Fault(f"{name}: {legible(key)}: {no}", key, "unknown_key")
        for key in tables
        if key not in ("case", "vary", "design")
    ]
    base = base_keys(name, folder, tables, isinstance(source, Mapping), faults) or {}
    vary, design = tables.get("vary", {}), tables.get("design", {})
    for key, table in (("vary", vary), ("design", design)):
        if not isinstance(table, dict):
            sentence = f"{name}: {key} = {shortened(table)}: must be a table, [{key}]"
            raise InputError(*faults, Fault(sentence, key, "not_allowed"))
    design = read_design(name, design, faults)
    method = design["method"]
    variations = read_variations(name, vary, method, faults)
    if faults:
        raise InputError(*faults)
    if method == "list":
        names, columns = listed(folder / design["file"])
    else:
        names = tuple(v.name for v in variations)
        columns = drawn(name, variations, method, design)
    values = dict(zip(names, (column.distinct for column in columns), strict=True))
    boundary = values.get("output.boundary", [base.get("output.boundary", "none")])
    if unknown := [value for value in boundary if value != "none"]:
        sentence = (
            f"{name}: output.boundary = {shortened(unknown[0])}: fields on whole boundaries are "
            'stored by ringwear run only; must be absent from the case, or "output.boundary" = '
            '{ values = ["none"] } in [vary]'
        )
        raise InputError(Fault(sentence, "output.boundary", "conflict"))
    if varied := [key for key in names if key.startswith("stress.")]:
        sentence = f"{varied[0]}: must not vary; what [stress] asks for is that of the base case"
        raise InputError(Fault(f"{name}: {sentence}", varied[0], "not_allowed"))
    complete = tuple(  # files are relative to the study
        column.mapped(partial(_in_full, key, folder)) if column.numbers is None else column
        for key, column in zip(names, columns, strict=True)
    )
    return Draft(name, text, method, base, names, complete)


def _in_full(name: str, folder: Path, value: Any) -> Any:
    """Return a raw value, names of files in it in full."""
    path, entry = split_key(name)
    whole = whole_name(path, entry) if isinstance(entry, str) else path
    (complete,) = in_full({whole: value}, folder).values()
    return complete


def read_design(name: str, table: Mapping[str, Any], faults: list[str]) -> dict[str, Any]:
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


def drawn(
    name: str, variations: Sequence[Variation], method: str, design: Mapping[str, Any]
) -> list[Column]:
    """Return the columns of a grid or sampled design without faults; refuse too many cases."""
    if method == "grid":
        sizes = [v.count or len(v.values) for v in variations]
        count = math.prod(sizes)
        if count > MOST_CASES:
            raise InputError(f"{name}: the grid has {count} cases; must be at most {MOST_CASES}")
        numbers = np.arange(count)
        columns = []
        for i, variation in enumerate(variations):  # the last one varies fastest
            codes = numbers // math.prod(sizes[i + 1 :]) % sizes[i]
            columns.append(Column.chosen(variation.grid(), codes))
        return columns
    count, seed, d = design["count"], design["seed"], len(variations)
    if method == "sobol":
        if d > MOST_AXES:
            raise InputError(f"{name}: [vary] has {d} keys; must be at most {MOST_AXES}")
        points = sobol(count, d, seed)
    elif method == "latin-hypercube":
        points = latin_hypercube(count, d, seed)
    else:
        points = np.random.default_rng(seed).random((count, d))
    return [v.at(u) for v, u in zip(variations, points.T, strict=True)]


def listed(table: Path) -> tuple[tuple[str, ...], list[Column]]:
    """Return the varied keys and columns of a CSV file: a line of keys, and one line a case.

    InputError has its first faults, one sentence each.
    """
    try:
        lines = [line for line in csv.reader(read_text(table).splitlines()) if line]
    except csv.Error as error:
        raise InputError(f"{table}: is not a table of comma-separated values: {error}") from error
    if len(lines) < 2:
        raise InputError(f"{table}: has no cases; must be a line of case keys and one line a case")
    names = tuple(cell.strip() for cell in lines[0])
    if any(";" in name for name in names):
        raise InputError(f"{table}: columns must be separated by commas, not ;")
    faults: list[str] = []
    times = Counter(names)
    for name in names:
        if not is_known(name) or name == "title":
            path = path_of(name)
            near = len(faults) < MOST_FAULTS
            reason = unknown_key(name if path in LAYERS else path) if near else "unknown key"
            code: Code = "not_allowed" if name == "title" else "unknown_key"
            faults.append(Fault(f"{table}: column {legible(name)}: {reason}", name, code))
        elif not has_entry(name):
            sentence = f"{table}: column {name}: has no entries; must be the key itself"
            faults.append(Fault(sentence, name, "unknown_key"))
        elif times[name] > 1:
            sentence = f"{table}: column {name}: is there more than once"
            faults.append(Fault(sentence, name, "conflict"))
    values: list[list[Any]] = [[] for _ in names]
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(names):
            faults.append(
                f"{table}: line {number}: has {len(line)} values; must have {len(names)}, as the "
                "first line"
            )
        for column, cell in zip(values, line, strict=False):
            column.append(_parsed(cell.strip()))
    if faults:
        raise InputError(*faults[:_MOST_NAMED])
    return names, [Column.of(column) for column in values]


def _parsed(cell: str) -> Any:
    """Return the value of a cell; most are plain numbers, a tenth of the time of any TOML."""
    if _WHOLE.fullmatch(cell):
        return int(cell)
    return float(cell) if _DECIMAL.fullmatch(cell) else parse_value(cell)
