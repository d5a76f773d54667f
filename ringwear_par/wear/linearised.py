"""How the wear of a step varies with P numbers and with pressure."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.wear.averaging import averaged
from ringwear_par.wear.increment import WearIncrement, WearingBody, total_of
from ringwear_par.wear.law import Law
from ringwear_par.wear.layer_split import d_split, split
from ringwear_par.wear.local_state import LocalState


class VaryingNumbers(Protocol):
    """P numbers with which the wear of a step varies."""

    @property
    def averages(self) -> Mapping[int, tuple[int, FloatArray]]:
        """Of bodies, which number their averages depend on, and (n, n) how."""

    @property
    def thicknesses(self) -> Mapping[int, FloatArray]:
        """Of bodies with layers, (layers, P) derivatives of their thicknesses."""

    def rates(
        self, i: int, law: Law, p: FloatArray, at: LocalState, layer: int | None
    ) -> FloatArray:
        """Return the derivatives of the rate of body i with respect to the numbers, (P, ..., n).

        At given pressure and wear, in one of its layers if it has any.
        """


@dataclass(frozen=True)
class LinearisedBody:
    """How a body's depths in all of a step vary with P numbers, by layer and along the normal.

    Parameters
    ----------
    body : at the start of the step.
    full : (layers + 1, ..., n) mm.
    change : (layers + 1, P, ..., n) mm, at given pressure.
    slope : (layers + 1, ..., n) mm/MPa, of the averaged pressure where it is averaged.
    d_remaining : (layers, P, ..., n) mm, of what remains of layers.
    """

    body: WearingBody
    full: FloatArray
    change: FloatArray
    slope: FloatArray
    d_remaining: FloatArray

    def with_pressure(self, d_p: FloatArray) -> FloatArray:
        """Return derivatives of ``full``, (layers + 1, P, ..., n), at (P, ..., n) MPa of them."""
        average = self.body.average
        if average is None:
            return self.change + self.slope[:, None] * d_p
        return self.change + averaged(average, self.slope[:, None] * averaged(average, d_p))

    def d_depth(self, d_full: FloatArray, share: Any, d_share: Any) -> FloatArray:
        """Return derivatives of the depth in a share of the step, (P, ..., n) mm."""
        parts = split(self.full, self.body.layers.remaining, share)
        return d_split(self.full, d_full, parts, share, d_share, self.d_remaining)


@dataclass(frozen=True)
class LinearisedIncrement:
    """How the depths of an increment vary with P numbers.

    Parameters
    ----------
    increment : of which it is the linearisation.
    bodies : those that wear.
    """

    increment: WearIncrement
    bodies: Sequence[LinearisedBody]

    @property
    def depth(self) -> FloatArray:
        """(P, ..., n) mm, of both bodies in contact all along at given pressure; without layers."""
        return total_of([self.increment.along_axis(body.change[0]) for body in self.bodies])

    def in_contact_problem(
        self, p: FloatArray, d_gap: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of the depth in the contact problem: at given pressure, and by it.

        (P, ..., n) mm and (..., n) or (..., n, n) mm/MPa.

        Parameters
        ----------
        d_gap : (P, ..., n) mm, derivatives of the gaps that wear closes.
        """
        increment = self.increment
        if increment.layered:
            share: Any = 1.0
            d_share: Any = 0.0
            if increment.closing is not None:
                always = self._sum([body.body.layers.at_face(body.full) for body in self.bodies])
                change = self._sum([body.body.layers.at_face(body.change) for body in self.bodies])
                share = increment.share(np.stack([always, np.zeros_like(always)]))
                d_share = increment.d_share(always, change, d_gap)
            depth = self._sum([body.d_depth(body.change, share, d_share) for body in self.bodies])
            return depth, increment.d_depth_dp(p)
        depth = self.depth
        slope = (
            self._sum([body.slope[0] for body in self.bodies])
            if increment.local
            else increment.jacobian(p)
        )
        if increment.closing is not None:
            closed = (increment.closing.gap == 0.0) | (increment.depth(p) > 0.0)
            assert d_gap is not None
            depth = np.where(closed, depth - d_gap, 0.0)
            slope = np.where(closed, slope, 0.0)
        return depth, slope

    def _sum(self, parts: list[FloatArray]) -> FloatArray:
        """Return a field of all bodies along the axis from those along their normals."""
        return self.increment.along_axis(total_of(parts))

    def depth_in_present_layer(self, d_p: FloatArray) -> FloatArray:
        """Return derivatives of that of the increment, (P, ..., n) mm, of both bodies together."""
        return total_of([
            self.increment.along_axis(body.body.layers.at_face(body.with_pressure(d_p)))
            for body in self.bodies
        ])  # fmt: skip

    def depths_in_share(
        self, d_p: FloatArray, share: Any = 1.0, d_share: Any = 0.0
    ) -> dict[int, FloatArray]:
        """Return derivatives of ``WearIncrement.depths_in_share``, (P, ..., n) mm of each body.

        Parameters
        ----------
        d_p : (P, ..., n) MPa.
        d_share : of ``share``, (P, ..., n) or 0.
        """
        return {
            body.body.side: self.increment.along_axis(
                body.d_depth(body.with_pressure(d_p), share, d_share)
            )
            for body in self.bodies
        }

    def fraction_to_interface(self, share: float, d_p: FloatArray) -> FloatArray:
        """Return derivatives of ``WearIncrement.fraction_to_interface``, (P, ..., n)."""
        d_ends, ends = np.zeros_like(d_p), np.full(d_p.shape[1:], share)
        for linearised in self.bodies:
            layers, full = linearised.body.layers, linearised.full
            if len(layers.laws) == 1:
                continue
            d_remaining = np.concatenate(
                [linearised.d_remaining, np.zeros_like(linearised.change[:1])]
            )
            c, a = layers.remaining_at_face(full), layers.at_face(full)
            now = (a < c) & (ends * a > c)
            ends = np.divide(c, a, out=ends.copy(), where=now)
            d_a = layers.at_face(linearised.with_pressure(d_p))
            d_c = layers.at_face(d_remaining)
            d_ends = np.where(now, (d_c - ends * d_a) / np.where(now, a, 1.0), d_ends)
        return d_ends


def linearise(
    increment: WearIncrement,
    p: FloatArray,
    numbers: VaryingNumbers,
    d_wear: FloatArray,
    d_step: FloatArray | None,
    instant: bool,
) -> LinearisedIncrement:
    """Return how the depths of an increment vary with P numbers, and with pressure.

    Parameters
    ----------
    d_wear : (2, P, ..., n) mm, derivatives of the wear before the step.
    d_step : (P, ..., n) s, those of its steps; None: 0.
    instant : whether rates are those before the step, as in explicit steps.
    """
    bodies = []
    for body in increment.bodies:
        normal = d_wear[body.side]
        if increment.obliquity is not None:
            normal = normal / increment.obliquity
        bodies.append(_linearised(increment, body, p, numbers, normal, d_step, instant))
    return LinearisedIncrement(increment, bodies)


def _linearised(
    increment: WearIncrement,
    body: WearingBody,
    p: FloatArray,
    numbers: VaryingNumbers,
    normal: FloatArray,
    d_step: FloatArray | None,
    instant: bool,
) -> LinearisedBody:
    """Return how the depths of a body vary, whose wear before the step does by (P, ..., n) mm."""
    step, average, layers = increment.step, body.average, body.layers
    layered = len(layers.laws) > 1
    q = np.maximum(p if average is None else averaged(average, p), 0.0)
    row, d_average = numbers.averages.get(body.side, (0, None))
    starts = np.zeros((1, *normal.shape))
    if layered:
        starts = _d_starts(numbers.thicknesses[body.side], normal, increment.obliquity)
    full = np.zeros((len(layers.laws), *p.shape))
    change, slope = np.zeros((len(full), *normal.shape)), np.zeros_like(full)
    for number, (law, at) in enumerate(zip(layers.laws, layers.states, strict=True)):
        within = law.remembers and not instant
        after = increment.after_step(law, at, q) if within else at
        rate = law.rate(q, after)
        full[number] = step * rate
        change[number] = numbers.rates(body.side, law, q, after, number if layered else None)
        d_before = law.d_rate_dbefore(q, after)
        if d_before is not None:  # of the layer's own wear
            d_rate = d_before * (normal - starts[number])
            change[number] += (layers.present == number) * d_rate if layered else d_rate
        change[number] *= step
        slope[number] = step * law.d_rate_dp(q, after)
        if d_step is not None:
            change[number] += d_step * rate
        if within and d_before is not None:
            change[number] /= 1.0 - step * d_before
            slope[number] /= 1.0 - step * d_before
    if d_average is not None:
        change[0, row] += slope[0] * averaged(d_average, p)
    if average is not None:
        change = averaged(average, change)
        if d_average is not None:
            change[0, row] += averaged(d_average, full[0])
        full = averaged(average, full)
    d_remaining = np.zeros((len(layers.remaining), *normal.shape))
    for number, (start, end) in enumerate(itertools.pairwise(starts)):
        untouched = np.where(layers.present < number, end - start, 0.0)
        d_remaining[number] = np.where(layers.present == number, end - normal, untouched)
    return LinearisedBody(body, full, change, slope, d_remaining)


def _d_starts(
    d_thickness: FloatArray, like: FloatArray, obliquity: FloatArray | None
) -> FloatArray:
    """Return derivatives of the starts of layers, (layers + 1, P, ..., n) mm, along normals.

    The first of them is that of the face, 0.
    """
    ends = np.cumsum(d_thickness, axis=0).reshape(*d_thickness.shape, *(1,) * (like.ndim - 1))
    if obliquity is not None:
        ends = ends / obliquity
    shape = len(ends), *like.shape
    return np.concatenate([np.zeros((1, *like.shape)), np.broadcast_to(ends, shape)])
