"""Files of the folder of a fit that have arrays: its readings, and its draws as ArviZ has them."""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.files.folders import CURVES, ESTIMATES, FIT, POSTERIOR, READINGS, SPECIMENS
from ringwear_par.identification.definition.problem import BASE, Problem, body_of_wear
from ringwear_par.identification.draws import Draws, write_draws
from ringwear_par.identification.fitted_tests import FittedTest, readings_of_draws
from ringwear_par.identification.likelihood import EmulatedLikelihood
from ringwear_par.results.hdf5 import atomic_hdf5, write_variable
from ringwear_par.results.variables import SOFTWARE, Variable

FILES = (FIT, READINGS, POSTERIOR, CURVES, ESTIMATES, SPECIMENS)

#: test, key and unit of an input, times (s) and readings, and the curve there
InputReadings = tuple[str, str, str, FloatArray, FloatArray, FloatArray]


def save_draws(
    path: Path,
    draws: Draws,
    tests: Sequence[FittedTest],
    likelihoods: Sequence[EmulatedLikelihood],
    versions: Mapping[str, str],
) -> None:
    """Write draws.nc, with the readings of each draw and their log likelihoods."""
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


def save_readings(
    path: Path,
    problem: Problem,
    tests: Sequence[FittedTest],
    inputs: Sequence[InputReadings],
    versions: Mapping[str, str],
) -> None:
    """Write results.h5: data, model, bands and residuals of each series, and measured inputs."""
    with atomic_hdf5(path) as file:
        file.attrs.update({"software": SOFTWARE, "fit": problem.text, "keys": [*problem.keys],
                           **versions})  # fmt: skip
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
        for number, (name, key, unit, time, value, curve) in enumerate(inputs, start=1):
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
