"""Observer that recovers the fields on whole boundaries where a case asks for them."""

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.boundary_fields import BoundaryState
from ringwear_par.history.pairs import boundary_recovery
from ringwear_par.history.saving import times_within, wants_boundary
from ringwear_par.history.snapshots import Snapshot


class BoundaryObserver:
    """Fields on the boundaries of lower and upper, at the stored states that a case asks for.

    Parameters
    ----------
    case : the case.
    comm : communicator; calls are collective.
    last_stored : s, time of the last stored state of an interrupted history; negative: none.
    """

    def __init__(self, case: Case, comm: MPI.Comm, last_stored: float = -1.0) -> None:
        self._case, self._last_stored = case, last_stored
        self._recovery = boundary_recovery(case, comm)
        #: what was asked for so far
        self.states: list[BoundaryState] = []

    def __call__(self, snapshot: Snapshot) -> bool:
        """Recover the fields of a state, if the case wants them. Collective."""
        case, state = self._case, snapshot.state
        steps = snapshot.progress.steps
        if snapshot.stored and wants_boundary(
            case, state.time, snapshot.finished, self._stored_before(state.time, steps)
        ):
            bodies = self._recovery.fields(
                state.contact.pressure, state.contact.approach, case.friction, state.wear,
                state.shape,
            )  # fmt: skip
            self.states.append(BoundaryState(steps, state.time, bodies))
        if snapshot.stored and not snapshot.passing:
            self._last_stored = state.time
        return False

    def _stored_before(self, time: float, steps: int) -> float:
        """Return the time of the stored state before one at a time; negative: there is none."""
        output = self._case.output
        if output.times:
            return max(times_within(self._case, -1.0, time), default=0.0 if time > 0.0 else -1.0)
        if not self._case.time.adaptive and steps > 0:
            # a shorter run's last state, from which this one may go on, is forgotten
            return (steps - 1) // output.every * output.every * self._case.time.step
        return self._last_stored
