"""The approach at which a contact carries a given force, from contacts at given approaches.

The force grows with the approach and is piecewise linear for the threshold law, so that Newton
steps end. Our own method for many histories has the approach among its unknowns and needs no
search; PETSc's methods do, and histories whose sets of elements cycle.
"""

from collections.abc import Callable

import numpy as np

from ringwear_par.compiled.contact_rows import FORCE_TOLERANCE
from ringwear_par.contact.problem import FORCE_LIMIT
from ringwear_par.errors import ComputationError

_MOST_APPROACHES = 60


def find_approach(
    force: float, start: float, stiffness: float, contact_at: Callable[[float], tuple[float, float]]
) -> None:
    """Find the approach; the contact that was computed last is that at it.

    Newton steps, or bisection where they do not halve the imbalance.

    Parameters
    ----------
    force : N, positive.
    start : mm, the first approach, above the one at which bodies just touch.
    stiffness : N/mm, of the contact before any is computed.
    contact_at : computes the contact at an approach, mm, beyond that at which bodies just touch;
        returns the force, N, and its derivative, N/mm.

    Raises
    ------
    ComputationError : the force is not met.
    """
    low, high = 0.0, np.inf  # no contact, no force at low
    approach, imbalance_before = start, np.inf
    for _ in range(_MOST_APPROACHES):
        carried, derivative = contact_at(approach)
        imbalance = carried - force
        if abs(imbalance) <= FORCE_TOLERANCE * force:
            return
        low, high = (low, approach) if imbalance > 0.0 else (approach, high)
        stiffness = derivative or stiffness
        slow = abs(imbalance) > 0.5 * abs(imbalance_before)
        imbalance_before = imbalance
        following = approach - imbalance / stiffness
        if high < np.inf:
            if slow or not low < following < high:
                following = 0.5 * (low + high)
        elif slow:
            following = approach - 2.0 * imbalance / stiffness
        if following == approach:
            break
        approach = following
    if not abs(imbalance) <= FORCE_LIMIT * force:
        raise ComputationError(
            f"contact: the approach was not found: force {force + imbalance:.9g} N instead of "
            f"{force:.9g} N at approach {approach:.9g} mm after {_MOST_APPROACHES} trials"
        )
