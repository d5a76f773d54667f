"""Tests of a fit linearised at their own values of the keys."""

from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.noise import log_volume, weights
from ringwear_par.identification.scatter.reduction import LinearisedTest, ReducedTest, reduce_test


class Linearisation:
    """The tests of a misfit, linearised at unknowns of their own.

    Keys and nuisances that are at their bounds stay there.

    Parameters
    ----------
    misfit : the least squares problem.
    x : (u,) unknowns of its optimum.

    Attributes
    ----------
    free : numbers of the keys that do not stay.
    rows : of each test among the readings.
    """

    def __init__(self, misfit: Misfit, x: FloatArray) -> None:
        self.misfit, at_bounds = misfit, _at_bounds(misfit, x)
        self.m = len(misfit.problem.parameters)
        self.free = tuple(np.flatnonzero(~at_bounds[: self.m]).tolist())
        self._at_bounds = at_bounds
        ends = np.cumsum([experiment.n for experiment in misfit.problem.experiments])
        self.rows = [
            slice(int(end) - experiment.n, int(end))
            for end, experiment in zip(ends, misfit.problem.experiments, strict=True)
        ]

    def reduced(
        self, evaluation: Evaluation, x: FloatArray, test_unknowns: FloatArray
    ) -> list[ReducedTest]:
        """Return the normal equations of all tests, linearised where they were evaluated."""
        return [
            reduce_test(self.test(i, evaluation, x, test_unknowns))[0]
            for i in range(len(self.rows))
        ]

    def nuisances_of(self, test: int) -> list[int]:
        """Return the numbers of a test's unknown nuisances that no bound holds."""
        name = self.misfit.problem.experiments[test].name
        return [
            j
            for j, of in enumerate(self.misfit.names)
            if not isinstance(of, str) and of[0] == name and not self._at_bounds[j]
        ]

    def priors_of(self, nuisances: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the rows and values of the priors of nuisances, in units of their sd."""
        priors = [(nuisances.index(j), p) for j, p in self.misfit.priors if j in nuisances]
        rows, values = np.zeros((len(priors), len(nuisances))), np.zeros(len(priors))
        for row, (place, prior) in enumerate(priors):
            rows[row, place], values[row] = 1.0 / prior.sd, prior.mean / prior.sd
        return rows, values

    def test(
        self, number: int, evaluation: Evaluation, x: FloatArray, test_unknowns: FloatArray
    ) -> LinearisedTest:
        """Return a test, linearised where it was evaluated."""
        misfit, rows, nuisances = self.misfit, self.rows[number], self.nuisances_of(number)
        loss = misfit.problem.settings.loss
        roots = np.sqrt(weights(loss, evaluation.noise[rows]))[:, None]
        jacobian = roots * evaluation.noise_jacobian[rows]
        keys, columns = jacobian[:, list(self.free)], jacobian[:, nuisances]
        readings = -roots[:, 0] * evaluation.noise[rows]
        readings = readings + keys @ test_unknowns[number, list(self.free)] + columns @ x[nuisances]
        records = [r for r in misfit.records if r.experiment is misfit.problem.experiments[number]]
        volume = 2.0 * float(np.log(misfit.sd[rows]).sum())
        volume += 2.0 * sum(log_volume(record.series) for record in records)
        return LinearisedTest(readings, keys, columns, *self.priors_of(nuisances), volume)


def _at_bounds(misfit: Misfit, x: FloatArray) -> BoolArray:
    """Return which unknowns (u,) stay at their bounds; no key that scatters does."""
    at_bounds = (x <= misfit.lower) | (x >= misfit.upper)
    for j, parameter in enumerate(misfit.problem.parameters):
        span = misfit.upper[j] - misfit.lower[j]
        near = min(x[j] - misfit.lower[j], misfit.upper[j] - x[j]) <= 1e-9 * span
        at_bounds[j] = near and parameter.scatter is None
    return at_bounds
