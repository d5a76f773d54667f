"""What is known of the fitted keys before the next tests, and what each test would tell of them.

The information of a test about the unknowns is J' C^-1 J: J by differences of histories, C of all
noise, nuisances projected out. A test of a new specimen tells less of a material that scatters.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import factor
from ringwear_par.cases.values import RejectedError
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
from ringwear_par.identification.likelihood import Noise, Setting
from ringwear_par.identification.readings import growth
from ringwear_par.identification.setting import random_wear

#: Fisher information of noise of the loss "student" over that of normal noise
_STUDENT = 5.0 / 7.0
#: share of the scale of its prior that the size of random wear is taken to be
_EXPECTED = 0.5
#: relative difference of growth times; share of bounds by which a key is moved for a derivative
_GROWTH, _STEP = 1e-3, 1e-4
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
    #: mm, of the random wear of bodies by "wear.lower", "wear.upper"; without those that are not known
    sizes: Mapping[str, float]
    #: (m,) whether nothing is known but bounds
    unknown: FloatArray


def before_tests(problem: Problem, folder: Path | None) -> tuple[Problem, Before]:
    """Return what priors and bounds tell, or an earlier fit; and the problem with its noise.

    Raises
    ------
    InputError : the folder is not that of a fit of the same keys.
    """
    parameters, process = problem.parameters, problem.settings.process
    low, high = problem.unknown_bounds
    scatter = expected_sizes(problem)
    sizes = {key: noise.size for key, noise in process.items() if noise.size is not None}
    unknown = np.array([folder is None and p.prior is None for p in parameters])
    if folder is None:
        values = [p.start if p.prior is None else np.clip(p.prior.mean, *p.bounds) for p in parameters]
        x, sd = problem.unknowns(values), (high - low) / np.sqrt(12.0)
        for j, (p, value) in enumerate(zip(parameters, values, strict=True)):
            if p.prior is not None:
                sd[j] = min(sd[j], p.prior.sd / p.slope(value))
        covariance = np.diag(sd**2)
        moves = np.where(unknown, 0.0, sd) * np.random.default_rng(0).standard_normal((_MANY, len(x)))
        material = reflected(x + moves, low, high)
    else:
        draws, noise = _earlier(problem, folder)
        problem = _with_noise(problem, noise)
        material = draws.values(draws.material)[:, [draws.keys.index(key) for key in problem.keys]]
        material = np.clip(material, *np.array([p.bounds for p in parameters]).T)
        logs = [p.log for p in parameters]
        material[:, logs] = np.log(material[:, logs])
        x, covariance = material.mean(axis=0), np.cov(material.T).reshape(len(parameters), -1)
        scatter |= {key: float(np.median(tau)) for key, tau in draws.scatter.items() if key in scatter}
        for key in process:
            size = float(np.median(draws.process[:, BODIES.index(body_of_wear(key))]))
            sizes |= {key: size} if size else {}
    variances = [sum(tau**2 for (k, _), tau in scatter.items() if k == key) for key in problem.keys]
    return problem, Before(
        problem.values(x), _along(material), covariance, np.array(variances, dtype=float), sizes, unknown
    )


def _along(material: FloatArray) -> FloatArray:
    """Return few draws (d, m) that stand for all (s, m): at equal steps of their longest axis.

    Where a posterior bends, readings at its mean alone would promise too much.
    """
    spread = material.std(axis=0)
    if not spread.any():
        return material[:1]
    scaled = (material - material.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    along = scaled @ np.linalg.eigh(scaled.T @ scaled)[1][:, -1]
    middles = (2 * np.arange(_DRAWS) + 1) * len(material) // (2 * _DRAWS)
    return material[np.argsort(along, kind="stable")[middles]]


def _earlier(problem: Problem, folder: Path) -> tuple[Draws, Mapping[Any, Any]]:
    """Return the draws of a fit's folder, and the noise (sd, unit) it found by test and series."""
    allowed = "must be the folder of a fit of the same keys that is done (ringwear fit -o)"
    try:
        text = read_text(folder / FIT)
    except InputError as error:
        raise InputError(f"--after {error}; {allowed}") from error
    draws = read_draws(folder / "draws.nc")
    try:
        noise = {
            (test, name): (float(entry["sd"]), str(entry["unit"]))
            for test, series in json.loads(text)["experiments"].items()
            for name, entry in series.items()
            if "sd" in entry
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"--after {folder / FIT}: is no outcome of ringwear fit; {allowed}") from error
    if sorted(draws.keys) != sorted(problem.keys):
        raise InputError(
            f"--after {folder}: keys = {shortened([*draws.keys])}: must be those of {problem.name}, "
            f"{', '.join(problem.keys)}"
        )
    for p in problem.parameters:
        value = float(np.median(draws.values(draws.material)[:, draws.keys.index(p.key)]))
        if not p.bounds[0] <= value <= p.bounds[1]:
            raise InputError(
                f"--after {folder}: {p.key} = {value:g}: must be within the bounds of {problem.name}, "
                f"{p.bounds[0]:g} to {p.bounds[1]:g}"
            )
    return draws, noise


def _with_noise(problem: Problem, found: Mapping[tuple[str, str], tuple[float, str]]) -> Problem:
    """Return a problem with the noise that an earlier fit has found, where it is to be fitted.

    It is that of the same series of the same test; else of the first test that had it.
    """

    def renoised(test: Experiment, series: Series) -> Series:
        others = [noise for (_, name), noise in found.items() if name == series.name]
        sd, unit = found.get((test.name, series.name), others[0] if others else (np.nan, ""))
        if not series.sd_fitted or np.isnan(sd):
            return series
        try:
            return replace(series, sd=np.full(series.n, sd * factor(unit, series.unit) * series.factor))
        except RejectedError:
            return series

    tests = [replace(t, series=tuple(renoised(t, s) for s in t.series)) for t in problem.experiments]
    return problem.with_experiments(tuple(tests))


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
    problem, tests = readings.problem, readings.problem.experiments
    slopes = _slopes(readings, before.draws)
    clocks, depths = random_wear(readings, np.tile(before.draws[len(before.draws) // 2], (len(tests), 1)))
    shares = np.zeros(len(depths))
    for place, (key, noise) in enumerate(problem.settings.process.items()):
        deepest = max(float(test[place][1].max()) for test in clocks[:own]) * depths[place]
        share = _EXPECTED * noise.scale if noise.share is None else noise.share
        shares[place] = np.sqrt(before.sizes.get(key, share**2 * deepest) / depths[place])
    d, m = before.draws.shape
    found = np.full((len(parts), d, m, m), np.nan)
    for matrices, (number, series) in zip(found, parts, strict=True):
        columns = slopes[number]
        if not np.isfinite(columns).all():
            continue
        test = tests[number]
        setting = Setting.before(test, "gaussian", 0)
        if problem.settings.loss == "student":
            setting = replace(setting, sd=setting.sd / np.sqrt(_STUDENT))
        setting = replace(setting, clocks=tuple(clocks[number]))
        for matrix, own_information in zip(
            matrices, _of_test(test, series, setting, shares, columns), strict=True
        ):
            matrix[:] = of_new_specimen(own_information, before.scatter)
    return found


def _slopes(readings: Readings, draws: FloatArray) -> list[FloatArray]:
    """Return the derivatives (n, d, m) of the readings of all tests at unknowns (d, m).

    By one block of m + 1 histories for each test and draw.
    """
    low, high = readings.problem.unknown_bounds
    step = _STEP * (high - low)
    step = np.where(draws + step > high, -step, step)
    points = np.concatenate([draws[:, None], draws[:, None] + step[:, None] * np.eye(len(low))], axis=1)
    every = points.reshape(-1, len(low))
    blocks = readings([(i, every) for i in range(len(readings.problem.experiments))])
    rows = [y.reshape(*points.shape[:2], y.shape[1]) for y in blocks]
    return [np.moveaxis((y[:, 1:] - y[:, :1]) / step[..., None], 2, 0) for y in rows]


def _of_test(
    test: Experiment, numbers: Sequence[int], setting: Setting, shares: FloatArray, slopes: FloatArray
) -> FloatArray:
    """Return the information (d, m, m) in some series of a test on its own unknowns.

    A thermal growth counts by its amplitude, and by its time where it is expected to grow.
    """
    noise = Noise(test, numbers, setting, shares)
    rows = noise(slopes[noise.rows].reshape(len(noise.rows), -1)).reshape(-1, *slopes.shape[1:])
    columns, known, start = np.zeros((len(noise.rows), 0)), [], 0
    for series in (test.series[i] for i in numbers):
        here = slice(start, start := start + series.n)
        if (time := series.growth_time) is None:
            continue
        amplitude = next(n for n in series.nuisances if n.kind == "thermal")
        times = time.expected * np.array([1.0, 1.0 + _GROWTH])
        grown, later = (growth(amplitude, test.case, series.x, t) for t in times.tolist())
        added = np.zeros((len(columns), 2))
        added[here, 0] = series.factor * grown
        added[here, 1] = series.factor * amplitude.expected * (later - grown) / np.diff(times)
        columns = np.concatenate([columns, added], axis=1)
        known += [0.0 if n.prior is None else n.prior.sd**-2 for n in (amplitude, time)]
    information: FloatArray = np.einsum("ndi,ndj->dij", rows, rows)
    if known:
        grows = noise(columns)
        along = np.einsum("ng,ndi->dgi", grows, rows)
        inverse = np.linalg.pinv(grows.T @ grows + np.diag(known))
        information -= np.einsum("dgi,gh,dhj->dij", along, inverse, along)
    return information


def of_new_specimen(information: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the information (m, m) on the material in a test of one more specimen.

    Its readings have some on its own values, which scatter about the material's by variances (m,).
    """
    some = variances > 0.0
    columns = information[:, some]
    inner = np.diag(1.0 / variances[some]) + columns[some]
    return information - columns @ np.linalg.solve(inner, columns.T)
