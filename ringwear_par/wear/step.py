"""What bodies lose in a step, as a function of the pressure at its end: eq. (4) of the paper."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.schedules import Schedules
from ringwear_par.wear.at import LocalState
from ringwear_par.wear.laws import LawFunction, Values

#: Newton's iterations for a depth that the rate depends on, and the change that ends them
_MOST, _SETTLED = 30, 1e-10
#: most scalings of averages
_SCALINGS = 1000


@dataclass(frozen=True, kw_only=True)
class Elements:
    """The contact elements, the same of all histories of a block."""

    #: (n,) mm and mm^2
    r: FloatArray
    area: FloatArray
    #: (n,) 1 / cos alpha of sloping faces, None where all are flat
    obliquity: FloatArray | None
    _averages: dict[float, FloatArray] = field(default_factory=dict, compare=False, repr=False)
    shared = True

    @cached_property
    def true_area(self) -> FloatArray:
        """(n,) mm^2, along sloping faces: friction and wear act on it."""
        return self.area if self.obliquity is None else self.area * self.obliquity

    def average(self, length: float) -> FloatArray:
        """Return the (n, n) matrix of Gaussian averages over a length (mm), of non-local laws.

        The same average is taken of the pressure and of the rate: pressure felt at a distance wears
        at that distance, without which a step need not have a solution. Rows sum to 1 and
        ``diag(area) A`` is symmetric, so that constants and area integrals are kept (Sinkhorn's
        scaling).
        """
        if length in self._averages:
            return self._averages[length]
        r, area = self.r, self.true_area
        kernel = np.exp(-0.5 * ((r[:, None] - r) / length) ** 2) * area[:, None] * area
        scale = 1.0 / np.sqrt(kernel.sum(axis=1) / area)
        for _ in range(_SCALINGS):
            sums = scale * (kernel @ scale) / area
            if np.abs(sums - 1.0).max() < 1e-14:
                break
            scale = scale / np.sqrt(sums)
        matrix = scale[:, None] * kernel * scale / area[:, None]
        self._averages[length] = matrix / matrix.sum(axis=1)[:, None]
        return self._averages[length]


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
    #: mm, averaging length of a non-local law; 0 of others
    length: float


@dataclass
class StepWear:
    """The wear of an implicit step of B histories: depths d = step rate(p, wear + d)."""

    #: bodies that wear, w of them
    wearing: tuple[Wearing, ...]
    elements: Elements
    #: (w, B, n) layers that elements are in throughout the step
    layer: IntArray
    #: (B, 1) s, coefficient of friction and numbers, (B, n) mm/s and mm, at its end or in the mean,
    #: see ``LocalState``
    time: FloatArray
    friction: FloatArray
    number: IntArray
    speed: FloatArray
    slid: FloatArray
    #: (w, B, n) mm, along the axis, before it; (B, 1) s; (w, B, 1) factors on the rates in it
    wear: FloatArray
    step: FloatArray
    pace: FloatArray | None
    #: (w, B, n) mm, depths of laws that remember, from which others near them are found
    near: FloatArray
    #: pressures whose lines were asked for last, as several ask for the same, and these lines
    _last: tuple[FloatArray, tuple[FloatArray, FloatArray]] | None = field(init=False, default=None)

    @property
    def is_local(self) -> bool:
        """Whether the wear of an element depends on its own pressure alone."""
        return not any(body.length for body in self.wearing)

    @cached_property
    def linear(self) -> bool:
        """Whether depths are max(0, const + slope p), with numbers that hold at all pressures."""
        return self.is_local and all(all(body.lines) for body in self.wearing)

    def lines(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return const (mm) and slope (mm/MPa), (w, B, n), of lines that touch depths at p (B, n).

        Near p, depths along the axis are max(0, const + slope p).
        """
        if self._last is None or not (self.linear or self._last[0] is p):
            self._last = p, self._lines(np.zeros((1, 1)) if self.linear else p)
        return self._last[1]

    def depths(self, p: FloatArray) -> FloatArray:
        """Return what bodies lose along the axis, (w, B, n) mm, at pressures (B, n)."""
        if not self.is_local:
            return self.step * self.rates(p)
        const, slope = self.lines(p)
        return np.maximum(const + slope * p, 0.0)

    def rates(self, p: FloatArray) -> FloatArray:
        """Return rates of wear along the axis at the wear before the step, (w, B, n) mm/s."""
        rates = np.zeros((len(self.wearing), *p.shape))
        for i, body in enumerate(self.wearing):
            rate = self._averaged(i, p)[0] if body.length else self._rate(i, p, 0.0)[0]
            rates[i] = np.maximum(rate, 0.0)
        return rates

    def of_one(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the depth of all bodies at pressures (n,), and its slopes, of one history.

        (n,) mm, and (n,) mm/MPa, or (n, n) of a non-local law.
        """
        if self.is_local:
            const, slope = self.lines(p[None])
            line = const + slope * p
            return np.maximum(line, 0.0).sum(axis=0)[0], (slope * (line > 0.0)).sum(axis=0)[0]
        step, bodies = self.step[0, 0], range(len(self.wearing))
        rates, slopes = zip(*(self._averaged(i, p[None]) for i in bodies), strict=True)
        return step * sum(rates)[0], step * sum(slopes)

    def _averaged(self, i: int, p: FloatArray) -> Values:
        """Return rates (B, n) of averaged pressures, averaged alike; of one also slopes (n, n)."""
        length = self.wearing[i].length
        average = self.elements.average(length) if length else np.eye(p.shape[1])
        secant = 1.0 if self.elements.obliquity is None else self.elements.obliquity
        rate, slope, *_ = self._rate(i, p @ average.T, 0.0)
        rises = np.where(rate > 0.0, slope / secant, 0.0)
        rate, slopes = np.maximum(rate / secant, 0.0) @ average.T, (average * rises[0]) @ average
        return secant * rate, (secant * slopes.T).T

    def _lines(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        const, slope = np.empty(self.wear.shape), np.empty(self.wear.shape)
        for i, body in enumerate(self.wearing):
            if any(body.remember):
                const[i], slope[i] = self._settled(i, p)
            else:
                rate, rise, *_ = self._rate(i, p, 0.0)
                const[i], slope[i] = self.step * rate, self.step * rise
        if not self.linear:
            const -= slope * p
        return const, slope

    def _settled(self, i: int, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return depth and slope of a law that remembers, by Newton's method at each element."""
        depth, step = self.near[i], self.step
        for _ in range(_MOST):
            rate, rise, by_wear = self._rate(i, p, depth)
            growth = 1.0 - step * by_wear
            change = (step * np.maximum(rate, 0.0) - depth) / growth
            depth = np.maximum(depth + change, 0.0)
            left = np.abs(change) > _SETTLED * depth.max(axis=1, keepdims=True)
            if not left.any():  # NaN of a history are not waited for
                break
        lost = left | ~(growth > 0.0)  # wear that grows faster than the step can follow
        self.near[i] = np.nan_to_num(np.where(lost, 0.0, depth))
        below = rate <= 0.0  # there the line goes on below zero
        depth = np.where(below, step * rate, np.where(lost, np.nan, depth))
        return depth, step * np.where(below, rise, np.where(lost, np.nan, rise / growth))

    def _rate(self, i: int, p: FloatArray, depth: FloatArray | float) -> Values:
        """Return rate, slope (and d rate / d wear) along the axis, worn by a further depth."""
        body, secant = self.wearing[i], self.elements.obliquity
        worn, values = self.wear[i] + depth, None
        for layer, law in enumerate(body.laws):
            here = self.layer[i] == layer
            if len(body.laws) > 1 and not here.any():
                continue
            lost = np.maximum(worn - body.ends[layer - 1], 0.0) if layer else worn
            at = LocalState(
                self.time, self.elements.r, self.speed, self.friction,
                lost if secant is None else lost / secant, self.slid, number=self.number,
            )  # fmt: skip
            arguments = {
                name: value.at(self.time[:, 0])[:, None] if isinstance(value, Schedules) else value
                for name, value in body.arguments[layer].items()
            }
            new = law(p, at, **arguments)
            if any(body.remember) and len(new) == 2:
                new = *new, np.zeros_like(p)
            if values is not None:
                new = tuple(np.where(here, a, b) for a, b in zip(new, values, strict=True))
            values = new
        assert values is not None
        if self.pace is not None:
            values = tuple(self.pace[i] * value for value in values)
        return values if secant is None else (secant * values[0], secant * values[1], *values[2:])
