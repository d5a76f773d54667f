"""Tests of a fit linearised at their own values of the keys."""

from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.noise import log_volume, weights
from ringwear_par.identification.scatter.reduction import LinearisedTest, ReducedTest, reduce_test


class Linearisation:
    """The tests of a misfit, linearised where they were evaluated.

    Nuisances that are at their bounds stay there.

    Parameters
    ----------
    misfit : the least squares problem.
    evaluation : of it.
    x : (u,) unknowns at which it was evaluated.
    test_unknowns : (tests, m) unknowns of the keys in each test.

    Attributes
    ----------
    rows : of each test among the readings.
    """

    def __init__(
        self, misfit: Misfit, evaluation: Evaluation, x: FloatArray, test_unknowns: FloatArray
    ) -> None:
        self.misfit, self._evaluation, self._x = misfit, evaluation, x
        self._test_unknowns, self._m = test_unknowns, len(misfit.problem.parameters)
        self._at_bounds: BoolArray = (x <= misfit.lower) | (x >= misfit.upper)
        ends = np.cumsum([experiment.n for experiment in misfit.problem.experiments])
        self.rows = [
            slice(int(end) - experiment.n, int(end))
            for end, experiment in zip(ends, misfit.problem.experiments, strict=True)
        ]
        #: of each test
        self.tests = [self._linearised(number) for number in range(len(self.rows))]

    def reduced(self) -> list[ReducedTest]:
        """Return the normal equations of all tests."""
        return [reduce_test(test)[0] for test in self.tests]

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

    def _linearised(self, number: int) -> LinearisedTest:
        misfit, rows, nuisances = self.misfit, self.rows[number], self.nuisances_of(number)
        noise = self._evaluation.noise[rows]
        roots = np.sqrt(weights(misfit.problem.settings.loss, noise))[:, None]
        jacobian = roots * self._evaluation.noise_jacobian[rows]
        keys, columns = jacobian[:, : self._m], jacobian[:, nuisances]
        readings = keys @ self._test_unknowns[number] + columns @ self._x[nuisances]
        records = [r for r in misfit.records if r.experiment is misfit.problem.experiments[number]]
        volume = 2.0 * float(np.log(misfit.sd[rows]).sum())
        volume += 2.0 * sum(log_volume(record.series) for record in records)
        return LinearisedTest(
            readings - roots[:, 0] * noise, keys, columns, *self.priors_of(nuisances), volume
        )
