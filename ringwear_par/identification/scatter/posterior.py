"""What is known after the sizes of all scatters are integrated over a grid.

A size has a half-t prior with four degrees of freedom: with few specimens the likelihood alone
hardly bounds it, and intervals at its best value hold the truth too rarely.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import log_ndtr, logsumexp, ndtr
from scipy.stats import t as student_t

from ringwear_par.arrays import FloatArray
from ringwear_par.batched import concat, take
from ringwear_par.identification.scatter.likelihood import MixedModel, Solutions

#: standard deviations beyond the outermost mean that hold all of a mixture, and error of a quantile
_REACH, _ROUND_OFF = 40.0, 1e-15
#: degrees of freedom of the priors of sizes
DEGREES = 4.0
#: points of the grid along each axis, by the number of axes
_POINTS = {1: 120, 2: 60, 3: 20}
#: ends of the grid of a size, over the scale of its prior
_GRID = (0.007, 17.0)
#: difference of -2 log likelihood from the best that a finer grid covers
_NEAR = 8.0
#: fewest points of an axis there; with fewer it is too coarse
_FEW = 10
#: points whose solutions are computed together, and -2 log likelihood over the best above which
#: they are dropped: their weights are round-off
_CHUNK, _IMPROBABLE = 256, 75.0
#: growth of -2 log likelihood at size 0 over the best that excludes it at 90 %
_AT_BOUND = 2.71


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

    def log_probability(self, low: float, high: float) -> float:
        """Return the logarithm of the probability between two numbers, however far off they are."""
        ends = (np.array([[low], [high]]) - self.means) / np.sqrt(self.variances)
        ends = np.where(ends[0] > 0.0, -ends[::-1], ends)  # upper tails as lower ones
        below_low, below_high = log_ndtr(ends)
        between = below_high + np.log1p(-np.exp(below_low - below_high))
        return float(logsumexp(between, b=self.weights))

    def quantile(self, probability: float) -> float:
        """Return the number below which the mixture has a probability, between 0 and 1."""
        sd = np.sqrt(self.variances)
        low, high = (self.means - _REACH * sd).min(), (self.means + _REACH * sd).max()

        def missing(number: float) -> float:
            return float(self.weights @ ndtr((number - self.means) / sd)) - probability

        return float(brentq(missing, low, high, xtol=_ROUND_OFF * (high - low), rtol=_ROUND_OFF))

    def interval(self, level: float) -> tuple[float, float]:
        """Return the central interval that holds the number with a probability ``level``."""
        tail = 0.5 * (1.0 - level)
        return self.quantile(tail), self.quantile(1.0 - tail)


@dataclass(frozen=True)
class Size:
    """A size that is known, or has a prior."""

    #: the size, None where it is to be fitted
    known: float | None
    #: of its half-t prior
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class Axis:
    """The points of a size."""

    #: (k,) float, increasing; one where the size is known
    points: FloatArray
    #: (k,) float, prior density times the width that a point stands for, but for a factor
    weights: FloatArray
    #: logarithm of that
    log_factor: float = 0.0


#: of a size that is 0
_NO_SIZE = Axis(np.zeros(1), np.ones(1))


def prior_density(size: FloatArray, scale: float) -> FloatArray:
    """Return the half-t density of sizes, but for a constant."""
    return (1.0 + (size / scale) ** 2 / DEGREES) ** (-0.5 * (DEGREES + 1.0))


def axis(size: Size, points: int, ends: tuple[float, float] | None = None) -> Axis:
    """Return the axis of a size; points are equal in the logarithm."""
    if size.known is not None:
        return Axis(np.array([size.known]), np.ones(1))
    low, high = ends or (_GRID[0] * size.scale, _GRID[1] * size.scale)
    values = np.geomspace(low, high, points)
    factor = 2.0 * student_t.pdf(0.0, DEGREES) / size.scale * np.log(high / low) / (points - 1)
    return Axis(values, values * prior_density(values, size.scale), float(np.log(factor)))


def grid(axes_of_sizes: Sequence[Axis]) -> tuple[FloatArray, FloatArray]:
    """Return all combinations of points, (G, sizes), and their weights, (G,)."""
    points = np.array(list(itertools.product(*(a.points for a in axes_of_sizes))))
    weights = np.array([np.prod(w) for w in itertools.product(*(a.weights for a in axes_of_sizes))])
    return points.reshape(len(weights), len(axes_of_sizes)), weights


@dataclass(frozen=True, eq=False)
class SizePosterior:
    """What is known of one size."""

    #: of its posterior
    median: float
    #: of the asked level; from 0 where 0 is not excluded
    interval: tuple[float, float]
    #: the size of the largest restricted likelihood
    restricted: float
    #: whether a size of 0 is not excluded by the readings
    at_bound: bool


class MaterialDraws(NamedTuple):
    """Draws of the unknowns of the material and of all tests, and of the sizes."""

    #: (n, m)
    material: FloatArray
    #: (n, tests, m)
    tests: FloatArray
    #: (n, levels)
    tau: FloatArray
    #: (n, bodies)
    shares: FloatArray


@dataclass(frozen=True, eq=False)
class ScatterPosterior:
    """The posterior of mixed models over the grid of their sizes."""

    #: one for each point of the process noise, one at least; of the same levels
    models: tuple[MixedModel, ...]
    #: at the points of the grid, those of each model after another
    solutions: Solutions
    #: (G,) float, posterior probability of each point
    weights: FloatArray
    #: (G, bodies) float, shares of the process noise at each point
    shares: FloatArray
    #: (levels + bodies,) float, smallest restricted -2 log likelihood without the scatter of a
    #: level, or the process noise of a body; NaN where its size is known
    without: FloatArray
    #: logarithm of the likelihood that was integrated over the grid, but for a constant
    log_mass: float

    @property
    def model(self) -> MixedModel:
        """The first model, for what all share: levels, and the layout of effects."""
        return self.models[0]

    def _rows(self, test: int | None) -> FloatArray:
        """Return (G, m, m + groups) what effects are in the unknowns of a test, or the material."""
        if test is None:
            m, size = self.model.m, self.solutions.effects.shape[1]
            return np.broadcast_to(np.eye(m, size), (len(self.weights), m, size))
        return self.model.columns(test) * self.model.scales(self.solutions.tau)[:, None, :]

    def means_of(self, test: int | None = None) -> FloatArray:
        """Return the means (G, m) of a test's unknowns, in the light of the others.

        As below, None stands for the material.
        """
        return np.einsum("gki,gi->gk", self._rows(test), self.solutions.effects)

    def covariances_of(self, test: int | None = None) -> FloatArray:
        """Return the covariances (G, m, m) of a test's unknowns."""
        rows, within = self._rows(test), self.solutions.covariance
        return np.einsum("gki,gij,glj->gkl", rows, within, rows, optimize=True)

    def unknown(self, key: int, test: int | None = None) -> Mixture:
        """Return the distribution of a key's unknown in a test."""
        variances = self.covariances_of(test)[:, key, key]
        return Mixture(self.weights, self.means_of(test)[:, key], variances)

    def covariance(self, test: int | None = None, other: int | None = None) -> FloatArray:
        """Return the covariance (m, m) of the unknowns of a test with those of another."""
        first, second, w = self._rows(test), self._rows(other), self.weights
        within = self.solutions.covariance
        within = np.einsum("g,gki,gij,glj->kl", w, first, within, second, optimize=True)
        a, b = (values - w @ values for values in (self.means_of(test), self.means_of(other)))
        return within + np.einsum("g,gk,gl->kl", w, a, b)

    def next_specimen(self, key: int) -> Mixture:
        """Return the distribution of a key's value of one more specimen, of a new batch and lab."""
        material = self.unknown(key)
        levels = [i for i, level in enumerate(self.model.levels) if level.key == key]
        spread = (self.solutions.tau[:, levels] ** 2).sum(axis=1)
        return Mixture(self.weights, material.means, material.variances + spread)

    def draw(self, tests: int, count: int, random: np.random.Generator) -> MaterialDraws:
        """Return some draws of everything, of all of so many tests together."""
        s = self.solutions
        part = random.choice(len(self.weights), count, p=self.weights)
        roots = np.linalg.cholesky(s.covariance)
        normal = random.standard_normal((count, s.effects.shape[1]))
        effects = s.effects[part] + np.einsum("nij,nj->ni", roots[part], normal)
        of_tests = [
            np.einsum("nki,ni->nk", self._rows(test)[part], effects) for test in range(tests)
        ]
        return MaterialDraws(effects[:, : self.model.m], np.stack(of_tests, axis=1), s.tau[part],
                     self.shares[part])  # fmt: skip

    def size(self, number: int, probability: float) -> SizePosterior:
        """Return the posterior of the size of a level's scatter, its interval of a probability.

        Shares of the process noise of bodies follow the levels.
        """
        values = np.concatenate([self.solutions.tau, self.shares], axis=1)[:, number]
        points = np.unique(values)
        mass = np.array([self.weights[values == point].sum() for point in points])
        centred = np.cumsum(mass) - 0.5 * mass
        tail = 0.5 * (1.0 - probability)
        low, median, high = np.interp([tail, 0.5, 1.0 - tail], centred, points)
        best, at_zero = int(np.argmin(self.solutions.restricted)), float(self.without[number])
        least = float(self.solutions.restricted[best])
        at_bound = at_zero - least < _AT_BOUND
        return SizePosterior(
            float(median),
            (0.0 if at_bound else float(low), float(high)),
            0.0 if at_zero <= least else float(values[best]),
            at_bound,
        )

    def share(self, body: int, probability: float) -> SizePosterior:
        """Return the posterior of the share of the process noise of a body, see ``size``."""
        return self.size(len(self.model.levels) + body, probability)


def integrate(
    models_at: Callable[[FloatArray], Sequence[MixedModel]],
    sizes: Sequence[Size],
    shares: Sequence[Size] = (),
) -> ScatterPosterior:
    """Return the posterior of mixed models over the sizes of their levels and of process noise.

    ``models_at`` returns a model for each of (k, bodies) shares of the process noise. With three
    sizes to be fitted, or one that is known well, a coarse grid finds where the likelihood is, and
    a second one covers that. LinAlgError where tests and priors together do not determine the
    material.
    """
    names = [*sizes, *shares]
    unknown = sum(size.known is None for size in names)
    axes = [axis(size, _POINTS.get(unknown, 1)) for size in names]
    posterior = _posterior(models_at, axes, len(sizes))
    restricted = posterior.solutions.restricted
    values = np.concatenate([posterior.solutions.tau, posterior.shares], axis=1)
    near = values[restricted < restricted.min() + _NEAR]
    coarse = [
        size.known is None and (unknown > 2 or len(np.unique(v)) < _FEW)
        for v, size in zip(near.T, names, strict=True)
    ]
    if not any(coarse):
        return posterior
    finer = [
        axis(size, _POINTS[unknown], _widened(before, near[:, i])) if coarse[i] else before
        for i, (size, before) in enumerate(zip(names, axes, strict=True))
    ]
    return _posterior(models_at, finer, len(sizes))


def _widened(before: Axis, near: FloatArray) -> tuple[float, float]:
    """Return the ends of an axis that holds some of its points, and one more on each side."""
    low = max(int(np.searchsorted(before.points, near.min())) - 1, 0)
    high = min(int(np.searchsorted(before.points, near.max())) + 1, len(before.points) - 1)
    return float(before.points[low]), float(before.points[high])


def _posterior(
    models_at: Callable[[FloatArray], Sequence[MixedModel]], axes: Sequence[Axis], n_levels: int
) -> ScatterPosterior:
    """Return the posterior over a grid: axes of the levels, then of the process noise."""
    tau, weights = grid(axes[:n_levels])
    points, prior = grid(axes[n_levels:])
    # without each size that is fitted: shares have models of their own there
    nulls = {
        i: grid([*axes[:i], _NO_SIZE, *axes[i + 1 :]])[0]
        for i, size in enumerate(axes)
        if len(size.points) > 1
    }
    extra = [np.unique(null[:, n_levels:], axis=0) for i, null in nulls.items() if i >= n_levels]
    models = models_at(np.concatenate([points, *extra]))
    parts = iter(np.split(np.arange(len(models)), np.cumsum([len(points), *map(len, extra)])[:-1]))
    of_grid, without = next(parts), np.full(len(axes), np.nan)
    for i, null in nulls.items():
        no_scatter, numbers = np.unique(null[:, :n_levels], axis=0), of_grid
        if i >= n_levels:
            numbers = next(parts)
        without[i] = min(models[j].solve(no_scatter).restricted.min() for j in numbers)
    probable, weighted, model_numbers = [], [], []
    least = np.inf
    for number, model in enumerate(models[: len(points)]):
        for first in range(0, len(tau), _CHUNK):
            part = slice(first, first + _CHUNK)
            solutions = model.solve(tau[part])
            least = min(least, float(solutions.restricted.min()))
            near = np.flatnonzero(solutions.restricted < least + _IMPROBABLE)
            probable.append(take(solutions, near))
            weighted.append(prior[number] * weights[part][near])
            model_numbers.append(np.full(len(near), number))
    solutions = concat(probable)
    posterior = np.exp(-0.5 * (solutions.restricted - least)) * np.concatenate(weighted)
    return ScatterPosterior(
        tuple(models[: len(points)]), solutions, posterior / posterior.sum(),
        points[np.concatenate(model_numbers)], without,
        float(np.log(posterior.sum()) - 0.5 * least + sum(a.log_factor for a in axes)),
    )  # fmt: skip
