"""Nuisances of readings: offsets, drifts, the thermal growth of a rig; what is known of them.

All are linear but the time of a thermal growth, which is at nodes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.errors import InputError, legible
from ringwear_par.identification.definition.problem import (
    Experiment,
    Nuisance,
    Series,
    friction_power,
    records,
)
from ringwear_par.schedules import in_time

#: sd of a nuisance without a prior, over the largest reading; that of a growth, over their range
_WIDE, _WIDE_GROWTH = 1e4, 100.0
#: sd of the prior of a growth time within which its nodes are
_PRIOR_SDS = 4.5
#: (nodes, weights) by their number
_nodes = cache(leggauss)


def growth(nuisance: Nuisance, case: Case, t: FloatArray, times: FloatArray) -> FloatArray:
    """Return the share (K, n) of its growth that a warm rig has at t (n,) s, by growth times (K,).

    It is cold at first, and follows its heat by time g' = heat - g (s): a step of it at the start,
    and each change of its slope. The heat is 1, or goes with the friction power where the nuisance
    has ``power``.
    """
    starts, heat = friction_power(case) if nuisance.power else (np.zeros(1), np.ones(1))
    heat, times = heat / heat.max(), times[:, None]
    slopes = np.diff(np.append(np.diff(heat) / np.diff(starts), 0.0), prepend=0.0)
    grown = -heat[0] * np.expm1(-t / times)
    for start, slope in zip(starts, slopes, strict=True):
        since = np.maximum(t - start, 0.0)
        grown = grown + slope * (since + times * np.expm1(-since / times))
    return grown


def nuisance_columns(series: Series, case: Case, times: FloatArray) -> FloatArray:
    """Return what a unit of each linear nuisance adds to readings of a series, (K, n, nuisances).

    The offset and the level are constant; the drift grows to 1 at the end of the test; the
    compliance goes with the load in kN (of a penetration with its change since the start); the tilt
    with the distance in mm from the middle of the contact; thermal growth has a time (K,) s.
    """
    columns = np.ones((len(times), series.n, len(series.linear_nuisances)))
    for nuisance, column in zip(series.linear_nuisances, np.moveaxis(columns, 2, 0), strict=True):
        if nuisance.kind == "drift":
            column[:] = series.x / case.time.end
        elif nuisance.kind == "compliance":
            assert case.load.force is not None
            start = 0.0 if series.quantity == "approach" else in_time(case.load.force, 0.0)
            column[:] = 1e-3 * (in_time(case.load.force, series.x) - start)
        elif nuisance.kind == "tilt":
            column[:] = series.x - 0.5 * sum(case.contact)
        elif nuisance.kind == "thermal":
            column[:] = growth(nuisance, case, series.x, times)
    return series.factor * columns


def _prior(nuisance: Nuisance, series: Series) -> tuple[float, float]:
    """Return mean and sd of a nuisance; bounds at both sides count as a normal distribution."""
    if nuisance.prior is not None:
        return nuisance.prior
    low, high = nuisance.bounds
    if not nuisance.free:
        return 0.5 * (low + high), (high - low) / np.sqrt(12.0)
    noise, mean = float(series.sd.max()), 0.0
    widest = _WIDE * (float(np.abs(series.value).max()) + noise)
    if nuisance.kind == "thermal":  # farther beyond the readings it would be an offset
        widest = _WIDE_GROWTH * float(np.ptp(series.value)) + noise
    elif nuisance.kind in ("offset", "level"):  # so that squares are no differences of large ones
        mean = float(series.value.mean())
    return mean / series.factor, widest / series.factor


def _growth_nodes(time: Nuisance, count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes (K,) s of a growth time, and logarithms of their weights, its prior's too."""
    low, high = time.bounds
    if time.prior is not None:
        at, sd = time.prior
        low, high = max(low, at - _PRIOR_SDS * sd), min(high, at + _PRIOR_SDS * sd)
    low, high = np.log([low, high])
    nodes, weights = _nodes(count)
    times = np.exp(low + 0.5 * (nodes + 1.0) * (high - low))
    logs = np.log(0.5 * (high - low) * weights * times)
    if time.prior is not None:
        logs = logs - 0.5 * ((times - at) / sd) ** 2 - np.log(sd)
    return times, logs


@dataclass(frozen=True, eq=False)
class Nuisances:
    """The c nuisances of some series of a test at K nodes of a growth time; one without growth."""

    #: number of the series, -1 of the calibration of an input, and kind of each
    owners: list[tuple[int, str]]
    #: (K, n, c) what a unit of each, or one sd of a calibration, adds to the readings
    columns: FloatArray
    #: (c,) of their priors, wide where nothing is known; which of them are free
    means: FloatArray
    sds: FloatArray
    free: BoolArray
    #: (K,) s, growth times, and logarithms of their weights
    times: FloatArray
    log_weights: FloatArray

    @classmethod
    def of(
        cls, test: Experiment, numbers: Sequence[int], scales: Sequence[FloatArray], nodes: int
    ) -> "Nuisances":
        """Return the nuisances of some series, and the calibrations of inputs.

        Parameters
        ----------
        scales : (n,) what the readings gain by one sd of each calibration.
        nodes : number of nodes of a growth time.
        """
        series = [test.series[i] for i in numbers]
        grown = [time for s in series if (time := s.growth_time) is not None]
        if len(grown) > 1:
            raise InputError(
                f'experiment "{legible(test.name)}": only one series may have thermal growth where '
                "wear is random or an input has a scale"
            )
        times, logs = _growth_nodes(grown[0], nodes) if grown else (np.zeros(1), np.zeros(1))
        every = [(i, nuisance) for i in numbers for nuisance in test.series[i].linear_nuisances]
        owners = [(i, nuisance.kind) for i, nuisance in every]
        owners += [(-1, str(number)) for number in range(len(scales))]
        columns, place = np.zeros((len(times), sum(s.n for s in series), len(owners))), 0
        for one, rows in records(series):
            some = slice(place, place := place + len(one.linear_nuisances))
            columns[:, rows, some] = nuisance_columns(one, test.case, times)
        for column, scale in enumerate(scales, place):
            columns[:, :, column] = scale
        priors = [(*_prior(nuisance, test.series[i]), nuisance.free) for i, nuisance in every]
        priors += [(0.0, 1.0, False)] * len(scales)
        means, sds, free = np.reshape(priors, (-1, 3)).T.astype(float)
        sds = sds * columns.any(axis=(0, 1))  # what adds nothing stays where it is
        return cls(owners, columns, means, sds, (free > 0.0) & (sds > 0.0), times, logs)
