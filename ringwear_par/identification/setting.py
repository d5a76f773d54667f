"""What the likelihoods of all tests take from the middle of the draws: by a few more histories.

Random wear and calibrations of measured inputs move readings along directions that hardly differ
among the draws: they are found by differences, at the middle. So is the radius at which friction
acts, by which a torque tells it.
"""

from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import (
    Experiment,
    MeasuredInput,
    Problem,
    Series,
    body_of_wear,
)
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.likelihood import TestLikelihood
from ringwear_par.identification.noise import Setting
from ringwear_par.schedules import Table, in_time, points_of

#: relative difference of rates, and of measured inputs
_DIFFERENCE = 0.01


def needs_middle(problem: Problem) -> bool:
    """Tell whether the likelihoods of a problem depend on where the draws are."""
    tests = problem.experiments
    series = [series for test in tests for series in test.series]
    return bool(
        problem.settings.process
        or problem.settings.loss == "student"
        or any(test.torque_input or any(i.scale for i in test.inputs) for test in tests)
        or any(s.sd_fitted or s.censored is not None for s in series)
    )


def settings_at(
    readings: Readings, old: list[Setting], middle: FloatArray, shares: FloatArray
) -> list[Setting]:
    """Return the settings of all tests at unknowns (tests, m), the old ones without a history.

    Friction is told anew by torques there: ``readings.problem`` changes. On the first rank.

    Parameters
    ----------
    shares : (bodies,) of random wear.
    """
    _tell_friction(readings, middle)
    problem = readings.problem
    predicted = [y[0] for y in readings([(i, x[None]) for i, x in enumerate(middle)])]
    clocks, depths = random_wear(readings, middle)
    known = np.array(
        [
            np.nan if process.fitted else process.share or np.sqrt((process.size or 0.0) / depth)
            for process, depth in zip(problem.settings.process.values(), depths, strict=True)
        ]
    )
    shares = np.where(np.isnan(known), shares, known)
    settings = []
    for i, test in enumerate(problem.experiments):
        setting = old[i]
        if np.isfinite(predicted[i]).all():
            scales = _scales(readings, i, middle)
            setting = replace(setting, clocks=tuple(clocks[i]), shares=known, scales=scales)
            likelihood = TestLikelihood(test, setting, shares)
            setting = likelihood.adapted(predicted[i], problem.settings.loss)
        settings.append(setting)
    return settings


def _read_beside(
    readings: Readings, x: FloatArray, more: list[list[Series]], factors: tuple[float, float]
) -> list[FloatArray]:
    """Return the readings (n,) of all tests, and behind them of more series of each.

    At unknowns (tests, m), by histories whose rates have factors.
    """
    problem = readings.problem
    tests = zip(problem.experiments, more, strict=True)
    experiments = tuple(replace(t, series=(*t.series, *of_test)) for t, of_test in tests)
    readings.problem = replace(problem, experiments=experiments)
    every = readings([(i, x[i : i + 1]) for i in range(len(x))], factors=factors)
    readings.problem = problem
    return [y[0] for y in every]


def _beside(quantity: str, x: FloatArray) -> Series:
    return Series(f"{quantity} beside", quantity, x, np.zeros(len(x)), np.ones(len(x)))


def _tell_friction(readings: Readings, x: FloatArray) -> None:
    """Tell friction by torques, at the radius where it acts in histories at unknowns (tests, m)."""
    experiments = list(readings.problem.experiments)
    if not any(test.torque_input for test in experiments):
        return
    grids = [step_times(test, readings.steps) for test in experiments]
    more = [[_beside("torque", at)] for at in grids]
    every = _read_beside(readings, x, more, (1.0, 1.0))
    for i, (test, at, y) in enumerate(zip(experiments, grids, every, strict=True)):
        force, friction = test.case.load.force, test.case.friction
        if test.torque_input is None or force is None or not np.isfinite(y).all():
            continue
        torque, normal = y[test.n :], in_time(force, at)
        radius = torque / np.where(normal > 0.0, in_time(friction, at) * normal, 1.0)
        table = Table(tuple(at[normal > 0.0].tolist()), tuple(radius[normal > 0.0].tolist()))
        experiments[i] = test.with_radius(table)
    readings.problem = replace(readings.problem, experiments=tuple(experiments))


def random_wear(
    readings: Readings, x: FloatArray
) -> tuple[list[list[tuple[FloatArray, FloatArray]]], FloatArray]:
    """Return the clocks of all tests at unknowns (tests, m), see ``Setting``, and depths (bodies,).

    The depths (mm) are the largest mean ones of all tests. On the first rank.
    """
    tests = readings.problem.experiments
    bodies = [BODIES.index(body_of_wear(key)) for key in readings.problem.settings.process]
    clocks: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in tests]
    if not bodies:
        return clocks, np.zeros(0)
    more = [[_beside(f"volume.{BODIES[b]}", test.times) for b in bodies] for test in tests]
    usual = _read_beside(readings, x, more, (1.0, 1.0))
    depths = np.zeros(len(bodies))
    for place, body in enumerate(bodies):
        lower, upper = (1.0 + _DIFFERENCE * (b == body) for b in range(len(BODIES)))
        faster = _read_beside(readings, x, more, (lower, upper))
        worn = [
            np.nan_to_num(y.reshape(-1, test.n)[1 + place]) / test.case.area
            for y, test in zip(usual, tests, strict=True)
        ]
        depths[place] = max(max(float(depth.max()) for depth in worn), 1e-300)
        for i, test in enumerate(tests):
            slope = np.nan_to_num(faster[i] - usual[i])[: test.n] / _DIFFERENCE
            share = worn[i] / depths[place]
            felt = np.divide(slope, share, out=np.zeros_like(share), where=share > 0.0)
            clocks[i].append((felt, share))
    return clocks, depths


def _scales(readings: Readings, number: int, middle: FloatArray) -> tuple[FloatArray, ...]:
    """Return what the readings (n,) of a test gain by one sd of each input's calibration."""
    problem, test = readings.problem, readings.problem.experiments[number]
    columns = []
    for measured in test.inputs:
        if measured.scale is None:
            continue
        both = []
        for sign in (-1.0, 1.0):
            changed = _with_input(test, measured, 1.0 + sign * _DIFFERENCE)
            tests = [changed if t is test else t for t in problem.experiments]
            readings.problem = replace(problem, experiments=tuple(tests))
            both.append(readings([(number, middle[number : number + 1])])[0][0])
        slope = (both[1] - both[0]) / (2.0 * _DIFFERENCE)
        columns.append(slope * measured.scale.sd / measured.scale.mean)
    readings.problem = problem
    return tuple(columns)


def _with_input(test: Experiment, measured: MeasuredInput, factor: float) -> Experiment:
    """Return a test whose measured input is larger by a factor: a force makes a friction less."""
    assert measured.scale is not None
    scale = measured.scale._replace(mean=factor * measured.scale.mean)
    inputs = tuple(replace(i, scale=scale) if i is measured else i for i in test.inputs)
    changed = replace(test, inputs=inputs)
    if not measured.of_torque:
        curve = points_of(replace(measured, scale=scale).curve(test.case))
        changed = replace(changed, case=changed.case.replace({measured.key: curve}))
    torque = changed.torque_input
    return changed if torque is None else changed.with_radius(torque.radius)
