"""The result of a fit: estimates with intervals, goodness of fit, what remains open."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning
from ringwear_par.identification.definition.problem import GROWTH_TIME
from ringwear_par.identification.estimation.intervals import information_rows, name_of
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.solution import Solution
from ringwear_par.identification.model.histories import MOST_SHIFT_SD
from ringwear_par.identification.model.noise import NuisanceProjection
from ringwear_par.identification.scatter.material import Material
from ringwear_par.results.result import Outcome

if TYPE_CHECKING:
    from arviz import InferenceData
    from matplotlib.figure import Figure

_ROOM = "ringwear_par.identification"
#: p-value below which a model does not fit
IMPROBABLE = 1e-3
#: relative difference below which sums of squares belong to one optimum
_SAME = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class FitResult(Outcome, Solution):
    """The outcome of a fit: its solution, with a fixed set of names in ``to_dict``.

    Parameters
    ----------
    misfit : the least squares problem, with its noise.
    versions : of the software.
    alternatives : outcomes under other laws, by name.
    failed : why there is no outcome under some other laws, by name.
    material : behind the specimens, where values of keys scatter; ``x``, ``evaluation``,
        ``parameters`` and ``covariance`` are its.
    """

    functions: ClassVar = {
        "summary": f"{_ROOM}.summary", "to_dict": f"{_ROOM}.fit_numbers",
        "doubts": f"{_ROOM}.fit_doubts", "assumptions": f"{_ROOM}.fit_doubts",
        "save": f"{_ROOM}.fit_folder", "plot": f"{_ROOM}.figures",
        "plot_parameters": f"{_ROOM}.figures", "plot_specimens": f"{_ROOM}.figures",
        "to_arviz": f"{_ROOM}.arviz_groups",
    }  # fmt: skip

    misfit: Misfit
    versions: Mapping[str, str]
    alternatives: "Mapping[str, FitResult]" = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)
    material: Material | None = None

    def __repr__(self) -> str:
        estimates = ", ".join(f"{p.key} = {p.estimate:.4g} ({p.verdict})" for p in self.parameters)
        return f"<FitResult: {estimates}; chi2 = {self.chi2:.4g} of {self.n} readings>"

    @property
    def n(self) -> int:
        """Number of readings."""
        return self.misfit.n

    @property
    def chi2(self) -> float:
        """Sum of the squares of the readings' residuals over their noise, but for mere limits."""
        noise = self.evaluation.noise[self.misfit.censored == 0]
        return float(noise @ noise)

    @property
    def residuals(self) -> FloatArray:
        """(n,) data less model over the noise, white; of limits the limit less the model."""
        misfit = self.misfit
        of_limits = (misfit.data - self.evaluation.model) / misfit.sd
        return np.where(misfit.censored == 0, -self.evaluation.noise, of_limits)

    @property
    def noise_fitted(self) -> bool:
        """Whether the noise of some series was fitted."""
        return any(record.series.sd_fitted for record in self.misfit.records)

    @property
    def n_fitted(self) -> int:
        """Number of fitted numbers: keys, nuisances that do something, and noises."""
        fitted_noise = sum(record.series.sd_fitted for record in self.misfit.records)
        sizes = 0 if self.material is None else self.material.n_fitted_sizes
        return len(self.x) - int(self.misfit.idle.sum()) + fitted_noise + sizes

    @property
    def freedom(self) -> float:
        """Degrees of freedom of ``chi2``: readings and priors, less what was fitted.

        Values of specimens count by how much their readings, not the others', determine them.
        """
        values = self.n - np.count_nonzero(self.misfit.censored)
        freedom = values + len(self.misfit.priors) - self.n_fitted
        if self.material is None:
            return freedom
        freedom += len(self.parameters) + self.material.n_fitted_sizes
        # limits tell of the material, too
        return max(freedom - self.material.best_fit.effective_number, 0.0)

    @property
    def total(self) -> float:
        """``chi2`` and the squares of the priors' residuals."""
        return self.chi2 + self._priors

    @property
    def _priors(self) -> float:
        """Sum of the squares of the priors' residuals."""
        rest = self.evaluation.residuals[self.n :]
        return float(rest @ rest)

    @property
    def _deviance(self) -> float:
        """-2 log L of the readings, and the squares of the priors' residuals."""
        if self.material is not None:
            return self.material.deviance
        return self._priors - 2.0 * self.misfit.log_likelihood(self.evaluation)

    @property
    def tested_chi2(self) -> tuple[float, float]:
        """Sum of squares and degrees of freedom of readings whose noise is given, and of priors.

        What was fitted takes its share of both, by the leverage of each reading.
        """
        misfit = self.misfit
        if not self.noise_fitted:
            return self.total, self.freedom
        rows = np.ones(len(self.evaluation.residuals), dtype=bool)
        for _, series, part in misfit.records:
            rows[part] = not series.sd_fitted
        rows[: self.n] &= misfit.censored == 0
        if misfit.problem.settings.process and self.material is not None:
            readings = rows[: self.n]
            free = (1.0 - self.material.best_fit.leverage)[readings].sum() + len(misfit.priors)
            return float((self.evaluation.residuals[rows] ** 2).sum()), float(free)
        free = 1.0 - NuisanceProjection(self.evaluation.jacobian).leverage
        return float((self.evaluation.residuals[rows] ** 2).sum()), float(free[rows].sum())

    @property
    def p_value(self) -> float | None:
        """How probable so large a sum of squares is by chance, for ``tested_chi2``.

        None where all noise was fitted, and under the loss "student", whose noise has long tails.
        """
        squared, freedom = self.tested_chi2
        if self.misfit.problem.settings.loss == "student" or freedom < 1.0:
            return None
        return float(chi2.sf(squared, freedom))

    @property
    def flagged(self) -> bool:
        """Whether the readings speak against the model."""
        return self.p_value is not None and self.p_value < IMPROBABLE

    @property
    def aic(self) -> float:
        """Akaike's information criterion, where priors count as readings.

        -2 log L and the squares of the priors' residuals, and 2 for each of ``n_fitted``.
        """
        return 2.0 * self.n_fitted + self._deviance

    @property
    def bic(self) -> float:
        """The Bayesian one: log ``n`` for each of ``n_fitted``."""
        return float(np.log(self.n)) * self.n_fitted + self._deviance

    @property
    def standard_deviations(self) -> FloatArray:
        """(u,) of the unknowns, infinite where nothing is known."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def natural_covariance(self) -> FloatArray:
        """(m, m) of the fitted keys' values."""
        m = len(self.parameters)
        slopes = self.misfit.problem.slopes(self.misfit.values(self.x))
        return self.covariance[:m, :m] * np.outer(slopes, slopes)

    @property
    def information(self) -> FloatArray:
        """(m, m) Fisher information of the fitted keys' unknowns, nuisances eliminated.

        Of the material's, where they scatter.
        """
        if self.material is not None:
            m = len(self.parameters)
            return np.linalg.pinv(self.covariance[:m, :m], hermitian=True)
        rows = information_rows(self.misfit, self.evaluation)
        keys, nuisances = np.split(rows, [len(self.parameters)], axis=1)
        keys = NuisanceProjection(nuisances).rest(keys)
        return keys.T @ keys

    @property
    def band(self) -> FloatArray:
        """(n,) sd of the model's readings, with nuisances; unknowns without sd count as known."""
        if self.material is not None:
            return self.material.band
        rows = self.misfit.columns(self.x)
        finite = np.where(np.isfinite(self.covariance), self.covariance, 0.0)
        return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, finite, rows), 0.0))

    @property
    def keys_at_bound(self) -> tuple[str, ...]:
        """Fitted keys whose estimate is one of their bounds."""
        return tuple(
            parameter.key
            for parameter, estimate in zip(
                self.misfit.problem.parameters, self.parameters, strict=True
            )
            if any(math.isclose(estimate.estimate, b, rel_tol=1e-9) for b in parameter.bounds)
        )

    @property
    def step_dependent_keys(self) -> tuple[str, ...]:
        """Fitted keys that steps half as long would move by more than they should."""
        shifts = self.discretisation_shift_sd.items()
        return tuple(key for key, shift in shifts if abs(shift) > MOST_SHIFT_SD)

    @property
    def n_at_best(self) -> int:
        """How many starts ended at the best optimum."""
        best = min(start.objective for start in self.starts)
        most = best + _SAME * max(best, 1.0)
        return sum(start.objective <= most for start in self.starts)

    @cached_property
    def doubts(self) -> tuple[ValidityWarning, ...]:
        """What speaks against taking the numbers as they are."""
        return tuple(self.apply("doubts"))

    @property
    def experiments(self) -> dict[str, dict[str, Any]]:
        """Sum of squares and number of readings of each series, by experiment."""
        experiments: dict[str, dict[str, Any]] = {}
        scales = self.misfit.noise_scale.tolist()
        for (experiment, series, part), scale in zip(self.misfit.records, scales, strict=True):
            noise = self.evaluation.noise[part][self.misfit.censored[part] == 0]
            entry = {"chi2": float(noise @ noise), "n": series.n, "unit": series.unit}
            if len(noise) < series.n:
                entry["censored"] = series.n - len(noise)
            if series.sd_fitted:
                entry["sd"] = scale * float(series.sd[0]) / series.factor
            experiments.setdefault(experiment.name, {})[series.name] = entry
        return experiments

    @property
    def nuisances(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Estimate and sd of each nuisance, by experiment and series, in the data's unit.

        That of thermal growth has the ``time`` constant's, s, and tells where it is with ``power``.
        """
        nuisances: dict[str, Any] = {}
        idle, sds = self.misfit.idle, self.standard_deviations
        numbers = {name: i for i, name in enumerate(self.misfit.names)}
        for experiment, series, _ in self.misfit.records:
            for nuisance in series.nuisances:
                i = numbers[experiment.name, series.name, nuisance.kind]
                known = not idle[i] and np.isfinite(sds[i])
                entry = {"estimate": float(self.x[i]), "sd": float(sds[i]) if known else None}
                of_series = nuisances.setdefault(experiment.name, {}).setdefault(series.name, {})
                if nuisance.kind == GROWTH_TIME:
                    of_series["thermal"]["time"] = entry
                else:
                    of_series[nuisance.kind] = entry | ({"power": True} if nuisance.power else {})
        return nuisances

    @property
    def input_readings(
        self,
    ) -> list[tuple[str, str, str, FloatArray, FloatArray, FloatArray]]:
        """Test, key, unit, times (s) and readings of each input, and the curve there."""
        return [
            (experiment.name, measured.key, measured.unit, measured.series.x,
             measured.readings(experiment.case), measured.curve(experiment.case)(measured.series.x))
            for experiment in self.misfit.problem.experiments
            for measured in experiment.inputs
        ]  # fmt: skip

    def to_arviz(self) -> "InferenceData":
        """Return draws and the log likelihood of each reading, as ArviZ has them.

        Raises
        ------
        InputError : arviz is not installed; limits, or a loss without a normal distribution.
        """
        return self.apply("to_arviz")

    def plot_parameters(self) -> "Figure":
        """Return the figure of the fitted keys: ellipses, likelihood profiles, samples."""
        return self.apply("plot_parameters")

    def plot_specimens(self) -> "Figure":
        """Return the figure of the specimens: each one's value, the material's, the next one's.

        Raises
        ------
        InputError : a fit without scatter.
        """
        return self.apply("plot_specimens")

    def correlations(self) -> list[tuple[str, str, float]]:
        """Return pairs of fitted keys and nuisances and their correlation, the strongest first."""
        sds, names = self.standard_deviations, self.misfit.names
        determined = [i for i in range(len(names)) if 0 < sds[i] < np.inf]
        pairs = [
            (name_of(names[i]), name_of(names[j]), float(self.covariance[i, j] / (sds[i] * sds[j])))
            for i in determined
            for j in determined
            if i < j and i < len(self.parameters)
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))
