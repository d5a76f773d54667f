"""The steady part of a test: where a rate, or a level, changes by little for certain, by AR(1)."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray

_ROUNDS, _MOST = 3, 0.95
#: bias of a coefficient from n residuals is -(1 + 3 phi) / n; phi is taken to be this for it
_USUAL = 0.8


class Regression(NamedTuple):
    """A linear regression."""

    #: (m,) float
    coefficients: FloatArray
    #: (m, m) float
    covariance: FloatArray
    #: of the errors, from one to the next
    autocorrelation: float
    #: of an error
    sd: float


def regress(columns: FloatArray, values: FloatArray) -> Regression:
    """Return the regression of values on columns, with AR(1) errors.

    The coefficient is that of the residuals with its small-sample bias, at most 0.95, in three
    rounds (Prais and Winsten 1954).

    Parameters
    ----------
    columns : (n, m) float, n > m.
    values : (n,) float.
    """
    n, m = columns.shape
    autocorrelation = 0.0
    for _ in range(_ROUNDS):
        white_columns, white = (_whiten(a, autocorrelation) for a in (columns, values))
        normal = np.linalg.inv(white_columns.T @ white_columns)
        coefficients = normal @ (white_columns.T @ white)
        residuals = values - columns @ coefficients
        squares = float(residuals @ residuals)
        before = autocorrelation
        if squares > 0.0:
            lagged = float(residuals[1:] @ residuals[:-1]) / squares
            autocorrelation = min(max(lagged + (1.0 + 3.0 * _USUAL) / n, 0.0), _MOST)
    errors = _whiten(values, before) - white_columns @ coefficients
    variance = float(errors @ errors) / (n - m)
    sd = float(np.sqrt(squares / (n - m)))
    return Regression(coefficients, normal * variance, autocorrelation, sd)


def extrapolate(
    x: FloatArray,
    values: FloatArray,
    place: float,
    degree: int,
    *,
    autocorrelation: float,
    sd: float,
) -> tuple[float, float]:
    """Return the value at a place of a polynomial near values, and its standard uncertainty.

    Parameters
    ----------
    x, values : (n,) float, n > degree, in order.
    autocorrelation, sd : of the values' AR(1) errors, which so few of them do not tell.
    """
    distance = (x - place) / np.ptp(x)
    weights = np.linalg.pinv(np.vander(distance, degree + 1, increasing=True))[0]
    order = np.arange(len(x))
    correlation = autocorrelation ** np.abs(order[:, None] - order)
    return float(weights @ values), sd * float(np.sqrt(weights @ correlation @ weights))


def _whiten(rows: FloatArray, autocorrelation: float) -> FloatArray:
    """Return rows less what they remember of the row before."""
    first = rows[:1] * np.sqrt(1.0 - autocorrelation**2)
    return np.concatenate([first, rows[1:] - autocorrelation * rows[:-1]])


#: most block means of a record, and readings of a block at least on average
MOST_BLOCKS, READINGS_OF_A_BLOCK = 200, 3
#: fewest block means of a steady part
FEWEST_BLOCKS = 20
#: fewest block means that a change is computed from
_FEWEST_OF_A_PART = 6
#: shares of the test: the latest start that is tried, the step between starts; how many in a row
#: must be steady
_LATEST, _STEP, _IN_A_ROW = 0.7, 0.01, 6
#: share of the usual number of readings below which a block is dropped
_HALF_FILLED = 0.5
#: share of the test after which numbers are taken where no part is steady
LAST_THIRD = 2.0 / 3.0

#: 1: a level that changes along a line; 2: a slope, of a record that bends as a parabola
Order = Literal[1, 2]


class Blocks(NamedTuple):
    """Means of readings in blocks of equal time: (n,) s and (n,) values."""

    time: FloatArray
    value: FloatArray


class Change(NamedTuple):
    """How much a slope or a level changes over a part of a record, and what it is in its middle."""

    #: from the part's start to its end, with its standard uncertainty
    change: float
    change_u: float
    #: in the middle
    value: float
    value_u: float
    #: of the blocks about the curve
    autocorrelation: float
    sd: float

    @property
    def steadiness_u(self) -> float:
        """Standard uncertainty of the value that it may have changed so much (JCGM 100, F.2)."""
        return (abs(self.change) + self.change_u) / float(np.sqrt(12.0))

    def within(self, limit: float) -> bool:
        """Tell whether the change is for certain at most a share of the value."""
        return abs(self.change) + self.change_u <= limit * abs(self.value)


@dataclass(frozen=True)
class SteadyPart:
    """The part of a test that numbers are of."""

    #: s
    start: float
    #: "steady part", "last third" or "given part"
    of: Literal["steady part", "last third", "given part"]
    #: s, from when on each is steady by itself; None: never, or it was not read
    wear: float | None
    friction: float | None

    @property
    def steady(self) -> bool:
        """Whether it is steady, or said to be."""
        return self.of != "last third"


def count_blocks(readings: int) -> int:
    """Return the number of blocks that so many readings are averaged in."""
    return max(min(MOST_BLOCKS, readings // READINGS_OF_A_BLOCK), 1)


def block_means(time: FloatArray, values: FloatArray) -> Blocks:
    """Return means in at most 200 blocks of equal time, of three readings at least on average.

    Blocks that are not half filled are dropped.

    Parameters
    ----------
    time : (n,) s, not falling, from 0.
    values : (n,), NaN where nothing was read.
    """
    filled = np.isfinite(values)
    time, values = time[filled], values[filled]
    n = count_blocks(len(time))
    place = np.minimum((time / time[-1] * n).astype(int), n - 1)
    counts = np.bincount(place, minlength=n)
    whole = counts >= _HALF_FILLED * np.median(counts[counts > 0])
    means = (np.bincount(place, x, n) / np.maximum(counts, 1) for x in (time, values))
    return Blocks(*(mean[whole] for mean in means))


def has_blocks(blocks: Blocks, start: float) -> bool:
    """Tell whether there are block means enough in all, and from a start, s, on."""
    later = int(np.count_nonzero(blocks.time >= start))
    return len(blocks.time) >= FEWEST_BLOCKS and later >= _FEWEST_OF_A_PART


def has_starts(blocks: Blocks) -> bool:
    """Tell whether there are block means enough for a steady part to begin anywhere."""
    last = blocks.time[-1] * _STEP * (_IN_A_ROW - 1)
    return int(np.count_nonzero(blocks.time >= last)) >= FEWEST_BLOCKS


def change_from(blocks: Blocks, start: float, order: Order) -> Change:
    """Return the change of a record's slope (order 2) or level (order 1) from a start, s, on."""
    part = blocks.time >= start
    time, value = blocks.time[part], blocks.value[part]
    span = float(time[-1] - time[0])
    x = (time - 0.5 * (time[0] + time[-1])) / span  # -1/2 ... 1/2
    columns = np.column_stack([x**power for power in range(order + 1)])
    lower = columns[:, :order]
    columns[:, order] -= lower @ np.linalg.lstsq(lower, columns[:, order], rcond=None)[0]
    (coefficients, covariance, autocorrelation, sd) = regress(columns, value)
    us = np.sqrt(np.diag(covariance))
    middle = order - 1  # the slope of a parabola at x is c1 + 2 c2 x
    scale, factor = (1.0, 1.0) if order == 1 else (span, 2.0)
    return Change(
        float(factor * coefficients[order] / scale), float(factor * us[order] / scale),
        float(coefficients[middle] / scale), float(us[middle] / scale), autocorrelation, sd,
    )  # fmt: skip


def steady_start(blocks: Blocks, order: Order, limit: float) -> float | None:
    """Return the earliest time, s, from which a record is steady; None for none.

    It is a test of equivalence: there, and at the next five starts, the change to the end and its
    uncertainty together are at most a share of the value. A short record with noise is not steady
    for want of evidence.

    Parameters
    ----------
    limit : share of the value.
    """
    starts = blocks.time[-1] * np.arange(0.0, _LATEST + 1e-4, _STEP)
    steady = [
        int(np.count_nonzero(blocks.time >= start)) >= FEWEST_BLOCKS
        and change_from(blocks, float(start), order).within(limit)
        for start in starts
    ]
    for i in range(len(starts) - _IN_A_ROW + 1):
        if all(steady[i : i + _IN_A_ROW]):
            return float(starts[i])
    return None


def steady_part(
    wear: Blocks | None,
    friction: Blocks | None,
    end: float,
    *,
    wear_limit: float,
    friction_limit: float,
    start: float | None = None,
) -> SteadyPart:
    """Return the part of a test in which all that was read is steady, or its last third.

    Parameters
    ----------
    wear, friction : block means of a depth and of a coefficient; None: not read.
    end : s, of the record.
    wear_limit, friction_limit : shares of the rate and of the coefficient.
    start : s, where a user says that it is.
    """
    from_wear = None if wear is None else steady_start(wear, 2, wear_limit)
    from_friction = None if friction is None else steady_start(friction, 1, friction_limit)
    if start is not None:
        return SteadyPart(start, "given part", from_wear, from_friction)
    pairs = ((wear, from_wear), (friction, from_friction))
    starts = [first for blocks, first in pairs if blocks is not None]
    if starts and all(first is not None for first in starts):
        latest = max(first for first in starts if first is not None)
        return SteadyPart(latest, "steady part", from_wear, from_friction)
    return SteadyPart(end * LAST_THIRD, "last third", from_wear, from_friction)
