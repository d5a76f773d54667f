"""The folder of a design: its numbers, their map, its best tests as tables of a fit file.

Readings of these tests are planned, to be filled in.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.files.keys import flatten
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.units import factor, has_unit, in_unit
from ringwear_par.cases.values import is_number
from ringwear_par.errors import legible
from ringwear_par.files.folders import DESIGN, MAP, NEXT, json_bytes, write_outcome
from ringwear_par.files.text import toml_value
from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.design.candidates import LOADS, Candidate, last_profiles
from ringwear_par.identification.design.design import DesignResult
from ringwear_par.identification.design.design_numbers import spreads
from ringwear_par.pictures.style import picture

FILES = (DESIGN, NEXT, MAP)

#: share of a step within which distances are equal
_EQUAL = 1e-6


def save(design: DesignResult, folder: Path) -> None:
    """Write all three files, see ``write_outcome``."""
    contents: dict[str, Callable[[], bytes | None]] = {
        MAP: lambda: picture(design.plot, str(folder / MAP)),
        NEXT: lambda: next_tests(design).encode(),
        DESIGN: lambda: json_bytes(design.to_dict()),
    }
    write_outcome(folder, "fit", contents)


def next_tests(design: DesignResult) -> str:
    """Return the best design as tables that may follow those of its fit file."""
    problem, best = design.problem, design.designs[0]
    measured = problem.experiments[0].table
    template = problem.experiments[0].series
    last = last_profiles(template).values()
    tables = {
        s.quantity if s.profile else s.name: table
        for s, table in zip(template, measured["data"], strict=True)
        if not s.profile or s in last
    }
    taken = {experiment.name for experiment in problem.experiments}
    names = (name for i in itertools.count(1) if (name := f"next {i}") not in taken)
    lines = [
        f"# The best of {len(design.candidates)} candidates: {spreads(design, best)}.",
        f"# Tables for {legible(problem.name)}, measured as {legible(measured['name'])} there. "
        "Readings are planned:",
        "# ringwear fit --dry-run prints the intervals to expect. After a test, put its readings",
        "# in place of times, r and unit (file, columns, units); a weight beside its unit (value).",
    ]
    for place, name in zip(best.tests, names, strict=False):
        test = design.candidates[place]
        changes = _set_of(measured, test, problem.design.units)
        lines += [
            "", "[[experiment]]", f"name = {toml_value(name)}",
            "set = " + toml_value(changes),
        ]  # fmt: skip
        for series in (test.experiment.series[i] for i in test.series):
            planned = _planned(series, tables[series.quantity if series.profile else series.name])
            lines += ["  [[experiment.data]]", *(f"  {line}" for line in planned)]
    return "\n".join(lines) + "\n"


def _set_of(
    measured: Mapping[str, Any], test: Candidate, units: Mapping[str, str]
) -> dict[str, Any]:
    """Return all case keys that an experiment of a fit file sets for a test.

    Parameters
    ----------
    units : of keys as the fit file has them; schedules are in those of a case.
    """
    settings = flatten(measured.get("set", {}), "set")
    changes = {
        key: f"{value / factor(units[key], BY_PATH[key].unit):.9g} {units[key]}"
        if key in units and isinstance(value, float)
        else value
        for key, value in test.changes().items()
    }
    loads = {*LOADS, "load.displacement"} if set(LOADS) & changes.keys() else set()
    return {key: value for key, value in settings.items() if key not in loads} | changes


def _planned(series: Series, table: Mapping[str, Any]) -> list[str]:
    """Return the keys of planned readings, measured like those of a table, a line each."""
    keys: dict[str, Any] = {"quantity": series.quantity}
    if series.profile:
        excluded = in_unit(table.get("exclude", []), "mm")
        keys |= {"at": series.at, "r": _places(series.x, excluded)}
        if excluded and isinstance(keys["r"], Mapping):
            keys["exclude"] = excluded
    elif series.n == 1:
        keys["at"] = float(series.x[0])
    else:
        keys["times"] = _places(series.x, [])
    keys["unit"] = series.unit
    sd = table.get("sd")
    keys["sd"] = float(f"{np.median(series.sd) / series.factor:.6g}")
    if is_number(sd) or has_unit(sd):
        keys["sd"] = sd
    keys |= {key: table[key] for key in ("density", "correlation_time", "nuisance") if key in table}
    lines = [f"{key} = {toml_value(value)}" for key, value in keys.items()]
    names = ", ".join(f"{key} = {toml_value(table[key])}" for key in ("columns", "units")
                      if key in table)  # fmt: skip
    if names:
        lines.append(f"# {names}")
    return lines


def _places(readings: FloatArray, excluded: list[list[float]]) -> Any:
    """Return where readings are: from, to and count of equal steps, if it is so, or a list."""
    x = np.unique(readings)
    if len(x) > 1:
        step = float(np.median(np.diff(x)))
        equal = np.linspace(x[0], x[-1], round((x[-1] - x[0]) / step) + 1)
        count = len(equal)
        for low, high in excluded:
            equal = equal[(equal < low) | (equal > high)]
        if len(equal) == len(x) and np.abs(equal - x).max() < _EQUAL * step:
            low, high = (float(f"{end:.9g}") for end in (x[0], x[-1]))
            return {"from": low, "to": high, "count": count}
    return [float(f"{value:.9g}") for value in x]
