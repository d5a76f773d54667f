"""Elements that follow the wear: when they are meshed anew, and the physics and state after it."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.problem import WarmStart
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.errors import ComputationError
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.elastic.compliances import Compliances
from ringwear_par.history.elastic.pairs import updated_geometry
from ringwear_par.history.physics import Physics
from ringwear_par.history.state import State


class MovingGeometry:
    """The elasticity of a case whose elements follow the wear.

    Parameters
    ----------
    case : the case.
    comm : communicator; methods are collective.
    """

    def __init__(self, case: Case, comm: MPI.Comm) -> None:
        self._case, self._geometry = case, updated_geometry(case, comm)
        #: (2, n) mm, wear of the profiles that the elements are meshed on
        self._meshed_wear = np.zeros((2, case.line.n))

    def unworn(self) -> ContactPair:
        """Return the pair before any wear. Collective."""
        return self._geometry.update(np.zeros_like(self._meshed_wear))

    def follow(
        self, physics: Physics, contacts: CorrectedContacts, state: State
    ) -> tuple[Physics, CorrectedContacts, State]:
        """Return physics, contacts and state of elements that have followed the wear of a state.

        Only if the wear since then is more than ``mesh.geometry_tolerance``; otherwise they are the
        same as before. It depends on the state alone, so that a restarted history does the same.
        Collective.

        Raises
        ------
        ComputationError : the worn bodies cannot be computed.
        """
        meshed = np.zeros_like(state.wear) if state.meshed_wear is None else state.meshed_wear
        if np.abs(state.wear - meshed).max() <= self._case.mesh.geometry_tolerance:
            physics, contacts = self.remesh_to(meshed, physics, contacts)
            return physics, contacts, replace(state, meshed_wear=meshed)
        before = physics.compliances.every[0]
        physics, contacts = self.remesh_to(state.wear, physics, contacts)
        after = physics.compliances.every[0]
        # where a slope has turned, the displacement along the axis under the present pressure
        # jumps, though nothing has moved: the offset takes this jump out of the gap
        turned = after.slope != before.slope
        jump = state.contact.pressure @ (after.collocated - before.collocated).T
        offset = 0.0 if state.gap_offset is None else state.gap_offset
        offset = np.where(turned, jump, 0.0) + offset
        physics = replace(physics, gap_offset=offset, updates=physics.updates + 1)
        # the rates at the start of the next step are to be those of the new elasticity
        inputs = physics.contact_inputs(state.time, state.wear)
        contact = contacts.solve(inputs, state.contact.pressure, exact=True)
        rates = physics.rates_at(state.time, state.wear, contact.pressure)
        state = replace(
            state, meshed_wear=state.wear, gap_offset=offset, contact=contact, rates=rates
        )
        return physics, contacts, state

    def remesh_to(
        self, wear: FloatArray, physics: Physics, contacts: CorrectedContacts
    ) -> tuple[Physics, CorrectedContacts]:
        """Return physics and contacts of elements that have followed a wear, (2, 1, n) mm.

        Contacts of other elements are closed. Collective.
        """
        if np.array_equal(wear[:, 0], self._meshed_wear):
            return physics, contacts
        pair = self._geometry.update(wear[:, 0])
        try:
            compliance = pair.compliance(young(self._case))
        except ComputationError as error:
            raise ComputationError(_slivers(pair.line, wear[:, 0]) or str(error)) from error
        self._meshed_wear = wear[:, 0]
        physics = physics.with_compliances(Compliances.of_each([compliance]), pair.cost)
        contacts.close()
        new_contacts = physics.contacts()
        rescaled = new_contacts.engine.scale / contacts.engine.scale
        warm = contacts.warm
        new_contacts.warm = WarmStart(warm.scaled_pressure * rescaled, warm.approach)
        new_contacts.largest_errors = contacts.largest_errors
        return physics, new_contacts


def _slivers(line: ContactLine, wear: FloatArray) -> str:
    """Return where a worn face stands out by more than elements are wide; "" for nowhere."""
    rises = np.abs(np.diff(wear, axis=-1))
    steep = rises / np.minimum(line.width[1:], line.width[:-1])
    body, e = np.unravel_index(steep.argmax(), steep.shape)
    if steep[body, e] <= 1.0:
        return ""
    less, more = sorted((e, e + 1), key=lambda place: wear[body, place])
    return (
        f"elements that follow the wear: {('lower', 'upper')[body]} is worn by "
        f"{wear[body, more]:.4g} mm at r = {line.r[more]:.6g} mm and by "
        f"{wear[body, less]:.4g} mm at r = {line.r[less]:.6g} mm beside it; what stands out "
        f"by {steep[body, e]:.2g} times the width of an element is no face that can be computed"
        ': mesh.geometry = "fixed", or laws of wear that differ less, must be used'
    )
