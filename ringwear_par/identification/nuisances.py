"""Nuisances of readings: offsets, drifts, the thermal growth of a rig; what is known of them.

All are linear but the time of a thermal growth, which is at nodes.
"""

from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import FloatArray
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


def column(nuisance: Nuisance, series: Series, case: Case, times: FloatArray) -> FloatArray:
    """Return what a unit of a linear nuisance adds to readings of a series, (n,), or (K, n).

    The offset and the level are constant; the drift grows to 1 at the end of the test; the
    compliance goes with the load in kN (of a penetration with its change since the start); the tilt
    with the distance in mm from the middle of the contact; thermal growth has a time (K,) s.
    """
    added = np.ones(series.n)
    if nuisance.kind == "drift":
        added = series.x / case.time.end
    elif nuisance.kind == "compliance":
        assert case.load.force is not None
        start = 0.0 if series.quantity == "approach" else in_time(case.load.force, 0.0)
        added = 1e-3 * (in_time(case.load.force, series.x) - start)
    elif nuisance.kind == "tilt":
        added = series.x - 0.5 * sum(case.contact)
    elif nuisance.kind == "thermal":
        added = growth(nuisance, case, series.x, times)
    return series.factor * added


def _prior(nuisance: Nuisance, series: Series) -> tuple[float, float]:
    """Return mean and sd of a nuisance; bounds at both sides count as a normal distribution."""
    if nuisance.prior is not None:
        return nuisance.prior
    low, high = nuisance.bounds
    if not nuisance.free:
        return 0.5 * (low + high), (high - low) / np.sqrt(12.0)
    noise = float(series.sd.max())
    widest = _WIDE * (float(np.abs(series.value).max()) + noise)
    if nuisance.kind == "thermal" and np.ptp(series.value):  # else it would be an offset
        widest = _WIDE_GROWTH * float(np.ptp(series.value)) + noise
    return 0.0, widest / series.factor


def _growth_nodes(time: Nuisance, count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes (K,) s of a growth time, and logarithms of their weights, its prior's too.

    They are in the middles of equal steps of the logarithm.
    """
    low, high = time.bounds
    if time.prior is not None:
        at, sd = time.prior
        low, high = max(low, at - _PRIOR_SDS * sd), min(high, at + _PRIOR_SDS * sd)
    step = np.log(high / low) / count
    times = low * np.exp(step * (np.arange(count) + 0.5))
    logs: FloatArray = np.log(step * times)
    if time.prior is not None:
        logs = logs - 0.5 * ((times - at) / sd) ** 2 - np.log(sd)
    return times, logs


class Nuisances:
    """The c nuisances of some series of a test at K nodes of a growth time; one without growth.

    Parameters
    ----------
    scales : (n,) what the readings gain by one sd of the calibration of each input.
    nodes : number of nodes of a growth time.
    """

    def __init__(
        self, test: Experiment, numbers: Sequence[int], scales: Sequence[FloatArray], nodes: int
    ) -> None:
        grown = [time for i in numbers if (time := test.series[i].growth_time) is not None]
        if len(grown) > 1:
            raise InputError(
                f'experiment "{legible(test.name)}": only one series may have thermal growth where '
                "wear is random or an input has a scale"
            )
        #: (K,) s, growth times, and logarithms of their weights
        self.times, self.log_weights = np.zeros(1), np.zeros(1)
        if grown:
            self.times, self.log_weights = _growth_nodes(grown[0], nodes)
        parts = records([test.series[i] for i in numbers])
        every = [((-1, f"{k}"), slice(None), of, (0.0, 1.0), False) for k, of in enumerate(scales)]
        for i, (series, rows) in zip(numbers, parts, strict=True):
            for one in series.linear_nuisances:
                added = column(one, series, test.case, self.times)
                every.append(((i, one.kind), rows, added, _prior(one, series), one.free))
        every.sort(key=lambda one: one[0][1] == "thermal")
        #: number of the series, -1 of the calibration of an input, and kind of each; a growth last
        self.owners = [owner for owner, *_ in every]
        #: (K, n, c) what a unit of each, or one sd of a calibration, adds to the readings
        self.columns = np.zeros((len(self.times), parts[-1][1].stop, len(every)))
        for place, (_, rows, added, *_) in enumerate(every):
            self.columns[:, rows, place] = added
        #: (c,) of their priors, wide where nothing is known
        self.means, self.sds = np.reshape([prior for *_, prior, _ in every], (-1, 2)).T
        #: (c,) those that readings alone tell, and those of which nothing does
        free, moves = np.array([f for *_, f in every], dtype=bool), self.columns.any(axis=(0, 1))
        self.free, self.idle = free & moves, free & ~moves
