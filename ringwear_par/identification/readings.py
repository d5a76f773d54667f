"""What instruments would read of histories: the model of each series.

Readings lie between steps: splines in time over them, and over the contact elements in radius, cost
no contact solution. Where a schedule bends, one spline ends and another begins.
"""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import READING_KINDS, Experiment, Series

#: share of a segment's length within which steps are equal; beyond it their logarithms are
_EARLY = 5e-4
#: relative difference below which times are the same
_CLOSE = 1e-9
#: lengths of the test: a layer that lasts longer is not worn through
_NEVER = 1e6


def read(
    experiment: Experiment, cases: Sequence[Case], data: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the readings (B, n) of all series, one after another, without nuisances.

    Parameters
    ----------
    cases : (B,) that of the experiment, with other values of the fitted keys.
    data : (B, steps, ...) each, the variables of their histories by name.
    """
    case, time, readings = experiment.case, data["time"][0], []
    breaks = (0.0, *case.breakpoints, case.time.end)
    for series in experiment.series:
        variable, body = READING_KINDS[series.kind].variable, series.body
        if variable is not None:
            values = _in_time(case, variable, series, data)
            readings.append(values @ interpolation(time, series.x, breaks).T)
        elif series.at is not None:
            wear = interpolation(time, np.array([series.at]), breaks) @ data[f"wear_{body}"]
            readings.append(_radial(series, case, wear[:, 0]))
        else:
            readings.append(times_through(cases, body, time, data[f"wear_{body}"])[:, None])
    return np.concatenate(readings, axis=1)


def _in_time(
    case: Case, variable: str, series: Series, data: Mapping[str, FloatArray]
) -> FloatArray:
    """Return what a series reads at the ends of steps, (B, steps)."""
    if not READING_KINDS[series.kind].of_body:
        return data[variable]
    if series.density is not None:
        return series.density * data[f"{variable}_{series.body}"]
    densities = case.rings[BODIES.index(series.body)].densities
    mass: FloatArray = data[f"{variable}_{series.body}_layers"] @ np.array(densities, dtype=float)
    return mass


def interpolation(time: FloatArray, at: FloatArray, breaks: Sequence[float]) -> FloatArray:
    """Return weights (t, s) of values at the ends (s,) of steps for values at times (t,), s.

    Parameters
    ----------
    breaks : s, where a spline ends and another begins; steps end there.
    """
    weights, close = np.zeros((len(at), len(time))), _CLOSE * breaks[-1]
    for low, high in itertools.pairwise(breaks):
        steps = np.flatnonzero((time >= low - close) & (time <= high + close))
        rows = np.flatnonzero((at >= low) & (at <= high + close))
        if len(rows):
            there, wanted = (
                np.log1p(np.clip(t - low, 0.0, high - low) / (_EARLY * (high - low)))
                for t in (time[steps], at[rows])
            )
            weights[rows] = 0.0  # a time at a break is the next spline's
            weights[np.ix_(rows, steps)] = CubicSpline(there, np.eye(len(steps)))(wanted)
    return weights


def _radial(series: Series, case: Case, wear: FloatArray) -> FloatArray:
    """Return the points (B, n) of a profile by depths (B, elements); 0 beyond the contact."""
    (a, b), mid_points = case.contact, case.line.r
    close = _CLOSE * b
    inside = (series.x >= a - close) & (series.x <= b + close)
    # the outermost half elements are thinner than any stylus
    r = np.clip(series.x, mid_points[0], mid_points[-1])
    depths: FloatArray = CubicSpline(mid_points, wear, axis=1)(r) * inside
    return depths


def times_through(
    cases: Sequence[Case], body: str, time: FloatArray, wear: FloatArray
) -> FloatArray:
    """Return when (B,) s the first layer of a body is worn through anywhere.

    From worn depths (B, s, n) mm, by the rate of the last step before it, or of the last one of
    all.
    """
    end = np.array([case.layer_ends(BODIES.index(body))[0] for case in cases])
    steps = np.maximum((wear < end[:, None]).sum(axis=1, keepdims=True) - 1, 1)
    last, before = (np.take_along_axis(wear, i, 1)[:, 0] for i in (steps, steps - 1))
    steps = steps[:, 0]
    rate = (last - before) / (time[steps] - time[steps - 1])
    left = np.divide(end - last, rate, out=np.full_like(rate, np.inf), where=rate > 0.0)
    through: FloatArray = np.minimum((time[steps] + left).min(axis=1), _NEVER * time[-1])
    return through
