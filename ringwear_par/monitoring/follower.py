"""What the readings of a running test say of its specimen: a fit's draws, weighed by them.

Readings weigh the draws by the likelihood of fits. Where few draws are left, they are made anew
about those that a power of the likelihood leaves, whose own density stands for the prior there
(population Monte Carlo: Cappe, Guillin, Marin and Robert, J. Comput. Graph. Stat. 13 (2004)
907-929). All of it starts from the draws before the test, whatever was asked before.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import Experiment, Problem, body_of_wear
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.likelihood import (
    LOG_SHARES,
    EmulatedLikelihood,
    Setting,
    TestLikelihood,
)
from ringwear_par.identification.setting import needs_middle
from ringwear_par.monitoring.histories import Histories

#: draws that are tried at first, and in one go; effective number that is enough
_SOME, _ENOUGH = 10_000, 2000.0
#: most rounds of new draws, their number, the share of them that is enough and that a power of the
#: likelihood leaves, and the number of kernels of the prior's density
_ROUNDS, _REDRAWN, _SHARE, _TEMPERED, _KERNELS = 12, 5000, 0.2, 0.4, 1500
#: of new draws: degrees of freedom, and factor of their covariance
_DEGREES, _WIDER = 8.0, 1.3
#: most settings that are tried, and draws that growth times are judged by
_SETTINGS, _JUDGED = 4, 64
#: part of the box of histories that is at its edges
_EDGE = 0.97


@dataclass(frozen=True, eq=False)
class Specimen:
    """Draws (s,) of the keys of the specimen under test, by its readings."""

    #: (s, m + bodies) unknowns, and logarithms of the sizes of random wear
    unknowns: FloatArray
    #: (s, r) of their histories
    coordinates: FloatArray
    #: (s,) which sum to 1
    weights: FloatArray
    #: (bodies,) rms share of random wear
    shares: FloatArray
    #: None before any reading
    likelihood: EmulatedLikelihood | None = None
    #: logarithm of the probability density of the readings, but for a constant of theirs
    log_evidence: float = 0.0
    #: how often the draws were made anew
    redraws: int = 0

    @property
    def effective(self) -> float:
        """How many draws of equal weights they are worth."""
        return float(1.0 / (self.weights @ self.weights))

    def chosen(self, count: int) -> FloatArray:
        """Return 1 and the coordinates, (count, 1 + r), of draws as often as they weigh."""
        rows = np.random.default_rng(count).choice(len(self.weights), count, p=self.weights)
        return np.column_stack([np.ones(count), self.coordinates[rows]])

    @property
    def middle(self) -> FloatArray:
        """Readings (n,) of the mean history."""
        assert self.likelihood is not None
        emulator = self.likelihood.emulator
        return emulator.mean + self.weights @ self.coordinates @ emulator.modes


class Follower:
    """What is known of the specimen of a running test, at any of its readings.

    On the first rank, within ``Readings.lead``.

    Parameters
    ----------
    draws : of the fit before.
    of : the next specimen, or one of the fit's.
    problem : of the running test.
    count, seed : number of draws, and their seed.
    """

    def __init__(
        self, draws: Draws, of: str, problem: Problem, readings: Readings, count: int, seed: int
    ) -> None:
        bodies = [BODIES.index(body_of_wear(key)) for key in problem.settings.process]
        x, sizes = draws.unknowns(of, count, np.random.default_rng(seed))
        self.m, self._seed, self._readings = x.shape[1], seed, readings
        self._unknowns = np.column_stack([x, np.log(sizes[:, bodies])])
        self.prepare(problem)

    def suits(self, problem: Problem) -> bool:
        """Tell whether the histories are of a problem's case, and have all that is read of it."""
        (test,), (before,) = problem.experiments, self.problem.experiments
        return before.case.text == test.case.text and self.histories.suits(test)

    def prepare(self, problem: Problem) -> None:
        """Compute histories: at first, and for profiles and measured inputs that are new."""
        self.problem = problem
        histories = Histories.of(self._readings, problem, self._unknowns[:, : self.m])
        self.histories = histories
        bodies = [f"depth.{body_of_wear(key)}" for key in problem.settings.process]
        # (bodies, 1 + r) at the end of the test
        depths = np.array([histories.at_steps(body)[-1] for body in bodies])
        self._depths = depths.reshape(-1, len(histories.middle))
        #: (bodies,) mm, depths of the middle history at the end, of which shares are
        self.most = self._depths @ histories.middle
        x = self._unknowns[histories.emulator.holds(self._unknowns[:, : self.m])]
        lots = np.array_split(x[:, : self.m], 1 + len(x) // _SOME)
        coordinates = np.concatenate([histories.emulator.coordinates(lot) for lot in lots])
        self.before = self._specimen(x, coordinates, np.zeros(len(x)))

    def _specimen(self, x: FloatArray, coordinates: FloatArray, logs: FloatArray) -> Specimen:
        weights = _normalised(logs)
        rms = np.sqrt(weights @ self._shares(x, coordinates) ** 2)
        return Specimen(x, coordinates, weights, rms)

    def _shares(self, x: FloatArray, coordinates: FloatArray) -> FloatArray:
        """Return the shares (s, bodies) of random wear: by its size, and the depth of the draw."""
        depths = np.maximum(self._depths[:, 0] + coordinates @ self._depths[:, 1:].T, 0.0)
        shares = np.sqrt(np.exp(x[:, self.m :]) * depths) / self.most
        return np.clip(shares, *np.exp(LOG_SHARES))

    def at_edges(self, found: Specimen) -> float:
        """Return the share of the draws that are at edges of the box of histories."""
        inside = self.histories.emulator.box.inside(found.unknowns[:, : self.m])
        return float(found.weights @ (np.abs(inside) > _EDGE).any(axis=1))

    def update(self, test: Experiment) -> Specimen:
        """Return the draws by the readings of a test."""
        if not test.series:
            return self.before
        loss, found = self.problem.settings.loss, self.before
        emulator = self.histories.emulator_of(test)
        setting = self.histories.setting_of(test, loss)
        for number in range(_SETTINGS if needs_middle(self.problem) else 1):
            likelihood = TestLikelihood(test, setting, found.shares)
            if number:  # which the last draws tell
                some = found.chosen(_JUDGED) @ np.vstack([emulator.mean, emulator.modes])
                times = likelihood.with_times_that_count(some).times
                old, setting = setting, likelihood.adapted(found.middle, loss)
                setting = replace(setting, times=times)
                if _is_close(old, setting, test):
                    break
                likelihood = TestLikelihood(test, setting, found.shares)
            found = self._weighed(EmulatedLikelihood(likelihood, emulator))
        return found

    def setting_like(self, found: Specimen, test: Experiment) -> Setting:
        """Return the setting of a test with other readings: noise and growth times as was found."""
        setting = self.histories.setting_of(test, "gaussian")
        if found.likelihood is None:
            return setting
        old, start, known = found.likelihood.likelihood, 0, {}
        for i, series in enumerate(old.test.series):
            scale = np.median(old.setting.sd[start : start + series.n] / series.sd)
            known[series.name] = scale if series.sd_fitted else 1.0, old.setting.times.get(i)
            start += series.n
        names = [series.name for series in test.series]
        sd = [known.get(series.name, (1.0,))[0] * series.sd for series in test.series]
        times = {i: known.get(names[i], (0, ends))[1] or ends for i, ends in setting.times.items()}
        setting = replace(setting, sd=np.concatenate(sd), times=times)
        if self.problem.settings.loss == "gaussian":
            return setting
        emulator = self.histories.emulator_of(test)
        middle = emulator.mean + found.weights @ found.coordinates @ emulator.modes
        likelihood = TestLikelihood(test, setting, found.shares)
        return likelihood.adapted(middle, self.problem.settings.loss)

    def _log_p(
        self, likelihood: EmulatedLikelihood, x: FloatArray, coordinates: FloatArray
    ) -> FloatArray:
        """Return the logarithm (s,) of the likelihood of draws (s, m + bodies)."""
        lots = np.array_split(np.arange(len(x)), 1 + len(x) // _SOME)
        parts = [likelihood(coordinates[i], self._shares(x[i], coordinates[i])) for i in lots]
        return np.concatenate(parts)

    def _weighed(self, likelihood: EmulatedLikelihood) -> Specimen:
        """Return the draws by a likelihood, made anew where few are left."""
        random, before = np.random.default_rng(self._seed + 1), self.before
        for count in (_SOME, 3 * _SOME, len(before.unknowns)):
            x, coordinates = before.unknowns[:count], before.coordinates[:count]
            log_l = self._log_p(likelihood, x, coordinates)
            if _effective(log_l) >= _ENOUGH:
                break
        # of the prior over the density that the draws are of, in logarithms
        ratio, redraws, enough = np.zeros(len(x)), 0, min(_ENOUGH, _SHARE * len(x))
        number = len(x)
        while redraws < _ROUNDS and _effective(ratio + log_l) < enough:
            tempered = _power(ratio, log_l, min(2.0 * _ENOUGH, _TEMPERED * len(x)))
            w = _normalised(ratio + tempered * log_l)
            if not redraws:
                power, prior = tempered, _Kernels.of(x, w, random)
                scale = logsumexp(power * log_l) - np.log(len(x))
            mean, covariance = _moments(x, w)
            proposal = multivariate_t(mean, _WIDER * covariance, _DEGREES)
            x = proposal.rvs(_REDRAWN, random).reshape(_REDRAWN, -1)
            x = x[self.histories.emulator.holds(x[:, : self.m])]
            coordinates = self.histories.emulator.coordinates(x[:, : self.m])
            log_l = self._log_p(likelihood, x, coordinates)
            ratio = prior(x) + scale - power * log_l - proposal.logpdf(x)
            redraws, number, enough = redraws + 1, _REDRAWN, _SHARE * _REDRAWN
        evidence = float(logsumexp(ratio + log_l) - np.log(number))
        return replace(
            self._specimen(x, coordinates, ratio + log_l),
            likelihood=likelihood, log_evidence=evidence, redraws=redraws,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Kernels:
    """A density of normal kernels, which has the mean and the covariance of its draws."""

    root: FloatArray
    #: (kernels, d) in units of the root
    centres: FloatArray
    width: float

    @classmethod
    def of(cls, x: FloatArray, weights: FloatArray, random: np.random.Generator) -> "_Kernels":
        """Return the density of weighed draws (s, d), which shrink to their mean by its width."""
        mean, covariance = _moments(x, weights)
        root = np.linalg.cholesky(covariance)
        at = (np.arange(_KERNELS) + random.random()) / _KERNELS
        rows = np.minimum(np.searchsorted(np.cumsum(weights), at), len(x) - 1)
        centres = np.linalg.solve(root, (x[rows] - mean).T).T
        width = _KERNELS ** (-1.0 / (4.0 + x.shape[1]))
        middle = np.linalg.solve(root, mean)
        return cls(root, middle + np.sqrt(1.0 - width**2) * centres, width)

    def __call__(self, x: FloatArray) -> FloatArray:
        """Return the logarithm of the density at x (s, d)."""
        squares = cdist(np.linalg.solve(self.root, x.T).T, self.centres, "sqeuclidean")
        logs: FloatArray = logsumexp(-0.5 * squares / self.width**2, axis=1) - np.log(_KERNELS)
        constant = x.shape[1] * (0.5 * np.log(2.0 * np.pi) + np.log(self.width))
        return logs - constant - np.log(np.diag(self.root)).sum()


def _normalised(logs: FloatArray) -> FloatArray:
    weights: FloatArray = np.exp(logs - logsumexp(logs))
    return weights


def _effective(logs: FloatArray) -> float:
    return float(np.exp(2.0 * logsumexp(logs) - logsumexp(2.0 * logs)))


def _power(ratio: FloatArray, log_l: FloatArray, wanted: float) -> float:
    """Return the power of the likelihood that leaves an effective number of draws."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        enough = _effective(ratio + middle * log_l) >= wanted
        low, high = (middle, high) if enough else (low, middle)
    return low


def _moments(x: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (d,) and covariance (d, d) of weighed draws; sizes may be known exactly."""
    mean = weights @ x
    covariance = (weights[:, None] * (x - mean)).T @ (x - mean)
    return mean, covariance + 1e-12 * np.eye(len(mean))


def _is_close(old: Setting, new: Setting, test: Experiment) -> bool:
    """Tell whether likelihoods do not differ by their settings."""
    times = all(np.diff(new.times[i])[0] > 0.7 * np.diff(ends)[0] for i, ends in old.times.items())
    limits = any(series.censored is not None for series in test.series)
    moved = np.abs(new.expected - old.expected) / new.sd if limits else np.zeros(1)
    return times and bool(np.abs(np.log(new.sd / old.sd)).max() < 0.02 and moved.max() < 0.05)
