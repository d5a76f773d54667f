"""Final values of a sweep against each key, and how much each key matters, as panels.

Two rules: in a grid, a curve for each combination of the other keys, where these are few; in any
other case a point for each case, and the surrogate's mean over the other keys where it is good.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.schema import quantity_name
from ringwear_par.errors import InputError, counted
from ringwear_par.pictures.panel import GREY, Axis, Band, Bars, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.studies.end_values import display_of, figure_columns, final_name
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.factors import Factor
from ringwear_par.studies.surrogate import (
    GOOD,
    SEED,
    Indices,
    Surrogate,
    chosen_cases,
    done_cases,
    share_words,
    sobol_indices,
    surrogate,
)

#: most keys, curves of a panel and cases with a point that are drawn
_MOST_KEYS, _MOST_CURVES, _MOST_POINTS = 8, 8, 1000
#: largest over smallest value above which an axis of values is logarithmic
LOG_VALUE = 100.0
#: pixels of a point times the square root of the number of points
_SIZE = 64.0
#: distance from the place of a category over which its cases are spread
_ASIDE = 0.2
#: least range of an axis over the size of its values: smaller variations are round-off
_LEAST_SPAN = 1e-3
_FIRST, _TOTAL = "first order S\N{SUBSCRIPT ONE}", "total S\N{LATIN SUBSCRIPT SMALL LETTER T}"


def spans(values: FloatArray, ratio: float) -> bool:
    """Tell whether values ask for a logarithmic axis."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and finite.min() > 0.0 and finite.max() >= ratio * finite.min())


@dataclass(frozen=True)
class Choice:
    """What is drawn of a sweep."""

    #: numbers of the cases that are done
    cases: IntArray
    #: names of final values
    outputs: list[str]
    #: the varied keys, and those of the largest indices, which are drawn
    varied: list[Factor]
    keys: list[Factor]
    #: whether the design is one
    grid: bool
    #: None: there is none, for a reason
    surrogate: Surrogate | None
    absence: str
    #: of the outputs of which the surrogate is good
    indices: tuple[Indices, ...]
    #: how many cases and keys, in words
    counts: str

    @property
    def pointed(self) -> IntArray:
        """The rows of the cases with a point each: all of them, or some chosen at random."""
        return chosen_cases(np.arange(len(self.cases)), _MOST_POINTS)

    def remarks(self) -> list[str]:
        """Return what is to be said of the panels, in sentences."""
        remarks = []
        if self.surrogate is not None:
            shares = {n: e for n, e in self.surrogate.relative_error.items() if e}
            words = (
                f"{display_of(name).name} {share_words(error)}"
                + (", not drawn" if error > GOOD else "")
                for name, error in shares.items()
            )
            remarks.append(
                f"surrogate of {len(self.surrogate.points)} cases; keys vary evenly over their "
                f"ranges; errors in left-out cases, of the spread: {'; '.join(words)}"
            )
        if len(self.pointed) < len(self.cases):
            remarks.append(f"{len(self.pointed)} of {len(self.cases)} cases have points, by chance")
        return remarks


def choose(ensemble: Ensemble) -> Choice:
    """Return the choice of what is drawn of a sweep; refuse one without a case. Not collective."""
    cases, counts = np.flatnonzero(done_cases(ensemble)), _counts(ensemble)
    if not len(cases):
        raise InputError(
            f"{ensemble.path}: has no case that is done ({counts}); must have one at least"
        )
    outputs = figure_columns(ensemble.final, cases)
    varied = [Factor.of(ensemble, name, cases) for name in ensemble.varied]
    varied = [key for key in varied if key.differs] or varied
    made, absence = None, ""
    try:
        made = surrogate(
            ensemble, [name for name in outputs if np.isfinite(ensemble.final[name][cases]).all()]
        )
    except InputError as error:
        absence = str(error)
    indices: list[Indices] = []
    if made is not None and len(made.factors) > 1:
        indices = [sobol_indices(made, name) for name in made.good]
    weights = {key.name: 0.0 for key in varied}
    for each in indices:
        for name, total in zip(each.keys, each.total.tolist(), strict=True):
            weights[name] = max(total, weights[name])
    names = sorted(weights, key=lambda name: -weights[name])[:_MOST_KEYS]
    keys = [key for key in varied if key.name in names]
    if len(keys) < len(varied):
        reason = "of the largest indices" if indices else "the first"
        counts += f"; {len(keys)} of {len(varied)} keys, {reason}"
    grid = ensemble.attributes.get("method") == "grid"
    return Choice(cases, outputs, varied, keys, grid, made, absence, tuple(indices), counts)


def _counts(ensemble: Ensemble) -> str:
    """Return in words how many cases there are, and how many of them failed."""
    failed = ensemble.status.count("failed")
    return counted(len(ensemble.status), "case") + (f", {failed} failed" if failed else "")


def effects(ensemble: Ensemble, choice: Choice) -> dict[tuple[str, str], Panel]:
    """Return the panels of final values by output and key."""
    return {
        (output, key.name): _effect(ensemble, choice, key, output)
        for key in choice.keys
        for output in choice.outputs
    }


def _effect(ensemble: Ensemble, choice: Choice, key: Factor, output: str) -> Panel:
    """Return the panel of an output against a key."""
    display = display_of(output)
    label = f"final {display.label}" if output == "penetration" else display.label
    values = display.factor * ensemble.final[output][choice.cases]
    others = [other for other in choice.varied if other is not key and other.differs]
    curves = _curves(key, others, values) if choice.grid else []
    axes = (
        Axis(key.label, log=key.logarithmic, categories=key.categories), _value_axis(label, values),
    )  # fmt: skip
    title = f"{label} over {key.label}"
    if curves:
        legend = ",\n".join(other.label for other in others)
        return Panel(*axes, title, curves=curves, legend=legend)
    points, bands = [_points(key, values, choice.pointed)], []
    made = choice.surrogate
    if made is not None and output in made.good:
        along, mean = made.mean_along(key.name, output)
        shifted = (made.responses[output].shifted(mean, errors) for errors in (-2.0, 0.0, 2.0))
        low, mean, high = (display.factor * each for each in shifted)
        name = "surrogate, mean over the other keys"
        interval = "\N{PLUS-MINUS SIGN} 2 errors in left-out cases"
        if key.texts:
            width = np.stack([mean - low, high - mean])
            (texts,) = (factor.texts for factor in made.factors if factor.name == key.name)
            places = np.array([float(key.texts.index(texts[int(number)])) for number in along])
            points.append(
                Points(places, mean, name, COLOURS[0], 20.0, marker="level", errors=width)
            )
        else:
            along, ends = along / key.scale, (f"{interval}, from", f"{interval}, to")
            bands = [Band(along, low, high, interval, ends, COLOURS[1], 0.5)]
            curves = [Curve(along, mean, name, COLOURS[0])]
    return Panel(*axes, title, curves=curves, bands=bands, points=points)


def _curves(key: Factor, others: Sequence[Factor], values: FloatArray) -> list[Curve]:
    """Return a curve for each combination of the other keys; none of many."""
    words = zip(*(other.words() for other in others), strict=True)
    names = [", ".join(row) for row in words] or ["cases"] * len(values)
    known = np.flatnonzero(np.isfinite(key.values))
    rows: dict[str, list[int]] = {names[row]: [] for row in known}
    for row in known[np.argsort(key.values[known], kind="stable")]:
        rows[names[row]].append(row)
    if len(rows) > _MOST_CURVES:
        return []
    return [
        Curve(
            key.values[row] / key.scale,
            values[row],
            name,
            COLOURS[i % len(COLOURS)],
            i,
            marked=True,
        )
        for i, (name, row) in enumerate(rows.items())
    ]


def _points(key: Factor, values: FloatArray, rows: IntArray) -> Points:
    """Return a point for each of some cases."""
    x, size = key.values[rows] / key.scale, float(np.clip(_SIZE / np.sqrt(len(rows)), 2.8, 6.0))
    if key.texts:
        x = x + np.random.default_rng(SEED).uniform(-_ASIDE, _ASIDE, len(x))
    known = np.isfinite(x)
    return Points(x[known], values[rows][known], "cases", GREY, size, behind=True)


def _value_axis(label: str, values: FloatArray) -> Axis:
    """Return the axis of an output: logarithmic, or wider than round-off."""
    values = values[np.isfinite(values)]
    if not len(values):
        return Axis(label)
    low, high = float(values.min()), float(values.max())
    if spans(values, LOG_VALUE):
        return Axis(label, (0.5 * low, 2.0 * high), log=True)
    wider = 0.5 * (_LEAST_SPAN * max(abs(low), abs(high)) - (high - low))
    return Axis(label, (low - wider, high + wider) if wider > 0.0 else None)


def index_panels(choice: Choice) -> dict[str, Panel]:
    """Return the bars of Sobol' indices by output, of the keys that are drawn."""
    panels = {}
    for each in choice.indices:
        rows = [each.keys.index(key.name) for key in choice.keys if key.name in each.keys]
        places = np.arange(len(rows), dtype=float)
        bars = [
            Bars(places + aside, values[rows], name, colour)
            for aside, values, name, colour in (
                (-0.17, each.first, _FIRST, COLOURS[0]), (0.17, each.total, _TOTAL, COLOURS[1]),
            )
        ]  # fmt: skip
        categories = tuple(quantity_name(each.keys[i]) for i in rows)
        panels[each.output] = Panel(
            Axis("Sobol' index", ends=(0.0, 1.05)),
            Axis("", categories=categories, reversed=True),
            f"Sobol' indices of the {final_name(each.output)}", bars=bars,
            legend=final_name(each.output),
        )  # fmt: skip
    return panels
