"""What is known of the fitted keys before the next tests, and what each test would tell of them.

The information of a test about the unknowns is J' C^-1 J: J by differences of histories, C of all
noise, nuisances projected out. A test of a new specimen tells less of a material that scatters.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.units import factor
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError
from ringwear_par.files.folders import FIT
from ringwear_par.files.text import read_text, shortened
from ringwear_par.identification.definition.problem import (
    Experiment,
    Problem,
    Series,
    body_of_wear,
    reflected,
)
from ringwear_par.identification.definition.scatter import expected_sizes
from ringwear_par.identification.draws import Draws, read_draws
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.likelihood import Growth, Noise, Setting
from ringwear_par.identification.setting import random_wear

#: Fisher information of noise of the loss "student" over that of normal noise
_STUDENT = 5.0 / 7.0
#: share of the scale of its prior that a size of random wear is taken to be
_EXPECTED = 0.5
#: share of its bounds by which a key is moved for a derivative
_STEP = 1e-4
#: draws at which readings are compared, and of priors from which these are chosen
_DRAWS, _MANY = 6, 512


@dataclass(frozen=True, eq=False)
class Before:
    """What is known before the next tests."""

    #: (m,) values of the keys, as they seem to be
    values: FloatArray
    #: (d, m) unknowns, draws of what they may be, at which readings are compared
    draws: FloatArray
    #: (m, m) of the unknowns
    covariance: FloatArray
    #: (m,) variances of the unknowns between specimens
    scatter: FloatArray
    #: mm, of the random wear of "wear.lower", "wear.upper", where it is known
    sizes: Mapping[str, float]
    #: (m,) whether nothing is known but bounds
    unknown: BoolArray


def before_tests(problem: Problem, folder: Path | None) -> tuple[Problem, Before]:
    """Return what priors and bounds tell, or an earlier fit; and the problem with its noise.

    InputError where the folder is not that of a fit of the same keys.
    """
    parameters, process = problem.parameters, problem.settings.process
    (low, high), taus = problem.unknown_bounds, expected_sizes(problem)
    sizes = {key: noise.size for key, noise in process.items() if noise.size is not None}
    unknown = np.array([folder is None and p.prior is None for p in parameters])
    if folder is None:
        means = [p.start if p.prior is None else p.prior.mean for p in parameters]
        x = problem.unknowns(np.clip(means, *np.array([p.bounds for p in parameters]).T))
        sd = (high - low) / np.sqrt(12.0)
        for j, p in enumerate(parameters):
            if p.prior is not None:
                sd[j] = min(sd[j], p.prior.sd / p.slope(p.value(x[j])))
        normal = np.random.default_rng(0).standard_normal((_MANY, len(x)))
        covariance, material = np.diag(sd**2), reflected(x + normal * sd * ~unknown, low, high)
    else:
        problem, draws = _earlier(problem, folder)
        order = [draws.keys.index(key) for key in problem.keys]
        values = draws.values(draws.material)[:, order]
        material = np.array([problem.unknowns(row) for row in values])
        material = np.clip(material, low, high)
        x, covariance = material.mean(axis=0), np.atleast_2d(np.cov(material.T))
        taus |= {key: float(np.median(tau)) for key, tau in draws.scatter.items() if key in taus}
        for key in process:
            size = float(np.median(draws.process[:, BODIES.index(body_of_wear(key))]))
            sizes |= {key: size} if size else {}
    scatter = [sum(tau**2 for (k, _), tau in taus.items() if k == key) for key in problem.keys]
    return problem, Before(
        problem.values(x), material[:1] if unknown.all() else _along(material), covariance,
        np.array(scatter, dtype=float), sizes, unknown,
    )  # fmt: skip


def _along(material: FloatArray) -> FloatArray:
    """Return few draws (d, m) that stand for all (s, m): at equal steps of their longest axis.

    Where a posterior bends, readings at its mean alone would promise too much.
    """
    spread = material.std(axis=0)
    scaled = (material - material.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    along = scaled @ np.linalg.eigh(scaled.T @ scaled)[1][:, -1]
    places = (2 * np.arange(_DRAWS) + 1) * len(material) // (2 * _DRAWS)
    return material[np.argsort(along, kind="stable")[places]]


def _earlier(problem: Problem, folder: Path) -> tuple[Problem, Draws]:
    """Return the problem with the noise that an earlier fit found, and the draws of that fit.

    The noise of a series that is to be fitted is that of the series of its name.
    """
    path, noise = folder / FIT, dict[str, tuple[float, str]]()
    allowed = "must be the folder of a fit of the same keys that is done (ringwear fit -o)"
    try:
        for test in json.loads(read_text(path))["experiments"].values():
            for name, entry in test.items():
                if "sd" in entry:
                    noise.setdefault(name, (float(entry["sd"]), str(entry["unit"])))
    except InputError as error:
        raise InputError(f"--after {error}; {allowed}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"--after {path}: is no outcome of ringwear fit; {allowed}") from error
    draws = read_draws(folder / "draws.nc")
    if sorted(draws.keys) != sorted(problem.keys):
        raise InputError(
            f"--after {path}: keys = {shortened([*draws.keys])}: must be those of {problem.name}, "
            f"{', '.join(problem.keys)}"
        )

    def renoised(series: Series) -> Series:
        if not series.sd_fitted or series.name not in noise:
            return series
        sd, unit = noise[series.name]
        return replace(series, sd=np.full(series.n, sd * factor(unit, series.unit) * series.factor))

    tests = [replace(t, series=tuple(map(renoised, t.series))) for t in problem.experiments]
    return problem.with_experiments(tuple(tests)), draws


def informations(
    readings: Readings, before: Before, own: int, parts: Sequence[tuple[int, Sequence[int]]]
) -> FloatArray:
    """Return the information (tests, d, m, m) about the material; NaN where there is no history.

    On the first rank, within ``readings.lead``.

    Parameters
    ----------
    own : number of tests of the fit file, which are the first ones: shares of random wear are of
        the largest depth of these.
    parts : number of the test and of those of its series that are read, of each wanted.
    """
    problem, tests, (d, m) = readings.problem, readings.problem.experiments, before.draws.shape
    slopes = _slopes(readings, before.draws)
    clocks, depths = random_wear(readings, np.tile(before.draws[d // 2], (len(tests), 1)))
    shares = np.zeros(len(depths))
    for place, (key, noise) in enumerate(problem.settings.process.items()):
        deepest = max(float(test[place][1].max()) for test in clocks[:own]) * depths[place]
        share = _EXPECTED * noise.scale if noise.share is None else noise.share
        shares[place] = np.sqrt(before.sizes.get(key, share**2 * deepest) / depths[place])
    found = np.full((len(parts), d, m, m), np.nan)
    for matrices, (number, series) in zip(found, parts, strict=True):
        if np.isfinite(slopes[number]).all():
            setting = replace(Setting.before(tests[number], "", 0), clocks=tuple(clocks[number]))
            if problem.settings.loss == "student":
                setting = replace(setting, sd=setting.sd / np.sqrt(_STUDENT))
            each = _of_test(tests[number], series, setting, shares, slopes[number])
            matrices[:] = [of_new_specimen(matrix, before.scatter) for matrix in each]
    return found


def _slopes(readings: Readings, draws: FloatArray) -> list[FloatArray]:
    """Return the derivatives (n, d, m) of the readings of all tests at unknowns (d, m).

    By one block of m + 1 histories for each test and draw.
    """
    low, high = readings.problem.unknown_bounds
    step = _STEP * (high - low) * np.where(draws + _STEP * (high - low) > high, -1.0, 1.0)
    moved = draws[:, None] + step[:, None] * np.eye(len(low))
    points = np.concatenate([draws[:, None], moved], axis=1)
    every = points.reshape(-1, len(low))
    blocks = readings([(i, every) for i in range(len(readings.problem.experiments))])
    rows = [y.reshape(*points.shape[:2], y.shape[1]) for y in blocks]
    return [np.moveaxis((y[:, 1:] - y[:, :1]) / step[..., None], 2, 0) for y in rows]


def _of_test(
    test: Experiment,
    numbers: Sequence[int],
    setting: Setting,
    shares: FloatArray,
    slopes: FloatArray,
) -> FloatArray:
    """Return the information (d, m, m) in some series of a test on its own unknowns.

    Of a thermal growth the amplitude is unknown, its time as expected.
    """
    noise = Noise(test, numbers, setting, shares)
    rows = noise(slopes[noise.rows].reshape(len(noise.rows), -1))
    grown = Growth(test, numbers, setting, noise)
    times = [time.expected for i in grown.series if (time := test.series[i].growth_time)]
    node = int(np.abs(np.log(grown.times / times)).sum(axis=1).argmin())
    taken = grown.directions(rows, np.zeros(rows.shape[1]))[node]
    rows, taken = (columns.reshape(-1, *slopes.shape[1:]) for columns in (rows, taken))
    information: FloatArray = np.einsum("ndi,ndj->dij", rows, rows)
    return information - np.einsum("gdi,gdj->dij", taken, taken)


def of_new_specimen(information: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the information (m, m) on the material in a test of one more specimen.

    Its readings have some on its own values, which scatter about the material's by variances (m,).
    """
    some = variances > 0.0
    columns = information[:, some]
    inner = np.diag(1.0 / variances[some]) + columns[some]
    return information - columns @ np.linalg.solve(inner, columns.T)
