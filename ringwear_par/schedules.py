"""Quantities of a case: numbers, tables in time, or profiles along the radius."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ringwear_par.arrays import FloatArray


@dataclass(frozen=True)
class Table:
    """A piecewise linear function, constant beyond its ends.

    Parameters
    ----------
    x : increasing; s for a table in time, mm for a profile along the radius.
    y : values.
    axis : "t" or "r".
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    axis: Literal["t", "r"] = "t"

    def __call__(self, x: float | FloatArray) -> float | FloatArray:
        """Return the value at x."""
        y = np.interp(x, self.x, self.y)
        return float(y) if np.ndim(x) == 0 else y

    @cached_property
    def _areas(self) -> FloatArray:
        x, y = np.array(self.x), np.array(self.y)
        return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])

    def integral(self, x: float) -> float:
        """Return the integral from the first x of the table."""
        if x <= self.x[0]:
            return self.y[0] * (x - self.x[0])
        i = int(np.searchsorted(self.x, x, side="right")) - 1
        return float(self._areas[i] + 0.5 * (self.y[i] + float(self(x))) * (x - self.x[i]))


Quantity = float | Table


def value(quantity: Quantity, time: float, r: FloatArray | None = None) -> float | FloatArray:
    """Return a quantity at a time (s), and at radii (mm) where it is a profile."""
    if not isinstance(quantity, Table):
        return quantity
    if quantity.axis == "t":
        return quantity(time)
    if r is None:
        raise ValueError("a profile along the radius has no value without one")
    return quantity(r)


def in_time(quantity: Quantity, time: float) -> float:
    """Return a number or a table in time at a time (s)."""
    return float(value(quantity, time))


def integral(quantity: Quantity, start: float, end: float) -> float:
    """Return the time integral of a number or a table in time."""
    if isinstance(quantity, Table):
        return quantity.integral(end) - quantity.integral(start)
    return quantity * (end - start)


def mean(quantity: Quantity, start: float, end: float) -> float:
    """Return the mean over an interval of time; a number itself, to the last bit."""
    if isinstance(quantity, Table):
        return integral(quantity, start, end) / (end - start)
    return quantity


def largest(quantity: Quantity) -> float:
    """Return the largest value that a quantity takes."""
    return max(quantity.y) if isinstance(quantity, Table) else quantity


def smallest(quantity: Quantity) -> float:
    """Return the smallest value that a quantity takes."""
    return min(quantity.y) if isinstance(quantity, Table) else quantity


def knots(*quantities: Quantity | None) -> tuple[float, ...]:
    """Return the times at which the slope of any of some quantities jumps, increasing."""
    times = {
        x for q in quantities if isinstance(q, Table) and q.axis == "t" for x in q.x if x > 0.0
    }
    return tuple(sorted(times))
