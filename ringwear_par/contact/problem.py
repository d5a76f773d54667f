"""Unilateral contact, eq. (3) of the paper, as bound-constrained problems of B histories.

With K the area-weighted compliance of the contact line, m the element areas and g the gap of the
undeformed, worn profiles, the pressure minimises at an approach delta

    1/2 p.K p + Sum m_e [(g_e - delta) p_e + Int_0^p_e depth],    p >= 0,

where ``depth`` is the wear of an implicit step (absent otherwise).

The unknowns are scaled so that K has a unit diagonal: ``q = s p``, ``A = K / (s s')``.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, Numbers, inner, largest, short_repr
from ringwear_par.batched import keep
from ringwear_par.compiled import contact_rows
from ringwear_par.compiled.machine_code import load
from ringwear_par.wear.increment import WearIncrement

if TYPE_CHECKING:
    from ringwear_par.contact.scaled_compliances import ComplianceProducts, ScaledCompliances

#: largest relative KKT residual of an accepted solution
KKT_TOLERANCE = 1e-9
#: norm of the gradient at which a solver ends, relative to that of the overlap
GRADIENT_TOLERANCE = 1e-12
#: relative force balance at which a solver ends, and that it may not exceed
FORCE_TOLERANCE, FORCE_LIMIT = 1e-12, 1e-10

#: largest systems that have bases: a basis takes as long as 26 to 31 factors (0.67, 3.1 and 14.8 ms
#: with 64, 128 and 256 elements), and as much memory as two
LARGEST_WITH_BASES = 256


@dataclass(frozen=True)
class ContactInputs:
    """What B contact solutions depend on, beside the compliances."""

    #: (B, n) float, mm, of the undeformed, worn profiles
    gap: FloatArray
    #: (B,) float, N or mm; the other one is None
    force: FloatArray | None
    approach: FloatArray | None
    #: of an implicit step; None: profiles stay
    wear: WearIncrement | None = None


@dataclass(frozen=True)
class ContactState:
    """Solution of B contact problems: numbers (B,), fields (B, n); of one without this axis."""

    #: (B, n) float, MPa
    pressure: FloatArray
    #: (B, n) float, mm, between the deformed profiles
    gap: FloatArray
    #: (B,) float, mm
    approach: Numbers
    #: (B,) float, N
    force: Numbers
    #: (B,) int, of TAO, all its solves together
    iterations: Numbers
    #: (B,) float, natural KKT residual, relative to the largest pressure (scaled unknowns)
    residual: Numbers

    __repr__ = short_repr


@dataclass(frozen=True)
class WarmStart:
    """Where the next solves start; by it a restarted run repeats an uninterrupted one exactly."""

    #: (B, n) float, unknowns of the last problems
    scaled_pressure: FloatArray
    #: (B,) float, mm, of the last problems
    approach: FloatArray

    __repr__ = short_repr


class ContactProblem:
    """The contact problems of B histories on one contact line, each at an approach of its own.

    Unknowns, gradients and Hessians are of the histories at work, (h, n).

    Parameters
    ----------
    compliances : of the contact line.
    which : (B,) int, the compliance of each history.
    """

    def __init__(self, compliances: "ScaledCompliances", which: IntArray) -> None:
        self.compliances, self.which = compliances, which
        self.area, self.loops = compliances.area, load(contact_rows)
        scale, weights = compliances.scale, compliances.weights
        #: (B, n) or (1, n), 1/MPa, pressure times this is the unknown; gap times the weights the
        #: gradient
        self.scale, self.weights, self._per_scale, self._per_weight, self._slope_scale = (
            part(values, which)
            for values in (scale, weights, 1.0 / scale, 1.0 / weights, weights / scale)
        )
        self.every = np.arange(len(which))
        #: (B, n) A q of the last unknowns, and (B,) whether those are the ones that there are now
        self._product, self.is_known = (
            np.zeros((len(which), len(self.area))),
            np.zeros(len(which), dtype=bool),
        )
        #: (B, n) MPa at the last gradient, where it was of all histories
        self._pressure: FloatArray | None = None
        #: (B, n) slopes that depths have over pressures, and those of gradients over unknowns
        self._slopes: tuple[FloatArray, FloatArray] | None = None
        self.at_work = self.every
        #: (B, n) mm, and (B,) mm
        self.gaps, self.approaches = np.zeros_like(self._product), np.zeros(len(which))
        #: (B,) N, where approaches are those that carry given forces
        self.forces: FloatArray | None = None
        self.wear: WearIncrement | None = None
        self._wear_at_work: tuple[IntArray, WearIncrement] | None = None
        self._products: tuple[IntArray, ComplianceProducts] | None = None

    def pose(
        self,
        gap: FloatArray,
        force: FloatArray | None,
        approach: FloatArray | None,
        wear: WearIncrement | None,
        histories: IntArray,
    ) -> BoolArray:
        """Pose the problems of some histories; return which need no pressure, (B,).

        Parameters
        ----------
        gap : (B, n) float, mm.
        force, approach : (B,) float, N or mm, one of them.
        wear : of an implicit step of all histories.
        histories : (h,) int; those of them that need pressure are at work from now on.
        """
        self.gaps, self.forces, self.wear, self._wear_at_work = gap, force, wear, None
        if approach is not None:
            self.approaches[histories] = approach[histories]
            apart = gap.min(axis=1) >= approach
        elif force is not None:
            apart = force == 0.0  # the bodies just touch
            touching = histories[apart[histories]]
            self.approaches[touching] = gap[touching].min(axis=1)
        else:
            raise ValueError("force or approach must be given")
        self.at_work = histories[~apart[histories]] if apart.any() else histories
        return apart

    def keep(self, histories: IntArray) -> None:
        """Go on with some of the histories, none of which is at work."""
        keep(self, ("which", "_product", "is_known", "gaps", "approaches"), histories)
        if len(self.compliances.scale) > 1:
            names = "scale", "weights", "_per_scale", "_per_weight", "_slope_scale"
            keep(self, names, histories)
        self.every = np.arange(len(histories))
        self.at_work = self.every
        self._pressure = self._products = self._wear_at_work = self.wear = self.forces = None
        self._slopes = None

    def rows_of(self, histories: IntArray) -> IntArray | slice:
        """Return the rows of some histories; of all a slice, which is quicker."""
        return slice(None) if len(histories) == len(self.every) else histories

    def rows_in(self, vector: FloatArray) -> FloatArray:
        """Return the rows of all histories, (B, n), in a vector that may have room for more."""
        return vector[: self._product.size].reshape(self._product.shape)

    @property
    def at_work(self) -> IntArray:
        """(h,) the histories at work."""
        return self._at_work

    @at_work.setter
    def at_work(self, histories: IntArray) -> None:
        self._at_work = histories
        #: the rows of the histories at work
        self.rows = self.rows_of(histories)

    def _increment(self) -> WearIncrement | None:
        """Return the wear of the histories at work."""
        histories = self.at_work
        if self.wear is None or len(histories) == len(self.every):
            return self.wear
        if self._wear_at_work is None or self._wear_at_work[0] is not histories:
            self._wear_at_work = histories, self.wear.take(histories)
        return self._wear_at_work[1]

    def pressures(self, q: FloatArray, rows: IntArray | slice) -> FloatArray:
        """Return the pressures of unknowns, MPa."""
        return q * part(self._per_scale, rows)

    def gaps_of(self, gradient: FloatArray) -> FloatArray:
        """Return the gaps between the deformed profiles of all histories, mm."""
        return gradient * self._per_weight

    def _products_of(self, q: FloatArray) -> FloatArray:
        """Return A q, (h, n)."""
        rows = self.rows
        if self._products is None or self._products[0] is not self.at_work:
            self._products = self.at_work, self.compliances.products(self.which[rows])
        product = self._products[1].symmetric(q)
        self.is_known[rows] = True
        if isinstance(rows, slice):
            self._product = product
        else:
            self._product[rows] = product
        return product

    def gradient(
        self, q: FloatArray, recall: bool = False, out: FloatArray | None = None
    ) -> FloatArray:
        """Return the gradient (h, n): the weighted gap of the deformed, worn profiles.

        Parameters
        ----------
        q : (h, n) float, the unknowns.
        recall : whether they are the last ones, as far as those ``is_known``.
        out : (h, n) float, where it is to be; None: in an array of its own.
        """
        rows, wear, whole = self.rows, self._increment(), isinstance(self.rows, slice)
        recall = recall and bool(self.is_known[rows].all())
        p = self._pressure if recall and whole else None
        if p is None:
            p = self.pressures(q, rows)
        self._pressure = None  # where a law raises, nothing is known of these unknowns
        self.is_known[rows] &= recall
        depths = np.zeros_like(q) if wear is None else wear.depth(p)
        products = self._product[rows] if recall else self._products_of(q)
        gradient = np.empty_like(q) if out is None else out
        self.loops.gradient(
            *q.shape, self.at_work, self.which, self.gaps, self.approaches, depths,
            self.compliances.weights, products, gradient,
        )  # fmt: skip
        self._pressure = p if whole else None
        return gradient

    def last_pressures(self, q: FloatArray) -> FloatArray:
        """Return the pressures of all histories, (B, n) MPa.

        Where they are those of the last gradient the same array, which laws know again.
        """
        if self._pressure is None or not self.is_known.all():
            self._pressure = self.pressures(q, slice(None))
        return self._pressure

    def objective(self, q: FloatArray) -> float:
        """Return the sum of the objectives, N mm."""
        rows, wear = self.rows, self._increment()
        self._pressure = None
        linear = part(self.weights, rows) * (self.gaps[rows] - self.approaches[rows, None])
        objectives = inner(q, 0.5 * self._products_of(q) + linear)
        if wear is not None:
            objectives = objectives + inner(self.area, wear.potential(self.pressures(q, rows)))
        return float(objectives.sum())

    def slopes(self, q: FloatArray, recall: bool = False) -> tuple[FloatArray, FloatArray | None]:
        """Return the slopes that wear adds to the Hessians: on diagonals, (h, n), and off them.

        The second part is (h, n, n) of non-local wear, and does not have the first in it; of local
        wear it is None.

        Parameters
        ----------
        q : (h, n) float, the unknowns.
        recall : whether they are those of the last gradient.
        """
        wear, rows = self._increment(), self.rows
        if wear is None:
            return np.zeros_like(q), None
        p = self._pressure if recall and isinstance(rows, slice) else None
        if p is None:
            p = self.pressures(q, rows)
        slope = np.ascontiguousarray(wear.d_depth_dp(p))
        if self._slopes is None or self._slopes[0] is not slope:
            self._slopes = slope, self.scaled_slopes(slope, rows)
        diagonal = self._slopes[1]
        if wear.local:
            return diagonal, None
        coupling = self.scaled_slopes(wear.jacobian(p), rows)
        places = np.arange(q.shape[1])
        coupling[:, places, places] -= diagonal
        return diagonal, coupling

    def scaled_slopes(self, slopes: FloatArray, rows: IntArray | slice) -> FloatArray:
        """Return slopes of the gradient over the unknowns, from those of depths over pressures.

        (h, n) mm/MPa, or of non-local wear (h, n, n).
        """
        if slopes.ndim == self.weights.ndim:
            return slopes * part(self._slope_scale, rows)
        return part(self.weights, rows)[..., None] * slopes / part(self.scale, rows)[:, None, :]

    def residuals(
        self, histories: IntArray, q: FloatArray, gradient: FloatArray, slope: FloatArray
    ) -> FloatArray:
        """Return natural KKT residuals of some histories, (h,), relative to their largest unknowns.

        Infinite where they are no numbers, or nothing touches.

        Parameters
        ----------
        q, gradient : (B, n) float.
        slope : (B, n) float, that wear adds to the diagonals of the Hessians.
        """
        rows = self.rows_of(histories)
        most = np.maximum(largest(q[rows]), 0.0)
        worst = _natural(q[rows], gradient[rows], slope[rows])
        if self.wear is not None and not (worst <= KKT_TOLERANCE * most).all():
            # at a kink of the law either side's slope will do
            every = slice(None)
            other = self.scaled_slopes(self.wear.d_depth_dp(self.pressures(q, every)), every)
            worst = _natural(q[rows], gradient[rows], np.maximum(slope, other)[rows])
        return np.divide(worst, most, out=np.full(len(histories), np.inf), where=most > 0.0)


def part(values: FloatArray, rows: IntArray | slice) -> FloatArray:
    """Return the values of some rows, (h, n); where all have the same, (1, n)."""
    return values if len(values) == 1 else values[rows]


def _natural(q: FloatArray, gradient: FloatArray, slope: FloatArray) -> FloatArray:
    """Return natural KKT residuals of (h, n), infinite where there is none."""
    worst = largest(np.abs(np.minimum(q, gradient / (1.0 + slope))))
    return np.where(np.isfinite(worst), worst, np.inf)
