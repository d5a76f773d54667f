"""Designs: the rows of a study, drawn from its varied keys or listed in a table."""

import csv
import itertools
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.case import nearest_key
from ringwear_par.cases.schema import BY_PATH, toml_value
from ringwear_par.errors import InputError
from ringwear_par.studies.variations import Variation, has_entry, is_whole, path_of

METHODS = ("grid", "sobol", "latin-hypercube", "random", "list")
SAMPLED = ("sobol", "latin-hypercube", "random")
_MOST_CASES = 10**7
#: faults of a table told one by one
_FAULTS_TOLD = 5


def read_text(path: Path) -> str:
    """Return what a file says.

    Raises
    ------
    InputError : it cannot be read, or is no text in UTF-8.
    """
    try:
        return path.readread_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file in UTF-8") from error


def design_faults(name: str, design: Mapping[str, Any], method: str) -> list[str]:
    """Return what is wrong with the table [design], whose method is known."""
    allowed = {"grid": (), "list": ("file",)}.get(method, ("count", "seed"))
    faults = []
    for key, value in design.items():
        if key != "method" and key not in allowed:
            faults.append(
                f'{name}: design.{key} = {toml_value(value)}: must be absent; method = "{method}" '
                f"knows {', '.join(('method', *allowed))}"
            )
    if method in SAMPLED:
        count, seed = design.get("count"), design.get("seed", 0)
        if not (isinstance(count, int) and is_whole(count) and 1 <= count <= _MOST_CASES):
            said = "is missing" if count is None else f"= {toml_value(count)}"
            faults.append(
                f"{name}: design.count {said}: must be a whole number from 1 to {_MOST_CASES}"
            )
        if not is_whole(seed) or seed < 0:
            faults.append(f"{name}: design.seed = {toml_value(seed)}: must be a whole number >= 0")
    if method == "list" and not isinstance(design.get("file"), str):
        said = f"= {toml_value(design['file'])}" if "file" in design else "is missing"
        faults.append(
            f"{name}: design.file {said}: must be the name of a CSV file, relative to this one"
        )
    return faults


def drawn_rows(
    name: str, variations: Sequence[Variation], method: str, design: Mapping[str, Any]
) -> list[tuple[Any, ...]]:
    """Return the rows of a grid or of a sampled design; the design must have no faults.

    Raises
    ------
    InputError : it has too many cases or keys.
    """
    if method == "grid":
        values = [v.grid() for v in variations]
        count = math.prod(map(len, values))
        if count > _MOST_CASES:
            raise InputError(f"{name}: the grid has {count} cases; must be at most {_MOST_CASES}")
        return list(itertools.product(*values))
    from scipy.stats import qmc  # slow to import, and not needed to draw a figure

    count, seed, d = design["count"], design.get("seed", 0), len(variations)
    if method == "sobol":  # whole powers of 2, cut: a longer design begins with a shorter one
        if d > qmc.Sobol.MAXDIM:
            raise InputError(f"{name}: [vary] has {d} keys; must be at most {qmc.Sobol.MAXDIM}")
        points = qmc.Sobol(d, scramble=True, seed=seed).random_base2((count - 1).bit_length())
        points = points[:count]
    elif method == "latin-hypercube":
        points = qmc.LatinHypercube(d, seed=seed).random(count)
    else:
        points = np.random.default_rng(seed).random((count, d))
    columns = [v.at(u) for v, u in zip(variations, points.T, strict=True)]
    return list(zip(*columns, strict=True))


def listed_rows(table: Path) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Return the varied keys and rows of a CSV file: a line of keys, and one line a case.

    Raises
    ------
    InputError : its first faults, one sentence each.
    """
    lines = [line for line in csv.reader(read_text(table).splitlines()) if line]
    if len(lines) < 2:
        raise InputError(f"{table}: has no cases; must be a line of case keys and one line a case")
    names = tuple(cell.strip() for cell in lines[0])
    faults = []
    for name in names:
        if path_of(name) not in BY_PATH or name == "title":
            faults.append(f"{table}: column {name}: unknown key{nearest_key(path_of(name))}")
        elif not has_entry(name):
            faults.append(f"{table}: column {name}: has no entries; must be the key itself")
        elif names.count(name) > 1:
            faults.append(f"{table}: column {name}: is there more than once")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(names):
            faults.append(
                f"{table}: line {number}: has {len(line)} values; must have {len(names)}, as the "
                "first line"
            )
        rows.append(tuple(_cell(cell.strip()) for cell in line))
    if faults:
        raise InputError(*faults[:_FAULTS_TOLD])
    return names, rows


def _cell(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
