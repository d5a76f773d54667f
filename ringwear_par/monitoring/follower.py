"""What the readings of a running test say of its specimen: a fit's draws, weighed by them.

Readings weigh the draws by the likelihood of fits, at once or, where that would leave few, by one
power of it after another: after each, draws are made anew about those that are left, by
normal kernels that keep mean and covariance (Liu and West 2001, in Sequential Monte Carlo Methods
in Practice, 197-223). All of it starts from the draws before the test, whatever was asked before.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp, softmax

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import (
    Experiment,
    Problem,
    body_of_wear,
    records,
    reflected,
)
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

#: effective number of draws that is enough, and share of them; factor between powers that are tried
_ENOUGH, _SHARE, _LESS = 2000.0, 0.2, 0.8
#: draws in one go, and draws that growth times are judged by
_LOT, _JUDGED = 10_000, 64
#: number of new draws; width of their kernels over the best one of a normal density; variance that
#: they have along what is known exactly
_ANEW, _WIDTH = 20_000, 0.5
_EXACT = 1e-12


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

    def quantiles(self, values: FloatArray, probabilities: FloatArray) -> FloatArray:
        """Return quantiles of values (s,) of the draws."""
        order = np.argsort(values)
        centred = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
        between: FloatArray = np.interp(probabilities, centred, values[order])
        return between


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
        bodies = [body_of_wear(key) for key in problem.settings.process]
        x, sizes = draws.unknowns(of, count, np.random.default_rng(seed))
        self.m, self._seed, self.problem = x.shape[1], seed, problem
        self.histories = histories = Histories.of(readings, problem, x)
        # (bodies, 1 + r) at the end of the test
        depths = np.array([histories.at_steps(f"depth.{body}")[-1] for body in bodies])
        self._depths = depths.reshape(-1, len(histories.middle))
        #: (bodies,) mm, depths of the middle history at the end, of which shares are
        self.most = self._depths @ histories.middle
        every = np.column_stack([x, np.log(sizes[:, [BODIES.index(body) for body in bodies]])])
        every = every[histories.emulator.holds(x)]
        self.before = self._specimen(every, self._coordinates(every), np.zeros(len(every)))

    def _specimen(self, x: FloatArray, coordinates: FloatArray, logs: FloatArray) -> Specimen:
        weights = softmax(logs)
        rms = np.sqrt(weights @ self._shares(x, coordinates) ** 2)
        return Specimen(x, coordinates, weights, rms)

    def _coordinates(self, x: FloatArray) -> FloatArray:
        lots = np.array_split(x[:, : self.m], 1 + len(x) // _LOT)
        return np.concatenate([self.histories.emulator.coordinates(lot) for lot in lots])

    def _shares(self, x: FloatArray, coordinates: FloatArray) -> FloatArray:
        """Return the shares (s, bodies) of random wear: by its size, and the depth of the draw."""
        depths = np.maximum(self._depths[:, 0] + coordinates @ self._depths[:, 1:].T, 0.0)
        shares = np.sqrt(np.exp(x[:, self.m :]) * depths) / self.most
        return np.clip(shares, *np.exp(LOG_SHARES))

    def update(self, test: Experiment) -> Specimen:
        """Return the draws by the readings of a test."""
        specimen, loss = self.before, self.problem.settings.loss
        if not test.series:
            return specimen
        emulator, setting = self.histories.emulator_of(test), self.histories.setting_of(test, loss)
        specimen = self._weighed(test, setting, specimen)
        if needs_middle(self.problem):  # which these draws tell
            assert specimen.likelihood is not None
            some = specimen.chosen(_JUDGED) @ np.vstack([emulator.mean, emulator.modes])
            likelihood, middle = specimen.likelihood.likelihood, self.middle(specimen, test)
            times = likelihood.with_times_that_count(some).times
            setting = replace(likelihood.adapted(middle, loss), times=times)
            specimen = self._weighed(test, setting, specimen)
        return specimen

    def middle(self, specimen: Specimen, test: Experiment) -> FloatArray:
        """Return readings (n,) of a test by the mean history."""
        emulator = self.histories.emulator_of(test)
        return emulator.mean + specimen.weights @ specimen.coordinates @ emulator.modes

    def likelihood_like(self, specimen: Specimen, test: Experiment) -> TestLikelihood:
        """Return the likelihood of other readings: noise and growth times as of the specimen's."""
        setting, known = self.histories.setting_of(test, "gaussian"), {}
        if specimen.likelihood is not None:
            old = specimen.likelihood.likelihood
            for i, (s, part) in enumerate(records(old.test.series)):
                scale = float(np.median(old.setting.sd[part] / s.sd)) if s.sd_fitted else 1.0
                known[s.name] = scale, old.setting.times.get(i)
        sd = np.concatenate([known.get(s.name, (1.0,))[0] * s.sd for s in test.series])
        times = {
            i: known.get(test.series[i].name, (1.0, None))[1] or ends
            for i, ends in setting.times.items()
        }
        likelihood = TestLikelihood(test, replace(setting, sd=sd, times=times), specimen.shares)
        if self.problem.settings.loss == "gaussian":
            return likelihood
        adapted = likelihood.adapted(self.middle(specimen, test), self.problem.settings.loss)
        return TestLikelihood(test, adapted, specimen.shares)

    def _weighed(self, test: Experiment, setting: Setting, about: Specimen) -> Specimen:
        """Return the draws by a likelihood, whose noise is that about some others."""
        likelihood = EmulatedLikelihood(
            TestLikelihood(test, setting, about.shares), self.histories.emulator_of(test)
        )
        random = np.random.default_rng(self._seed + 1)
        x, coordinates = self.before.unknowns, self.before.coordinates
        left, redraws = 1.0, 0
        while True:
            lots = np.array_split(np.arange(len(x)), 1 + len(x) // _LOT)
            shares = self._shares(x, coordinates)
            log_p = np.concatenate([likelihood(coordinates[i], shares[i]) for i in lots])
            power, enough = left, min(_ENOUGH, _SHARE * len(x))
            while _effective(power * log_p) < enough:
                power *= _LESS
            if power == left:
                specimen = self._specimen(x, coordinates, power * log_p)
                return replace(specimen, likelihood=likelihood, redraws=redraws)
            left, redraws = left - power, redraws + 1
            x = self._made_anew(x, softmax(power * log_p), random)
            coordinates = self._coordinates(x)

    def _made_anew(
        self, x: FloatArray, weights: FloatArray, random: np.random.Generator
    ) -> FloatArray:
        """Return draws about weighed ones (s, m + bodies), which shrink to their mean before."""
        d = x.shape[1]
        mean, rows = weights @ x, random.choice(len(x), _ANEW, p=weights)
        covariance = np.cov(x.T, aweights=weights).reshape(d, d) + _EXACT * np.eye(d)
        width = _WIDTH * (weights @ weights) ** (1.0 / (4.0 + d))
        step = random.standard_normal((_ANEW, d)) @ np.linalg.cholesky(covariance).T
        x = mean + np.sqrt(1.0 - width**2) * (x[rows] - mean) + width * step
        x[:, : self.m] = reflected(x[:, : self.m], *self.problem.unknown_bounds)
        return x[self.histories.emulator.holds(x[:, : self.m])]


def _effective(logs: FloatArray) -> float:
    return float(np.exp(2.0 * logsumexp(logs) - logsumexp(2.0 * logs)))
