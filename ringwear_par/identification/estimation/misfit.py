"""The least squares problem of a fit: unknowns, residuals and their derivatives.

Unknowns are those of the fitted keys, then the nuisances of all series. Histories give each test's
readings with their derivatives, (n, 1 + m); these are compared with the data, whitened, and weighed
by the loss, which makes residuals in units of their noise; those of all priors follow. Nuisances
cost no histories, and all but the time constants of thermal growth are linear.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ringwear_par.arrays import BoolArray, FloatArray, short_repr
from ringwear_par.identification.definition.problem import (
    GROWTH_TIME,
    SCALE,
    Experiment,
    Nuisance,
    Prior,
    Problem,
    Series,
)
from ringwear_par.identification.model.histories import Histories, HistoryError
from ringwear_par.identification.model.noise import (
    NuisanceProjection,
    bounded_solution,
    censored_rows,
    log_constant,
    log_volume,
    loss_roots,
    weights,
    whitened,
)
from ringwear_par.identification.model.readings import nuisance_columns
from ringwear_par.identification.model.rounds import Responses

log = logging.getLogger(__name__)

#: steps of nuisances under a loss with weights, and sd by which the last one moves readings
_REWEIGHTED, _SETTLED = 60, 1e-6


class Record(NamedTuple):
    """A series of a test, and its rows among the readings of all."""

    experiment: Experiment
    series: Series
    rows: slice


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Residuals at some unknowns."""

    #: (n,) readings as the model has them, nuisances included
    model: FloatArray
    #: (n,) residuals of the readings over their sd, uncorrelated; their derivatives (n, u)
    noise: FloatArray
    noise_jacobian: FloatArray
    #: (n + priors,) what is squared and summed; their derivatives (n + priors, u)
    residuals: FloatArray
    jacobian: FloatArray
    #: (n, m) derivatives of the readings with respect to the fitted keys' values
    sensitivity: FloatArray
    #: (n,) factor of the derivatives ``noise_jacobian``, of readings that are but limits; else 1
    roots: FloatArray

    __repr__ = short_repr

    @property
    def objective(self) -> float:
        """Half the sum of squares."""
        return float(0.5 * self.residuals @ self.residuals)


class Misfit:
    """Residuals of a problem over its unknowns.

    Attributes
    ----------
    records : of all series.
    names : (u,) of the unknowns: keys, then (experiment, series, kind) of nuisances.
    data : (n,) the readings.
    censored : (n,) -1 where the true value is at most the reading, 1 where at least, else 0.
    expected_nuisances : (u - m,) by their priors, or 0; the start of a time constant.
    nuisance_columns : (n, u - m) what nuisances add to the readings, by their units, linearised
        where they are expected; those of factors on inputs see ``linearise_inputs``.
    lower, upper : (u,) bounds.
    priors : of unknowns, by their numbers.
    noise_scale : of each series, by which its sd is multiplied.
    responses : readings of the tests' histories.
    """

    def __init__(self, problem: Problem, histories: Histories) -> None:
        self.problem, self.responses = problem, Responses(problem, histories)
        self._m = len(problem.parameters)
        self.records: list[Record] = []
        self.n = 0
        for experiment in problem.experiments:
            for series in experiment.series:
                rows = slice(self.n, self.n + series.n)
                self.records.append(Record(experiment, series, rows))
                self.n = rows.stop
        self.data = np.concatenate([record.series.value for record in self.records])
        sides = [np.zeros(r.series.n, int) if r.series.censored is None else r.series.censored
                 for r in self.records]  # fmt: skip
        self.censored = np.concatenate(sides)
        self.noise_scale = np.ones(len(self.records))
        self._factors = problem.factors
        self._lay_out_unknowns()

    def renew_inputs(self, x: FloatArray) -> bool:
        """Update friction by torques and histories at unknowns; tell whether any input changed.

        Factors on inputs are linearised at these unknowns. Not collective.
        """
        by_torque = any(e.torque_input is not None for e in self.problem.experiments)
        if by_torque:
            tests = self.responses.renew_inputs(self.values(x))
            by_name = {test.name: test for test in tests}
            self.problem = self.problem.with_experiments(tests)
            self.records = [r._replace(experiment=by_name[r.experiment.name]) for r in self.records]
        self.linearise_inputs(x)
        return by_torque or bool(self._scales)

    def linearise_inputs(self, x: FloatArray, test_unknowns: FloatArray | None = None) -> None:
        """Linearise the effect of factors on inputs at unknowns, (tests, m) of each test.

        Not collective.
        """
        if self._scales:
            by_factors = self._response(x, test_unknowns)[:, 1 + self._m :]
            for rows, place, taken in self._scales:
                self.nuisance_columns[rows, place] = by_factors[rows, : len(taken)] @ taken

    def _lay_out_unknowns(self) -> None:
        """Number the unknowns, and set their bounds, priors and columns."""
        parameters = self.problem.parameters
        self.names: list[str | tuple[str, str, str]] = list(self.problem.keys)
        nuisances: list[Nuisance] = []
        columns = [np.zeros((self.n, 0))]

        def add(test: str, name: str, nuisance: Nuisance, rows: slice, values: FloatArray) -> None:
            self.names.append((test, name, nuisance.kind))
            nuisances.append(nuisance)
            columns.append(np.zeros((self.n, 1)))
            columns[-1][rows, 0] = values

        # numbers of records with thermal growth, and their nuisances among all
        self._growths: list[tuple[int, slice]] = []
        for number, (experiment, series, rows) in enumerate(self.records):
            first = len(nuisances)
            if any(nuisance.kind == GROWTH_TIME for nuisance in series.nuisances):
                self._growths.append((number, slice(first, first + len(series.nuisances))))
            series_columns = nuisance_columns(series, experiment.case).T
            for nuisance, values in zip(series.nuisances, series_columns, strict=True):
                add(experiment.name, series.name, nuisance, rows, values)
        #: factors on measured inputs: rows of their test, place among the nuisances, and how much
        #: of the derivatives by ``problem.factors`` they take
        self._scales: list[tuple[slice, int, FloatArray]] = []
        start = 0
        for experiment in self.problem.experiments:
            rows = slice(start, start + experiment.n)
            start = rows.stop
            for measured in experiment.inputs:
                if measured.scale is None:
                    continue
                key = measured.key.replace("pressure", "force")
                taken = np.array([float(factor == key) for factor in self._factors])
                if key == "load.force" and experiment.torque_input is not None:
                    taken[self._factors.index("contact.friction")] = -1.0
                self._scales.append((rows, len(nuisances), taken))
                prior = Prior(0.0, measured.scale.sd / measured.scale.mean)
                add(experiment.name, measured.key, Nuisance(SCALE, prior), rows, np.zeros(1))
        known = [unknown.prior for unknown in parameters]
        known += [nuisance.prior for nuisance in nuisances]
        self.priors = [(j, prior) for j, prior in enumerate(known) if prior is not None]
        bounds = np.array([nuisance.bounds for nuisance in nuisances]).reshape(-1, 2)
        self.lower, self.upper = np.vstack([np.transpose(self.problem.unknown_bounds), bounds]).T
        self.nuisance_columns = np.concatenate(columns, axis=1)
        self.expected_nuisances = np.array([nuisance.expected for nuisance in nuisances])
        # (u - m,) which are growths and which time constants, and how large these are at first
        kinds = np.array([nuisance.kind for nuisance in nuisances], dtype=object)
        self._grown, self._times = kinds == "thermal", kinds == GROWTH_TIME
        self._first_times = np.array([nuisance.start for nuisance in nuisances])

    @property
    def sd(self) -> FloatArray:
        """(n,) noise of the readings."""
        scaled = zip(self.records, self.noise_scale.tolist(), strict=True)
        return np.concatenate([scale * record.series.sd for record, scale in scaled])

    def values(self, x: FloatArray) -> FloatArray:
        """Return the fitted keys' values (m,) of unknowns, nuisances among them or not."""
        return self.problem.values(x[: self._m])

    def values_of_tests(self, x: FloatArray, test_unknowns: FloatArray | None) -> list[FloatArray]:
        """Return the keys' values (m,) of each test, by unknowns (tests, m), or x for all."""
        if test_unknowns is None:
            return [self.values(x)] * len(self.problem.experiments)
        return [self.values(unknowns) for unknowns in test_unknowns]

    def _response(self, x: FloatArray, test_unknowns: FloatArray | None = None) -> FloatArray:
        return self.responses.of_tests(self.values_of_tests(x, test_unknowns))

    def model_readings(self, x: FloatArray) -> FloatArray:
        """Return the readings (n,) as the model has them without nuisances. Not collective."""
        return self._response(x)[:, 0]

    def clocks(
        self, x: FloatArray, test_unknowns: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return how readings follow the wear of bodies that is random. Not collective.

        (n, bodies) of each reading: its change for each mm of mean depth that is worn faster all
        along, and that mean depth, mm.
        """
        clock_response = self._response(x, test_unknowns)[:, 1 + self._m + len(self._factors) :]
        by_factor, depth = np.split(clock_response, 2, axis=1)
        return np.divide(by_factor, depth, out=np.zeros_like(depth), where=depth > 0.0), depth

    # from readings to residuals

    def columns(self, x: FloatArray, test_unknowns: FloatArray | None = None) -> FloatArray:
        """Return derivatives (n, u) of the readings by the unknowns. Not collective."""
        counts = [experiment.n for experiment in self.problem.experiments]
        slopes = [self.problem.slopes(v) for v in self.values_of_tests(x, test_unknowns)]
        derivatives = self._response(x, test_unknowns)[:, 1 : 1 + self._m]
        key_columns = derivatives * np.repeat(slopes, counts, axis=0)
        return np.concatenate([key_columns, self.nuisance_derivatives(x)], axis=1)

    def nuisance_derivatives(self, x: FloatArray) -> FloatArray:
        """Return derivatives (n, u - m) of the readings with respect to nuisances, at unknowns."""
        columns = self.nuisance_columns
        if self._growths:
            columns = columns.copy()
            for number, places in self._growths:
                experiment, series, rows = self.records[number]
                values = x[self._m :][places]
                columns[rows, places] = nuisance_columns(series, experiment.case, values)
        return columns

    def nuisance_readings(self, x: FloatArray) -> FloatArray:
        """Return the nuisances of unknowns as they are in the readings, (n,)."""
        return self.nuisance_derivatives(x) @ np.where(self._times, 0.0, x[self._m :])

    def evaluate(
        self,
        x: FloatArray,
        test_unknowns: FloatArray | None = None,
        random_part: FloatArray | float = 0.0,
    ) -> Evaluation:
        """Return the residuals at unknowns (u,), or raise HistoryError. Not collective.

        Keys have unknowns (tests, m) of their own where their values scatter; priors are of those
        of x. ``random_part`` (n,) of the readings is due to the random part of wear.
        """
        values, response = self.values(x), self._response(x, test_unknowns)
        model = response[:, 0] + self.nuisance_readings(x) + random_part
        rows = np.concatenate(
            [(model - self.data)[:, None], self.columns(x, test_unknowns)], axis=1
        )
        rows = self.whitened(rows)
        noise, noise_jacobian = rows[:, 0], rows[:, 1:]
        loss, slope = loss_roots(self.problem.settings.loss, noise)
        limits, roots = np.flatnonzero(self.censored), np.ones(self.n)
        if len(limits):
            noise, loss = noise.copy(), loss.copy()
            noise[limits], roots[limits], loss[limits], slope[limits] = censored_rows(
                self.censored[limits], noise[limits]
            )
        residuals = np.append(loss, np.zeros(len(self.priors)))
        jacobian = np.concatenate(
            [slope[:, None] * noise_jacobian, np.zeros((len(self.priors), len(x)))]
        )
        noise_jacobian = roots[:, None] * noise_jacobian
        slopes = self.problem.slopes(values)
        for row, (j, prior) in enumerate(self.priors, start=self.n):
            at, by = (values[j], slopes[j]) if j < self._m else (x[j], 1.0)
            residuals[row], jacobian[row, j] = (at - prior.mean) / prior.sd, by / prior.sd
        sensitivity = response[:, 1 : 1 + self._m]
        return Evaluation(model, noise, noise_jacobian, residuals, jacobian, sensitivity, roots)

    def whitened(self, rows: FloatArray) -> FloatArray:
        """Return rows (n, ...) of all readings in units of their noise, uncorrelated."""
        rows = rows / self.sd.reshape(-1, *(1,) * (rows.ndim - 1))
        return np.concatenate([whitened(series, rows[part]) for _, series, part in self.records])

    def discretisation_shift(
        self, x: FloatArray, evaluation: Evaluation, covariance: FloatArray
    ) -> FloatArray | None:
        """Return by how many sd (m,) steps half as long would move the fitted keys' unknowns.

        From x, the optimum, to the first order, and 0 of those of which nothing is known; None
        where all readings are limits, and, with a warning, where no history comes of such steps.
        Not collective.
        """
        if self.censored.all():
            return None
        finer = self.responses.in_shorter_steps(self.values(x))
        if isinstance(finer, HistoryError):
            log.warning("what shorter steps would change is not known: %s", finer)
            return None
        change = self.whitened(finer - self.model_readings(x))
        growth = (
            loss_roots(self.problem.settings.loss, evaluation.noise + change)[0]
            - evaluation.residuals[: self.n]
        )
        growth[self.censored != 0] = 0.0  # a limit
        finite = np.where(np.isfinite(covariance), covariance, 0.0)[: self._m]
        sd = np.sqrt(np.diag(finite))
        shift = finite @ (evaluation.jacobian[: self.n].T @ growth)
        return np.divide(-shift, sd, out=np.zeros(self._m), where=sd > 0.0)

    def noise_growth(
        self, evaluation: Evaluation, leverage: FloatArray | None = None
    ) -> FloatArray:
        """Return the scatter of each series over its noise, (series,).

        By the leverage (n,), the share of each reading that what is fitted takes away.
        """
        by_loss = weights(self.problem.settings.loss, evaluation.noise)
        weighted = by_loss * evaluation.noise**2 * (self.censored == 0)
        if leverage is None:
            leverage = NuisanceProjection(evaluation.jacobian).leverage
        leverage = np.where(self.censored == 0, leverage[: self.n], 1.0)
        parts = [record.rows for record in self.records]
        return np.array(
            [
                np.sqrt(weighted[part].sum() / max(1.0, (1.0 - leverage[part]).sum()))
                for part in parts
            ]
        )

    def log_likelihood(self, evaluation: Evaluation) -> float:
        """Return the logarithm of the likelihood of the readings."""
        values = self.censored == 0
        scatter = float(np.log(self.sd[values]).sum())
        scatter += sum(log_volume(r.series) for r in self.records)
        loss = evaluation.residuals[: self.n]
        constant = log_constant(self.problem.settings.loss)
        return float(-0.5 * loss @ loss - scatter - values.sum() * constant)

    def with_best_nuisances(
        self,
        values: Sequence[float] | FloatArray,
        test_unknowns: FloatArray | None = None,
        times_of: FloatArray | None = None,
    ) -> FloatArray:
        """Return unknowns (u,) at values of the fitted keys, with the best nuisances for them.

        Time constants are the best ones only where tests have their unknowns (tests, m), and
        ``times_of`` (u,) does not hold them; else at their start. Raises HistoryError.
        """
        lower, upper = self.lower[self._m :], self.upper[self._m :]
        unknowns = self.problem.unknowns(values)
        first = self._first_times if times_of is None else times_of[self._m :]
        first = np.where(self._times, first, 0.0)
        x = np.concatenate([unknowns, np.clip(first, lower, upper)])
        if len(x) == self._m:
            return x
        loss, rows = (
            self.problem.settings.loss,
            np.array([True] * self.n + [j >= self._m for j, _ in self.priors]),
        )
        # a start needs no more than one step; where tests have their values, all weights count
        linear = loss == "gaussian" and not self.censored.any()
        reweighted = 1 if linear or test_unknowns is None else _REWEIGHTED
        for _ in range(reweighted):
            evaluation = self.evaluate(x, test_unknowns)
            columns, residuals = evaluation.jacobian[rows, self._m :], evaluation.residuals[rows]
            if reweighted > 1:
                roots = np.sqrt(weights(loss, evaluation.noise))
                columns[: self.n] = roots[:, None] * evaluation.noise_jacobian[:, self._m :]
                residuals[: self.n] = roots * evaluation.noise
            columns[:, self._times] = 0.0
            nuisances = x[self._m :]
            step = bounded_solution(columns, -residuals, lower - nuisances, upper - nuisances)
            x[self._m :] = np.clip(nuisances + step, lower, upper)
            if np.abs(step * np.linalg.norm(columns, axis=0)).max() < _SETTLED:
                break
        if self._growths and test_unknowns is not None and times_of is None:
            x[self._m :] = self._best_growth(x, test_unknowns, rows)
        return x

    def _best_growth(self, x: FloatArray, test_unknowns: FloatArray, rows: BoolArray) -> FloatArray:
        """Return the best nuisances (u - m,), time constants included, from those of x on.

        ``rows`` are of residuals that nuisances change.
        """

        def at(nuisances: FloatArray) -> Evaluation:
            return self.evaluate(np.concatenate([x[: self._m], nuisances]), test_unknowns)

        limits = self.lower[self._m :], self.upper[self._m :]
        outcome = least_squares(
            lambda nuisances: at(nuisances).residuals[rows], x[self._m :],
            lambda nuisances: at(nuisances).jacobian[rows, self._m :], limits, x_scale="jac",
        )  # fmt: skip
        # it stays within the bounds, however close
        return np.choose(outcome.active_mask + 1, [limits[0], outcome.x, limits[1]])

    @property
    def integrated_limits(self) -> BoolArray:
        """(n,) bool, which limits are integrated over what scatters: those without nuisances."""
        alone = ~self.nuisance_columns.any(axis=1)
        return (self.censored != 0) & alone & self.problem.scatters

    @property
    def linear(self) -> BoolArray:
        """(u,) bool, unknowns on which residuals depend linearly, and which have no bounds."""
        free = np.isinf(self.lower) & np.isinf(self.upper)
        free[: self._m] = False
        free[self._m :] &= ~self._grown
        free[self._m :] &= ~self.nuisance_columns[self.censored != 0].any(axis=0)
        return free & (self.problem.settings.loss == "gaussian")

    @property
    def idle(self) -> BoolArray:
        """(u,) bool, which nuisances do nothing to any reading and have no prior."""
        acts = np.append(
            np.ones(self._m, dtype=bool), np.abs(self.nuisance_columns).sum(axis=0) > 0
        )
        acts[[j for j, _ in self.priors]] = True
        acts[self._m :] |= self._times
        return ~acts
