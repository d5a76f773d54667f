"""What the likelihoods of all tests take from the middle of the draws: by a few more histories.

Random wear and calibrations of measured inputs move readings along directions that hardly differ
among the draws: they are found by differences, at the middle. So is the radius at which friction
acts, by which a torque tells it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import (
    Experiment,
    Prior,
    Problem,
    Series,
    body_of_wear,
)
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.likelihood import TestLikelihood
from ringwear_par.identification.noise import Clocks, Setting
from ringwear_par.schedules import Table, in_time

#: relative difference of rates, and of measured inputs
_DIFFERENCE = 0.01


def needs_middle(problem: Problem) -> bool:
    """Tell whether the likelihoods of a problem depend on where the draws are."""
    settings, tests = problem.settings, problem.experiments
    return bool(settings.process) or settings.loss == "student" or any(
        test.inputs or any(s.sd_fitted or s.censored is not None for s in test.series)
        for test in tests
    )  # fmt: skip


def settings_at(
    readings: Readings, old: list[Setting], middle: FloatArray, shares: FloatArray
) -> list[Setting]:
    """Return the settings of all tests at unknowns (tests, m), the old ones without a history.

    ``readings.problem`` changes: torques tell friction anew there, and sizes of random wear that
    are known become shares of the depths there. On the first rank.

    Parameters
    ----------
    shares : (bodies,) of random wear.
    """
    _tell_friction(readings, middle)
    tests, settings = readings.problem.experiments, readings.problem.settings
    predicted = _read(readings, tests, middle)
    clocks, depths = random_wear(readings, middle)
    process = {
        key: replace(noise, share=float(np.sqrt(noise.size / depth))) if noise.size else noise
        for (key, noise), depth in zip(settings.process.items(), depths, strict=True)
    }
    readings.problem = replace(readings.problem, settings=replace(settings, process=process))
    found = []
    for i, (test, setting, y) in enumerate(zip(tests, old, predicted, strict=True)):
        if np.isfinite(y).all():
            now = replace(setting, clocks=clocks[i], scales=_scales(readings, test, middle[i]))
            setting = TestLikelihood(test, now, shares).adapted(y, settings.loss)
        found.append(setting)
    return found


def _read(
    readings: Readings,
    tests: Sequence[Experiment],
    x: FloatArray,
    factors: tuple[float, float] = (1.0, 1.0),
) -> list[FloatArray]:
    """Return the readings (n,) of tests at unknowns (tests, m), by rates that have factors."""
    wanted = [(i, x[i : i + 1]) for i in range(len(tests))]
    return [y for (y,) in readings(wanted, experiments=tests, factors=factors)]


def _reading_too(test: Experiment, times: FloatArray, *quantities: str) -> Experiment:
    """Return a test in which more quantities are read, behind its own series."""
    more = (Series(f"{q} too", q, times, 0.0 * times, 0.0 * times + 1.0) for q in quantities)
    return replace(test, series=(*test.series, *more))


def _tell_friction(readings: Readings, x: FloatArray) -> None:
    """Tell friction by torques, at the radius where it acts in histories at unknowns (tests, m)."""
    tests = [*readings.problem.experiments]
    told = [i for i, test in enumerate(tests) if test.torque_input is not None]
    if not told:
        return
    grids = [step_times(tests[i], readings.steps) for i in told]
    more = [_reading_too(tests[i], at, "torque") for i, at in zip(told, grids, strict=True)]
    for i, at, y in zip(told, grids, _read(readings, more, x[told]), strict=True):
        force, friction = tests[i].case.load.force, tests[i].case.friction
        if force is None or not np.isfinite(y).all():
            continue
        normal = in_time(force, at)
        pressed = normal > 0.0
        radius = y[tests[i].n :][pressed] / (in_time(friction, at) * normal)[pressed]
        tests[i] = tests[i].with_radius(Table(tuple(at[pressed].tolist()), tuple(radius.tolist())))
    readings.problem = replace(readings.problem, experiments=tuple(tests))


def random_wear(readings: Readings, x: FloatArray) -> tuple[list[Clocks], FloatArray]:
    """Return the clocks of all tests at unknowns (tests, m), see ``Setting``, and depths (bodies,).

    The depths (mm) are the largest mean ones of all tests. On the first rank.
    """
    tests = readings.problem.experiments
    bodies = [body_of_wear(key) for key in readings.problem.settings.process]
    if not bodies:
        return [()] * len(tests), np.zeros(0)
    volumes = [f"volume.{body}" for body in bodies]
    more = [_reading_too(test, test.times, *volumes) for test in tests]
    usual, greater = _read(readings, more, x), 1.0 + _DIFFERENCE
    rates = [(greater, 1.0) if body == BODIES[0] else (1.0, greater) for body in bodies]
    faster = [_read(readings, more, x, factors) for factors in rates]
    worn = [
        np.nan_to_num(y[test.n :].reshape(-1, test.n)) / test.case.area
        for test, y in zip(tests, usual, strict=True)
    ]
    depths = np.maximum(np.max([depth.max(axis=1) for depth in worn], axis=0), 1e-300)
    clocks: list[Clocks] = []
    for y, depth, *of_bodies in zip(usual, worn, *faster, strict=True):
        shares = depth / depths[:, None]
        slopes = np.nan_to_num(np.array(of_bodies) - y)[:, : shares.shape[1]] / _DIFFERENCE
        felt = np.divide(slopes, shares, out=np.zeros_like(shares), where=shares > 0.0)
        clocks.append(tuple(zip(felt, shares, strict=True)))
    return clocks, depths


def _scales(readings: Readings, test: Experiment, x: FloatArray) -> tuple[FloatArray, ...]:
    """Return what the readings (n,) of a test gain by one sd of each input's calibration."""
    columns = []
    for measured in test.inputs:
        if measured.scale is None:
            continue
        (mean, sd), both = measured.scale, []
        for factor in (1.0 - _DIFFERENCE, 1.0 + _DIFFERENCE):
            changed = replace(measured, scale=Prior(factor * mean, sd))
            inputs = tuple(changed if i is measured else i for i in test.inputs)
            # a larger force makes a friction less
            case = test.case if measured.of_torque else changed.applied(test.case)
            other, torque = replace(test, inputs=inputs, case=case), test.torque_input
            both.append(other if torque is None else other.with_radius(torque.radius))
        less, more = _read(readings, both, np.array([x, x]))
        columns.append((more - less) / (2.0 * _DIFFERENCE) * sd / mean)
    return tuple(columns)
