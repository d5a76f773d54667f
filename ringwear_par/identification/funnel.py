"""Coordinates in which keys, specimens' values and the sizes of their scatter are easy to draw.

Where keys are correlated the draws are bent, as those of k and p0 of one load: what the others are
by the longest one, a polynomial, is taken out of them. And where the scatter is small, specimens'
values are near each other, where it is large, each is near its own estimate: a funnel, which
samplers hardly enter. Contrasts y of the specimens, of all keys that scatter, have a precision P
and a mean by their readings alone, 0 and the covariance T of the scatter by that alone, and

    y = M b + S w,   M = S S' = (T^-1 + P)^-1

by both: w is about standard normal whatever T is (Papaspiliopoulos, Roberts and Skold 2007). Both
are changes of variables: what is drawn does not depend on the polynomial, b and P.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from scipy.linalg import helmert

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.posterior import Layout, Scattering
from ringwear_par.identification.sampling import standardised

#: share of the draws, those of the largest scatter, that tell specimens' own values
_LARGE = 0.25
#: degree of the polynomial, and parts of its range that count alike
_DEGREE, _PARTS = 5, 24


@dataclass(frozen=True, eq=False)
class _Contrasts:
    """Contrasts (c,) of the groups of some keys (k,), which are the same groups for each."""

    keys: tuple[Scattering, ...]
    #: (c, k) and (c, k, k), b and P
    shift: FloatArray
    precision: FloatArray

    def moments(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return M b (s, c, k) and S (s, c, k, k) at the sizes of theta (s, d)."""
        inverse = np.stack([key.spread(theta) ** -2 for key in self.keys], axis=-1)
        total = self.precision + (inverse[..., None] * np.eye(len(self.keys)))[:, None]
        if len(self.keys) == 1:
            covariance = 1.0 / total
            return (covariance * self.shift[..., None])[..., 0], np.sqrt(covariance)
        covariance = np.linalg.inv(total)
        mean = np.einsum("sckl,cl->sck", covariance, self.shift)
        return mean, np.linalg.cholesky(covariance)


class Funnel:
    """The change of variables for theta (s, d) of a layout, by draws of it."""

    def __init__(self, layout: Layout, draws: FloatArray) -> None:
        groups: dict[bytes, list[Scattering]] = defaultdict(list)
        for scattering in layout.scatterings:
            groups[scattering.group.tobytes()].append(scattering)
        self._parts = [_contrasts(tuple(keys), draws) for keys in groups.values()]
        flat = self._upright(draws)
        scaled, longest = standardised(flat)
        self._pivot = int(np.argmax(np.abs(longest)))
        along, pivot = scaled[:, self._pivot], flat[:, self._pivot]
        self._mean, self._sd = pivot.mean(), max(pivot.std(), 1e-300)
        self._ends = along.min(), along.max()
        # as many draws count where they are rare, in the tails, as elsewhere
        part = np.digitize(along, np.linspace(*self._ends, _PARTS))
        rare = np.bincount(part)[part][:, None] ** -0.5
        self._bend = np.linalg.lstsq(rare * self._powers(flat), rare * flat, rcond=None)[0]
        self._bend[:, self._pivot] = 0.0

    def _powers(self, flat: FloatArray) -> FloatArray:
        """Return powers (s, 6) of the longest coordinate, within its range among the draws."""
        scaled = (flat[:, self._pivot] - self._mean) / self._sd
        return np.vander(np.clip(scaled, *self._ends), _DEGREE + 1)

    def flat(self, theta: FloatArray) -> FloatArray:
        """Return the coordinates (s, d) of theta (s, d)."""
        upright = self._upright(theta)
        return upright - self._powers(upright) @ self._bend

    def _upright(self, theta: FloatArray) -> FloatArray:
        """Return theta (s, d) with w in place of contrasts."""
        out = theta.copy()
        for part in self._parts:
            means, y = _split(part.keys, theta)
            mean, root = part.moments(theta)
            w = np.linalg.solve(root, (y - mean)[..., None])[..., 0]
            _join(part.keys, means, w, out, np.eye(w.shape[1] + 1))
        return out

    def theta(self, flat: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return theta (s, d) of what ``flat`` returns, and the log of the volume's change (s,)."""
        flat = flat + self._powers(flat) @ self._bend
        out, volume = flat.copy(), np.zeros(len(flat))
        for part in self._parts:
            mean, root = part.moments(flat)
            values = np.stack([flat[:, key.places] for key in part.keys], axis=-1)
            y = mean + np.einsum("sckl,scl->sck", root, values[:, 1:])
            _join(part.keys, values[:, 0], y, out, _matrix(y.shape[1] + 1))
            volume += np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=(1, 2))
        return out, volume


def _contrasts(keys: tuple[Scattering, ...], draws: FloatArray) -> _Contrasts:
    """Return what the draws of the largest scatters say of contrasts by readings alone."""
    sizes = np.stack([key.spread(draws) for key in keys], axis=-1)
    product = np.log(sizes).sum(axis=1)
    large = product >= np.quantile(product, 1.0 - _LARGE)
    _, y = _split(keys, draws[large])
    by_scatter = np.diag(np.mean(sizes[large] ** -2, axis=0))
    shifts, precisions = [], []
    for contrast in np.moveaxis(y, 1, 0):
        inverse = np.linalg.pinv(np.cov(contrast.T).reshape(len(keys), -1), hermitian=True)
        values, axes = np.linalg.eigh(inverse - by_scatter)
        shifts.append(inverse @ contrast.mean(axis=0))
        precisions.append((axes * np.maximum(values, 0.0)) @ axes.T)
    shape = -1, len(keys)
    return _Contrasts(
        keys, np.array(shifts).reshape(shape), np.array(precisions).reshape(*shape, len(keys))
    )


def _split(keys: tuple[Scattering, ...], theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means times a constant (s, k) and contrasts (s, c, k) of the groups' values."""
    values = np.stack([theta[:, key.places] for key in keys], axis=-1)
    turned = np.einsum("cg,sgk->sck", _matrix(values.shape[1]), values)
    return turned[:, 0], turned[:, 1:]


def _join(
    keys: tuple[Scattering, ...],
    means: FloatArray,
    y: FloatArray,
    out: FloatArray,
    matrix: FloatArray,
) -> None:
    """Put means (s, k) and contrasts (s, c, k), turned back by a matrix, in their places."""
    values = np.einsum("cg,sck->sgk", matrix, np.concatenate([means[:, None], y], axis=1))
    for place, key in enumerate(keys):
        out[:, key.places] = values[..., place]


def _matrix(groups: int) -> FloatArray:
    """Return the orthogonal matrix of the mean of groups (times a constant) and their contrasts."""
    matrix: FloatArray = helmert(groups, full=True)
    return matrix
