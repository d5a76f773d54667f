"""Each test of a fit at the mode and among the draws: model, band, residuals, nuisances.

Given the keys, nuisances, random wear and noise of the readings are normal together. With r = data
less model, P the inverse covariance of r (nuisances and random wear in it) and E that of the noise
alone, what they add to the model is r - E P r, with the covariance E - E P E. Given all others, a
reading is off its expectation by (P r)_i / P_ii, with the variance 1 / P_ii (Sundararajan and
Keerthi, Neural Comput. 13 (2001) 1103-1118).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import Experiment, Series
from ringwear_par.identification.likelihood import EmulatedLikelihood, TestLikelihood, sides
from ringwear_par.identification.noise import brownian_root, coloured, whitened

#: step of differences of log p, in the sd of an unknown given the others
_STEP = 0.5


class Part(NamedTuple):
    """Readings of a part of a test, see ``TestLikelihood``, each draw with its likeliest growth."""

    #: (n,) numbers of its readings
    rows: IntArray
    #: (n, s) P r, see above
    scores: FloatArray
    #: (n, s) P_ii, and (n, n) P with the growth that is likeliest of all
    information: FloatArray
    precision: FloatArray
    #: (s,) r' P r with the priors' squares, and its degrees of freedom
    squares: FloatArray
    freedom: float
    #: whether the sd of all its readings is given
    given: bool
    #: log of the determinant of the covariance of readings, nuisances known
    log_volume: float


def parts_at(likelihood: TestLikelihood, readings: FloatArray) -> list[Part]:
    """Return the parts of a test by readings (s, n) of the model."""
    parts = []
    by_node = likelihood.by_node(readings)
    for numbers, (noise, growth), logs in zip(
        likelihood.parts, likelihood.noises, by_node, strict=True
    ):
        white = noise(noise.data(likelihood.data[noise.rows])[:, None] - readings.T[noise.rows])
        every = np.eye(len(noise.rows))
        units, nodes = noise(every), logs.argmax(axis=0)
        taken = growth.directions(units, np.zeros(len(every)))
        along = growth.directions(white, np.ones(len(nodes)))[nodes, :, np.arange(len(nodes))]
        squares = growth.squares(white)[nodes, np.arange(len(nodes))]
        whole, likeliest = units.T @ units, taken[np.logaddexp.reduce(logs, axis=1).argmax()]
        less = np.square(taken).sum(axis=1)[nodes].T
        values = np.flatnonzero(sides(likelihood.test)[noise.rows] == 0.0)
        root = noise.white(every)[np.ix_(values, values)]
        parts.append(Part(
            noise.rows, units.T @ white - np.einsum("sgn,sg->ns", taken[nodes], along),
            np.diag(whole)[:, None] - less, whole - likeliest.T @ likeliest, squares,
            noise.freedom - growth.free,
            not any(likelihood.test.series[i].sd_fitted for i in numbers),
            -2.0 * float(np.linalg.slogdet(root)[1]) if len(values) else 0.0,
        ))  # fmt: skip
    return parts


def noisy(likelihood: TestLikelihood, white: FloatArray) -> FloatArray:
    """Return noise (n, ...) of a test's instruments by white noise."""
    rows, start, test = np.empty_like(white), 0, likelihood.test
    for series in test.series:
        part = slice(start, start + series.n)
        rows[part] = (coloured(series, white[part]).T * likelihood.setting.sd[part]).T
        start += series.n
    return rows


@dataclass(frozen=True, eq=False)
class FittedTest:
    """A test of a fit; arrays (n,) are of all its readings, in the program's units."""

    experiment: Experiment
    data: FloatArray
    #: noise: as given, or as fitted
    sd: FloatArray
    #: of the mode, without and with nuisances and random wear
    pure: FloatArray
    model: FloatArray
    #: sd of the model's readings among the draws
    band: FloatArray
    #: data less model over the noise, white; of limits the limit less the model
    residuals: FloatArray
    #: -1 where the true value is at most the reading, 1 where at least, else 0
    censored: FloatArray
    #: (n, bodies) mm, depth worn by chance beyond that of the law, and its sd
    excess: FloatArray
    excess_sd: FloatArray
    #: (n, bodies) mm, mean depth by the law
    depths: FloatArray
    #: sums of squares, with random wear and priors', at the mode and at the draws (s,), and their
    #: degrees of freedom
    squares: float
    drawn_squares: FloatArray
    freedom: float
    #: the latter two of readings whose noise is given
    tested_squares: FloatArray
    tested_freedom: float
    #: -2 log p of all readings at the mode, priors' squares included
    deviance: float
    #: number of nuisances and fitted noises
    n_fitted: int
    #: draws (s,) of nuisances by number of the series and kind, see ``nuisance_draws``
    nuisances: dict[tuple[int, str], FloatArray]
    growth_times: dict[int, FloatArray]

    @property
    def records(self) -> list[tuple[Series, slice]]:
        """Its series, and where their readings are."""
        ends = np.cumsum([0, *(series.n for series in self.experiment.series)]).tolist()
        places = map(slice, ends, ends[1:])
        return list(zip(self.experiment.series, places, strict=True))


def fitted_test(
    emulated: EmulatedLikelihood,
    best: FloatArray,
    x: FloatArray,
    depths: FloatArray,
    random: np.random.Generator,
) -> FittedTest:
    """Return a test of a fit.

    Parameters
    ----------
    best : (m,) unknowns of the mode.
    x : (s, m) of draws.
    depths : (bodies,) mm, see ``Solution``.
    """
    likelihood, n = emulated.likelihood, emulated.likelihood.test.n
    test, setting, side = likelihood.test, likelihood.setting, sides(likelihood.test)
    at_best, readings = emulated.emulator(best[None]), emulated.emulator(x)
    added, values, times = likelihood.nuisance_draws(readings, random)
    model = (at_best + likelihood.nuisance_draws(at_best)[0])[0]
    band = (readings + added).std(axis=0)
    noise, excess, excess_sd = noisy(likelihood, np.eye(n)), *np.zeros((2, n, len(depths)))
    squares, freedom, tested_freedom = 0.0, 0.0, 0.0
    drawn, tested = np.zeros((2, len(x)))
    deviance = -2.0 * float(likelihood.of_limits(at_best[:, likelihood.limits])[0])
    for mode, others in zip(
        parts_at(likelihood, at_best), parts_at(likelihood, readings), strict=True
    ):
        own, known = noise[np.ix_(mode.rows, mode.rows)], side[mode.rows] == 0.0
        rest = own @ (own.T @ np.concatenate([mode.scores, others.scores], axis=1))
        left = np.eye(len(own)) - own.T @ mode.precision @ own
        variance = ((own @ left) * own).sum(axis=1) + rest[:, 1:].var(axis=1)
        rows = mode.rows[known]
        model[rows] = likelihood.data[rows] - rest[known, 0]
        band[rows] = np.sqrt(np.maximum(variance[known], 0.0))
        for body, (slope, depth) in enumerate(setting.clocks):
            root = likelihood.shares[body] * brownian_root(depth)
            felt = slope[:, None] * root
            left = np.eye(n) - felt.T @ mode.precision @ felt
            variance = ((root @ left) * root).sum(axis=1)
            excess[:, body] = depths[body] * root @ (felt.T @ mode.scores[:, 0])
            excess_sd[:, body] = depths[body] * np.sqrt(np.maximum(variance, 0.0))
        deviance += float(mode.squares[0]) + mode.log_volume + len(rows) * np.log(2.0 * np.pi)
        squares, freedom = squares + float(mode.squares[0]), freedom + mode.freedom
        drawn += others.squares
        if mode.given:
            tested, tested_freedom = tested + others.squares, tested_freedom + mode.freedom
    sd = setting.sd.copy()
    residuals = (likelihood.data - model) / sd
    fitted = FittedTest(
        test, likelihood.data, sd, at_best[0], model, band, residuals, side, excess, excess_sd,
        depths * np.array([depth for _, depth in setting.clocks]).reshape(len(depths), n).T,
        squares, drawn, freedom, tested, tested_freedom, deviance,
        len(values) + len(times) + sum(series.sd_fitted for series in test.series), values, times,
    )  # fmt: skip
    for series, part in fitted.records:
        # the loss "student" has made the sd of outliers larger
        scale = float((sd[part] / series.sd).min()) if series.sd_fitted else 1.0
        sd[part] = scale * series.sd
        residuals[part] = (likelihood.data - model)[part] / sd[part]
        if not side[part].any():
            residuals[part] = whitened(series, residuals[part])
    return fitted


def readings_of_draws(
    emulated: EmulatedLikelihood, x: FloatArray, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return log p of each reading given all others of its test, and replicas, (s, n) both.

    By unknowns (s, m) of draws.
    """
    likelihood = emulated.likelihood
    readings, side = emulated.emulator(x), sides(likelihood.test)
    logs, limits = np.zeros_like(readings), likelihood.limits
    expected = readings + likelihood.setting.expected
    replicas = expected + noisy(likelihood, random.standard_normal(readings.shape[::-1])).T
    for part in parts_at(likelihood, readings):
        rows, values = part.rows, side[part.rows] == 0.0
        own = noisy(likelihood, np.eye(len(side)))[np.ix_(rows, rows)]
        information, scores = part.information[values], part.scores[values]
        there = 0.5 * (np.log(information / (2.0 * np.pi)) - scores**2 / information)
        logs[:, rows[values]] = there.T
        root = np.linalg.cholesky(2.0 * np.eye(len(own)) - own.T @ part.precision @ own)
        white = root @ random.standard_normal(part.scores.shape) - own.T @ part.scores
        replica = likelihood.data[rows, None] + own @ white
        replicas[:, rows[values]] = replica[values].T
    if len(limits):
        off = (expected - likelihood.data)[:, limits] / likelihood.setting.sd[limits]
        logs[:, limits] = log_ndtr(side[limits] * off)
    return logs, replicas


class LocalSquares(NamedTuple):
    """log p (s,) of a test, its slopes (s, q) and minus its curvatures (s, q, q)."""

    log_p: FloatArray
    score: FloatArray
    information: FloatArray


def local_squares(
    emulated: EmulatedLikelihood,
    x: FloatArray,
    shares: FloatArray,
    of: Sequence[int],
    sd: FloatArray,
) -> LocalSquares:
    """Return log p of a test as a quadratic form of some unknowns about x (s, m), by differences.

    Parameters
    ----------
    shares : (s, bodies) of random wear.
    of : numbers of the q unknowns.
    sd : (q,) of them, given the others.
    """
    q, step = len(of), _STEP * np.where(sd > 0.0, sd, 1e-6)

    def at(*moves: tuple[int, float]) -> FloatArray:
        moved = x.copy()
        for a, sign in moves:
            moved[:, of[a]] += sign * step[a]
        return emulated(emulated.emulator.coordinates(moved), shares)

    middle = at()
    up, down = (np.array([at((a, sign)) for a in range(q)]).T for sign in (1.0, -1.0))
    information = np.zeros((len(x), q, q))
    for a in range(q):
        information[:, a, a] = 2.0 * middle - up[:, a] - down[:, a]
        for b in range(a):
            both = up[:, a] + up[:, b] - middle - at((a, 1.0), (b, 1.0))
            information[:, a, b] = information[:, b, a] = both
    return LocalSquares(middle, (up - down) / (2.0 * step), information / np.outer(step, step))


def marginal_log_p(squares: LocalSquares, off: FloatArray, variances: FloatArray) -> FloatArray:
    """Return log p (s,) of a test whose own unknowns (s, q) are normal, integrated out.

    Parameters
    ----------
    off : (s, q) means of the unknowns less where the squares are.
    variances : (s, q) of the unknowns about them.
    """
    information = squares.information
    log_p = squares.log_p + np.einsum("si,si->s", squares.score, off)
    log_p -= 0.5 * np.einsum("si,sij,sj->s", off, information, off)
    slope = squares.score - np.einsum("sij,sj->si", information, off)
    system = np.eye(off.shape[1]) + information * variances[:, None, :]
    gain = np.linalg.solve(system, slope[:, :, None])[:, :, 0] * variances
    logs: FloatArray = log_p + 0.5 * np.einsum("si,si->s", slope, gain)
    return logs - 0.5 * np.linalg.slogdet(system)[1]
