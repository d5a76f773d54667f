"""``rw.plot``: the figure of a sweep, from its stored results, or of other results.

Histories; final values against each key; how much each key matters. Two rules choose what is drawn
of final values: in a grid, a curve for each combination of the other keys, where these are few; in
any other case a point for each case, and the surrogate's mean over the other keys where it is good.
"""

import logging
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.schema import quantity_name
from ringwear_par.errors import InputError, counted
from ringwear_par.files.folders import refuse_drawn
from ringwear_par.files.text import parse_value
from ringwear_par.pictures import figures
from ringwear_par.pictures.matplotlib import (
    add_letters,
    add_shared_legend,
    draw,
    legend_entries,
    legend_shape,
)
from ringwear_par.pictures.panel import GREY, Axis, Band, Bars, Curve, Panel, Points
from ringwear_par.pictures.rig import draw_rig
from ringwear_par.pictures.style import (
    COLOURS,
    STYLE,
    NotebookFigure,
    check_format,
    in_words,
    number_text,
    of_width,
    plain,
    save_figure,
)
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.result import Result
from ringwear_par.studies.end_values import display_of, figure_columns, final_name
from ringwear_par.studies.ensemble import Ensemble, Factor, factors_of, read_ensemble
from ringwear_par.studies.surrogate import (
    GOOD,
    SEED,
    Surrogate,
    chosen_cases,
    share_words,
    surrogate,
)

log = logging.getLogger(__name__)

#: most keys, curves of a panel and cases with a point that are drawn
_MOST_KEYS, _MOST_CURVES, _MOST_POINTS = 8, 8, 1000
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
#: most panels in a row, and inches of a panel and of a line of a legend
_COLUMNS, _PANEL, _LINE = 4, (2.3, 2.1), 0.18
#: letters of a line in a title, of a legend for each inch, and of a label along a panel's height
_TITLE_LETTERS, _LEGEND_LETTERS, _LABEL_LETTERS = 100, 14, 26


def plot(
    results: Case | figures.Source | Sequence[figures.Source],
    panels: str | Sequence[str] | None = None,
    steps: str = "",
    profiles_of: Sequence[figures.Source] = (),
    times: str = "",
    width: float | None = None,
) -> Figure:
    """Return the panels of results side by side, the figure of a sweep, or the rig of a case.

    Not collective. Profiles (``wear``, ``pressure``) and deformed sections (``section``, the last
    one stored) are drawn of every result, one panel each; the histories of all of them share a
    panel (``penetration``, ``approach``, ``force``, ``torque``, ``energy``, ``volume``, ``rate``,
    ``pv``).

    Parameters
    ----------
    results : a result or a result file, or several; the folder of a sweep; or a case or its file,
        whose rig is drawn as a section through the axis.
    panels : names, in a list or separated by commas; None for wear and penetration.
    steps : comma-separated step numbers of the profiles.
    profiles_of : those of the results whose profiles and sections are drawn; () for all.
    times : comma-separated times of the profiles, s or with a unit ("1 h"), instead of steps; the
        stored states nearest to them are drawn. Without either: the first step and four quarters.

    width : mm, of the figure; None: what suits it.

    Returns
    -------
    matplotlib.figure.Figure : it belongs to no window; ``.savefig`` writes it.

    Raises
    ------
    InputError : something that is not a result, an unknown panel, a step not stored; more than its
        folder where a sweep is drawn; the folder of a fit or a design, which has its pictures.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> result = rw.simulate(rw.read_case("scripts/cases/paper.toml"))
    >>> rw.plot(result, "wear,pressure", times="1 s, 200 s").savefig("run.png")
    """
    if isinstance(results, Case):
        return of_width(draw_rig(results), width)
    several = [results] if isinstance(results, Result | str | Path) else results
    sources = several if isinstance(several, Sequence) else ()
    for path in (Path(source) for source in sources if isinstance(source, str | Path)):
        if not path.is_dir() and path.suffix != ".toml":
            continue
        refuse_drawn(path)
        if len(sources) > 1 or panels is not None or steps or times or profiles_of:
            raise InputError(
                f"{path}: a folder or a case must be drawn alone, without other options"
            )
        if path.is_dir():
            return of_width(draw_sweep(read_ensemble(path)), width)
        return of_width(draw_rig(read_case(path)), width)
    return figures.plot(several, panels or figures.DEFAULT, steps, profiles_of, times, width)


def plot_stored(
    results: Sequence[Path], output: Path, dpi: float | None = None, **choices: Any
) -> None:
    """Write the picture of runs, of a sweep or of the rig of a case; see ``plot``. On one rank.

    The ending of the output chooses the format; dpi are the points of an inch, where it has such.
    """
    check_format(output)
    figure = plot(results, **{name: choice for name, choice in choices.items() if choice})
    save_figure(figure, output, dpi)


# -- what is drawn of a sweep -----------------------------------------------------------------------


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
    #: first-order and total Sobol' indices of its factors, of the outputs of which it is good
    indices: dict[str, tuple[FloatArray, FloatArray]]
    #: how many cases and keys, in words
    counts: str

    @property
    def remark(self) -> str:
        """Errors of the surrogate, in words."""
        if self.surrogate is None:
            return ""
        words = (
            f"{display_of(name).name} {share_words(error)}{', not drawn' * (error > GOOD)}"
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
    varied = [key for key in varied if key.differs] or varied
    made, absence = None, ""
    indices: dict[str, tuple[FloatArray, FloatArray]] = {}
    weights = {key.name: 0.0 for key in varied}
    try:
        complete = [name for name in outputs if np.isfinite(ensemble.final[name][cases]).all()]
        made = surrogate(ensemble, complete)
        if len(made.factors) > 1:
            indices = {name: made.sobol_indices(name) for name in made.good}
        for _, total in indices.values():
            for name, weight in zip(made.ranges, total.tolist(), strict=True):
                weights[name] = max(weight, weights[name])
    except InputError as error:
        absence = str(error)
    names = sorted(weights, key=lambda name: -weights[name])[:_MOST_KEYS]
    keys = [key for key in varied if key.name in names]
    if len(keys) < len(varied):
        reason = "of the largest indices" if indices else "the first"
        counts += f"; {len(keys)} of {len(varied)} keys, {reason}"
    grid = ensemble.attributes.get("method") == "grid"
    return Choice(cases, outputs, varied, keys, grid, made, absence, indices, counts)


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
    x = Axis(key.label, log=key.logarithmic, categories=_categories(key))
    axes = x, value_axis(label, values), f"{label} over {key.label}"
    others = [other for other in choice.varied if other is not key and other.differs]
    curves = _curves(key, others, values) if choice.grid else []
    if curves:
        return Panel(*axes, curves=curves, legend=",\n".join(other.label for other in others))
    points, bands = [_points(key, values)], []
    made = choice.surrogate
    if made is not None and output in made.good:
        along, mean = made.mean_along(key.name, output)
        shifted = (made.responses[output].shifted(mean, errors) for errors in (-2.0, 0.0, 2.0))
        low, mean, high = (display.factor * each for each in shifted)
        name = "surrogate, mean over the other keys"
        if key.texts:
            ends = np.stack([mean - low, high - mean])
            level = Points(along, mean, name, COLOURS[0], 20.0, marker="level", errors=ends)
            points.append(level)
        else:
            interval = "\N{PLUS-MINUS SIGN} 2 errors in left-out cases"
            names = f"{interval}, from", f"{interval}, to"
            bands = [Band(along, low, high, interval, names, COLOURS[1], 0.5)]
            curves = [Curve(along, mean, name, COLOURS[0])]
    return Panel(*axes, curves=curves, bands=bands, points=points)


def _curves(key: Factor, others: Sequence[Factor], values: FloatArray) -> list[Curve]:
    """Return a curve for each combination of the other keys; none of many."""
    names = _names(others) or ["cases"] * len(values)
    rows: dict[str, list[int]] = {name: [] for name in names}
    for row in np.argsort(key.values, kind="stable").tolist():
        rows[names[row]].append(row)
    if len(rows) > _MOST_CURVES:
        return []
    return [
        Curve(key.values[row], values[row], name, COLOURS[i % len(COLOURS)], i, marked=True)
        for i, (name, row) in enumerate(rows.items())
    ]


def _points(key: Factor, values: FloatArray) -> Points:
    """Return a point for each case, or for some of many."""
    rows = chosen_cases(np.arange(len(values)), _MOST_POINTS)
    x, size = key.values[rows], float(np.clip(_SIZE / np.sqrt(len(rows)), 2.8, 6.0))
    if key.texts:
        x = x + np.random.default_rng(SEED).uniform(-_ASIDE, _ASIDE, len(x))
    name = f"{len(rows)} of {len(values)} cases" if len(rows) < len(values) else "cases"
    return Points(x, values[rows], name, GREY, size, behind=True)


def value_axis(label: str, values: FloatArray) -> Axis:
    """Return the axis of an output: logarithmic, or wider than round-off."""
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    if low > 0.0 and high >= _LOG_VALUE * low:
        return Axis(label, (0.5 * low, 2.0 * high), log=True)
    wider = 0.5 * (_LEAST_SPAN * max(abs(low), abs(high)) - (high - low))
    return Axis(label, (low - wider, high + wider) if wider > 0.0 else None)


def index_panels(choice: Choice) -> dict[str, Panel]:
    """Return the bars of Sobol' indices by output, of the keys that are drawn."""
    panels = {}
    for output, (first, total) in choice.indices.items():
        assert choice.surrogate is not None
        names = [factor.name for factor in choice.surrogate.factors]
        rows = [names.index(key.name) for key in choice.keys if key.name in names]
        places = np.arange(len(rows), dtype=float)
        bars = [
            Bars(places - 0.17, first[rows], _FIRST, COLOURS[0]),
            Bars(places + 0.17, total[rows], _TOTAL, COLOURS[1]),
        ]
        categories = tuple(quantity_name(names[row]) for row in rows)
        x, y = (
            Axis("Sobol' index", ends=(0.0, 1.05)),
            Axis("", categories=categories, reversed=True),
        )
        title = f"Sobol' indices of the {final_name(output)}"
        panels[output] = Panel(x, y, title, bars=bars, legend=final_name(output))
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
    keys = [key for key in choice.keys if key.differs]
    names, legend = [ensemble.ids[case] for case in cases], "case"
    if 0 < len(keys) <= _NAMED_KEYS:
        names = _names(keys)
        legend = ",\n".join(key.label for key in keys)
    curves = [
        Curve(*line, name, COLOURS[i % len(COLOURS)], i // len(COLOURS))
        for i, (line, name) in enumerate(zip(lines, names, strict=True))
    ]
    title = "Penetration of each case"
    return Panel(x, Axis(label, zero=True), title, curves=curves, legend=legend)


def _fan(lines: list[tuple[FloatArray, FloatArray]], x: Axis, label: str, count: int) -> Panel:
    """Return quantiles of penetrations, as long as half of the cases last, and some of these.

    Parameters
    ----------
    lines : times and penetrations of cases, which are some or all of ``count``.
    """
    last = max(time[-1] for time, _ in lines) * (1.0 - 1e-9)  # all but round-off
    time = np.linspace(0.0, last, _TIMES)
    depth = np.array([np.interp(time, *line, right=np.nan) for line in lines])
    ends = np.array([line[-1] for _, line in lines])
    rows = np.argsort(ends)[np.unique(np.linspace(0, len(ends) - 1, _LINES).astype(int))]
    singles = f"{len(rows)} of the cases"
    curves = [Curve(time, depth[row], singles, GREY, 0, 0.8, tabulated=False) for row in rows]
    known = np.isfinite(depth).sum(axis=0) >= 0.5 * len(depth)
    low, lower, median, upper, high = np.nanquantile(depth[:, known], _QUANTILES, axis=0)
    time = time[known]
    bands = [
        Band(time, low, high, "5\N{EN DASH}95 %", ("5 %", "95 %"), COLOURS[0], 0.16),
        Band(time, lower, upper, "25\N{EN DASH}75 %", ("25 %", "75 %"), COLOURS[0], 0.3),
    ]
    curves.append(Curve(time, median, "median", COLOURS[0], 0, 2.5))
    chosen = f"{len(ends)} of {count} cases, chosen at random" if len(ends) < count else ""
    title = f"Penetration: quantiles of {len(ends)} cases, {singles} from the least to the deepest"
    y = value_axis(label, ends)
    y = y if y.log else Axis(label, zero=True)
    return Panel(x, y, title, curves=curves, bands=bands, legend=chosen)


# -- words -----------------------------------------------------------------------------------------


def raw_words(text: str) -> str:
    """Return a raw value of a key, as studies store it, in few words."""
    return in_words(parse_value(text)) if text else "none"


def _categories(key: Factor) -> tuple[str, ...]:
    """Return the texts of a key in few words, numbered where these would be the same."""
    words = [raw_words(text) for text in key.texts]
    same = len(set(words)) < len(words)
    return tuple(f"{word} ({n})" if same else word for n, word in enumerate(words, 1))


def _words(key: Factor) -> list[str]:
    """Return a key's value in each case, as short as its values stay apart."""
    if key.texts:
        return [_categories(key)[int(number)] for number in key.values]
    count, words = len(np.unique(key.values)), list[str]()
    for digits in range(3, 18):
        words = [number_text(value, digits) for value in key.values]
        if len(set(words)) == count:
            break
    return words


def _names(keys: Sequence[Factor]) -> list[str]:
    """Return the values of some keys in each case."""
    return [", ".join(row) for row in zip(*map(_words, keys), strict=True)]


# -- the figure -------------------------------------------------------------------------------------


def draw_sweep(ensemble: Ensemble) -> Figure:
    """Return the figure of a sweep's results. Not collective."""
    choice = choose(ensemble)
    if choice.absence:
        log.info("no surrogate: %s", choice.absence)
    panels, bars = effects(ensemble, choice), [*index_panels(choice).values()]
    keys = [key.name for key in choice.keys]
    grids = [[[histories(ensemble, choice)]]]
    grids += [[bars[i : i + 3]] for i in range(0, len(bars), 3)]
    grids += [
        [[panels[output, key] for key in keys[i : i + _COLUMNS]] for output in choice.outputs]
        for i in range(0, len(keys), _COLUMNS)
    ]
    width = _PANEL[0] * max(3, *(len(row) for grid in grids for row in grid))
    letters = [int(_LEGEND_LETTERS * width / len(grid[0])) for grid in grids]
    heights = [
        _PANEL[1] * len(grid) + 0.4 + _LINE * max(legend_shape(panel, n)[1] for panel in grid[0])
        for grid, n in zip(grids, letters, strict=True)
    ]
    with matplotlib.rc_context(STYLE):
        figure = NotebookFigure(figsize=(width, sum(heights) + 0.5), layout="constrained")
        title = [choice.counts, *textwrap.wrap(choice.remark, _TITLE_LETTERS)]
        figure.suptitle("\n".join(map(plain, title)), fontsize=9.0)
        parts: Any = figure.subfigures(len(grids), 1, height_ratios=heights, squeeze=False)[:, 0]
        for part, grid, n in zip(parts, grids, letters, strict=True):
            _draw_grid(part, grid, n)
        add_letters(figure)
    return figure


def _draw_grid(part: Any, grid: Sequence[Sequence[Panel]], letters: int) -> None:
    """Draw rows of panels on the same scales: a column has one axis below, a row one on the left.

    Legends with a title stand above each column, others together above all.

    Parameters
    ----------
    letters : of a line of a column's legend.
    """
    sharey = "none" if grid[0][0].bars else "row"  # bars have ends, and would be reversed twice
    all_axes = part.subplots(len(grid), len(grid[0]), squeeze=False, sharex="col", sharey=sharey)
    entries: dict[str, Any] = {}
    for i, row in enumerate(grid):
        for j, (axes, panel) in enumerate(zip(all_axes[i], row, strict=True)):
            draw(axes, panel, legend_shape(panel, letters)[0] if panel.legend and not i else 0)
            if not panel.legend:
                entries |= legend_entries(axes)
            across = textwrap.fill(axes.get_xlabel(), _LEGEND_LETTERS * 2)
            axes.set_xlabel(across if i == len(grid) - 1 else "")
            axes.set_ylabel("" if j else textwrap.fill(axes.get_ylabel(), _LABEL_LETTERS))
            axes.tick_params(labelleft=not j)
            if not (panel.x.log or panel.x.categories):
                axes.locator_params(axis="x", nbins=4 if len(row) > 1 else 8)
    part.align_ylabels(all_axes[:, 0])
    add_shared_legend(part, entries)
