"""The folder of a fit: its outcome, its draws and readings, its figures, each there once whole."""

import re
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.files.folders import (
    CURVES,
    ESTIMATES,
    FIT,
    POSTERIOR,
    READINGS,
    SPECIMENS,
    json_bytes,
    new_files,
    write_contents,
)
from ringwear_par.identification.definition.problem import BASE, body_of_wear
from ringwear_par.identification.draws import write_draws
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.fitted_tests import readings_of_draws
from ringwear_par.pictures.style import picture
from ringwear_par.results.hdf5 import atomic_hdf5, write_variable
from ringwear_par.results.variables import SOFTWARE, Variable

FILES = (FIT, READINGS, POSTERIOR, CURVES, ESTIMATES, SPECIMENS)


def save(fit: FitResult, folder: Path) -> None:
    """Write all files; fit.json, which says that it is whole, the last. On one rank.

    A picture that cannot be drawn is left out, with a warning.
    """
    with new_files(folder, FILES, "fit"):
        with atomic_hdf5(folder / READINGS) as file:
            _write(file, fit)
        readings, places = drawn_readings(fit)
        write_draws(folder / POSTERIOR, fit.draws, fit.versions, places, readings)
        figures = {CURVES: fit.plot, ESTIMATES: fit.plot_parameters, SPECIMENS: fit.plot_specimens}
        if not fit.problem.scatters:
            del figures[SPECIMENS]
            (folder / SPECIMENS).unlink(missing_ok=True)
        pictures = {
            name: partial(picture, draw, str(folder / name)) for name, draw in figures.items()
        }
        write_contents(folder, {**pictures, FIT: lambda: json_bytes(fit.to_dict())})


def drawn_readings(fit: FitResult) -> tuple[dict[str, FloatArray], dict[str, list[Any]]]:
    """Return what draws.nc holds of readings, and the test, series and place of each.

    Where keys scatter, "log_likelihood_test" (s, tests) is of all readings of a test.
    """
    random, x = np.random.default_rng(0), fit.draws.tests
    posterior = fit.solution.posterior
    parts = [
        readings_of_draws(likelihood, x[:, i], random)
        for i, likelihood in enumerate(posterior.likelihoods)
    ]
    logs, replicas = (np.hstack(columns) for columns in zip(*parts, strict=True))
    readings = {
        "observed_data": np.concatenate([test.data for test in fit.tests]),
        "posterior_predictive": replicas, "log_likelihood": logs,
    }  # fmt: skip
    places: dict[str, list[Any]] = {"test": [], "series": [], "at": []}
    for test in fit.tests:
        for series, _ in test.records:
            places["test"] += [test.experiment.name] * series.n
            places["series"] += [series.name] * series.n
            places["at"] += series.x.tolist()
    if posterior.scatterings:
        bodies = [BODIES.index(body_of_wear(key)) for key in fit.problem.settings.process]
        shares = np.sqrt(fit.draws.process[:, bodies] / fit.solution.depths)
        readings["log_likelihood_test"] = np.stack(
            [
                f(f.emulator.coordinates(x[:, i]), shares)
                for i, f in enumerate(posterior.likelihoods)
            ],
            axis=1,
        )
    return readings, places


def _write(file: h5py.File, fit: FitResult) -> None:
    problem = fit.problem
    file.attrs.update({"software": SOFTWARE, "fit": problem.text, "keys": [*problem.keys],
                       **fit.versions})  # fmt: skip
    records = [(test, *record) for test in fit.tests for record in test.records]
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
    for number, (name, key, unit, time, value, curve) in enumerate(fit.input_readings, start=1):
        group = file.create_group(f"inputs/{number}")
        group.attrs.update(experiment=name, key=key, unit=unit)
        _put(group, "time", time, "s", "time")
        _put(group, "data", value, unit, "reading, in the unit of the key")
        _put(group, "curve", curve, unit, "the case's value")


def _put(group: h5py.Group, name: str, values: FloatArray, unit: str, meaning: str) -> None:
    """Write a variable of the readings of a group."""
    if "reading" not in group:
        axis = Variable("reading", ("reading",), "1", "number of the reading", integer=True)
        write_variable(group, axis, np.arange(len(values)))
    write_variable(group, Variable(name, ("reading",), unit, meaning), values)
