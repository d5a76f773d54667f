"""Draws of a density by importance sampling, from draws of a nearby one; its integral.

Points come from a density like that of the draws so far, and count by how much larger the wanted
density is there. So do those far out in long tails, where walks of a sampler come rarely.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaln, logsumexp

from ringwear_par.arrays import FloatArray, IntArray

#: highest degree of the polynomials of a ridge
_DEGREE = 4
#: degrees of freedom and scale over the rms of draws, of entries that may be bent and of others
_FREEDOM, _SCALE = (3.0, 6.0), (1.5, 0.9)
#: least distance of a draw from where it is expected, over the rms one; largest leverage
_CLOSE, _LEVERAGE = 1e-3, 0.9
#: points at a time, which fit into a cache; share of points that must count for another density
_POINTS, _COUNT = 4096, 0.2
#: most of these parts; most draws that are kept, and points that are wider spread
_MOST, _KEPT, _SPREAD = 32, 2**15, 2048

#: log prior and log likelihood (s,) at points (s, d); where either is -inf they do not count
Density = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


class Drawn(NamedTuple):
    """Draws of a density, and its integral."""

    #: (s, d), in no order
    draws: FloatArray
    #: (s,) log p
    logs: FloatArray
    #: (p, d) points that are wider spread, by the root of their weights
    spread: FloatArray
    #: how many independent draws they are worth
    effective: float
    #: logarithm of the integral of the density, and its error
    log_integral: float
    error: float


class _Ridge:
    """A density like that of draws (s, d), from which points are easily had.

    Each entry has a t distribution given those before it. Its mean is a polynomial of these, and
    the logarithm of its scale is linear in them: ridges may be bent, and funnels become narrow.

    Parameters
    ----------
    bent : number of first entries, of which polynomials have powers and products; in the others,
        which may be many, they are linear.
    """

    def __init__(self, draws: FloatArray, bent: int) -> None:
        rows, counts = np.unique(draws, axis=0, return_counts=True)
        if len(rows) <= rows.shape[1]:
            raise np.linalg.LinAlgError("too few draws")
        self._bent, self._low, self._high = bent, rows.min(axis=0), rows.max(axis=0)
        others = (np.arange(rows.shape[1]) >= bent).astype(int)
        self._freedom = np.array(_FREEDOM)[others]
        #: coefficients of the mean of each entry, and of the logarithm of its scale
        self._entries: list[tuple[FloatArray, FloatArray]] = []
        roots = np.sqrt(counts)
        for x, (terms, lines), other in zip(rows.T, self._terms(rows), others, strict=True):
            q, r = np.linalg.qr(terms * roots[:, None])
            along = q.T @ (x * roots)
            # from where the others expect each draw
            left_out = 1.0 - np.minimum(np.square(q).sum(axis=1), _LEVERAGE)
            rest = (x - q @ along / roots) / left_out
            logs = np.log(np.maximum(np.abs(rest), _CLOSE * rest.std()))
            scale = np.linalg.lstsq(lines * roots[:, None], logs * roots, rcond=None)[0]
            squares = np.square(rest / np.exp(lines @ scale))
            scale[0] += np.log(_SCALE[other] * np.sqrt(np.average(squares, weights=counts)))
            self._entries.append((np.linalg.lstsq(r, along, rcond=1e-10)[0], scale))

    def _terms(self, points: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield terms (s, p) of the mean of each entry, and of its scale, by those before it.

        A column of points is not looked at before its own terms have been used. Polynomials are
        constant beyond the range of draws.
        """
        terms, degrees = np.ones((len(points), 1)), np.zeros(1, dtype=int)
        for j, (low, high) in enumerate(zip(self._low, self._high, strict=True)):
            yield terms, terms[:, degrees <= 1]
            t = np.clip((2.0 * points[:, [j]] - low - high) / (high - low), -1.0, 1.0)
            own = 1 if j < self._bent else _DEGREE  # an entry alone has the highest degree
            before, degrees_before = terms, degrees
            for power in range(1, 1 + _DEGREE // own):
                some = degrees_before + own * power <= _DEGREE
                terms = np.hstack([terms, before[:, some] * t**power])
                degrees = np.append(degrees, degrees_before[some] + own * power)

    def points(self, count: int, random: np.random.Generator) -> FloatArray:
        """Return points (count, d) of the density."""
        points = random.standard_t(self._freedom, (count, len(self._entries)))
        for x, (mean, scale), (terms, lines) in self._by_entry(points):
            x[:] = terms @ mean + np.exp(lines @ scale) * x
        return points

    def __call__(self, points: FloatArray) -> FloatArray:
        """Return the logarithm (s,) of the density at points (s, d)."""
        nu, half = self._freedom, 0.5 * (self._freedom + 1.0)
        constants = gammaln(half) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi)
        logs = np.full(len(points), constants.sum())
        for j, (x, (mean, scale), (terms, lines)) in enumerate(self._by_entry(points)):
            log_scale = lines @ scale
            z = (x - terms @ mean) / np.exp(log_scale)
            logs -= log_scale + half[j] * np.log1p(z**2 / nu[j])
        return logs

    def _by_entry(self, points: FloatArray) -> Iterator[Any]:
        """Yield the column of each entry, its coefficients and its terms."""
        return zip(points.T, self._entries, self._terms(points), strict=True)


def draw(
    density: Density,
    draws: FloatArray,
    old: FloatArray,
    power: float,
    bent: int,
    random: np.random.Generator,
    want: float,
) -> Drawn:
    """Return draws of a density, its likelihood to a power.

    They come from draws of another density in steps, after each of which a part still counts;
    LinAlgError where hardly any does. At the end points are twice as many, until enough count.

    Parameters
    ----------
    draws, old : (s, d) of the other density, and its logarithm (s,) there.
    power : of the likelihood.
    bent : see ``_Ridge``.
    want : effective number.
    """
    cast, reached, parts = [draws, *density(draws), old], 0.0, 1
    while True:
        reached, weights = _raised(cast, reached, power)
        effective = _effective(weights)
        if parts > 1 and (effective >= want or parts >= _MOST):
            break
        ridge = _Ridge(cast[0][_chosen(weights, len(weights), random)], bent)
        parts = 2 * parts if reached == power else 1
        cast = _cast(density, ridge, parts, random)
    draws, prior, likelihood, old = cast
    logs = prior + power * likelihood
    integral = float(logsumexp(logs - old) - np.log(len(logs)))
    error = float(weights.std() / weights.mean() / np.sqrt(len(weights)))
    rows = random.permutation(_chosen(weights, min(len(draws), _KEPT), random))
    spread = random.permutation(draws[_chosen(np.sqrt(weights), _SPREAD, random)])
    return Drawn(draws[rows], logs[rows], spread, effective, integral, error)


def _cast(
    density: Density, ridge: _Ridge, parts: int, random: np.random.Generator
) -> list[FloatArray]:
    """Return points (s, d), log prior and log likelihood there, and the log of their density."""
    every = []
    for _ in range(parts):
        points = ridge.points(_POINTS, random)
        every.append((points, *density(points), ridge(points)))
    return [np.concatenate(part) for part in zip(*every, strict=True)]


def _raised(cast: list[FloatArray], power: float, most: float) -> tuple[float, FloatArray]:
    """Return a larger power of the likelihood for which enough points count, and weights (s,).

    Parameters
    ----------
    cast : see ``_cast``.
    most : largest power.
    """
    _, prior, likelihood, old = cast
    if not (np.isfinite(prior) & np.isfinite(likelihood)).any():
        raise np.linalg.LinAlgError("no point counts")
    counting, trials = -1.0, most * 0.8 ** np.arange(100)
    for trial in trials[(trials > power) | (trials == most)]:
        logs = prior + trial * likelihood - old
        w = np.exp(logs - logs.max())
        if (count := _effective(w)) > counting:
            counting, reached, weights = count, float(trial), w
        if count > _COUNT * len(w):
            break
    return reached, weights


def _effective(weights: FloatArray) -> float:
    """Return how many points of equal weights tell a mean as exactly as those of weights (s,)."""
    return float(weights.sum() ** 2 / (weights @ weights))


def _chosen(weights: FloatArray, count: int, random: np.random.Generator) -> IntArray:
    """Return rows (count,), each as often as its weight says, to one."""
    places = np.cumsum(weights / weights.sum())
    rows = np.searchsorted(places, (random.random() + np.arange(count)) / count)
    return np.minimum(rows, len(weights) - 1)
