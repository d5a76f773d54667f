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
from scipy.special import ndtr
from scipy.stats import norm, truncnorm
from scipy.stats import t as student_t

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import GROUPS, Prior, Problem
from ringwear_par.identification.likelihood import LOG_SHARES, EmulatedLikelihood

#: degrees of freedom of half-t priors of sizes
_DEGREES = 4.0
#: limits of logarithms of taus, less those of the scales of their priors
_FAR = np.array([-10.0, 10.0])
#: share of the variance that keeps covariances of groups regular where one level vanishes
_REGULAR = 1e-10


@dataclass(frozen=True, eq=False)
class Size:
    """A tau, or the share of random wear: its logarithm is in theta, or it is known."""

    #: its place in theta; None: it is known
    place: int | None
    known: float = 0.0
    #: of its half-t prior; the logarithm is within these limits
    scale: float = 1.0
    limits: FloatArray | tuple[float, float] = (-np.inf, np.inf)

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Return the size (...), within its limits."""
        if self.place is None:
            return np.full(theta.shape[:-1], self.known)
        size: FloatArray = np.exp(np.clip(theta[..., self.place], *self.limits))
        return size

    def log_prior(self, theta: FloatArray) -> FloatArray:
        """Return the log density (...) of its logarithm."""
        log = theta[..., self.place]
        logs = student_t.logpdf(self(theta) / self.scale, _DEGREES) + log
        logs = logs + np.log(2.0 / self.scale)
        return np.where((log > self.limits[0]) & (log < self.limits[1]), logs, -np.inf)


class Scattering:
    """A key whose value differs between groups of tests.

    Parameters
    ----------
    key : its number.
    levels : sd of deviations by the name of their level.
    place : of the first group's value in theta.
    """

    def __init__(self, problem: Problem, key: int, levels: Mapping[str, Size], place: int) -> None:
        parameter, prior = problem.parameters[key], problem.parameters[key].prior
        self.key, self.levels = key, levels
        low, high = parameter.bounds
        #: smallest and largest unknown of the material
        self.bounds = parameter.unknown(low), parameter.unknown(high)
        if prior is not None and parameter.log:
            prior = Prior(float(np.log(prior.mean)), prior.sd / prior.mean)
        #: mean and sd of the material's unknown before any reading; None: it is flat
        self.prior = prior
        names = np.array([test.groups for test in problem.experiments])
        labels = names[:, [GROUPS.index(name) for name in levels]]
        groups, of_tests = np.unique(labels, axis=0, return_inverse=True)
        #: (tests,) number of the group of each test
        self.group: IntArray = of_tests.ravel()
        #: of the groups' values in theta
        self.places = slice(place, place + len(groups))
        #: (levels, groups, groups) whether two groups are of one specimen, batch, lab
        self.same = (groups[:, None] == groups).transpose(2, 0, 1)

    def spread(self, theta: FloatArray) -> FloatArray:
        """Return the sd (...) of one more specimen, of a new batch and laboratory."""
        return np.sqrt(sum(size(theta) ** 2 for size in self.levels.values()))

    def _material(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mean and sd (...) of the material's value, and log p of the groups'."""
        x = theta[..., self.places]
        sizes = np.stack([size(theta) for size in self.levels.values()], axis=-1)
        both = np.stack([x, np.ones_like(x)], axis=-1)
        if len(self.levels) == 1:  # quicker by far where there are many groups
            solved, volume = both / sizes[..., None] ** 2, -x.shape[-1] * np.log(sizes[..., 0])
        else:
            same = self.same + _REGULAR * np.eye(x.shape[-1])
            covariance = np.einsum("...l,lij->...ij", sizes**2, same)
            solved = np.linalg.solve(covariance, both)
            volume = -0.5 * np.linalg.slogdet(covariance)[1]
        precision = solved[..., 1].sum(axis=-1)
        mean = solved[..., 0].sum(axis=-1) / precision
        off = solved[..., 0] - mean[..., None] * solved[..., 1]
        rest = ((x - mean[..., None]) * off).sum(axis=-1)
        constant = -0.5 * (x.shape[-1] - 1) * np.log(2.0 * np.pi)
        logs = constant + volume - 0.5 * rest - 0.5 * np.log(precision)
        if self.prior is None:
            return mean, precision**-0.5, logs - np.log(self.bounds[1] - self.bounds[0])
        at, sd = self.prior
        logs = logs + norm.logpdf(mean, at, np.hypot(precision**-0.5, sd))
        total = precision + sd**-2
        return (precision * mean + at / sd**2) / total, total**-0.5, logs

    def log_prior(self, theta: FloatArray) -> FloatArray:
        """Return the log density (...) of the groups' values."""
        mean, sd, logs = self._material(theta)
        below, above = (ndtr((end - mean) / sd) for end in self.bounds)
        total: FloatArray = logs + np.log(np.maximum(above - below, 1e-300))
        return total

    def draw(self, theta: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return a draw of the material's value for each theta, (...)."""
        mean, sd, _ = self._material(theta)
        low, high = ((end - mean) / sd for end in self.bounds)
        drawn: FloatArray = truncnorm.rvs(low, high, mean, sd, random_state=random)
        return drawn


class Posterior:
    """log p(theta | readings), of many theta at once.

    In theta are the keys that do not scatter, logarithms of taus and shares that are fitted, and
    the values of groups of tests.

    Parameters
    ----------
    likelihoods : one a test, or none.
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
        levels = [
            (j, {level: self._size(known, s.scale, np.log(s.scale) + _FAR)
                 for level, known in s.sizes.items()})
            for j, p in enumerate(parameters) if (s := p.scatter) is not None
        ]  # fmt: skip
        #: shares of random wear, of the bodies that have it
        self.wear_shares = [
            self._size(None if p.fitted else p.share or 0.0, p.scale, LOG_SHARES) for p in process
        ]
        self.scatterings: list[Scattering] = []
        for j, sizes in levels:
            self.scatterings.append(Scattering(problem, j, sizes, self.dimension))
            self.dimension = self.scatterings[-1].places.stop

    def _size(
        self, known: float | None, scale: float, limits: FloatArray | tuple[float, float]
    ) -> Size:
        """Return a size that is known, or one with the next place in theta."""
        if known is not None:
            return Size(None, known)
        self.sizes.append(Size(self.dimension, scale=scale, limits=limits))
        self.dimension += 1
        return self.sizes[-1]

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
            logs = np.log(0.5 * size.scale) + 0.5 * random.standard_normal(count)
            low, high = size.limits  # where there is no density any more
            theta[:, size.place] = np.clip(logs, low + 1e-6, high - 1e-6)
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
                density = norm.logpdf(np.exp(x) if p.log else x, *p.prior) + x * p.log
            logs = logs + np.where((x >= low) & (x <= high), density, -np.inf)
        parts: list[Size | Scattering] = [*self.sizes, *self.scatterings]
        for part in parts:
            logs = logs + part.log_prior(theta)
        return logs

    def parts(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log prior and log likelihood (s,) of theta (s, d); -inf and 0 out of boxes."""
        prior, x, likelihood = self.log_prior(theta), self.of_tests(theta), np.zeros(len(theta))
        for i, of_test in enumerate(self.likelihoods):
            prior[~of_test.emulator.holds(x[:, i])] = -np.inf
        inside = np.isfinite(prior)
        x, shares = x[inside], self.shares(theta[inside])
        for i, of_test in enumerate(self.likelihoods):
            likelihood[inside] += of_test(of_test.emulator.coordinates(x[:, i]), shares)
        return prior, likelihood
