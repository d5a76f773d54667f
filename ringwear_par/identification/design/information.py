"""What is known of the fitted keys before the next tests, and what each test would tell of them.

The information of a test about the unknowns is J' C^-1 J: J by differences of histories, C of all
noise, nuisances projected out. A test of a new specimen tells less of a material that scatters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError
from ringwear_par.files.folders import POSTERIOR
from ringwear_par.files.text import shortened
from ringwear_par.identification.definition.problem import (
    Experiment,
    Loss,
    Problem,
    body_of_wear,
)
from ringwear_par.identification.draws import read_draws
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.key_estimates import prior_sd
from ringwear_par.identification.noise import STUDENT, Growth, Noise, Setting
from ringwear_par.identification.sampling import standardised
from ringwear_par.identification.setting import random_wear

#: draws at which readings are compared, and of priors from which these are chosen
_DRAWS, _MANY = 6, 512


@dataclass(frozen=True, eq=False)
class Before:
    """What is known before the next tests."""

    #: (m,) values of the keys, as they seem to be, and their derivatives by the unknowns
    values: FloatArray
    slopes: FloatArray
    #: (d, m) unknowns, draws of what they may be, at which readings are compared
    draws: FloatArray
    #: (m, m) of the unknowns
    covariance: FloatArray
    #: (m,) variances of the unknowns between specimens
    scatter: FloatArray
    #: (bodies,) mm, sizes of random wear; NaN where a share is expected
    sizes: FloatArray
    #: (m,) whether nothing is known but bounds
    unknown: BoolArray


def before_tests(problem: Problem, folder: Path | None) -> Before:
    """Return what priors and bounds tell, or the draws of an earlier fit.

    InputError where the folder is not that of a fit of the same keys.
    """
    parameters, process = problem.parameters, problem.settings.process
    unknown = np.array([folder is None and p.prior is None for p in parameters])
    variances = {p.key: p.scatter.variance if p.scatter else 0.0 for p in parameters}
    sizes = [np.nan if noise.size is None else noise.size for noise in process.values()]
    low, high = problem.unknown_bounds
    if folder is None:
        means = [p.start if p.prior is None else p.prior.mean for p in parameters]
        x = problem.unknowns(np.clip(means, *np.array([p.bounds for p in parameters]).T))
        sd = np.array([prior_sd(p) for p in parameters])
        normal = np.random.default_rng(0).standard_normal((_MANY, len(x)))
        material, covariance = x + normal * sd * ~unknown, np.diag(sd**2)
    else:
        draws = read_draws(folder / POSTERIOR)
        if sorted(draws.keys) != sorted(problem.keys):
            raise InputError(
                f"--after {folder / POSTERIOR}: keys = {shortened([*draws.keys])}: must be those "
                f"of {problem.name}, {', '.join(problem.keys)}"
            )
        order = [draws.keys.index(key) for key in problem.keys]
        values = draws.values(draws.material)[:, order]
        material = np.array([problem.unknowns(row) for row in values])
        x, covariance = material.mean(axis=0), np.atleast_2d(np.cov(material.T))
        variances |= dict.fromkeys([key for key, _ in draws.scatter], 0.0)
        for (key, _), tau in draws.scatter.items():
            variances[key] += float(np.median(tau)) ** 2
        sizes = [np.median(draws.process[:, BODIES.index(body_of_wear(key))]) for key in process]
    at = problem.values(x)
    slopes = np.array([p.slope(v) for p, v in zip(parameters, at, strict=True)])
    chosen = _along(np.clip(material, low, high))
    return Before(
        at, slopes, chosen, covariance, np.array([*variances.values()]),
        np.array(sizes, dtype=float), unknown,
    )  # fmt: skip


def _along(material: FloatArray) -> FloatArray:
    """Return few draws (d, m) that stand for all (s, m): at equal steps of their longest axis.

    Where a posterior bends, readings at its mean alone would promise too much.
    """
    scaled, longest = standardised(material)
    places = (2 * np.arange(_DRAWS) + 1) * len(material) // (2 * _DRAWS)
    return material[np.argsort(scaled @ longest, kind="stable")[places]]


def informations(
    readings: Readings, before: Before, existing: int, parts: Sequence[tuple[int, Sequence[int]]]
) -> FloatArray:
    """Return the information (tests, d, m, m) about the material; NaN where there is no history.

    On the first rank, within ``readings.lead``.

    Parameters
    ----------
    existing : number of tests of the fit file, which are the first ones: shares of random wear are
        of the largest depth of these.
    parts : number of the test and of those of its series that are read, of each wanted.
    """
    problem, tests, (d, m) = readings.problem, readings.problem.experiments, before.draws.shape
    _, slopes = readings.with_slopes(before.draws)
    clocks, depths = random_wear(readings, np.tile(before.draws[d // 2], (len(tests), 1)))
    expected = [noise.expected_share for noise in problem.settings.process.values()]
    deepest = [max(test[i][1].max() for test in clocks[:existing]) for i in range(len(depths))]
    of_sizes = np.sqrt(before.sizes / depths)
    shares = np.where(np.isnan(of_sizes), expected * np.sqrt(deepest), of_sizes)
    every = np.full((len(parts), d, m, m), np.nan)
    for matrices, (number, series) in zip(every, parts, strict=True):
        test = tests[number]
        if np.isfinite(slopes[number]).all():
            setting = replace(Setting.before(test), clocks=tuple(clocks[number]))
            matrices[:] = information(
                test, series, setting, shares, slopes[number], problem.settings.loss, before.scatter
            )
    return every


def information(
    test: Experiment,
    numbers: Sequence[int],
    setting: Setting,
    shares: FloatArray,
    slopes: FloatArray,
    loss: Loss,
    scatter: FloatArray,
) -> FloatArray:
    """Return the information (d, m, m) on the material in some series of a test of one specimen.

    Of a thermal growth the amplitude is unknown, its time as expected.

    Parameters
    ----------
    shares : (bodies,) of random wear.
    slopes : (n, d, m) derivatives of all readings of the test.
    scatter : (m,) variances of the specimen's own values about the material's.
    """
    sd = np.concatenate([series.sd for series in test.series])
    setting = replace(setting, sd=sd / np.sqrt(STUDENT if loss == "student" else 1.0))
    noise = Noise(test, numbers, setting, shares)
    rows = noise(slopes[noise.rows].reshape(len(noise.rows), -1))
    grown = Growth(test, numbers, noise)
    times = [time.expected for i in grown.series if (time := test.series[i].growth_time)]
    node = int(np.abs(np.log(grown.times / times)).sum(axis=1).argmin())
    taken = grown.directions(rows, np.zeros(rows.shape[1]))[node]
    rows, taken = (columns.reshape(-1, *slopes.shape[1:]) for columns in (rows, taken))
    alone = np.einsum("ndi,ndj->dij", rows, rows) - np.einsum("gdi,gdj->dij", taken, taken)
    of_material: FloatArray = np.linalg.solve(np.eye(len(scatter)) + alone * scatter, alone)
    return of_material
