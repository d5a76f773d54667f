"""How probable readings are at values of the fitted keys, with the nuisances that suit them best.

As nuisances are linear, that is the same as integrating over them where noise is Gaussian and they
have no bounds.
"""

import numpy as np
from scipy.optimize import lsq_linear

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.estimation.least_squares import NU, LeastSquares

#: rounds of reweighting where the loss is not Gaussian
_REWEIGHTED = 20
#: change of residuals over their noise at which they are done
_SAME = 1e-4


class Marginal:
    """The logarithm of the probability of readings, but for a constant.

    Parameters
    ----------
    squares : the least squares problem, with its noise.
    """

    def __init__(self, squares: LeastSquares) -> None:
        self._squares = squares
        problem, m = squares.problem, len(squares.problem.parameters)
        self._student = problem.settings.loss == "student"
        self._low, self._high = squares.lower[m:], squares.upper[m:]
        self._free = not np.isfinite([self._low, self._high]).any()
        count = len(self._low)
        own = [(j - m, prior) for j, prior in squares.priors if j >= m]
        self._prior_rows, self._prior_values = np.zeros((len(own), count)), np.zeros(len(own))
        for row, (j, prior) in enumerate(own):
            self._prior_rows[row, j] = 1.0 / prior.sd
            self._prior_values[row] = prior.mean / prior.sd
        self._priors = [(j, prior) for j, prior in squares.priors if j < m]
        self._columns = squares.whitened(squares.nuisance_columns)
        # without weights that change it is the same for all samples
        ones = np.ones(squares.n)
        self._inverse = None if self._student or not self._free else self._inverted(ones)

    def __call__(self, values: FloatArray, readings: FloatArray) -> float:
        """Return it for values (m,) of the keys and the model's readings (n,)."""
        bare = self._squares.whitened(readings - self._squares.data)
        weights = np.ones(len(bare))
        noise, rest = bare, -self._prior_values
        for _ in range(_REWEIGHTED if self._student else 1):
            if not len(self._low):
                break
            nuisances, before = self._nuisances(bare, np.sqrt(weights)), noise
            noise = bare + self._columns @ nuisances
            rest = self._prior_rows @ nuisances - self._prior_values
            if np.abs(noise - before).max() < _SAME:
                break
            weights = (NU + 1.0) / (NU + noise * noise)
        square = noise @ noise
        if self._student:
            square = (NU + 1.0) * np.log1p(noise * noise / NU).sum()
        square += rest @ rest
        square += sum(((values[j] - prior.mean) / prior.sd) ** 2 for j, prior in self._priors)
        # priors are densities of values, those sought here of unknowns
        slopes = self._squares.slopes(values)
        return float(sum(np.log(slopes[j]) for j, _ in self._priors) - 0.5 * square)

    def _nuisances(self, bare: FloatArray, roots: FloatArray) -> FloatArray:
        right = np.concatenate([-roots * bare, self._prior_values])
        if self._free:
            inverse = self._inverted(roots) if self._inverse is None else self._inverse
            return inverse @ right
        columns, size = self._scaled(roots)
        limits = (self._low * size, self._high * size)
        nuisances: FloatArray = lsq_linear(columns, right, limits).x / size
        return nuisances

    def _inverted(self, roots: FloatArray) -> FloatArray:
        """Return what gives the best nuisances, none of those that do nothing."""
        columns, size = self._scaled(roots)
        inverse: FloatArray = np.linalg.pinv(columns, rcond=1e-12) / size[:, None]
        return inverse

    def _scaled(self, roots: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the columns of nuisances and priors with norm 1, and their norms."""
        columns = np.concatenate([roots[:, None] * self._columns, self._prior_rows])
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        return columns / size, size
