"""The likelihood of all readings at values of the fitted keys, at the best nuisances.

As nuisances are linear, that is the same as integrating over them where noise is Gaussian and they
have no bounds. Thermal growth is linearised.
"""

import numpy as np
from scipy.optimize import lsq_linear

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.model.noise import student_loss, student_weights

#: rounds of reweighting where the loss is not Gaussian
_REWEIGHTED = 20
#: change of residuals over their noise at which they are done
_SAME = 1e-4


class MarginalLikelihood:
    """The logarithm of the probability of readings, but for a constant.

    Thermal growth is linearised at unknowns x (u,).
    """

    def __init__(self, misfit: Misfit, x: FloatArray) -> None:
        self._misfit = misfit
        problem, m = misfit.problem, len(misfit.problem.parameters)
        self._student = problem.settings.loss == "student"
        self._low, self._high = misfit.lower[m:], misfit.upper[m:]
        self._free = not np.isfinite([self._low, self._high]).any()
        count = len(self._low)
        nuisance_priors = [(j - m, prior) for j, prior in misfit.priors if j >= m]
        self._prior_rows, self._prior_values = (
            np.zeros((len(nuisance_priors), count)),
            np.zeros(len(nuisance_priors)),
        )
        for row, (j, prior) in enumerate(nuisance_priors):
            self._prior_rows[row, j] = 1.0 / prior.sd
            self._prior_values[row] = prior.mean / prior.sd
        self._priors = [(j, prior) for j, prior in misfit.priors if j < m]
        columns = misfit.nuisance_derivatives(x)
        self._data = misfit.data - (misfit.nuisance_readings(x) - columns @ x[m:])
        self._columns = misfit.whitened(columns)
        # without weights that change it is the same for all samples
        ones = np.ones(misfit.n)
        self._inverse = None if self._student or not self._free else self._inverse_of(ones)

    def __call__(self, values: FloatArray, readings: FloatArray) -> float:
        """Return it for values (m,) of the keys and the model's readings (n,)."""
        unadjusted = self._misfit.whitened(readings - self._data)
        weights = np.ones(len(unadjusted))
        noise, rest = unadjusted, -self._prior_values
        for _ in range(_REWEIGHTED if self._student else 1):
            if not len(self._low):
                break
            nuisances, before = self._nuisances(unadjusted, np.sqrt(weights)), noise
            noise = unadjusted + self._columns @ nuisances
            rest = self._prior_rows @ nuisances - self._prior_values
            if np.abs(noise - before).max() < _SAME:
                break
            weights = student_weights(noise)
        square = noise @ noise
        if self._student:
            square = student_loss(noise).sum()
        square += rest @ rest
        square += sum(((values[j] - prior.mean) / prior.sd) ** 2 for j, prior in self._priors)
        # priors are densities of values, those sought here of unknowns
        slopes = self._misfit.problem.slopes(values)
        return float(sum(np.log(slopes[j]) for j, _ in self._priors) - 0.5 * square)

    def _nuisances(self, unadjusted: FloatArray, roots: FloatArray) -> FloatArray:
        right = np.concatenate([-roots * unadjusted, self._prior_values])
        if self._free:
            inverse = self._inverse_of(roots) if self._inverse is None else self._inverse
            return inverse @ right
        columns, size = self._scaled(roots)
        limits = (self._low * size, self._high * size)
        nuisances: FloatArray = lsq_linear(columns, right, limits).x / size
        return nuisances

    def _inverse_of(self, roots: FloatArray) -> FloatArray:
        """Return the matrix (nuisances, rows) of the best nuisances; idle ones stay 0."""
        columns, size = self._scaled(roots)
        inverse: FloatArray = np.linalg.pinv(columns, rcond=1e-12) / size[:, None]
        return inverse

    def _scaled(self, roots: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the columns of nuisances and priors with norm 1, and their norms."""
        columns = np.concatenate([roots[:, None] * self._columns, self._prior_rows])
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        return columns / size, size
