"""What observers see of histories on their way."""

from collections.abc import Callable
from dataclasses import dataclass, field

from ringwear_par.arrays import BoolArray, IntArray
from ringwear_par.batched import along, one
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.history.physics import Physics
from ringwear_par.history.schemes.step import Step
from ringwear_par.history.state import Progress, State


@dataclass(frozen=True)
class Snapshot:
    """States of B histories on their way, each at a time of its own."""

    #: (B,) int, of the histories among all cases
    numbers: IntArray
    #: of these histories; the contacts start from here
    physics: Physics = field(metadata=along(None))
    contacts: CorrectedContacts = field(metadata=along(None))
    #: the states
    state: State
    #: that led there; None at the start
    step: Step | None = field(metadata=along(None))
    #: of step control, after it
    progress: Progress
    #: (B,) int, of the contact solver, for these states
    iterations: IntArray
    #: (B,) bool, which histories have come to a new state; of the others nothing is to be taken
    accepted: BoolArray
    #: (B,) bool, which new states their cases store, and which are the last ones
    stored: BoolArray
    finished: BoolArray
    #: whether all of them lie within steps, at times of output, and the histories do not continue
    #: from them
    passing: bool = field(default=False, metadata=along(None))

    def instant(self, place: int) -> "Instant":
        """Return the state of one of the histories."""
        return Instant(
            one(self.state, place),
            int(self.progress.steps[place]),
            bool(self.stored[place]),
            self.passing,
            bool(self.finished[place]),
        )


@dataclass(frozen=True)
class Instant:
    """One history at an instant."""

    #: without the axis of histories
    state: State
    #: number of steps made
    steps: int
    #: see ``Snapshot``
    stored: bool
    passing: bool
    finished: bool


#: called with every snapshot, the same on all ranks; tells whether the histories are to stop here,
#: which they do where one of the observers says so. Any observer that meets other ranks does it in
#: every snapshot
Observer = Callable[[Snapshot], bool]
