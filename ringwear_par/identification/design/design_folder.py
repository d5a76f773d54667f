"""What is written and said of a design: its numbers, and its best tests as tables."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringwear_par.cases.files.keys import flatten
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.units import factor, has_unit
from ringwear_par.cases.values import is_number
from ringwear_par.errors import legible
from ringwear_par.files.text import toml_value
from ringwear_par.identification.definition.fitted_parameters import unit_of_key, unit_scale
from ringwear_par.identification.definition.problem import DesignSpace, Series
from ringwear_par.identification.design.candidates import (
    INSTANTS,
    LOADS,
    RECORD,
    Candidate,
    case_keys,
)
from ringwear_par.identification.design.design import Design, DesignResult
from ringwear_par.results.key_numbers import time_words

_CRITERIA = {"D": "smallest volume of the confidence ellipsoid (D)",
             "A": "smallest mean variance over the widths of the bounds (A)"}  # fmt: skip
#: number of designs that a summary shows; factor on an sd that is nearly the same
_LISTED, _NEARLY = 5, 1.1


def to_dict(found: DesignResult) -> dict[str, Any]:
    """Return the contents of design.json."""
    problem, keys = found.problem, found.problem.keys

    def predicted(design: Design) -> dict[str, Any]:
        sd = [value if np.isfinite(value) else None for value in design.sd.tolist()]
        return {"score": design.score, "gain": design.gain, "sd": dict(zip(keys, sd, strict=True))}

    designs = []
    for design in found.designs:
        tests = [found.candidates[i] for i in design.tests]
        designs.append(
            {"name": name_of_tests(found, design), "experiments": [t.to_dict() for t in tests],
             "seconds": sum(test.seconds for test in tests), **predicted(design)}
        )  # fmt: skip
    return {
        "criterion": problem.design.criterion,
        "parameters": dict(zip(keys, found.before.values.tolist(), strict=True)),
        "after": found.after or None,
        "candidates": len(found.candidates),
        "failed": [test.to_dict() for test in found.failed],
        "reason": found.reason or None,
        "histories": found.histories,
        "measured_as": problem.experiments[0].name,
        "sd_scales": sd_scales(found),
        "designs": designs,
        "today": predicted(found.today),
        "fit_file": predicted(found.planned),
        "versions": dict(found.versions),
    }


def sd_scales(found: DesignResult) -> dict[str, dict[str, Any]]:
    """Return unit and factor by which people read the sd of each key: % of logarithms."""
    return {
        p.key: {"factor": 100.0 / value, "unit": "%"} if p.log
        else {"factor": 1.0 / unit_scale(p),
              "unit": p.unit or unit_of_key(found.problem, p.key).strip()}
        for p, value in zip(found.problem.parameters, found.before.values.tolist(), strict=True)
    }  # fmt: skip


def summary(found: DesignResult) -> str:
    """Return the outcome in a few lines."""
    problem, count, before = found.problem, len(found.designs[0].tests), found.before
    about = ", ".join(
        f"{p.key} = {v / unit_scale(p):.4g} {p.unit}" if p.unit
        else f"{p.key} = {v:.4g}{unit_of_key(problem, p.key)}"
        for p, v in zip(problem.parameters, before.values.tolist(), strict=True)
    )  # fmt: skip
    around = (
        "without priors or an earlier fit (--after) it holds there only" if before.unknown.all()
        else f"means over {len(before.draws)} draws"
    )  # fmt: skip
    lines = [
        f"{problem.name}: {count} of {len(found.candidates)} tests, "
        f"{_CRITERIA[problem.design.criterion]}; measured as in {problem.experiments[0].name}; "
        f"{found.histories} histories",
        f"{f'after {found.after}' if found.after else 'at the start'}: {about}; {around}",
    ]
    if scattering := [p.key for p in problem.parameters if p.scatter is not None]:
        lines.append(
            f"each test is of a new specimen, and {', '.join(scattering)} differs between "
            "specimens, by as much as is taken as known; numbers below are of the material"
        )
    seconds = sum(experiment.case.time.end for experiment in problem.experiments)
    rows = [("today", found.today)]
    rows += [(name_of_tests(found, design), design) for design in found.designs[:_LISTED]]
    again = " again" * bool(found.after)
    rows.append((f"the fit file's{again}, {time_words(seconds, seconds)}", found.planned))
    width = max(len(name) for name, _ in rows)
    for name, design in rows:
        gain = f"; gain {design.gain:.3g} bits" * (name != "today")
        lines.append(f"  {name.ljust(width)}  {spreads(found, design)}{gain}")
    lines += _only_specimens(found)
    if found.failed:
        name = name_of(found.failed[0], problem.design)
        lines.append(
            f"{len(found.failed)} tests cannot be computed and are left out: {name}: {found.reason}"
        )
    return "\n".join(lines)


def _only_specimens(found: DesignResult) -> list[str]:
    """Return sentences on keys whose scatter alone limits what tests tell, whichever they are."""
    best, before, lines = found.designs[0], found.before, []
    count, precision = len(best.tests), np.diag(np.linalg.inv(before.covariance))
    usual = np.median(found.sds(count * found.information), axis=0)
    for j, (key, scale) in enumerate(sd_scales(found).items()):
        if not (variance := before.scatter[j]):
            continue
        least = before.slopes[j] / np.sqrt(precision[j] + count / variance)
        if best.sd[j] < _NEARLY * least and usual[j] < _NEARLY * best.sd[j]:
            between, left = (
                f"{scale['factor'] * sd:.2g} {scale['unit']}"
                for sd in (before.slopes[j] * np.sqrt(variance), least)
            )
            lines.append(
                f"{key}: specimens differ by {between}, so that {count} more leave an sd of {left} "
                "at least, and most candidates come near it: only their number matters"
            )
    return lines


def spreads(found: DesignResult, design: Design) -> str:
    """Return the predicted standard deviations of a design in a sentence."""
    return "; ".join(
        f"{key} sd {scale['factor'] * sd:.2g} {scale['unit']}".rstrip() if np.isfinite(sd)
        else f"{key} not identified"
        for (key, scale), sd in zip(sd_scales(found).items(), design.sd.tolist(), strict=True)
    )  # fmt: skip


def name_of_tests(found: DesignResult, design: Design) -> str:
    """Return the tests of a design in a few words."""
    return " + ".join(name_of(found.candidates[i], found.problem.design) for i in design.tests)


def name_of(test: Candidate, space: DesignSpace) -> str:
    """Return a test in a few words, in the units in which ranges are written."""
    words, at = [], [time_words(time, test.seconds) for time in test.profiles]
    for key in (*LOADS, "load.omega"):
        if key in test.keys:
            values = test.loads if key in LOADS else (test.keys[key],)
            words.append(" then ".join(_in_unit(key, value, space) for value in values))
    given = "time.end" in space.units
    duration = _in_unit("time.end", test.seconds, space) if given else ""
    words.append(duration or time_words(test.seconds, test.seconds))
    if not space.ranges.keys().isdisjoint(INSTANTS):
        words.append(f"profile{'s' if at[1:] else ''} at {', '.join(at)}")
    return ", ".join(words)


def _in_unit(key: str, value: float, space: DesignSpace, digits: int = 4) -> str:
    unit = space.units.get(key, BY_PATH[key].unit)
    return f"{value / factor(unit, BY_PATH[key].unit):.{digits}g} {unit}"


def next_tests(found: DesignResult) -> str:
    """Return the best design as tables that may follow those of its fit file."""
    problem, best, space = found.problem, found.designs[0], found.problem.design
    template, measured = problem.experiments[0].series, problem.experiments[0].table
    tables = {
        s.quantity if s.profile else s.name: table
        for s, table in zip(template, measured["data"], strict=True)
    }
    lines = [
        f"# The best of {len(found.candidates)} candidates: {spreads(found, best)}.",
        f"# Tables for {legible(problem.name)}, measured as {legible(measured['name'])} there. "
        "Readings are planned:",
        "# ringwear fit --dry-run prints the intervals to expect. After a test, put its readings",
        "# in place of times, r and unit (file, columns, units); a weight beside its unit (value).",
    ]
    # numbered among all tests of the fit file, so that names differ
    for number, i in enumerate(best.tests, start=1 + len(problem.experiments)):
        test = found.candidates[i]
        changes = {
            key: _in_unit(key, value, space, 9) if key in space.units and is_number(value)
            else value
            for key, value in case_keys(test.keys, test.seconds).items()
        }  # fmt: skip
        loads = {*LOADS, "load.displacement"} if test.loads else set()
        settings = flatten(measured.get("set", {}), "set")
        changes = {k: v for k, v in settings.items() if k not in loads} | changes
        lines += ["", "[[experiment]]", f'name = "next {number}"', f"set = {toml_value(changes)}"]
        for series in (test.experiment.series[i] for i in test.series):
            table = tables[series.quantity if series.profile else series.name]
            planned = [f"{k} = {toml_value(v)}" for k, v in _planned(series, table).items()]
            lines += ["  [[experiment.data]]", *(f"  {line}" for line in planned)]
    return "\n".join(lines) + "\n"


def _planned(series: Series, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of planned readings, measured like those of a table."""
    keys: dict[str, Any] = {"quantity": series.quantity}
    places = [float(f"{x:.9g}") for x in np.unique(series.x).tolist()]
    if series.profile:
        keys |= {"at": series.at, "r": table.get("r", places)}
        keys |= {key: table[key] for key in ("exclude",) if key in table and "r" in table}
    elif series.n == 1:
        keys["at"] = places[0]
    elif series.n < RECORD:
        keys["times"] = places
    else:  # at equal steps
        keys["times"] = {"from": places[0], "to": places[-1], "count": series.n}
    keys |= {"unit": series.unit, "sd": table.get("sd")}
    if not (is_number(keys["sd"]) or has_unit(keys["sd"])):
        keys["sd"] = float(f"{np.median(series.sd) / series.factor:.6g}")
    return keys | {k: table[k] for k in ("density", "correlation_time", "nuisance") if k in table}
