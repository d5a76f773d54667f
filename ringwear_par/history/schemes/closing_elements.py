"""Elements that wear brings into contact within a step.

Such an element is in contact for a part of the step only. A stage that has it wear for all of its
time is off by as much as the element wears, and its pressure, which is to wear it off, by up to 1.4
times what it should be. So these elements make one implicit step each, in which gap and wear go at
the rate of their pressure (see ``Closing``). Where the force is kept, the others' stages count for
as much longer as makes up for it: over a step, all elements together carry the load.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, columns, inner
from ringwear_par.history.physics import Physics
from ringwear_par.history.state import State
from ringwear_par.wear.increment import Closing, WearIncrement

#: gaps that a step may close, in what the fastest element wears in it
_REACH = 2.0
#: largest area of elements that enter, in that of those in contact
_MOST = 0.25
#: least of what a stage counts more: wear never falls
_LEAST = -0.9
#: measured shares of the pressure at stake that elements are off by after they have entered, in a
#: step of their own and in the stages of all others
_ENTRY_ERROR, _STAGE_ERROR = 0.33, 0.67


@dataclass(frozen=True)
class Entering:
    """The elements that wear may bring into contact in a step.

    Parameters
    ----------
    gap : (..., n) float, mm, of these elements at the start, 0 elsewhere.
    area : (n,) float, mm^2.
    force_kept : whether the others carry what these do not.
    held : (..., n) float, how many times its weight the first stage counts for elements that wear
        through a layer after it, see ``held``; 1 for all others.
    """

    gap: FloatArray
    area: FloatArray
    force_kept: bool
    held: FloatArray | float = 1.0

    @property
    def late(self) -> BoolArray:
        """Which elements these are, (..., n)."""
        return (self.gap > 0.0) | (np.asarray(self.held) < 1.0)

    @property
    def first(self) -> FloatArray:
        """How many times its weight the first stage counts for these elements, (..., n)."""
        return np.where(self.gap > 0.0, 0.0, self.held)

    def closing(self, step: FloatArray, stretch: FloatArray) -> Closing:
        """Return what a stage closes; ``stretch`` is of the steps, s, of the elements."""
        return Closing(self.gap, columns(step) * stretch)

    def counts(self, p: FloatArray, counts: FloatArray | float) -> FloatArray:
        """Return how many times its weight a stage counts for each element, (..., n).

        Parameters
        ----------
        p : (..., n) float, MPa, of the stage.
        counts : for the elements that enter.
        """
        late, area = self.late, self.area
        ones = np.ones_like(p)
        if self.force_kept:
            lacking = np.asarray(inner(area, np.where(late, (1.0 - counts) * p, 0.0)))
            carried = np.asarray(inner(area, np.where(late, 0.0, p)))
            more = np.divide(lacking, carried, out=np.zeros_like(carried), where=carried > 0.0)
            ones = ones + np.maximum(more, _LEAST)[..., None]
        return np.where(late, counts, ones)

    def d_counts(self, p: FloatArray, d_p: FloatArray, counts: Any, d_counts: Any) -> FloatArray:
        """Return derivatives of ``counts``, (P, ..., n), from those of what it is given."""
        late, area = self.late, self.area
        if not self.force_kept:
            return np.where(late, d_counts, np.zeros_like(d_p))

        def carried(late_ones: Any, others: Any) -> Any:
            return np.asarray(inner(area, np.where(late, late_ones, others)))

        lacking, held = carried((1.0 - counts) * p, 0.0), carried(0.0, p)
        d_lacking, d_held = carried((1.0 - counts) * d_p - d_counts * p, 0.0), carried(0.0, d_p)
        whole = np.where(held > 0.0, held, 1.0)
        more = lacking / whole
        d_more = np.where((held > 0.0) & (more > _LEAST), (d_lacking - more * d_held) / whole, 0.0)
        return np.where(late, d_counts, d_more[..., None])


def entering(physics: Physics, state: State, length: FloatArray) -> Entering | None:
    """Return the elements that wear may bring into contact; None where there are none.

    Where an element that wears yields more elastically than it wears, its gap is not closed by
    wear; many elements that enter at once change all pressures; and non-local laws wear them before
    they touch. In these cases stages do as for all others, and ``entry_error`` judges.
    """
    p, gap = state.contact.pressure, state.contact.gap
    if not physics.inputs.wears_locally or (p > 0.0).all():
        return None
    worn = columns(length * state.rates.sum(axis=0).max(axis=-1))
    late = (p <= 0.0) & (gap > 0.0) & (gap < _REACH * worn)
    late &= worn > physics.own_displacement(columns(p.max(axis=-1)))
    # the others can make up for what a few of them carry
    touching = np.asarray(inner(physics.area, (p > 0.0).astype(float)))
    joining = np.asarray(inner(physics.area, (late & (gap < worn)).astype(float)))
    late &= (joining <= _MOST * touching)[..., None]
    if not late.any():
        return None
    return Entering(np.where(late, gap, 0.0), physics.area, physics.inputs.force is not None)


def held(
    physics: Physics, enter: Entering | None, first: WearIncrement, p: FloatArray, share: float
) -> Entering | None:
    """Return the elements that enter, and with them those that get to the next layer after a stage.

    The pressure of the first stage is not that of the next layer: it wears such an element as long
    as its layer lasts, and the last stage does for the rest of the step.

    Parameters
    ----------
    p : (..., n) float, MPa, of the first stage.
    share : of that stage's length, what it stands for.
    """
    if not first.layered:
        return enter
    counts = first.fraction_to_interface(p, share) / share
    if enter is not None:
        counts = np.where(enter.gap > 0.0, 1.0, counts)
    if not (counts < 1.0).any():
        return enter
    gap = np.zeros_like(p) if enter is None else enter.gap
    return Entering(gap, physics.area, physics.inputs.force is not None, counts)


def entry_error(
    physics: Physics,
    enter: Entering | None,
    before: State,
    after: State,
    unhindered: FloatArray,
) -> FloatArray:
    """Return the estimated errors of pressure of elements that came into contact, (..., n) MPa.

    Such a pressure is right where the wear of the element is far more than what it yields, or far
    less: it is then what wears it off as fast as the gap closes, or what elasticity alone makes of
    the overlap. In between it depends on when the element entered.

    Parameters
    ----------
    unhindered : (2, ..., n) float, mm, what the elements would have worn in contact all along.
    """
    p = after.contact.pressure
    came = (before.contact.pressure <= 0.0) & (p > 0.0)
    if not came.any():
        return np.zeros_like(p)
    elastic, most = physics.own_displacement(p), unhindered.sum(axis=0)
    worn = (after.wear - before.wear).sum(axis=0)
    size = np.maximum((elastic + worn) * (elastic + most), np.finfo(float).tiny)
    share: FloatArray | float = _STAGE_ERROR
    if enter is not None:
        share = np.where(enter.late, _ENTRY_ERROR, _STAGE_ERROR)
    return np.where(came, share * p * elastic * most / size, 0.0)
