"""What instruments would read of a history: the model of each series, and its nuisances.

Readings lie between steps: splines in time over them, and over the contact elements in radius, cost
no contact solution. Where a schedule bends, one spline ends and another begins.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import (
    Experiment,
    Nuisance,
    Series,
    friction_power,
)
from ringwear_par.identification.definition.reading_kinds import READING_KINDS, Trajectory
from ringwear_par.results.result import Result
from ringwear_par.schedules import in_time

#: share of a segment's length within which steps are equal; beyond it their logarithms are
_EARLY = 5e-4
#: grids of steps whose weights are kept
_GRIDS = 4
#: relative difference below which times are the same
_CLOSE = 1e-9
#: lengths of the test: a layer that lasts longer is not worn through
_NEVER = 1e6


class TimeInterpolation:
    """Values at times ``at`` (t,), s, of those at the ends (s,) of steps, the breaks among them."""

    def __init__(self, time: FloatArray, at: FloatArray, breaks: Sequence[float]) -> None:
        self._count = len(at)
        self._parts: list[tuple[IntArray, IntArray, FloatArray]] = []
        for low, high in itertools.pairwise(breaks):
            close = _CLOSE * breaks[-1]
            steps = np.flatnonzero((time >= low - close) & (time <= high + close))
            rows = np.flatnonzero((at >= low) & (at <= high + close))
            if not len(rows):
                continue
            step_coordinates, coordinates = (
                np.log1p(np.clip(t - low, 0.0, high - low) / (_EARLY * (high - low)))
                for t in (time[steps], at[rows])
            )
            units = np.eye(len(steps))
            if len(steps) > 3:
                weights = CubicSpline(step_coordinates, units)(coordinates)
            else:
                weights = np.stack(
                    [np.interp(coordinates, step_coordinates, unit) for unit in units], axis=1
                )
            self._parts.append((rows, steps, weights))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return values (s, ...) at the other times, (t, ...)."""
        result = np.empty((self._count, *values.shape[1:]))
        for wanted, steps, weights in self._parts:
            result[wanted] = np.tensordot(weights, values[steps], axes=1)
        return result


class Reader:
    """Reads all series of an experiment, whose case may have other values of the fitted keys."""

    def __init__(self, experiment: Experiment) -> None:
        case = experiment.case
        self._series = experiment.series
        self._breaks = (0.0, *case.breakpoints, case.time.end)
        self._radial = {s.name: _radial(s, case) for s in self._series if s.profile}
        # histories share their steps
        self._steps: dict[bytes, dict[str, TimeInterpolation]] = {}

    def read(self, trajectory: Trajectory) -> FloatArray:
        """Return the readings (n,) of all series, one after another, without nuisances."""
        time = trajectory.time
        key = time.tobytes()
        if key not in self._steps:
            at = {s.name: np.array([s.at]) if s.profile else s.x for s in self._series}
            if len(self._steps) == _GRIDS:
                self._steps.clear()
            self._steps[key] = {
                name: TimeInterpolation(time, t, self._breaks) for name, t in at.items()
            }
        steps = self._steps[key]
        return np.concatenate([self._of(s, trajectory, steps[s.name]) for s in self._series])

    def _of(
        self, series: Series, trajectory: Trajectory, in_steps: TimeInterpolation
    ) -> FloatArray:
        body = BODIES.index(series.body)
        if series.profile:
            return self._radial[series.name] @ in_steps(trajectory.wear[body])[0]
        if series.kind == "through":
            return trajectory.through[[body]]
        values = READING_KINDS[series.kind].values
        assert values is not None
        return in_steps(values(trajectory, body, series.density))


def _radial(series: Series, case: Case) -> FloatArray:
    """Return (n, elements) what points of a profile are of depths of elements; 0 beyond them."""
    a, b = case.contact
    mid_points = case.line.r
    close = _CLOSE * b
    inside = (series.x >= a - close) & (series.x <= b + close)
    # the outermost half elements are thinner than any stylus
    r = np.clip(series.x[inside], mid_points[0], mid_points[-1])
    weights = np.zeros((series.n, len(mid_points)))
    weights[inside] = CubicSpline(mid_points, np.eye(len(mid_points)))(r)
    return weights


def growth(nuisance: Nuisance, case: Case, t: FloatArray, time: float) -> FloatArray:
    """Return the share of its growth that a warm rig has at t (n,) s.

    It is cold at first, and follows its heat by time g' = heat - g (s): a step of it at the start,
    and each change of its slope. The heat is 1, or goes with the friction power where the nuisance
    has ``power``.
    """
    starts, heat = friction_power(case) if nuisance.power else (np.zeros(1), np.ones(1))
    heat = heat / heat.max()
    slopes = np.diff(np.append(np.diff(heat) / np.diff(starts), 0.0), prepend=0.0)
    grown = -heat[0] * np.expm1(-t / time)
    for start, slope in zip(starts, slopes, strict=True):
        since = np.maximum(t - start, 0.0)
        grown = grown + slope * (since + time * np.expm1(-since / time))
    return grown


def nuisance_columns(series: Series, case: Case) -> FloatArray:
    """Return (n, nuisances) what a unit of each linear nuisance adds to readings of a series.

    The offset and the level are constant; the drift grows to 1 at the end of the test; the
    compliance goes with the load in kN (of a penetration with its change since the start); the tilt
    with the distance in mm from the middle of the contact.
    """
    columns = []
    for nuisance in series.linear_nuisances:
        if nuisance.kind == "drift":
            column = series.x / case.time.end
        elif nuisance.kind == "compliance":
            assert case.load.force is not None
            start = 0.0 if series.quantity == "approach" else in_time(case.load.force, 0.0)
            column = 1e-3 * (in_time(case.load.force, series.x) - start)
        elif nuisance.kind == "tilt":
            column = series.x - 0.5 * sum(case.contact)
        else:
            column = np.ones(series.n)
        columns.append(series.factor * column)
    return np.stack(columns, axis=1) if columns else np.zeros((series.n, 0))


def time_through(case: Case, body: int, time: FloatArray, wear: FloatArray) -> float:
    """Return when (s) the first layer of lower (0) or upper (1) is worn through anywhere.

    From worn depths (s, n) mm, by the rate of the last step before it, or of the last one of all;
    NaN of a body without layers.
    """
    if not case.rings[body].layers:
        return np.nan
    end, places = case.layer_ends(body)[0], np.arange(wear.shape[1])
    steps = np.maximum((wear < end).sum(axis=0) - 1, 1)
    last, before = wear[steps, places], wear[steps - 1, places]
    rate = (last - before) / (time[steps] - time[steps - 1])
    wearing = rate > 0.0
    if not wearing.any():
        return float(_NEVER * time[-1])
    return float((time[steps] + (end - last) / np.where(wearing, rate, 1.0))[wearing].min())


def lost_mass(case: Case, body: int, wear: FloatArray) -> FloatArray:
    """Return the mass (g) that layers and body of lower (0) or upper (1) have lost, (s,).

    By worn depths (s, n) mm. NaN where a density is not known, and of a body without layers, whose
    volume tells it.
    """
    ring = case.rings[body]
    if not ring.layers or None in ring.densities:
        return np.full(len(wear), np.nan)
    densities = np.array(ring.densities, dtype=float)
    depth = densities[-1] * wear  # of mass
    more = densities[:-1] - densities[1:]
    for end, density in zip(case.layer_ends(body), more, strict=True):
        depth = depth + density * np.minimum(wear, end)
    return depth @ case.line.area


def trajectory(result: Result, case: Case) -> Trajectory:
    """Return what is read of a history."""
    histories = result.histories
    time = histories["time"]
    wear = np.stack([result.profiles[f"wear_{body}"] for body in BODIES])
    return Trajectory(
        time, histories["approach"], histories["torque"],
        np.stack([histories[f"worn_volume_{body}"] for body in BODIES]), wear,
        np.stack([lost_mass(case, i, depths) for i, depths in enumerate(wear)]),
        np.array([time_through(case, i, time, depths) for i, depths in enumerate(wear)]),
    )  # fmt: skip
