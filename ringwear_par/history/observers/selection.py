"""Which states of a history are stored, and which of these have boundary fields or stresses."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.elasticity.stress.fields import BoundaryState, StressState
from ringwear_par.history.inputs import StoredStates
from ringwear_par.history.snapshots import Instant

Timed = TypeVar("Timed", BoundaryState, StressState)


class Selection:
    """Tells of one state after another whether a case selects it.

    Parameters
    ----------
    case : the case.
    which : "none", "last", "all", or times (s) from each of which on the first stored state is.
    last_stored : s, time of the last stored state of an interrupted history; negative: none.
    """

    def __init__(self, case: Case, which: str | tuple[float, ...], last_stored: float) -> None:
        self._case, self._which, self._last_stored = case, which, last_stored

    def __call__(self, instant: Instant) -> bool:
        """Tell whether a state is selected, in the order of the history. Not collective."""
        time, steps = float(instant.state.time), instant.steps
        if not instant.stored:
            return False
        before = self._stored_before(time, steps)
        if not instant.passing:
            self._last_stored = time
        if isinstance(self._which, str):
            return self._which == "all" or (self._which == "last" and instant.finished)
        near = SAME_TIME * time
        return any(before + near < t <= time + near for t in self._which)

    def of_interrupted(
        self, states: Sequence[Timed], stored: FloatArray, finished: bool
    ) -> list[Timed]:
        """Return the states of an interrupted history that are still selected.

        Parameters
        ----------
        stored : s, times of the states that the case still stores.
        finished : whether the case has come to its end, and not a shorter one alone.
        """
        times = stored.tolist()
        if self._which == "last" and not finished:
            return []
        return [state for state in states if state.time in times]

    def _stored_before(self, time: float, steps: int) -> float:
        """Return the time of the stored state before one at a time; negative: there is none."""
        output = self._case.output
        if output.times:
            within = StoredStates.of([self._case]).within(np.array([-1.0]), np.array([time]))[0]
            first = 0.0 if time > 0.0 else -1.0
            return max(np.array(output.times)[within].tolist(), default=first)
        if not self._case.time.adaptive and steps > 0:
            # a shorter run's last state, from which this one may go on, is forgotten
            return (steps - 1) // output.every * output.every * self._case.time.step
        return self._last_stored
