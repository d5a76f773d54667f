"""The numbers of a test design: design.json, the summary, and the names and units of both."""

import itertools
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import factor
from ringwear_par.identification.definition.fitted_parameters import unit_of_key, unit_scale
from ringwear_par.identification.definition.scatter import known_sizes
from ringwear_par.identification.test_design.candidates import Candidate
from ringwear_par.identification.test_design.design import DesignResult
from ringwear_par.identification.test_design.search import Design
from ringwear_par.pictures.key_panels import design_panels
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.results.key_numbers import time_unit, time_words

_CRITERIA = {
    "D": "smallest volume of the confidence ellipsoid (D)",
    "A": "smallest mean variance over the widths of the bounds (A)",
    "eig": "largest expected gain of information (eig)",
}
#: inches: width and height of a panel, height of a test of a design in bars
_WIDTH, _HEIGHT, _LINE = 4.6, 4.2, 0.2
#: number of designs that a summary shows
_LISTED = 5


@dataclass(frozen=True)
class SdScale:
    """How people read the sd of a key: in its unit, or in % where it is fitted as a logarithm."""

    key: str
    factor: float
    unit: str


def sd_scales(design: DesignResult) -> list[SdScale]:
    """Return the scales of the predicted standard deviations, by key."""
    return [
        SdScale(p.key, 100.0 / value, "%") if p.log
        else SdScale(
            p.key, 1.0 / unit_scale(p), p.unit or unit_of_key(design.problem, p.key).strip()
        )
        for p, value in zip(design.problem.parameters, design.nominal.tolist(), strict=True)
    ]  # fmt: skip


def to_dict(design: DesignResult) -> dict[str, Any]:
    """Return the contents of design.json."""
    keys = design.problem.keys
    return {
        "criterion": design.criterion,
        "parameters": dict(zip(keys, design.nominal.tolist(), strict=True)),
        "after": design.after or None,
        "draws": design.draws,
        "candidates": len(design.candidates),
        "failed": [
            {"experiment": test.to_dict(), "error": reason}
            for test, reason in design.failed.items()
        ],
        "histories": design.histories,
        "measured_as": design.problem.experiments[0].name,
        "map": _map(design),
        "sd_scales": {scale.key: asdict(scale) for scale in sd_scales(design)},
        "designs": [
            {
                "name": name_of_tests(design, candidate),
                "experiments": [design.candidates[i].to_dict() for i in candidate.tests],
                "seconds": sum(design.candidates[i].seconds for i in candidate.tests),
                **_predicted(keys, candidate),
            }
            for candidate in design.designs
        ],
        "fit_file": _predicted(keys, design.planned),
        "versions": dict(design.versions),
    }


def plot(design: DesignResult) -> Figure:
    """Return the map of predicted standard deviations, or bars of those of the best designs."""
    outcome = to_dict(design)
    panels = design_panels(outcome)
    lines = sum(len(entry["experiments"]) for entry in outcome["designs"])
    return panel_figure([panels], (_WIDTH * len(panels), max(_HEIGHT, _LINE * lines)))


def _map(design: DesignResult) -> dict[str, Any] | None:
    """Return predicted standard deviations over loads, or over load and duration.

    Of two tests a cell has the durations of the best score within the budget; of one the best
    instant of a profile; of several the map is that of one. None where neither varies.
    """
    plain = [i for i, test in enumerate(design.candidates) if _is_plain(test)]
    seconds = sorted({design.candidates[i].seconds for i in plain})
    if not plain or (len(seconds) < 2 and not len(design.pairs)):
        return None
    first = design.candidates[plain[0]]
    quantity = "mean pressure (MPa)" if "load.pressure" in first.keys else "force (N)"
    loads = sorted({design.candidates[i].loads[0] for i in plain})
    best = [design.candidates[i] for i in design.designs[0].tests]
    best = best if all(map(_is_plain, best)) else []
    cells: dict[tuple[int, int], tuple[float, FloatArray]] = {}
    if len(design.pairs):
        y, ends = {"label": f"{quantity} of the other", "values": loads}, best[::-1]
        pairs = np.array(plain)[np.argwhere(np.isfinite(design.pair_scores[np.ix_(plain, plain)]))]
        for i, j in pairs.tolist():
            row, column = (loads.index(design.candidates[k].loads[0]) for k in (i, j))
            _keep_better(cells, (row, column), design.pair_scores[i, j], design.pairs[i, j])
        places = [test.loads[0] for test in ends]
    else:
        unit, length = time_unit(seconds[-1])
        y = {"label": f"duration ({unit})", "values": [duration / length for duration in seconds]}
        for i in plain:
            test = design.candidates[i]
            cell = seconds.index(test.seconds), loads.index(test.loads[0])
            _keep_better(cells, cell, design.single_scores[i], design.single[i])
        places = [test.seconds / length for test in best]
    values = np.full((len(design.problem.keys), len(y["values"]), len(loads)), np.nan)
    for cell, (_, sds) in cells.items():
        values[(slice(None), *cell)] = sds
    tables = zip(design.problem.keys, values.tolist(), strict=True)
    return {
        "x": {"label": f"{quantity} of one test", "values": loads},
        "y": y,
        "sd": {key: [[_finite(v) for v in row] for row in table] for key, table in tables},
        "best": {"x": [test.loads[0] for test in best], "y": places},
    }


def _is_plain(test: Candidate) -> bool:
    return len(test.loads) == 1 and len(test.profiles) <= 1 and "load.omega" not in test.keys


def _keep_better(
    cells: dict[tuple[int, int], tuple[float, FloatArray]],
    cell: tuple[int, int],
    score: float,
    sds: FloatArray,
) -> None:
    """Put standard deviations into a cell, if none of a better score are there."""
    if cell not in cells or score >= cells[cell][0]:
        cells[cell] = score, sds


def _predicted(keys: tuple[str, ...], candidate: Design) -> dict[str, Any]:
    pairs = itertools.combinations(range(len(keys)), 2)
    return {
        "score": _finite(candidate.score),
        "sd": {key: _finite(v) for key, v in zip(keys, candidate.sd.tolist(), strict=True)},
        "sd_range": {
            key: [_finite(v) for v in ends]
            for key, ends in zip(keys, candidate.range.T.tolist(), strict=True)
        },
        "correlation": {
            f"{keys[i]}, {keys[j]}": _finite(float(candidate.correlation[i, j])) for i, j in pairs
        },
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def summary(design: DesignResult) -> str:
    """Return the outcome in a few lines."""
    problem, count = design.problem, len(design.designs[0].tests)
    lines = [
        f"{problem.name}: {count} of {len(design.candidates)} tests, "
        f"{_CRITERIA[design.criterion]}; measured as in {problem.experiments[0].name}; "
        f"{design.histories} histories"
    ]
    about = ", ".join(
        f"{p.key} = {v:.4g}{unit_of_key(problem, p.key)}"
        + f" ({v / unit_scale(p):.4g} {p.unit})" * bool(p.unit)
        for p, v in zip(problem.parameters, design.nominal.tolist(), strict=True)
    )
    where = f"after {design.after}" if design.after else "at the start"
    spread = (
        f", and {design.draws - 1} draws around it" if design.draws > 1
        else "; without priors or an earlier fit (--after) it holds there only"
    )  # fmt: skip
    lines.append(f"{where}: {about}{spread}")
    if scattering := [p.key for p in problem.parameters if p.scatter is not None]:
        lines.append(
            f"each test is of a new specimen, and {', '.join(scattering)} differs between "
            "specimens; numbers below are of the material"
        )
    if not design.after:  # or earlier specimens tell it too
        lines += known_sizes(problem, count)
    if problem.settings.process:
        lines.append(
            "noise of the wear itself (fit.process) is not counted: tests tell less than this"
        )
    names = [name_of_tests(design, candidate) for candidate in design.designs[:_LISTED]]
    width = max(map(len, names))
    for name, candidate in zip(names, design.designs, strict=False):
        lines.append(f"  {name.ljust(width)}  {spreads(design, candidate)}")
    seconds = sum(experiment.case.time.end for experiment in problem.experiments)
    planned = f"the fit file's{' again' if design.after else ''}, {time_words(seconds, seconds)}"
    lines.append(f"  {planned.ljust(width)}  {spreads(design, design.planned)}")
    if design.failed:
        test, reason = next(iter(design.failed.items()))
        lines.append(
            f"{len(design.failed)} tests cannot be computed and are left out: "
            f"{name_of(test, problem.design.units)}: {reason}"
        )
    return "\n".join(lines)


def name_of_tests(design: DesignResult, candidate: Design) -> str:
    """Return the tests of a design in a few words."""
    units = design.problem.design.units
    return " + ".join(name_of(design.candidates[i], units) for i in candidate.tests)


def name_of(test: Candidate, units: Mapping[str, str]) -> str:
    """Return a test in a few words, its keys in some units where not in the case's."""

    def words_of(key: str, base: str, *values: Any) -> str:
        unit = units.get(key, base)
        return f"{' then '.join(f'{value / factor(unit, base):.4g}' for value in values)} {unit}"

    words = []
    if test.loads:
        key, base = ("load.force", "N")
        if "load.pressure" in test.keys:
            key, base = "load.pressure", "MPa"
        words.append(words_of(key, base, *test.loads))
    if isinstance(omega := test.keys.get("load.omega"), float):
        words.append(words_of("load.omega", "rad/s", omega))
    if "time.end" in units:
        words.append(words_of("time.end", "s", test.seconds))
    else:
        words.append(time_words(test.seconds, test.seconds))
    if test.instants_vary:
        at = ", ".join(time_words(at, test.seconds) for at in test.profiles)
        words.append(f"profile{'s' if test.profiles[1:] else ''} at {at}")
    return ", ".join(words)


def spreads(design: DesignResult, candidate: Design) -> str:
    """Return the predicted standard deviations of a design in a sentence."""
    texts = []
    for scale, sd, low, high in zip(sd_scales(design), candidate.sd, *candidate.range, strict=True):
        if not np.isfinite(sd):
            texts.append(f"{scale.key} not identified")
            continue
        unit = f" {scale.unit}" if scale.unit else ""
        texts.append(f"{scale.key} sd {scale.factor * sd:.2g}{unit}")
        if high > 1.5 * low:
            worst = f"{high / sd:.2g} times" if np.isfinite(high) else "not identified"
            texts[-1] += f" (at worst {worst})"
    return "; ".join(texts)
