"""What is written and said of a design: its numbers, their map, its best tests as tables."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.files.keys import flatten
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.units import factor, has_unit
from ringwear_par.cases.values import is_number
from ringwear_par.errors import legible
from ringwear_par.files.folders import DESIGN, MAP, NEXT, json_bytes, write_outcome
from ringwear_par.files.text import toml_value
from ringwear_par.identification.definition.fitted_parameters import unit_of_key, unit_scale
from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.definition.scatter import known_sizes
from ringwear_par.identification.design.candidates import LOADS, Candidate, last_profiles
from ringwear_par.identification.design.design import Design, DesignResult
from ringwear_par.pictures.key_panels import design_panels
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.style import picture
from ringwear_par.results.key_numbers import time_unit, time_words

_CRITERIA = {"D": "smallest volume of the confidence ellipsoid (D)",
             "A": "smallest mean variance over the widths of the bounds (A)"}  # fmt: skip
#: inches: width and height of a panel, height of a test of a design in bars
_WIDTH, _HEIGHT, _LINE = 4.6, 4.2, 0.2
#: number of designs that a summary shows; factor on an sd that is nearly the same
_LISTED, _NEARLY = 5, 1.1
#: share of a step within which distances are equal
_EQUAL = 1e-6


def save(found: DesignResult, folder: Path) -> None:
    """Write all three files, see ``write_outcome``."""
    contents = {
        MAP: lambda: picture(found.plot, str(folder / MAP)),
        NEXT: lambda: next_tests(found).encode(),
        DESIGN: lambda: json_bytes(found.to_dict()),
    }
    write_outcome(folder, "fit", contents)


def sd_scales(found: DesignResult) -> dict[str, dict[str, Any]]:
    """Return unit and factor by which people read the sd of each key: % of logarithms."""
    return {
        p.key: {"factor": 100.0 / value, "unit": "%"} if p.log
        else {"factor": 1.0 / unit_scale(p),
              "unit": p.unit or unit_of_key(found.problem, p.key).strip()}
        for p, value in zip(found.problem.parameters, found.before.values.tolist(), strict=True)
    }  # fmt: skip


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
        "draws": len(found.before.draws),
        "candidates": len(found.candidates),
        "failed": [test.to_dict() for test in found.failed],
        "reason": found.reason or None,
        "histories": found.histories,
        "measured_as": problem.experiments[0].name,
        "map": _map(found),
        "sd_scales": sd_scales(found),
        "designs": designs,
        "today": predicted(found.today),
        "fit_file": predicted(found.planned),
        "versions": dict(found.versions),
    }


def plot(found: DesignResult) -> Figure:
    """Return the map of predicted standard deviations, or bars of those of the best designs."""
    outcome = to_dict(found)
    panels = design_panels(outcome)
    lines = sum(len(entry["experiments"]) for entry in outcome["designs"])
    return panel_figure([panels], (_WIDTH * len(panels), max(_HEIGHT, _LINE * lines)))


def _map(found: DesignResult) -> dict[str, Any] | None:
    """Return predicted standard deviations over the load and duration of the last test.

    The others are those of the best design; of several instants the best ones. None where one of
    the two does not vary.
    """
    tests, best, keys = found.candidates, found.designs[0].tests, found.problem.keys
    plain = [i for i, t in enumerate(tests) if len(t.loads) == 1 and "load.omega" not in t.keys]
    loads = sorted({tests[i].loads[0] for i in plain})
    seconds = sorted({tests[i].seconds for i in plain})
    if len(loads) < 2 or len(seconds) < 2 or best[-1] not in plain:
        return None
    rows = np.array([[*best[:-1], i] for i in plain])
    scores, (unit, length) = found.scores(rows), time_unit(seconds[-1])
    sd: dict[str, list[list[Any]]] = {key: [[None] * len(loads) for _ in seconds] for key in keys}
    for row in np.argsort(scores, kind="stable").tolist():  # the best one of a cell stays
        test, sds = tests[plain[row]], found.sds(found.information[rows[row]].sum(axis=0)).tolist()
        for key, value in zip(keys, sds, strict=True):
            told = value if np.isfinite([value, scores[row]]).all() else None
            sd[key][seconds.index(test.seconds)][loads.index(test.loads[0])] = told
    load = "mean pressure (MPa)" if "load.pressure" in tests[best[-1]].keys else "force (N)"
    return {
        "x": {"label": load + " of the last test" * (len(best) > 1), "values": loads},
        "y": {"label": f"duration ({unit})", "values": [second / length for second in seconds]},
        "sd": sd,
        "best": {"x": [*tests[best[-1]].loads], "y": [tests[best[-1]].seconds / length]},
    }


def summary(found: DesignResult) -> str:
    """Return the outcome in a few lines."""
    problem, count, draws = found.problem, len(found.designs[0].tests), len(found.before.draws)
    about = ", ".join(
        f"{p.key} = {v:.4g}{unit_of_key(problem, p.key)}"
        + f" ({v / unit_scale(p):.4g} {p.unit})" * bool(p.unit)
        for p, v in zip(problem.parameters, found.before.values.tolist(), strict=True)
    )
    around = (
        f"means over {draws} draws" if draws > 1
        else "without priors or an earlier fit (--after) it holds there only"
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
            "specimens; numbers below are of the material"
        )
    lines += known_sizes(problem, count) * (not found.after)  # or earlier specimens tell it too
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
        name = name_of(found.failed[0], problem.design.units)
        lines.append(
            f"{len(found.failed)} tests cannot be computed and are left out: {name}: {found.reason}"
        )
    return "\n".join(lines)


def _only_specimens(found: DesignResult) -> list[str]:
    """Return sentences on keys whose scatter alone limits what tests tell, whichever they are."""
    best, precision = found.designs[0], np.linalg.inv(found.before.covariance)
    usual = np.median(found.sds(len(best.tests) * found.information), axis=0)
    slopes, lines = found.problem.slopes(found.before.values), []
    for j, (key, scale) in enumerate(sd_scales(found).items()):
        if not (variance := found.before.scatter[j]):
            continue
        least = slopes[j] / np.sqrt(precision[j, j] + len(best.tests) / variance)
        if best.sd[j] < _NEARLY * least and usual[j] < _NEARLY * best.sd[j]:
            between, left = (
                f"{scale['factor'] * sd:.2g} {scale['unit']}"
                for sd in (slopes[j] * np.sqrt(variance), least)
            )
            lines.append(
                f"{key}: specimens differ by {between}, so that {len(best.tests)} more leave an sd "
                f"of {left} at least, and most candidates come near it: only their number matters"
            )
    return lines


def name_of_tests(found: DesignResult, design: Design) -> str:
    """Return the tests of a design in a few words."""
    units = found.problem.design.units
    return " + ".join(name_of(found.candidates[i], units) for i in design.tests)


def name_of(test: Candidate, units: Mapping[str, str]) -> str:
    """Return a test in a few words, its keys in some units where not in the case's."""
    words = []
    for key in (*LOADS, "load.omega"):
        if key in test.keys:
            values = test.loads if key in LOADS else (test.keys[key],)
            words.append(" then ".join(_in_unit(key, value, units) for value in values))
    if "time.end" in units:
        words.append(_in_unit("time.end", test.seconds, units))
    else:
        words.append(time_words(test.seconds, test.seconds))
    if test.instants_vary:
        at = ", ".join(time_words(at, test.seconds) for at in test.profiles)
        words.append(f"profile{'s' if test.profiles[1:] else ''} at {at}")
    return ", ".join(words)


def _in_unit(key: str, value: float, units: Mapping[str, str], digits: int = 4) -> str:
    unit = units.get(key, BY_PATH[key].unit)
    return f"{value / factor(unit, BY_PATH[key].unit):.{digits}g} {unit}"


def spreads(found: DesignResult, design: Design) -> str:
    """Return the predicted standard deviations of a design in a sentence."""
    return "; ".join(
        f"{key} sd {scale['factor'] * sd:.2g} {scale['unit']}".rstrip() if np.isfinite(sd)
        else f"{key} not identified"
        for (key, scale), sd in zip(sd_scales(found).items(), design.sd.tolist(), strict=True)
    )  # fmt: skip


def next_tests(found: DesignResult) -> str:
    """Return the best design as tables that may follow those of its fit file."""
    problem, best = found.problem, found.designs[0]
    template, measured = problem.experiments[0].series, problem.experiments[0].table
    last = last_profiles(template)
    tables = {
        s.quantity if s.profile else s.name: table
        for s, table in zip(template, measured["data"], strict=True)
        if not s.profile or s in last
    }
    lines = [
        f"# The best of {len(found.candidates)} candidates: {spreads(found, best)}.",
        f"# Tables for {legible(problem.name)}, measured as {legible(measured['name'])} there. "
        "Readings are planned:",
        "# ringwear fit --dry-run prints the intervals to expect. After a test, put its readings",
        "# in place of times, r and unit (file, columns, units); a weight beside its unit (value).",
    ]
    number, taken = 1, {experiment.name for experiment in problem.experiments}
    for test in (found.candidates[i] for i in best.tests):
        while (name := f"next {number}") in taken:
            number += 1
        taken.add(name)
        units = problem.design.units
        changes = {
            key: _in_unit(key, value, units, 9) if key in units and is_number(value) else value
            for key, value in test.changes().items()
        }
        loads = {*LOADS, "load.displacement"} if test.loads else set()
        settings = flatten(measured.get("set", {}), "set")
        changes = {k: v for k, v in settings.items() if k not in loads} | changes
        lines += ["", "[[experiment]]", f"name = {toml_value(name)}"]
        lines.append(f"set = {toml_value(changes)}")
        for series in (test.experiment.series[i] for i in test.series):
            table = tables[series.quantity if series.profile else series.name]
            planned = [f"{k} = {toml_value(v)}" for k, v in _planned(series, table).items()]
            lines += ["  [[experiment.data]]", *(f"  {line}" for line in planned)]
    return "\n".join(lines) + "\n"


def _planned(series: Series, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of planned readings, measured like those of a table."""
    keys: dict[str, Any] = {"quantity": series.quantity}
    if series.profile:
        keys |= {"at": series.at, "r": table.get("r") or _places(series.x)}
        keys |= {key: table[key] for key in ("exclude",) if key in table and "r" in table}
    elif series.n == 1:
        keys["at"] = float(series.x[0])
    else:
        keys["times"] = _places(series.x)
    keys |= {"unit": series.unit, "sd": table.get("sd")}
    if not (is_number(keys["sd"]) or has_unit(keys["sd"])):
        keys["sd"] = float(f"{np.median(series.sd) / series.factor:.6g}")
    return keys | {k: table[k] for k in ("density", "correlation_time", "nuisance") if k in table}


def _places(readings: FloatArray) -> Any:
    """Return where readings are: from, to and count of equal steps, if it is so, or a list."""
    x = np.unique(readings)
    equal = np.linspace(x[0], x[-1], len(x))
    if len(x) > 2 and np.abs(equal - x).max() < _EQUAL * (equal[1] - equal[0]):
        return {"from": float(f"{x[0]:.9g}"), "to": float(f"{x[-1]:.9g}"), "count": len(x)}
    return [float(f"{value:.9g}") for value in x]
