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
from ringwear_par.compiled.contact_rows import Contacts, Judgement
from ringwear_par.compiled.machine_code import load
from ringwear_par.compiled.product_rows import SPARE_ROWS
from ringwear_par.wear.increment import WearIncrement

if TYPE_CHECKING:
    from ringwear_par.contact.scaled_compliances import ScaledCompliances

#: largest relative KKT residual of an accepted solution
KKT_TOLERANCE = 1e-9
#: relative force balance that may not be exceeded
FORCE_LIMIT = 1e-10

#: largest systems that share bases: such a one takes as long as 30 to 50 Cholesky factors (0.67,
#: 3.1 and 14.8 ms with 64, 128 and 256 elements)
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
        self.scale, self.weights, self._per_weight = (
            part(values, which) for values in (scale, weights, 1.0 / weights)
        )
        count, n = len(which), len(self.area)
        self.every = np.arange(count)
        #: as loops have them
        self.contacts = Contacts(
            compliances=which,
            references=compliances.reference[which],
            deviations=compliances.deviation(which),
            unknowns=np.zeros((count, n)),
            gradients=np.zeros((count, n)),
            products=np.zeros((count + SPARE_ROWS, n)),
            are_known=np.zeros(count, dtype=bool),
        )
        #: of the histories at work
        self._judgement = Judgement(
            are_settled=np.empty(count, dtype=bool),
            are_lost=np.empty(count, dtype=bool),
            counts=np.zeros(2, dtype=np.int64),
            zeroed=np.empty(2 * count, dtype=np.int64),
            derivative_products=np.empty((4, n)),
        )
        #: (h, n) MPa, pressures of the histories at work at their unknowns
        self.pressures_at_work: FloatArray | None = None
        self.at_work = self.every
        #: (B, n) mm, and (B,) mm
        self.gaps, self.approaches = np.zeros_like(self.unknowns), np.zeros(len(which))
        #: (B,) N, where approaches are those that carry given forces
        self.forces: FloatArray | None = None
        self.wear: WearIncrement | None = None
        self._wear_at_work: tuple[IntArray, WearIncrement] | None = None
        #: histories, those in the order of their references, and places of these
        self._order: tuple[IntArray, IntArray, IntArray] | None = None

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
        else:
            raise ValueError("force or approach must be given")
        self.at_work = histories
        if apart.any():
            self.at_work = histories[~apart[histories]]
            if approach is None:
                touching = histories[apart[histories]]
                self.approaches[touching] = gap[touching].min(axis=1)
        return apart

    def keep(self, histories: IntArray) -> None:
        """Go on with some of the histories, in ascending order, none of which is at work."""
        count, old = len(histories), self.contacts
        for rows in old.unknowns, old.gradients:  # in their places: vectors of PETSc's are there
            rows[:count] = rows[histories]
        self.contacts = Contacts(
            compliances=old.compliances[histories],
            references=old.references[histories],
            deviations=old.deviations[histories],
            unknowns=old.unknowns[:count],
            gradients=old.gradients[:count],
            products=old.products[np.append(histories, histories[-1:].repeat(SPARE_ROWS))],
            are_known=old.are_known[histories],
        )
        keep(self, ("which", "gaps", "approaches"), histories)
        if len(self.compliances.scale) > 1:
            keep(self, ("scale", "weights", "_per_weight"), histories)
        self.every = np.arange(count)
        self.at_work = self.every
        self.pressures_at_work = self._order = self._wear_at_work = self.wear = self.forces = None

    @property
    def unknowns(self) -> FloatArray:
        """(B, n) 1, pressures times ``scale``."""
        unknowns: FloatArray = self.contacts.unknowns
        return unknowns

    @property
    def gradients(self) -> FloatArray:
        """(B, n) mm times weights, gaps of the deformed, worn profiles."""
        gradients: FloatArray = self.contacts.gradients
        return gradients

    def rows_of(self, histories: IntArray) -> IntArray | slice:
        """Return the rows of some histories; of all a slice, which is quicker."""
        return slice(None) if len(histories) == len(self.every) else histories

    @property
    def at_work(self) -> IntArray:
        """(h,) the histories at work."""
        return self._at_work

    @at_work.setter
    def at_work(self, histories: IntArray) -> None:
        self._at_work = histories
        #: the rows of the histories at work
        self.rows = self.rows_of(histories)

    def go_on(self, on: BoolArray) -> None:
        """Leave some (h,) of the histories at work to go on."""
        assert self.pressures_at_work is not None
        self.at_work, p = self.at_work[on], self.pressures_at_work[on]
        self.pressures_at_work = p

    def _increment(self) -> WearIncrement | None:
        """Return the wear of the histories at work, for depths and slopes."""
        histories = self.at_work
        if self.wear is None or len(histories) == len(self.every):
            return self.wear
        if self._wear_at_work is None or self._wear_at_work[0] is not histories:
            self._wear_at_work = histories, self.wear.growth_of(histories)
        return self._wear_at_work[1]

    def pressures(self, histories: IntArray) -> FloatArray:
        """Return the pressures of the unknowns of some histories, (h, n) MPa, none negative."""
        count, n = len(histories), len(self.area)
        pressures = np.empty((count, n))
        self.loops.pressures(count, n, histories, self.compliances.record, self.contacts, pressures)
        return pressures

    def gaps_of(self, gradient: FloatArray) -> FloatArray:
        """Return the gaps between the deformed profiles of all histories, mm."""
        return gradient * self._per_weight

    def evaluate(self, recall: bool = False) -> None:
        """Set the gradients of the histories at work at their unknowns.

        Parameters
        ----------
        recall : whether unknowns are the last ones, as far as their products are known.
        """
        histories, rows = self.at_work, self.rows
        are_known = self.contacts.are_known
        recall = recall and bool(are_known[rows].all())
        p = self.pressures_at_work if recall and len(histories) == len(self.every) else None
        if p is None or len(p) != len(histories):
            p = self.pressures(histories)
        are_known[rows] &= recall
        self._evaluate(p, recall, self.unknowns, None, self.approaches)
        self.pressures_at_work = p

    def judge(
        self, diagonal: FloatArray, free: BoolArray, residuals: FloatArray
    ) -> tuple[int, int]:
        """Evaluate after steps; return how many histories have settled, and how many are lost.

        The others go on with the sets of the signs; unknowns that leave their set become 0.

        Parameters
        ----------
        diagonal : (B, n) float, of the Hessians.
        free : (B, n) bool, the elements in contact.
        residuals : (B,) float, set: natural ones, relative to largest unknowns.
        """
        assert self.pressures_at_work is not None
        self._evaluate(self.pressures_at_work, False, diagonal, free, residuals)
        settled, lost = self._judgement.counts.tolist()
        return settled, lost

    def judged(self) -> tuple[BoolArray, BoolArray]:
        """Return which of the histories at work have settled and are lost, (h,)."""
        count = len(self.at_work)
        return self._judgement.are_settled[:count], self._judgement.are_lost[:count]

    def _evaluate(
        self, p: FloatArray, recall: bool, diagonal: FloatArray, free: BoolArray | None,
        residuals: FloatArray,
    ) -> None:  # fmt: skip
        """Set gradients at pressures (h, n), and where there are sets also who has settled."""
        histories, forces, contacts = self.at_work, self.forces, self.contacts
        if self._order is None or self._order[0] is not histories:
            places = np.argsort(contacts.references[histories], kind="stable")
            self._order = histories, histories[places], places
        self.loops.evaluate(
            *p.shape, len(self.every), *self._order[1:], self.compliances.record, contacts,
            self._judgement, not recall, self.gaps, self.approaches, self._depths(p),
            self.approaches if forces is None else forces, forces is not None, free is not None,
            diagonal, contacts.are_known if free is None else free, residuals,
        )  # fmt: skip

    def _depths(self, p: FloatArray) -> FloatArray:
        """Return the wear of the histories at work, (h, n) mm."""
        wear = self._increment()
        return np.zeros_like(p) if wear is None else np.ascontiguousarray(wear.depth(p))

    def last_pressures(self) -> FloatArray:
        """Return the pressures of all histories, (B, n) MPa.

        Where they are those of the last gradient the same array, which laws know again.
        """
        p = self.pressures_at_work
        if p is None or len(p) != len(self.every) or not self.contacts.are_known.all():
            p = self.pressures_at_work = self.pressures(self.every)
        return p

    def objective(self) -> float:
        """Return the sum of the objectives of the histories at work, N mm."""
        histories, wear, rows = self.at_work, self.wear, self.rows
        products = self.compliances.products(self.which[histories])
        linear = part(self.weights, rows) * (self.gaps[rows] - self.approaches[rows, None])
        q = self.unknowns[rows]
        objectives = inner(q, 0.5 * products.symmetric(q) + linear)
        if wear is not None:
            potential = wear.potential(self.pressures(self.every))
            objectives = objectives + inner(self.area, potential[rows])
        return float(objectives.sum())

    def slopes(self) -> tuple[FloatArray, FloatArray | None]:
        """Return the slopes of depths over pressures where gradients are, (h, n) mm/MPa.

        Of histories at work. The second part are those of gradients over unknowns off the diagonals
        of Hessians, (h, n, n), of non-local wear, and does not have the first in it; of local wear
        it is None.
        """
        wear, rows, p = self._increment(), self.rows, self.pressures_at_work
        if p is None or len(p) != len(self.at_work):
            p = self.pressures(self.at_work)
        if wear is None:
            return np.zeros_like(p), None
        slope = np.ascontiguousarray(wear.d_depth_dp(p))
        if wear.local:
            return slope, None
        coupling = self.scaled_slopes(wear.jacobian(p), rows)
        places = np.arange(slope.shape[1])
        coupling[:, places, places] -= slope * self.compliances.record.slope_scale[self.which[rows]]
        return slope, coupling

    def scaled_slopes(self, slopes: FloatArray, rows: IntArray | slice) -> FloatArray:
        """Return slopes of the gradient over the unknowns, from those of depths over pressures.

        (h, n) mm/MPa, or of non-local wear (h, n, n).
        """
        if slopes.ndim == self.weights.ndim:
            return slopes * self.compliances.record.slope_scale[self.which[rows]]
        return part(self.weights, rows)[..., None] * slopes / part(self.scale, rows)[:, None, :]

    def residuals(self, histories: IntArray, slope: FloatArray) -> FloatArray:
        """Return natural KKT residuals of some histories, (h,), relative to their largest unknowns.

        Infinite where they are no numbers, or nothing touches.

        Parameters
        ----------
        slope : (B, n) float, that wear adds to the diagonals of the Hessians.
        """
        rows, q, gradient = self.rows_of(histories), self.unknowns, self.gradients
        most = np.maximum(largest(q[rows]), 0.0)
        worst = _natural(q[rows], gradient[rows], slope[rows])
        if self.wear is not None and not (worst <= KKT_TOLERANCE * most).all():
            # at a kink of the law either side's slope will do
            every = slice(None)
            other = self.scaled_slopes(self.wear.d_depth_dp(self.pressures(self.every)), every)
            worst = _natural(q[rows], gradient[rows], np.maximum(slope, other)[rows])
        return np.divide(worst, most, out=np.full(len(histories), np.inf), where=most > 0.0)


def part(values: FloatArray, rows: IntArray | slice) -> FloatArray:
    """Return the values of some rows, (h, n); where all have the same, (1, n)."""
    return values if len(values) == 1 else values[rows]


def _natural(q: FloatArray, gradient: FloatArray, slope: FloatArray) -> FloatArray:
    """Return natural KKT residuals of (h, n), infinite where there is none."""
    worst = largest(np.abs(np.minimum(q, gradient / (1.0 + slope))))
    return np.where(np.isfinite(worst), worst, np.inf)
