"""The wear of one implicit step: a convex part of the contact problem, whatever the laws.

It does not fall with pressure. An element of a body with layers wears by the law of one of them in
all of a step, see ``LayeredLaw.in_layers``.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ringwear_par import batched
from ringwear_par.arrays import FloatArray, IntArray, columns, largest
from ringwear_par.compiled import step_rows
from ringwear_par.compiled.machine_code import load
from ringwear_par.errors import ComputationError
from ringwear_par.schedules import take
from ringwear_par.wear.law import Law, PacedLaw
from ringwear_par.wear.laws.non_local import averaged, averaged_rate
from ringwear_par.wear.layered import LayeredLaw
from ringwear_par.wear.local_state import LocalState

_MEMORY_ITERATIONS = 60
#: relative change with which the wear of a step is found, and below which it may stop falling
_LAST, _NOISE = 1e-10, 1e-9
#: panels of integrals over pressure, and halvings towards the pressure that closes a gap
_PANELS, _BISECTIONS = 8, 60
_GAUSS = tuple(0.5 * v for v in np.polynomial.legendre.leggauss(8))


@dataclass(frozen=True)
class Closing:
    """Elements whose gap wear has to close in a step before it can take anything off.

    Where the bodies around an element wear as fast as its gap closes, what it would lose in contact
    all along is gap first and wear then: ``max(0, step rate(p) - gap)``.
    """

    #: (..., n) float, mm, at the start of the step; 0 in contact
    gap: FloatArray
    #: (..., n) float, s, of each element
    step: FloatArray


class WearingBody(NamedTuple):
    """A body that wears, at the start of a step."""

    #: 0 of lower, 1 of upper
    side: int
    #: as of the increment
    law: Law
    at: LocalState
    average: FloatArray | None


class _Losses(NamedTuple):
    """What pressures wear off in contact all along."""

    #: (..., n) MPa
    pressure: FloatArray
    #: (bodies, ..., n) mm/s, along the axis, of the bodies that wear
    rates: FloatArray
    #: (..., n) mm, of both together, and what gaps that close leave of it
    depth: FloatArray
    growth: FloatArray
    #: (..., n) mm/MPa, its derivative where all rates are lines; None: laws have to be asked
    slope: FloatArray | None


@dataclass(eq=False)
class WearIncrement:
    """Wear of both bodies over one implicit step, as a function of the pressure at its end.

    Of B histories with the same elements and averages. The numbers of a history are the same to the
    last bit alone and among others.
    """

    #: laws of lower and upper, None for a body that does not wear
    laws: tuple[Law | None, ...]
    #: local state of lower and upper at the end of the step, with the wear before it
    at: tuple[LocalState, ...]
    #: s, or (B,) of them
    step: float | FloatArray
    #: (n, n) matrices of the non-local laws, None for local ones
    averages: tuple[FloatArray | None, ...] = (None, None)
    #: (n,) float, 1 / cos alpha of the sloping faces, None where they are flat: laws speak of what
    #: is lost along the normal, and all results here of what is lost along the axis
    obliquity: FloatArray | None = None
    #: of local laws, elements that come into contact in the step; its steps are those of the
    #: elements
    closing: Closing | None = None
    #: (2,) or (2, B) factors on the rates of lower and upper; None: 1
    pace: FloatArray | None = None

    #: those that wear
    bodies: list[WearingBody] = field(init=False, repr=False, compare=False)
    #: whether all laws are local, so that ``d_depth_dp`` is the whole derivative
    local: bool = field(init=False, repr=False)
    #: whether any body has layers, whose laws may differ from element to element
    layered: bool = field(init=False, repr=False)
    #: of laws that remember, by identity: the last pressures, and the local states before and after
    #: the step; one law may serve both bodies
    _after: dict[int, tuple[FloatArray, LocalState, LocalState]] = field(
        default_factory=dict, init=False, repr=False
    )
    #: at the last pressures: it is asked for several times
    _known: _Losses | None = field(default=None, init=False, repr=False)
    #: (2, bodies, ..., n) rises and onsets of the rates of those that wear, see ``Law.line``;
    #: empty: some are no lines; None: laws were not asked yet
    _lines: FloatArray | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        parts = enumerate(zip(self.laws, self.at, self.averages, strict=True))
        self.bodies = [
            WearingBody(i, law, at, average) for i, (law, at, average) in parts if law is not None
        ]
        self._sides = np.array([body.side for body in self.bodies], dtype=np.int64)
        self._remembers = any(body.law.remembers for body in self.bodies)
        self.local = all(average is None for average in self.averages)
        self.layered = any(isinstance(body.law, LayeredLaw) for body in self.bodies)
        if self.pace is not None:
            self.bodies = [
                b._replace(law=PacedLaw(b.law, columns(self.pace[b.side]))) for b in self.bodies
            ]
        self.duration = self.step
        self.step = columns(self.step) if self.closing is None else self.closing.step

    def with_step(
        self, step: float | FloatArray, closing: Closing | None = None
    ) -> "WearIncrement":
        """Return the increment over another step of laws that are steady, of which it knows all."""
        if closing is not None:
            self._lines_over(closing.gap.shape)  # which later increments of the step share
        other = copy(self)
        other.duration, other.closing, other._known = step, closing, None
        other.step = columns(step) if closing is None else closing.step
        return other

    def take(self, histories: IntArray) -> "WearIncrement":
        """Return the increment of some of B histories."""
        lower = self.at[0].take(histories)
        return type(self)(
            tuple(None if law is None else law.take(histories) for law in self.laws),
            (lower, lower if self.at[1] is self.at[0] else self.at[1].take(histories)),
            take(self.step, histories),
            self.averages,
            self.obliquity,
            None if self.closing is None else batched.take(self.closing, histories),
            None if self.pace is None else self.pace[:, histories],
        )

    def growth_of(self, histories: IntArray) -> "WearIncrement":
        """Return the increment of some of B histories, for depths and their slopes alone."""
        if self._lines is None or not self._lines.size:
            return self.take(histories)
        part = copy(self)
        part.step, part._known = take(self.step, histories), None
        part._lines = self._lines.take(histories, 2)
        part.closing = None if self.closing is None else batched.take(self.closing, histories)
        return part

    def along_axis(self, normal: FloatArray) -> FloatArray:
        """Return depths along the axis from those along the normal, (..., n) mm."""
        return normal if self.obliquity is None else self.obliquity * normal

    # -- one material ------------------------------------------------------------------------------

    def _rate(
        self, law: Law, at: LocalState, average: FloatArray | None, p: FloatArray
    ) -> FloatArray:
        """Return the rate(p, wear + d) of one material along the normal, d = step rate, mm/s."""
        p = _not_negative(p)
        if law.remembers:
            at = self.after_step(law, at, p)
        return np.ascontiguousarray(averaged_rate(law, at, average, p))

    def _worn(self, p: FloatArray) -> _Losses:
        """Return rates, depths and slopes at pressures in contact all along."""
        known = self._known
        if known is not None and known.pressure is p:
            return known
        lines, n, closing = self._lines_over(p.shape), p.shape[-1], self.closing
        if lines.size:
            of_elements = np.size(self.step) == p.size
            step = _filled(self.step, p.shape if of_elements else (*p.shape[:-1], 1))
            rates, (depth, slope) = np.empty(lines.shape[1:]), np.empty((2, *p.shape))
            growth = depth if closing is None else np.empty_like(depth)
            load(step_rows).wear_by_lines(
                p.size // n, n, len(rates), np.ascontiguousarray(p), step, of_elements, *lines,
                rates, depth, slope, depth if closing is None else closing.gap,
                closing is not None, growth,
            )  # fmt: skip
            self._known = _Losses(p, rates, depth, growth, slope)
        else:
            of_bodies = [
                self.along_axis(self._rate(law, at, average, p))
                for _, law, at, average in self.bodies
            ]
            depths = [self.step * rate for rate in of_bodies]
            depth = total_of(depths) if depths else np.zeros_like(p)
            growth = depth if closing is None else np.maximum(depth - closing.gap, 0.0)
            self._known = _Losses(p, _stacked(of_bodies, p.shape), depth, growth, None)
        return self._known

    def _lines_over(self, shape: tuple[int, ...]) -> FloatArray:
        """Return rises, along the axis, and onsets of rates at pressures of a shape; see above."""
        if self._lines is None or (self._lines.size and self._lines.shape[2:] != shape):
            lines = [law.line(at) if a is None else None for _, law, at, a in self.bodies]
            of_bodies = [(self.along_axis(line[0]), line[1]) for line in lines if line is not None]
            self._lines = np.empty((2, len(lines), *shape))
            if len(of_bodies) < len(lines):
                self._lines = self._lines[:, :0]
            for body, line in enumerate(of_bodies[: self._lines.shape[1]]):
                self._lines[0, body], self._lines[1, body] = line
        return self._lines

    def after_step(self, law: Law, at: LocalState, p: FloatArray) -> LocalState:
        """Return the local state with the depth worn at the end of the step.

        As the law has it, else by Newton's method, from below: a history that has settled stays as
        it is while others go on. Depths, slopes and errors are asked for at the same pressures one
        after another.

        Raises
        ------
        ComputationError : it does not settle: the rate grows with worn depth too fast.
        """
        if id(law) in self._after:
            pressure, before_step, after = self._after[id(law)]
            if before_step is at and (pressure is p or np.array_equal(pressure, p)):
                return after
        if (solved := law.depth_in_step(p, at, self.step)) is not None:
            self._after[id(law)] = p, at, at.worn_by(solved)
            return self._after[id(law)][2]
        depth, trial = np.zeros_like(p), at
        before: Any = np.inf
        settled: Any = np.zeros(p.shape[:-1], dtype=bool)
        for _ in range(_MEMORY_ITERATIONS):
            rise = 1.0 - self.step * law.d_rate_dwear(p, trial)
            if not rise.min() > 0.0 and ((rise <= 0.0).any(axis=-1) & ~settled).any():
                worst = np.where(settled[..., None], -np.inf, -rise)
                break
            change = (self.step * law.rate(p, trial) - depth) / rise
            if settled.any():
                change[settled] = 0.0
            depth = np.maximum(depth + change, 0.0)
            trial = at.worn_by(depth)
            worst = np.abs(change) / np.maximum(trial.wear, 1e-300)
            most = largest(worst)
            # the next change would be the square of this one; or no better than its round-off
            settled = (most <= _LAST) | ((before <= most) & (most <= _NOISE))
            if settled.all():
                self._after[id(law)] = p, at, trial
                return trial
            before = most
        i, e = divmod(int(worst.argmax()), p.shape[-1])
        step = np.broadcast_to(self.step, p.shape).reshape(-1, p.shape[-1])[i, e]
        at = at.history(i)
        raise ComputationError(
            f"wear law at time {at.time:g} s: the wear of history {i}, element {e} "
            f"(r = {at.r[e]:.6g} mm) over a step of {step:g} s does not settle; the rate grows "
            "with worn depth too fast"
        )

    def _d_depth_dp(self, law: Law, at: LocalState, p: FloatArray) -> FloatArray:
        p = _not_negative(p)
        if not law.remembers:
            return self.step * law.d_rate_dp(p, at)
        after = self.after_step(law, at, p)
        return self.step * law.d_rate_dp(p, after) / (1.0 - self.step * law.d_rate_dwear(p, after))

    # -- depths ------------------------------------------------------------------------------------

    def depth_if_always_in_contact(self, p: FloatArray) -> FloatArray:
        """Return the depths that lower and upper lose in contact all along, (2, ..., n) mm."""
        depths = np.zeros((2, *p.shape))
        for body, rate in zip(self.bodies, self._worn(p).rates, strict=True):
            depths[body.side] = self.step * rate
        return depths

    def total_if_always_in_contact(self, p: FloatArray) -> FloatArray:
        """Return the depths that both bodies together lose in contact all along, (..., n) mm."""
        return self._worn(p).depth

    def depths(self, p: FloatArray) -> FloatArray:
        """Return the depths that lower and upper lose, (2, ..., n) mm."""
        always = self.depth_if_always_in_contact(p)
        return always if self.closing is None else always * self.share(always)

    def _end_rates(self, p: FloatArray) -> FloatArray:
        """Return the rates at the end of the step in contact all along, of those that wear.

        Of laws that depend on depths they are evaluated at these, apart from these.
        """
        rates = self._worn(p).rates
        if not self._remembers:
            return rates
        ends = []
        for (_, law, at, average), rate in zip(self.bodies, rates, strict=True):
            if law.remembers:
                lost = self.step * rate
                after = at.worn_by(lost if self.obliquity is None else lost / self.obliquity)
                rate = self.along_axis(averaged_rate(law, after, average, p))
            ends.append(rate)
        return _stacked(ends, p.shape)

    def rates(self, p: FloatArray) -> FloatArray:
        """Return the rates of wear at the end of the step, (2, ..., n) mm/s, see above."""
        rates = np.zeros((2, *p.shape))
        rates[self._sides] = self._end_rates(p)
        return rates

    def wear_off(
        self,
        p: FloatArray,
        wear: FloatArray,
        duration: FloatArray,
        area: FloatArray,
        weights: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the wear after a duration at pressures, and the rates of the worn volumes.

        (2, B, n) mm and (2, B) mm^3/s. Volumes are of the rates at the end of the step, not of the
        depths, whose volumes are to be the same.

        Parameters
        ----------
        p : (B, n) MPa.
        wear : (2, B, n) mm, before.
        duration : (B,) s.
        area : (n,) mm^2.
        weights : (B, n) factors on duration and rates of elements; None: 1.
        """
        after, volumes = np.empty_like(wear), np.zeros(wear.shape[:-1])
        if not self.bodies:
            return wear, volumes
        rates = self._worn(p).rates
        load(step_rows).wear_off(
            *p.shape, len(self.bodies), self._sides, wear, rates, self._end_rates(p), duration,
            p if weights is None else weights, weights is not None, area, after, volumes,
        )  # fmt: skip
        return after, volumes

    def share(self, always: FloatArray) -> FloatArray:
        """Return the share of the step, (..., n), that is left for wear once the gap is closed.

        Parameters
        ----------
        always : (2, ..., n) mm, ``depth_if_always_in_contact``.
        """
        total = always[0] + always[1]
        share = np.ones_like(total)
        if self.closing is not None:
            open_, left = self.closing.gap > 0.0, total - self.closing.gap
            share[open_] = 0.0
            np.divide(left, total, out=share, where=open_ & (left > 0.0))
        return share

    # -- in the contact problem --------------------------------------------------------------------

    def depth(self, p: FloatArray) -> FloatArray:
        """Return the growth of the gap, (..., n) mm."""
        return self._worn(p).growth

    def d_depth_dp(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_e, (..., n) mm/MPa; of local laws all there is."""
        worn, slopes = self._worn(p), []
        if worn.slope is not None:
            return worn.slope
        for _, law, at, average in self.bodies:
            if average is None:
                slopes.append(self._d_depth_dp(law, at, p))
            else:
                slope = self._d_depth_dp(law, at, averaged(average, p))
                slopes.append(((average * average.T) * slope[..., None, :]).sum(axis=-1))
        total, closing = self.along_axis(total_of(slopes)), self.closing
        return total if closing is None else np.where(worn.depth >= closing.gap, total, 0.0)

    def jacobian(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_f, (..., n, n) mm/MPa."""
        n = p.shape[-1]
        total, diagonal = np.zeros((*p.shape, n)), np.arange(n)
        for _, law, at, average in self.bodies:
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

    def memory(self, p: FloatArray) -> FloatArray | None:
        """Return the change of depth at the end over that at the start, pressure staying, (..., n).

        None, for 1, of laws that do not remember depth. A change is shared between lower and upper
        by what they lose.
        """
        if not self._remembers:
            return None
        worn, q = self.depth_if_always_in_contact(p), np.maximum(p, 0.0)
        total = worn.sum(axis=0)
        growth = np.ones_like(p)
        for i, law, at, _ in self.bodies:
            if law.remembers:
                share = np.divide(worn[i], total, out=np.zeros_like(total), where=total > 0.0)
                rise = law.d_rate_dwear(q, self.after_step(law, at, q))
                growth += share * (1.0 / (1.0 - self.step * rise) - 1.0)
        return growth

    # -- potential ---------------------------------------------------------------------------------

    def potential(self, p: FloatArray) -> FloatArray:
        """Return the integral of the depth from 0 to p, (..., n) MPa mm.

        Non-local laws: area integrals of it are those of the potential, not its values.
        """
        if self.closing is None:
            return self._potential(p)
        low, high = np.zeros_like(p), np.maximum(p, 0.0)  # of the pressure that closes the gap
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            closed = self.depth(middle) > 0.0
            low, high = np.where(closed, low, middle), np.where(closed, middle, high)
        low[self.closing.gap == 0.0] = 0.0
        past = np.maximum(p, 0.0) - low
        return self._potential(p) - self._potential(low) - self.closing.gap * past

    def _potential(self, p: FloatArray) -> FloatArray:
        parts = []
        for _, law, at, average in self.bodies:
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
                rate = self._rate(law, at, None, low + share * span)
                total += w / _PANELS * self.step * rate
        return total * span


def _filled(values: float | FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return values as an array of a shape."""
    if isinstance(values, np.ndarray) and values.shape == shape and values.flags.c_contiguous:
        return values
    return np.array(np.broadcast_to(values, shape), dtype=float)


def _stacked(fields: Sequence[FloatArray], shape: tuple[int, ...]) -> FloatArray:
    """Return fields of a shape, of bodies, in one array."""
    if len(fields) == 1:
        return np.ascontiguousarray(fields[0])[None]
    return np.array(fields).reshape(len(fields), *shape)


def _not_negative(p: FloatArray) -> FloatArray:
    """Return pressures, 0 where they are negative: few iterates have such, and looking is quick."""
    return p if p.min(initial=0.0) >= 0.0 else np.maximum(p, 0.0)


def total_of(parts: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """Return the sum of fields of one body, or of two."""
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]
