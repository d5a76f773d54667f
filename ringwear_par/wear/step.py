"""What bodies lose in a step, as a function of the pressure at its end: eq. (4) of the paper."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.batched import take
from ringwear_par.schedules import Schedules
from ringwear_par.wear.at import LocalState
from ringwear_par.wear.laws import LawFunction, Values

#: Newton's iterations for a depth that the rate depends on, and the change that ends them
_MOST, _SETTLED = 30, 1e-10


@dataclass(frozen=True)
class Average:
    """What a non-local law averages pressures, and rates, with."""

    #: (n, n) 1
    matrix: FloatArray
    shared = True


@dataclass(frozen=True)
class Wearing:
    """A body that wears, of B histories: the laws of its layers from the face inwards, and its own.

    Lengths along the axis.
    """

    #: 0 of lower, 1 of upper
    body: int
    laws: tuple[LawFunction, ...]
    #: what each takes: (B, 1) or (B, n), or schedules
    arguments: tuple[dict[str, FloatArray | Schedules], ...]
    #: whether the rate of each is a line above a threshold, and depends on the depth worn off it
    lines: tuple[bool, ...]
    remember: tuple[bool, ...]
    #: (layers + 1, B, n) mm, depths at which they end; infinite of the body
    ends: FloatArray
    #: (B, layers + 1) 1/MPa, worn volume by dissipated energy, 0 where it is not always the same
    per_energy: FloatArray
    #: of a non-local law, None of others
    average: Average | None = None

    @property
    def linear(self) -> bool:
        """Whether depths are max(0, const + slope p), with numbers that hold at all pressures."""
        return all(self.lines) and self.average is None


class StepWear:
    """The wear of an implicit step of B histories: depths d = step rate(p, wear + d).

    Parameters
    ----------
    wearing : bodies that wear, w of them.
    layer : (w, B, n) layers that elements are in throughout the step.
    r : (n,) mm.
    at : time, speed, friction, distance slid and number of the histories, at its end or in the
        mean: (B, 1) or (B, n), see ``LocalState``.
    wear : (w, B, n) mm, along the axis, before it.
    step : (B,) s.
    obliquity : (n,) 1 / cos alpha of sloping faces; None: flat ones.
    pace : (w, B, 1) factors on the rates in the step; None: 1.
    """

    def __init__(
        self,
        wearing: tuple[Wearing, ...],
        layer: IntArray,
        r: FloatArray,
        at: tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray],
        wear: FloatArray,
        step: FloatArray,
        obliquity: FloatArray | None = None,
        pace: FloatArray | None = None,
    ) -> None:
        self._wearing, self._layer, self._r, self._at = wearing, layer, r, at
        self._wear, self._obliquity = wear, obliquity
        self._step, self._pace = step[:, None], pace
        #: whether the wear of an element depends on its own pressure alone
        self.is_local = all(body.average is None for body in wearing)
        #: whether lines hold at all pressures
        self.linear = all(body.linear for body in wearing)
        self._fixed = self._lines(np.zeros((1, 1)), None) if self.linear else None
        self._last: tuple[FloatArray, tuple[FloatArray, FloatArray]] | None = None
        #: (w, B, n) mm, depths of laws that remember, from which others near them are found
        self._near = np.zeros_like(wear) if any(any(b.remember) for b in wearing) else wear

    def lines(self, p: FloatArray, rows: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return const (mm) and slope (mm/MPa) of the lines that touch depths at pressures (h, n).

        (w, h, n) of histories ``rows``; near p, depths along the axis are max(0, const + slope p).
        """
        if self._fixed is not None:
            return self._fixed if rows is None else take(self._fixed, rows)
        if self._last is None or self._last[0] is not p:  # several ask for the same
            self._last = p, self._lines(p, rows)
        return self._last[1]

    def depths(self, p: FloatArray) -> FloatArray:
        """Return what bodies lose along the axis, (w, B, n) mm, at pressures (B, n)."""
        if not self.is_local:
            return self._step * self.rates(p)
        const, slope = self.lines(p)
        return np.maximum(const + slope * p, 0.0)

    def rates(self, p: FloatArray) -> FloatArray:
        """Return rates of wear along the axis at the wear before the step, (w, B, n) mm/s."""
        rates = np.zeros((len(self._wearing), *p.shape))
        for i, body in enumerate(self._wearing):
            if body.average is None:
                rates[i] = self._rate(i, body, p, None, 0.0)[0].clip(0.0)
            else:
                rates[i] = self._averaged(i, body.average.matrix, p, None)[0]
        return rates

    def of_history(self, row: int, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the depth of all bodies of a history at pressures (n,), and its slopes.

        (n,) mm, and (n,) mm/MPa, or (n, n) of a non-local law.
        """
        rows = None if self._wear.shape[1] == 1 else np.array([row])
        if self.is_local:
            const, slope = self.lines(p[None], rows)
            line = const + slope * p
            wears = line > 0.0
            return np.maximum(line, 0.0).sum(axis=0)[0], (slope * wears).sum(axis=0)[0]
        depth, slopes = np.zeros_like(p), np.zeros((len(p), len(p)))
        for i, body in enumerate(self._wearing):
            step = self._step[row, 0]
            matrix = np.eye(len(p)) if body.average is None else body.average.matrix
            rate, slope = self._averaged(i, matrix, p[None], rows)
            depth += step * rate[0]
            slopes += step * slope
        return depth, slopes

    def _averaged(
        self, i: int, average: FloatArray, p: FloatArray, rows: IntArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return rates (h, n) of averaged pressures, averaged alike; of one also slopes (n, n)."""
        body, secant = self._wearing[i], self._obliquity
        rate, slope, *_ = self._rate(i, body, p @ average.T, rows, 0.0)
        if secant is not None:
            rate, slope = rate / secant, slope / secant
        rises = np.where(rate > 0.0, slope, 0.0)
        rate, slopes = np.maximum(rate, 0.0) @ average.T, (average * rises[0]) @ average
        return (rate, slopes) if secant is None else (secant * rate, secant[:, None] * slopes)

    def _lines(self, p: FloatArray, rows: IntArray | None) -> tuple[FloatArray, FloatArray]:
        consts, slopes = [], []
        step = self._step if rows is None else self._step[rows]
        for i, body in enumerate(self._wearing):
            if any(body.remember):
                depth, slope = self._settled(i, body, p, rows, step)
            else:
                rate, rise, *_ = self._rate(i, body, p, rows, 0.0)
                depth, slope = step * rate, step * rise
            consts.append(depth if self.linear else depth - slope * p)
            slopes.append(slope)
        if len(consts) == 1:  # without a copy
            return consts[0][None], slopes[0][None]
        shape = self._wear.shape[1:] if rows is None else (len(rows), self._wear.shape[2])
        const, slope = (
            np.array([np.broadcast_to(v, shape) for v in of_bodies]).reshape(-1, *shape)
            for of_bodies in (consts, slopes)
        )
        return const, slope

    def _settled(
        self, i: int, body: Wearing, p: FloatArray, rows: IntArray | None, step: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return depth and slope of a law that remembers, by Newton's method at each element."""
        near = self._near[i]
        depth = near if rows is None else near[rows]
        for _ in range(_MOST):
            rate, rise, by_wear = self._rate(i, body, p, rows, depth)
            growth = 1.0 - step * by_wear
            change = (step * np.maximum(rate, 0.0) - depth) / growth
            depth = np.maximum(depth + change, 0.0)
            left = np.abs(change) > _SETTLED * depth.max(axis=1, keepdims=True)
            if not left.any():  # NaN of a history are not waited for
                break
        lost = left | ~(growth > 0.0)  # wear that grows faster than the step can follow
        near[slice(None) if rows is None else rows] = np.nan_to_num(np.where(lost, 0.0, depth))
        below = rate <= 0.0  # there the line goes on below zero
        depth = np.where(below, step * rate, np.where(lost, np.nan, depth))
        return depth, step * np.where(below, rise, np.where(lost, np.nan, rise / growth))

    def _rate(
        self,
        i: int,
        body: Wearing,
        p: FloatArray,
        rows: IntArray | None,
        depth: FloatArray | float,
    ) -> Values:
        """Return rate, slope (and d rate / d wear) along the axis, worn by a further depth."""
        of_histories = *self._at, self._wear[i], self._layer[i], body.ends
        if rows is not None:
            of_histories = take(of_histories, rows)
        time, speed, friction, slid, number_of, wear, layer, ends = of_histories
        worn, secant, values = wear + depth, self._obliquity, None
        for number, law in enumerate(body.laws):
            here = layer == number
            if len(body.laws) > 1 and not here.any():
                continue
            lost = np.maximum(worn - ends[number - 1], 0.0) if number else worn
            lost = lost if secant is None else lost / secant
            own = LocalState(time, self._r, speed, friction, lost, slid, number=number_of)
            new = law(p, own, **self._values(body.arguments[number], rows))
            if any(body.remember) and len(new) == 2:
                new = *new, np.zeros_like(p)
            if values is not None:
                new = tuple(np.where(here, a, b) for a, b in zip(new, values, strict=True))
            values = new
        assert values is not None
        if self._pace is not None:
            pace = self._pace[i] if rows is None else self._pace[i, rows]
            values = tuple(pace * value for value in values)
        return values if secant is None else (secant * values[0], secant * values[1], *values[2:])

    def _values(
        self, arguments: dict[str, FloatArray | Schedules], rows: IntArray | None
    ) -> dict[str, Any]:
        """Return what a law takes at the time, of some histories."""
        time = self._at[0][:, 0]
        values = {
            name: value.at(time)[:, None] if isinstance(value, Schedules) else value
            for name, value in arguments.items()
        }
        return values if rows is None else take(values, rows)
