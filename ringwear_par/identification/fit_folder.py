"""The folder of a fit: its outcome, its readings and its figures, each there once it is whole."""

import json
import logging
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.errors import InputError
from ringwear_par.files.folders import (
    CURVES,
    ESTIMATES,
    FIT,
    PROGRESS,
    READINGS,
    SPECIMENS,
    json_bytes,
    new_files,
    write_contents,
)
from ringwear_par.files.text import read_text
from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.definition.problem import BASE, Problem, body_of_wear
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.fitted_values import LAWS, fitted_values, write_values
from ringwear_par.pictures.style import picture
from ringwear_par.results.storage.hdf5 import atomic_hdf5, write_variable
from ringwear_par.results.variables import PARAMETER, PARAMETER_UNIT, SOFTWARE, Variable

log = logging.getLogger(__name__)

FILES = (FIT, READINGS, CURVES, ESTIMATES, SPECIMENS)


def refuse_interrupted(folder: Path) -> None:
    """Refuse a folder with what an interrupted fit has left."""
    left = folder / PROGRESS
    if left.is_dir() and any(left.iterdir()):
        raise InputError(
            f"{folder}: holds a fit that was interrupted; --restart goes on with it, --overwrite "
            "starts anew"
        )


def complete(folder: Path, problem: Problem, *, compare: bool) -> bool:
    """Tell whether a folder holds the outcome of a problem, of its other laws too where asked."""
    try:
        stored = json.loads(read_text(folder / FIT))
        laws = problem.alternatives.keys() if compare else set()
        return bool(stored["key"] == problem.key and laws <= stored["alternatives"].keys())
    except (InputError, ValueError, TypeError, KeyError, AttributeError):
        return False


def save(fit: FitResult, folder: Path) -> None:
    """Write all files; fit.json, which says that it is whole, the last. On one rank.

    A picture that cannot be drawn is left out, with a warning.
    """
    with new_files(folder, FILES, "fit"):
        with atomic_hdf5(folder / READINGS) as file:
            _write(file, fit)
        figures = {CURVES: fit.plot, ESTIMATES: fit.plot_parameters, SPECIMENS: fit.plot_specimens}
        if not fit.misfit.problem.scatters:
            del figures[SPECIMENS]
            (folder / SPECIMENS).unlink(missing_ok=True)
        pictures = {
            name: partial(picture, draw, str(folder / name)) for name, draw in figures.items()
        }
        write_contents(folder, {**pictures, FIT: lambda: json_bytes(fit.to_dict())})


def _write(file: h5py.File, fit: FitResult) -> None:
    misfit = fit.misfit
    keys = [p.key for p in fit.parameters]
    sd, band, units = misfit.sd, fit.band, units_of(misfit.problem)
    file.attrs.update(
        {"software": SOFTWARE, "fit": misfit.problem.text, "keys": keys, **fit.versions}
    )
    write_values(file, fitted_values(fit))
    for number, (law, other) in enumerate(fit.alternatives.items(), start=1):
        group = file.create_group(f"{LAWS}/{number}")
        group.attrs["law"] = law
        write_values(group, fitted_values(other))
    _write_inputs(file, fit)
    if fit.posterior is not None:
        group = file.create_group("posterior")
        samples = fit.posterior.samples
        axis = Variable("sample", ("sample",), "1", "number of the sample", integer=True)
        write_variable(group, axis, np.arange(len(samples)))
        for j, parameter in enumerate(fit.parameters):
            unit = units[parameter.key]
            variable = Variable(parameter.key, ("sample",), unit, "sample of the posterior")
            write_variable(group, variable, samples[:, j])
    for number, (experiment, series, part) in enumerate(misfit.records, start=1):
        name = f"{number}_{re.sub(r'[^A-Za-z0-9.]+', '_', series.name)}"
        group, put = _group_of_readings(
            file, name, series.n, experiment=experiment.name, series=series.name,
            quantity=series.quantity, file=series.file, data_unit=series.unit,
            contact=experiment.case.contact,
        )  # fmt: skip
        base = _unit(series.quantity)
        write_variable(group, PARAMETER, keys)
        write_variable(group, PARAMETER_UNIT, list(units.values()))
        if series.profile:
            put("r", series.x, "mm", "radius")
        else:
            put("time", series.x, "s", "time")
        put("data", series.value, base, "what was read")
        put("sd", sd[part], base, "noise of the data")
        meaning = "the model's reading, with nuisances and random wear"
        put("model", fit.evaluation.model[part], base, meaning)
        put("band", band[part], base, "sd of the model's reading")
        if fit.material is not None:
            for body, key in enumerate(fit.material.process):
                name = f"excess_{body_of_wear(key)}"
                excess, excess_sd = (
                    fit.material.best_fit.excess[part],
                    fit.material.best_fit.excess_sd[part],
                )
                meaning = "mean depth worn beyond that of the law, by the readings"
                put(name, excess[:, body], "mm", meaning)
                put(f"{name}_sd", excess_sd[:, body], "mm", f"sd of {name}")
        if misfit.censored[part].any():
            meaning = "-1: the true value is at most what was read, 1: at least, 0: that"
            put("censored", misfit.censored[part], "1", meaning)
        put("residual", fit.residuals[part], "1", "data less model over its noise, white")
        put(
            "sensitivity", fit.evaluation.sensitivity[part], f"{base}/{PARAMETER_UNIT.name}",
            "derivative of the model's reading with respect to each fitted key", "parameter",
        )  # fmt: skip


def _write_inputs(file: h5py.File, fit: FitResult) -> None:
    """Write the readings of inputs and the curves of cases there."""
    for number, (name, key, unit, time, value, curve) in enumerate(fit.input_readings, start=1):
        _, put = _group_of_readings(
            file, f"inputs/{number}", len(time), experiment=name, key=key, unit=unit
        )
        put("time", time, "s", "time")
        put("data", value, unit, "reading, in the unit of the key")
        put("curve", curve, unit, "the case's value")


def _group_of_readings(
    file: h5py.File, name: str, count: int, /, **attributes: Any
) -> tuple[h5py.Group, Callable[..., None]]:
    """Return a new group of readings, and what puts one more variable of them into it."""
    group = file.create_group(name)
    group.attrs.update(attributes)
    axis = Variable("reading", ("reading",), "1", "number of the reading", integer=True)
    write_variable(group, axis, np.arange(count))

    def put(word: str, values: Any, unit: str, meaning: str, *more: str) -> None:
        write_variable(group, Variable(word, ("reading", *more), unit, meaning), values)

    return group, put


def _unit(quantity: str) -> str:
    return BASE[quantity.partition(".")[0]]
