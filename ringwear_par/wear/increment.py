"""The wear of one implicit step: a convex part of the contact problem, whatever the laws."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, columns
from ringwear_par.errors import ComputationError
from ringwear_par.schedules import history, take
from ringwear_par.wear.derivatives import COMPLEX_STEP
from ringwear_par.wear.law import Law, WearLaw, complete
from ringwear_par.wear.local_state import LocalState

_MEMORY_ITERATIONS = 60
#: how often averages are scaled at most, and to what they have to keep constants by then
_SCALINGS, _SCALED = 1000, 1e-10
#: relative change at which the wear of a step is found, and below which it may stop falling
_ROUND_OFF, _NOISE = 1e-15, 1e-9
_POTENTIAL_PANELS, _BISECTIONS = 8, 60
_GAUSS = tuple(0.5 * v for v in np.polynomial.legendre.leggauss(8))


class VaryingNumbers(Protocol):
    """P numbers with which the wear of a step varies, see ``WearIncrement.varied``."""

    @property
    def averages(self) -> Mapping[int, tuple[int, FloatArray]]:
        """Of bodies, which number their averages depend on, and (n, n) how."""

    @property
    def thicknesses(self) -> Mapping[int, FloatArray]:
        """Of bodies with layers, (layers, P) derivatives of their thicknesses."""

    def rates(
        self, i: int, law: Law, p: FloatArray, at: LocalState, layer: int | None
    ) -> FloatArray:
        """Return what the numbers themselves do to the rate of body i, (P, ..., n) mm/s.

        At given pressure and wear, in one of its layers if it has any.
        """


def averaging(r: FloatArray, area: FloatArray, length: complex) -> FloatArray:
    """Return the (n, n) matrix of Gaussian averages over a length.

    Rows sum to 1 and ``diag(area) A`` is symmetric, so that constants and area integrals are
    kept (Sinkhorn's scaling).

    Raises
    ------
    ComputationError : the scaling does not settle.
    """
    if length == 0.0:
        return np.eye(len(r))
    kernel = np.exp(-0.5 * ((r[:, None] - r) / length) ** 2) * area[:, None] * area
    scale = 1.0 / np.sqrt(kernel.sum(axis=1) / area)
    for _ in range(_SCALINGS):
        sums = scale * (kernel @ scale) / area
        off = np.abs(sums - 1.0).max()
        if off < 1e-14:
            break
        scale = scale / np.sqrt(sums)
    if not off <= _SCALED:
        raise ComputationError(
            f"wear law: averages over {np.real(length):g} mm keep constants to {off:.1e} only, "
            f"after {_SCALINGS} scalings (allowed {_SCALED:g})"
        )
    symmetric = scale[:, None] * kernel * scale
    matrix = symmetric / area[:, None]
    return matrix / matrix.sum(axis=1)[:, None]


def d_averaging(r: FloatArray, area: FloatArray, length: float) -> FloatArray:
    """Return the derivative of the matrix of averages with respect to its length, (n, n) 1/mm."""
    return np.imag(averaging(r, area, length + 1j * COMPLEX_STEP)) / COMPLEX_STEP


def averaged(average: FloatArray, x: FloatArray) -> FloatArray:
    """Return averages, (..., n), of x, without BLAS: its rounding may turn on where x lies.

    Parameters
    ----------
    average : (..., n, n) float.
    """
    products: FloatArray = average * x[..., None, :]
    return products.sum(axis=-1)


def averaged_rate(
    law: Law, at: LocalState, average: FloatArray | None, p: FloatArray
) -> FloatArray:
    """Return the rate of wear under a law, (..., n) mm/s, with its average if it is non-local."""
    if average is None:
        return law.rate(p, at)
    return averaged(average, law.rate(averaged(average, p), at))


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

    #: whether all laws are local, so that ``d_depth_dp`` is the whole derivative
    local: bool = field(init=False, repr=False)
    _each: list[tuple[int, Law, LocalState, FloatArray | None]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        bodies = zip(self.laws, self.at, self.averages, strict=True)
        each = [
            (i, complete(law), at, average)
            for i, (law, at, average) in enumerate(bodies)
            if law is not None
        ]
        object.__setattr__(self, "_each", each)
        object.__setattr__(self, "local", all(a is None for a in self.averages))
        if self.closing is not None:
            object.__setattr__(self, "step", self.closing.step)
        elif isinstance(self.step, np.ndarray):
            object.__setattr__(self, "step", columns(self.step))

    @property
    def bends(self) -> bool:
        """Whether depth may almost jump with pressure, so that straight lines tell little of it."""
        return False

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

    def _depth(
        self, law: Law, at: LocalState, average: FloatArray | None, p: FloatArray
    ) -> FloatArray:
        """Return what one body loses along the normal, mm.

        Solves d = step rate(p, wear + d) where it remembers.
        """
        p = np.maximum(p, 0.0)
        if law.remembers:
            at = self._after(law, at, p)
        return self.step * averaged_rate(law, at, average, p)

    def _after(self, law: Law, at: LocalState, p: FloatArray) -> LocalState:
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
            there = replace(at, wear=at.wear + depth)
            rise = 1.0 - self.step * law.d_rate_dwear(p, there)
            if (rise <= 0.0).any() and ((rise <= 0.0).any(axis=-1) & ~settled).any():
                e = int(np.where(settled[..., None], np.inf, rise).argmin())
                break
            change = (self.step * law.rate(p, there) - depth) / rise
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
        after = self._after(law, at, p)
        return self.step * law.d_rate_dp(p, after) / (1.0 - self.step * law.d_rate_dwear(p, after))

    def unhindered(self, p: FloatArray) -> FloatArray:
        """Return what lower and upper would lose in contact all along, (2, ..., n) mm."""
        depths = np.zeros((2, *p.shape))
        for i, law, at, average in self._each:
            depths[i] = self._axial(self._depth(law, at, average, p))
        return depths

    def top(self, p: FloatArray) -> FloatArray:
        """Return what bodies would lose all along if they stayed in the layer that is at the face.

        (2, ..., n) mm, of lower and upper, which are of one material each.
        """
        return self.unhindered(p)

    def lost(self, p: FloatArray, worn: FloatArray, share: FloatArray | float) -> FloatArray:
        """Return what lower and upper lose in contact in a share of the step, (2, ..., n) mm.

        Parameters
        ----------
        worn : what they do all along, ``unhindered``.
        share : (..., n) or a number; more than 1 where the step counts for longer.
        """
        return share * worn

    def apart(self, p: FloatArray, worn: FloatArray, share: FloatArray | float) -> FloatArray:
        """Return the same, from the rates at the pressure alone, see ``rates``."""
        return share * (self.step * self.rates(p, worn))

    def varied(
        self,
        p: FloatArray,
        numbers: VaryingNumbers,
        d_wear: FloatArray,
        d_step: FloatArray | None,
        instant: bool,
    ) -> "VariedIncrement":
        """Return how the unhindered depths vary with P numbers, and with pressure.

        Parameters
        ----------
        numbers : they.
        d_wear : (2, P, ..., n) mm, derivatives of the wear before the step.
        d_step : (P, ..., n) s, those of ``step``; None: 0.
        instant : whether rates are those before the step, as in explicit steps.
        """
        bodies = []
        for i, law, at, average in self._each:
            q = np.maximum(p if average is None else averaged(average, p), 0.0)
            within = law.remembers and not instant
            there = self._after(law, at, q) if within else at
            change = numbers.rates(i, law, q, there, None)
            before = law.d_rate_dbefore(q, there)
            if before is not None:
                normal = d_wear[i] if self.obliquity is None else d_wear[i] / self.obliquity
                change += before * normal
            change *= self.step
            slope = self.step * law.d_rate_dp(q, there)
            if d_step is not None:
                change += d_step * law.rate(q, there)
            if within and before is not None:
                left = 1.0 - self.step * before
                change /= left
                slope = slope / left
            row, d_average = numbers.averages.get(i, (0, None))
            if d_average is not None:
                change[row] += slope * averaged(d_average, p)
            depths = self._axial(change if average is None else averaged(average, change))
            if d_average is not None:
                depths[row] += self._axial(averaged(d_average, self.step * law.rate(q, there)))
            bodies.append((i, depths, slope, average))
        return VariedIncrement(bodies, self.obliquity)

    def _axial(self, normal: FloatArray) -> FloatArray:
        """Return along the axis what is (..., n) along the normal."""
        return normal if self.obliquity is None else self.obliquity * normal

    def share(self, unhindered: FloatArray) -> FloatArray:
        """Return the share of the step, (..., n), that is left for wear once the gap is closed."""
        total = unhindered[0] + unhindered[1]
        share = np.ones_like(total)
        if self.closing is not None:
            open_, left = self.closing.gap > 0.0, total - self.closing.gap
            share[open_] = 0.0
            np.divide(left, total, out=share, where=open_ & (left > 0.0))
        return share

    def d_share(self, total: FloatArray, d_total: FloatArray, d_gap: Any) -> FloatArray:
        """Return derivatives of ``share`` from those of what it is made of, both bodies' together.

        Parameters
        ----------
        total : (..., n) mm, and ``d_total`` (..., n) or (P, ..., n).
        d_gap : of the gaps that close, likewise.
        """
        assert self.closing is not None
        gap = self.closing.gap
        inside = (gap > 0.0) & (total > gap)
        total = np.where(inside, total, 1.0)
        return np.where(inside, (gap * d_total / total - d_gap) / total, 0.0)

    def depths(self, p: FloatArray) -> FloatArray:
        """Return what lower and upper lose, (2, ..., n) mm."""
        depths = self.unhindered(p)
        return depths if self.closing is None else depths * self.share(depths)

    def rates(self, p: FloatArray, depths: FloatArray) -> FloatArray:
        """Return the rates of wear at the end of the step, (2, ..., n) mm/s.

        They are evaluated at the pressure, apart from the depths (2, ..., n) mm, whose volumes are
        to be the same; of the depths, only laws that remember them take any notice.
        """
        rates = np.zeros((2, *p.shape))
        for i, law, at, average in self._each:
            lost = depths[i] if self.obliquity is None else depths[i] / self.obliquity
            there = replace(at, wear=at.wear + lost) if law.remembers else at
            rates[i] = self._axial(averaged_rate(law, there, average, p))
        return rates

    def depth(self, p: FloatArray) -> FloatArray:
        """Return the growth of the gap, (..., n) mm."""
        return self._left(p) if self.closing is None else np.maximum(self._left(p), 0.0)

    def _left(self, p: FloatArray) -> FloatArray:
        """Return what a step in contact all along takes off beyond the gap, mm; may be negative."""
        each = [self._depth(law, at, average, p) for _, law, at, average in self._each]
        total = self._axial(_total(each))
        return total if self.closing is None else total - self.closing.gap

    def d_depth_dp(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_e, (..., n) mm/MPa; of local laws all there is."""
        each = []
        for _, law, at, average in self._each:
            if average is None:
                each.append(self._d_depth_dp(law, at, p))
            else:
                slope = self._d_depth_dp(law, at, averaged(average, p))
                each.append(((average * average.T) * slope[..., None, :]).sum(axis=-1))
        total = self._axial(_total(each))
        return total if self.closing is None else np.where(self._left(p) >= 0.0, total, 0.0)

    def jacobian(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_f, (..., n, n) mm/MPa."""
        n = p.shape[-1]
        total, own = np.zeros((*p.shape, n)), np.arange(n)
        for _, law, at, average in self._each:
            if average is None:
                total[..., own, own] += self._d_depth_dp(law, at, p)
            else:
                slope = self._d_depth_dp(law, at, averaged(average, p))
                total += (average * slope[..., None, :]) @ average
        return total if self.obliquity is None else self.obliquity[:, None] * total

    def linear(self, p: FloatArray, change: FloatArray) -> FloatArray:
        """Return what a small change of pressure does to the depth, (..., n) mm."""
        if self.local:
            return self.d_depth_dp(p) * change
        return averaged(self.jacobian(p), change)

    def memory(self, p: FloatArray, worn: FloatArray) -> FloatArray | float:
        """Return what a step makes of a change of depth at its start, pressure staying, (..., n).

        1 of laws that do not remember depth.

        Parameters
        ----------
        worn : (2, ..., n) mm, what lower and upper lose, by which a change is shared between them.
        """
        if not any(law.remembers for _, law, _, _ in self._each):
            return 1.0
        total, q = worn.sum(axis=0), np.maximum(p, 0.0)
        growth = np.ones_like(p)
        for i, law, at, _ in self._each:
            if law.remembers:
                share = np.divide(worn[i], total, out=np.zeros_like(total), where=total > 0.0)
                growth += share * self._remembered(i, law, at, q)
        return growth

    def _remembered(self, i: int, law: Law, at: LocalState, p: FloatArray) -> FloatArray:
        """Return what a change of the depth of body i grows by in the step, over that change."""
        return 1.0 / (1.0 - self.step * law.d_rate_dwear(p, self._after(law, at, p))) - 1.0

    def potential(self, p: FloatArray) -> FloatArray:
        """Return the integral of the depth from 0 to p, (..., n) MPa mm.

        Non-local laws: area integrals of it are those of the potential, not its values.
        """
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
        for _, law, at, average in self._each:
            q = np.maximum(p if average is None else averaged(average, p), 0.0)
            part = None if law.remembers else law.potential(q, at)
            parts.append(self._integrated(law, at, q) if part is None else self.step * part)
        return self._axial(_total(parts))

    def _integrated(self, law: Law, at: LocalState, p: FloatArray) -> FloatArray:
        """Integrate the depth from the onset of wear to p by Gauss rules: exact where smooth."""
        low, total = law.onset(at), np.zeros_like(p)
        span = np.maximum(p - low, 0.0)
        for panel in range(_POTENTIAL_PANELS):
            for x, w in zip(*_GAUSS, strict=True):
                share = (panel + 0.5 + x) / _POTENTIAL_PANELS
                total += w / _POTENTIAL_PANELS * self._depth(law, at, None, low + share * span)
        return total * span


@dataclass(frozen=True)
class VariedIncrement:
    """How the unhindered depths of an increment vary with P numbers.

    Parameters
    ----------
    bodies : of each that wears: which it is; (P, ..., n) mm, at given pressure; (..., n) mm/MPa,
        its slope along the normal; its average.
    obliquity : as of the increment.
    """

    bodies: Sequence[tuple[int, FloatArray, FloatArray, FloatArray | None]]
    obliquity: FloatArray | None

    @property
    def slope(self) -> FloatArray:
        """``WearIncrement.d_depth_dp`` of local laws in contact all along, (..., n) mm/MPa."""
        total = _total([slope for _, _, slope, _ in self.bodies])
        return total if self.obliquity is None else self.obliquity * total

    @property
    def depth(self) -> FloatArray:
        """(P, ..., n) mm, of both bodies together at given pressure."""
        return _total([depths for _, depths, _, _ in self.bodies])

    def posed(
        self, during: WearIncrement, p: FloatArray, closes: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return how the depth in the contact problem varies at given pressure, and with it.

        (P, ..., n) mm and (..., n) or (..., n, n) mm/MPa.

        Parameters
        ----------
        during : the increment.
        closes : (P, ..., n) mm, derivatives of the gaps that wear closes.
        """
        worn, slope = self.depth, self.slope if during.local else during.jacobian(p)
        if during.closing is not None:
            closed = (during.closing.gap == 0.0) | (during.depth(p) > 0.0)
            assert closes is not None
            worn = np.where(closed, worn - closes, 0.0)
            slope = np.where(closed, slope, 0.0)
        return worn, slope

    def top(self, d_p: FloatArray) -> dict[int, FloatArray]:
        """Return derivatives of ``WearIncrement.top``, see ``with_pressure``."""
        return self.with_pressure(d_p)

    def lost(
        self, d_p: FloatArray, worn: FloatArray, share: Any, d_share: Any
    ) -> dict[int, FloatArray]:
        """Return derivatives of ``WearIncrement.lost``, (P, ..., n) mm of each body.

        Parameters
        ----------
        d_p : (P, ..., n) MPa.
        d_share : of ``share``, (P, ..., n) or 0.
        """
        each = self.with_pressure(d_p)
        return {i: share * d_worn + d_share * worn[i] for i, d_worn in each.items()}

    def with_pressure(self, d_p: FloatArray) -> dict[int, FloatArray]:
        """Return (P, ..., n) mm of each body, as the pressure varies by (P, ..., n) MPa."""
        found = {}
        for i, depths, slope, average in self.bodies:
            change = slope * (d_p if average is None else averaged(average, d_p))
            if average is not None:
                change = averaged(average, change)
            if self.obliquity is not None:
                change *= self.obliquity
            change += depths
            found[i] = change
        return found


def _total(parts: list[FloatArray]) -> FloatArray:
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]
