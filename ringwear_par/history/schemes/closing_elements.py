"""Elements that wear brings into contact within a step.

Such an element is in contact for a part of the step only. If it wore for the whole of a stage, the
error would be as large as its wear, and that of its pressure up to 1.4 times the right pressure. So
each of these elements makes one implicit step of its own, in which its gap closes and it wears at
the rate of its pressure (see ``Closing``). Where the force is prescribed, the stages of the other
elements get more weight, so that over a step all elements together carry the load.
"""

from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, columns, inner
from ringwear_par.history.physics import Physics
from ringwear_par.history.state import State
from ringwear_par.wear.increment import Closing

#: largest gap that a step may close, over the wear of the fastest element in it
_REACH = 2.0
#: largest area of closing elements over that of elements in contact
_MOST = 0.25
#: least addition to the weight of a stage, which stays positive: wear never falls
_LEAST = -0.9
#: error of pressure of an element after it has entered, measured, as a part of
#: p * elastic * most / size (see ``entry_error``): in a closing step, and in an ordinary stage
_ENTRY_ERROR, _STAGE_ERROR = 0.33, 0.67


@dataclass(frozen=True)
class ClosingElements:
    """The elements that wear may bring into contact in a step."""

    #: (..., n) float, mm, of these elements at the start, 0 elsewhere
    gap: FloatArray
    #: (n,) float, mm^2
    area: FloatArray
    #: whether the force is prescribed, so that other elements carry what these do not
    force_kept: bool

    @property
    def mask(self) -> BoolArray:
        """Which elements these are, (..., n)."""
        return self.gap > 0.0

    def closing(self, step: FloatArray, stretch: FloatArray) -> Closing:
        """Return gaps and steps of elements in a stage, whose step (s) is stretched for each."""
        return Closing(self.gap, columns(step) * stretch)

    def stage_weights(self, p: FloatArray, weights: FloatArray | float) -> FloatArray:
        """Return factors on the weight of a stage, for each element, (..., n).

        Parameters
        ----------
        p : (..., n) float, MPa, of the stage.
        weights : the factors of closing elements.
        """
        closing, area = self.mask, self.area
        ones = np.ones_like(p)
        if self.force_kept:
            lacking = np.asarray(inner(area, np.where(closing, (1.0 - weights) * p, 0.0)))
            carried = np.asarray(inner(area, np.where(closing, 0.0, p)))
            extra = np.divide(lacking, carried, out=np.zeros_like(carried), where=carried > 0.0)
            ones = ones + np.maximum(extra, _LEAST)[..., None]
        return np.where(closing, weights, ones)


def find_closing_elements(
    physics: Physics, state: State, length: FloatArray
) -> ClosingElements | None:
    """Return the elements that wear may bring into contact; None where there are none.

    Elements whose elastic displacement is more than their wear in the step are left out:
    deflection, not wear, closes their gaps. So are many elements that enter at once, which change
    all pressures, and those that non-local laws wear before they touch. Stages do with these as
    with all others, and ``entry_error`` judges.
    """
    p, gap = state.contact.pressure, state.contact.gap
    if not physics.inputs.wears_locally:
        return None
    worn = columns(length * state.rates.sum(axis=0).max(axis=-1))
    closing = (p <= 0.0) & (gap > 0.0) & (gap < _REACH * worn)
    closing &= worn > physics.own_displacement(columns(p.max(axis=-1)))
    # other elements can make up only for the load of a few
    touching = physics.area_in_contact(p)
    joining = np.asarray(inner(physics.area, (closing & (gap < worn)).astype(float)))
    closing &= (joining <= _MOST * touching)[..., None]
    if not closing.any():
        return None
    return ClosingElements(
        np.where(closing, gap, 0.0), physics.area, physics.inputs.force is not None
    )


def entry_error(
    physics: Physics,
    closing: ClosingElements | None,
    before: State,
    after: State,
    depth_if_always_in_contact: FloatArray,
) -> FloatArray | None:
    """Return the estimated errors of pressure of elements that came into contact, (..., n) MPa.

    None where none did.

    Such a pressure is right where the element wears far more than it is displaced, as it then wears
    as fast as the gap closes; or far less, as elasticity alone then resists the overlap. In between
    it depends on when the element entered.

    Parameters
    ----------
    depth_if_always_in_contact : (..., n) float, mm, of the elements of both bodies.
    """
    p = after.contact.pressure
    entered = (before.contact.pressure <= 0.0) & (p > 0.0)
    if not entered.any():
        return None
    elastic, most = physics.own_displacement(p), depth_if_always_in_contact
    worn = (after.wear - before.wear).sum(axis=0)
    size = np.maximum((elastic + worn) * (elastic + most), np.finfo(float).tiny)
    share: FloatArray | float = _STAGE_ERROR
    if closing is not None:
        share = np.where(closing.mask, _ENTRY_ERROR, _STAGE_ERROR)
    return np.where(entered, share * p * elastic * most / size, 0.0)
