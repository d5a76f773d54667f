"""The numbers of a test design: design.json with its map, the summary, the names of tests."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import factor
from ringwear_par.identification.definition.fitted_parameters import unit_of_key, unit_scale
from ringwear_par.identification.definition.scatter import known_sizes
from ringwear_par.identification.design.candidates import Candidate
from ringwear_par.identification.design.design import DesignResult
from ringwear_par.identification.design.search import Design
from ringwear_par.pictures.key_panels import design_panels
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.results.key_numbers import time_unit, time_words

_CRITERIA = {"D": "smallest volume of the confidence ellipsoid (D)",
             "A": "smallest mean variance over the widths of the bounds (A)"}  # fmt: skip
#: inches: width and height of a panel, height of a test of a design in bars
_WIDTH, _HEIGHT, _LINE = 4.6, 4.2, 0.2
#: number of designs that a summary shows; factor on an sd that is nearly the same
_LISTED, _NEARLY = 5, 1.1


@dataclass(frozen=True)
class SdScale:
    """How people read the sd of a key: in its unit, or in % where it is fitted as a logarithm."""

    key: str
    factor: float
    unit: str


def sd_scales(found: DesignResult) -> list[SdScale]:
    """Return the scales of the predicted standard deviations, by key."""
    return [
        SdScale(p.key, 100.0 / value, "%") if p.log
        else SdScale(p.key, 1.0 / unit_scale(p), p.unit or unit_of_key(found.problem, p.key).strip())
        for p, value in zip(found.problem.parameters, found.nominal.tolist(), strict=True)
    ]  # fmt: skip


def to_dict(found: DesignResult) -> dict[str, Any]:
    """Return the contents of design.json."""
    keys, problem = found.problem.keys, found.problem

    def predicted(design: Design) -> dict[str, Any]:
        correlation = design.correlation.tolist()
        return {
            "score": design.score,
            "gain": design.gain,
            "sd": {k: v if np.isfinite(v) else None for k, v in zip(keys, design.sd.tolist(), strict=True)},
            "correlation": {
                f"{keys[i]}, {keys[j]}": correlation[i][j] for i, j in combinations(range(len(keys)), 2)
            },
        }

    return {
        "criterion": problem.design.criterion,
        "parameters": dict(zip(keys, found.nominal.tolist(), strict=True)),
        "after": found.after or None,
        "draws": len(found.every.before.draws),
        "candidates": len(found.candidates),
        "failed": [test.to_dict() for test in found.failed],
        "reason": found.reason or None,
        "histories": found.histories,
        "measured_as": problem.experiments[0].name,
        "map": _map(found),
        "sd_scales": {scale.key: asdict(scale) for scale in sd_scales(found)},
        "designs": [
            {
                "name": name_of_tests(found, design),
                "experiments": [found.candidates[i].to_dict() for i in design.tests],
                "seconds": sum(found.candidates[i].seconds for i in design.tests),
                **predicted(design),
            }
            for design in found.designs
        ],
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
    """Return predicted standard deviations over the loads of two tests, or load and duration.

    A cell has the best durations or instants; of more than two tests the map is that of one. None
    where neither loads nor durations vary.
    """
    tests, every = found.candidates, found.every
    two = found.compared.shape[1] == 2
    rows = found.compared if two else np.arange(len(tests))[:, None]
    rows = rows[[all(tests[i].plain for i in row) for row in rows.tolist()]]
    seconds = sorted({tests[i].seconds for i in rows.ravel().tolist()})
    if not len(rows) or (len(seconds) < 2 and not two):
        return None
    if not two:
        rows = rows[np.argsort(-every.scores(rows), kind="stable")]
    pressed = "load.pressure" in tests[rows[0, 0]].keys
    quantity, (unit, length) = "mean pressure (MPa)" if pressed else "force (N)", time_unit(seconds[-1])
    label = f"{quantity} of the other" if two else f"duration ({unit})"
    places = [(tests[row[0]].loads[0], tests[row[1]].loads[0] if two else tests[row[0]].seconds / length)
              for row in rows.tolist()]  # fmt: skip
    cells = dict[tuple[float, float], FloatArray]()
    for place, row in zip(places, rows, strict=True):
        for cell in (place, place[::-1]) if two else (place,):
            if cell not in cells:  # the best one
                cells[cell] = every.sds(every.information[row].sum(axis=0))
    x, y = (sorted({cell[axis] for cell in cells}) for axis in (0, 1))
    tables = [
        [[float(cells[a, b][j]) if (a, b) in cells and np.isfinite(cells[a, b][j]) else None for a in x]
         for b in y]
        for j in range(len(found.problem.keys))
    ]  # fmt: skip
    best = [tests[i] for i in found.designs[0].tests]
    marks = [(test.loads[0], (best[-1 - i].loads[0] if two else test.seconds / length))
             for i, test in enumerate(best)] if all(test.plain for test in best) else []  # fmt: skip
    return {
        "x": {"label": f"{quantity} of one test", "values": x},
        "y": {"label": label, "values": y},
        "sd": dict(zip(found.problem.keys, tables, strict=True)),
        "best": {"x": [a for a, _ in marks], "y": [b for _, b in marks]},
    }


def summary(found: DesignResult) -> str:
    """Return the outcome in a few lines."""
    problem, before, count = found.problem, found.every.before, len(found.designs[0].tests)
    lines = [
        f"{problem.name}: {count} of {len(found.candidates)} tests, "
        f"{_CRITERIA[problem.design.criterion]}; measured as in {problem.experiments[0].name}; "
        f"{found.histories} histories"
    ]
    about = ", ".join(
        f"{p.key} = {v:.4g}{unit_of_key(problem, p.key)}"
        + f" ({v / unit_scale(p):.4g} {p.unit})" * bool(p.unit)
        for p, v in zip(problem.parameters, found.nominal.tolist(), strict=True)
    )
    where = f"after {found.after}" if found.after else "at the start"
    draws = len(before.draws)
    lines.append(f"{where}: {about}" + (
        f"; means over {draws} draws" if draws > 1
        else "; without priors or an earlier fit (--after) it holds there only"
    ))  # fmt: skip
    if scattering := [p.key for p in problem.parameters if p.scatter is not None]:
        lines.append(
            f"each test is of a new specimen, and {', '.join(scattering)} differs between "
            "specimens; numbers below are of the material"
        )
    if not found.after:  # or earlier specimens tell it too
        lines += known_sizes(problem, count)
    seconds = sum(experiment.case.time.end for experiment in problem.experiments)
    planned = f"the fit file's{' again' if found.after else ''}, {time_words(seconds, seconds)}"
    rows = [("today", found.today)]
    rows += [(name_of_tests(found, design), design) for design in found.designs[:_LISTED]]
    rows.append((planned, found.planned))
    width = max(len(name) for name, _ in rows)
    lines += [
        f"  {name.ljust(width)}  {spreads(found, design)}" + f"; gain {design.gain:.3g} bits" * (design is not found.today)
        for name, design in rows
    ]
    lines += _only_specimens(found)
    if found.failed:
        name = name_of(found.failed[0], problem.design.units)
        lines.append(
            f"{len(found.failed)} tests cannot be computed and are left out: {name}: {found.reason}"
        )
    return "\n".join(lines)


def _only_specimens(found: DesignResult) -> list[str]:
    """Return sentences on keys whose scatter alone limits what tests tell, whichever they are."""
    every, best = found.every, found.designs[0]
    count, lines = len(best.tests), []
    usual = np.median(every.sds(count * every.information), axis=0)
    for j, scale in enumerate(sd_scales(found)):
        if not (variance := every.before.scatter[j]):
            continue
        slope = found.problem.slopes(found.nominal)[j]
        least = slope / np.sqrt(np.linalg.inv(every.before.covariance)[j, j] + count / variance)
        if best.sd[j] < _NEARLY * least and usual[j] < _NEARLY * best.sd[j]:
            sds = [f"{scale.factor * sd:.2g} {scale.unit}" for sd in (slope * variance**0.5, least)]
            lines.append(
                f"{scale.key}: {count} specimens, which differ by {sds[0]}, leave an sd of {sds[1]} at "
                "least, and most candidates come near it: only their number matters"
            )
    return lines


def name_of_tests(found: DesignResult, design: Design) -> str:
    """Return the tests of a design in a few words."""
    return " + ".join(name_of(found.candidates[i], found.problem.design.units) for i in design.tests)


def name_of(test: Candidate, units: Mapping[str, str]) -> str:
    """Return a test in a few words, its keys in some units where not in the case's."""

    def words_of(key: str, base: str, *values: Any) -> str:
        unit = units.get(key, base)
        return f"{' then '.join(f'{value / factor(unit, base):.4g}' for value in values)} {unit}"

    words = []
    if test.loads:
        pressed = "load.pressure" in test.keys
        words.append(words_of(*(("load.pressure", "MPa") if pressed else ("load.force", "N")), *test.loads))
    if "load.omega" in test.keys:
        words.append(words_of("load.omega", "rad/s", test.keys["load.omega"]))
    length = words_of("time.end", "s", test.seconds)
    words.append(length if "time.end" in units else time_words(test.seconds, test.seconds))
    if test.instants_vary:
        at = ", ".join(time_words(at, test.seconds) for at in test.profiles)
        words.append(f"profile{'s' if test.profiles[1:] else ''} at {at}")
    return ", ".join(words)


def spreads(found: DesignResult, design: Design) -> str:
    """Return the predicted standard deviations of a design in a sentence."""
    return "; ".join(
        f"{scale.key} sd {scale.factor * sd:.2g} {scale.unit}".rstrip() if np.isfinite(sd)
        else f"{scale.key} not identified"
        for scale, sd in zip(sd_scales(found), design.sd.tolist(), strict=True)
    )  # fmt: skip
