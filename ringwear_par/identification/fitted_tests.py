"""Each test of a fit at the mode and among the draws: model, band, residuals, nuisances."""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import Series, records
from ringwear_par.identification.likelihood import EmulatedLikelihood, TestLikelihood
from ringwear_par.identification.noise import coloured, log_volumes, sides, whitened
from ringwear_par.pictures import fit_panels

#: step of differences of log p, in the sd of an unknown
_STEP = 0.02


@dataclass(frozen=True, eq=False)
class FittedSeries:
    """A series as it was fitted."""

    series: Series
    #: noise, the model at the mode with nuisances and random wear, its band, and residuals, white;
    #: of limits the limit less the model
    drawn: fit_panels.Series
    #: (n, bodies) mm, depth worn by chance beyond that of the law, and its sd
    excess: FloatArray
    excess_sd: FloatArray
    #: draws (s,) of nuisances by kind, in the data's unit, and of growth times, s
    nuisances: dict[str, FloatArray]

    @property
    def test(self) -> str:
        """The name of its test."""
        return self.drawn.experiment

    @property
    def title(self) -> str:
        """Its name, and that of its test."""
        return f"{self.series.name} ({self.test})"

    @property
    def misfits(self) -> FloatArray:
        """Residuals of its readings that are no limits."""
        return self.drawn.residuals[self.drawn.censored == 0]


def fitted_series(
    emulated: EmulatedLikelihood,
    best: FloatArray,
    x: FloatArray,
    depths: FloatArray,
    level: float,
    random: np.random.Generator,
) -> tuple[list[FittedSeries], list[FloatArray]]:
    """Return the series of a test, and draws (s,) of its inputs' calibrations, in their sd.

    Parameters
    ----------
    best : (m,) unknowns of the mode.
    x : (s, m) of draws.
    depths : (bodies,) mm, see ``Solution``.
    level : of bands.
    """
    likelihood, test = emulated.likelihood, emulated.likelihood.test
    model, excess, _ = with_all(likelihood, emulated.emulator(best[None]))
    models, worn, values = with_all(likelihood, emulated.emulator(x), random)
    band, excess, excess_sd = models.std(axis=0), excess[0] * depths, worn.std(axis=0) * depths
    fitted = []
    for number, (series, part) in enumerate(records(test.series)):
        # the loss "student" has made the sd of outliers larger
        larger = float((likelihood.setting.sd[part] / series.sd).min())
        sd = (larger if series.sd_fitted else 1.0) * series.sd
        off, factor = (series.value - model[0, part]) / sd, series.factor
        nuisances = {kind: drawn for (i, kind), drawn in values.items() if i == number}
        drawn = fit_panels.Series(
            test.name, series.name, series.quantity, series.unit, series.x, series.value / factor,
            model[0, part] / factor, sd / factor, band[part] / factor,
            whitened(series, off) if series.censored is None else off, level, test.case.contact,
            sides(test)[part].astype(int),
        )  # fmt: skip
        fitted.append(FittedSeries(series, drawn, excess[part], excess_sd[part], nuisances))
    return fitted, [drawn for (i, _), drawn in values.items() if i < 0]


def with_all(
    likelihood: TestLikelihood, readings: FloatArray, random: np.random.Generator | None = None
) -> tuple[FloatArray, FloatArray, dict[tuple[int, str], FloatArray]]:
    """Return readings (P, n) of the model with nuisances and random wear: draws, or the best ones.

    Also return what is worn by chance (P, n, bodies) over the largest depth, and nuisances, see
    ``TestLikelihood.nuisance_draws``.
    """
    added, values = likelihood.nuisance_draws(readings, random)
    models, clocks = readings + added, likelihood.setting.clocks
    if not clocks:
        return models, np.zeros((*models.shape, 0)), values
    (noise,) = likelihood.noises
    worn = noise.random_wear((likelihood.data - models).T, random).T
    felt = np.stack([slope for slope, _ in clocks], axis=1)
    return models + (worn * felt).sum(axis=2), worn, values


def readings_of_draws(
    emulated: EmulatedLikelihood, x: FloatArray, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return log p of each reading, by those before where noise is correlated, and replicas.

    Both are (s, n), at unknowns (s, m) of draws; nuisances and random wear are drawn beside them.
    """
    likelihood, test = emulated.likelihood, emulated.likelihood.test
    models = with_all(likelihood, emulated.emulator(x), random)[0]
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
