"""Observer that recovers the fields on whole boundaries where a case asks for them."""

from collections.abc import Sequence

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.stress.fields import BoundaryState
from ringwear_par.history.elastic.pairs import boundary_recovery
from ringwear_par.history.observers.selection import Selection
from ringwear_par.history.snapshots import Snapshot


class BoundaryObserver:
    """Fields on the boundaries of lower and upper, at the stored states that a case asks for.

    Parameters
    ----------
    case : the case; one that asks for fields has a history of its own.
    comm : communicator; calls are collective.
    last_stored : s, time of the last stored state of an interrupted history; negative: none.
    """

    def __init__(self, case: Case, comm: MPI.Comm, last_stored: float = -1.0) -> None:
        self._case = case
        self._selection = Selection(case, case.output.boundary, last_stored)
        wanted = case.output.boundary != "none"
        self._recovery = boundary_recovery(case, comm) if wanted else None
        #: the states so far
        self.states: list[BoundaryState] = []

    def restore(self, states: Sequence[BoundaryState], stored: FloatArray, finished: bool) -> None:
        """Take the states of an interrupted history, see ``Selection.of_interrupted``."""
        self.states = self._selection.of_interrupted(states, stored, finished)

    def __call__(self, snapshot: Snapshot) -> bool:
        """Recover the fields of a state, if the case wants them. Collective."""
        if self._recovery is None or not snapshot.accepted[0]:
            return False
        instant = snapshot.instant(0)
        if self._selection(instant):
            state = instant.state
            bodies = self._recovery.fields(
                state.contact.pressure, state.contact.approach,
                self._case.friction_at(float(state.time)), state.wear, state.meshed_wear,
            )  # fmt: skip
            self.states.append(BoundaryState(instant.steps, float(state.time), bodies))
        return False
