"""The wear of an implicit step of bodies with layers, through as many of them as it gets.

As a function of pressure it does not fall either; where little is left of a layer that does not
wear at a pressure at which the next one does, it almost jumps.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.wear.increment import VariedIncrement, VaryingNumbers, WearIncrement
from ringwear_par.wear.law import Law
from ringwear_par.wear.layered import LayeredLaw, Passage, d_passage, passage
from ringwear_par.wear.local_state import LocalState

#: halvings of the pressures that integrals are taken over, towards a kink
_PANELS, _BISECTIONS = 48, 60
_GAUSS = tuple(0.5 * v for v in np.polynomial.legendre.leggauss(8))


@dataclass(frozen=True)
class _Layers:
    """A body with layers at the start of a step.

    Parameters
    ----------
    law : of the body.
    states : what the law of each layer, and of the body itself, knows.
    left : (layers, ..., n) mm, of each layer, along the normal.
    present : (..., n) int, which of them is at the face.
    """

    law: LayeredLaw
    states: list[LocalState]
    left: FloatArray
    present: Any

    @classmethod
    def of(cls, law: LayeredLaw, at: LocalState) -> "_Layers":
        """Return the layers of a body in a local state."""
        left = law.left(at.wear)
        return cls(law, law.states(at), left, (left <= 0.0).sum(axis=0))


@dataclass(frozen=True)
class LayeredIncrement(WearIncrement):
    """Wear of both bodies over one implicit step, one of which has layers or both; all laws local.

    ``WearIncrement.step`` may be that of elements, whose time is shared out by layer.
    """

    _bodies: dict[int, _Layers] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        bodies = {
            i: _Layers.of(law, at) for i, law, at, _ in self._each if isinstance(law, LayeredLaw)
        }
        object.__setattr__(self, "_bodies", bodies)

    @property
    def bends(self) -> bool:
        """Whether there is any layer left to get through."""
        return any(bool(body.left.any()) for body in self._bodies.values())

    # -- how time divides --------------------------------------------------------------------------

    def _full(
        self, body: _Layers, of_layer: Callable[[Law, LocalState], FloatArray], p: FloatArray
    ) -> FloatArray:
        """Return what a function gives of each law, (layers + 1, ..., n), 0 where all is gone."""
        found = np.zeros((len(body.law.laws), *np.broadcast_shapes(p.shape, body.left.shape[1:])))
        for number, (law, at) in enumerate(zip(body.law.laws, body.states, strict=True)):
            if number == len(body.left) or body.left[number].any():
                found[number] = of_layer(law, at)
        return found

    def _depths(self, body: _Layers, p: FloatArray) -> FloatArray:
        """Return what each law would take off in all of the step, (layers + 1, ..., n) mm."""
        p = np.maximum(p, 0.0)
        return self._full(body, lambda law, at: self._depth(law, at, None, p), p)

    def _slopes(self, body: _Layers, p: FloatArray) -> FloatArray:
        """Return derivatives of ``_depths`` with respect to pressure, mm/MPa."""
        return self._full(body, lambda law, at: self._d_depth_dp(law, at, p), p)

    def _present(self, body: _Layers, full: FloatArray) -> FloatArray:
        """Return what there is of the layer that is at the face of each element, (..., n)."""
        present = np.broadcast_to(body.present, full.shape[1:])
        return np.take_along_axis(full, present[None], axis=0)[0]

    def top(self, p: FloatArray) -> FloatArray:
        """Return what bodies would lose all along if they stayed in the layer that is at the face.

        (2, ..., n) mm.
        """
        depths = np.zeros((2, *p.shape))
        for i, law, at, average in self._each:
            body = self._bodies.get(i)
            if body is None:
                own = self._depth(law, at, average, p)
            else:
                own = self._present(body, self._depths(body, p))
            depths[i] = self._axial(own)
        return depths

    def _share(self, p: FloatArray) -> FloatArray | float:
        """Return the share of the step that an element wears."""
        return 1.0 if self.closing is None else self.share(self.top(p))

    def lost(self, p: FloatArray, worn: FloatArray, share: FloatArray | float) -> FloatArray:
        """Return what lower and upper lose in contact in a share of the step, (2, ..., n) mm."""
        depths = np.zeros((2, *p.shape))
        for i, law, at, average in self._each:
            body = self._bodies.get(i)
            own = (
                share * self._depth(law, at, average, p)
                if body is None
                else passage(self._depths(body, p), body.left, share).depths.sum(axis=0)
            )
            depths[i] = self._axial(own)
        return depths

    def unhindered(self, p: FloatArray) -> FloatArray:
        """Return what lower and upper would lose in contact all along, (2, ..., n) mm."""
        return self.lost(p, p, 1.0)

    def depths(self, p: FloatArray) -> FloatArray:
        """Return what lower and upper lose, (2, ..., n) mm."""
        return self.lost(p, p, self._share(p))

    def apart(self, p: FloatArray, worn: FloatArray, share: FloatArray | float) -> FloatArray:
        """Return what is lost in a share of the step, from the rates at the pressure alone."""
        depths, q = np.zeros((2, *p.shape)), np.maximum(p, 0.0)
        for i, law, at, _ in self._each:
            body = self._bodies.get(i)
            if body is None:
                there = self._after(law, at, q) if law.remembers else at
                own = share * (self.step * law.rate(p, there))
            else:
                times = passage(self._depths(body, p), body.left, share).times
                rates = self._full(
                    body,
                    lambda law, at: law.rate(q, self._after(law, at, q) if law.remembers else at),
                    p,
                )
                own = (times * (self.step * rates)).sum(axis=0)
            depths[i] = self._axial(own)
        return depths

    def through(self, p: FloatArray, share: FloatArray | float) -> FloatArray:
        """Return after which share of the step the bodies themselves are reached, (2, ..., n).

        Infinite where they are not in the share that is worn, or were already; of a body that has
        no layers too.
        """
        found = np.full((2, *p.shape), np.inf)
        for i, body in self._bodies.items():
            gone = passage(self._depths(body, p), body.left, share)
            now = gone.left_behind.all(axis=0) & (body.left[-1] > 0.0)
            found[i] = np.where(now, gone.times[:-1].sum(axis=0), np.inf)
        return found

    def until_next(self, p: FloatArray, share: FloatArray | float) -> FloatArray:
        """Return shares of the step, (..., n), that end where a body gets to its next layer.

        Of elements that would do so in a share of more than a step, but not in the step itself;
        of others the same.
        """
        found = np.broadcast_to(np.asarray(share, dtype=float), p.shape)
        for body in self._bodies.values():
            full = self._depths(body, p)
            left = np.concatenate([body.left, np.full_like(full[:1], np.inf)])
            c, a = self._present(body, left), self._present(body, full)
            ends = (a < c) & (found * a > c)
            found = np.where(ends, np.divide(c, a, out=np.ones_like(a), where=ends), found)
        return found

    def faster(self, p: FloatArray, usual: Any, most: float) -> FloatArray:
        """Return how many times faster elements may wear under the layer that is worn, (..., n).

        Which is what an error of depth in this layer becomes, by then of time; from 1 to ``most``.
        At the pressure, or at one that it may have fallen to when the layer is through: near a
        threshold of the layer hardly anything is worn off it.

        Parameters
        ----------
        usual : MPa, (..., n) or a number, such a pressure.
        """
        found = np.ones_like(p)
        for body in self._bodies.values():
            wears = self._present(body, self._depths(body, p)) > 0.0
            for q in (p, np.minimum(p, usual)):
                full = self._depths(body, q)
                here, below = self._present(body, full), np.zeros_like(p)
                for number in range(1, len(full)):
                    below = np.where(number > body.present, np.maximum(below, full[number]), below)
                times = np.divide(below, here, out=np.full_like(p, most), where=here * most > below)
                found = np.maximum(found, np.where(wears & (below > 0.0), times, 1.0))
        return found

    def explicit(self, p: FloatArray) -> FloatArray:
        """Return what both lose at the rates of the start, (2, ..., n) mm, layer by layer."""
        depths = np.zeros((2, *p.shape))
        for i, law, at, _ in self._each:
            body = self._bodies.get(i)
            if body is None:
                own = self.step * law.rate(p, at)
            else:
                full = self._full(body, lambda law, at: self.step * law.rate(p, at), p)
                own = passage(full, body.left, 1.0).depths.sum(axis=0)
            depths[i] = self._axial(own)
        return depths

    def _remembered(self, i: int, law: Law, at: LocalState, p: FloatArray) -> FloatArray:
        """Return what a change of the depth of body i grows by in the step, over that change.

        In the layer that is at the face.
        """
        body, of_any = self._bodies.get(i), super()._remembered
        if body is None:
            return of_any(i, law, at, p)
        grown = self._full(
            body, lambda law, at: of_any(i, law, at, p) if law.remembers else np.zeros_like(p), p
        )
        return self._present(body, grown)

    # -- in the contact problem --------------------------------------------------------------------

    def depth(self, p: FloatArray) -> FloatArray:
        """Return the growth of the gap, (..., n) mm."""
        lower, upper = self.depths(p)
        return lower + upper

    def d_depth_dp(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_e, (..., n) mm/MPa."""
        share, d_share = self._share(p), self._d_share(p)
        total = np.zeros_like(p)
        for i, law, at, average in self._each:
            body = self._bodies.get(i)
            if body is None:
                slope = self._d_depth_dp(law, at, p)
                own = share * slope
                if self.closing is not None:
                    own = own + d_share * self._depth(law, at, average, p)
            else:
                full, slopes = self._depths(body, p), self._slopes(body, p)
                own = d_passage(full, slopes, passage(full, body.left, share), share, d_share)
            total += self._axial(own)
        return total

    def _d_share(self, p: FloatArray) -> FloatArray | float:
        """Return d share_e / d p_e, 1/MPa."""
        if self.closing is None:
            return 0.0
        slope = np.zeros_like(p)
        for i, law, at, _ in self._each:
            body = self._bodies.get(i)
            if body is None:
                own = self._d_depth_dp(law, at, p)
            else:
                own = self._present(body, self._slopes(body, p))
            slope += self._axial(own)
        return self.d_share(self.top(p).sum(axis=0), slope, 0.0)

    def jacobian(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_f, (..., n, n) mm/MPa."""
        n = p.shape[-1]
        total, own = np.zeros((*p.shape, n)), np.arange(n)
        total[..., own, own] = self.d_depth_dp(p)
        return total

    def potential(self, p: FloatArray) -> FloatArray:
        """Return the integral of the depth from 0 to p, (..., n) MPa mm.

        By Gauss rules between the pressures at which an element is through one layer more, finer
        towards each of them, where depth rises steeply.
        """
        top = np.maximum(p, 0.0)
        low, total = np.zeros_like(top), np.zeros_like(top)
        most = sum(len(body.left) for body in self._bodies.values()) + (self.closing is not None)
        for number in range(most + 1):
            high = top
            if number < most:
                high = self._where_passed(low, top)
            total += self._between(low, high)
            low = high
        return total

    def _passed(self, p: FloatArray) -> Any:
        """Return how many layers an element is through, and whether it wears at all, (..., n)."""
        share = self._share(p)
        count = np.broadcast_to(np.asarray(share) > 0.0, p.shape).astype(int)
        for body in self._bodies.values():
            count = count + passage(self._depths(body, p), body.left, share).left_behind.sum(axis=0)
        return count

    def _where_passed(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the lowest pressures at which more layers are passed than just above others."""
        before = self._passed(np.minimum(low * (1.0 + 1e-12) + 1e-300, high))
        start, end = low.copy(), high.copy()
        for _ in range(_BISECTIONS):
            middle = 0.5 * (start + end)
            more = self._passed(middle) > before
            start, end = np.where(more, start, middle), np.where(more, middle, end)
        return end

    def _between(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Integrate the depth between pressures by Gauss rules, finer towards the lower ones."""
        total, span = np.zeros_like(low), high - low
        if not span.any():
            return total
        for panel in range(_PANELS + 1):
            width = 0.5 ** (panel + 1) if panel < _PANELS else 0.5**_PANELS
            start = width if panel < _PANELS else 0.0
            for x, w in zip(*_GAUSS, strict=True):
                total += w * width * self.depth(low + (start + width * (0.5 + x)) * span)
        return total * span

    def _d_ends(self, d_thickness: FloatArray, like: FloatArray) -> FloatArray:
        """Return derivatives of the depths between layers, (layers + 1, P, ..., n), along normals.

        The first of them is that of the face, 0.
        """
        ends = np.cumsum(d_thickness, axis=0).reshape(*d_thickness.shape, *(1,) * (like.ndim - 1))
        if self.obliquity is not None:
            ends = ends / self.obliquity
        shape = len(ends), *like.shape
        return np.concatenate([np.zeros((1, *like.shape)), np.broadcast_to(ends, shape)])

    # -- derivatives -------------------------------------------------------------------------------

    def varied(
        self,
        p: FloatArray,
        numbers: VaryingNumbers,
        d_wear: FloatArray,
        d_step: FloatArray | None,
        instant: bool,
    ) -> "VariedIncrement":
        """Return how depths vary with P numbers, and with pressure.

        See ``WearIncrement.varied``.
        """
        q, bodies = np.maximum(p, 0.0), {}
        for i, law, at, _ in self._each:
            body = self._bodies.get(i)
            normal = d_wear[i] if self.obliquity is None else d_wear[i] / self.obliquity
            layers: list[tuple[int | None, Law, LocalState]] = [(None, law, at)]
            ends = (
                self._d_ends(numbers.thicknesses[i], normal) if body is not None else normal[None]
            )
            if body is not None:
                each = zip(body.law.laws, body.states, strict=True)
                layers = [(number, *own) for number, own in enumerate(each)]
            full = np.zeros((len(layers), *p.shape))
            change, slope = np.zeros((len(layers), *d_wear[i].shape)), np.zeros_like(full)
            for place, (layer, own, there) in enumerate(layers):
                within = own.remembers and not instant
                after = self._after(own, there, q) if within else there
                full[place] = self.step * own.rate(q, after)
                change[place] = numbers.rates(i, own, q, after, layer)
                before = own.d_rate_dbefore(q, after)
                if before is not None:
                    if body is None:
                        change[place] += before * normal
                    else:  # of its own layer's wear
                        here = body.present == layer
                        change[place] += here * (before * (normal - ends[place]))
                change[place] *= self.step
                slope[place] = self.step * own.d_rate_dp(q, after)
                if d_step is not None:
                    change[place] += d_step * own.rate(q, after)
                if within and before is not None:
                    change[place] /= 1.0 - self.step * before
                    slope[place] /= 1.0 - self.step * before
            d_left = None
            if body is not None:
                d_left = np.zeros((len(body.left), *normal.shape))
                for number, (start, end) in enumerate(itertools.pairwise(ends)):
                    untouched = np.where(body.present < number, end - start, 0.0)
                    d_left[number] = np.where(body.present == number, end - normal, untouched)
            bodies[i] = _VariedBody(body, full, change, slope, d_left)
        return VariedLayers((), self.obliquity, self, bodies)


@dataclass(frozen=True)
class _VariedBody:
    """How a body's depths in all of a step vary with P numbers, by layer and along the normal.

    Parameters
    ----------
    body : its layers; None: it has none.
    full : (layers + 1, ..., n) mm.
    change : (layers + 1, P, ..., n) mm, at given pressure.
    slope : (layers + 1, ..., n) mm/MPa.
    d_left : (layers, P, ..., n) mm, of what is left of layers.
    """

    body: _Layers | None
    full: FloatArray
    change: FloatArray
    slope: FloatArray
    d_left: FloatArray | None

    def passed(self, share: Any) -> Passage:
        """Return how a share of the step divides."""
        left = self.full[:0] if self.body is None else self.body.left
        return passage(self.full, left, share)

    def top(self, values: FloatArray) -> FloatArray:
        """Return of values by layer, (layers + 1, [P,] ..., n), those of the one at the face."""
        if self.body is None:
            return values[0]
        found = values[-1]
        for number in range(len(values) - 1):
            found = np.where(self.body.present == number, values[number], found)
        return found


@dataclass(frozen=True)
class VariedLayers(VariedIncrement):
    """How the depths of an increment through layers vary with P numbers.

    Parameters
    ----------
    of : the increment.
    each : its bodies.
    """

    of: LayeredIncrement
    each: Mapping[int, _VariedBody]

    @cached_property
    def _total(self) -> FloatArray:
        """What both bodies would lose all along in the layers at their faces, (..., n) mm."""
        return self._axial(sum(one.top(one.full) for one in self.each.values()))

    def _axial(self, normal: Any) -> Any:
        return normal if self.obliquity is None else self.obliquity * normal

    def posed(
        self, during: WearIncrement, p: FloatArray, closes: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return how the depth in the contact problem varies at given pressure, and with it."""
        share: Any = 1.0
        d_share: Any = 0.0
        if during.closing is not None:
            share = during.share(np.stack([self._total, np.zeros_like(self._total)]))
            d_total = self._axial(sum(one.top(one.change) for one in self.each.values()))
            d_share = self.of.d_share(self._total, d_total, closes)
        worn = sum(
            d_passage(one.full, one.change, one.passed(share), share, d_share, one.d_left)
            for one in self.each.values()
        )
        return self._axial(worn), during.d_depth_dp(p)

    def top(self, d_p: FloatArray) -> dict[int, FloatArray]:
        """Return derivatives of ``LayeredIncrement.top``, (P, ..., n) mm of each body."""
        return {
            i: self._axial(one.top(one.change) + one.top(one.slope) * d_p)
            for i, one in self.each.items()
        }

    def until_next(self, share: float, d_p: FloatArray) -> FloatArray:
        """Return derivatives of ``LayeredIncrement.until_next``, (P, ..., n)."""
        found, ends = np.zeros_like(d_p), np.full(d_p.shape[1:], share)
        for one in self.each.values():
            if one.body is None:
                continue
            left = np.concatenate([one.body.left, np.full_like(one.full[:1], np.inf)])
            assert one.d_left is not None
            d_left = np.concatenate([one.d_left, np.zeros_like(one.change[:1])])
            c, a, d_c = one.top(left), one.top(one.full), one.top(d_left)
            now = (a < c) & (ends * a > c)
            ends = np.divide(c, a, out=ends.copy(), where=now)
            d_a = one.top(one.change) + one.top(one.slope) * d_p
            found = np.where(now, (d_c - ends * d_a) / np.where(now, a, 1.0), found)
        return found

    def lost(
        self, d_p: FloatArray, worn: FloatArray, share: Any, d_share: Any
    ) -> dict[int, FloatArray]:
        """Return derivatives of ``LayeredIncrement.lost``, (P, ..., n) mm of each body."""
        found = {}
        for i, one in self.each.items():
            d_full = one.change + one.slope[:, None] * d_p
            found[i] = self._axial(
                d_passage(one.full, d_full, one.passed(share), share, d_share, one.d_left)
            )
        return found

    def with_pressure(self, d_p: FloatArray) -> dict[int, FloatArray]:
        """Return derivatives of the unhindered depths, (P, ..., n) mm of each body."""
        return self.lost(d_p, d_p, 1.0, 0.0)
