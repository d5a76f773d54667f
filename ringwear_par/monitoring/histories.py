"""Histories of a running test as polynomials of its keys, and its readings from them.

Polynomials tell a history at the ends of steps; readings, whenever they come, lie between these.
"""

from collections.abc import Hashable
from dataclasses import dataclass, replace

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.problem import (
    Experiment,
    Loss,
    Problem,
    Series,
    records,
)
from ringwear_par.identification.definition.reading_kinds import READING_KINDS, Trajectory
from ringwear_par.identification.emulator import Box, Emulator, emulate, nearness
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.likelihood import Setting
from ringwear_par.identification.readings import TimeInterpolation
from ringwear_par.identification.setting import needs_middle, settings_at

#: histories that polynomials are made of by the number of fitted keys, and most of them
_HISTORIES, _MOST_HISTORIES = {1: 64, 2: 192, 3: 320}, 448
#: draws that a box is about, and its margin
_BOXED, _MARGIN = 10_000, 0.1
#: scale of a quantity over its spread, and error of polynomials in it that is small enough
_SCALE, _CLOSE = 1e-3, 0.03
#: share of random wear where clocks are found, which hardly depend on it
_SHARE = 0.05


def frame_of(problem: Problem) -> tuple[Hashable, ...]:
    """Return all of a problem of one test but its readings over time, which histories are for."""
    (test,) = problem.experiments
    fixed = (s.x.tobytes() for s in test.series if READING_KINDS[s.kind].values is None)
    return (problem.text, test.case.text, *fixed)


def part_of(test: Experiment, rows: BoolArray) -> Experiment:
    """Return a test with some of its readings (n,), without series that their nuisances explain."""
    parts = [series.part(rows[place]) for series, place in records(test.series)]
    informative = (
        s for s in parts if s.n > sum(n.free for n in s.nuisances) * (s.censored is None)
    )
    return replace(test, series=tuple(informative))


@dataclass(frozen=True, eq=False)
class Histories:
    """Histories of a test at unknowns of its keys, from which its readings are taken."""

    #: its approach, torque, volumes and masses at the ends of steps; profiles and times at which
    #: layers are worn through, as they are read
    plan: Experiment
    #: of the readings of the plan
    emulator: Emulator
    #: how these follow random wear and the calibration of measured inputs
    setting: Setting
    #: (1 + r,) 1 and the coordinates of the history at the middle of the draws
    middle: FloatArray

    @classmethod
    def of(cls, readings: Readings, problem: Problem, x: FloatArray) -> "Histories":
        """Return the histories of a problem of one test at draws (s, m). On the first rank.

        Raises
        ------
        ComputationError : hardly any draw has a history.
        """
        (test,), bodies = problem.experiments, len(problem.settings.process)
        plan, middle = _plan(test), np.median(x, axis=0)
        readings.problem = replace(problem, experiments=(plan,))
        settings = [Setting.before(plan, bodies=bodies)]
        if needs_middle(readings.problem):
            shares = np.full(bodies, _SHARE)
            settings = settings_at(readings, settings, middle[None], shares, first=True)
        box = Box.about(x[:_BOXED], *problem.unknown_bounds, _MARGIN)
        count = _HISTORIES.get(x.shape[1], _MOST_HISTORIES)
        points = np.concatenate([box.design(count - count // 3), x[: count // 3]])
        points = points[box.holds(points)]
        (y,) = readings([(0, points)])
        good = np.isfinite(y).all(axis=1)
        if good.sum() < 2 * x.shape[1] + 2:
            reason = f"hardly any draw has a history: {readings.reason}"
            raise ComputationError(f"{problem.name}: {reason}")
        sd = y[good].std(axis=0)
        for _, part in records(plan.series):
            sd[part] = sd[part].max() or 1.0
        root = np.linalg.cholesky(np.atleast_2d(np.cov(x.T)))
        distance = np.linalg.norm(np.linalg.solve(root, (points[good] - middle).T), axis=0)
        emulator, _ = emulate(box, points, y, _SCALE * sd, nearness(distance), _CLOSE)
        return cls(plan, emulator, settings[0], np.append(1.0, emulator.coordinates(middle[None])))

    @property
    def error(self) -> float:
        """Largest rms error of a quantity, over its spread among the draws."""
        return _SCALE * self.emulator.error

    @property
    def columns(self) -> FloatArray:
        """Readings (n, 1 + r) of the plan by 1 and the coordinates."""
        return np.column_stack([self.emulator.mean, self.emulator.modes.T])

    @property
    def time(self) -> FloatArray:
        """(steps,) s, ends of steps, the start included."""
        return self.plan.series[0].x

    def at_steps(self, quantity: str) -> FloatArray:
        """Return (steps, 1 + r) a quantity by 1 and the coordinates; "depth" is mean, in mm."""
        volume = quantity.replace("depth", "volume")
        part = self._parts(self.columns)[f"all {volume}"]
        return part if volume == quantity else part / self.plan.case.area

    def _parts(self, columns: FloatArray) -> dict[str, FloatArray]:
        """Return readings (n, ...) of the plan by the names of its series."""
        return {series.name: columns[part] for series, part in records(self.plan.series)}

    def read(self, columns: FloatArray, test: Experiment) -> FloatArray:
        """Return the readings (n, ...) of a test by those of the plan."""
        parts, nothing = self._parts(columns), np.full((len(self.time), *columns.shape[1:]), np.nan)
        volume, mass = (
            np.stack([parts.get(f"all {quantity}.{body}", nothing) for body in BODIES])
            for quantity in ("volume", "mass")
        )
        history = Trajectory(
            self.time, parts["all approach"], parts["all torque"], volume, nothing, mass, nothing
        )
        breaks, readings = (0.0, *test.case.breakpoints, test.case.time.end), []
        for series in test.series:
            values = READING_KINDS[series.kind].values
            if values is None:
                readings.append(parts[series.name])
            else:
                between = TimeInterpolation(self.time, series.x, breaks)
                read = values(history, BODIES.index(series.body), series.density)
                readings.append(between(read))
        return np.concatenate(readings)

    def emulator_of(self, test: Experiment) -> Emulator:
        """Return the emulator of the readings of a test."""
        both = self.read(self.columns, test)
        return replace(self.emulator, mean=both[:, 0], modes=both[:, 1:].T)

    def setting_of(self, test: Experiment, loss: Loss) -> Setting:
        """Return the setting of a test before its readings are looked at."""
        clocks = []
        for felt, share in self.setting.clocks:
            depth = np.interp(test.times, self.time, share[: len(self.time)])
            answer = self.read(felt * share, test)
            slope = np.divide(answer, depth, out=np.zeros_like(depth), where=depth > 0.0)
            clocks.append((slope, depth))
        scales = tuple(self.read(scale, test) for scale in self.setting.scales)
        before = Setting.before(test, loss, len(clocks))
        return replace(before, clocks=tuple(clocks), scales=scales)


def _plan(test: Experiment) -> Experiment:
    """Return a test whose readings are all of a history that others are taken from."""
    times = np.append(0.0, step_times(test))
    quantities = ["approach", "torque", *(f"volume.{body}" for body in BODIES)]
    for body, ring in zip(BODIES, test.case.rings, strict=True):
        quantities += [f"mass.{body}"] * (bool(ring.layers) and None not in ring.densities)
    zero, one = np.zeros(len(times)), np.ones(len(times))
    series = [Series(f"all {q}", q, times, zero, one, density=None) for q in quantities]
    fixed = [s for s in test.series if READING_KINDS[s.kind].values is None]
    return replace(test, series=(*series, *fixed))
