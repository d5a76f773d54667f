"""How probable the readings of a test are at values of its keys.

Nuisances and random wear are integrated out (``noise``). What is left is, by an emulator, a
quadratic form in a few coordinates, one at each node of a growth time and of the share of random
wear: log p is summed over the former and interpolated between the latter. An sd that is to be
fitted is integrated out too (flat in its logarithm).
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from scipy.special import log_ndtr, logsumexp

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import Experiment, Loss, records
from ringwear_par.identification.emulator import Emulator
from ringwear_par.identification.noise import NU, STUDENT, Noise, Setting, sides, whitened

#: logarithms of the least and the largest share of random wear
LOG_SHARES = (float(np.log(1e-3)), 0.0)
#: nodes of each share by the number of bodies whose share is fitted
_SHARE_NODES = {0: 1, 1: 24, 2: 20}


class TestLikelihood:
    """log p(readings of a test | unknowns), by the readings of the model there.

    Readings of several series are judged together, but for those that grow thermally or have an sd
    that is fitted; random wear and the calibration of an input are felt by all.

    Parameters
    ----------
    shares : (bodies,) of random wear.
    """

    __test__ = False  # for pytest

    def __init__(self, test: Experiment, setting: Setting, shares: FloatArray) -> None:
        self.test, self.setting, self.shares = test, setting, shares
        self.data = np.concatenate([s.value for s in test.series])
        self._side = sides(test)
        self.limits = np.flatnonzero(self._side)
        joint, every = bool(setting.clocks or setting.scales), enumerate(test.series)
        apart = [i for i, s in every if not joint and (s.growth_time or s.sd_fitted)]
        rest = [i for i in range(len(test.series)) if i not in apart]
        parts = [part for part in (rest, *([i] for i in apart)) if part]
        #: of the series that are judged together
        self.noises = [Noise(test, part, setting, shares) for part in parts]

    def of_limits(self, readings: FloatArray) -> FloatArray:
        """Return log p (...) of the limits, by the model's readings (..., limits) there."""
        at = self.limits
        t = (readings + self.setting.expected[at] - self.data[at]) / self.setting.sd[at]
        logs: FloatArray = log_ndtr(self._side[at] * t).sum(axis=-1)
        return logs

    def _parts(self, readings: FloatArray) -> list[tuple[Noise, FloatArray]]:
        """Return the noise of each part, and its data less readings (P, n) of the model, (n, P)."""
        return [(of, self.data[of.rows, None] - readings.T[of.rows]) for of in self.noises]

    def least_squares(self, readings: FloatArray) -> FloatArray:
        """Return sums of squares (parts, P), those of priors too, at the likeliest growth times."""
        parts = [noise.reduced(rows) for noise, rows in self._parts(readings)]
        at = np.arange(len(readings))
        return np.array([of.squares()[of.log_p().argmax(axis=0), at] for of in parts])

    def __call__(self, readings: FloatArray) -> FloatArray:
        """Return log p (P,) by readings (P, n) of the model."""
        total = self.of_limits(readings[:, self.limits])
        for noise, rows in self._parts(readings):
            total = total + logsumexp(noise.reduced(rows).log_p(), axis=0)
        return total

    def nuisance_draws(
        self, readings: FloatArray, random: np.random.Generator | None = None
    ) -> tuple[FloatArray, dict[tuple[int, str], FloatArray]]:
        """Return nuisances by readings (P, n) of the model: a draw each, or else the best.

        What they add to the readings (P, n), and values (P,) by the series' number and kind, growth
        times (s) too; those of the calibrations of inputs, in their sd, by -1 and their number.
        """
        added = np.zeros_like(readings)
        values: dict[tuple[int, str], FloatArray] = {}
        for noise, rows in self._parts(readings):
            of_part, more = noise.explained(rows, random)
            added[:, noise.rows] = of_part.T
            values |= more
        return added, values

    def adapted(self, readings: FloatArray, loss: Loss) -> Setting:
        """Return the setting about readings (n,) of the model: sd and nuisances.

        An sd that is fitted becomes that of the residuals; weights of the loss "student" are in the
        sd.
        """
        expected = self.nuisance_draws(readings[None])[0][0]
        sd = np.concatenate([series.sd for series in self.test.series])
        for series, whole in records(self.test.series):
            rows = whole.start + np.flatnonzero(self._side[whole] == 0.0)
            rest = (self.data - readings - expected)[rows] / sd[rows]
            if series.sd_fitted and len(rest) > 2:
                white = whitened(series, rest)
                # differences of neighbours hardly feel random wear
                variances = 0.5 * np.diff(white) ** 2 if self.setting.clocks else white**2
                scale = max(float(np.sqrt(np.mean(variances))), 1e-9)
                sd[whole], rest = sd[whole] * scale, rest / scale
            if loss == "student":
                if self.setting.clocks and len(rest) > 2:  # random wear is no outlier
                    rest[1:-1] -= 0.5 * (rest[:-2] + rest[2:])
                    rest[1:-1] /= np.sqrt(1.5)
                # as in the steps of least squares, over their Fisher information
                sd[rows] *= np.sqrt((NU + rest**2) / (NU + 1.0) / STUDENT)
        return replace(self.setting, sd=sd, expected=expected)


class EmulatedLikelihood:
    """log p(readings of a test | unknowns, shares of random wear), by an emulator.

    Parameters
    ----------
    likelihood : of the test.
    emulator : of its readings.
    fitted : numbers of the bodies whose share of random wear differs between draws; None: of all.
    """

    def __init__(
        self, likelihood: TestLikelihood, emulator: Emulator, fitted: Sequence[int] | None = None
    ) -> None:
        self.likelihood, self.emulator = likelihood, emulator
        bodies = range(len(likelihood.setting.clocks))
        self._fitted = [i for i in bodies if fitted is None or i in fitted]
        count, (low, high) = _SHARE_NODES[len(self._fitted)], LOG_SHARES
        at = chebpts1(count)
        self._chebyshev = np.linalg.inv(chebvander(at, count - 1)).T
        rows = np.vstack([likelihood.data - emulator.mean, -emulator.modes]).T
        of_data, nodes = np.eye(1, rows.shape[1])[0], []
        for chosen in itertools.product(at, repeat=len(self._fitted)):
            shares = likelihood.shares.copy()
            shares[self._fitted] = np.exp(low + 0.5 * (np.array(chosen) + 1.0) * (high - low))
            noises = TestLikelihood(likelihood.test, likelihood.setting, shares).noises
            nodes.append([noise.reduced(rows[noise.rows], of_data) for noise in noises])
        if self._fitted:
            #: constants and squares of all series, which are one part then, at c nodes of shares,
            #: (c, K) and (c, K, q, q)
            self._constants = np.array([of.log_constants for of, *_ in nodes])
            self._grams = np.array([of.grams() for of, *_ in nodes])
        else:
            #: what log p of each part takes from readings by (1, z)
            self._parts = [of._replace(rest=np.linalg.qr(of.rest)[1]) for of in nodes[0]]

    def __call__(self, coordinates: FloatArray, shares: FloatArray) -> FloatArray:
        """Return log p (s,) at coordinates (s, r) of the emulator and shares (s, bodies)."""
        (low, high), weights = LOG_SHARES, np.ones((1, len(coordinates)))
        for column in np.log(shares[:, self._fitted]).T:
            orders = chebvander(2.0 * (column - low) / (high - low) - 1.0, len(self._chebyshev) - 1)
            more = self._chebyshev @ orders.T
            weights = (weights[:, None] * more).reshape(len(weights) * len(more), -1)
        v = np.insert(coordinates.T, 0, 1.0, axis=0)
        if self._fitted:
            squares = np.tensordot(self._grams, v[:, None] * v, 2)
            squares = np.einsum("cks,cs->ks", squares, weights)
            parts = [self._constants.T @ weights - 0.5 * squares]
        else:
            parts = [part.combined(v).log_p() for part in self._parts]
        at = self.likelihood.limits
        readings = self.emulator.mean[at] + coordinates @ self.emulator.modes[:, at]
        return sum((logsumexp(p, axis=0) for p in parts), self.likelihood.of_limits(readings))
