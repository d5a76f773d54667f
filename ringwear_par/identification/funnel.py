"""Coordinates in which specimens' values and the size of their scatter are easy to draw.

Where the scatter tau is small, specimens' values are near each other, where it is large, each is
near its own estimate: a funnel, which samplers hardly enter. Contrasts y of the specimens have a
mean e and an sd o by their readings alone, 0 and tau by the scatter alone, and

    y = B e + s w,   B = tau^2 / (tau^2 + o^2),   s = tau o / sqrt(tau^2 + o^2)

by both: w is about standard normal whatever tau is (Papaspiliopoulos, Roberts and Skold 2007). This
is a change of variables: what is drawn does not depend on e and o.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import helmert

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.posterior import Layout, Scattering

#: share of the draws, those of the largest scatter, that tell specimens' own values
_LARGE = 0.25


@dataclass(frozen=True, eq=False)
class _Contrasts:
    """Contrasts of the groups of a key: their means and sd by readings alone, (groups - 1,)."""

    scattering: Scattering
    mean: FloatArray
    sd: FloatArray

    def moments(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return B e and s (s, groups - 1) at the sizes of theta (s, d)."""
        squares = self.scattering.spread(theta)[:, None] ** 2
        total = squares + self.sd**2
        return squares / total * self.mean, np.sqrt(squares / total) * self.sd


class Funnel:
    """The change of variables for theta (s, d) of a layout, by draws of it."""

    def __init__(self, layout: Layout, draws: FloatArray) -> None:
        self._parts = []
        for scattering in layout.scatterings:
            tau = scattering.spread(draws)
            large = draws[tau >= np.quantile(tau, 1.0 - _LARGE)]
            y = large[:, scattering.places] @ _matrix(scattering).T
            sd = np.maximum(y[:, 1:].std(axis=0), 1e-6)
            self._parts.append(_Contrasts(scattering, y[:, 1:].mean(axis=0), sd))

    def flat(self, theta: FloatArray) -> FloatArray:
        """Return theta (s, d) with w in place of contrasts."""
        out = theta.copy()
        for part in self._parts:
            places = part.scattering.places
            y = theta[:, places] @ _matrix(part.scattering).T
            mean, sd = part.moments(theta)
            out[:, places] = np.column_stack([y[:, :1], (y[:, 1:] - mean) / sd])
        return out

    def theta(self, flat: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return theta (s, d) of what ``flat`` returns, and the log of the volume's change (s,)."""
        out, volume = flat.copy(), np.zeros(len(flat))
        for part in self._parts:
            places = part.scattering.places
            mean, sd = part.moments(flat)
            y = np.column_stack([flat[:, places][:, :1], mean + sd * flat[:, places][:, 1:]])
            out[:, places] = y @ _matrix(part.scattering)
            volume += np.log(sd).sum(axis=1)
        return out, volume


def _matrix(scattering: Scattering) -> FloatArray:
    """Return the orthogonal matrix of the mean of groups (times a constant) and their contrasts."""
    matrix: FloatArray = helmert(scattering.places.stop - scattering.places.start, full=True)
    return matrix
