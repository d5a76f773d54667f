"""What tests would tell of the fitted keys: those that could be made, and those of a dry run.

The information of a test about the unknowns is J' C^-1 J: J by differences of histories, C of all
noise, nuisances projected out. A test of a new specimen tells less of a material that scatters.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.units import factor
from ringwear_par.errors import ComputationError, counted
from ringwear_par.identification.definition.fitted_parameters import unit_scale, units_of
from ringwear_par.identification.definition.problem import (
    DesignSpace,
    Experiment,
    FittedParameter,
    Problem,
    ProcessNoise,
    Series,
)
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.key_estimates import VAGUE, direction, prior_sd
from ringwear_par.identification.likelihood import TestLikelihood
from ringwear_par.identification.noise import STUDENT, Setting
from ringwear_par.identification.record_checks import refuse_unfit
from ringwear_par.identification.setting import random_wear
from ringwear_par.results.key_numbers import time_words
from ringwear_par.results.progress import StopSignals

#: how many values of a range are tried
_LEVELS = {"load.pressure": 15, "load.force": 15, "load.omega": 3, "time.end": 10}
#: fewest readings over time of a record, which continues at its rate in a longer test
_RECORD = 10
#: draws at which readings are compared, and of priors from which these are chosen
_DRAWS, _MANY = 6, 512


def candidates(space: DesignSpace, template: Experiment) -> tuple[Experiment, ...]:
    """Return the tests of a space, measured as ``template``; InputError for impossible values.

    Their ``changes`` are the keys that vary, which their names tell in the units of the ranges.
    Records go on at their rate, with their median noise; profiles are measured at the end, that of
    a body as its last one in the file; all else is read at its part of the test.
    """
    usual, tests = template.case.time.end, list[Experiment]()
    read = {s.quantity if s.profile else s.name: s for s in template.series}
    varied = [key for key in _LEVELS if key in space.ranges]
    levels = (np.unique(np.linspace(*space.ranges[key], _LEVELS[key])).tolist() for key in varied)
    for values in itertools.product(*levels):
        keys = dict(zip(varied, values, strict=True))
        if (end := keys.get("time.end", usual)) > space.seconds:
            continue
        name = ", ".join(_in_words(space, *entry) for entry in {**keys, "time.end": end}.items())
        series = tuple(_scaled(s, end, end / usual) for s in read.values())
        tests.append(Experiment(name, template.case.replace(keys), series, changes=keys))
    return tuple(tests)


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

    parameters: Sequence[FittedParameter]
    #: (m,) as they seem to be
    values: FloatArray
    #: (d, m) unknowns, draws of what they may be, at which readings are compared
    draws: FloatArray
    #: (m, m) of the unknowns
    covariance: FloatArray
    #: (m,) sd of unknowns above which a key is not identified; infinite where a prior or a fit
    #: says more of it than its bounds
    vague: FloatArray
    #: (m,) variances of the unknowns between specimens
    scatter: FloatArray
    #: of the bodies whose wear is random, by the file or the fit
    process: Sequence[ProcessNoise]

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

    def sds(self, information: FloatArray) -> dict[str, float | None]:
        """Return the sd of the value of each key, see ``then``; None: not identified."""
        _, sd = self.then(information)
        of_values = sd * np.where([p.log for p in self.parameters], self.values, 1.0)
        every = zip(self.parameters, of_values.tolist(), sd > self.vague, strict=True)
        return {p.key: None if is_vague else of_value for p, of_value, is_vague in every}


def before_tests(problem: Problem, draws: Draws | None) -> Before:
    """Return what priors and bounds tell, or the draws of an earlier fit of these keys."""
    parameters, process = problem.parameters, problem.settings.process
    scatter = np.array([p.scatter.variance if p.scatter else 0.0 for p in parameters])
    if draws is None:
        means = [p.start if p.prior is None else p.prior.mean for p in parameters]
        x = problem.unknowns(np.clip(means, *np.array([p.bounds for p in parameters]).T))
        sd = np.array([prior_sd(p) for p in parameters])
        known = np.array([p.prior is not None for p in parameters])
        vague, covariance = np.where(known, np.inf, VAGUE * sd), np.diag(sd**2)
        material = x + np.random.default_rng(0).standard_normal((_MANY, len(x))) * sd * known
    else:
        material = problem.unknowns(draws.material)
        x, covariance = material.mean(axis=0), np.atleast_2d(np.cov(material.T))
        vague = np.full(len(x), np.inf)
        for j, (p, fitted) in enumerate(zip(parameters, draws.parameters, strict=True)):
            found = [np.median(tau) ** 2 for (of, _), tau in draws.scatter.items() if of == p.key]
            unit = np.median(draws.material[:, j]) ** (fitted.log - p.log)  # of a logarithm, or not
            scatter[j] = sum(found) * unit**2 if found else scatter[j]
        process = {
            key: ProcessNoise(float(np.median(draws.process.get(key, 0.0)))) for key in process
        }
    # few draws stand for all, at equal steps of their longest axis: where a posterior bends,
    # readings at its mean alone would promise too much
    material = np.clip(material, *problem.unknown_bounds)
    spread = material.std(axis=0)
    scaled = (material - material.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    longest = np.linalg.eigh(scaled.T @ scaled)[1][:, -1]
    places = (2 * np.arange(_DRAWS) + 1) * len(material) // (2 * _DRAWS)
    chosen = material[np.argsort(scaled @ longest, kind="stable")[places]]
    processes = [*process.values()]
    return Before(parameters, problem.values(x), chosen, covariance, vague, scatter, processes)


def informations(readings: Readings, before: Before) -> FloatArray:
    """Return what each test, of a specimen each, tells of the material, (tests, d, m, m).

    NaN without a history. Of a thermal growth the amplitude is unknown, its time as expected. On
    the first rank, within ``readings.lead``.
    """
    problem, tests, (d, m) = readings.problem, readings.problem.experiments, before.draws.shape
    slopes = readings.slopes(before.draws)
    clocks, depths = random_wear(readings, np.tile(before.draws[d // 2], (len(tests), 1)))
    shares = np.array([
        noise.share or 0.5 * noise.scale if noise.size is None else np.sqrt(noise.size / depth)
        for noise, depth in zip(before.process, depths, strict=True)
    ])  # fmt: skip
    worse = STUDENT if problem.settings.loss == "student" else 1.0
    information = np.full((len(tests), d, m, m), np.nan)
    for number, (test, slope, of_test) in enumerate(zip(tests, slopes, clocks, strict=True)):
        if not np.isfinite(slope).all():
            continue
        setting = Setting.before(test)
        setting = replace(setting, clocks=of_test, sd=setting.sd / np.sqrt(worse))
        gram = np.zeros((d * m, d * m))
        for noise in TestLikelihood(test, setting, shares).noises:
            rows = slope[noise.rows].reshape(len(noise.rows), -1)
            times = [time.expected for one in noise.series if (time := one.growth_time)] or [1.0]
            distance = np.abs(np.log(np.maximum(noise.nuisances.times, 1e-300) / times[0]))
            gram += noise.reduced(rows, 0.0).grams()[distance.argmin()]
        alone = np.einsum("didj->dij", gram.reshape(d, m, d, m))
        scatter = before.scatter  # of the specimen's own values about the material's
        information[number] = np.linalg.solve(np.eye(m) + alone * scatter, alone)
    return information


def in_users_units(problem: Problem, before: Before) -> tuple[list[str], dict[str, Any]]:
    """Return the values of the keys in words, and of the sd of each a ``factor`` and its ``unit``.

    In the units of the file; sds of values whose logarithm is fitted are in percent.
    """
    about, scales = [], {}
    for p, value, sd in zip(
        before.parameters, before.values.tolist(), np.sqrt(before.scatter).tolist(), strict=True
    ):
        scale, unit = unit_scale(p), p.unit or units_of(problem)[p.key]
        unit = "" if unit == "1" else unit
        about.append(f"{p.key} = {value / scale:.4g} {unit}".rstrip())
        times, of_sd = (100.0 / value, "%") if p.log else (1.0 / scale, unit)
        scales[p.key] = {"factor": times, "unit": of_sd}
        if sd:
            size = f"{100.0 * sd if p.log else times * sd:.2g} {of_sd}".rstrip()
            about[-1] += f" of the material (specimens differ by {size})"
    return about, scales


def sds_in_words(sds: Mapping[str, float | None], scales: Mapping[str, Any]) -> list[str]:
    """Return standard deviations by key, None of one that is not identified, in words."""
    return [
        f"{key} not identified" if sd is None
        else f"{key} sd {scales[key]['factor'] * sd:.2g} {scales[key]['unit']}".rstrip()
        for key, sd in sds.items()
    ]  # fmt: skip


def expectation(problem: Problem, comm: MPI.Intracomm) -> str:
    """Return what the tests of a problem would tell, in lines: a dry run. Collective on comm."""
    readings, tests = Readings(problem, comm, StopSignals()), problem.experiments

    def lead() -> str:
        refuse_unfit(readings)
        before = before_tests(problem, None)
        there = replace(before, draws=problem.unknowns(before.values)[None])
        told = informations(readings, there).sum(axis=0)
        if not np.isfinite(told).all():
            raise ComputationError(f"{problem.name}: no history at the start: {readings.reason}")
        about, scales = in_users_units(problem, before)
        lines = [
            f"{problem.name}: {counted(sum(test.n for test in tests), 'reading')} in "
            f"{counted(len(tests), 'experiment')}; to be expected at {', '.join(about)} (nothing "
            "written):"
        ]
        covariance, sds = (
            np.linalg.inv(np.linalg.inv(before.covariance) + told[0]),
            before.sds(told),
        )
        for j, (sd, words) in enumerate(zip(sds.values(), sds_in_words(sds, scales), strict=True)):
            lines.append(f"  {words}" + f": {direction(problem, covariance, j, {})}" * (sd is None))
        if problem.alternatives:
            lines.append(f"to be compared: {', '.join(problem.alternatives)}")
        return "\n".join(lines)

    return readings.lead(lead)
