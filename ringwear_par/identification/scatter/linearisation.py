"""Tests of a fit linearised at their own values of the keys."""

from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.noise import log_volume, weights
from ringwear_par.identification.scatter.clocks import TestClocks
from ringwear_par.identification.scatter.reduction import LinearisedTest, ReducedTest, reduce_test

#: of a reading without weight, instead of 0
_NO_WEIGHT = 1e-12


class Linearisation:
    """The tests of a misfit, linearised at x (u,) and (tests, m) unknowns of the keys in each test.

    Nuisances that are at their bounds stay there. The loss weighs readings by the residuals of the
    evaluation or by others, ``weighed`` (n,). ``rows`` are of each test among the readings,
    ``clocks`` of each test where wear is random.
    """

    def __init__(
        self,
        misfit: Misfit,
        evaluation: Evaluation,
        x: FloatArray,
        test_unknowns: FloatArray,
        weighed: FloatArray | None = None,
    ) -> None:
        self.misfit, self._evaluation, self._x = misfit, evaluation, x
        self._test_unknowns, self._m = test_unknowns, len(misfit.problem.parameters)
        self._at_bounds: BoolArray = (x <= misfit.lower) | (x >= misfit.upper)
        ends = np.cumsum([experiment.n for experiment in misfit.problem.experiments])
        self.rows = [
            slice(int(end) - experiment.n, int(end))
            for end, experiment in zip(ends, misfit.problem.experiments, strict=True)
        ]
        residuals = evaluation.noise if weighed is None else weighed
        self._roots = np.sqrt(weights(misfit.problem.settings.loss, residuals))
        self.clocks: list[TestClocks] = []
        if misfit.problem.settings.process:
            answers, depths = misfit.clocks(x, test_unknowns)
            self.clocks = [
                TestClocks(
                    experiment.series, misfit.sd[rows],
                    self._roots[rows] * evaluation.roots[rows] + _NO_WEIGHT, answers[rows],
                    depths[rows],
                )
                for experiment, rows in zip(misfit.problem.experiments, self.rows, strict=True)
            ]  # fmt: skip
        #: of each test
        self.tests = [self._linearised(number) for number in range(len(self.rows))]
        self._reduced: dict[bytes, list[list[ReducedTest]]] = {}

    def reduced(self, sizes: FloatArray | None = None) -> list[list[ReducedTest]]:
        """Return the normal equations of all tests at sizes (G, bodies) mm of the process noise."""
        key = b"" if sizes is None else sizes.tobytes()
        if key not in self._reduced:
            by_test = [reduce_test(test, sizes) for test in self.tests]
            self._reduced[key] = [list(tests) for tests in zip(*by_test, strict=True)]
        return self._reduced[key]

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
        roots = self._roots[rows, None]
        noise = roots[:, 0] * self._evaluation.noise[rows]
        jacobian = roots * self._evaluation.noise_jacobian[rows]
        records = [r for r in misfit.records if r.experiment is misfit.problem.experiments[number]]
        values = misfit.censored[rows] == 0  # limits have no density
        volume = 2.0 * float(np.log(misfit.sd[rows][values]).sum())
        volume += 2.0 * sum(log_volume(record.series) for record in records)
        kernels: tuple[FloatArray, ...] = ()
        if self.clocks:
            clocks, square = self.clocks[number], float(noise @ noise)
            noise, jacobian = clocks.combine(noise), clocks.combine(jacobian)
            volume += square - float(noise @ noise)  # of readings about the means of blocks
            kernels = clocks.kernels
        keys, columns = jacobian[:, : self._m], jacobian[:, nuisances]
        readings = keys @ self._test_unknowns[number] + columns @ self._x[nuisances]
        return LinearisedTest(
            readings - noise, keys, columns, *self.priors_of(nuisances), volume, kernels
        )
