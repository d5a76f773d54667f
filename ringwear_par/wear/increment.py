"""The wear of one implicit step: a convex part of the contact problem, whatever the laws."""

from dataclasses import dataclass, field, replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.wear.law import LocalState, WearLaw

_MEMORY_ITERATIONS = 60
#: relative change at which the wear of a step is found, and below which it may stop falling
_ROUND_OFF, _NOISE = 1e-15, 1e-9
_POTENTIAL_PANELS = 8
_GAUSS = tuple(0.5 * v for v in np.polynomial.legendre.leggauss(8))


def averaging(r: FloatArray, area: FloatArray, length: float) -> FloatArray:
    """Return the (n, n) matrix of Gaussian averages over a length.

    Rows sum to 1 and ``diag(area) A`` is symmetric, so that constants and area integrals are
    kept (Sinkhorn's scaling).
    """
    if length <= 0.0:
        return np.eye(len(r))
    kernel = np.exp(-0.5 * ((r[:, None] - r) / length) ** 2) * area[:, None] * area
    scale = 1.0 / np.sqrt(kernel.sum(axis=1) / area)
    for _ in range(1000):
        sums = scale * (kernel @ scale) / area
        if np.abs(sums - 1.0).max() < 1e-14:
            break
        scale = scale / np.sqrt(sums)
    symmetric = scale[:, None] * kernel * scale
    matrix = symmetric / area[:, None]
    return matrix / matrix.sum(axis=1)[:, None]


def averaged_rate(
    law: WearLaw, at: LocalState, average: FloatArray | None, p: FloatArray
) -> FloatArray:
    """Return the rate of wear under a law, (n,) mm/s, with its average if it is non-local."""
    return law.rate(p, at) if average is None else average @ law.rate(average @ p, at)


@dataclass(frozen=True)
class WearIncrement:
    """Wear of both bodies over one implicit step, as a function of the pressure at its end.

    Parameters
    ----------
    laws : laws of lower and upper, None for a body that does not wear.
    at : sliding for lower and upper at the end of the step, with the wear before it.
    step : s.
    averages : (n, n) matrices of the non-local laws, None for local ones.
    """

    laws: tuple[WearLaw | None, ...]
    at: tuple[LocalState, ...]
    step: float
    averages: tuple[FloatArray | None, ...] = (None, None)

    #: whether all laws are local, so that ``slope`` is the whole derivative
    local: bool = field(init=False, repr=False)
    _each: list[tuple[WearLaw, LocalState, FloatArray | None]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        bodies = zip(self.laws, self.at, self.averages, strict=True)
        each = [(law, at, average) for law, at, average in bodies if law is not None]
        object.__setattr__(self, "_each", each)
        object.__setattr__(self, "local", all(a is None for a in self.averages))

    def _depth(
        self, law: WearLaw, at: LocalState, average: FloatArray | None, p: FloatArray
    ) -> FloatArray:
        """Return what one body loses, mm; solves d = step rate(p, wear + d) where it remembers."""
        p = np.maximum(p, 0.0)
        if law.remembers:
            at = self._after(law, at, p)
        return self.step * averaged_rate(law, at, average, p)

    def _after(self, law: WearLaw, at: LocalState, p: FloatArray) -> LocalState:
        """Return the sliding with the depth worn at the end of the step (Newton, from below).

        Raises
        ------
        ComputationError : it does not settle: the rate grows with worn depth too fast.
        """
        depth, before = np.zeros_like(p), np.inf
        for _ in range(_MEMORY_ITERATIONS):
            there = replace(at, wear=at.wear + depth)
            rise = 1.0 - self.step * law.wear_slope(p, there)
            if (rise <= 0.0).any():
                e = int(rise.argmin())
                break
            change = (self.step * law.rate(p, there) - depth) / rise
            depth = np.maximum(depth + change, 0.0)
            worst = np.abs(change) / np.maximum(at.wear + depth, 1e-300)
            e, largest = int(worst.argmax()), float(worst.max())
            if largest <= _ROUND_OFF or before <= largest <= _NOISE:  # no better than its round-off
                return replace(at, wear=at.wear + depth)
            before = largest
        raise ComputationError(
            f"wear law at time {at.time:g} s: the wear of element {e} (r = {at.r[e]:.6g} mm) over "
            f"a step of {self.step:g} s does not settle; the rate grows with worn depth too fast"
        )

    def _slope(self, law: WearLaw, at: LocalState, p: FloatArray) -> FloatArray:
        p = np.maximum(p, 0.0)
        if not law.remembers:
            return self.step * law.slope(p, at)
        after = self._after(law, at, p)
        return self.step * law.slope(p, after) / (1.0 - self.step * law.wear_slope(p, after))

    def depths(self, p: FloatArray) -> FloatArray:
        """Return what lower and upper lose, (2, n) mm."""
        depths = np.zeros((2, len(p)))
        for i, law in enumerate(self.laws):
            if law is not None:
                depths[i] = self._depth(law, self.at[i], self.averages[i], p)
        return depths

    def volumes(self, depths: FloatArray, p: FloatArray, area: FloatArray) -> FloatArray:
        """Return step times the area integrals of the rates of lower and upper, (2,) mm^3.

        The rates are those at the end of the step, before any average of them; the volumes of the
        depths are to be the same.
        """
        volumes = depths @ area
        for i, (law, at, average) in enumerate(zip(self.laws, self.at, self.averages, strict=True)):
            if law is not None and average is not None:
                volumes[i] = self.step * float(law.rate(average @ p, at) @ area)
            elif law is not None and law.remembers:
                end = replace(at, wear=at.wear + depths[i])
                volumes[i] = self.step * float(law.rate(p, end) @ area)
        return volumes

    def depth(self, p: FloatArray) -> FloatArray:
        """Return the growth of the gap, mm."""
        return _total([self._depth(*each, p) for each in self._each])

    def slope(self, p: FloatArray) -> FloatArray:
        """Return d depth_e / d p_e, (n,) mm/MPa; of local laws all there is."""
        return _total(
            [
                self._slope(law, at, p)
                if average is None
                else ((average * average.T) * self._slope(law, at, average @ p)).sum(axis=1)
                for law, at, average in self._each
            ]
        )

    def derivative(self, p: FloatArray) -> FloatArray:
        """Return d depth / d p, (n, n) mm/MPa."""
        total = np.zeros((len(p), len(p)))
        for law, at, average in self._each:
            if average is None:
                total[np.diag_indices(len(p))] += self._slope(law, at, p)
            else:
                total += (average * self._slope(law, at, average @ p)) @ average
        return total

    def linear(self, p: FloatArray, change: FloatArray) -> FloatArray:
        """Return what a small change of pressure does to the depth, mm."""
        return self.slope(p) * change if self.local else self.derivative(p) @ change

    def potential(self, p: FloatArray) -> FloatArray:
        """Return the integral of the depth from 0 to p, MPa mm.

        Non-local laws: area integrals of it are those of the potential, not its values.
        """
        parts = []
        for law, at, average in self._each:
            q = np.maximum(p if average is None else average @ p, 0.0)
            part = None if law.remembers else law.potential(q, at)
            parts.append(self._integrated(law, at, q) if part is None else self.step * part)
        return _total(parts)

    def _integrated(self, law: WearLaw, at: LocalState, p: FloatArray) -> FloatArray:
        """Integrate the depth from the onset of wear to p by Gauss rules: exact where smooth."""
        low, total = law.onset(at), np.zeros_like(p)
        span = np.maximum(p - low, 0.0)
        for panel in range(_POTENTIAL_PANELS):
            for x, w in zip(*_GAUSS, strict=True):
                share = (panel + 0.5 + x) / _POTENTIAL_PANELS
                total += w / _POTENTIAL_PANELS * self._depth(law, at, None, low + share * span)
        return total * span

    def part(self, here: slice) -> "WearIncrement":
        """Return the same for some of the elements.

        Raises
        ------
        InputError : a law is non-local.
        """
        if not self.local:
            raise InputError(
                'law = "non-local": needs a contact problem that every rank solves by itself; '
                "must be used with fewer contact elements or -contact_tao_type python"
            )
        return replace(self, at=tuple(at.part(here) for at in self.at))


def _total(parts: list[FloatArray]) -> FloatArray:
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]
