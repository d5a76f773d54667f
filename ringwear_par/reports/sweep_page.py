"""The page of a sweep."""

from collections import Counter
from pathlib import Path

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.schema import quantity_label
from ringwear_par.cases.units import in_signs
from ringwear_par.errors import legible
from ringwear_par.reports import blocks as page
from ringwear_par.results.key_numbers import number_words
from ringwear_par.studies.ensemble import Ensemble, count_flags, end_value_of, read_ensemble
from ringwear_par.studies.pictures import (
    Choice,
    choose,
    display_of,
    effects,
    figure_columns,
    histories,
    index_panels,
    raw_words,
)
from ringwear_par.studies.variations import own_key

#: most cases of the table
_MOST = 30
#: digits of a number in a table
_DIGITS = 4


def sweep_page(folder: Path) -> page.Page:
    """Return the page of a sweep's folder. Not collective.

    Raises
    ------
    InputError : the folder holds no results.
    """
    ensemble = read_ensemble(folder)
    sections = [page.Section("Summary", _summary(ensemble))]
    if ensemble.done.any():
        choice = choose(ensemble)
        sections.append(page.Section("Histories", [_histories(ensemble, choice)]))
        sections.append(page.Section("Final values", _effects(ensemble, choice)))
        absence = "No Sobol' indices: they need two varied keys, and a good surrogate."
        blocks: list[page.Block] = [page.Lines([absence])]
        if choice.indices:
            blocks = [_index_charts(choice), *_index_tables(choice)]
        sections.append(page.Section("Sensitivity", blocks))
    sections.append(page.Section("Cases", [_cases(ensemble)]))
    sections.append(_reproduced(ensemble))
    return page.Page("Sweep of a study", f"Sweep: {legible(folder.resolve().name)}", sections)


def _summary(ensemble: Ensemble) -> list[page.Block]:
    total, status = len(ensemble.ids), Counter(ensemble.status)
    doubts = [count_flags(ensemble.flags)] if any(ensemble.flags) else []
    if status["failed"]:
        doubts.append(f"{status['failed']} of {total} cases failed; the table of cases has why")
    counts = ", ".join(f"{number} {word}" for word, number in status.most_common())
    method = ensemble.attributes["method"]
    lines = [f"{total} cases ({counts}); design: {method}; the sweep is "
             f"{ensemble.attributes['status']}"]  # fmt: skip
    done = ensemble.done
    blocks: list[page.Block] = [_tiles(ensemble, done, total, len(doubts))]
    if doubts:
        blocks.append(page.Lines(doubts, warning=True))
    ranges, fixed = _ranges(ensemble)
    if fixed:
        lines.append(f"the same in all cases: {', '.join(fixed)}")
    blocks += [page.Lines(lines), ranges]
    if done.any():
        rows = [
            (
                end_value_of(name)[1].meaning.replace(", at the last stored step", ""),
                in_signs(display_of(name).unit),
                *map(_number, display_of(name).factor * _quantiles(values[done])),
            )
            for name, values in ensemble.final.items()
            if np.isfinite(values[done]).any()
        ]
        header = ("at the end", "unit", "least", "median", "largest")
        blocks.append(page.Table("Final values of all cases", header, rows))
    return blocks


def _quantiles(values: FloatArray) -> FloatArray:
    """Return the least, median and largest value, of those that there are."""
    quantiles: FloatArray = np.nanquantile(values, [0.0, 0.5, 1.0])
    return quantiles


def _tiles(ensemble: Ensemble, done: BoolArray, total: int, doubts: int) -> page.Tiles:
    """Return the answers of a sweep: medians and ranges of what its figure draws."""
    tiles = [page.Tile("cases done", str(int(done.sum())), f"of {total}")]
    names = figure_columns(ensemble.final, np.flatnonzero(done)) if done.any() else []
    for name in names:
        display = display_of(name)
        low, middle, high = map(
            number_words, display.factor * _quantiles(ensemble.final[name][done])
        )
        note = f"median; {low} to {high}"
        tiles.append(page.Tile(f"final {display.name}", middle, in_signs(display.unit), note))
    return page.Tiles([*tiles, page.checks_tile(doubts)])


def _ranges(ensemble: Ensemble) -> tuple[page.Table, list[str]]:
    """Return the keys that differ between cases, and those of the study that do not."""
    rows, fixed = [], []
    for name, values in ensemble.varied.items():
        meaning, unit = own_key(name).meaning, ensemble.units[name]
        if values.dtype.kind == "f":
            known = values[np.isfinite(values)]
            ends = [_number(v) for v in (known.min(), known.max())] if len(known) else ["", ""]
            count = len(np.unique(known))
        else:
            words = list(dict.fromkeys(values))
            ends, count = [raw_words(w) for w in (words[0], words[-1])], len(words)
        if count > 1:
            rows.append((name, in_signs(unit), meaning, *ends, str(count)))
        else:
            fixed.append(f"{name} = {ends[0]} {in_signs(unit)}".rstrip())
    header = ("key", "unit", "meaning", "least, or first", "largest, or last", "values")
    return page.Table("Varied keys", header, rows), fixed


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}" if np.isfinite(value) else ""


def _histories(ensemble: Ensemble, choice: Choice) -> page.Pictures:
    panel = histories(ensemble, choice)
    label = f"Line chart: {panel.y.label} over {panel.x.label}"
    return page.Pictures([page.chart(panel, label, 4.4, wide=True)])


def _index_charts(choice: Choice) -> page.Pictures:
    return page.Pictures([
        page.chart(
            panel, f"Bar chart: {panel.title}; the table has the numbers",
            1.4 + 0.45 * len(panel.y.categories),
        )
        for panel in index_panels(choice).values()
    ])  # fmt: skip


def _effects(ensemble: Ensemble, choice: Choice) -> list[page.Block]:
    charts = [
        page.chart(panel, f"Chart: {panel.title}") for panel in effects(ensemble, choice).values()
    ]
    lines = [choice.counts, *[choice.remark] * bool(choice.remark)]
    if choice.absence:
        lines.append(f"No surrogate: {choice.absence}")
    return [page.Lines(lines), page.Pictures(charts)]


def _index_tables(choice: Choice) -> list[page.Table]:
    tables = []
    for output, indices in choice.indices.items():
        assert choice.surrogate is not None
        rows = [
            (key, f"{first:.3f}", f"{total:.3f}")
            for key, first, total in zip(choice.surrogate.ranges, *indices, strict=True)
        ]
        header = ("key", "first order: by the key alone", "total: with all others")
        caption = f"Sobol' indices of the final {display_of(output).name}, from the surrogate"
        tables.append(page.Table(caption, header, rows))
    return tables


def _cases(ensemble: Ensemble) -> page.Table:
    """Return the table of all cases, or of the worst of many, failed ones with why."""
    total = len(ensemble.ids)
    worst = worst_cases(ensemble)[:_MOST]
    caption = f"{total} cases" if total <= _MOST else f"The {_MOST} worst of {total} cases"
    caption += ": those that failed, then those with most warnings, then by penetration"
    return _case_table(ensemble, worst, f"{caption}; cases.csv has all")


def worst_cases(ensemble: Ensemble) -> IntArray:
    """Return the numbers of cases, (cases,), the worst first: see the caption of their table."""
    depths = np.nan_to_num(ensemble.final["penetration"])
    counts = np.array([len(flags.split(", ")) if flags else 0 for flags in ensemble.flags])
    return np.lexsort((-depths, -counts, ensemble.done))


def _case_table(ensemble: Ensemble, tabulated: IntArray, caption: str) -> page.Table:
    """Return a table of some cases."""
    displays = {name: display_of(name) for name in ensemble.final}
    header = ["case", "status", *(quantity_label(*entry) for entry in ensemble.units.items())]
    header += [display.label for display in displays.values()]
    remarks = {
        "flags": [flags.replace("_", " ") for flags in ensemble.flags],
        "error": ensemble.error,
    }
    remarks = {name: texts for name, texts in remarks.items() if any(texts[i] for i in tabulated)}
    header += remarks
    rows = []
    for i in tabulated.tolist():
        values = [
            _number(column[i]) if column.dtype.kind == "f" else raw_words(column[i])
            for column in ensemble.varied.values()
        ]
        ends = [_number(d.factor * ensemble.final[name][i]) for name, d in displays.items()]
        words = [texts[i] for texts in remarks.values()]
        rows.append((ensemble.ids[i], ensemble.status[i], *values, *ends, *words))
    return page.Table(caption, header, rows)


def _reproduced(ensemble: Ensemble) -> page.Section:
    about = ensemble.attributes
    commands = (
        "ringwear sweep study.toml -o out/study\nringwear report out/study -o report.html\n"
        "ringwear plot out/study -o study.png\n"
    )
    first = (
        "Save the study as study.toml beside the case file that it names, whose keys are below; "
        "those that vary have their values in the table of cases. Then type:"
    )
    sources = [page.Source("Study", str(about["study"]))]
    sources.append(page.Source("Base case", str(about["case"])))
    return page.reproduced(first, commands, sources, page.stored_versions(about))
