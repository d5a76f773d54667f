"""Tests that could be made, by ``[design]``, and what each would tell of the fitted keys.

The information of a test about the unknowns is J' C^-1 J: J by differences of histories, C of all
noise, nuisances projected out. A test of a new specimen tells less of a material that scatters.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.units import factor
from ringwear_par.identification.definition.problem import (
    DesignSpace,
    Experiment,
    Problem,
    Series,
)
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.key_estimates import VAGUE, prior_sd
from ringwear_par.identification.noise import STUDENT, Noise, Setting
from ringwear_par.identification.setting import random_wear
from ringwear_par.results.key_numbers import time_words

#: keys of the load, of which one may vary
LOADS = ("load.pressure", "load.force")
#: how many values of a range are tried
_LEVELS = {"load.omega": 3, "load.pressure": 15, "load.force": 15, "time.end": 10}
#: fewest readings over time of a record, which continues at its rate in a longer test
_RECORD = 10
#: draws at which readings are compared, and of priors from which these are chosen
_DRAWS, _MANY = 6, 512


class Candidate(NamedTuple):
    """One test that could be made."""

    #: of the case, those that vary
    keys: Mapping[str, float]
    #: its case, when it is read, and in a few words what it is
    experiment: Experiment

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return self.experiment.case.time.end


def candidates(space: DesignSpace, template: Experiment) -> list[Candidate]:
    """Return the tests of a space, measured as ``template``; InputError for impossible values.

    Records go on at their rate, with their median noise; profiles are measured at the end, that of
    a body as its last one in the file; all else is read at its part of the test. Names have the
    units in which ranges are written.
    """
    usual, tests = template.case.time.end, list[Candidate]()
    read = {s.quantity if s.profile else s.name: s for s in template.series}
    varied = [key for key in _LEVELS if key in space.ranges]
    levels = (np.unique(np.linspace(*space.ranges[key], _LEVELS[key])).tolist() for key in varied)
    for values in itertools.product(*levels):
        keys = dict(zip(varied, values, strict=True))
        if (end := keys.get("time.end", usual)) > space.time_limit:
            continue
        named = [(key, keys[key]) for key in (*LOADS, "load.omega") if key in keys]
        words = [_in_words(space, key, value) for key, value in (*named, ("time.end", end))]
        series = tuple(_scaled(s, end, end / usual) for s in read.values())
        test = Experiment(", ".join(words), template.case.replace(keys), series)
        tests.append(Candidate(keys, test))
    return tests


def _in_words(space: DesignSpace, key: str, value: float) -> str:
    """Return the value of a key in the unit in which its range is written."""
    if key == "time.end" and key not in space.units:
        return time_words(value, value)
    unit = space.units.get(key, BY_PATH[key].unit)
    return f"{value / factor(unit, BY_PATH[key].unit):.4g} {unit}"


def _scaled(series: Series, end: float, longer: float) -> Series:
    """Return the readings of a test that ends at ``end``, longer by a factor."""
    if series.profile:
        return replace(series, at=end)
    if series.n < _RECORD:
        return replace(series, x=series.x * longer)
    count = max(round(series.n * longer), 2)
    x = longer * np.linspace(series.x[0], series.x[-1], count)
    sd = np.full(count, np.median(series.sd))
    return replace(series, x=x, value=np.zeros(count), sd=sd, lines=None, censored=None)


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
    #: (m,) sd of unknowns above which a key is not identified; infinite where a prior or a fit
    #: says more of it than its bounds
    vague: FloatArray
    #: (m,) variances of the unknowns between specimens
    scatter: FloatArray
    #: (bodies,) mm, sizes of random wear; NaN where a share is expected
    sizes: FloatArray

    def then(self, information: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is known with information (..., d, m, m) at each of the draws.

        How much the logarithm of the ellipsoid becomes smaller (...), the mean of the draws, and
        standard deviations (..., m) of unknowns, of their mean variance.
        """
        before = np.linalg.inv(self.covariance)
        precision = before + information
        gain = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(before)[1]
        covariance = np.linalg.inv(precision).mean(axis=-3)
        return 0.5 * gain.mean(axis=-1), np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))

    def sd_of_values(self, information: FloatArray) -> FloatArray:
        """Return standard deviations (..., m) of values, infinite: not identified."""
        _, sd = self.then(information)
        return np.where(sd > self.vague, np.inf, sd * self.slopes)


def before_tests(problem: Problem, draws: Draws | None) -> Before:
    """Return what priors and bounds tell, or the draws of an earlier fit of these keys."""
    parameters, process = problem.parameters, problem.settings.process
    scatter = np.array([p.scatter.variance if p.scatter else 0.0 for p in parameters])
    if draws is None:
        sizes = [np.nan if noise.size is None else noise.size for noise in process.values()]
        means = [p.start if p.prior is None else p.prior.mean for p in parameters]
        x = problem.unknowns(np.clip(means, *np.array([p.bounds for p in parameters]).T))
        sd = np.array([prior_sd(p) for p in parameters])
        known = np.array([p.prior is not None for p in parameters])
        vague, covariance = np.where(known, np.inf, VAGUE * sd), np.diag(sd**2)
        material = x + np.random.default_rng(0).standard_normal((_MANY, len(x))) * sd * known
    else:
        material = np.array([problem.unknowns(row) for row in draws.material])
        x, covariance = material.mean(axis=0), np.atleast_2d(np.cov(material.T))
        vague = np.full(len(x), np.inf)
        for j, key in enumerate(problem.keys):
            found = [np.median(tau) ** 2 for (of, _), tau in draws.scatter.items() if of == key]
            scatter[j] = sum(found) if found else scatter[j]
        sizes = [float(np.median(draws.process.get(key, 0.0))) for key in process]
    at = problem.values(x)
    slopes = np.array([p.slope(v) for p, v in zip(parameters, at, strict=True)])
    # few draws stand for all, at equal steps of their longest axis: where a posterior bends,
    # readings at its mean alone would promise too much
    material = np.clip(material, *problem.unknown_bounds)
    spread = material.std(axis=0)
    scaled = (material - material.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    longest = np.linalg.eigh(scaled.T @ scaled)[1][:, -1]
    places = (2 * np.arange(_DRAWS) + 1) * len(material) // (2 * _DRAWS)
    chosen = material[np.argsort(scaled @ longest, kind="stable")[places]]
    return Before(at, slopes, chosen, covariance, vague, scatter, np.array(sizes, dtype=float))


def informations(readings: Readings, before: Before) -> FloatArray:
    """Return what each test, of a specimen each, tells of the material, (tests, d, m, m).

    NaN without a history. Of a thermal growth the amplitude is unknown, its time as expected. On
    the first rank, within ``readings.lead``.
    """
    problem, tests, (d, m) = readings.problem, readings.problem.experiments, before.draws.shape
    slopes = readings.slopes(before.draws)
    clocks, depths = random_wear(readings, np.tile(before.draws[d // 2], (len(tests), 1)))
    expected = [noise.expected_share for noise in problem.settings.process.values()]
    of_sizes = np.sqrt(before.sizes / depths)
    shares = np.where(np.isnan(of_sizes), expected, of_sizes)
    worse = STUDENT if problem.settings.loss == "student" else 1.0
    information = np.full((len(tests), d, m, m), np.nan)
    for number, (test, slope, of_test) in enumerate(zip(tests, slopes, clocks, strict=True)):
        if not np.isfinite(slope).all():
            continue
        sd, every = np.concatenate([series.sd for series in test.series]), range(len(test.series))
        setting = replace(Setting.before(test), clocks=tuple(of_test), sd=sd / np.sqrt(worse))
        noise = Noise(test, every, setting, shares)
        rows = slope[noise.rows].reshape(len(noise.rows), -1)
        times = [time.expected for one in test.series if (time := one.growth_time)] or [1.0]
        distance = np.abs(np.log(np.maximum(noise.nuisances.times, 1e-300) / times[0]))
        gram = noise.grams(rows, np.zeros(rows.shape[1]), int(distance.argmin()))
        alone = np.einsum("didj->dij", gram.reshape(d, m, d, m))
        scatter = before.scatter  # of the specimen's own values about the material's
        information[number] = np.linalg.solve(np.eye(m) + alone * scatter, alone)
    return information
