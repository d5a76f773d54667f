"""Observer that keeps a whole history in memory, for checks, scripts and tests."""

from mpi4py import MPI

from ringwear_par.batched import one
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.observers.balances import Balances, WorstBalances
from ringwear_par.history.physics import Physics
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.state import State


class Trace:
    """Every state of a history, and the worst of its balances."""

    def __init__(self) -> None:
        #: states that the history went on from, the start first; and those within steps
        self.snapshots: list[Snapshot] = []
        self.passing: list[Snapshot] = []
        self._worst = WorstBalances()

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take a new state."""
        if snapshot.accepted[0]:
            (self.passing if snapshot.passing else self.snapshots).append(snapshot)
        self._worst(snapshot)
        return False

    @property
    def states(self) -> list[State]:
        """States that the history went on from, the start first, without an axis of histories."""
        return [one(snapshot.state, 0) for snapshot in self.snapshots]

    def at(self, time: float) -> State:
        """Return the state at a time (s), of all.

        Raises
        ------
        StopIteration : there is none.
        """
        states = (snapshot.state for snapshot in (*self.snapshots, *self.passing))
        return next(one(s, 0) for s in states if abs(s.time[0] - time) <= SAME_TIME * time)

    @property
    def last(self) -> State:
        """The last state."""
        return one(self.snapshots[-1].state, 0)

    @property
    def steps(self) -> int:
        """Number of steps made."""
        return int(self.snapshots[-1].progress.steps[0])

    @property
    def physics(self) -> Physics:
        """The physics; its contact solver is gone."""
        return self.snapshots[-1].physics

    @property
    def balances(self) -> Balances:
        """The worst of all states."""
        return self._worst.worst


def trace(case: Case, comm: MPI.Comm, *, pair: ContactPair | None = None) -> Trace:
    """Return all states of a history. Collective on comm; see ``simulate_one``."""
    history = Trace()
    simulate_one(case, comm, pair=pair, observers=[history])
    return history
