"""The joint posterior of a material, its scatter and its specimens.

What is assumed. Each test has values of the keys. A key without scatter has one value for all
tests. Values of a key that scatters are normal about the material's, one for each group of tests:
those of one specimen, batch or laboratory share a deviation of sd tau_specimen, tau_batch, tau_lab.
Of logarithms where the key's scale is logarithmic. The material's value is flat within the key's
bounds, or has its prior; each tau has a half-t prior (4 degrees of freedom); so has the share of
random wear. Given taus and specimens' values the material's own value is normal and is integrated
out: it need not be sampled.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, log_ndtr
from scipy.stats import truncnorm

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import (
    GROUPS,
    Prior,
    Problem,
    Scatter,
)
from ringwear_par.identification.likelihood import LOG_SHARES, EmulatedLikelihood

#: degrees of freedom of half-t priors of sizes, and the logarithm of their density at 0
_DEGREES = 4.0
_HALF_T = float(np.log(2.0) + gammaln(2.5) - gammaln(2.0) - 0.5 * np.log(4.0 * np.pi))
#: logarithm of the density of a normal distribution of sd 1 at its mean
_NORMAL = -0.5 * float(np.log(2.0 * np.pi))
#: logarithms of taus are no farther from those of the scales of their priors
_FAR = 10.0
#: share of the variance that keeps covariances of groups regular where one level vanishes
_REGULAR = 1e-10


@dataclass(frozen=True)
class Size:
    """A tau, or the share of random wear: its logarithm is in theta, or it is known."""

    #: its place in theta; None: it is known
    place: int | None
    known: float = 0.0
    #: of its half-t prior; the logarithm is within these limits
    scale: float = 1.0
    limits: tuple[float, float] = (-np.inf, np.inf)

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Return the size (...), within its limits."""
        if self.place is None:
            return np.full(theta.shape[:-1], self.known)
        size: FloatArray = np.exp(np.clip(theta[..., self.place], *self.limits))
        return size

    def log_prior(self, theta: FloatArray) -> FloatArray:
        """Return the log density (...) of its logarithm."""
        log = theta[..., self.place]
        square, volume = (self(theta) / self.scale) ** 2, log - np.log(self.scale)
        logs = _HALF_T + volume - 0.5 * (_DEGREES + 1.0) * np.log1p(square / _DEGREES)
        return np.where((log > self.limits[0]) & (log < self.limits[1]), logs, -np.inf)


@dataclass(frozen=True, eq=False)
class Scattering:
    """A key whose value differs between groups of tests."""

    #: its number, and the smallest and largest unknown of the material
    key: int
    bounds: tuple[float, float]
    #: mean and sd of the material's unknown before any reading; None: it is flat
    prior: Prior | None
    #: places of the groups' values in theta
    places: slice
    #: (tests,) number of the group of each test
    group: IntArray
    #: sd of deviations by the name of their level
    levels: Mapping[str, Size]
    #: (levels, groups, groups) 1 where two groups are of one specimen, batch, lab
    same: FloatArray

    def spread(self, theta: FloatArray) -> FloatArray:
        """Return the sd (...) of one more specimen, of a new batch and laboratory."""
        return np.sqrt(sum(size(theta) ** 2 for size in self.levels.values()))

    def material(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mean and sd (...) of the material's value, and log p of the groups'."""
        x = theta[..., self.places]
        sizes = np.stack([size(theta) for size in self.levels.values()], axis=-1)
        if len(self.levels) == 1:
            tau, n = sizes[..., 0], x.shape[-1]
            mean, precision = x.mean(axis=-1), n / tau**2
            rest = np.square(x - mean[..., None]).sum(axis=-1) / tau**2
            volume = -n * np.log(tau)
        else:
            total = np.square(sizes).sum(axis=-1)[..., None, None]
            covariance = np.einsum("...l,lij->...ij", sizes**2, self.same)
            covariance = covariance + _REGULAR * total * np.eye(x.shape[-1])
            factor = np.linalg.inv(np.linalg.cholesky(covariance))
            a, b = np.einsum("...ij,...j->...i", factor, x), factor.sum(axis=-1)
            precision = np.square(b).sum(axis=-1)
            mean = (a * b).sum(axis=-1) / precision
            rest = np.square(a).sum(axis=-1) - mean**2 * precision
            volume = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        logs = _NORMAL * (x.shape[-1] - 1) + volume - 0.5 * rest - 0.5 * np.log(precision)
        if self.prior is None:
            return mean, precision**-0.5, logs - np.log(self.bounds[1] - self.bounds[0])
        at, sd = self.prior
        variance, both = 1.0 / precision + sd**2, precision + sd**-2
        logs = logs + _NORMAL - 0.5 * (mean - at) ** 2 / variance - 0.5 * np.log(variance)
        return (precision * mean + at / sd**2) / both, both**-0.5, logs

    def log_prior(self, theta: FloatArray) -> FloatArray:
        """Return the log density (...) of the groups' values."""
        mean, sd, logs = self.material(theta)
        low, high = ((end - mean) / sd for end in self.bounds)
        inside = np.exp(log_ndtr(high)) - np.exp(log_ndtr(low))
        total: FloatArray = logs + np.log(np.maximum(inside, 1e-300))
        return total

    def draw(self, theta: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return a draw of the material's value for each theta, (...)."""
        mean, sd, _ = self.material(theta)
        low, high = ((end - mean) / sd for end in self.bounds)
        drawn: FloatArray = mean + sd * truncnorm.rvs(low, high, random_state=random)
        return drawn


class Posterior:
    """log p(theta | readings), of many theta at once.

    In theta are the keys that do not scatter, logarithms of taus and shares that are fitted, and
    the values of groups of tests.

    Parameters
    ----------
    likelihoods : one a test, or none; tests of equal conditions share an emulator.
    """

    def __init__(self, problem: Problem, likelihoods: Sequence[EmulatedLikelihood] = ()) -> None:
        self.problem, self.likelihoods = problem, likelihoods
        parameters, process = problem.parameters, problem.settings.process.values()
        self.low, self.high = problem.unknown_bounds
        #: numbers of the keys that do not scatter
        self.shared = [j for j, p in enumerate(parameters) if p.scatter is None]
        #: number of entries of theta
        self.dimension = len(self.shared)
        #: sizes that are fitted, in theta behind these
        self.sizes: list[Size] = []
        levels = {j: self._levels(p.scatter) for j, p in enumerate(parameters) if p.scatter}
        #: shares of random wear, of the bodies that have it
        self.wear_shares = [
            self._size(None if p.fitted else p.share or 0.0, p.scale, LOG_SHARES) for p in process
        ]
        self.scatterings = [self._scattering(j, sizes) for j, sizes in levels.items()]
        #: numbers of tests that share an emulator
        self._alike: dict[int, list[int]] = {}
        for i, likelihood in enumerate(likelihoods):
            self._alike.setdefault(id(likelihood.emulator), []).append(i)

    def _size(self, known: float | None, scale: float, limits: tuple[float, float]) -> Size:
        """Return a size that is known, or one with the next place in theta."""
        if known is not None:
            return Size(None, known)
        self.sizes.append(Size(self.dimension, scale=scale, limits=limits))
        self.dimension += 1
        return self.sizes[-1]

    def _levels(self, scatter: Scatter) -> dict[str, Size]:
        middle = float(np.log(scatter.scale))
        limits = middle - _FAR, middle + _FAR
        return {
            name: self._size(known, scatter.scale, limits) for name, known in scatter.sizes.items()
        }

    def _scattering(self, key: int, sizes: dict[str, Size]) -> Scattering:
        """Return the scattering of a key, with the next places in theta."""
        parameter, tests = self.problem.parameters[key], self.problem.experiments
        labels = np.array([test.groups for test in tests])[:, [*map(GROUPS.index, sizes)]]
        groups, of_tests = np.unique(labels, axis=0, return_inverse=True)
        places = slice(self.dimension, self.dimension + len(groups))
        self.dimension = places.stop
        same = (groups[:, None] == groups).transpose(2, 0, 1).astype(float)
        prior = parameter.prior
        if prior is not None and parameter.log:
            prior = Prior(float(np.log(prior.mean)), prior.sd / prior.mean)
        bounds = float(self.low[key]), float(self.high[key])
        return Scattering(key, bounds, prior, places, of_tests.ravel(), sizes, same)

    # -- what is in theta --------------------------------------------------------------------------

    def of_tests(self, theta: FloatArray) -> FloatArray:
        """Return the unknowns (..., tests, m) of each test."""
        shape = len(self.problem.experiments), len(self.problem.parameters)
        x = np.empty((*theta.shape[:-1], *shape))
        x[..., self.shared] = theta[..., None, : len(self.shared)]
        for s in self.scatterings:
            x[..., s.key] = theta[..., s.places][..., s.group]
        return x

    def material(self, theta: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return unknowns (s, m) of the material, a draw for each theta (s, d)."""
        x = np.empty((len(theta), len(self.problem.parameters)))
        x[:, self.shared] = theta[:, : len(self.shared)]
        for s in self.scatterings:
            x[:, s.key] = s.draw(theta, random)
        return x

    def shares(self, theta: FloatArray) -> FloatArray:
        """Return the shares of random wear (..., bodies)."""
        shares = [size(theta) for size in self.wear_shares]
        return np.stack(shares, axis=-1) if shares else np.zeros((*theta.shape[:-1], 0))

    def anywhere(self, count: int, random: np.random.Generator) -> FloatArray:
        """Return theta (count, d) all over the bounds, or by priors; sizes about their scales."""
        theta = np.empty((count, self.dimension))
        x = random.uniform(self.low, self.high, (count, len(self.low)))
        for j, p in enumerate(self.problem.parameters):
            if p.prior is not None:
                values = p.prior.mean + 2.0 * p.prior.sd * random.standard_normal(count)
                values = np.clip(values, *p.bounds)
                x[:, j] = np.log(values) if p.log else values
        theta[:, : len(self.shared)] = x[:, self.shared]
        for size in self.sizes:
            log = np.log(0.5 * size.scale) + 0.5 * random.standard_normal(count)
            theta[:, size.place] = log
        for s in self.scatterings:
            z = random.standard_normal((count, s.places.stop - s.places.start))
            values = x[:, [s.key]] + s.spread(theta)[:, None] * z
            theta[:, s.places] = np.clip(values, *s.bounds)
        return theta

    # -- probability -------------------------------------------------------------------------------

    def log_prior(self, theta: FloatArray) -> FloatArray:
        """Return the log density (...) of the prior of theta (..., d).

        Its integral is 1 but for the ends of normal priors beyond bounds.
        """
        logs = np.zeros(theta.shape[:-1])
        for place, j in enumerate(self.shared):
            x, p = theta[..., place], self.problem.parameters[j]
            low, high = self.low[j], self.high[j]
            density = -np.log(high - low)
            if p.prior is not None:
                value, (mean, sd) = np.exp(x) if p.log else x, p.prior
                density = _NORMAL - np.log(sd) - 0.5 * ((value - mean) / sd) ** 2 + x * p.log
            logs = logs + np.where((x >= low) & (x <= high), density, -np.inf)
        parts: list[Size | Scattering] = [*self.sizes, *self.scatterings]
        for part in parts:
            logs = logs + part.log_prior(theta)
        return logs

    def of_readings(self, theta: FloatArray) -> FloatArray:
        """Return log likelihoods (s,) at theta (s, d)."""
        x, shares, total = self.of_tests(theta), self.shares(theta), np.zeros(len(theta))
        for tests in self._alike.values():
            coordinates = self.likelihoods[tests[0]].emulator.coordinates(x[:, tests])
            for place, test in enumerate(tests):
                total += self.likelihoods[test](coordinates[:, place], shares)
        return total

    def parts(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log prior and log likelihood (s,) of theta (s, d); -inf and 0 out of boxes."""
        prior, x = self.log_prior(theta), self.of_tests(theta)
        for tests in self._alike.values():
            inside = self.likelihoods[tests[0]].emulator.holds(x[:, tests]).all(axis=1)
            prior[~inside] = -np.inf
        inside, likelihood = np.isfinite(prior), np.zeros(len(theta))
        if inside.any():
            likelihood[inside] = self.of_readings(theta[inside])
        return prior, likelihood

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Return log p (s,) of theta (s, d); -inf out of the boxes."""
        prior, likelihood = self.parts(theta)
        return prior + likelihood
