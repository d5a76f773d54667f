"""The page of a fit, and of the design of the next tests, from what their folders hold."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.cases.units import factor, in_signs, with_signs
from ringwear_par.errors import InputError, counted, legible
from ringwear_par.files import folders
from ringwear_par.files.text import read_text as read_file
from ringwear_par.identification import summary
from ringwear_par.identification.draws import read_draws
from ringwear_par.pictures import fit_panels, key_panels
from ringwear_par.pictures.panel import Panel
from ringwear_par.reports import blocks as page
from ringwear_par.results.files import reading
from ringwear_par.results.key_numbers import time_words
from ringwear_par.results.variables import SOFTWARE

_DASH = "\N{EN DASH}"
#: units of nuisances, after that of their readings
_PER = {"compliance": "/kN", "tilt": "/mm"}


def fit_page(folder: Path) -> page.Page:
    """Return the page of the folder of a fit, a design or both. Not collective.

    Raises
    ------
    InputError : it holds none, or a damaged one.
    """
    sections: list[page.Section] = []
    title = f"Fit: {legible(folder.resolve().name)}"
    if (folder / folders.FIT).exists():
        with stored_outcome(folder / folders.FIT, "the outcome of ringwear fit") as outcome:
            sections += _fitted(folder, outcome)
    else:
        title = f"Design: {legible(folder.resolve().name)}"
    if (folder / folders.DESIGN).exists():
        with stored_outcome(folder / folders.DESIGN, "the outcome of ringwear design") as outcome:
            sections.insert(max(len(sections) - 1, 0), _designed(outcome))
    kind = "Fit of a wear law" if title.startswith("Fit") else "Design of the next tests"
    return page.Page(kind, title, sections)


@contextmanager
def stored_outcome(path: Path, kind: str) -> Iterator[dict[str, Any]]:
    """Yield the content of a JSON file; an error while it is used means that it is damaged."""
    fault, text = f"{path}: is not {kind}, or is damaged", read_file(path)
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InputError(fault) from error
    if not isinstance(content, dict):
        raise InputError(fault)
    try:
        yield content
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(fault) from error


def _fitted(folder: Path, outcome: Mapping[str, Any]) -> list[page.Section]:
    sections = [page.Section("Summary", _summary(outcome))]
    level = float(outcome["level"])
    series, text, inputs = stored_readings(folder / folders.READINGS, level)
    draws = read_draws(folder / folders.POSTERIOR)
    samples = dict(zip(draws.keys, draws.material.T, strict=True))
    blocks = (
        page.Lines(_bands(level)),
        page.Pictures(_series_charts(series)),
        _series(outcome),
    )
    sections.append(page.Section("Data, model and residuals", blocks))
    if inputs:
        drawn = page.Pictures([page.chart(*of_input) for of_input in inputs])
        sections.append(page.Section("Measured inputs", [_inputs(outcome), drawn]))
    keys = [
        page.chart(panel, f"{panel.y.label} over {panel.x.label}; numbers above")
        for row in key_panels.fitted_keys(outcome, samples)
        for panel in row
    ]
    sections.append(page.Section("Draws of the keys", [page.Pictures(keys)]))
    if outcome["alternatives"]:
        sections.append(
            page.Section(
                "Other laws", [_cells("Laws compared", summary.LAWS, summary.law_rows(outcome))]
            )
        )
    sections.append(_reproduced(outcome, text))
    return sections


def _series(outcome: Mapping[str, Any]) -> page.Table:
    """Return the table of the series of all tests, with their nuisances."""
    header = ("series", "readings", "chi2", "unit", "fitted noise", "nuisances")
    rows = []
    for test, of_test in outcome["experiments"].items():
        for name, entry in of_test.items():
            limits, unit = entry.get("censored", 0), entry["unit"]
            notes = [counted(limits, "limit")] if limits else []
            for kind, found in outcome["nuisance"].get(test, {}).get(name, {}).items():
                note = f"{kind} {_with_sd(found, f' {unit}' + _PER.get(kind, ''))}"
                note += f" in {_with_sd(found['time'], ' s')}" if "time" in found else ""
                notes.append(note)
            noise, chi2 = f"{entry.get('sd', 0.0):.3g}", f"{entry['chi2']:.4g}"
            rows.append(
                (f"{test}, {name}", str(entry["n"] - limits), chi2 * (limits < entry["n"]), unit,
                 noise * ("sd" in entry), ", ".join(notes))
            )  # fmt: skip
    return _cells("Series", header, rows)


def _with_sd(entry: Mapping[str, Any], unit: str = "") -> str:
    """Return an estimate and its sd; None: the readings do not change it."""
    if entry["sd"] is None:
        return "not identified"
    return f"{entry['estimate']:.4g}{unit} (u = {entry['sd']:.2g})"


def _inputs(outcome: Mapping[str, Any]) -> page.Table:
    """Return the table of the measured inputs and their curves."""
    header = ("input", "readings", "curve from", "to", "unit", "readings off it, %", "scale")
    rows = [
        (f"{key} ({test})", str(entry["n"]), f"{min(entry['value']):.4g}",
         f"{max(entry['value']):.4g}", entry["unit"], f"{100.0 * entry['scatter']:.2g}",
         _with_sd(entry["scale"]) if "scale" in entry else "")
        for test, inputs in outcome["inputs"].items()
        for key, entry in inputs.items()
    ]  # fmt: skip
    return _cells("Readings and curves", header, rows)


def _summary(outcome: Mapping[str, Any]) -> list[page.Block]:
    parameters, level = outcome["parameters"], float(outcome["level"])
    lines = [
        f"{counted(outcome['n_data'], 'reading')}, {counted(len(parameters), 'parameter')}, "
        f"{outcome['histories']} histories, loss {outcome['loss']}",
        summary.goodness(outcome),
    ]
    header = ("check", "statistic", "limit", "outcome")
    blocks: list[page.Block] = [_tiles(outcome)]
    if doubts := [with_signs(doubt["text"]) for doubt in outcome["doubts"]]:
        blocks.append(page.Lines(doubts, warning=True))
    blocks += [page.Lines(lines), _estimates(parameters, level), *_scatter(outcome)]
    if random_wear := summary.process_lines(outcome):
        blocks.append(page.Lines([*map(with_signs, random_wear)]))
    if len(parameters) > 1:
        blocks.append(_correlations(outcome))
    blocks.append(page.Table("What was checked", header, summary.check_rows(outcome)))
    return blocks


def _tiles(outcome: Mapping[str, Any]) -> page.Tiles:
    """Return the tiles of a fit: its estimates, and whether it has doubts."""
    percent, tiles = f"{100 * outcome['level']:g} %", []
    for key, entry in outcome["parameters"].items():
        row = summary.key_rows(key, entry)[0]
        unlimited = [end is None for end in (row.low, row.high)]
        value, note = _number(row.estimate, row.digits), row.verdict
        if not any(unlimited):
            note = f"{row.ends} ({percent})"
        elif not all(unlimited):
            value, note = row.ends, f"{percent}, {note}"
        tiles.append(page.Tile(key, value, in_signs(row.unit), note))
    return page.Tiles([*tiles, page.checks_tile(len(outcome["doubts"]))])


def _estimates(parameters: Mapping[str, Any], level: float) -> page.Table:
    percent, header = f"{100 * level:g} %", ["key", "estimate", "sd", "unit"]
    header += [f"{percent} from", f"{percent} to", "verdict"]
    rows = [
        [row.label, _number(row.estimate, row.digits), _number(row.sd, 2), in_signs(row.unit),
         *(_number(end, row.digits) for end in (row.low, row.high)),
         row.verdict or with_signs(row.note)]
        for key, entry in parameters.items()
        for row in summary.key_rows(key, entry)
    ]  # fmt: skip
    return page.Table("Estimates", header, rows)


def _scatter(outcome: Mapping[str, Any]) -> list[page.Block]:
    """Return blocks about the specimens: intervals are of them, or of the material behind them."""
    parameters, level = outcome["parameters"], float(outcome["level"])
    scattering = {key: entry for key, entry in parameters.items() if entry["of"] == "material"}
    if not scattering:
        return [page.Lines([f"Intervals {summary.of_specimens(outcome)}"])]
    blocks: list[page.Block] = []
    for key, entry in scattering.items():
        sentences = "; ".join(summary.scatter_lines(entry, level))
        blocks.append(page.Lines([f"{key} of the material, {with_signs(sentences)}"]))
        panel = key_panels.specimens(key, entry, level)
        chart = page.chart(panel, f"Values of {key} in each specimen")
        blocks.append(page.Pictures([chart]))
    return blocks


def _number(value: float | None, digits: int) -> str:
    return _DASH if value is None else summary.number(value, digits)


def _correlations(outcome: Mapping[str, Any]) -> page.Table:
    keys, covariance = outcome["keys"], outcome["covariance"]
    rows = []
    for i, key in enumerate(keys):
        row = [key]
        for j in range(len(keys)):
            entries = covariance[i][j], covariance[i][i], covariance[j][j]
            known = all(v is not None for v in entries) and entries[1] > 0 and entries[2] > 0
            row.append(f"{entries[0] / np.sqrt(entries[1] * entries[2]):+.3f}" if known else _DASH)
        rows.append(row)
    return page.Table("Correlations of the estimates", ["key", *keys], rows)


def _cells(caption: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> page.Table:
    """Return a table of cells of the summary, in the signs of pages."""
    signs = [in_signs if name == "unit" else with_signs for name in header]
    cells = [[sign(cell) or _DASH for sign, cell in zip(signs, row, strict=True)] for row in rows]
    return page.Table(caption, header, cells)


def stored_readings(
    path: Path, level: float
) -> tuple[list[fit_panels.Series], str, list[tuple[Panel, str]]]:
    """Return the series, the fit file's text, and panels of inputs with what they show."""
    with reading(path, SOFTWARE, "the readings of ringwear fit") as file:
        series = [_series_of(group, level) for group in _groups(file)]
        inputs = [*map(_input_panel, file.get("inputs", {}).values())]
        return series, file.attrs["fit"], inputs


def _input_panel(group: h5py.Group) -> tuple[Panel, str]:
    name, key, unit = (group.attrs[n] for n in ("experiment", "key", "unit"))
    panel = fit_panels.measured_input(
        name, key, unit, *(group[n][()] for n in ("time", "data", "curve"))
    )
    return panel, f"Readings of {key} in {name}, and its curve"


def _series_of(group: h5py.Group, level: float) -> fit_panels.Series:
    """Return a stored series in the unit of its readings."""
    experiment, name, quantity, unit = (
        group.attrs[n] for n in ("experiment", "series", "quantity", "data_unit")
    )
    scale = 1.0 / factor(unit, group["data"].attrs["units"])
    data, model, sd, band = (scale * group[n][()] for n in ("data", "model", "sd", "band"))
    x, residuals = group["r" if "r" in group else "time"][()], group["residual"][()]
    edges = tuple(group.attrs["contact"].tolist())
    censored = group["censored"][()] if "censored" in group else np.zeros(len(x), dtype=int)
    return fit_panels.Series(
        experiment, name, quantity, unit, x, data, model, sd, band, residuals, level, edges,
        censored.astype(int),
    )  # fmt: skip


def _series_charts(drawn: Sequence[fit_panels.Series]) -> list[page.Picture]:
    charts = []
    for series in [series for series in drawn if len(series.x) > 1]:
        alt = f"Data, model and band of {series.title}"
        charts.append(page.chart(fit_panels.readings(series), alt))
        charts.append(page.chart(fit_panels.residuals(series), f"Residuals of {series.title}"))
    if single := [series for series in drawn if len(series.x) == 1]:
        panel, height = fit_panels.single_readings(single), 1.6 + 0.6 * len(single)
        charts.append(page.chart(panel, "Series of one reading", height, wide=True))
    return charts


def _bands(level: float) -> list[str]:
    percent = f"{100 * level:g} %"
    return [
        f"Inner band: the model, {percent}, from the draws of keys, nuisances and random wear",
        f"Outer band: {percent} of readings, noise included; bars, where there are few readings: "
        f"the noise, {percent}",
    ]


def _groups(file: h5py.File) -> Iterator[h5py.Group]:
    names = [name for name in file if name.partition("_")[0].isdigit()]
    for name in sorted(names, key=lambda name: int(name.partition("_")[0])):
        yield file[name]


def _designed(outcome: Mapping[str, Any]) -> page.Section:
    scales = outcome["sd_scales"]

    def sds(design: Mapping[str, Any]) -> list[str]:
        """Return the standard deviations of a design."""
        known = {key: sd for key, sd in design["sd"].items() if sd is not None}
        return [
            f"{scale['factor'] * known[key]:.3g}" if key in known else _DASH
            for key, scale in scales.items()
        ]

    rows = [
        [
            str(number),
            design["name"],
            time_words(design["seconds"], design["seconds"]),
            *sds(design),
        ]
        for number, design in enumerate(outcome["designs"], start=1)
    ]
    rows.append(["today", "none", _DASH, *sds(outcome["today"])])
    units = {key: f" ({in_signs(scale['unit'])})" * bool(scale["unit"])
             for key, scale in scales.items()}  # fmt: skip
    header = ["design", "tests", "duration", *(f"sd of {key}{units[key]}" for key in scales)]
    blocks: list[page.Block] = [
        page.Lines([f"{outcome['candidates']} candidate tests, criterion {outcome['criterion']}, "
               f"measured as in {outcome['measured_as']}"]),
        page.Table("Best designs, with predicted standard deviations", header, rows),
    ]  # fmt: skip
    alt = "Predicted standard deviations after the best designs"
    height = max(3.2, 0.2 * sum(len(design["experiments"]) for design in outcome["designs"]))
    charts = [page.chart(panel, alt, height) for panel in key_panels.design_panels(outcome)]
    blocks.append(page.Pictures(charts))
    return page.Section("The next tests", blocks)


def _reproduced(outcome: Mapping[str, Any], text: str) -> page.Section:
    commands = (
        f"ringwear fit fit.toml -o out/fit{' --compare' if outcome['alternatives'] else ''}\n"
        "ringwear report out/fit -o report.html\n"
    )
    first = "Save the fit file as fit.toml beside its case and its data, then type:"
    source = page.Source("Fit file", text)
    return page.reproduced(first, commands, [source], outcome["versions"], [], outcome["data"])
