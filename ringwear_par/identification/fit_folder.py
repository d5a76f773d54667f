"""The files of a fit: its readings with the model, its draws, and its figure."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.files.folders import POSTERIOR, READINGS
from ringwear_par.identification.definition.problem import BASE, Problem, body_of_wear
from ringwear_par.identification.draws import Draws, write_columns, write_draws
from ringwear_par.identification.fitted_tests import FittedSeries, readings_of_draws
from ringwear_par.identification.likelihood import EmulatedLikelihood
from ringwear_par.pictures import fit_panels
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.panel import Panel
from ringwear_par.results.files import atomic_hdf5
from ringwear_par.results.variables import SOFTWARE

#: what is written of series, and what it means
_WRITTEN = {
    "data": "what was read", "sd": "noise of the data", "band": "sd of the model's reading",
    "model": "the model's reading, with nuisances and random wear",
}  # fmt: skip
#: most columns of series; inches of readings with their residuals, and of a legend above all
_COLUMNS, _WIDTH, _HEIGHT, _LEGEND = 3, 4.3, 3.9, 0.4
#: inches of the strip of single readings: height of a row, margin around them, least width
_ROW, _MARGIN, _NARROWEST = 0.5, 0.9, 6.5


def write_readings(
    folder: Path, problem: Problem, every: Sequence[FittedSeries], versions: Mapping[str, str]
) -> None:
    """Write results.h5: the series of all tests, and their measured inputs. On one rank."""
    bodies = [body_of_wear(key) for key in problem.settings.process]
    with atomic_hdf5(folder / READINGS) as file:
        file.attrs.update({"software": SOFTWARE, "fit": problem.text, "keys": [*problem.keys],
                           **versions})  # fmt: skip
        for number, one in enumerate(every, start=1):
            name = f"{number}_{re.sub(r'[^A-Za-z0-9.]+', '_', one.series.name)}"
            _write_series(file.create_group(name), one, bodies)
        inputs = [(test, entry) for test in problem.experiments for entry in test.inputs]
        for number, (experiment, measured) in enumerate(inputs, start=1):
            group, unit = file.create_group(f"inputs/{number}"), measured.unit
            group.attrs.update(experiment=experiment.name, key=measured.key, unit=unit)
            time, curve = measured.series.x, measured.curve(experiment.case)
            write_columns(group, {"reading": len(time)}, [
                ("time", time, "s", "time"),
                ("data", measured.readings(experiment.case), unit,
                 "reading, in the unit of the key"),
                ("curve", curve(time), unit, "the case's value"),
            ])  # fmt: skip


def write_posterior(
    folder: Path,
    draws: Draws,
    every: Sequence[FittedSeries],
    likelihoods: Sequence[EmulatedLikelihood],
    versions: Mapping[str, str],
) -> None:
    """Write draws.nc: draws, replicas of the readings by each, and log likelihoods. On one rank."""
    random = np.random.default_rng(0)
    logs, replicas = zip(*(
        readings_of_draws(likelihood, draws.of_test(i), random)
        for i, likelihood in enumerate(likelihoods)
    ), strict=True)  # fmt: skip
    readings = {
        "observed_data": np.concatenate([one.series.value for one in every]),
        "posterior_predictive": np.hstack(replicas), "log_likelihood": np.hstack(logs),
    }  # fmt: skip
    places = {
        "test": [one.test for one in every for _ in one.series.x],
        "series": [one.series.name for one in every for _ in one.series.x],
        "at": [x for one in every for x in one.series.x.tolist()],
    }
    write_draws(folder / POSTERIOR, draws, versions, places, readings)


def _write_series(group: h5py.Group, one: FittedSeries, bodies: Sequence[str]) -> None:
    """Write data, model, band and residuals of a series; ``bodies`` are those of random wear."""
    series, drawn, factor = one.series, one.drawn, one.series.factor
    group.attrs.update(
        experiment=one.test, series=series.name, quantity=series.quantity,
        file=series.file, data_unit=series.unit, contact=drawn.edges,
    )  # fmt: skip
    base, at = BASE[series.kind], ("r", "mm") if series.profile else ("time", "s")
    columns = [
        (at[0], series.x, at[1], "where or when it was read"),
        ("residual", drawn.residuals, "1", "data less model over its noise, white"),
        *((name, factor * getattr(drawn, name), base, of) for name, of in _WRITTEN.items()),
    ]
    for body, excess, sd in zip(bodies, one.excess.T, one.excess_sd.T, strict=True):
        meaning = "mean depth worn beyond that of the law, by the readings"
        columns.append((f"excess_{body}", excess, "mm", meaning))
        columns.append((f"excess_{body}_sd", sd, "mm", f"sd of excess_{body}"))
    if drawn.censored.any():
        meaning = "-1: the true value is at most what was read, 1: at least, 0: that"
        columns.append(("censored", drawn.censored.astype(float), "1", meaning))
    write_columns(group, {"reading": series.n}, columns)


def figure_of_readings(drawn: Sequence[fit_panels.Series]) -> Figure:
    """Return the figure of data, model, its band, and residuals.

    Of series of one reading, such as weighings, only where there are no others: a line each.
    """
    curves = [series for series in drawn if len(series.x) > 1]
    if not curves:
        size = _NARROWEST, _LEGEND + _MARGIN + _ROW * len(drawn)
        return panel_figure([[fit_panels.single_readings(drawn)]], size)
    across = 2 if len(curves) == 4 else min(_COLUMNS, len(curves))
    rows: list[list[Panel]] = []
    for first in range(0, len(curves), across):
        beside = curves[first : first + across]
        rows += [[*map(fit_panels.readings, beside)], [*map(fit_panels.residuals, beside)]]
    size = max(_WIDTH * across, _NARROWEST), _LEGEND + 0.5 * _HEIGHT * len(rows)
    return panel_figure(rows, size, [5, 2] * (len(rows) // 2))
