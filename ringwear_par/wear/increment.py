"""The wear of one implicit step: a convex part of the contact problem, whatever the laws.

A body without layers has one; one with layers wears through as many of them as it gets. As a
function of pressure that does not fall either; where little is left of a layer that does not wear
at a pressure at which the next one does, it almost jumps.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, columns
from ringwear_par.errors import ComputationError
from ringwear_par.schedules import history, take
from ringwear_par.wear.averaging import averaged, averaged_rate
from ringwear_par.wear.checked_law import complete
from ringwear_par.wear.law import Law, Layers, WearLaw
from ringwear_par.wear.layer_split import LayerSplit, d_split, split
from ringwear_par.wear.local_state import LocalState

_MEMORY_ITERATIONS = 60
#: relative change at which the wear of a step is found, and below which it may stop falling
_ROUND_OFF, _NOISE = 1e-15, 1e-9
#: panels of integrals over pressure: alike, or halved towards a kink
_PANELS, _HALVED_PANELS, _BISECTIONS = 8, 48, 60
_GAUSS = tuple(0.5 * v for v in np.polynomial.legendre.leggauss(8))


@dataclass(frozen=True)
class Closing:
    """Elements whose gap wear has to close in a step before it can take anything off.

    Where the bodies around an element wear as fast as its gap closes, what it would lose in contact
    all along is gap first and wear then: ``max(0, step rate(p) - gap)``.

    Parameters
    ----------
    gap : (..., n) float, mm, at the start of the step; 0 in contact.
    step : (..., n) float, s, of each element.
    """

    gap: FloatArray
    step: FloatArray


class WearingBody(NamedTuple):
    """A body that wears, at the start of a step.

    Parameters
    ----------
    side : 0 of lower, 1 of upper.
    law, at, average : as of the increment.
    layers : of which it has one at least.
    """

    side: int
    law: Law
    at: LocalState
    average: FloatArray | None
    layers: Layers


@dataclass(frozen=True)
class WearIncrement:
    """Wear of both bodies over one implicit step, as a function of the pressure at its end.

    Of one history, whose pressures are (n,), or of B with the same elements and averages: (B, n).
    The numbers of a history are the same to the last bit alone and among others.

    Parameters
    ----------
    laws : laws of lower and upper, None for a body that does not wear.
    at : local state of lower and upper at the end of the step, with the wear before it.
    step : s, or (B,) of them.
    averages : (n, n) matrices of the non-local laws, None for local ones.
    obliquity : (n,) float, 1 / cos alpha of the sloping faces, None where they are flat: laws speak
        of what is lost along the normal, and all results here of what is lost along the axis.
    closing : of local laws, elements that come into contact in the step; its steps are those of
        the elements.
    """

    laws: tuple[WearLaw | Law | None, ...]
    at: tuple[LocalState, ...]
    step: float | FloatArray
    averages: tuple[FloatArray | None, ...] = (None, None)
    obliquity: FloatArray | None = None
    closing: Closing | None = None

    #: those that wear
    bodies: list[WearingBody] = field(init=False, repr=False, compare=False)
    #: whether all laws are local, so that ``d_depth_dp`` is the whole derivative
    local: bool = field(init=False, repr=False)
    #: whether any body has more than one layer; then all laws are local
    layered: bool = field(init=False, repr=False)

    def __post_init__(self) -> None:
        bodies = []
        for i, (law, at, average) in enumerate(zip(self.laws, self.at, self.averages, strict=True)):
            if law is not None:
                completed = complete(law)
                bodies.append(WearingBody(i, completed, at, average, completed.layers(at)))
        object.__setattr__(self, "bodies", bodies)
        object.__setattr__(self, "local", all(a is None for a in self.averages))
        object.__setattr__(self, "layered", any(len(body.layers.laws) > 1 for body in bodies))
        if self.closing is not None:
            object.__setattr__(self, "step", self.closing.step)
        elif isinstance(self.step, np.ndarray):
            object.__setattr__(self, "step", columns(self.step))

    @property
    def nearly_discontinuous(self) -> bool:
        """Whether depth may almost jump with pressure: where there is a layer to get through."""
        return self.layered and any(body.layers.remaining.any() for body in self.bodies)

    def history(self, i: int) -> "WearIncrement":
        """Return the increment of one of B histories."""
        return type(self)(
            tuple(None if law is None else complete(law).history(i) for law in self.laws),
            tuple(at.history(i) for at in self.at),
            history(self.step, i),
            self.averages,
            self.obliquity,
            None if self.closing is None else Closing(self.closing.gap[i], self.closing.step[i]),
        )

    def take(self, histories: IntArray) -> "WearIncrement":
        """Return the increment of some of B histories."""
        closing, lower = self.closing, self.at[0].take(histories)
        return type(self)(
            tuple(None if law is None else complete(law).take(histories) for law in self.laws),
            (lower, lower if self.at[1] is self.at[0] else self.at[1].take(histories)),
            take(self.step, histories),
            self.averages,
            self.obliquity,
            None
            if closing is None
            else Closing(take(closing.gap, histories), take(closing.step, histories)),
        )

    def along_axis(self, normal: FloatArray) -> FloatArray:
        """Return depths along the axis from those along the normal, (..., n) mm."""
        return normal if self.obliquity is None else self.obliquity * normal

    # -- one material ------------------------------------------------------------------------------

    def _depth(
        self, law: Law, at: LocalState, average: FloatArray | None, p: FloatArray
    ) -> FloatArray:
        """Return the depth d = step rate(p, wear + d) of one material along the normal, mm."""
        p = np.maximum(p, 0.0)
        if law.remembers:
            at = self.after_step(law, at, p)
        return self.step * averaged_rate(law, at, average, p)

    def after_step(self, law: Law, at: LocalState, p: FloatArray) -> LocalState:
        """Return the local state with the depth worn at the end of the step (Newton, from below).

        A history that has settled stays as it is while others go on.

        Raises
        ------
        ComputationError : it does not settle: the rate grows with worn depth too fast.
        """
        depth = np.zeros_like(p)
        before: Any = np.inf
        settled: Any = np.zeros(p.shape[:-1], dtype=bool)
        for _ in range(_MEMORY_ITERATIONS):
            trial = replace(at, wear=at.wear + depth)
            rise = 1.0 - self.step * law.d_rate_dwear(p, trial)
            if (rise <= 0.0).any() and ((rise <= 0.0).any(axis=-1) & ~settled).any():
                e = int(np.where(settled[..., None], np.inf, rise).argmin())
                break
            change = (self.step * law.rate(p, trial) - depth) / rise
            if p.ndim > 1:
                change[settled] = 0.0
            depth = np.maximum(depth + change, 0.0)
            worst = np.abs(change) / np.maximum(at.wear + depth, 1e-300)
            e, largest = int(worst.argmax()), worst.max(axis=-1)
            # no better than its round-off
            settled = (largest <= _ROUND_OFF) | ((before <= largest) & (largest <= _NOISE))
            if settled if p.ndim == 1 else settled.all():
                return replace(at, wear=at.wear + depth)
            before = largest
        raise ComputationError(self._unsettled(at, np.unravel_index(e, p.shape)))

    def _unsettled(self, at: LocalState, place: tuple[Any, ...]) -> str:
        """Return which element (of which history, where there are some) does not settle."""
        step, among = self.step, ""
        if len(place) > 1:
            at, step, among = at.history(place[0]), history(step, place[0]), f"history {place[0]}, "
        if isinstance(step, np.ndarray):
            step = step[place[-1]]
        return (
            f"wear law at time {at.time:g} s: the wear of {among}element {place[-1]} "
            f"(r = {at.r[place[-1]]:.6g} mm) over a step of {step:g} s does not settle; the rate "
            "grows with worn depth too fast"
        )

    def _d_depth_dp(self, law: Law, at: LocalState, p: FloatArray) -> FloatArray:
        p = np.maximum(p, 0.0)
        if not law.remembers:
            return self.step * law.d_rate_dp(p, at)
        after = self.after_step(law, at, p)
        return self.step * law.d_rate_dp(p, after) / (1.0 - self.step * law.d_rate_dwear(p, after))

    # -- by layer ----------------------------------------------------------------------------------

    def _by_layer(
        self, body: WearingBody, function: Callable[[Law, LocalState], FloatArray], p: FloatArray
    ) -> FloatArray:
        """Return a function of the law of each layer, (layers, ..., n), 0 where all is gone."""
        laws, states, remaining, _ = body.layers
        if len(laws) == 1:
            return function(laws[0], states[0])[None]
        values = np.zeros((len(laws), *np.broadcast_shapes(p.shape, remaining.shape[1:])))
        for number, (law, at) in enumerate(zip(laws, states, strict=True)):
            if number == len(remaining) or remaining[number].any():
                values[number] = function(law, at)
        return values

    def _layer_depths(self, body: WearingBody, p: FloatArray) -> FloatArray:
        """Return the depth that each layer would lose in all of the step, (layers, ..., n) mm."""
        return self._by_layer(body, lambda law, at: self._depth(law, at, body.average, p), p)

    def _layer_slopes(self, body: WearingBody, p: FloatArray) -> FloatArray:
        """Return derivatives of local ``_layer_depths`` with respect to pressure, mm/MPa."""
        return self._by_layer(body, lambda law, at: self._d_depth_dp(law, at, p), p)

    def _split(self, body: WearingBody, p: FloatArray, share: FloatArray | float) -> LayerSplit:
        return split(self._layer_depths(body, p), body.layers.remaining, share)

    # -- depths ------------------------------------------------------------------------------------

    def depth_in_present_layer(self, p: FloatArray) -> FloatArray:
        """Return the depths lost in contact all along in the layers at the faces, (2, ..., n) mm.

        Of lower and upper, as if these layers had no end.
        """
        depths = np.zeros((2, *p.shape))
        for body in self.bodies:
            depths[body.side] = self.along_axis(body.layers.at_face(self._layer_depths(body, p)))
        return depths

    def depth_if_always_in_contact(self, p: FloatArray) -> FloatArray:
        """Return the depths that lower and upper lose in contact all along, (2, ..., n) mm."""
        if not self.layered:
            return self.depth_in_present_layer(p)
        return self._depths_in_share(p, 1.0)

    def depths_in_share(
        self, p: FloatArray, always: FloatArray, share: FloatArray | float
    ) -> FloatArray:
        """Return the depths that lower and upper lose in a share of the step, (2, ..., n) mm.

        Parameters
        ----------
        always : ``depth_if_always_in_contact``.
        share : (..., n) or a number; more than 1 where the step counts for longer.
        """
        return self._depths_in_share(p, share) if self.layered else share * always

    def _depths_in_share(self, p: FloatArray, share: FloatArray | float) -> FloatArray:
        depths = np.zeros((2, *p.shape))
        for body in self.bodies:
            depths[body.side] = self.along_axis(self._split(body, p, share).depths.sum(axis=0))
        return depths

    def depths(self, p: FloatArray) -> FloatArray:
        """Return the depths that lower and upper lose, (2, ..., n) mm."""
        if self.closing is None:
            return self.depth_if_always_in_contact(p)
        always = self.depth_in_present_layer(p)
        share = self.share(always)
        return self._depths_in_share(p, share) if self.layered else always * share

    def explicit(self, p: FloatArray) -> FloatArray:
        """Return the depths that both lose at the rates of the start, (2, ..., n) mm."""
        depths = np.zeros((2, *p.shape))
        for body in self.bodies:
            full = self._by_layer(body, lambda law, at: self.step * law.rate(p, at), p)
            lost = split(full, body.layers.remaining, 1.0).depths.sum(axis=0)
            depths[body.side] = self.along_axis(lost)
        return depths

    def rates(self, p: FloatArray, depths: FloatArray) -> FloatArray:
        """Return the rates of wear at the end of the step, (2, ..., n) mm/s.

        They are evaluated at the pressure, apart from the depths (2, ..., n) mm, whose volumes are
        to be the same; of the depths, only laws that depend on them take any notice.
        """
        rates = np.zeros((2, *p.shape))
        for i, law, at, average, _ in self.bodies:
            lost = depths[i] if self.obliquity is None else depths[i] / self.obliquity
            after = replace(at, wear=at.wear + lost) if law.remembers else at
            rates[i] = self.along_axis(averaged_rate(law, after, average, p))
        return rates

    def integrated_rates(
        self, p: FloatArray, depths: FloatArray, share: FloatArray | float
    ) -> FloatArray:
        """Return the rates integrated over a share of the step, (2, ..., n) mm, see ``rates``.

        Through layers each rate lasts as long as its layer does.
        """
        if not self.layered:
            return share * (self.step * self.rates(p, depths))
        q = np.maximum(p, 0.0)

        def rate(law: Law, at: LocalState) -> FloatArray:
            return law.rate(q, self.after_step(law, at, q) if law.remembers else at)

        integrals = np.zeros((2, *p.shape))
        for body in self.bodies:
            times, rates = self._split(body, p, share).times, self._by_layer(body, rate, p)
            integrals[body.side] = self.along_axis((times * (self.step * rates)).sum(axis=0))
        return integrals

    def share(self, always: FloatArray) -> FloatArray:
        """Return the share of the step, (..., n), that is left for wear once the gap is closed.

        Parameters
        ----------
        always : (2, ..., n) mm, ``depth_in_present_layer``.
        """
        total = always[0] + always[1]
        share = np.ones_like(total)
        if self.closing is not None:
            open_, left = self.closing.gap > 0.0, total - self.closing.gap
            share[open_] = 0.0
            np.divide(left, total, out=share, where=open_ & (left > 0.0))
        return share

    def d_share(self, total: FloatArray, d_total: FloatArray, d_gap: Any) -> FloatArray:
        """Return derivatives of ``share`` from those of total depth and gap.

        Parameters
        ----------
        total : (..., n) mm, of both bodies; ``d_total`` is (..., n) or (P, ..., n).
        d_gap : of the gaps that close, likewise.
        """
        assert self.closing is not None
        gap = self.closing.gap
        inside = (gap > 0.0) & (total > gap)
        total = np.where(inside, total, 1.0)
        return np.where(inside, (gap * d_total / total - d_gap) / total, 0.0)

    # -- layers ------------------------------------------------------------------------------------

    def breakthrough_time(self, p: FloatArray, share: FloatArray | float) -> FloatArray:
        """Return the share of the step after which bodies under layers are reached, (2, ..., n).

        Infinite where they are not in the share that is worn, or were already; of a body that has
        no layers too.
        """
        times = np.full((2, *p.shape), np.inf)
        for body in self.bodies:
            remaining = body.layers.remaining
            if len(remaining):
                parts = self._split(body, p, share)
                now = parts.worn_through.all(axis=0) & (remaining[-1] > 0.0)
                times[body.side] = np.where(now, parts.times[:-1].sum(axis=0), np.inf)
        return times

    def fraction_to_interface(self, p: FloatArray, share: FloatArray | float) -> FloatArray:
        """Return shares of the step, (..., n), that end where a body gets to its next layer.

        Of elements that would do so in a share of more than a step, but not in the step itself; the
        given share of others.
        """
        shares = np.broadcast_to(np.asarray(share, dtype=float), p.shape)
        for body in self.bodies:
            if len(body.layers.laws) > 1:
                full = self._layer_depths(body, p)
                c, a = body.layers.remaining_at_face(full), body.layers.at_face(full)
                ends = (a < c) & (shares * a > c)
                shares = np.where(ends, np.divide(c, a, out=np.ones_like(a), where=ends), shares)
        return shares

    def rate_ratio_below(self, p: FloatArray, usual: Any, largest: float) -> FloatArray:
        """Return how many times faster elements may wear under the layer that is worn, (..., n).

        Which is what an error of depth in this layer becomes, by then of time; from 1 to
        ``largest``. At the pressure, or at one that it may have fallen to when the layer is
        through: near a threshold of the layer hardly anything is worn off it.

        Parameters
        ----------
        usual : MPa, (..., n) or a number, such a pressure.
        """
        ratios = np.ones_like(p)
        for body in self.bodies:
            layers = body.layers
            wears = layers.at_face(self._layer_depths(body, p)) > 0.0
            for q in (p, np.minimum(p, usual)):
                full = self._layer_depths(body, q)
                here, below = layers.at_face(full), np.zeros_like(p)
                for number in range(1, len(full)):
                    below = np.where(
                        number > layers.present, np.maximum(below, full[number]), below
                    )
                ratio = np.divide(
                    below, here, out=np.full_like(p, largest), where=here * largest > below
                )
                ratios = np.maximum(ratios, np.where(wears & (below > 0.0), ratio, 1.0))
        return ratios

    # -- in the contact problem --------------------------------------------------------------------

    def depth(self, p: FloatArray) -> FloatArray:
        """Return the growth of the gap, (..., n) mm."""
        if self.layered:
            lower, upper = self.depths(p)
            return lower + upper
        return self._left(p) if self.closing is None else np.maximum(self._left(p), 0.0)

    def _left(self, p: FloatArray) -> FloatArray:
        """Return the depth of a step in contact all along beyond the gap, mm; may be negative."""
        parts = [self._depth(law, at, average, p) for _, law, at, average, _ in self.bodies]
        total = self.along_axis(total_of(parts))
        return total if self.closing is None else total - self.closing.gap

    def d_depth_dp(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_e, (..., n) mm/MPa; of local laws all there is."""
        if self.layered:
            return self._d_split_dp(p)
        slopes = []
        for _, law, at, average, _ in self.bodies:
            if average is None:
                slopes.append(self._d_depth_dp(law, at, p))
            else:
                slope = self._d_depth_dp(law, at, averaged(average, p))
                slopes.append(((average * average.T) * slope[..., None, :]).sum(axis=-1))
        total = self.along_axis(total_of(slopes))
        return total if self.closing is None else np.where(self._left(p) >= 0.0, total, 0.0)

    def _d_split_dp(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_e through layers, (..., n) mm/MPa."""
        full = [self._layer_depths(body, p) for body in self.bodies]
        slopes = [self._layer_slopes(body, p) for body in self.bodies]
        share: FloatArray | float = 1.0
        d_share: FloatArray | float = 0.0
        if self.closing is not None:
            worn, slope = np.zeros_like(p), np.zeros_like(p)
            for body, depths, d_depths in zip(self.bodies, full, slopes, strict=True):
                worn += self.along_axis(body.layers.at_face(depths))
                slope += self.along_axis(body.layers.at_face(d_depths))
            share = self.share(np.stack([worn, np.zeros_like(worn)]))
            d_share = self.d_share(worn, slope, 0.0)
        total = np.zeros_like(p)
        for body, depths, d_depths in zip(self.bodies, full, slopes, strict=True):
            parts = split(depths, body.layers.remaining, share)
            total += self.along_axis(d_split(depths, d_depths, parts, share, d_share))
        return total

    def jacobian(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_f, (..., n, n) mm/MPa."""
        n = p.shape[-1]
        total, diagonal = np.zeros((*p.shape, n)), np.arange(n)
        if self.layered:
            total[..., diagonal, diagonal] = self.d_depth_dp(p)
            return total
        for _, law, at, average, _ in self.bodies:
            if average is None:
                total[..., diagonal, diagonal] += self._d_depth_dp(law, at, p)
            else:
                slope = self._d_depth_dp(law, at, averaged(average, p))
                total += (average * slope[..., None, :]) @ average
        return total if self.obliquity is None else self.obliquity[:, None] * total

    def slope(self, p: FloatArray) -> FloatArray:
        """Return the derivative of the depth with respect to pressure, mm/MPa.

        (..., n) where laws are local, otherwise (..., n, n).
        """
        if not self.bodies:
            return np.zeros_like(p)
        return self.d_depth_dp(p) if self.local else self.jacobian(p)

    def depth_change(self, slope: FloatArray, change: FloatArray) -> FloatArray:
        """Return the depth changes, mm, for small pressure changes, (P, ..., n) MPa."""
        return slope * change if self.local else averaged(slope, change)

    def memory(self, p: FloatArray, worn: FloatArray) -> FloatArray | float:
        """Return the change of depth at the end over that at the start, pressure staying, (..., n).

        1 of laws that do not remember depth.

        Parameters
        ----------
        worn : (2, ..., n) mm, lost by lower and upper, by which a change is shared between them.
        """
        if not any(body.law.remembers for body in self.bodies):
            return 1.0
        total, q = worn.sum(axis=0), np.maximum(p, 0.0)

        def grown(law: Law, at: LocalState) -> FloatArray:
            if not law.remembers:
                return np.zeros_like(q)
            return 1.0 / (1.0 - self.step * law.d_rate_dwear(q, self.after_step(law, at, q))) - 1.0

        growth = np.ones_like(p)
        for body in self.bodies:
            if body.law.remembers:
                share = np.divide(
                    worn[body.side], total, out=np.zeros_like(total), where=total > 0.0
                )
                growth += share * body.layers.at_face(self._by_layer(body, grown, p))
        return growth

    # -- potential ---------------------------------------------------------------------------------

    def potential(self, p: FloatArray) -> FloatArray:
        """Return the integral of the depth from 0 to p, (..., n) MPa mm.

        Non-local laws: area integrals of it are those of the potential, not its values.
        """
        if self.layered:
            return self._potential_through_layers(p)
        if self.closing is None:
            return self._potential(p)
        low, high = np.zeros_like(p), np.maximum(p, 0.0)  # of the pressure that closes the gap
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            closed = self._left(middle) > 0.0
            low, high = np.where(closed, low, middle), np.where(closed, middle, high)
        low[self.closing.gap == 0.0] = 0.0
        past = np.maximum(p, 0.0) - low
        return self._potential(p) - self._potential(low) - self.closing.gap * past

    def _potential(self, p: FloatArray) -> FloatArray:
        parts = []
        for _, law, at, average, _ in self.bodies:
            q = np.maximum(p if average is None else averaged(average, p), 0.0)
            part = None if law.remembers else law.potential(q, at)
            parts.append(self._integrated(law, at, q) if part is None else self.step * part)
        return self.along_axis(total_of(parts))

    def _integrated(self, law: Law, at: LocalState, p: FloatArray) -> FloatArray:
        """Integrate the depth from the onset of wear to p by Gauss rules: exact where smooth."""
        low, total = law.onset(at), np.zeros_like(p)
        span = np.maximum(p - low, 0.0)
        for panel in range(_PANELS):
            for x, w in zip(*_GAUSS, strict=True):
                share = (panel + 0.5 + x) / _PANELS
                total += w / _PANELS * self._depth(law, at, None, low + share * span)
        return total * span

    def _potential_through_layers(self, p: FloatArray) -> FloatArray:
        """Integrate by Gauss rules between the pressures at which an element is through a layer."""
        top = np.maximum(p, 0.0)
        low, total = np.zeros_like(top), np.zeros_like(top)
        kinks = sum(len(body.layers.remaining) for body in self.bodies)
        kinks += self.closing is not None
        for number in range(kinks + 1):
            high = self._next_kink(low, top) if number < kinks else top
            total += self._between(low, high)
            low = high
        return total

    def _passed(self, p: FloatArray) -> Any:
        """Return how many layers an element is through, and whether it wears at all, (..., n)."""
        share: FloatArray | float = 1.0
        if self.closing is not None:
            share = self.share(self.depth_in_present_layer(p))
        count = np.broadcast_to(np.asarray(share) > 0.0, p.shape).astype(int)
        for body in self.bodies:
            count = count + self._split(body, p, share).worn_through.sum(axis=0)
        return count

    def _next_kink(self, low: FloatArray, high: FloatArray) -> FloatArray:
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
        for panel in range(_HALVED_PANELS + 1):
            width = 0.5 ** (panel + 1) if panel < _HALVED_PANELS else 0.5**_HALVED_PANELS
            start = width if panel < _HALVED_PANELS else 0.0
            for x, w in zip(*_GAUSS, strict=True):
                total += w * width * self.depth(low + (start + width * (0.5 + x)) * span)
        return total * span


def total_of(parts: list[FloatArray]) -> FloatArray:
    """Return the sum of fields of one body, or of two."""
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]
