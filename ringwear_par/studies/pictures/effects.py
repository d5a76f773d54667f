"""Final values of a sweep against each key, and how much each key matters, as panels.

Against a key there are curves where its values repeat with the same others, and a point each case
elsewhere, with the surrogate's mean over the other keys where it is good, or medians of all cases.
"""

import textwrap
from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.schema import quantity_name
from ringwear_par.pictures.panel import GREY, Axis, Band, Bars, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.studies.analysis.responses import SEED, chosen_cases
from ringwear_par.studies.analysis.sensitivity import Indices
from ringwear_par.studies.end_values import display_of, final_name
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.pictures.choice import LOG_VALUE, Arrangement, Choice, Key, spans

#: most cases that are points against a key, and most without a running median
_POINTS, _MANY = 1000, 200
#: pixels of a point times the square root of the number of points
_SIZE = 64.0
#: most values of a sampled key, and fewest cases of each, for medians at each value
_DISCRETE, _REPEATED = 12, 5
#: fewest cases at a value of which quantiles are drawn, of fewer the whole range; the quantiles
_FEW_REPEATED, _QUANTILES = 20, (0.05, 0.95)
#: distance from the place of a category over which its cases are spread, and half the width of the
#: box of their range
_ASIDE, _BOX = 0.2, 0.3
#: least range of an axis over the size of its values: smaller variations are round-off
_LEAST_SPAN = 1e-3
#: letters of a line in the title of a legend
_LETTERS = 26
#: factor by which a logarithmic axis goes beyond its values
_BEYOND = 2.0


def pointed_cases(choice: Choice) -> IntArray:
    """Return the cases that have a point each: all of them, or some chosen at random."""
    return chosen_cases(choice.cases, _POINTS)


def effects(ensemble: Ensemble, choice: Choice) -> dict[tuple[str, str], Panel]:
    """Return the panels of final values by output and key; points go as ``pointed_cases``."""
    rows = np.searchsorted(choice.cases, pointed_cases(choice))
    return {
        (output, arrangement.key.name): _effect(ensemble, choice, arrangement, output, rows)
        for arrangement in choice.arrangements
        for output in choice.outputs
    }


def _effect(
    ensemble: Ensemble, choice: Choice, arrangement: Arrangement, output: str, rows: IntArray
) -> Panel:
    """Return the panel of an output against a key; ``rows`` are those of cases with points."""
    key, display = arrangement.key, display_of(output)
    label = f"final {display.label}" if output == "penetration" else display.label
    values = display.factor * ensemble.final[output][choice.cases]
    response, errors = _response(choice, key, output)
    curves, bands, points = [*response], [*errors], []
    if arrangement.kind == "curves":
        curves = [*_curves(arrangement, values, rows), *response]
        if arrangement.points is not None and len(arrangement.points):
            rest = np.isin(rows, arrangement.points)
            points.append(_points(key, values, rows, rest, "other cases"))
    else:
        points.append(_points(key, values, rows, np.ones(len(rows), dtype=bool), "cases"))
        if not response:
            summary = _medians(arrangement, values)
            curves = [mark for mark in summary if isinstance(mark, Curve)]
            bands = [mark for mark in summary if isinstance(mark, Band)]
            points += [mark for mark in summary if isinstance(mark, Points)]
    return Panel(
        Axis(key.label, log=key.logarithmic, categories=key.categories),
        _value_axis(label, values, [*curves, *points], bands), f"{label} over {key.label}",
        curves=curves, bands=bands, points=points, legend=arrangement.title,
    )  # fmt: skip


def _curves(arrangement: Arrangement, values: FloatArray, rows: IntArray) -> list[Curve]:
    """Return one curve for each combination of the other keys, with its cases."""
    number_of = np.full(len(values), -1)
    number_of[rows] = np.arange(len(rows))
    x = arrangement.key.values
    return [
        Curve(
            x[curve], values[curve], arrangement.labels[number] if arrangement.labels else "cases",
            COLOURS[number % len(COLOURS)], number + number // len(COLOURS), marked=True,
            tabulated=False, cases=number_of[curve],
        )
        for number, curve in enumerate(arrangement.curves)
    ]  # fmt: skip


def _points(key: Key, values: FloatArray, rows: IntArray, chosen: BoolArray, name: str) -> Points:
    """Return a point for each of the chosen ``rows``."""
    x = key.values[rows]
    chosen = chosen & np.isfinite(x)
    if key.categories:
        x = x + np.random.default_rng(SEED).uniform(-_ASIDE, _ASIDE, len(x))
    size = float(np.clip(_SIZE / np.sqrt(len(rows)), 2.8, 6.0))
    numbers = np.arange(len(rows))
    return Points(x[chosen], values[rows][chosen], name, GREY, size, cases=numbers[chosen])


def _medians(arrangement: Arrangement, values: FloatArray) -> list[Curve | Band | Points]:
    """Return medians of all cases along a key, with their range where its values repeat."""
    key = arrangement.key
    known = np.isfinite(key.values) & np.isfinite(values)
    x, y = key.values[known], values[known]
    levels = np.unique(x)
    if not len(x):
        return []
    if arrangement.kind == "scatter" and not (
        len(levels) <= _DISCRETE and len(x) >= _REPEATED * len(levels)
    ):
        if len(x) <= _MANY:
            return []
        parts = np.array_split(np.argsort(x, kind="stable"), min(20, len(x) // 50))
        along, middle = (np.array([np.median(column[part]) for part in parts]) for column in (x, y))
        return [Curve(along, middle, "running median", COLOURS[1], 1)]
    repeated = [y[x == level] for level in levels]
    middle = np.array([np.median(part) for part in repeated])
    if arrangement.kind == "scatter":
        return [Points(levels, middle, "median", COLOURS[1], 20.0, marker="level")]
    whole = np.median([len(part) for part in repeated]) < _FEW_REPEATED
    ends = (0.0, 1.0) if whole else _QUANTILES
    low, high = np.array([np.quantile(part, ends) for part in repeated]).T
    name = "full range" if whole else "5\N{EN DASH}95 %"
    median = "median over the others"
    summary: list[Curve | Band | Points] = []
    if key.categories:  # a box each
        levels, low, high = (
            np.stack([ends, ends, np.full(len(ends), np.nan)], axis=1).ravel()
            for ends in (levels, low, high)
        )
        levels[::3] -= _BOX
        levels[1::3] += _BOX
        summary.append(Points(levels[::3] + _BOX, middle, median, COLOURS[1], 20.0, marker="level"))
    else:
        summary.append(Curve(levels, middle, median, COLOURS[1], marked=True))
    ends_names = ("least", "largest") if whole else ("5 %", "95 %")
    return [Band(levels, low, high, name, ends_names, COLOURS[0], 0.2), *summary]


def _response(choice: Choice, key: Key, output: str) -> tuple[list[Curve], list[Band]]:
    """Return the surrogate's mean over the other keys, with its error."""
    responses, factor = choice.responses, display_of(output).factor
    if responses is None or output not in responses.names or key.name not in responses.keys:
        return [], []
    along, mean, low, high = responses.part.mean_along(responses.keys[key.name], output)
    along = along / key.scale
    name, short = "surrogate", "surrogate"
    if len(responses.part.keys) > 1:
        name, short = f"{name}, mean over the other keys", f"{short}, mean over others"
    ends = ("95 % of the surrogate, from", "95 % of the surrogate, to")
    interval = "95 % of the surrogate (2 leave-out errors)"
    band = Band(along, factor * low, factor * high, interval, ends, COLOURS[1], 0.5)
    return [Curve(along, factor * mean, name, COLOURS[0], legend=short)], [band]


def _value_axis(
    label: str, values: FloatArray, marks: Sequence[Curve | Points], bands: Sequence[Band]
) -> Axis:
    """Return the axis of an output: logarithmic, or wider than round-off."""
    if spans(values, LOG_VALUE):
        finite = values[np.isfinite(values)]
        ends = float(finite.min()) / _BEYOND, float(finite.max()) * _BEYOND
        return Axis(label, ends, log=True)
    drawn = np.concatenate([
        *(mark.y for mark in marks), *(band.low for band in bands), *(band.high for band in bands),
    ])  # fmt: skip
    drawn = drawn[np.isfinite(drawn)]
    if not len(drawn):
        return Axis(label)
    low, high = float(drawn.min()), float(drawn.max())
    wider = _LEAST_SPAN * max(abs(low), abs(high)) - (high - low)
    return Axis(label, (low - 0.5 * wider, high + 0.5 * wider) if wider > 0.0 else None)


def index_panels(indices: Sequence[Indices], keys: Sequence[str] | None = None) -> dict[str, Panel]:
    """Return the bars of the indices by output, of some keys or of all (None)."""
    return {of_output.output: _index_panel(of_output, keys) for of_output in indices}


def _index_panel(indices: Indices, keys: Sequence[str] | None) -> Panel:
    chosen = [i for i, key in enumerate(indices.keys) if keys is None or key in keys]
    name = final_name(indices.output)
    title = f"Indices of the {name}"
    if indices.noise:
        title += "; dotted: \N{GREEK SMALL LETTER DELTA} of a key without influence"
    places = np.arange(len(chosen), dtype=float)
    bars = [
        Bars(
            places + aside, values[chosen], words, colour,
            None if widths is None else widths[chosen],
        )
        for aside, words, values, widths, colour in zip(
            (-0.17, 0.17), indices.names, (indices.first, indices.influence),
            (indices.first_width, indices.influence_width), COLOURS[:2], strict=True,
        )
    ]  # fmt: skip
    return Panel(
        Axis("sensitivity index", ends=(0.0, 1.05)),
        Axis("", categories=tuple(quantity_name(indices.keys[i]) for i in chosen), reversed=True),
        title, bars=bars, uprights=(indices.noise,) if indices.noise else (),
        legend=f"{textwrap.fill(f'{name}:', _LETTERS)}\n{indices.source}",
    )  # fmt: skip
