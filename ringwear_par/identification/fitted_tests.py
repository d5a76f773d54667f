"""Each test of a fit at the mode and among the draws: model, band, residuals, nuisances.

Given the keys, nuisances, random wear and noise of the readings are normal together. With r = data
less model, P the inverse covariance of r (nuisances and random wear in it) and E that of the noise
alone, what they add to the model is r - E P r, with the covariance E - E P E. Given all others, a
reading is off its expectation by (P r)_i / P_ii, with the variance 1 / P_ii (Sundararajan and
Keerthi, Neural Comput. 13 (2001) 1103-1118).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr
from scipy.stats import norm, qmc

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.problem import Experiment, Series, records
from ringwear_par.identification.likelihood import EmulatedLikelihood, TestLikelihood, sides
from ringwear_par.identification.noise import coloured, whitened
from ringwear_par.identification.posterior import Posterior

#: step of differences of log p, in the sd of an unknown
_STEP = 0.02
#: values of the next specimen over which the likelihood of a test is averaged
_SPECIMENS = 64
#: sd of these about the draws, over that of what is left open
_WIDER = 2.0


class Explained(NamedTuple):
    """What the readings of a test tell beside those (P, n) of the model, see above."""

    #: (n, P) P r and P_ii, each with its likeliest growth; 0 of limits
    scores: FloatArray
    diagonal: FloatArray
    #: (n, n) P with the growth that is likeliest of all
    precision: FloatArray
    #: (parts, P) r' P r with the squares of priors, see ``TestLikelihood.parts``
    squares: FloatArray


def explained(likelihood: TestLikelihood, readings: FloatArray) -> Explained:
    """Return what the readings of a test tell beside those (P, n) of the model."""
    n, each = likelihood.test.n, np.arange(len(readings))
    scores, diagonal = np.zeros((2, n, len(readings)))
    precision, squares = np.zeros((n, n)), []
    for (noise, growth), logs in zip(likelihood.noises, likelihood.by_node(readings), strict=True):
        rows, nodes = noise.rows, logs.argmax(axis=0)
        white = noise(noise.data(likelihood.data[rows])[:, None] - readings.T[rows])
        units = noise(np.eye(len(rows)))
        taken = growth.directions(units, np.zeros(len(rows)))
        along = growth.directions(white, np.ones(len(each)))[nodes, :, each]
        scores[rows] = units.T @ white - np.einsum("sgn,sg->ns", taken[nodes], along)
        less = np.square(taken).sum(axis=1)[nodes].T
        diagonal[rows] = np.square(units).sum(axis=0)[:, None] - less
        likeliest = taken[np.logaddexp.reduce(logs, axis=1).argmax()]
        precision[np.ix_(rows, rows)] = units.T @ units - likeliest.T @ likeliest
        squares.append(growth.squares(white)[nodes, each])
    return Explained(scores, diagonal, precision, np.array(squares))


def noise_root(likelihood: TestLikelihood) -> FloatArray:
    """Return L (n, n) whose L L' is the covariance of the noise of a test's instruments."""
    root = np.eye(likelihood.test.n)
    for series, part in records(likelihood.test.series):
        root[part] = coloured(series, root[part])
    return likelihood.setting.sd[:, None] * root


@dataclass(frozen=True, eq=False)
class FittedTest:
    """A test of a fit; arrays (n,) are of all its readings, in the program's units."""

    experiment: Experiment
    data: FloatArray
    #: noise: as given, or as fitted
    sd: FloatArray
    #: of the mode, with nuisances and random wear
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
    #: (parts, 1 + s) sums of squares, with random wear and priors', at the mode and at draws
    squares: FloatArray
    #: (parts,) their degrees of freedom, and whether the sd of all their readings is given
    freedom: FloatArray
    given: BoolArray
    #: draws (s,) of nuisances by number of the series and kind, see ``nuisance_draws``
    nuisances: dict[tuple[int, str], FloatArray]
    growth_times: dict[int, FloatArray]

    @property
    def records(self) -> list[tuple[Series, slice]]:
        """Its series, and where their readings are."""
        return records(self.experiment.series)


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
    likelihood, test = emulated.likelihood, emulated.likelihood.test
    at_best, readings = emulated.emulator(best[None]), emulated.emulator(x)
    side, root = sides(test), noise_root(likelihood)
    found = explained(likelihood, np.concatenate([at_best, readings]))
    noise = root @ (root.T @ found.scores)
    known = ((root @ (np.eye(test.n) - root.T @ found.precision @ root)) * root).sum(axis=1)
    added, values, times = likelihood.nuisance_draws(readings, random)
    of_limits = at_best[0] + likelihood.nuisance_draws(at_best)[0][0]
    model = np.where(side == 0.0, likelihood.data - noise[:, 0], of_limits)
    spread = np.maximum(known + noise[:, 1:].var(axis=1), 0.0)
    band = np.sqrt(np.where(side == 0.0, spread, (readings + added).var(axis=0)))
    excess, excess_sd = np.zeros((2, test.n, len(depths)))
    for body, (slope, depth) in enumerate(likelihood.setting.clocks):
        wear = (likelihood.shares[body] * depths[body]) ** 2 * np.minimum.outer(depth, depth)
        felt = wear * slope / depths[body]
        excess[:, body] = felt @ found.scores[:, 0]
        left = np.diag(wear) - ((felt @ found.precision) * felt).sum(axis=1)
        excess_sd[:, body] = np.sqrt(np.maximum(left, 0.0))
    freedom = [noise.freedom - growth.free for noise, growth in likelihood.noises]
    given = [not any(test.series[i].sd_fitted for i in part) for part in likelihood.parts]
    sd, residuals = _residuals(likelihood, model)
    return FittedTest(
        test, likelihood.data, sd, model, band, residuals, side, excess, excess_sd, found.squares,
        np.array(freedom), np.array(given), values, times,
    )  # fmt: skip


def _residuals(likelihood: TestLikelihood, model: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the noise (n,) of readings, and data less model over it, white."""
    sd, off = likelihood.setting.sd.copy(), likelihood.data - model
    for series, part in records(likelihood.test.series):
        # the loss "student" has made the sd of outliers larger
        scale = float((sd[part] / series.sd).min()) if series.sd_fitted else 1.0
        sd[part] = scale * series.sd
        off[part] /= sd[part]
        if series.censored is None:
            off[part] = whitened(series, off[part])
    return sd, off


def readings_of_draws(
    emulated: EmulatedLikelihood, x: FloatArray, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return log p of each reading given all others of its test, and replicas, (s, n) both.

    By unknowns (s, m) of draws.
    """
    likelihood, readings = emulated.likelihood, emulated.emulator(x)
    side, root = sides(likelihood.test), noise_root(likelihood)
    values, limits = np.flatnonzero(side == 0.0), likelihood.limits
    found = explained(likelihood, readings)
    scores, diagonal = found.scores[values], found.diagonal[values]
    logs = np.zeros_like(readings)
    logs[:, values] = 0.5 * (np.log(diagonal / (2.0 * np.pi)) - scores**2 / diagonal).T
    noise = random.standard_normal(readings.T.shape)
    spread = np.linalg.cholesky(2.0 * np.eye(len(side)) - root.T @ found.precision @ root)
    replicas = (likelihood.data[:, None] + root @ (spread @ noise - root.T @ found.scores)).T
    if len(limits):
        expected = (readings + likelihood.setting.expected)[:, limits]
        replicas[:, limits] = expected + (root @ noise).T[:, limits]
        off = (expected - likelihood.data[limits]) / likelihood.setting.sd[limits]
        logs[:, limits] = log_ndtr(side[limits] * off)
    return logs, replicas


def scores_and_information(
    emulated: EmulatedLikelihood, x: FloatArray, shares: FloatArray, sd: FloatArray
) -> FloatArray:
    """Return slopes of log p of a test by each unknown, and minus its curvatures, (2, m).

    Parameters
    ----------
    x : (m,) unknowns.
    shares : (bodies,) of random wear.
    sd : (m,) of the unknowns.
    """
    m, step = len(x), _STEP * np.where(sd > 0.0, sd, 1e-6)
    points = x + np.concatenate([np.zeros((1, m)), np.diag(step), -np.diag(step)])
    coordinates = emulated.emulator.coordinates(points)
    middle, up, down = np.split(
        emulated(coordinates, np.tile(shares, (len(points), 1))), [1, m + 1]
    )
    return np.array([(up - down) / (2.0 * step), (2.0 * middle - up - down) / step**2])


def log_p_of_tests(
    posterior: Posterior, x: FloatArray, material: FloatArray, sd: FloatArray, shares: FloatArray
) -> FloatArray:
    """Return log p (s, tests) of the readings of each test, whatever its own values are.

    The likelihood is averaged over values that the next specimen may have, drawn about those of
    each draw by what the keys that do not scatter leave open.

    Parameters
    ----------
    x : (s, tests, m) unknowns of draws; material: (s, m) of the material.
    sd : (s, m) between specimens; 0 of keys that do not scatter.
    shares : (s, bodies) of random wear.
    """
    keys = [s.key for s in posterior.scatterings]
    normal = norm.ppf(qmc.Sobol(len(keys), seed=0).random(_SPECIMENS))
    logs = np.empty((len(x), len(posterior.likelihoods)))
    for i, emulated in enumerate(posterior.likelihoods):
        own, others = x[:, i, keys], np.delete(x[:, i], keys, axis=1)
        others = np.column_stack([np.ones(len(x)), others])
        centre = others @ np.linalg.lstsq(others, own, rcond=None)[0]
        root = _WIDER * np.linalg.cholesky(np.atleast_2d(np.cov((own - centre).T)))
        volume = float(np.log(np.diag(root)).sum())
        each = []
        for z in normal:
            points = x[:, i].copy()
            points[:, keys] += root @ z
            off = (points - material)[:, keys] / sd[:, keys]
            prior = -0.5 * np.square(off).sum(axis=1) - np.log(sd[:, keys]).sum(axis=1)
            log_p = emulated(emulated.emulator.coordinates(points), shares)
            log_p = np.where(emulated.emulator.holds(points), log_p, -np.inf)
            each.append(log_p + prior + 0.5 * float(z @ z) + volume)
        logs[:, i] = np.logaddexp.reduce(each, axis=0) - np.log(_SPECIMENS)
    return logs
