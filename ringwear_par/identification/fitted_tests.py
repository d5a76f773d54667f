"""Each test of a fit at the mode and among the draws: model, band, residuals, nuisances."""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.problem import Experiment, Series, records
from ringwear_par.identification.likelihood import EmulatedLikelihood, TestLikelihood
from ringwear_par.identification.noise import coloured, log_volumes, sides, whitened

#: step of differences of log p, in the sd of an unknown
_STEP = 0.02


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
    model, excess, _, _ = _with_all(likelihood, at_best)
    models, drawn, values, times = _with_all(likelihood, readings, random)
    sd, off = likelihood.setting.sd.copy(), likelihood.data - model[0]
    for series, part in records(test.series):
        # the loss "student" has made the sd of outliers larger
        scale = float((sd[part] / series.sd).min()) if series.sd_fitted else 1.0
        sd[part] = scale * series.sd
        off[part] /= sd[part]
        if series.censored is None:
            off[part] = whitened(series, off[part])
    squares = likelihood.least_squares(np.concatenate([at_best, readings]))
    freedom = [noise.freedom for noise in likelihood.noises]
    given = [not any(test.series[i].sd_fitted for i in part) for part in likelihood.parts]
    return FittedTest(
        test, likelihood.data, sd, model[0], models.std(axis=0), off, sides(test),
        excess[0] * depths, drawn.std(axis=0) * depths, squares, np.array(freedom),
        np.array(given), values, times,
    )  # fmt: skip


def _with_all(
    likelihood: TestLikelihood, readings: FloatArray, random: np.random.Generator | None = None
) -> tuple[FloatArray, FloatArray, dict[tuple[int, str], FloatArray], dict[int, FloatArray]]:
    """Return readings (P, n) of the model with nuisances and random wear: draws, or the best ones.

    Also return what is worn by chance (P, n, bodies) over the largest depth, and nuisances and
    growth times, see ``TestLikelihood.nuisance_draws``.
    """
    added, values, times = likelihood.nuisance_draws(readings, random)
    models, clocks = readings + added, likelihood.setting.clocks
    if not clocks:
        return models, np.zeros((*models.shape, 0)), values, times
    (noise,) = likelihood.noises
    worn = noise.random_wear((likelihood.data - models).T, random).T
    felt = np.stack([slope for slope, _ in clocks], axis=1)
    return models + (worn * felt).sum(axis=2), worn, values, times


def readings_of_draws(
    emulated: EmulatedLikelihood, x: FloatArray, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return log p of each reading, by those before where noise is correlated, and replicas.

    Both are (s, n), at unknowns (s, m) of draws; nuisances and random wear are drawn beside them.
    """
    likelihood, test = emulated.likelihood, emulated.likelihood.test
    models = _with_all(likelihood, emulated.emulator(x), random)[0]
    sd, side = likelihood.setting.sd, sides(test)
    off = (likelihood.data - models) / sd
    logs, replicas = log_ndtr(-side * off), np.empty_like(models)
    for series, part in records(test.series):
        white = random.standard_normal((series.n, len(x)))
        replicas[:, part] = models[:, part] + sd[part] * coloured(series, white).T
        constant = np.log(sd[part]) + log_volumes(series) + 0.5 * np.log(2.0 * np.pi)
        of_values = -0.5 * whitened(series, off[:, part].T).T ** 2 - constant
        logs[:, part] = np.where(side[part] == 0.0, of_values, logs[:, part])
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
