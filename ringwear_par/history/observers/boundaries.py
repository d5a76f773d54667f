"""Observer that recovers the fields on whole boundaries where a case asks for them."""

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.stress.boundary_fields import BoundaryState
from ringwear_par.history.elastic.pairs import boundary_recovery
from ringwear_par.history.observers.selection import Asked
from ringwear_par.history.snapshots import Instant


class BoundaryObserver:
    """Fields on the boundaries of lower and upper, at the stored states that a case asks for.

    Parameters
    ----------
    case : the case.
    comm : communicator; calls are collective.
    last_stored : s, time of the last stored state of an interrupted history; negative: none.
    """

    def __init__(self, case: Case, comm: MPI.Comm, last_stored: float = -1.0) -> None:
        self._case = case
        self._asked = Asked(case, case.output.boundary, last_stored)
        self._recovery = boundary_recovery(case, comm)
        #: what was asked for so far
        self.states: list[BoundaryState] = []

    def __call__(self, instant: Instant) -> None:
        """Recover the fields of a state, if the case wants them. Collective."""
        if self._asked(instant):
            state = instant.state
            bodies = self._recovery.fields(
                state.contact.pressure, state.contact.approach, self._case.friction, state.wear,
                state.meshed_wear,
            )  # fmt: skip
            self.states.append(BoundaryState(instant.steps, float(state.time), bodies))
