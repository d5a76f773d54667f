"""Quantities of a case: numbers, tables in time, or profiles along the radius; stacks of them.

Times are a number, or an array for many histories at once; values have its shape.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, overload

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray

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


@dataclass(frozen=True, eq=False)
class Stacked:
    """A quantity for each of B histories, whose times are (B,), or a column (B, 1)."""

    #: the B quantities, numbers or tables; numbers alone may be an array
    quantities: tuple[float | Table, ...] | FloatArray

    @cached_property
    def numbers(self) -> FloatArray | None:
        """(B,) the quantities, where they are all numbers."""
        if isinstance(self.quantities, np.ndarray):
            return self.quantities
        tables = any(isinstance(q, Table) for q in self.quantities)
        return None if tables else np.array(self.quantities)

    def value(self, time: float | FloatArray, r: FloatArray | None) -> FloatArray:
        """Return (B,) values at times (B,); (B, 1) at a column, (B, n) where one is a profile."""
        column = np.ndim(time) > 1
        if self.numbers is not None:
            return self.numbers[:, None] if column else self.numbers
        times = np.broadcast_to(np.ravel(time), len(self.quantities)).tolist()
        values = [value(q, t, r) for q, t in zip(self.quantities, times, strict=True)]
        return np.array(np.broadcast_arrays(*map(np.atleast_1d, values)) if column else values)


Quantity = float | Table | Stacked


def value(
    quantity: Quantity, time: float | FloatArray, r: FloatArray | None = None
) -> float | FloatArray:
    """Return a quantity at a time (s), and at radii (mm) where it is a profile.

    Parameters
    ----------
    time : a number, or (B, 1) of B histories, whose elements the value goes with.
    r : (n,) float.
    """
    if isinstance(quantity, float):  # most are, and this is done for every rate
        return quantity
    if isinstance(quantity, Table):
        if quantity.axis == "t":
            return quantity(time)
        if r is None:
            raise ValueError("a profile along the radius has no value without one")
        return quantity(r)
    return quantity.value(time, r) if isinstance(quantity, Stacked) else quantity


@overload
def in_time(quantity: Quantity, time: float) -> float: ...
@overload
def in_time(quantity: Quantity, time: FloatArray) -> FloatArray: ...
def in_time(quantity: Quantity, time: float | FloatArray) -> float | FloatArray:
    """Return a number or a table in time at a time (s); (B,) of a stack, or at (B,) times."""
    if isinstance(quantity, Stacked):
        return quantity.value(time, None)
    if isinstance(time, np.ndarray):
        return quantity(time) if isinstance(quantity, Table) else np.full(time.shape, quantity)
    return float(value(quantity, time))


@overload
def integral(quantity: Quantity, start: float, end: float) -> float: ...
@overload
def integral(quantity: Quantity, start: float | FloatArray, end: FloatArray) -> FloatArray: ...
def integral(
    quantity: Quantity, start: float | FloatArray, end: float | FloatArray
) -> float | FloatArray:
    """Return the time integral of a number or a table in time; (B,) up to (B,) ends."""
    if isinstance(quantity, Table):
        return quantity.integral(end) - quantity.integral(start)
    if isinstance(quantity, Stacked):
        return _of_each(integral, quantity, start, end)
    return quantity * (end - start)


@overload
def mean(quantity: Quantity, start: float, end: float) -> float: ...
@overload
def mean(quantity: Quantity, start: float | FloatArray, end: FloatArray) -> FloatArray: ...
def mean(
    quantity: Quantity, start: float | FloatArray, end: float | FloatArray
) -> float | FloatArray:
    """Return the mean over an interval of time, (B,) up to (B,) ends; a number is its own."""
    if isinstance(quantity, Table):
        return integral(quantity, start, end) / (end - start)  # type: ignore[arg-type]
    if isinstance(quantity, Stacked):
        return _of_each(mean, quantity, start, end)
    return np.full(end.shape, quantity) if isinstance(end, np.ndarray) else quantity


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


def _of_each(
    function: Callable[[Quantity, float, float], float],
    stacked: Stacked,
    start: float | FloatArray,
    end: float | FloatArray,
) -> FloatArray:
    """Return (B,) what a function makes of each quantity between its own times."""
    starts, ends = (np.broadcast_to(t, len(stacked.quantities)).tolist() for t in (start, end))
    return np.array([*map(function, stacked.quantities, starts, ends)])


def largest(quantity: Quantity) -> float:
    """Return the largest value that a quantity takes."""
    if isinstance(quantity, Stacked):
        return max(map(largest, quantity.quantities))
    return max(quantity.y) if isinstance(quantity, Table) else quantity


def smallest(quantity: Quantity) -> float:
    """Return the smallest value that a quantity takes."""
    if isinstance(quantity, Stacked):
        return min(map(smallest, quantity.quantities))
    return min(quantity.y) if isinstance(quantity, Table) else quantity


def quantity_text(quantity: Quantity) -> str:
    """Return a quantity as messages and summaries show it."""
    if isinstance(quantity, Stacked):
        return f"{len(quantity.quantities)} numbers or tables to {largest(quantity):g}"
    return f"a table to {largest(quantity):g}" if isinstance(quantity, Table) else f"{quantity:g}"


def points_of(table: Table) -> list[list[float]]:
    """Return the points of a table, as case files have them."""
    return [[*point] for point in zip(table.x, table.y, strict=True)]


def varies(quantity: Quantity) -> bool:
    """Tell whether a quantity, or one of a stack, is a table."""
    if isinstance(quantity, Stacked):
        return quantity.numbers is None
    return isinstance(quantity, Table)


def breakpoints(*quantities: Quantity | None) -> tuple[float, ...]:
    """Return the times at which the slope of any of some quantities jumps, increasing."""
    times: set[float] = set()
    for q in quantities:
        if isinstance(q, Stacked):
            times.update(breakpoints(*(q.quantities if q.numbers is None else ())))
        elif isinstance(q, Table) and q.axis == "t":
            times.update(x for x in q.x if x > 0.0)
    return tuple(sorted(times))


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


def stack(quantities: Sequence[Quantity]) -> Quantity:
    """Return one quantity for some histories; equal ones stay as they are.

    Raises
    ------
    ValueError : one is a stack itself.
    """
    first = quantities[0]
    if all(q == first for q in quantities):
        return first
    plain = tuple(q for q in quantities if not isinstance(q, Stacked))
    if len(plain) < len(quantities):
        raise ValueError("stacks cannot be stacked")
    return Stacked(plain)


def take(quantity: Any, histories: IntArray) -> Any:
    """Return a stack, or an array (B, 1) or (B, n), of some of B histories."""
    if isinstance(quantity, Stacked):
        if quantity.numbers is not None:
            return Stacked(quantity.numbers[histories])
        return Stacked(tuple(quantity.quantities[i] for i in histories.tolist()))
    if isinstance(quantity, np.ndarray) and quantity.ndim > 1:
        return quantity[histories]
    return quantity


def history(quantity: Any, i: int) -> Any:
    """Return the entry of one of B histories in a stack, or an array (B, 1) or (B, n)."""
    if isinstance(quantity, Stacked):
        return quantity.quantities[i]
    if isinstance(quantity, np.ndarray) and quantity.ndim > 1:
        return quantity[i] if quantity.shape[-1] > 1 else quantity[i, 0]
    return quantity
