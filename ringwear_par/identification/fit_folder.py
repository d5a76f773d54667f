"""The folder of a fit: its outcome, its draws and readings, its figures, each there once whole."""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.files import folders
from ringwear_par.identification.definition.problem import BASE, Problem, Series, body_of_wear
from ringwear_par.identification.draws import Draws, write_draws
from ringwear_par.identification.fitted_tests import FittedTest, readings_of_draws
from ringwear_par.identification.likelihood import EmulatedLikelihood
from ringwear_par.pictures import fit_panels, key_panels
from ringwear_par.pictures.matplotlib import add_letters, panel_figure, panel_grid
from ringwear_par.pictures.panel import Panel
from ringwear_par.pictures.style import STYLE, NotebookFigure, picture
from ringwear_par.results.files import atomic_hdf5, write_variable
from ringwear_par.results.variables import SOFTWARE, Variable

FILES = (folders.FIT, folders.READINGS, folders.POSTERIOR, folders.CURVES, folders.ESTIMATES,
         folders.SPECIMENS)  # fmt: skip
#: most columns of series; inches of readings with their residuals, and of a legend above all
_COLUMNS, _WIDTH, _HEIGHT, _LEGEND = 3, 4.3, 3.9, 0.4
#: inches of the strip of single readings: height of a row, margin around them, least width
_ROW, _MARGIN, _NARROWEST = 0.5, 0.9, 6.5


def save(
    folder: Path,
    outcome: Mapping[str, Any],
    problem: Problem,
    draws: Draws,
    tests: Sequence[FittedTest],
    likelihoods: Sequence[EmulatedLikelihood],
) -> None:
    """Write all files; fit.json, the outcome, which says that it is whole, the last. On one rank.

    A picture that cannot be drawn is left out, with a warning.
    """
    drawn: dict[str, Callable[[], Figure]] = {
        folders.CURVES: lambda: figure_of_readings(tests, outcome["level"]),
        folders.ESTIMATES: lambda: figure_of_keys(outcome, draws),
        folders.SPECIMENS: lambda: figure_of_specimens(outcome),
    }
    with folders.new_files(folder, FILES, "fit"):
        with atomic_hdf5(folder / folders.READINGS) as file:
            file.attrs.update({"software": SOFTWARE, "fit": problem.text, "keys": [*problem.keys],
                               **outcome["versions"]})  # fmt: skip
            _write_readings(file, problem, tests)
        _write_draws(folder / folders.POSTERIOR, outcome["versions"], draws, tests, likelihoods)
        if not problem.scatters:
            del drawn[folders.SPECIMENS]
            (folder / folders.SPECIMENS).unlink(missing_ok=True)
        contents = {n: partial(picture, draw, str(folder / n)) for n, draw in drawn.items()}
        last = {folders.FIT: lambda: folders.json_bytes(outcome)}
        folders.write_contents(folder, {**contents, **last})


def _write_draws(
    path: Path,
    versions: Mapping[str, str],
    draws: Draws,
    tests: Sequence[FittedTest],
    likelihoods: Sequence[EmulatedLikelihood],
) -> None:
    """Write draws.nc, with replicas of the readings of each draw and log likelihoods."""
    random = np.random.default_rng(0)
    parts = [
        readings_of_draws(likelihood, draws.tests[:, i], random)
        for i, likelihood in enumerate(likelihoods)
    ]
    logs, replicas = (np.hstack(columns) for columns in zip(*parts, strict=True))
    readings = {
        "observed_data": np.concatenate([test.data for test in tests]),
        "posterior_predictive": replicas, "log_likelihood": logs,
    }  # fmt: skip
    places: dict[str, list[Any]] = {"test": [], "series": [], "at": []}
    for test in tests:
        for series, _ in test.records:
            places["test"] += [test.experiment.name] * series.n
            places["series"] += [series.name] * series.n
            places["at"] += series.x.tolist()
    write_draws(path, draws, versions, places, readings)


def _write_readings(file: h5py.File, problem: Problem, tests: Sequence[FittedTest]) -> None:
    """Write data, model, bands and residuals of each series, and the measured inputs."""
    records = [(test, *record) for test in tests for record in test.records]
    for number, (test, series, part) in enumerate(records, start=1):
        group = file.create_group(f"{number}_{re.sub(r'[^A-Za-z0-9.]+', '_', series.name)}")
        group.attrs.update(
            experiment=test.experiment.name, series=series.name, quantity=series.quantity,
            file=series.file, data_unit=series.unit, contact=test.experiment.case.contact,
        )  # fmt: skip
        base, at = BASE[series.kind], ("r", "mm") if series.profile else ("time", "s")
        put = partial(_put, group)
        put(at[0], series.x, at[1], "where or when it was read")
        put("data", series.value, base, "what was read")
        put("sd", test.sd[part], base, "noise of the data")
        meaning = "the model's reading, with nuisances and random wear"
        put("model", test.model[part], base, meaning)
        put("band", test.band[part], base, "sd of the model's reading")
        put("residual", test.residuals[part], "1", "data less model over its noise, white")
        for body, key in enumerate(problem.settings.process):
            name = f"excess_{body_of_wear(key)}"
            meaning = "mean depth worn beyond that of the law, by the readings"
            put(name, test.excess[part, body], "mm", meaning)
            put(f"{name}_sd", test.excess_sd[part, body], "mm", f"sd of {name}")
        if test.censored[part].any():
            meaning = "-1: the true value is at most what was read, 1: at least, 0: that"
            put("censored", test.censored[part], "1", meaning)
    inputs = [(test, measured) for test in problem.experiments for measured in test.inputs]
    for number, (experiment, measured) in enumerate(inputs, start=1):
        group, time = file.create_group(f"inputs/{number}"), measured.series.x
        group.attrs.update(experiment=experiment.name, key=measured.key, unit=measured.unit)
        readings, curve = measured.readings(experiment.case), measured.curve(experiment.case)
        _put(group, "time", time, "s", "time")
        _put(group, "data", readings, measured.unit, "reading, in the unit of the key")
        _put(group, "curve", curve(time), measured.unit, "the case's value")


def _put(group: h5py.Group, name: str, values: FloatArray, unit: str, meaning: str) -> None:
    """Write a variable of the readings of a group."""
    if "reading" not in group:
        axis = Variable("reading", ("reading",), "1", "number of the reading", integer=True)
        write_variable(group, axis, np.arange(len(values)))
    write_variable(group, Variable(name, ("reading",), unit, meaning), values)


def figure_of_readings(tests: Sequence[FittedTest], level: float) -> Figure:
    """Return the figure of data, model, its band at a level, and residuals.

    Series of one reading, such as weighings, share a strip below: a line each.
    """
    every = [drawn_series(test, *record, level) for test in tests for record in test.records]
    curves = [series for series in every if len(series.x) > 1]
    single = [series for series in every if len(series.x) == 1]
    across = 2 if len(curves) == 4 else min(_COLUMNS, max(len(curves), 1))
    rows: list[list[Panel]] = []
    for first in range(0, len(curves), across):
        beside = curves[first : first + across]
        rows += [[*map(fit_panels.readings, beside)], [*map(fit_panels.residuals, beside)]]
    # two parts: labels of the strip make no panel above it narrower
    parts = [(rows, 0.5 * _HEIGHT * len(rows))] if rows else []
    if single:
        strip = [[fit_panels.single_readings(single)]]
        parts.append((strip, _MARGIN + _ROW * len(single)))
    heights = [height + _LEGEND * (not number) for number, (_, height) in enumerate(parts)]
    with matplotlib.rc_context(STYLE):
        size = max(_WIDTH * across, _NARROWEST), sum(heights)
        chart = NotebookFigure(figsize=size, layout="constrained")
        places = chart.subfigures(len(parts), 1, height_ratios=heights, squeeze=False)[:, 0]
        for place, (panels, _) in zip(places, parts, strict=True):
            shares = [5, 2] * (len(panels) // 2)
            panel_grid(place, panels, shares, legend=place is places[0])
        add_letters(chart)
    return chart


def drawn_series(test: FittedTest, series: Series, part: slice, level: float) -> fit_panels.Series:
    """Return a series with its model, in the unit of its readings."""
    scale = 1.0 / series.factor
    return fit_panels.Series(
        test.experiment.name, series.name, series.quantity, series.unit, series.x,
        scale * series.value, scale * test.model[part], scale * test.sd[part],
        scale * test.band[part], test.residuals[part], level,
        test.experiment.case.contact, test.censored[part].astype(int),
    )  # fmt: skip


def figure_of_keys(outcome: Mapping[str, Any], draws: Draws) -> Figure:
    """Return the draws of each key, and of pairs."""
    by_key = dict(zip(draws.keys, draws.values(draws.material).T, strict=True))
    rows = key_panels.fitted_keys(outcome, by_key)
    return panel_figure(rows, (0.8 + 3.2 * len(rows), 0.8 + 3.1 * len(rows)))


def figure_of_specimens(outcome: Mapping[str, Any]) -> Figure:
    """Return the values of specimens and material of each key that scatters."""
    scattering = {k: entry for k, entry in outcome["parameters"].items() if "each" in entry}
    widest = max(len(entry["each"]) for entry in scattering.values())
    size = max(_NARROWEST, 0.7 * min(widest, 16)), _LEGEND + _HEIGHT * len(scattering)
    panels = [[key_panels.specimens(k, entry, outcome["level"])] for k, entry in scattering.items()]
    return panel_figure(panels, size)
