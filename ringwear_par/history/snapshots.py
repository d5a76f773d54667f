"""What observers of a history are shown."""

from collections.abc import Callable
from dataclasses import dataclass

from ringwear_par.arrays import BoolArray, IntArray
from ringwear_par.history.model import WearModel
from ringwear_par.history.schemes import Step
from ringwear_par.history.state import Progress, State


@dataclass(frozen=True)
class Snapshot:
    """A state of a history on its way.

    Parameters
    ----------
    model : the physics, for what follows from a state.
    state : the state.
    step : that led there; None at the start.
    progress : of step control, after it.
    iterations : of the contact solver, for this state.
    stored : whether the case stores it.
    passing : whether it lies within a step, at a time of output, and the history does not go on
        from it.
    finished : whether it is the last one.
    """

    model: WearModel
    state: State
    step: Step | None
    progress: Progress
    iterations: int
    stored: bool
    passing: bool = False
    finished: bool = False


@dataclass(frozen=True)
class BatchSnapshot:
    """States of B histories on their way, each at a time of its own.

    Parameters
    ----------
    numbers : (B,) int, of the histories among all that were given.
    model, state : the physics and the states.
    step : that led there; None at the start.
    progress : of step control, after it.
    iterations : (B,) int, of the contact solver, for these states.
    shown : (B,) bool, which histories have come to a new state; of the others nothing is to be
        taken.
    stored, finished : (B,) bool, which new states their cases store, and which are the last ones.
    passing : whether all of them lie within steps, at times of output.
    """

    numbers: IntArray
    model: WearModel
    state: State
    step: Step | None
    progress: Progress
    iterations: IntArray
    shown: BoolArray
    stored: BoolArray
    finished: BoolArray
    passing: bool = False


#: called with every snapshot, the same on all ranks; tells whether the history is to stop here,
#: which it does where one of its observers says so. Any observer that meets other ranks does it in
#: every snapshot
Observer = Callable[[Snapshot], bool]
