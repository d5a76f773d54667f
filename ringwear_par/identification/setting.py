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
    Problem,
    Series,
    body_of_wear,
)
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.likelihood import TestLikelihood
from ringwear_par.identification.noise import Setting
from ringwear_par.schedules import Table, in_time

#: relative difference of rates, and of measured inputs
_DIFFERENCE = 0.01


def needs_middle(problem: Problem) -> bool:
    """Tell whether the likelihoods of a problem depend on where the draws are."""
    settings, tests = problem.settings, problem.experiments
    return bool(settings.process) or settings.loss == "student" or any(
        test.torque_input or any(measured.scale for measured in test.inputs)
        or any(s.sd_fitted or s.censored is not None for s in test.series)
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
    shares : (bodies,) of random wear, where they are fitted.
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
    known = [noise.share for noise in process.values()]
    at = np.array([s if k is None else k for s, k in zip(shares, known, strict=True)])
    found = []
    for i, (test, setting, y) in enumerate(zip(tests, old, predicted, strict=True)):
        if np.isfinite(y).all():
            scales = _scales(readings, i, middle)
            now = replace(setting, clocks=tuple(clocks[i]), scales=scales)
            setting = TestLikelihood(test, now, at).adapted(y, settings.loss)
        found.append(setting)
    return found


def _read(
    readings: Readings,
    experiments: Sequence[Experiment],
    x: FloatArray,
    factors: tuple[float, float] = (1.0, 1.0),
    tests: Sequence[int] | None = None,
) -> list[FloatArray]:
    """Return the readings (n,) of tests in place of those of the problem, or of some of them.

    At unknowns (tests, m), by histories whose rates have factors.
    """
    problem, numbers = readings.problem, range(len(x)) if tests is None else tests
    readings.problem = replace(problem, experiments=tuple(experiments))
    every = readings([(i, x[i : i + 1]) for i in numbers], factors=factors)
    readings.problem = problem
    return [y[0] for y in every]


def _reading_too(test: Experiment, times: FloatArray, *quantities: str) -> Experiment:
    """Return a test in which more quantities are read, behind its own series."""
    more = (Series(f"{q} too", q, times, 0.0 * times, 0.0 * times + 1.0) for q in quantities)
    return replace(test, series=(*test.series, *more))


def _tell_friction(readings: Readings, x: FloatArray) -> None:
    """Tell friction by torques, at the radius where it acts in histories at unknowns (tests, m)."""
    experiments = list(readings.problem.experiments)
    if not any(test.torque_input for test in experiments):
        return
    grids = [step_times(test, readings.steps) for test in experiments]
    more = [_reading_too(test, at, "torque") for test, at in zip(experiments, grids, strict=True)]
    every = _read(readings, more, x)
    for i, (test, at, y) in enumerate(zip(experiments, grids, every, strict=True)):
        force, friction = test.case.load.force, test.case.friction
        if test.torque_input is None or force is None or not np.isfinite(y).all():
            continue
        normal = in_time(force, at)
        pressed = normal > 0.0
        radius = y[test.n :][pressed] / (in_time(friction, at) * normal)[pressed]
        table = Table(tuple(at[pressed].tolist()), tuple(radius.tolist()))
        experiments[i] = test.with_radius(table)
    readings.problem = replace(readings.problem, experiments=tuple(experiments))


def random_wear(
    readings: Readings, x: FloatArray
) -> tuple[list[list[tuple[FloatArray, FloatArray]]], FloatArray]:
    """Return the clocks of all tests at unknowns (tests, m), see ``Setting``, and depths (bodies,).

    The depths (mm) are the largest mean ones of all tests. On the first rank.
    """
    tests = readings.problem.experiments
    bodies = [body_of_wear(key) for key in readings.problem.settings.process]
    clocks: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in tests]
    depths = np.zeros(len(bodies))
    if not bodies:
        return clocks, depths
    volumes = [f"volume.{body}" for body in bodies]
    more = [_reading_too(test, test.times, *volumes) for test in tests]
    usual = _read(readings, more, x)
    for place, body in enumerate(bodies):
        lower, upper = (1.0 + _DIFFERENCE * (b == body) for b in BODIES)
        faster = _read(readings, more, x, (lower, upper))
        worn = [
            np.nan_to_num(y.reshape(-1, test.n)[1 + place]) / test.case.area
            for y, test in zip(usual, tests, strict=True)
        ]
        depths[place] = max(1e-300, *(depth.max() for depth in worn))
        for of_test, test, fast, slow, depth in zip(
            clocks, tests, faster, usual, worn, strict=True
        ):
            slope, share = np.nan_to_num(fast - slow)[: test.n] / _DIFFERENCE, depth / depths[place]
            felt = np.divide(slope, share, out=np.zeros_like(share), where=share > 0.0)
            of_test.append((felt, share))
    return clocks, depths


def _scales(readings: Readings, number: int, middle: FloatArray) -> tuple[FloatArray, ...]:
    """Return what the readings (n,) of a test gain by one sd of each input's calibration."""
    tests, columns = [*readings.problem.experiments], []
    test = tests[number]
    for measured in test.inputs:
        if measured.scale is None:
            continue
        mean, sd = measured.scale
        both = []
        for factor in (1.0 - _DIFFERENCE, 1.0 + _DIFFERENCE):
            changed = replace(measured, scale=measured.scale._replace(mean=factor * mean))
            inputs = tuple(changed if i is measured else i for i in test.inputs)
            tests[number] = replace(test, inputs=inputs)
            if not measured.of_torque:  # a larger force makes a friction less
                tests[number] = replace(tests[number], case=changed.applied(test.case))
            if test.torque_input is not None:
                tests[number] = tests[number].with_radius(test.torque_input.radius)
            both += _read(readings, tests, middle, tests=[number])
        columns.append((both[1] - both[0]) / (2.0 * _DIFFERENCE) * sd / mean)
    return tuple(columns)
