"""The result of a fit: the numbers of fit.json, draws, the tests as they were fitted; its files."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning
from ringwear_par.files import folders
from ringwear_par.identification import doubts
from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.definition.problem import (
    BASE,
    GROWTH_TIME,
    Experiment,
    Problem,
    body_of_wear,
)
from ringwear_par.identification.draws import (
    CHAINS,
    Draws,
    conditions_of,
    law_names,
    values_of,
    write_columns,
    write_draws,
)
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
#: draws that are kept, of each of the chains that ArviZ wants; how many of all tell bands
_KEPT, _BANDS = 500, 500
#: what is written of series, and what it means
_WRITTEN = {
    "data": "what was read", "sd": "noise of the data", "band": "sd of the model's reading",
    "model": "the model's reading, with nuisances and random wear",
}  # fmt: skip
#: most columns of series; inches of readings with their residuals, and of a legend above all
_COLUMNS, _WIDTH, _HEIGHT, _LEGEND = 3, 4.3, 3.9, 0.4
#: inches of the strip of single readings: height of a row, margin around them, least width
_ROW, _MARGIN, _NARROWEST = 0.5, 0.9, 6.5


@dataclass(frozen=True, eq=False)
class FitResult(Outcome):
    """The outcome of a fit."""

    #: with friction as torques tell it
    problem: Problem
    #: draws, with the emulators
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
        bodies = [body_of_wear(key) for key in problem.settings.process]
        with atomic_hdf5(path) as file:
            file.attrs.update({"software": SOFTWARE, "fit": problem.text, "keys": [*problem.keys],
                               **self.content["versions"]})  # fmt: skip
            for number, one in enumerate(self.series, start=1):
                name = f"{number}_{re.sub(r'[^A-Za-z0-9.]+', '_', one.series.name)}"
                _write_series(file.create_group(name), one, bodies)
            inputs = [(test, entry) for test in problem.experiments for entry in test.inputs]
            for number, (test, measured) in enumerate(inputs, start=1):
                group, unit = file.create_group(f"inputs/{number}"), measured.unit
                group.attrs.update(experiment=test.name, key=measured.key, unit=unit)
                time, readings = measured.series.x, measured.readings(test.case)
                write_columns(group, {"reading": len(time)}, [
                    ("time", time, "s", "time"),
                    ("data", readings, unit, "reading, in the unit of the key"),
                    ("curve", measured.curve(test.case)(time), unit, "the case's value"),
                ])  # fmt: skip

    def _write_draws(self, path: Path) -> None:
        """Write draws.nc: draws, replicas of the readings by each, and log likelihoods."""
        random, every = np.random.default_rng(0), self.series
        logs, replicas = zip(*(
            readings_of_draws(likelihood, self.draws.of_test(i), random)
            for i, likelihood in enumerate(self.solution.posterior.likelihoods)
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
        write_draws(path, self.draws, self.content["versions"], places, readings)

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
    x, best = posterior.of_tests(solution.theta), posterior.of_tests(solution.best)
    material = posterior.material(solution.theta, random)
    log, bounds = (np.array([getattr(p, n) for p in problem.parameters]) for n in ("log", "bounds"))
    values, of_tests = (values_of(unknowns, log, bounds) for unknowns in (material, x))
    rows = np.linspace(0, len(x) - 1, CHAINS * _KEPT).round().astype(int)
    some = rows[:: max(1, len(rows) // _BANDS)]
    every, scales = list[FittedSeries](), list[FloatArray]()
    for i, likelihood in enumerate(posterior.likelihoods):
        series, drawn = fitted_series(
            likelihood, best[i], x[some, i], solution.depths, problem.settings.level, random
        )
        every, scales = every + series, scales + drawn
    correlations = {
        f"{kind} of {one.title}": np.corrcoef(material[some].T, drawn)[-1]
        for one in every for kind, drawn in one.nuisances.items()
        if kind != GROWTH_TIME and drawn.std() > 0.0
    }  # fmt: skip
    shares = np.median(posterior.shares(solution.theta), axis=0)
    scores, information = np.stack([
        scores_and_information(likelihood, best[i], shares, x[:, i].std(axis=0))
        for i, likelihood in enumerate(posterior.likelihoods)
    ], axis=1)  # fmt: skip
    parameters = key_entries(solution, material, values, of_tests, information, correlations)
    process, squares = process_entries(solution), _goodness(solution, every, x[some])
    checks = [
        *doubts.of_computation(solution), *doubts.of_squares(squares), *doubts.of_trends(every),
        *doubts.of_tests(problem, parameters, scores, information),
    ]  # fmt: skip
    found = (
        *doubts.of_keys(parameters), *(doubt for _, doubt in checks if doubt is not None),
        *doubts.of_readings(every), *doubts.of_sizes(parameters, process),
        *doubts.of_units(problem.experiments),
    )  # fmt: skip
    draws = _draws(solution, rows, values[rows], of_tests[rows])
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
        **_numbers_of_tests(problem.experiments, every, scales),
        "histories": solution.histories,
        "failed_histories": solution.failed,
        "steps": solution.steps,
        "draws": {"effective": solution.effective, "stored": len(draws)},
        "checks": [check for check, _ in checks],
        "doubts": [doubt.to_dict() for doubt in found],
        "warnings": [doubt.text for doubt in found],
        "alternatives": {},
        "loss": problem.settings.loss,
        "versions": versions(),
        "data": dict(problem.hashes),
    }  # fmt: skip
    return FitResult(problem, solution, draws, tuple(every), found, content)


def _draws(solution: Solution, rows: Any, values: FloatArray, of_tests: FloatArray) -> Draws:
    """Return the draws that are kept, some rows of ``theta``: values of the material and tests."""
    problem, theta, units = solution.problem, solution.theta[rows], units_of(solution.problem)
    keys, tests, scatterings = problem.keys, problem.experiments, solution.posterior.scatterings
    shares = solution.posterior.shares(theta).T
    return Draws(
        keys, tuple(units[key] for key in keys), np.array([p.log for p in problem.parameters]),
        np.array([p.bounds for p in problem.parameters], dtype=float), values,
        {keys[s.key]: of_tests[..., s.key] for s in scatterings},
        {(keys[s.key], name): size(theta) for s in scatterings for name, size in s.levels.items()},
        {
            key: np.full(len(theta), noise.size or share**2 * depth)
            for (key, noise), share, depth in zip(
                problem.settings.process.items(), shares, solution.depths, strict=True
            )
        },
        tuple(test.name for test in tests), tuple(test.groups[0] for test in tests),
        law_names(tests[0].case), np.array([conditions_of(test.case, keys) for test in tests]),
    )  # fmt: skip


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


def _goodness(solution: Solution, every: Sequence[FittedSeries], x: FloatArray) -> dict[str, Any]:
    """Return what tells how well the model fits, by draws (s, tests, m) of unknowns.

    ``chi2`` is the sum of squares at the mode, with those of priors, of all readings but mere
    limits, over the noise and random wear; its freedom is the readings less nuisances without
    priors, and less keys, which count by how much the draws raise the squares. ``p_value`` is the
    mean over the draws (Johnson, Ann. Stat. 32 (2004) 2361-2384) for readings whose noise is given;
    None where all is fitted, or has long tails.
    """
    posterior, best = solution.posterior, solution.best[None]
    student = solution.problem.settings.loss == "student"
    points = np.concatenate([posterior.of_tests(best), x])
    parts: list[tuple[FloatArray, float, bool]] = []
    for i, emulated in enumerate(posterior.likelihoods):
        each = emulated.likelihood.least_squares(emulated.emulator(points[:, i]))
        for row, noise in zip(each, emulated.likelihood.noises, strict=True):
            given = not any(series.sd_fitted for series in noise.series)
            parts.append((row, noise.freedom, given))
    squares, freedom, known = map(np.array, zip(*parts, strict=True))
    total, p_value, free = squares.sum(axis=0), None, float(freedom[known].sum())
    if not student and free >= 1.0:
        p_value = float(chi2.sf(squares[known, 1:].sum(axis=0), free).mean())
    raised = max(float(total[1:].mean() - total[0]), 0.0)
    at_mode = float(total[0])
    if student:  # the sd of outliers is larger in the others
        at_mode = sum(float(np.square(one.misfits).sum()) for one in every)
    return {
        "chi2": at_mode, "n_data": sum(one.series.n for one in every),
        "degrees_of_freedom": max(float(freedom.sum()) - raised, 0.0), "p_value": p_value,
        "flagged": p_value is not None and p_value < doubts.IMPROBABLE,
    }  # fmt: skip


def _numbers_of_tests(
    tests: Sequence[Experiment], every: Sequence[FittedSeries], scales: Sequence[FloatArray]
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
    left = iter(scales)
    for test, measured in [(one, measured) for one in tests for measured in one.inputs]:
        curve, readings = measured.curve(test.case), measured.readings(test.case)
        off = readings / np.maximum(curve(measured.series.x), np.finfo(float).tiny) - 1.0
        entry = {
            "time": list(curve.x), "value": list(curve.y), "unit": measured.unit,
            "n": measured.series.n, "scatter": float(np.sqrt(np.mean(off**2))),
        }  # fmt: skip
        if measured.scale is not None:
            mean, sd = measured.scale
            entry["scale"] = _mean_and_sd(mean + sd * next(left))
        inputs.setdefault(test.name, {})[measured.key] = entry
    return {"experiments": experiments, "nuisance": nuisance, "inputs": inputs}


def _mean_and_sd(draws: FloatArray) -> dict[str, Any]:
    """Return the mean of draws (s,) and their sd; None where readings do not change them."""
    sd = float(draws.std())
    return {"estimate": float(draws.mean()), "sd": sd if sd > 0.0 else None}
