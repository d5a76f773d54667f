"""States that are refused: overlapping bodies, contact at the end of the mesh, deep wear."""

import numpy as np

from ringwear_par.arrays import largest
from ringwear_par.cases.plausible import wear_question
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError, HistoriesError, UnfitError
from ringwear_par.history.inputs import HistoryInputs, of_faces
from ringwear_par.history.physics import Physics
from ringwear_par.history.refusals.stable_steps import most_loaded_contacts
from ringwear_par.history.state import State


def check_interpenetration(physics: Physics, contacts: CorrectedContacts) -> None:
    """Refuse undeformed bodies that overlap by more than the largest force presses them.

    Raises
    ------
    UnfitError : they do; HistoriesError of several histories.
    """
    inputs = physics.inputs
    if inputs.force is None or not (inputs.initial_gap < 0.0).any():
        return
    overlaps = np.array(of_faces(inputs.cases, lambda case: case.interpenetration))
    overlapping = np.flatnonzero(overlaps > 0.0)
    approach = most_loaded_contacts(physics, contacts, overlapping).approach
    apart = np.zeros(len(overlaps), dtype=bool)
    apart[overlapping] = approach[overlapping] < 0.0
    if not apart.any():
        return
    if len(apart) > 1:
        raise HistoriesError(apart)
    e = int(inputs.initial_gap[0].argmin())
    raise UnfitError(
        f"upper.z, lower.z and contact faces: the undeformed bodies interpenetrate by "
        f"{overlaps[0]:.6g} mm at element {e} (r = {physics.line.r[e]:.6g} mm); must be at most "
        f"the {overlaps[0] + approach[0]:.6g} mm that the load presses them together"
    )


def check_state(inputs: HistoryInputs, state: State) -> State:
    """Return a state if the physics holds for it. Not collective.

    Raises
    ------
    ComputationError : contact has reached an end of the contact line that is no edge, or half of a
        body has been worn off; HistoriesError of several histories.
    """
    most, open_ends = inputs.most_wear, inputs.open_ends
    if not open_ends and not state.wear.max() > min(most):
        return state
    case, deepest = inputs.cases[0], largest(state.wear)
    too_deep = (deepest > np.array(most)[:, None]).any(axis=0)
    off = too_deep.copy()
    for e in open_ends:
        off |= state.contact.pressure[:, e] > 0.0
    if not off.any():
        return state
    if len(off) > 1:
        raise HistoriesError(off)
    if too_deep[0]:
        body = BODIES[int(deepest[0, 0] <= most[0])]
        raise ComputationError(
            f"time {state.time[0]:g} s: {deepest.max():.4g} mm are worn off {body}, more than half "
            f"of its height{wear_question(case, body)}"
        )
    e = next(e for e in open_ends if state.contact.pressure[0, e] > 0.0)
    raise ComputationError(
        f"time {state.time[0]:g} s: contact has reached the end of mesh.contact "
        f"at r = {case.line.edges[e]:g} mm; mesh.contact must be wider there"
    )
