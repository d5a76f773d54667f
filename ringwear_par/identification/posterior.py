"""The joint posterior of a material, its scatter and its specimens.

What is assumed. Each test has values of the keys. A key without scatter has one value for all
tests. Values of a key that scatters are normal about the material's, one for each group of tests:
those of one specimen, batch or laboratory share a deviation of sd tau_specimen, tau_batch, tau_lab.
Of logarithms where the key's scale is logarithmic. The material's value is flat within the key's
bounds, or has its prior; each tau has a half-t prior (4 degrees of freedom); so has the share of
random wear. Given taus and specimens' values the material's own value is normal and is integrated
out: it need not be sampled.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln, log_ndtr
from scipy.stats import truncnorm

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.identification.definition.problem import GROUPS, Problem
from ringwear_par.identification.likelihood import LOG_SHARES, EmulatedLikelihood

#: degrees of freedom of half-t priors of sizes
_DEGREES = 4.0
#: logarithms of sizes are no farther from those of the scales of their priors
_FAR = 10.0
#: share of the variance that keeps covariances of groups regular where one level vanishes
_REGULAR = 1e-10


def log_half_t(log_size: FloatArray, scale: float) -> FloatArray:
    """Return the log density of log sizes by the half-t prior of sizes, but for a constant."""
    square = np.exp(2.0 * log_size) / scale**2
    logs: FloatArray = (
        log_size - np.log(scale) - 0.5 * (_DEGREES + 1.0) * np.log1p(square / _DEGREES)
    )
    return logs


@dataclass(frozen=True, eq=False)
class Scattering:
    """A key whose value differs between groups of tests."""

    #: its number
    key: int
    #: places of the groups' values in theta
    places: slice
    #: (tests,) number of the group of each test
    group: IntArray
    #: names of levels, and places in theta of the logs of their sizes; None: a known size
    levels: tuple[str, ...]
    sizes: tuple[int | None, ...]
    known: tuple[float, ...]
    #: (levels, groups, groups) 1 where two groups are of one specimen, batch, lab
    same: FloatArray

    def size(self, theta: FloatArray, level: int) -> FloatArray:
        """Return the sd (...) of a level."""
        place = self.sizes[level]
        if place is None:
            return np.full(theta.shape[:-1], self.known[level])
        size: FloatArray = np.exp(theta[..., place])
        return size

    def spread(self, theta: FloatArray) -> FloatArray:
        """Return the sd (...) of one more specimen, of a new batch and laboratory."""
        squares = sum(self.size(theta, level) ** 2 for level in range(len(self.levels)))
        return np.sqrt(squares)

    def material(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mean and precision (...) of the material's value, and log p of the groups'."""
        x = theta[..., self.places]
        if len(self.levels) == 1 and (self.same[0] == np.eye(x.shape[-1])).all():
            tau, n = self.size(theta, 0), x.shape[-1]
            mean, precision = x.mean(axis=-1), n / tau**2
            rest = np.square(x - mean[..., None]).sum(axis=-1) / tau**2
            return mean, precision, -n * np.log(tau) - 0.5 * rest - 0.5 * np.log(precision)
        sizes = np.stack([self.size(theta, level) for level in range(len(self.levels))], axis=-1)
        total = np.square(sizes).sum(axis=-1)[..., None, None]
        covariance = np.einsum("...l,lij->...ij", sizes**2, self.same)
        covariance = covariance + _REGULAR * total * np.eye(x.shape[-1])
        factor = np.linalg.inv(np.linalg.cholesky(covariance))
        a, b = np.einsum("...ij,...j->...i", factor, x), factor.sum(axis=-1)
        precision = np.square(b).sum(axis=-1)
        mean = (a * b).sum(axis=-1) / precision
        rest = np.square(a).sum(axis=-1) - mean**2 * precision
        volume = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        return mean, precision, volume - 0.5 * rest - 0.5 * np.log(precision)


class Layout:
    """Places in theta: keys that do not scatter, log sizes and shares, values of groups."""

    def __init__(self, problem: Problem) -> None:
        self.problem, tests = problem, problem.experiments
        self.m = len(problem.parameters)
        self.low, self.high = problem.unknown_bounds
        self.shared = [j for j, p in enumerate(problem.parameters) if p.scatter is None]
        at = len(self.shared)
        #: places of logs of sizes and shares, and the scales of their half-t priors
        self.sizes: list[tuple[int, float]] = []
        places: dict[int, list[int | None]] = {}
        for j, parameter in enumerate(problem.parameters):
            if parameter.scatter is None:
                continue
            places[j] = []
            for known in parameter.scatter.sizes.values():
                places[j].append(at if known is None else None)
                if known is None:
                    self.sizes.append((at, parameter.scatter.scale))
                    at += 1
        #: place of the log share of each body whose wear is random; None: it is known
        self.share_places: list[int | None] = []
        for process in problem.settings.process.values():
            self.share_places.append(at if process.fitted else None)
            if process.fitted:
                self.sizes.append((at, process.scale))
                at += 1
        self.scatterings: list[Scattering] = []
        for j, sizes in places.items():
            scatter = problem.parameters[j].scatter
            assert scatter is not None
            levels = [GROUPS.index(name) for name in scatter.sizes]
            labels = ["\0".join(test.groups[i] for i in sorted(levels)) for test in tests]
            _, first, group = np.unique(labels, return_index=True, return_inverse=True)
            names = [[tests[t].groups[i] for t in first] for i in levels]
            same = np.array([[[a == b for b in n] for a in n] for n in names], dtype=float)
            place = slice(at, at + len(first))
            sizes_known = tuple(size or 0.0 for size in scatter.sizes.values())
            self.scatterings.append(
                Scattering(j, place, group, tuple(scatter.sizes), tuple(sizes), sizes_known, same)
            )
            at = place.stop
        #: number of entries of theta
        self.dimension = at

    def anywhere(self, count: int, random: np.random.Generator) -> FloatArray:
        """Return theta (count, d) all over the bounds, or by priors; sizes about their scales."""
        theta = np.empty((count, self.dimension))
        x = random.uniform(self.low, self.high, (count, self.m))
        for j, p in enumerate(self.problem.parameters):
            if p.prior is not None:
                values = p.prior.mean + 2.0 * p.prior.sd * random.standard_normal(count)
                values = np.clip(values, *p.bounds)
                x[:, j] = np.log(values) if p.log else values
        theta[:, : len(self.shared)] = x[:, self.shared]
        for place, scale in self.sizes:
            theta[:, place] = np.log(0.5 * scale) + 0.5 * random.standard_normal(count)
        for s in self.scatterings:
            z = random.standard_normal((count, s.places.stop - s.places.start))
            values = x[:, [s.key]] + s.spread(theta)[:, None] * z
            theta[:, s.places] = np.clip(values, self.low[s.key], self.high[s.key])
        return theta

    def shares(self, theta: FloatArray, known: FloatArray) -> FloatArray:
        """Return the shares of random wear (..., bodies), those that are known (bodies,) too."""
        shares = np.broadcast_to(known, (*theta.shape[:-1], len(self.share_places))).copy()
        for body, place in enumerate(self.share_places):
            if place is not None:
                shares[..., body] = np.exp(theta[..., place])
        return shares

    def of_tests(self, theta: FloatArray) -> FloatArray:
        """Return the unknowns (..., tests, m) of each test."""
        x = np.empty((*theta.shape[:-1], len(self.problem.experiments), self.m))
        x[..., self.shared] = theta[..., None, : len(self.shared)]
        for s in self.scatterings:
            x[..., s.key] = theta[..., s.places][..., s.group]
        return x

    def material(self, theta: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return unknowns (s, m) of the material, a draw for each theta (s, d)."""
        x = np.empty((len(theta), self.m))
        x[:, self.shared] = theta[:, : len(self.shared)]
        for s in self.scatterings:
            mean, precision, _ = self._material(s, theta)
            sd = precision**-0.5
            low, high = (self.low[s.key] - mean) / sd, (self.high[s.key] - mean) / sd
            x[:, s.key] = mean + sd * truncnorm.rvs(low, high, random_state=random)
        return x

    def _material(
        self, s: Scattering, theta: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what ``Scattering.material`` does, by the key's prior too.

        Of a logarithm the prior is normal as well, of a relative sd.
        """
        mean, precision, logs = s.material(theta)
        parameter = self.problem.parameters[s.key]
        if parameter.prior is None:
            return mean, precision, logs
        at, sd = parameter.prior
        if parameter.log:
            at, sd = np.log(at), sd / at
        variance = 1.0 / precision + sd**2
        logs = logs - 0.5 * (mean - at) ** 2 / variance - 0.5 * np.log(variance)
        both = precision + sd**-2
        return (precision * mean + at / sd**2) / both, both, logs

    @property
    def log_constant(self) -> float:
        """Logarithm of what makes the integral of the prior 1, but for ends of normal ones."""
        constant = 0.0
        for j, parameter in enumerate(self.problem.parameters):
            if parameter.prior is None:
                constant -= np.log(self.high[j] - self.low[j])
            else:
                scatters = parameter.scatter is not None  # then the sd is in ``_material``
                constant -= 0.5 * np.log(2.0 * np.pi) + (
                    0.0 if scatters else np.log(parameter.prior.sd)
                )
        half_t = gammaln(0.5 * (_DEGREES + 1.0)) - gammaln(0.5 * _DEGREES)
        constant += len(self.sizes) * (np.log(2.0) + half_t - 0.5 * np.log(_DEGREES * np.pi))
        groups = [s.places.stop - s.places.start for s in self.scatterings]
        return float(constant - 0.5 * np.log(2.0 * np.pi) * sum(n - 1 for n in groups))

    def log_prior(self, theta: FloatArray) -> FloatArray:
        """Return the log density of the prior of theta (..., d), but for a constant."""
        logs = np.zeros(theta.shape[:-1])
        for place, scale in self.sizes:
            logs = logs + log_half_t(theta[..., place], scale)
            logs = np.where(np.abs(theta[..., place] - np.log(scale)) < _FAR, logs, -np.inf)
        for at in self.share_places:
            if at is not None:
                share = theta[..., at]
                logs = np.where((share > LOG_SHARES[0]) & (share < LOG_SHARES[1]), logs, -np.inf)
        for place, j in enumerate(self.shared):
            x, p = theta[..., place], self.problem.parameters[j]
            logs = np.where((x >= self.low[j]) & (x <= self.high[j]), logs, -np.inf)
            if p.prior is not None:
                value = np.exp(x) if p.log else x
                logs = logs - 0.5 * ((value - p.prior.mean) / p.prior.sd) ** 2 + x * p.log
        for s in self.scatterings:
            mean, precision, log_p = self._material(s, theta)
            ends = [
                (end - mean) * np.sqrt(precision) for end in (self.low[s.key], self.high[s.key])
            ]
            inside = np.exp(log_ndtr(ends[1])) - np.exp(log_ndtr(ends[0]))
            logs = logs + log_p + np.log(np.maximum(inside, 1e-300))
        return logs


class Posterior(Layout):
    """log p(theta | readings), of many theta at once.

    Parameters
    ----------
    likelihoods : one a test; tests of equal conditions share an emulator.
    known : (bodies,) shares of random wear that are known; anything where they are fitted.
    """

    def __init__(
        self, problem: Problem, likelihoods: list[EmulatedLikelihood], known: FloatArray
    ) -> None:
        super().__init__(problem)
        self.likelihoods, self.known = likelihoods, known

    @cached_property
    def _members(self) -> dict[int, list[int]]:
        """Numbers of tests by the identity of their emulator."""
        members: dict[int, list[int]] = {}
        for i, likelihood in enumerate(self.likelihoods):
            members.setdefault(id(likelihood.emulator), []).append(i)
        return members

    def holds(self, x: FloatArray) -> BoolArray:
        """Tell which unknowns (s, tests, m) are in the boxes of all emulators, (s,)."""
        parts = [
            self.likelihoods[tests[0]].emulator.holds(x[:, tests]).all(axis=1)
            for tests in self._members.values()
        ]
        inside: BoolArray = np.all(parts, axis=0)
        return inside

    def __call__(self, theta: FloatArray, power: float = 1.0) -> FloatArray:
        """Return log p (s,) of theta (s, d), the likelihood to a power; -inf out of the boxes."""
        logs = self.log_prior(theta)
        x = self.of_tests(theta)
        logs[~self.holds(x)] = -np.inf
        inside = np.isfinite(logs)
        if power and inside.any():
            logs[inside] += power * self.of_readings(
                x[inside], self.shares(theta[inside], self.known)
            )
        return logs

    def of_readings(self, x: FloatArray, shares: FloatArray) -> FloatArray:
        """Return log likelihoods (s,) at unknowns (s, tests, m) and shares (s, bodies)."""
        total = np.zeros(len(x))
        for tests in self._members.values():
            coordinates = self.likelihoods[tests[0]].emulator.coordinates(x[:, tests])
            for place, test in enumerate(tests):
                total += self.likelihoods[test](coordinates[:, place], shares)
        return total
