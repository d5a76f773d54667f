"""Observer of the states from which histories can go on."""

from dataclasses import dataclass, replace

import numpy as np

from ringwear_par import batched
from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.history.physics import Physics
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.state import Start


@dataclass(frozen=True)
class LastState:
    """The present or last states of B histories.

    Parameters
    ----------
    start : to continue from, without derivatives.
    symmetry_defect : (B,) of the compliances.
    finished : (B,) whether the histories have come to their ends.
    """

    start: Start
    symmetry_defect: FloatArray
    finished: BoolArray

    @classmethod
    def of(cls, snapshot: Snapshot, places: IntArray) -> "LastState":
        """Return the states of some histories of a snapshot."""
        physics, state = snapshot.physics, replace(snapshot.state, tangent=None)
        start = Start(state, snapshot.progress, snapshot.contacts.warm, physics.updates)
        defect = physics.compliances.symmetry_defect
        return batched.take(cls(start, defect, snapshot.finished), places)


class LastStates:
    """The state from which each of B histories can go on: an observer. Not collective.

    Parameters
    ----------
    count : B.
    results : whether the states at the ends of the histories are wanted.
    """

    def __init__(self, count: int, results: bool = True) -> None:
        self._results = results
        #: the last snapshot that histories went on from; None before the first
        self.snapshot: Snapshot | None = None
        #: (2, B) s, when wear got through all layers of lower and upper, by the end of a history
        self.through = np.full((2, count), np.inf)
        self._ended: dict[int, tuple[LastState, int]] = {}

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take new states."""
        if snapshot.passing:
            return False
        self.snapshot = snapshot
        places = np.flatnonzero(snapshot.finished)
        if not len(places):
            return False
        numbers = snapshot.numbers[places]
        if snapshot.state.through is not None:
            self.through[:, numbers] = snapshot.state.through[:, places]
        if self._results:
            states = LastState.of(snapshot, places)
            self._ended |= {number: (states, i) for i, number in enumerate(numbers.tolist())}
        return False

    def state(self, number: int) -> LastState:
        """Return the state of a history at its end, or its present one, as of one of B = 1."""
        if number in self._ended:
            states, place = self._ended[number]
            return batched.take(states, np.array([place]))
        assert self.snapshot is not None
        return LastState.of(self.snapshot, np.flatnonzero(self.snapshot.numbers == number))

    @property
    def physics(self) -> Physics:
        """The physics of the last snapshot."""
        assert self.snapshot is not None
        return self.snapshot.physics

    @property
    def finished(self) -> bool:
        """Whether a single history has come to its end."""
        return self.snapshot is not None and bool(self.snapshot.finished.all())
