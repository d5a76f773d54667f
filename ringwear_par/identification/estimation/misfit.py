"""The least squares problem of a fit: unknowns, residuals and their derivatives.

Unknowns are those of the fitted keys, then the nuisances of all series. Residuals are those of all
readings, in units of their noise, then those of all priors. Nuisances are linear, so that they cost
no histories.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.fitted_parameters import ordered_keys
from ringwear_par.identification.definition.problem import Prior, Problem
from ringwear_par.identification.model.histories import Histories
from ringwear_par.identification.model.noise import (
    log_constant,
    log_volume,
    loss_roots,
    weights,
    whitened,
)
from ringwear_par.identification.model.readings import nuisance_columns
from ringwear_par.identification.model.steps import STEPS

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Residuals at some unknowns.

    Parameters
    ----------
    model : (n,) readings as the model has them, nuisances included.
    noise : (n,) residuals of the readings over their sd, uncorrelated.
    noise_jacobian : (n, u).
    residuals : (n + priors,) what is squared and summed.
    jacobian : (n + priors, u).
    sensitivity : (n, m) derivatives of the readings with respect to the fitted keys' values.
    """

    model: FloatArray
    noise: FloatArray
    noise_jacobian: FloatArray
    residuals: FloatArray
    jacobian: FloatArray
    sensitivity: FloatArray

    @property
    def objective(self) -> float:
        """Half the sum of squares."""
        return float(0.5 * self.residuals @ self.residuals)


class Misfit:
    """Residuals of a problem over its unknowns.

    Parameters
    ----------
    problem : the problem.
    histories : of its experiments.

    Attributes
    ----------
    names : (u,) of the unknowns: keys, then (experiment, series, kind) of nuisances.
    data : (n,) the readings.
    nuisance_columns : (n, u - m) what nuisances add to the readings, by their units.
    lower, upper : (u,) bounds.
    ordered : pairs (i, j) of unknowns of which i is never less than j.
    noise_scale : of each series, by which its sd is multiplied.
    steps : about how many a history makes.
    response_cache : responses of histories, or their errors, by the bytes of the keys' values.
    """

    def __init__(self, problem: Problem, histories: Histories) -> None:
        self.problem, self._histories = problem, histories
        self._m = len(problem.parameters)
        self.series = [(e, s) for e in problem.experiments for s in e.series]
        ends = np.cumsum([series.n for _, series in self.series])
        self.parts = [slice(end - s.n, end) for end, (_, s) in zip(ends, self.series, strict=True)]
        self.n = int(ends[-1])
        self.data = np.concatenate([series.value for _, series in self.series])
        self.noise_scale = np.ones(len(self.series))
        self.steps = STEPS
        self.response_cache: dict[bytes, FloatArray | Exception] = {}
        self._lay_out_unknowns()

    def _lay_out_unknowns(self) -> None:
        """Lay the unknowns out."""
        self.names: list[str | tuple[str, str, str]] = list(self.problem.keys)
        limits = [[p.unknown(b) for b in p.bounds] for p in self.problem.parameters]
        priors: list[tuple[int, Prior]] = [
            (j, p.prior) for j, p in enumerate(self.problem.parameters) if p.prior is not None
        ]
        columns = []
        for (experiment, series), part in zip(self.series, self.parts, strict=True):
            series_columns = nuisance_columns(series, experiment.case)
            for nuisance, values in zip(series.nuisances, series_columns.T, strict=True):
                column = np.zeros(self.n)
                column[part] = values
                columns.append(column)
                if nuisance.prior is not None:
                    priors.append((len(self.names), nuisance.prior))
                self.names.append((experiment.name, series.name, nuisance.kind))
                limits.append(list(nuisance.bounds))
        self.lower, self.upper = np.array(limits).T
        self.ordered = ordered_keys(self.problem.parameters)
        self.nuisance_columns = np.stack(columns, axis=1) if columns else np.zeros((self.n, 0))
        self.priors = priors

    @property
    def sd(self) -> FloatArray:
        """(n,) noise of the readings."""
        scaled = zip(self.series, self.noise_scale.tolist(), strict=True)
        return np.concatenate([scale * series.sd for (_, series), scale in scaled])

    def values(self, x: FloatArray) -> FloatArray:
        """Return the fitted keys' values (m,) of unknowns."""
        parameters = self.problem.parameters
        return np.array([p.value(u) for p, u in zip(parameters, x, strict=False)])

    def slopes(self, values: FloatArray) -> FloatArray:
        """Return the derivatives (m,) of the values with respect to their unknowns."""
        return np.array([p.slope(v) for p, v in zip(self.problem.parameters, values, strict=True)])

    def allowed(self, points: FloatArray) -> BoolArray:
        """Return at which unknowns (p, m) of the fitted keys all rules of the laws hold, (p,)."""
        return self._histories.allowed(np.array([self.values(x) for x in points]))

    def is_computed(self, x: FloatArray) -> bool:
        """Tell whether the histories at unknowns were computed."""
        return self.values(x).tobytes() in self.response_cache

    def forget(self, points: Sequence[FloatArray], but: FloatArray) -> None:
        """Forget the histories at unknowns, but for those at some."""
        remaining = self.values(but).tobytes()
        for key in {self.values(x).tobytes() for x in points} - {remaining}:
            self.response_cache.pop(key, None)

    def keep_only(self, x: FloatArray) -> None:
        """Forget all histories but those at unknowns. Not collective."""
        self.compute([x])
        key = self.values(x).tobytes()
        self.response_cache = {key: self.response_cache[key]}

    def part_from_histories(self) -> None:
        """Let the histories' engines and communicator go: responses computed so far remain."""
        del self._histories

    def compute(self, points: Sequence[FloatArray]) -> None:
        """Have the histories at unknowns computed together, and keep them. Not collective."""
        values = [self.values(x) for x in points]
        new = {v.tobytes(): v for v in values if v.tobytes() not in self.response_cache}
        if new:
            responses = self._histories.responses(np.array(list(new.values())), self.steps)
            self.response_cache.update(zip(new, responses, strict=True))

    def refine(self) -> None:
        """Have histories make twice as many steps from now on."""
        self.steps *= 2
        self.response_cache = {}

    def discretisation_shift(
        self, x: FloatArray, evaluation: Evaluation, covariance: FloatArray
    ) -> FloatArray | None:
        """Return by how many sd (m,) steps half as long would move the fitted keys' unknowns.

        To the first order, and 0 of those of which nothing is known; None, and a warning, where no
        history comes of such steps. Not collective.

        Parameters
        ----------
        x, evaluation, covariance : the optimum, the residuals there, (u, u) of the unknowns.
        """
        values = self.values(x)
        (finer_response,) = self._histories.responses(
            values[None], 2 * self.steps, derivatives=False
        )
        if isinstance(finer_response, Exception):
            log.warning("what shorter steps would change is not known: %s", finer_response)
            return None
        change = self.whitened(finer_response[:, 0] - self.model_readings(x))
        growth = (
            loss_roots(self.problem.settings.loss, evaluation.noise + change)[0]
            - evaluation.residuals[: self.n]
        )
        finite = np.where(np.isfinite(covariance), covariance, 0.0)[: self._m]
        sd = np.sqrt(np.diag(finite))
        shift = finite @ (evaluation.jacobian[: self.n].T @ growth)
        return np.divide(-shift, sd, out=np.zeros(self._m), where=sd > 0.0)

    def _response(self, x: FloatArray) -> FloatArray:
        self.compute([x])
        response = self.response_cache[self.values(x).tobytes()]
        if isinstance(response, Exception):
            raise response
        return response

    def model_readings(self, x: FloatArray) -> FloatArray:
        """Return the readings (n,) as the model has them without nuisances. Not collective.

        Raises
        ------
        ComputationError : a history.
        """
        return self._response(x)[:, 0]

    def columns(self, x: FloatArray) -> FloatArray:
        """Return derivatives (n, u) of the readings with respect to the unknowns. Not collective.

        Raises
        ------
        ComputationError : a history.
        """
        key_columns = self._response(x)[:, 1:] * self.slopes(self.values(x))
        return np.concatenate([key_columns, self.nuisance_columns], axis=1)

    def evaluate(self, x: FloatArray) -> Evaluation:
        """Return the residuals at unknowns (u,). Not collective.

        Raises
        ------
        ComputationError : a history.
        """
        values, response = self.values(x), self._response(x)
        model = response[:, 0] + self.nuisance_columns @ x[self._m :]
        jacobian = self.columns(x)
        rows = np.concatenate([(model - self.data)[:, None], jacobian], axis=1)
        rows = self.whitened(rows)
        noise, noise_jacobian = rows[:, 0], rows[:, 1:]
        loss, slope = loss_roots(self.problem.settings.loss, noise)
        residuals = np.append(loss, np.zeros(len(self.priors)))
        whole = np.concatenate(
            [slope[:, None] * noise_jacobian, np.zeros((len(self.priors), len(x)))]
        )
        for row, (j, prior) in enumerate(self.priors, start=self.n):
            at, by = (values[j], self.slopes(values)[j]) if j < self._m else (x[j], 1.0)
            residuals[row], whole[row, j] = (at - prior.mean) / prior.sd, by / prior.sd
        return Evaluation(model, noise, noise_jacobian, residuals, whole, response[:, 1:])

    def whitened(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) of all readings in units of their noise, uncorrelated."""
        rows = rows / self.sd.reshape(-1, *(1,) * (rows.ndim - 1))
        parts = zip(self.series, self.parts, strict=True)
        return np.concatenate([whitened(series, rows[part]) for (_, series), part in parts])

    def noise_growth(self, evaluation: Evaluation) -> FloatArray:
        """Return the scatter of each series over its noise, (series,)."""
        by_loss = weights(self.problem.settings.loss, evaluation.noise)
        weighted = by_loss * evaluation.noise**2
        leverage = (np.linalg.qr(evaluation.jacobian)[0] ** 2).sum(axis=1)
        return np.array(
            [
                np.sqrt(weighted[part].sum() / max(1.0, (1.0 - leverage[part]).sum()))
                for part in self.parts
            ]
        )

    def log_likelihood(self, evaluation: Evaluation) -> float:
        """Return the logarithm of the likelihood of the readings."""
        scatter = float(np.log(self.sd).sum()) + sum(log_volume(s) for _, s in self.series)
        loss = evaluation.residuals[: self.n]
        constant = log_constant(self.problem.settings.loss)
        return float(-0.5 * loss @ loss - scatter - self.n * constant)

    def with_best_nuisances(self, values: Sequence[float]) -> FloatArray:
        """Return unknowns (u,) at values of the fitted keys, with the best nuisances for them.

        Raises
        ------
        ComputationError : a history.
        """
        unknowns = [p.unknown(v) for p, v in zip(self.problem.parameters, values, strict=True)]
        x = np.concatenate(
            [unknowns, np.clip(np.zeros(len(self.names) - self._m), *self._nuisance_limits)]
        )
        if len(x) == self._m:
            return x
        evaluation = self.evaluate(x)
        rows = np.array([True] * self.n + [j >= self._m for j, _ in self.priors])
        columns = evaluation.jacobian[rows, self._m :]
        size = np.linalg.norm(columns, axis=0)
        size[size == 0] = 1.0  # one that does nothing
        low, high = ((limit - x[self._m :]) * size for limit in self._nuisance_limits)
        step = lsq_linear(columns / size, -evaluation.residuals[rows], (low, high)).x
        x[self._m :] = np.clip(x[self._m :] + step / size, *self._nuisance_limits)
        return x

    @property
    def _nuisance_limits(self) -> tuple[FloatArray, FloatArray]:
        return self.lower[self._m :], self.upper[self._m :]

    @property
    def linear(self) -> BoolArray:
        """(u,) bool, unknowns on which residuals depend linearly, and which have no bounds."""
        free = np.isinf(self.lower) & np.isinf(self.upper)
        free[: self._m] = False
        return free & (self.problem.settings.loss == "gaussian")

    @property
    def idle(self) -> BoolArray:
        """(u,) bool, which nuisances do nothing to any reading and have no prior."""
        with_prior = {j for j, _ in self.priors}
        acts = np.append(
            np.ones(self._m, dtype=bool), np.abs(self.nuisance_columns).sum(axis=0) > 0
        )
        return ~acts & ~np.isin(np.arange(len(acts)), list(with_prior))
