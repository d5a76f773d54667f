"""The result of a fit: estimates with intervals, goodness of fit, what remains open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning
from ringwear_par.identification import doubts, fit_folder
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.doubts import IMPROBABLE, Check
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.fitted_tests import FittedTest
from ringwear_par.identification.solution import Solution
from ringwear_par.identification.summary import summary
from ringwear_par.results.result import Outcome


@dataclass(frozen=True, eq=False, kw_only=True)
class FitResult(Outcome):
    """The outcome of a fit, with a fixed set of names in ``to_dict``.

    Parameters
    ----------
    problem : with friction as torques tell it.
    solution : draws by the sampler, with the emulators.
    draws : of what the fit knows, in the order of chains.
    parameters, process : of the fitted keys and of random wear, as fit.json has them.
    tests : at the mode and among the draws.
    information : (2, tests, m) slopes of log p of each test at the mode, and minus its curvatures.
    versions : of the software.
    alternatives : outcomes under other laws, by name.
    failed : why there is no outcome under some other laws, by name.
    """

    problem: Problem
    solution: Solution
    draws: Draws
    parameters: Mapping[str, dict[str, Any]]
    process: Mapping[str, dict[str, Any]]
    tests: tuple[FittedTest, ...]
    information: FloatArray
    versions: Mapping[str, str]
    alternatives: "Mapping[str, FitResult]" = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        keys = self.parameters.items()
        estimates = (f"{key} = {e['estimate']:.3g} ({e['verdict']})" for key, e in keys)
        return f"<FitResult: {', '.join(estimates)}; chi2 = {self.chi2:.4g} of {self.n} readings>"

    @property
    def n(self) -> int:
        """Number of readings."""
        return sum(len(test.data) for test in self.tests)

    @property
    def chi2(self) -> float:
        """Sum of squares at the mode, with those of priors: of all readings but mere limits.

        Over the noise, and random wear where it is fitted; nuisances are at their best.
        """
        if self.problem.settings.loss == "student":  # the sd of outliers is larger in the others
            return sum(float(np.square(t.residuals[t.censored == 0.0]).sum()) for t in self.tests)
        return sum(float(test.squares[:, 0].sum()) for test in self.tests)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of ``chi2``: readings less nuisances without priors, and keys.

        These count by how much the draws raise the squares above those of the mode.
        """
        squares = np.sum([test.squares.sum(axis=0) for test in self.tests], axis=0)
        raised = max(float(squares[1:].mean() - squares[0]), 0.0)
        return max(sum(float(test.freedom.sum()) for test in self.tests) - raised, 0.0)

    @cached_property
    def p_value(self) -> float | None:
        """How probable so large a sum of squares is by chance, of readings whose noise is given.

        The mean over the draws (Johnson, Ann. Stat. 32 (2004) 2361-2384). None where all noise was
        fitted, and under the loss "student", whose noise has long tails.
        """
        free = sum(float(test.freedom[test.given].sum()) for test in self.tests)
        if self.problem.settings.loss == "student" or free < 1.0:
            return None
        squares = np.sum([test.squares[test.given, 1:].sum(axis=0) for test in self.tests], axis=0)
        return float(chi2.sf(squares, free).mean())

    @property
    def flagged(self) -> bool:
        """Whether the readings speak against the model."""
        return self.p_value is not None and self.p_value < IMPROBABLE

    @property
    def aic(self) -> float:
        """Akaike's information criterion at the mode, but for a constant of the readings.

        Nuisances and fitted noise are integrated out, as in the posterior.
        """
        posterior, best = self.solution.posterior, self.solution.best[None]
        log_p = float(posterior.of_readings(best)[0])
        return 2.0 * posterior.dimension - 2.0 * log_p

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        """What was checked, the computation first."""
        return (
            *doubts.of_computation(self.solution),
            *doubts.of_squares(self.chi2, self.freedom, self.p_value),
            *doubts.of_trends(self.tests),
            *doubts.of_tests(self.problem, self.parameters, self.information),
        )

    @cached_property
    def doubts(self) -> tuple[ValidityWarning, ...]:
        """What speaks against taking the numbers as they are."""
        return (
            *doubts.of_keys(self.parameters),
            *(check.doubt for check in self.checks if check.doubt is not None),
            *doubts.of_readings(self.tests),
            *doubts.of_sizes(self.parameters, self.process),
            *doubts.of_units(self.problem.experiments),
        )

    def summary(self) -> str:
        """Return it in a few lines, as the command prints it."""
        return summary(self.problem.name, self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of fit.json."""
        problem, solution = self.problem, self.solution
        alternatives: dict[str, Any] = {n: law.to_dict() for n, law in self.alternatives.items()}
        for law in alternatives.values():
            del law["alternatives"], law["data"]
        return {
            "parameters": {key: dict(entry) for key, entry in self.parameters.items()},
            "keys": [*problem.keys],
            "covariance": np.atleast_2d(np.cov(self.draws.values(self.draws.material).T)).tolist(),
            "level": problem.settings.level,
            "chi2": self.chi2,
            "n_data": self.n,
            "degrees_of_freedom": self.freedom,
            "p_value": self.p_value,
            "flagged": self.flagged,
            "aic": self.aic,
            "evidence": solution.log_evidence,
            "evidence_error": solution.evidence_error,
            "specimens": len({test.groups[0] for test in problem.experiments}),
            "process": {key: dict(entry) for key, entry in self.process.items()},
            **_numbers_of_tests(self.tests),
            "histories": solution.histories,
            "failed_histories": solution.failed,
            "steps": solution.steps,
            "draws": {"effective": solution.effective, "stored": len(self.draws)},
            "checks": [
                {"name": name, "value": value if np.isfinite(value) else None, "limit": limit,
                 "pass": passed}
                for name, value, limit, passed, _ in self.checks
            ],
            "doubts": [doubt.to_dict() for doubt in self.doubts],
            "warnings": [doubt.text for doubt in self.doubts],
            "alternatives": alternatives | {n: {"error": why} for n, why in self.failed.items()},
            "loss": problem.settings.loss,
            "versions": dict(self.versions),
            "data": dict(problem.hashes),
        }  # fmt: skip

    def save(self, path: str | Path) -> None:
        """Write the files of its folder, see ``Outcome.save``."""
        likelihoods, outcome = self.solution.posterior.likelihoods, self.to_dict()
        fit_folder.save(Path(path), outcome, self.problem, self.draws, self.tests, likelihoods)

    def plot(self) -> Figure:
        """Return the figure of data, model, its band and residuals."""
        return fit_folder.figure_of_readings(self.tests, self.problem.settings.level)


def _numbers_of_tests(tests: Sequence[FittedTest]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the numbers of series, their nuisances and measured inputs, by test.

    Nuisances are in the data's unit; that of thermal growth has the ``time`` constant's, s. The
    curve of an input is at ``time``, s; the scatter about it is a relative standard deviation.
    """
    experiments, nuisance, inputs = (dict[str, dict[str, Any]]() for _ in range(3))
    for test in tests:
        name, case, scaled = test.experiment.name, test.experiment.case, 0
        of_series = experiments[name] = {}
        for number, (series, part) in enumerate(test.records):
            values = test.residuals[part][test.censored[part] == 0.0]
            entry = {"chi2": float(values @ values), "n": series.n, "unit": series.unit}
            if len(values) < series.n:
                entry["censored"] = series.n - len(values)
            if series.sd_fitted:
                entry["sd"] = float(test.sd[part][0]) / series.factor
            of_series[series.name], found = entry, {}
            for kind, power in ((n.kind, n.power) for n in series.nuisances):
                if (number, kind) in test.nuisances:
                    found[kind] = _mean_and_sd(test.nuisances[number, kind])
                    if kind == "thermal":
                        found[kind]["time"] = _mean_and_sd(test.growth_times[number])
                    found[kind] |= {"power": True} if power else {}
            if found:
                nuisance.setdefault(name, {})[series.name] = found
        for measured in test.experiment.inputs:
            curve, readings = measured.curve(case), measured.readings(case)
            off = readings / np.maximum(curve(measured.series.x), np.finfo(float).tiny) - 1.0
            entry = {
                "time": list(curve.x), "value": list(curve.y), "unit": measured.unit,
                "n": measured.series.n, "scatter": float(np.sqrt(np.mean(off**2))),
            }  # fmt: skip
            if measured.scale is not None:
                (mean, sd), drawn = measured.scale, test.nuisances[-1, str(scaled)]
                scaled, entry["scale"] = scaled + 1, _mean_and_sd(mean + sd * drawn)
            inputs.setdefault(name, {})[measured.key] = entry
    return {"experiments": experiments, "nuisance": nuisance, "inputs": inputs}


def _mean_and_sd(draws: FloatArray) -> dict[str, Any]:
    """Return the mean of draws (s,) and their sd; None where readings do not change them."""
    sd = float(draws.std())
    return {"estimate": float(draws.mean()), "sd": sd if sd > 0.0 else None}
