"""Draws of a density by importance sampling, from draws of a nearby one; its integral.

Points come from a density like that of the draws so far, and count by how much larger the wanted
density is there. So do those far out in long tails, where walks of a sampler come rarely.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaln, logsumexp
from scipy.stats import norm

from ringwear_par.arrays import FloatArray, IntArray

#: densities of which points come, as many of each: degree of their polynomials, which may be wrong
#: where it is high and there are hardly any draws; and whether these are of the draws' ranks, by
#: which a ridge along two axes is smooth
_KINDS = ((2, False), (4, False), (4, True))
#: ranks of draws, from the least to the largest
_RANKS = np.linspace(-1.0, 1.0, 65)
#: degrees of freedom and scale over the rms of draws, of entries that may be bent and of others
_FREEDOM, _SCALE = (3.0, 6.0), (1.5, 0.9)
#: how far polynomials go on beyond the range of draws, over half of it
_BEYOND = 1.25
#: least distance of a draw from where it is expected, over the rms one; largest leverage
_CLOSE, _LEVERAGE = 1e-3, 0.9
#: points at a time, of all kinds; share of them that must count for another density, and how many
#: for each entry
_POINTS, _COUNT, _FEW = 4098, 0.2, 15
#: times that draws of a density tell where its points are to be, and points for each draw wanted
_TIMES, _EACH = 2, 4
#: most points, and most draws that are kept
_MOST, _KEPT = 2**17, 20_000
#: probability beyond each end of an interval; error of an end, in sd, of one draw of a normal one
_TAIL = 0.025
_NEAR, _FAR = norm.ppf([0.5 * _TAIL, 1.5 * _TAIL])
_NORMAL_END = float(np.sqrt((1.0 - _TAIL) / _TAIL) * (_FAR - _NEAR))

#: log prior and log likelihood (s,) at points (s, d); where either is -inf they do not count
Density = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


class Drawn(NamedTuple):
    """Draws of a density, and its integral."""

    #: (s, d), in no order
    draws: FloatArray
    #: (s,) log p
    logs: FloatArray
    #: how many independent draws the ends of their intervals are worth
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
    degree, ranked : of polynomials, and whether they are of ranks of draws.
    """

    def __init__(self, draws: FloatArray, bent: int, degree: int, ranked: bool) -> None:
        rows, counts = np.unique(draws, axis=0, return_counts=True)
        if len(rows) <= rows.shape[1]:
            raise np.linalg.LinAlgError("too few draws")
        self._low, self._high = rows.min(axis=0), rows.max(axis=0)
        self._ranks = np.quantile(rows, 0.5 + 0.5 * _RANKS, axis=0).T if ranked else None
        self._bent, self._degree = bent, degree
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
            rms = np.sqrt(np.average(rest**2, weights=counts))
            logs = np.log(np.abs(rest) + _CLOSE * rms)
            scale = np.linalg.lstsq(lines * roots[:, None], logs * roots, rcond=None)[0]
            squares = np.square(rest / np.exp(lines @ scale))
            scale[0] += np.log(_SCALE[other] * np.sqrt(np.average(squares, weights=counts)))
            self._entries.append((np.linalg.lstsq(r, along, rcond=1e-10)[0], scale))

    def _terms(self, points: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield terms (s, p) of the mean of each entry, and of its scale, by those before it.

        A column of points is not looked at before its own terms have been used.
        """
        most, terms, degrees = self._degree, np.ones((len(points), 1)), np.zeros(1, dtype=int)
        for j, (low, high) in enumerate(zip(self._low, self._high, strict=True)):
            yield terms, terms[:, degrees <= 1]
            if self._ranks is None:
                t = np.clip((2.0 * points[:, [j]] - low - high) / (high - low), -_BEYOND, _BEYOND)
            else:
                t = np.interp(points[:, [j]], self._ranks[j], _RANKS)
            own = 1 if j < self._bent else most  # an entry alone has the highest degree
            before, degrees_before = terms, degrees
            for power in range(1, 1 + most // own):
                some = degrees_before + own * power <= most
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


class Nearby:
    """Densities like that of draws (s, d), of several kinds, as many points of each.

    Parameters
    ----------
    bent : see ``_Ridge``.
    """

    def __init__(self, draws: FloatArray, bent: int) -> None:
        self._each = [_Ridge(draws, bent, *kind) for kind in _KINDS]

    def points(self, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return some points (s, d), and the logarithm of the density there."""
        count = _POINTS // len(_KINDS)
        points = np.concatenate([one.points(count, random) for one in self._each])
        logs = logsumexp([one(points) for one in self._each], axis=0)
        return points, logs - np.log(len(_KINDS))


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
    LinAlgError where hardly any does.

    Parameters
    ----------
    draws, old : (s, d) of the other density, and its logarithm (s,) there.
    power : of the likelihood.
    bent : see ``_Ridge``.
    want : effective number.
    """
    cast, reached, times = [draws, *density(draws), old], 0.0, 0
    least = many_for(draws.shape[1])
    nearby: Nearby | None = None
    enough = max(least, round(_EACH * want / _POINTS))
    while times < _TIMES:
        raised, weights = _raised(cast, reached, power)
        few = 1.0 / (weights @ weights) < _FEW * draws.shape[1]
        if nearby is not None and few and len(weights) < _MOST:
            cast = _doubled(cast, density, nearby, random)
            continue
        reached = raised
        nearby = Nearby(cast[0][_chosen(weights, len(weights), random)], bent)
        cast = _cast(density, nearby, enough if reached == power else least, random)
        times += reached == power
    assert nearby is not None
    while True:
        _, weights = _raised(cast, power, power)
        effective, worst = worth(cast[0], weights)
        if effective >= want or len(weights) >= _MOST:
            break
        cast = _doubled(cast, density, nearby, random)
    draws, prior, likelihood, old = cast
    logs = prior + power * likelihood
    integral = float(logsumexp(logs - old) - np.log(len(logs)))
    error = float(weights.std() / weights.mean() / np.sqrt(len(weights)))
    # in the order of the entry whose ends are known worst, so that they stay where they are
    order = np.argsort(draws[:, worst])
    rows = random.permutation(order[_chosen(weights[order], min(len(draws), _KEPT), random)])
    return Drawn(draws[rows], logs[rows], effective, integral, error)


def many_for(entries: int) -> int:
    """Return how many times as many points are needed for so many entries as for a few."""
    return max(1, (entries // 10) ** 2)


def _cast(
    density: Density, nearby: Nearby, times: int, random: np.random.Generator
) -> list[FloatArray]:
    """Return points (s, d), log prior and log likelihood there, and the log of their density."""
    parts = []
    for _ in range(times):
        points, logs = nearby.points(random)
        parts.append((points, *density(points), logs))
    return [np.concatenate(part) for part in zip(*parts, strict=True)]


def _doubled(
    cast: list[FloatArray], density: Density, nearby: Nearby, random: np.random.Generator
) -> list[FloatArray]:
    """Return a cast with as many points more."""
    more = _cast(density, nearby, len(cast[0]) // _POINTS, random)
    return [np.concatenate(pair) for pair in zip(cast, more, strict=True)]


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
        if (count := float(w.sum() ** 2 / (w @ w))) > counting:
            counting, reached, weights = count, float(trial), w
        if count > _COUNT * len(w):
            break
    return reached, weights / weights.sum()


def _chosen(weights: FloatArray, count: int, random: np.random.Generator) -> IntArray:
    """Return rows (count,), each as often as its weight says, to one."""
    places = np.cumsum(weights / weights.sum())
    rows = np.searchsorted(places, (random.random() + np.arange(count)) / count)
    return np.minimum(rows, len(weights) - 1)


def worth(points: FloatArray, weights: FloatArray) -> tuple[float, int]:
    """Return how many draws of a normal distribution tell the ends of intervals as exactly.

    As points (s, d) with weights (s,) tell those of the entry whose ends are known worst over its
    sd, and this entry. Where a tail is long, a few draws more or less beyond an end move it far.
    """
    w, errors = weights / weights.sum(), []
    for x in points.T:
        order = np.argsort(x)
        x, ordered = x[order], w[order]
        below = np.cumsum(ordered)
        mean = ordered @ x
        sd = np.sqrt(ordered @ (x - mean) ** 2)
        for tail in (_TAIL, 1.0 - _TAIL):
            chance = np.sqrt(np.square(ordered) @ np.square((below < tail) - tail))
            near, far = np.interp([tail - 0.5 * _TAIL, tail + 0.5 * _TAIL], below, x)
            errors.append(chance * (far - near) / _TAIL / sd)
    worst, most = int(np.argmax(errors)), float(1.0 / (w @ w))  # few points tell nothing of others
    return min(float(_NORMAL_END / errors[worst]) ** 2, most), worst // 2
