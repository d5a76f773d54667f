"""Each test of a fit at the mode and among the draws: model, band, residuals, nuisances."""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import BASE, Series, body_of_wear, records
from ringwear_par.identification.likelihood import EmulatedLikelihood, TestLikelihood
from ringwear_par.identification.noise import coloured, log_volumes, sides, whitened
from ringwear_par.identification.solution import Solution
from ringwear_par.pictures import fit_panels

#: step of differences of log p, in the sd of an unknown
_STEP = 0.02


@dataclass(frozen=True, eq=False)
class FittedSeries:
    """A series as it was fitted."""

    #: name of its test
    test: str
    series: Series
    #: noise, the model at the mode with nuisances and random wear, its band, and residuals, white;
    #: of limits the limit less the model
    drawn: fit_panels.Series
    #: the same and what is worn by chance, as files have it: (n,) values, unit and meaning by name
    columns: dict[str, tuple[FloatArray, str, str]]
    #: draws (s,) of nuisances by kind, in the data's unit, and of growth times, s
    nuisances: dict[str, FloatArray]

    @property
    def title(self) -> str:
        """Its name, and that of its test."""
        return f"{self.series.name} ({self.test})"

    @property
    def misfits(self) -> FloatArray:
        """Residuals of its readings that are no limits."""
        return self.drawn.residuals[self.drawn.censored == 0]


def _of_test(solution: Solution, number: int) -> tuple[EmulatedLikelihood, FloatArray, FloatArray]:
    """Return the likelihood of a test, and its unknowns at the mode (m,) and in draws (s, m)."""
    posterior, both = solution.posterior, (solution.best, solution.theta)
    best, x = (posterior.of_tests(theta)[..., number, :] for theta in both)
    return posterior.likelihoods[number], best, x


def fitted_series(
    solution: Solution, number: int, random: np.random.Generator
) -> tuple[list[FittedSeries], dict[str, FloatArray]]:
    """Return the series of a test, and draws (s,) of the factors on its inputs, by their keys."""
    (emulated, best, x), settings = _of_test(solution, number), solution.problem.settings
    likelihood, test = emulated.likelihood, emulated.likelihood.test
    model, excess, _ = with_all(likelihood, emulated.emulator(best[None]))
    models, worn, values = with_all(likelihood, emulated.emulator(x), random)
    band, worn_sd, fitted = models.std(axis=0), worn.std(axis=0), []
    for place, (series, part) in enumerate(records(test.series)):
        # the loss "student" has made the sd of outliers larger
        larger = float((likelihood.setting.sd[part] / series.sd).min())
        sd, limits = (larger if series.sd_fitted else 1.0) * series.sd, sides(test)[part]
        off, factor = (series.value - model[0, part]) / sd, series.factor
        residuals = whitened(series, off) if series.censored is None else off
        drawn = fit_panels.Series(
            test.name, series.name, series.quantity, series.unit, series.x, series.value / factor,
            model[0, part] / factor, sd / factor, band[part] / factor, residuals, settings.level,
            test.case.contact, limits.astype(int),
        )  # fmt: skip
        base, (along, unit) = BASE[series.kind], ("r", "mm") if series.profile else ("time", "s")
        columns = {
            along: (series.x, unit, "where or when it was read"),
            "residual": (residuals, "1", "data less model over its noise, white"),
            "data": (series.value, base, "what was read"),
            "sd": (sd, base, "noise of the data"),
            "band": (band[part], base, "sd of the model's reading"),
            "model": (model[0, part], base, "the model's reading, with nuisances and random wear"),
        }
        for i, (key, depth) in enumerate(zip(settings.process, solution.depths, strict=True)):
            name, of = f"excess_{body_of_wear(key)}", "depth worn beyond that of the law"
            columns[name] = depth * excess[0, part, i], "mm", f"mean {of}, by the readings"
            columns[f"{name}_sd"] = depth * worn_sd[part, i], "mm", f"sd of {name}"
        if limits.any():
            meaning = "-1: the true value is at most what was read, 1: at least, 0: that"
            columns["censored"] = limits, "1", meaning
        nuisances = {kind: of for (i, kind), of in values.items() if i == place}
        fitted.append(FittedSeries(test.name, series, drawn, columns, nuisances))
    scales = [(measured.key, *measured.scale) for measured in test.inputs if measured.scale]
    of_inputs = enumerate(scales)
    return fitted, {key: mean + sd * values[-1, str(i)] for i, (key, mean, sd) in of_inputs}


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
    solution: Solution, number: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return log p of each reading, by those before where noise is correlated, and replicas.

    Both are (s, n), at the draws of a test; nuisances and random wear are drawn beside them.
    """
    emulated, _, x = _of_test(solution, number)
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


def scores_and_information(solution: Solution, number: int) -> FloatArray:
    """Return slopes of log p of a test at the mode, and minus its curvatures, (2, m)."""
    (emulated, best, x), m = _of_test(solution, number), len(solution.problem.parameters)
    sd = x.std(axis=0)
    step = _STEP * np.where(sd > 0.0, sd, 1e-6)
    points = best + np.concatenate([np.zeros((1, m)), np.diag(step), -np.diag(step)])
    shares = np.median(solution.posterior.shares(solution.theta), axis=0)
    coordinates = emulated.emulator.coordinates(points)
    log_p = emulated(coordinates, np.tile(shares, (len(points), 1)))
    middle, up, down = np.split(log_p, [1, m + 1])
    return np.array([(up - down) / (2.0 * step), (2.0 * middle - up - down) / step**2])
