"""Study files: a base case, the keys that vary, and the design that draws their values."""

import csv
import math
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.files.keys import base_keys, in_full, kinds, source_tables
from ringwear_par.cases.tables import Key, TableReader, keys_of_table
from ringwear_par.cases.values import anything, one_of, text, whole
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.text import parse_value, read_text, shortened
from ringwear_par.studies.variations import (
    MOST_CASES,
    Column,
    Variation,
    name_fault,
    read_variations,
    split_key,
    whole_name,
)

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


def read_draft(
    source: Path | str | Mapping[str, Any],
) -> tuple[str, str, str, dict[str, Any], tuple[str, ...], tuple[Column, ...]]:
    """Return the fields of a ``Study``; refuse all faults but those of single cases."""
    name, folder, tables, text = source_tables(source, "study")
    if kinds(tables) == {"case"}:
        raise InputError(f"{name}: is a case, not a study; ringwear run computes it")
    no = "unknown key; must be one of case, vary, design"
    faults: list[str] = [
        Fault(f"{name}: {legible(key)}: {no}", key, "unknown_key")
        for key in tables.keys() - {"case", "vary", "design"}
    ]
    base = base_keys(name, folder, tables, isinstance(source, Mapping), faults) or {}
    vary, design = tables.get("vary", {}), tables.get("design", {})
    for key, table in (("vary", vary), ("design", design)):
        if not isinstance(table, dict):
            sentence = f"{name}: {key} = {shortened(table)}: must be a table, [{key}]"
            raise InputError(*faults, Fault(sentence, key, "not_allowed"))
    design = read_design(name, design, faults)
    variations = read_variations(name, vary, design["method"], faults)
    if faults:
        raise InputError(*faults)
    if design["method"] == "list":
        columns = listed(folder / design["file"])
    else:
        columns = drawn(name, variations, **design)
    boundary = columns.get("output.boundary", Column.of([base.get("output.boundary", "none")]))
    if unknown := [value for value in boundary.distinct if value != "none"]:
        sentence = (
            f"{name}: output.boundary = {shortened(unknown[0])}: must be none in a study, if need "
            'be by "output.boundary" = { values = ["none"] } in [vary]; ringwear run stores it'
        )
        raise InputError(Fault(sentence, "output.boundary", "conflict"))
    if varied := [key for key in columns if key.startswith("stress.")]:
        sentence = f"{name}: {varied[0]}: must not vary; keys of [stress] are of the base case"
        raise InputError(Fault(sentence, varied[0], "not_allowed"))
    complete = tuple(  # files are relative to the study
        column.mapped(partial(_in_full, key, folder)) if column.numbers is None else column
        for key, column in columns.items()
    )
    return name, text, design["method"], base, tuple(columns), complete


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
    name: str, variations: Sequence[Variation], method: str, count: int = 0, seed: int = 0
) -> dict[str, Column]:
    """Return the columns of a grid, whose last key varies fastest, or of a sampled design."""
    keys = [variation.name for variation in variations]
    if method == "grid":
        values = [variation.grid() for variation in variations]
        sizes = [len(each) for each in values]
        if math.prod(sizes) > MOST_CASES:
            raise InputError(
                f"{name}: the grid has {math.prod(sizes)} cases; must be at most {MOST_CASES}"
            )
        codes = np.unravel_index(np.arange(math.prod(sizes)), sizes)
        return dict(zip(keys, map(Column.chosen, values, codes), strict=True))
    shape = count, len(keys)
    if method == "random":
        points = np.random.default_rng(seed).random(shape)
    else:
        from scipy.stats import qmc  # slow to import

        sampler = qmc.Sobol if method == "sobol" else qmc.LatinHypercube
        with warnings.catch_warnings():  # of numbers of points that are no powers of two
            warnings.simplefilter("ignore", UserWarning)
            points = sampler(len(keys), seed=seed).random(count)
    return {v.name: v.at(shares) for v, shares in zip(variations, points.T, strict=True)}


def listed(table: Path) -> dict[str, Column]:
    """Return the columns of a CSV file: a line of case keys, and one line for each case."""
    lines = [line for line in csv.reader(read_text(table).splitlines()) if line]
    names = [cell.strip() for cell in lines[0]] if lines else []
    faults: list[str] = [
        f"{table}: line {number}: has {len(line)} values; must have {len(names)}, as the first line"
        for number, line in enumerate(lines[1:], start=2)
        if len(line) != len(names)
    ]
    if len(lines) < 2 or len({*names}) < len(names):
        faults.append(f"{table}: must be a line of case keys, each once, and then one line a case")
    faults += filter(None, (name_fault(f"{table}: column {legible(n)}", n, n) for n in names))
    if faults:
        raise InputError(*faults)
    return dict(zip(names, map(_parsed, zip(*lines[1:], strict=True)), strict=True))


def _parsed(cells: Sequence[str]) -> Column:
    """Return the values of a column: numbers, or anything that TOML knows, and texts."""
    try:
        return Column.of(np.array(cells, dtype=float))
    except ValueError:
        return Column.of([parse_value(cell.strip()) for cell in cells])
