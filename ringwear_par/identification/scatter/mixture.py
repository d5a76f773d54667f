"""Mixtures of normal distributions: what is known of a number after its scatter is integrated."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ringwear_par.arrays import FloatArray

#: standard deviations beyond the outermost mean that hold all of a mixture, and halvings of that
#: range until a quantile is found to round-off
_REACH, _BISECTIONS = 40.0, 80


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture of normal distributions of one number."""

    #: (g,) float, of the parts; they sum to 1
    weights: FloatArray
    #: (g,) float, of the parts
    means: FloatArray
    variances: FloatArray

    @property
    def mean(self) -> float:
        """Mean of the mixture."""
        return float(self.weights @ self.means)

    @property
    def sd(self) -> float:
        """Standard deviation of the mixture."""
        spread = self.variances + (self.means - self.mean) ** 2
        return float(np.sqrt(self.weights @ spread))

    def quantile(self, probability: float) -> float:
        """Return the number below which the mixture has a probability, between 0 and 1."""
        sd = np.sqrt(self.variances)
        low = float(np.min(self.means - _REACH * sd))
        high = float(np.max(self.means + _REACH * sd))
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if self.weights @ ndtr((middle - self.means) / sd) < probability:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def interval(self, level: float) -> tuple[float, float]:
        """Return the central interval that holds the number with a probability ``level``."""
        tail = 0.5 * (1.0 - level)
        return self.quantile(tail), self.quantile(1.0 - tail)
