"""The result of a fit: the numbers of fit.json, draws, the tests as they were fitted; its files."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.schema import unit_of
from ringwear_par.errors import ValidityWarning
from ringwear_par.files import folders
from ringwear_par.identification import doubts
from ringwear_par.identification.definition.problem import GROWTH_TIME, Problem
from ringwear_par.identification.draws import CHAINED, Draws, draws_of, write_columns, write_draws
from ringwear_par.identification.fitted_tests import (
    FittedSeries,
    fitted_series,
    readings_of_draws,
    scores_and_information,
)
from ringwear_par.identification.key_estimates import key_entries, process_entries
from ringwear_par.identification.solution import Solution
from ringwear_par.identification.summary import summary
from ringwear_par.pictures import fit_panels
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.panel import Panel
from ringwear_par.pictures.style import picture
from ringwear_par.results.files import atomic_hdf5
from ringwear_par.results.result import Outcome
from ringwear_par.results.variables import SOFTWARE
from ringwear_par.version import versions

#: files of its folder
FILES = (folders.FIT, folders.READINGS, folders.POSTERIOR, folders.CURVES)
#: draws that are kept; of how many of these one tells bands and nuisances
_KEPT, _EVERY = 2000, 4
#: most columns of series; inches of readings with their residuals, and of a legend above all
_COLUMNS, _WIDTH, _HEIGHT, _LEGEND = 3, 4.3, 3.9, 0.4
#: inches of the strip of single readings: height of a row, margin around them, least width
_ROW, _MARGIN, _NARROWEST = 0.5, 0.9, 6.5


@dataclass(frozen=True, eq=False)
class FitResult(Outcome):
    """The outcome of a fit."""

    #: with friction as torques tell it
    problem: Problem
    #: the draws that are kept, with the emulators
    solution: Solution
    #: of what the fit knows
    draws: Draws
    #: of all tests, at the mode and among the draws
    series: tuple[FittedSeries, ...]
    #: what speaks against taking the numbers as they are
    doubts: tuple[ValidityWarning, ...]
    #: of fit.json
    content: dict[str, Any]

    def __repr__(self) -> str:
        return self.summary()

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """The numbers of each fitted key, as fit.json has them."""
        entries: dict[str, dict[str, Any]] = self.content["parameters"]
        return entries

    def summary(self) -> str:
        """Return it in a few lines, as the command prints it."""
        return summary(self.problem.name, self.content)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of fit.json."""
        return dict(self.content)

    def save(self, path: str | Path) -> None:
        """Write the files of its folder, fit.json, which says that it is whole, the last.

        A picture that cannot be drawn is left out, with a warning; see ``Outcome.save``.
        """
        folder = Path(path)
        with folders.new_files(folder, FILES, "fit"):
            self._write_readings(folder / folders.READINGS)
            self._write_draws(folder / folders.POSTERIOR)
            contents = {
                folders.CURVES: lambda: picture(self.plot, str(folder / folders.CURVES)),
                folders.FIT: lambda: folders.json_bytes(self.content),
            }
            folders.write_contents(folder, contents)

    def _write_readings(self, path: Path) -> None:
        """Write results.h5: the series of all tests, and their measured inputs."""
        problem = self.problem
        with atomic_hdf5(path) as file:
            file.attrs.update({"software": SOFTWARE, "fit": problem.text, "keys": [*problem.keys],
                               **self.content["versions"]})  # fmt: skip
            for number, one in enumerate(self.series, start=1):
                name = f"{number}_{re.sub(r'[^A-Za-z0-9.]+', '_', one.series.name)}"
                group, series = file.create_group(name), one.series
                group.attrs.update(
                    experiment=one.test, series=series.name, quantity=series.quantity,
                    file=series.file, data_unit=series.unit, contact=one.drawn.edges,
                )  # fmt: skip
                columns = [(name, *column) for name, column in one.columns.items()]
                write_columns(group, ("reading",), columns)
            inputs = [(test, entry) for test in problem.experiments for entry in test.inputs]
            for number, (test, measured) in enumerate(inputs, start=1):
                group = file.create_group(f"inputs/{number}")
                unit = unit_of(measured.key) or "1"
                group.attrs.update(experiment=test.name, key=measured.key, unit=unit)
                time = measured.series.x
                write_columns(group, ("reading",), [
                    ("time", time, "s", "time"),
                    ("data", measured.readings(test.case), unit, "reading, in the unit of the key"),
                    ("curve", measured.curve(test.case)(time), unit, "the case's value"),
                ])  # fmt: skip

    def _write_draws(self, path: Path) -> None:
        """Write draws.nc: draws, replicas of the readings by each, and log likelihoods."""
        random, every = np.random.default_rng(0), self.series
        tests = range(len(self.problem.experiments))
        of_tests = [readings_of_draws(self.solution, i, random) for i in tests]
        logs, replicas = (np.hstack(of) for of in zip(*of_tests, strict=True))
        places = {
            "test": [one.test for one in every for _ in one.series.x],
            "series": [one.series.name for one in every for _ in one.series.x],
            "at": np.concatenate([one.series.x for one in every]),
        }
        with atomic_hdf5(path) as file:
            file.attrs.update({"software": SOFTWARE, **self.content["versions"]})
            write_draws(file.create_group("posterior"), self.draws)
            for name, axes, values in (
                ("observed_data", (), np.concatenate([one.series.value for one in every])),
                ("posterior_predictive", CHAINED, replicas),
                ("log_likelihood", CHAINED, logs),
            ):
                group, meaning = file.create_group(name), name.replace("_", " ")
                write_columns(group, (*axes, "place"), [("reading", values, "1", meaning)])
                columns = [(of, v, "1", f"{of} of the reading") for of, v in places.items()]
                write_columns(group, ("place",), columns)

    def plot(self) -> Figure:
        """Return the figure of data, model, its band and residuals.

        Of series of one reading, such as weighings, only where there are no others: a line each.
        """
        drawn = [one.drawn for one in self.series]
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


def result_of(solution: Solution) -> FitResult:
    """Return the result of a solution. On the first rank."""
    problem, posterior, random = solution.problem, solution.posterior, np.random.default_rng(0)
    material, tests = posterior.material(solution.theta, random), range(len(problem.experiments))
    # in the order of one entry, so that its ends stay
    ordered = np.linspace(0, len(material) - 1, _KEPT).round().astype(int)
    rows = random.permutation(np.argsort(solution.theta[:, 0])[ordered])
    some = rows[::_EVERY]
    kept, few = (replace(solution, theta=solution.theta[of]) for of in (rows, some))
    fitted = [fitted_series(few, i, random) for i in tests]
    every = [one for series, _ in fitted for one in series]
    correlations = {
        f"{kind} of {one.title}": np.corrcoef(material[some].T, drawn)[-1]
        for one in every for kind, drawn in one.nuisances.items()
        if kind != GROWTH_TIME and drawn.std() > 0.0
    }  # fmt: skip
    each = [scores_and_information(solution, i) for i in tests]
    scores, information = np.stack(each, axis=1)
    parameters = key_entries(solution, material, information, correlations)
    process, squares = process_entries(solution), _goodness(few, every)
    checked = [
        *doubts.of_keys(parameters), *doubts.of_fit(solution, squares), *doubts.of_series(every),
        *doubts.of_tests(problem, parameters, scores, information),
        *doubts.of_sizes(parameters, process),
    ]  # fmt: skip
    found = tuple(one for one in checked if isinstance(one, ValidityWarning))
    draws = draws_of(kept, problem.values(material[rows]))
    content = {
        "parameters": parameters,
        "keys": [*problem.keys],
        "covariance": np.atleast_2d(np.cov(draws.material.T)).tolist(),
        "level": problem.settings.level,
        **squares,
        "evidence": solution.log_evidence,
        "evidence_error": solution.evidence_error,
        "specimens": len({test.groups[0] for test in problem.experiments}),
        "process": process,
        **_numbers_of_tests(problem, every, [factors for _, factors in fitted]),
        "histories": solution.histories,
        "failed_histories": solution.failed,
        "steps": solution.steps,
        "draws": {"effective": solution.effective, "stored": len(draws)},
        "checks": [one for one in checked if isinstance(one, dict)],
        "doubts": [doubt.to_dict() for doubt in found],
        "warnings": [doubt.text for doubt in found],
        "alternatives": {},
        "loss": problem.settings.loss,
        "versions": versions(),
        "data": dict(problem.hashes),
    }  # fmt: skip
    return FitResult(problem, kept, draws, tuple(every), found, content)


def _goodness(solution: Solution, every: Sequence[FittedSeries]) -> dict[str, Any]:
    """Return what tells how well the model fits, by the draws of a solution.

    ``chi2`` is the sum of squares at the mode, with those of priors, of all readings but mere
    limits, over the noise and random wear; its freedom is the readings less nuisances without
    priors, and less keys, which count by how much the draws raise the squares. ``p_value`` is the
    mean over the draws (Johnson, Ann. Stat. 32 (2004) 2361-2384) for readings whose noise is given;
    None where all is fitted, or has long tails.
    """
    posterior, student = solution.posterior, solution.problem.settings.loss == "student"
    points = posterior.of_tests(np.vstack([solution.best, solution.theta]))
    rows, of_parts, given = list[FloatArray](), list[float](), list[bool]()
    for i, emulated in enumerate(posterior.likelihoods):
        likelihood = emulated.likelihood
        rows += [*likelihood.least_squares(emulated.emulator(points[:, i]))]
        of_parts += [noise.freedom for noise in likelihood.noises]
        given += [not any(s.sd_fitted for s in noise.series) for noise in likelihood.noises]
    squares, freedom = np.array(rows), np.array(of_parts)
    at_mode, *total = squares.sum(axis=0).tolist()
    raised, free, p_value = max(float(np.mean(total)) - at_mode, 0.0), freedom[given].sum(), None
    if not student and free >= 1.0:
        p_value = float(chi2.sf(squares[given, 1:].sum(axis=0), free).mean())
    if student:  # the sd of outliers is larger in the others
        at_mode = sum(float(np.square(one.misfits).sum()) for one in every)
    return {
        "chi2": at_mode, "n_data": sum(one.series.n for one in every),
        "degrees_of_freedom": max(float(freedom.sum()) - raised, 0.0), "p_value": p_value,
        "flagged": p_value is not None and p_value < doubts.IMPROBABLE,
    }  # fmt: skip


def _numbers_of_tests(
    problem: Problem, every: Sequence[FittedSeries], factors: Sequence[Mapping[str, FloatArray]]
) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the numbers of series, their nuisances and measured inputs, by test.

    Nuisances are in the data's unit; that of thermal growth has the ``time`` constant's, s. The
    curve of an input is at ``time``, s; the scatter about it is a relative standard deviation.
    """
    experiments, nuisance, inputs = (dict[str, dict[str, Any]]() for _ in range(3))
    for one in every:
        series, values = one.series, one.misfits
        entry = {"chi2": float(values @ values), "n": series.n, "unit": series.unit}
        if len(values) < series.n:
            entry["censored"] = series.n - len(values)
        if series.sd_fitted:
            entry["sd"] = float(one.drawn.sd[0])
        experiments.setdefault(one.test, {})[series.name] = entry
        found = {kind: _mean_and_sd(draws) for kind, draws in one.nuisances.items()}
        if GROWTH_TIME in found:
            found["thermal"]["time"] = found.pop(GROWTH_TIME)
        if found:
            nuisance.setdefault(one.test, {})[series.name] = found
    for test, of_test in zip(problem.experiments, factors, strict=True):
        for measured in test.inputs:
            curve, readings = measured.curve(test.case), measured.readings(test.case)
            off = readings / np.maximum(curve(measured.series.x), np.finfo(float).tiny) - 1.0
            entry = {
                "time": list(curve.x), "value": list(curve.y), "unit": unit_of(measured.key) or "1",
                "n": measured.series.n, "scatter": float(np.sqrt(np.mean(off**2))),
            }  # fmt: skip
            if measured.key in of_test:
                entry["scale"] = _mean_and_sd(of_test[measured.key])
            inputs.setdefault(test.name, {})[measured.key] = entry
    return {"experiments": experiments, "nuisance": nuisance, "inputs": inputs}


def _mean_and_sd(draws: FloatArray) -> dict[str, Any]:
    """Return the mean of draws (s,) and their sd; None where readings do not change them."""
    sd = float(draws.std())
    return {"estimate": float(draws.mean()), "sd": sd if sd > 0.0 else None}
