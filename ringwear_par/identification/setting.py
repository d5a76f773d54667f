"""What the likelihoods of all tests take from the middle of the draws: by a few more histories.

Random wear and calibrations of measured inputs move readings along directions that hardly differ
among the draws: they are found by differences, at the middle.
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
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.likelihood import Setting, TestLikelihood
from ringwear_par.schedules import points_of

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
        or any(s.sd_fitted or s.growth_time or s.censored is not None for s in series)
    )


def settings_at(
    readings: Readings, old: list[Setting], middle: FloatArray, shares: FloatArray, *, first: bool
) -> list[Setting]:
    """Return the settings of all tests at unknowns (tests, m), the old ones without a history.

    Friction is told anew by torques there: ``readings.problem`` changes. On the first rank.

    Parameters
    ----------
    shares : (bodies,) of random wear.
    first : whether this is but the best of some draws, which does not tell outliers.
    """
    if any(test.torque_input for test in readings.problem.experiments):
        readings.problem = readings.with_friction_at(middle)
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
        if not np.isfinite(predicted[i]).all():
            settings.append(old[i])
            continue
        setting = replace(
            old[i], clocks=tuple(clocks[i]), shares=known, scales=_scales(readings, i, middle)
        )
        adapted = TestLikelihood(test, setting, shares).adapted(predicted[i], problem.settings.loss)
        settings.append(replace(adapted, sd=setting.sd) if first else adapted)
    return settings


def random_wear(
    readings: Readings, x: FloatArray
) -> tuple[list[list[tuple[FloatArray, FloatArray]]], FloatArray]:
    """Return the clocks of all tests at unknowns (tests, m), see ``Setting``, and depths (bodies,).

    The depths (mm) are the largest mean ones of all tests. On the first rank.
    """
    problem, tests = readings.problem, readings.problem.experiments
    bodies = [BODIES.index(body_of_wear(key)) for key in problem.settings.process]
    if not bodies:
        return [[] for _ in tests], np.zeros(0)
    readings.problem = replace(problem, experiments=tuple(_with_volumes(t, bodies) for t in tests))
    wanted = [(i, x[i : i + 1]) for i in range(len(tests))]
    usual = [y[0] for y in readings(wanted)]
    slopes, worn = [], []
    for place, body in enumerate(bodies):
        factors = tuple(1.0 + _DIFFERENCE * (b == body) for b in range(len(BODIES)))
        faster = [y[0] for y in readings(wanted, factors=(factors[0], factors[1]))]
        slopes.append(
            [(f - u)[: t.n] / _DIFFERENCE for f, u, t in zip(faster, usual, tests, strict=True)]
        )
        worn.append(
            [
                u[(1 + place) * t.n : (2 + place) * t.n] / t.case.area
                for u, t in zip(usual, tests, strict=True)
            ]
        )
    readings.problem = problem
    depths = np.array([max((np.nanmax(d, initial=1e-300) for d in w), default=0.0) for w in worn])
    clocks: list[list[tuple[FloatArray, FloatArray]]] = []
    for i in range(len(tests)):
        clocks.append([])
        for slope, depth, most in zip(slopes, worn, depths, strict=True):
            share = np.nan_to_num(depth[i]) / most
            felt = np.divide(slope[i], share, out=np.zeros_like(share), where=share > 0.0)
            clocks[i].append((np.nan_to_num(felt), share))
    return clocks, depths


def _with_volumes(test: Experiment, bodies: list[int]) -> Experiment:
    """Return a test that has volumes worn off some bodies, too, at the times of all readings."""
    more = [
        Series(
            f"volume beside {BODIES[b]}",
            f"volume.{BODIES[b]}",
            test.times,
            np.zeros(test.n),
            np.ones(test.n),
        )
        for b in bodies
    ]
    return replace(test, series=(*test.series, *more))


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
