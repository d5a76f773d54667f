"""Study files: a base case, the keys that vary, and the design that draws cases from them.

A case is known by its content: its id does not depend on the study it belongs to, on the order of
its keys or on how a number is written, so that a study may grow, shrink or change and the cases
that stay the same keep their results.
"""

import csv
import hashlib
import itertools
import json
import math
import re
import tomllib
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.stats import qmc

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.keys import find_files, override, read_keys
from ringwear_par.cases.law_trials import refuse_bad_laws
from ringwear_par.cases.reading import make_case
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.suggestions import nearest_key
from ringwear_par.cases.text import read_text, toml_value
from ringwear_par.elasticity.mesh import count_elements
from ringwear_par.errors import InputError
from ringwear_par.history.limits import check_memory, check_mesh, check_ranks
from ringwear_par.history.pairs import operator_key

METHODS = ("grid", "sobol", "latin-hypercube", "random", "list")
SAMPLED = ("sobol", "latin-hypercube", "random")
#: faults of single cases told one by one; the rest are counted
_FAULTS_TOLD = 5
_MOST_CASES = 10**7


@dataclass(frozen=True)
class Variation:
    """One varied key.

    Parameters
    ----------
    name : as in the study: a case key, or an entry of one that is a pair, such as ``upper.r[1]``.
    path : the case key.
    index : which entry of a pair, None for the whole value.
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
        return [self._rounded(v) for v in space(low, high, self.count).tolist()]

    def at(self, u: FloatArray) -> list[Any]:
        """Return the values at points u of the unit interval."""
        if self.spacing == "values":
            return [self.values[i] for i in (u * len(self.values)).astype(int).tolist()]
        low, high = self.values
        values = low * (high / low) ** u if self.spacing == "log" else low + (high - low) * u
        return [self._rounded(v) for v in values.tolist()]

    def _rounded(self, value: float) -> float | int:
        return round(value) if self.whole else value


@dataclass(frozen=True)
class Study:
    """A study, complete: every case of it is known to be a good one.

    Parameters
    ----------
    text : the TOML text of the study.
    base : dotted keys and raw values of the base case.
    names : the varied keys, as the study names them.
    method : of the design.
    rows : one tuple of raw values a case, in the order of ``names``.
    ids : one id a case.
    groups : indices of the cases that share an operator, longest work first; those of the same
        moduli follow each other.
    work : estimated seconds of stepping of each case, (cases,).
    assembly : estimated seconds of assembly of each group, (groups,). Both are in proportion only.
    """

    text: str
    base: Mapping[str, Any]
    names: tuple[str, ...]
    method: str
    rows: tuple[tuple[Any, ...], ...]
    ids: tuple[str, ...]
    groups: tuple[tuple[int, ...], ...]
    work: FloatArray
    assembly: FloatArray

    def case(self, number: int) -> Case:
        """Return one case."""
        return make_case(self.keys(number), f"case {number + 1} ({self.ids[number]})")

    def keys(self, number: int) -> dict[str, Any]:
        """Return the dotted keys and raw values of one case."""
        return _varied_keys(self.base, self._parts, self.rows[number])

    @cached_property
    def _parts(self) -> list[tuple[str, int | str | None]]:
        return [_split(name) for name in self.names]


def case_id(case_keys: Mapping[str, Any]) -> str:
    """Return the id of a case, from all that its results depend on: 16 hexadecimal digits.

    Parameters
    ----------
    case_keys : dotted keys and raw values of a good case.
    """
    content = {}
    for path in sorted(case_keys.keys() - {"title"}):
        value = BY_PATH[path].read(case_keys[path])
        if value != BY_PATH[path].default:
            content[path] = value
        if path.startswith("wear.") and path.endswith(".file"):  # what it says, not where it is
            content[path] = read_text(Path(case_keys[path]))
    return hashlib.sha256(json.dumps(content, default=repr).encode()).hexdigest()[:16]


def _split(name: str) -> tuple[str, int | str | None]:
    """Return the case key of a varied one, and which entry of a pair or of a table it is."""
    match = re.fullmatch(r"(.+)\[([01])\]", name)
    if match:
        return match[1], int(match[2])
    match = re.fullmatch(r"(wear\.(?:lower|upper)\.parameters)\.(.+)", name)
    return (match[1], match[2]) if match else (name, None)


def path_of(name: str) -> str:
    """Return the case key of a varied one, which may be an entry of it."""
    return _split(name)[0]


def _has_entry(name: str) -> bool:
    path, index = _split(name)
    return not isinstance(index, int) or BY_PATH[path].kind == "pair"


def value_of(case_keys: Mapping[str, Any], name: str) -> Any:
    """Return the value of a varied key in a case; None where it has none."""
    path, index = _split(name)
    value = case_keys.get(path, BY_PATH[path].default if path in BY_PATH else None)
    if index is None:
        return None if value is ... else value
    if isinstance(index, str):
        return value.get(index) if isinstance(value, dict) else None
    return value[index] if isinstance(value, list | tuple) and len(value) > index else None


def _varied_keys(
    base: Mapping[str, Any], parts: Sequence[tuple[str, int | str | None]], row: Sequence[Any]
) -> dict[str, Any]:
    changed: dict[str, Any] = {}
    for (path, index), value in zip(parts, row, strict=True):
        if index is None:
            changed[path] = value
        elif isinstance(index, str):
            changed[f"{path}.{index}"] = value
        else:
            there = changed.get(path, base.get(path))
            pair = list(there) if isinstance(there, list) and len(there) == 2 else [None, None]
            pair[index] = value
            changed[path] = pair
    return override(base, changed)


def read_study(path: Path, ranks: int = 1) -> Study:
    """Read a study file, its base case and its list, and check every case. Not collective.

    Raises
    ------
    InputError : all faults of the study file together, or those of its first bad cases.
    """
    text = read_text(path)
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is not valid TOML: {error}") from error
    name = str(path)
    faults = [
        f"{name}: {key}: unknown key; must be one of case, vary, design"
        for key in tables.keys() - {"case", "vary", "design"}
    ]
    base: dict[str, Any] = {}
    base_name = tables.get("case")
    if not isinstance(base_name, str):
        said = "is missing" if base_name is None else f"= {toml_value(base_name)}"
        faults.append(f"{name}: case {said}: must be the name of a case file, relative to this one")
    else:
        base_path = path.parent / base_name
        try:
            base = find_files(read_keys(read_text(base_path), str(base_path)), base_path.parent)
        except InputError as error:
            faults += error.faults
    vary, design = tables.get("vary", {}), tables.get("design", {})
    for key, table in (("vary", vary), ("design", design)):
        if not isinstance(table, dict):
            faults.append(f"{name}: {key} = {toml_value(table)}: must be a table, [{key}]")
            raise InputError(*faults)
    method = design.get("method", "grid")
    if method not in METHODS:
        faults.append(
            f"{name}: design.method = {toml_value(method)}: must be one of {', '.join(METHODS)}"
        )
        raise InputError(*faults)
    faults += _design_faults(name, design, method)
    variations = _variations(name, vary, method, faults)
    if faults:
        raise InputError(*faults)
    if method == "list":
        names, rows = _listed(path, design["file"])
    else:
        names = tuple(v.name for v in variations)
        rows = _drawn(name, variations, method, design)
    if base.get("output.boundary", "none") != "none" or "output.boundary" in names:
        raise InputError(
            f"{name}: output.boundary: must be absent from a study and its case; fields on whole "
            "boundaries are stored by ringwear run only"
        )
    files = [i for i, v in enumerate(names) if v.endswith(".file")]
    if files:  # relative to the study
        rows = [
            tuple(
                find_files({names[i]: v}, path.parent)[names[i]] if i in files else v
                for i, v in enumerate(row)
            )
            for row in rows
        ]
    return _checked(path, text, base, names, method, rows, ranks)


def _design_faults(name: str, design: Mapping[str, Any], method: str) -> list[str]:
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
        if not (isinstance(count, int) and _whole(count) and 1 <= count <= _MOST_CASES):
            said = "is missing" if count is None else f"= {toml_value(count)}"
            faults.append(
                f"{name}: design.count {said}: must be a whole number from 1 to {_MOST_CASES}"
            )
        if not _whole(seed) or seed < 0:
            faults.append(f"{name}: design.seed = {toml_value(seed)}: must be a whole number >= 0")
    if method == "list" and not isinstance(design.get("file"), str):
        said = f"= {toml_value(design['file'])}" if "file" in design else "is missing"
        faults.append(
            f"{name}: design.file {said}: must be the name of a CSV file, relative to this one"
        )
    return faults


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _variations(
    name: str, vary: Mapping[str, Any], method: str, faults: list[str]
) -> list[Variation]:
    """Return the varied keys, and add what is wrong with them to the faults."""
    if method == "list":
        if vary:
            faults.append(f'{name}: [vary]: must be absent where design.method = "list"')
        return []
    if not vary:
        faults.append(f"{name}: [vary]: is missing or empty; must name one case key at least")
    variations = []
    for key, entry in _unnested(vary).items():
        path = path_of(key)
        said = f'{name}: vary."{key}"'
        if path not in BY_PATH:
            faults.append(f"{said}: unknown key{nearest_key(path)}")
        elif path == "title":
            faults.append(f"{said}: a title makes no other case; must be another key")
        elif not _has_entry(key):
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
    path, index = _split(key)
    if not isinstance(entry, dict) or len(entry.keys() & {"values", "linear", "log"}) != 1:
        shown = toml_value(entry) if not isinstance(entry, dict) else "{" + ", ".join(entry) + "}"
        faults.append(
            f"{said} = {shown}: must be {{ values = [...] }}, {{ linear = [low, high], count = n }}"
            " or { log = [low, high], count = n }"
        )
        return None
    (spacing,) = entry.keys() & {"values", "linear", "log"}
    values, count = entry[spacing], entry.get("count")
    unknown = entry.keys() - {spacing, "count"}
    if unknown:
        faults.append(f"{said}: {', '.join(sorted(unknown))}: must be {spacing} and count only")
    told = "is missing" if count is None else f"= {toml_value(count)}"
    if spacing == "values":
        if not isinstance(values, list) or not values:
            faults.append(f"{said}: values = {toml_value(values)}: must be a list of values")
            return None
        if count is not None:
            faults.append(f"{said}: count {told}: must be absent beside values")
        return Variation(key, path, index, "values", tuple(values))
    shown = f"{said}: {spacing} = {toml_value(values)}"
    numbers = isinstance(values, list) and len(values) == 2 and all(
        isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e300 for v in values
    )  # fmt: skip
    if not numbers or not values[0] < values[1]:
        faults.append(f"{shown}: must be two increasing numbers")
        return None
    if spacing == "log" and values[0] <= 0:
        faults.append(f"{shown}: must be two increasing numbers > 0")
        return None
    if method == "grid" and not (isinstance(count, int) and _whole(count) and count >= 2):
        faults.append(f"{said}: count {told}: must be a whole number >= 2 in a grid")
        return None
    if method != "grid" and count is not None:
        faults.append(
            f"{said}: count {told}: must be absent; design.count says how many "
            f'cases method = "{method}" draws'
        )
    return Variation(
        key, path, index, "log" if spacing == "log" else "linear", tuple(map(float, values)),
        count or 0,
    )  # fmt: skip


def _drawn(
    name: str, variations: Sequence[Variation], method: str, design: Mapping[str, Any]
) -> list[tuple[Any, ...]]:
    """Return the rows of a grid or of a sampled design."""
    if method == "grid":
        values = [v.grid() for v in variations]
        count = math.prod(map(len, values))
        if count > _MOST_CASES:
            raise InputError(f"{name}: the grid has {count} cases; must be at most {_MOST_CASES}")
        return list(itertools.product(*values))
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


def _listed(path: Path, file: str) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Return the varied keys and rows of a CSV file."""
    table = path.parent / file
    lines = [line for line in csv.reader(read_text(table).splitlines()) if line]
    if len(lines) < 2:
        raise InputError(f"{table}: has no cases; must be a line of case keys and one line a case")
    names = tuple(cell.strip() for cell in lines[0])
    faults = []
    for name in names:
        if path_of(name) not in BY_PATH or name == "title":
            faults.append(f"{table}: column {name}: unknown key{nearest_key(path_of(name))}")
        elif not _has_entry(name):
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


def _checked(
    path: Path,
    text: str,
    base: Mapping[str, Any],
    names: tuple[str, ...],
    method: str,
    rows: Sequence[tuple[Any, ...]],
    ranks: int,
) -> Study:
    """Make every case once, refuse bad ones, drop repetitions, and group by operator."""
    parts = [_split(name) for name in names]
    kept: dict[str, tuple[Any, ...]] = {}
    work: list[float] = []
    groups: dict[Hashable, list[tuple[tuple[float, float], int]]] = defaultdict(list)
    faults: list[str] = []
    largest: dict[Hashable, Case] = {}
    bad = 0
    for number, row in enumerate(rows):
        keys = _varied_keys(base, parts, row)
        try:
            case = make_case(keys, f"{path}: case {number + 1}", text="")
            refuse_bad_laws(case, f"{path}: case {number + 1}")
            check_ranks(case, ranks, f"{path}: case {number + 1}")
        except InputError as error:
            bad += 1
            if bad <= _FAULTS_TOLD:
                faults += error.faults
            continue
        identity = case_id(keys)
        if identity in kept:
            continue
        key = operator_key(case)
        groups[key].append(((case.lower.young, case.upper.young), len(kept)))
        kept[identity] = row
        work.append(_stepping_work(case))
        there = largest.setdefault(key, case)
        if there.stored_rows < case.stored_rows:
            largest[key] = case
    if bad > _FAULTS_TOLD:
        faults.append(f"{path}: {bad - _FAULTS_TOLD} more of {len(rows)} cases are bad")
    for case in largest.values():
        try:
            check_memory(case, ranks, str(path))
            check_mesh(case, str(path))
        except InputError as error:
            faults += [fault for fault in error.faults if fault not in faults]
    if faults:
        raise InputError(*faults)
    worked = np.array(work)
    indices = {key: tuple(i for _, i in sorted(members)) for key, members in groups.items()}
    assembly = {key: _assembly_work(largest[key]) for key in groups}
    order = sorted(
        indices, key=lambda k: (-assembly[k] - worked[list(indices[k])].sum(), indices[k][0])
    )
    return Study(
        text, dict(base), names, method, tuple(kept.values()), tuple(kept),
        tuple(indices[k] for k in order), worked, np.array([assembly[k] for k in order]),
    )  # fmt: skip


def _stepping_work(case: Case) -> float:
    """Return about the seconds of a case's steps: a constant and the work on the matrix a step."""
    return 1e-4 * case.about_steps * (1.0 + (case.mesh.contact_elements / 220.0) ** 2)


def _assembly_work(case: Case) -> float:
    """Return about the seconds of a case's boundary elements: n^2 assembly, n^3 factorisation."""
    rings = case.rings
    n = sum(count_elements(case.section(ring), case.contact, case.mesh) for ring in rings)
    return 0.04 * (n / 318.0) ** 2 + 0.006 * (n / 318.0) ** 3
