"""The result of a fit: estimates with intervals, goodness of fit, what remains open."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.fitted_tests import FittedTest
from ringwear_par.identification.key_estimates import ParameterEstimate
from ringwear_par.identification.solution import Solution
from ringwear_par.results.result import Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: p-value below which a model does not fit
IMPROBABLE = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class FitResult(Outcome):
    """The outcome of a fit, with a fixed set of names in ``to_dict``.

    Parameters
    ----------
    problem : with friction as torques tell it.
    solution : draws by the sampler, with the emulators.
    draws : of what the fit knows, in the order of chains.
    entries, process : of the fitted keys and of random wear, as fit.json has them.
    tests : at the mode and among the draws.
    information : (2, tests, m) slopes of log p of each test at the mode, and minus its curvatures.
    versions : of the software.
    alternatives : outcomes under other laws, by name.
    failed : why there is no outcome under some other laws, by name.
    """

    problem: Problem
    solution: Solution
    draws: Draws
    entries: Mapping[str, dict[str, Any]]
    process: Mapping[str, dict[str, Any]]
    tests: tuple[FittedTest, ...]
    information: FloatArray
    versions: Mapping[str, str]
    alternatives: "Mapping[str, FitResult]" = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        estimates = ", ".join(f"{p.key} = {p.estimate:.3g} ({p.verdict})" for p in self.parameters)
        return f"<FitResult: {estimates}; chi2 = {self.chi2:.4g} of {self.n} readings>"

    @property
    def parameters(self) -> tuple[ParameterEstimate, ...]:
        """The fitted keys; of the material where they scatter."""
        return tuple(
            ParameterEstimate(
                key, entry["estimate"], entry["sd"], tuple(entry["interval"]), entry["verdict"],
                entry.get("direction", ""),
            )
            for key, entry in self.entries.items()
        )  # fmt: skip

    @property
    def covariance(self) -> FloatArray:
        """(m, m) of the fitted keys' values."""
        return np.atleast_2d(np.cov(self.draws.values(self.draws.material).T))

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
        shares = posterior.shares(best, posterior.known)
        log_p = float(posterior.of_readings(posterior.of_tests(best), shares)[0])
        return 2.0 * posterior.dimension - 2.0 * log_p

    @cached_property
    def doubts(self) -> tuple[ValidityWarning, ...]:
        """What speaks against taking the numbers as they are."""
        from ringwear_par.identification.doubts import doubts

        return tuple(doubts(self))

    @property
    def experiments(self) -> dict[str, dict[str, Any]]:
        """Sum of squares and number of readings of each series, by experiment."""
        experiments: dict[str, dict[str, Any]] = {}
        for test in self.tests:
            of_test = experiments.setdefault(test.experiment.name, {})
            for series, part in test.records:
                values = test.residuals[part][test.censored[part] == 0.0]
                entry = {"chi2": float(values @ values), "n": series.n, "unit": series.unit}
                if len(values) < series.n:
                    entry["censored"] = series.n - len(values)
                if series.sd_fitted:
                    entry["sd"] = float(test.sd[part][0]) / series.factor
                of_test[series.name] = entry
        return experiments

    @property
    def nuisances(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Mean and sd of each nuisance, by experiment and series, in the data's unit.

        That of thermal growth has the ``time`` constant's, s, and tells where it is with ``power``.
        """
        nuisances: dict[str, Any] = {}
        for test in self.tests:
            for number, series in enumerate(test.experiment.series):
                for nuisance in series.nuisances:
                    if (number, nuisance.kind) not in test.nuisances:
                        continue
                    entry = mean_and_sd(test.nuisances[number, nuisance.kind])
                    if nuisance.kind == "thermal":
                        entry["time"] = mean_and_sd(test.growth_times[number])
                    entry |= {"power": True} if nuisance.power else {}
                    of_test = nuisances.setdefault(test.experiment.name, {})
                    of_test.setdefault(series.name, {})[nuisance.kind] = entry
        return nuisances

    @property
    def input_readings(self) -> list[tuple[str, str, str, FloatArray, FloatArray, FloatArray]]:
        """Test, key, unit, times (s) and readings of each input, and the curve there."""
        return [
            (experiment.name, measured.key, measured.unit, measured.series.x,
             measured.readings(experiment.case), measured.curve(experiment.case)(measured.series.x))
            for experiment in self.problem.experiments
            for measured in experiment.inputs
        ]  # fmt: skip

    def summary(self) -> str:
        """Return it in a few lines, as the command prints it."""
        from ringwear_par.identification.summary import summary

        return summary(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of fit.json."""
        from ringwear_par.identification.fit_numbers import to_dict

        return to_dict(self)

    def save(self, path: str | Path) -> None:
        """Write the files of its folder, see ``Outcome.save``."""
        from ringwear_par.identification.fit_folder import save

        save(self, Path(path))

    def plot(self) -> "Figure":
        """Return the figure of data, model, its band and residuals."""
        from ringwear_par.identification.figures import plot

        return plot(self)

    def plot_parameters(self) -> "Figure":
        """Return the figure of the fitted keys: draws of each, and of pairs."""
        from ringwear_par.pictures import key_panels
        from ringwear_par.pictures.matplotlib import panel_figure

        by_key = dict(zip(self.draws.keys, self.draws.values(self.draws.material).T, strict=True))
        rows = key_panels.fitted_keys(self.to_dict(), by_key)
        return panel_figure(rows, (0.8 + 3.2 * len(rows), 0.8 + 3.1 * len(rows)))

    def plot_specimens(self) -> "Figure":
        """Return the figure of the specimens: each one's value, the material's, the next one's.

        Raises
        ------
        InputError : a fit without scatter.
        """
        from ringwear_par.identification.figures import plot_specimens

        return plot_specimens(self)


def mean_and_sd(draws: FloatArray) -> dict[str, Any]:
    """Return the mean of draws (s,) and their sd; None where readings do not change them."""
    sd = float(draws.std())
    return {"estimate": float(draws.mean()), "sd": sd if sd > 0.0 else None}
