"""Quantities of a case: numbers, tables in time, profiles along the radius; of many histories."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, overload

import numpy as np

from ringwear_par.arrays import FloatArray

#: share of a schedule's largest size within which a point on the line of its neighbours is no bend,
#: see ``bends``
_SLIGHT_BEND = 1e-3


@dataclass(frozen=True)
class Table:
    """A piecewise linear function, constant beyond its ends."""

    #: increasing; s for a table in time, mm for a profile along the radius
    x: tuple[float, ...]
    #: values
    y: tuple[float, ...]
    #: "t" or "r"
    axis: Literal["t", "r"] = "t"

    @overload
    def __call__(self, x: float) -> float: ...
    @overload
    def __call__(self, x: FloatArray) -> FloatArray: ...
    def __call__(self, x: float | FloatArray) -> float | FloatArray:
        """Return the value at x."""
        y = np.interp(x, *self._arrays)
        return y if isinstance(x, np.ndarray) else float(y)

    @cached_property
    def _arrays(self) -> tuple[FloatArray, FloatArray]:
        return np.array(self.x), np.array(self.y)

    @cached_property
    def _areas(self) -> FloatArray:
        x, y = self._arrays
        return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])

    @overload
    def integral(self, x: float) -> float: ...
    @overload
    def integral(self, x: FloatArray) -> FloatArray: ...
    def integral(self, x: float | FloatArray) -> float | FloatArray:
        """Return the integral from the first x of the table."""
        at, (xs, ys) = np.asarray(x, dtype=float), self._arrays
        i = np.maximum(np.searchsorted(xs, at, side="right") - 1, 0)
        inside = self._areas[i] + 0.5 * (ys[i] + np.interp(at, xs, ys)) * (at - xs[i])
        total = np.where(at <= xs[0], ys[0] * (at - xs[0]), inside)
        return total if isinstance(x, np.ndarray) else float(total)


@dataclass(frozen=True)
class Schedules:
    """Numbers of B histories, linear between times and constant beyond them."""

    #: (B, m) s, not falling, and the numbers then
    t: FloatArray
    y: FloatArray

    @classmethod
    def of(cls, quantities: Sequence[float | Table]) -> "Schedules":
        """Return numbers, or tables in time, of some histories."""
        points = [(q.x, q.y) if isinstance(q, Table) else ((0.0,), (float(q),)) for q in quantities]
        return cls(padded([x for x, _ in points]), padded([y for _, y in points]))

    @cached_property
    def constant(self) -> bool:
        """Whether no history's number changes."""
        return self.t.shape[1] == 1

    @cached_property
    def _areas(self) -> FloatArray:
        """(B, m) integrals from 0 to each of the times."""
        pieces = 0.5 * (self.y[:, 1:] + self.y[:, :-1]) * np.diff(self.t)
        return np.append(self.y[:, :1] * self.t[:, :1], pieces, axis=1).cumsum(axis=1)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the numbers at times, (B,)."""
        if self.constant:
            return self.y[:, 0]
        rows = np.arange(len(time))
        i = np.clip((self.t <= time[:, None]).sum(axis=1) - 1, 0, self.t.shape[1] - 2)
        past, width = time - self.t[rows, i], self.t[rows, i + 1] - self.t[rows, i]
        share = np.divide(past, width, out=np.zeros_like(past), where=width > 0.0).clip(0.0, 1.0)
        return (1.0 - share) * self.y[rows, i] + share * self.y[rows, i + 1]

    def integral(self, time: FloatArray) -> FloatArray:
        """Return the integrals from 0 to times, (B,)."""
        if self.constant:
            return self.y[:, 0] * time
        rows = np.arange(len(time))
        i = np.maximum((self.t <= time[:, None]).sum(axis=1) - 1, 0)
        past, mean = time - self.t[rows, i], 0.5 * (self.y[rows, i] + self.at(time))
        return self._areas[rows, i] + mean * past

    def mean(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the means over intervals, (B,)."""
        if self.constant:
            return self.y[:, 0]
        return (self.integral(end) - self.integral(start)) / (end - start)


def padded(rows: Sequence[Sequence[float]]) -> FloatArray:
    """Return rows of unlike lengths as one array, each row's last number repeated."""
    most = max(map(len, rows))
    return np.array([[*row, *[row[-1]] * (most - len(row))] for row in rows], dtype=float)


Quantity = float | Table


def value(quantity: Quantity, time: Any, r: FloatArray | None = None) -> Any:
    """Return a quantity at a time, or times (s), and at radii (mm) where it is a profile."""
    if not isinstance(quantity, Table):
        return quantity
    x: Any = time if quantity.axis == "t" else r
    return quantity(x)


def in_time(quantity: Quantity, time: Any) -> Any:
    """Return a number or a table in time at a time, or at times, s."""
    if isinstance(time, np.ndarray):
        return quantity(time) if isinstance(quantity, Table) else np.full(time.shape, quantity)
    return float(value(quantity, time))


def integral(quantity: Quantity, start: Any, end: Any) -> Any:
    """Return the integral of a number or a table in time."""
    if isinstance(quantity, Table):
        return quantity.integral(end) - quantity.integral(start)
    return quantity * (end - start)


def mean(quantity: Quantity, start: Any, end: Any) -> Any:
    """Return the mean over an interval of time; a number is its own."""
    if isinstance(quantity, Table):
        return integral(quantity, start, end) / (end - start)
    return quantity


def mean_of_product(a: Quantity, b: Quantity, start: float, end: float) -> float:
    """Return the mean over an interval of time of the product of numbers or tables in time."""
    inside = (time for time in breakpoints(a, b) if start < time < end)
    times = np.array([start, *inside, end])
    # a product of lines is a parabola, of which Simpson's rule is exact
    first, middle, last = (
        in_time(a, t) * in_time(b, t)
        for t in (times[:-1], 0.5 * (times[:-1] + times[1:]), times[1:])
    )
    return float(np.diff(times) @ (first + 4.0 * middle + last)) / 6.0 / (end - start)


def largest(quantity: Quantity) -> float:
    """Return the largest value that a quantity takes."""
    return max(quantity.y) if isinstance(quantity, Table) else quantity


def smallest(quantity: Quantity) -> float:
    """Return the smallest value that a quantity takes."""
    return min(quantity.y) if isinstance(quantity, Table) else quantity


def quantity_text(quantity: Quantity) -> str:
    """Return a quantity as messages and summaries show it."""
    return f"a table to {largest(quantity):g}" if isinstance(quantity, Table) else f"{quantity:g}"


def points_of(table: Table) -> list[list[float]]:
    """Return the points of a table, as case files have them."""
    return [[*point] for point in zip(table.x, table.y, strict=True)]


def breakpoints(*quantities: Quantity | None) -> tuple[float, ...]:
    """Return the times at which the slope of any of some quantities jumps, increasing."""
    tables = (q for q in quantities if isinstance(q, Table) and q.axis == "t")
    return tuple(sorted({x for q in tables for x in q.x if x > 0.0}))


def bends(schedule: Quantity | None) -> tuple[float, ...]:
    """Return the times at which a schedule bends so much that steps must end there, increasing.

    That is where a line past the point would be off it by a thousandth of the largest size: the
    points of a smooth curve are closer.
    """
    if not isinstance(schedule, Table):
        return ()
    x, y = np.array(schedule.x), np.array(schedule.y)
    share = (x[1:-1] - x[:-2]) / (x[2:] - x[:-2])
    past = (1.0 - share) * y[:-2] + share * y[2:]
    sharp = x[1:-1][np.abs(y[1:-1] - past) > _SLIGHT_BEND * np.abs(y).max()]
    times = {schedule.x[0], *sharp.tolist(), schedule.x[-1]}
    return tuple(sorted(time for time in times if time > 0.0))
