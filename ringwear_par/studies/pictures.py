"""What figures and pages show of a sweep, from its stored results.

Histories; final values against each key; how much each key matters. Two rules choose what is drawn
of final values: in a grid, a curve for each combination of the other keys, where these are few; in
any other case a point for each case, and the surrogate's mean over the other keys where it is good.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.schema import quantity_name
from ringwear_par.cases.units import in_signs
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, counted
from ringwear_par.files.text import parse_value
from ringwear_par.pictures.panel import GREY, Axis, Band, Bars, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS, in_words, number_text
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.variables import DISPLAY_UNITS, LAYER_HISTORIES
from ringwear_par.studies.ensemble import STRESS_STATES, Ensemble, Factor, end_value_of, factors_of
from ringwear_par.studies.surrogate import GOOD, SEED, Surrogate, chosen_cases, percent, surrogate

#: most curves of a panel and cases with a point that are drawn
_MOST_CURVES, _MOST_POINTS = 8, 1000
#: largest over smallest value above which an axis of values is logarithmic
_LOG_VALUE = 100.0
#: pixels of a point times the square root of the number of points
_SIZE = 64.0
#: distance from the place of a category over which its cases are spread
_ASIDE = 0.2
#: least range of an axis over the size of its values: smaller variations are round-off
_LEAST_SPAN = 1e-3
_FIRST, _TOTAL = "first order S\N{SUBSCRIPT ONE}", "total S\N{LATIN SUBSCRIPT SMALL LETTER T}"
#: most cases that are drawn one by one, and most of which names are the values of so many keys
_FEW, _NAMED_KEYS = 12, 3
#: most cases of which quantiles are drawn, and number of those with a line of their own on top
_MOST_HISTORIES, _LINES = 1000, 40
#: common times of a fan
_TIMES = 201
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


# -- what is drawn of a sweep ----------------------------------------------------------------------


@dataclass(frozen=True)
class Choice:
    """What is drawn of a sweep."""

    #: numbers of the cases that are done
    cases: IntArray
    #: names of final values
    outputs: list[str]
    #: the varied keys
    keys: list[Factor]
    #: None: there is none, for a reason
    surrogate: Surrogate | None
    absence: str
    #: first-order and total Sobol' indices of its factors, of the outputs of which it is good
    indices: dict[str, tuple[FloatArray, FloatArray]]
    #: how many cases, in words
    counts: str

    @property
    def remark(self) -> str:
        """Errors of the surrogate, in words."""
        if self.surrogate is None:
            return ""
        words = (
            f"{display_of(name).name} {percent(error)}{', not drawn' * (error > GOOD)}"
            for name, error in self.surrogate.relative_error.items()
            if error
        )
        return f"errors of the surrogate in left-out cases, of the spread: {'; '.join(words)}"


def choose(ensemble: Ensemble) -> Choice:
    """Return the choice of what is drawn of a sweep; refuse one without a case. Not collective."""
    cases, failed = np.flatnonzero(ensemble.done), ensemble.status.count("failed")
    counts = counted(len(ensemble.status), "case") + (f", {failed} failed" if failed else "")
    if not len(cases):
        raise InputError(
            f"{ensemble.path}: has no case that is done ({counts}); must have one at least"
        )
    outputs = figure_columns(ensemble.final, cases)
    varied = factors_of(ensemble, cases)
    keys = [key for key in varied if key.differs] or varied
    made, absence = None, ""
    indices: dict[str, tuple[FloatArray, FloatArray]] = {}
    try:
        complete = [name for name in outputs if np.isfinite(ensemble.final[name][cases]).all()]
        made = surrogate(ensemble, complete)
        if len(made.factors) > 1:
            good = (name for name, error in made.relative_error.items() if 0.0 < error <= GOOD)
            indices = {name: made.sobol_indices(name) for name in good}
    except InputError as error:
        absence = str(error)
    return Choice(cases, outputs, keys, made, absence, indices, counts)


def effects(ensemble: Ensemble, choice: Choice) -> dict[tuple[str, str], Panel]:
    """Return the panels of final values by output and key."""
    return {
        (output, key.name): _effect(ensemble, choice, key, output)
        for key in choice.keys
        for output in choice.outputs
    }


def _effect(ensemble: Ensemble, choice: Choice, key: Factor, output: str) -> Panel:
    """Return the panel of an output against a key: curves in grids, else cases and their mean."""
    display, made = display_of(output), choice.surrogate
    label = f"final {display.label}" if output == "penetration" else display.label
    values = display.factor * ensemble.final[output][choice.cases]
    x = Axis(key.label, log=key.logarithmic, categories=tuple(map(raw_words, key.texts)))
    axes = x, value_axis(label, values), f"{label} over {key.label}"
    others = [other for other in choice.keys if other is not key]
    rows: dict[str, list[int]] = {}
    names = _names(others) or ["cases"] * len(values)
    for row in np.argsort(key.values, kind="stable").tolist():
        rows.setdefault(names[row], []).append(row)
    if ensemble.attributes["method"] == "grid" and len(rows) <= _MOST_CURVES:
        curves = [
            Curve(key.values[rows[name]], values[rows[name]], name, COLOURS[i % len(COLOURS)], i,
                  marked=True)
            for i, name in enumerate(dict.fromkeys(names))
        ]  # fmt: skip
        return Panel(*axes, curves=curves, legend=",\n".join(other.label for other in others))
    points = [_points(key, values)]
    if made is None or not 0.0 < made.relative_error.get(output, 0.0) <= GOOD:
        return Panel(*axes, points=points)
    along, mean = made.mean_along(key.name, output)
    error = 2.0 * made.error[output]
    shifted = np.clip([mean - error, mean, mean + error], *made.responses[output].limits)
    low, mean, high = display.factor * shifted
    name = "surrogate, mean over the other keys"
    if key.texts:
        ends = np.stack([mean - low, high - mean])
        level = Points(along, mean, name, COLOURS[0], 20.0, marker="level", errors=ends)
        return Panel(*axes, points=[*points, level])
    interval = "\N{PLUS-MINUS SIGN} 2 errors in left-out cases"
    band = Band(along, low, high, interval, COLOURS[1], 0.5)
    return Panel(*axes, curves=[Curve(along, mean, name, COLOURS[0])], bands=[band], points=points)


def _points(key: Factor, values: FloatArray) -> Points:
    """Return a point for each case, or for some of many."""
    rows = chosen_cases(np.arange(len(values)), _MOST_POINTS)
    x, size = key.values[rows], float(np.clip(_SIZE / np.sqrt(len(rows)), 2.8, 6.0))
    if key.texts:
        x = x + np.random.default_rng(SEED).uniform(-_ASIDE, _ASIDE, len(x))
    name = f"{len(rows)} of {len(values)} cases" if len(rows) < len(values) else "cases"
    return Points(x, values[rows], name, GREY, size)


def value_axis(label: str, values: FloatArray) -> Axis:
    """Return the axis of an output: logarithmic, or wider than round-off."""
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    if low > 0.0 and high >= _LOG_VALUE * low:
        return Axis(label, (0.5 * low, 2.0 * high), log=True)
    wider = 0.5 * (_LEAST_SPAN * max(abs(low), abs(high)) - (high - low))
    return Axis(label, (low - wider, high + wider) if wider > 0.0 else None)


def index_panels(choice: Choice) -> dict[str, Panel]:
    """Return the bars of Sobol' indices by output."""
    panels = {}
    for output, (first, total) in choice.indices.items():
        assert choice.surrogate is not None
        places = np.arange(len(first), dtype=float)
        bars = [
            Bars(places - 0.17, first, _FIRST, COLOURS[0]),
            Bars(places + 0.17, total, _TOTAL, COLOURS[1]),
        ]
        categories = tuple(map(quantity_name, choice.surrogate.ranges))
        x = Axis("Sobol' index", ends=(0.0, 1.05))
        y = Axis("", categories=categories, reversed=True)
        name = f"final {display_of(output).name}"
        panels[output] = Panel(x, y, f"Sobol' indices of the {name}", bars=bars, legend=name)
    return panels


def histories(ensemble: Ensemble, choice: Choice) -> Panel:
    """Return the penetration over time: a line for each case, or a fan of quantiles."""
    cases = chosen_cases(choice.cases, _MOST_HISTORIES)
    counts = ensemble.steps_stored[cases].tolist()
    times, depths = (ensemble.histories(name, cases) for name in ("time", "penetration"))
    unit, seconds = time_unit(float(np.nanmax(times)))
    lines = [
        (time[:count] / seconds, 1e3 * depth[:count])
        for time, depth, count in zip(times, depths, counts, strict=True)
    ]
    x, label = Axis(f"time ({unit})", zero=True), display_of("penetration").label
    if len(cases) > _FEW:
        return _fan(lines, x, label, len(choice.cases))
    names, legend = [ensemble.ids[case] for case in cases], "case"
    keys = [key for key in choice.keys if key.differs]
    if 0 < len(keys) <= _NAMED_KEYS:
        names, legend = _names(keys), ",\n".join(key.label for key in keys)
    curves = [
        Curve(*line, name, COLOURS[i % len(COLOURS)], i // len(COLOURS))
        for i, (line, name) in enumerate(zip(lines, names, strict=True))
    ]
    title = "Penetration of each case"
    return Panel(x, Axis(label, zero=True), title, curves=curves, legend=legend)


def _fan(lines: list[tuple[FloatArray, FloatArray]], x: Axis, label: str, count: int) -> Panel:
    """Return quantiles of penetrations, as long as half of the cases last, and some of these.

    Lines are times and penetrations of some or all of so many cases.
    """
    last = max(time[-1] for time, _ in lines) * (1.0 - 1e-9)  # all but round-off
    time = np.linspace(0.0, last, _TIMES)
    depth = np.array([np.interp(time, *line, right=np.nan) for line in lines])
    ends = np.array([line[-1] for _, line in lines])
    rows = np.argsort(ends)[np.unique(np.linspace(0, len(ends) - 1, _LINES).astype(int))]
    singles = f"{len(rows)} of the cases"
    curves = [Curve(time, depth[row], singles, GREY, 0, 0.8) for row in rows]
    known = np.isfinite(depth).sum(axis=0) >= 0.5 * len(depth)
    low, lower, median, upper, high = np.nanquantile(depth[:, known], _QUANTILES, axis=0)
    time = time[known]
    bands = [
        Band(time, low, high, "5\N{EN DASH}95 %", COLOURS[0], 0.16),
        Band(time, lower, upper, "25\N{EN DASH}75 %", COLOURS[0], 0.3),
    ]
    curves.append(Curve(time, median, "median", COLOURS[0], 0, 2.5))
    chosen = f"{len(ends)} of {count} cases, chosen at random" if len(ends) < count else ""
    title = f"Penetration: quantiles of {len(ends)} cases, {singles} from the least to the deepest"
    y = value_axis(label, ends)
    y = y if y.log else Axis(label, zero=True)
    return Panel(x, y, title, curves=curves, bands=bands, legend=chosen)


# -- words -----------------------------------------------------------------------------------------


class Display(NamedTuple):
    """How a number is drawn: times a factor, and under which name, with its unit."""

    factor: float
    name: str
    unit: str

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})"


#: words for names that do not speak for themselves, without their bodies
_WORDS = {
    "mean_wear_rate": "mean rate",
    "sliding_distance": "distance",
    "pressure_velocity": "p V",
    "share_through": "share worn through",
    "time_through": "worn through from",
    "least_layer_left": "least left of layers",
    "max_mises": "largest von Mises stress",
    "max_mises_r": "its radius",
    "max_mises_z": "its height",
    "max_mises_layer": "its layer",
    "mises": "von Mises stress",
    "max_shear": "largest shear stress",
}
_UNITS = DISPLAY_UNITS | {"share_through": ("%", 100.0), "least_layer_left": ("um", 1e3)}


def display_of(name: str) -> Display:
    """Return how a number is drawn: its name, then its body, then its entry."""
    column, variable, entry = end_value_of(name)
    words = column.removesuffix("_layers")
    body = words.rpartition("_")[2]
    body = body if body in BODIES else ""
    words = words.removesuffix(f"_{body}")
    unit, factor = _UNITS.get(words, (variable.unit, 1.0))
    parts = [_WORDS.get(words, words.replace("_", " ")), body, entry]
    return Display(factor, ", ".join(filter(None, parts)), in_signs(unit))


def figure_columns(final: Mapping[str, Any], cases: IntArray) -> list[str]:
    """Return the numbers of some cases that figures draw.

    Volumes of bodies that wear in some of them, or of the lower one; shares worn through, where
    there are some; the largest stress. Numbers of each layer and point would make figures too
    long to read.
    """
    volumes = ("worn_volume_lower", "worn_volume_upper")
    worn = [name for name in volumes if np.nan_to_num(final[name][cases]).any()]
    through = [name for name in LAYER_HISTORIES if np.nan_to_num(final.get(name, [])).any()]
    stress = [STRESS_STATES] if STRESS_STATES in final else []
    return ["penetration", *(worn or ["worn_volume_lower"]), *through, *stress]


def raw_words(text: str) -> str:
    """Return a raw value of a key, as studies store it, in few words."""
    return in_words(parse_value(text)) if text else "none"


def _names(keys: Sequence[Factor]) -> list[str]:
    """Return the values of some keys in each case, as short as those of a key stay apart."""

    def words(key: Factor) -> list[str]:
        if key.texts:
            return [raw_words(key.texts[int(number)]) for number in key.values]
        count = len(np.unique(key.values))
        every = ([number_text(value, digits) for value in key.values] for digits in range(3, 18))
        return next((texts for texts in every if len({*texts}) == count), [*map(str, key.values)])

    return [", ".join(row) for row in zip(*map(words, keys), strict=True)]
