"""Elements that follow the wear: when they do, and the state that they lead to."""

from dataclasses import replace

import numpy as np

from ringwear_par.history.model import WearModel
from ringwear_par.history.state import State


def update_geometry(model: WearModel, state: State) -> State:
    """Return the state with elements that follow its wear, if that is more than the tolerance.

    Collective. It depends on the state alone, so that a restarted history does the same. Where
    elements do not follow the wear, the state stays as it is.
    """
    if model.geometry is None:
        return state
    meshed = np.zeros_like(state.wear) if state.meshed_wear is None else state.meshed_wear
    if np.abs(state.wear - meshed).max() <= model.case.mesh.geometry_tolerance:
        model.remesh_to(meshed)
        return replace(state, meshed_wear=meshed)
    before = model.compliances.every[0]
    model.remesh_to(state.wear)
    model.geometry.updates += 1
    after = model.compliances.every[0]
    # faces that wear has made to slope alike touch as they are displaced: what the turned slope
    # makes of displacements that there are already is no gap
    turned = after.slope != before.slope
    gained = state.contact.pressure @ (after.collocated - before.collocated).T
    offset = 0.0 if state.gap_offset is None else state.gap_offset
    model.gap_offset = np.where(turned, gained, 0.0) + offset
    # the rates at the start of the next step are to be those of the new elasticity
    contact = model.contact(state.time, state.wear, state.contact.pressure, exact=True)
    rates = model.rates_at(state.time, state.wear, contact.pressure)
    return replace(
        state, meshed_wear=state.wear, gap_offset=model.gap_offset, contact=contact, rates=rates
    )
