"""How probable the readings of a test are at values of its keys.

Nuisances and random wear are integrated out (``noise``). What is left is, by an emulator, a
quadratic form in a few coordinates, one at each node of a growth time and of the share of random
wear: log p is summed over the former and interpolated between the latter. An sd that is to be
fitted is integrated out too (flat in its logarithm).
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.special import log_ndtr, logsumexp

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import GROWTH_TIME, Experiment, Loss, records
from ringwear_par.identification.emulator import Emulator
from ringwear_par.identification.noise import (
    Noise,
    Setting,
    drawn_nodes,
    sides,
    student_weights,
    whitened,
)

#: logarithms of the least and the largest share of random wear
LOG_SHARES = (float(np.log(1e-3)), 0.0)
#: nodes of each share by the number of bodies whose share is fitted
_SHARE_NODES = {0: 1, 1: 24, 2: 20}
#: growth times whose log likelihood is less than the largest by more count nowhere; points that
#: tell it
_COUNTS, _JUDGED = 15.0, 64


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
        numbers, joint = range(len(test.series)), bool(setting.clocks or setting.scales)
        apart = [
            i for i in numbers
            if not joint and (test.series[i].growth_time or test.series[i].sd_fitted)
        ]  # fmt: skip
        rest = [i for i in numbers if i not in apart]
        #: numbers of the series that are judged together
        self.parts = [*([rest] if rest else []), *([i] for i in apart)]
        #: noise of each part
        self.noises = self.noises_at(shares)

    def noises_at(self, shares: FloatArray) -> list[Noise]:
        """Return the noise of each part at shares (bodies,) of random wear."""
        return [Noise(self.test, part, self.setting, shares) for part in self.parts]

    def of_limits(self, readings: FloatArray) -> FloatArray:
        """Return log p (...) of the limits, by the model's readings (..., limits) there."""
        at = self.limits
        t = (readings + self.setting.expected[at] - self.data[at]) / self.setting.sd[at]
        logs: FloatArray = log_ndtr(self._side[at] * t).sum(axis=-1)
        return logs

    def _rows(self, noise: Noise, readings: FloatArray) -> FloatArray:
        """Return data less readings (P, n) of the model, as a part has them, (n of the part, P)."""
        return noise.data(self.data[noise.rows])[:, None] - readings.T[noise.rows]

    def _squares(self, readings: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield squares and log p (K, P) of each part at its growth times."""
        for noise in self.noises:
            squares = noise.squares(self._rows(noise, readings))
            yield squares, noise.log_constants[:, None] + noise.density(squares)

    def by_node(self, readings: FloatArray) -> list[FloatArray]:
        """Return log p (K, P) of each part at its growth times by readings (P, n) of the model."""
        return [logs for _, logs in self._squares(readings)]

    def least_squares(self, readings: FloatArray) -> FloatArray:
        """Return sums of squares (parts, P), those of priors too, at the likeliest growth times."""
        at = np.arange(len(readings))
        return np.array([q[logs.argmax(axis=0), at] for q, logs in self._squares(readings)])

    def __call__(self, readings: FloatArray) -> FloatArray:
        """Return log p (P,) by readings (P, n) of the model."""
        total = self.of_limits(readings[:, self.limits])
        for logs in self.by_node(readings):
            total = total + logsumexp(logs, axis=0)
        return total

    def nuisance_draws(
        self, readings: FloatArray, random: np.random.Generator | None = None
    ) -> tuple[FloatArray, dict[tuple[int, str], FloatArray]]:
        """Return nuisances by readings (P, n) of the model: a draw each, or else the best.

        What they add to the readings (P, n); and values (P,) by the series' number and kind, growth
        times (s) too, those of the calibrations of inputs, in their sd, by -1 and their number.
        """
        added = np.zeros_like(readings)
        values: dict[tuple[int, str], FloatArray] = {}
        for noise, logs in zip(self.noises, self.by_node(readings), strict=True):
            nodes = logs.argmax(axis=0) if random is None else drawn_nodes(logs, random)
            rows, owners = self._rows(noise, readings), noise.nuisances.owners
            explained, of_part = noise.explained(rows, nodes, random)
            added[:, noise.rows] = explained.T
            values.update(zip(owners, of_part, strict=True))
            times = noise.nuisances.times[nodes]
            values |= {(i, GROWTH_TIME): times for i, kind in owners if kind == "thermal"}
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
                white = whitened(series, rest) if len(rest) == series.n else rest
                # differences of neighbours hardly feel random wear
                squares = 0.5 * np.diff(white) ** 2 if self.setting.clocks else white**2
                scale = max(float(np.sqrt(np.mean(squares))), 1e-9)
                sd[whole], rest = sd[whole] * scale, rest / scale
            if loss == "student":
                if self.setting.clocks and len(rest) > 2:  # random wear is no outlier
                    rest[1:-1] -= 0.5 * (rest[:-2] + rest[2:])
                    rest[1:-1] /= np.sqrt(1.5)
                sd[rows] /= np.sqrt(student_weights(rest))
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
        self,
        likelihood: TestLikelihood,
        emulator: Emulator,
        fitted: Sequence[int] | None = None,
    ) -> None:
        self.likelihood, self.emulator = likelihood, emulator
        bodies = range(len(likelihood.setting.clocks))
        self._fitted = [i for i in bodies if fitted is None or i in fitted]
        self._count = _SHARE_NODES[len(self._fitted)]
        at, (low, high) = np.cos(np.pi * (np.arange(self._count) + 0.5) / self._count), LOG_SHARES
        weights = np.ones((1, 1))
        for _ in self._fitted:
            weights = np.kron(weights, np.linalg.inv(chebvander(at, self._count - 1)))
        every = []
        for chosen in itertools.product(at, repeat=len(self._fitted)):
            shares = likelihood.shares.copy()
            shares[self._fitted] = np.exp(low + 0.5 * (np.array(chosen) + 1.0) * (high - low))
            noises = likelihood.noises_at(shares) if self._fitted else likelihood.noises
            every.append([self._form(noise) for noise in noises])
        #: of each part, Chebyshev coefficients in the shares of constants, and below them of what
        #: products of (1, z) add to squares, (c, 1 + products, K)
        self._forms = [np.tensordot(weights, forms, 1) for forms in zip(*every, strict=True)]
        z = emulator.coordinates(emulator.box.design(_JUDGED))
        by_node = self._by_node(z, np.tile(likelihood.shares, (len(z), 1)))
        for part, logs in enumerate(by_node):
            counts = np.flatnonzero((logs - logs.max(axis=0)).max(axis=1) > -_COUNTS)
            kept = slice(max(counts[0] - 1, 0), counts[-1] + 2)
            self._forms[part] = self._forms[part][..., kept]

    def _form(self, noise: Noise) -> FloatArray:
        """Return constants, and what products of (1, z) add to squares, (1 + products, K)."""
        emulator, data = self.emulator, noise.data(self.likelihood.data[noise.rows])
        rows = np.column_stack([data - emulator.mean[noise.rows], -emulator.modes[:, noise.rows].T])
        grams = noise.grams(rows, np.eye(1, rows.shape[1])[0])
        i, j = np.triu_indices(rows.shape[1])
        return np.vstack([noise.log_constants, (grams[:, i, j] * (1.0 + (i != j))).T])

    def _by_node(self, coordinates: FloatArray, shares: FloatArray) -> list[FloatArray]:
        """Return log p (K, s) of each part at its growth times, see ``__call__``."""
        (low, high), terms = LOG_SHARES, np.ones((1, len(coordinates)))
        for column in np.log(shares[:, self._fitted]).T:
            more = chebvander(2.0 * (column - low) / (high - low) - 1.0, self._count - 1).T
            terms = (terms[:, None] * more).reshape(-1, len(column))
        v = np.insert(coordinates.T, 0, 1.0, axis=0)
        i, j = np.triu_indices(len(v))
        products, every = None, []
        for noise, form in zip(self.likelihood.noises, self._forms, strict=True):
            if form[:, 0].size == 1:  # without products, which many modes have many of
                triangle = np.zeros((len(v), len(v)))
                triangle[i, j] = form[0, 1:, 0]
                squares = np.einsum("is,is->s", triangle @ v, v)[None]
            else:
                products = v[i] * v[j] if products is None else products
                squares = np.tensordot(form[:, 1:], products, (1, 0))  # (c, K, s)
                squares = np.einsum("cks,cs->ks", squares, terms)
            every.append(form[:, 0].T @ terms + noise.density(squares))
        return every

    def __call__(self, coordinates: FloatArray, shares: FloatArray) -> FloatArray:
        """Return log p (s,) at coordinates (s, r) of the emulator and shares (s, bodies)."""
        emulator, at = self.emulator, self.likelihood.limits
        total = np.zeros(len(coordinates))
        for logs in self._by_node(coordinates, shares):
            total += logsumexp(logs, axis=0) if len(logs) > 1 else logs[0]
        if len(at):
            readings = emulator.mean[at] + coordinates @ emulator.modes[:, at]
            total += self.likelihood.of_limits(readings)
        return total
