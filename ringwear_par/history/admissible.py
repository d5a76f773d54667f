"""What the model does not hold for: overlapping bodies, contact cut by the mesh, deep wear."""

from typing import TYPE_CHECKING

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.errors import ComputationError, HistoriesError, UnfitError
from ringwear_par.history.given import of_faces
from ringwear_par.history.stability import pressed
from ringwear_par.history.state import State
from ringwear_par.schedules import largest

if TYPE_CHECKING:
    from ringwear_par.history.model import WearModel


def check_interpenetration(model: "WearModel") -> None:
    """Refuse undeformed bodies that overlap by more than the largest force presses them.

    Collective.

    Raises
    ------
    UnfitError, or HistoriesError of B histories : they do.
    """
    if model.given.several:
        _check_interpenetrations(model)
        return
    case, overlap = model.case, model.case.interpenetration
    if case.load.force is None or overlap == 0.0:
        return
    found = pressed(model.solver, case)
    if found.approach < 0.0:
        e = int(case.initial_gap.argmin())
        raise UnfitError(
            f"upper.z, lower.z and contact faces: the undeformed bodies interpenetrate by "
            f"{overlap:.6g} mm at element {e} (r = {model.line.r[e]:.6g} mm); must be at most "
            f"the {overlap + found.approach:.6g} mm that the load presses them together"
        )


def _check_interpenetrations(model: "WearModel") -> None:
    given = model.given
    if given.force is None or not (given.initial_gap < 0.0).any():
        return
    overlaps = of_faces(given.cases, lambda case: case.interpenetration)
    overlapping = np.flatnonzero(np.array(overlaps) > 0.0)
    forces = np.array([largest(case.load.force or 0.0) for case in given.cases])
    found = model.batch.solver.solve(given.initial_gap, force=forces, histories=overlapping)
    if (apart := found.approach[overlapping] < 0.0).any():
        which = np.zeros(len(given.cases), dtype=bool)
        which[overlapping[apart]] = True
        raise HistoriesError(which)


def checked(case: Case, state: State) -> State:
    """Return a state, of one history or of B, if the model holds for it. Not collective.

    Parameters
    ----------
    case : of the history; any of the B, which have the same heights.

    Raises
    ------
    ComputationError, or HistoriesError of B histories : contact has reached an end of the contact
        line that is no edge, or half of a body has been worn off.
    """
    if state.wear.ndim > 2:
        return _all_checked(case, state)
    for e in _open_ends(case):
        if state.contact.pressure[e] > 0.0:
            raise ComputationError(
                f"time {state.time:g} s: contact has reached the end of mesh.contact "
                f"at r = {case.line.edges[e]:g} mm; must be wider there"
            )
    most = _most_wear(case)
    if state.wear.max() > min(most):
        deepest = state.wear.max(axis=1)
        if (deepest > most).any():
            body = "lower" if deepest[0] > most[0] else "upper"
            raise ComputationError(
                f"time {state.time:g} s: {deepest.max():.4g} mm are worn off {body}, "
                "more than half of its height"
            )
    return state


def _all_checked(case: Case, state: State) -> State:
    most = _most_wear(case)
    off = np.zeros(state.wear.shape[1], dtype=bool)
    if state.wear.max() > min(most):
        off |= (state.wear.max(axis=2) > np.array(most)[:, None]).any(axis=0)
    for e in _open_ends(case):
        off |= state.contact.pressure[:, e] > 0.0
    if off.any():
        raise HistoriesError(off)
    return state


def _open_ends(case: Case) -> list[int]:
    """Return the end elements, 0 and -1, at which mesh.contact cut the contact."""
    return [e for e, cut in zip((0, -1), case.open_ends, strict=True) if cut]


def _most_wear(case: Case) -> tuple[float, ...]:
    """Return how deep lower and upper may be worn, mm."""
    return tuple(0.5 * (ring.z[1] - ring.z[0]) for ring in case.rings)
