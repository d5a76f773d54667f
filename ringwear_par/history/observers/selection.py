"""Which states of a history are stored, and which of these have boundary fields or stresses."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import TypeVar

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.elasticity.stress.boundary_fields import BoundaryState
from ringwear_par.elasticity.stress.fields import StressState
from ringwear_par.history.snapshots import Instant

Timed = TypeVar("Timed", BoundaryState, StressState)


def _same(time: float, *others: float) -> bool:
    """Tell whether a time is one of others but for round-off."""
    return any(abs(time - other) <= SAME_TIME * time for other in others)


def stores(case: Case, step: int, time: float) -> bool:
    """Tell whether a case stores its state after so many steps, at a time (s)."""
    output = case.output
    if step == 0 or case.time.finished(step, time):
        return True
    if output.times:
        i = bisect_left(output.times, time)
        return any(_same(t, time) for t in output.times[max(i - 1, 0) : i + 1])
    return step % output.every == 0


def times_within(case: Case, start: float, end: float) -> list[float]:
    """Return the times of output strictly between two times, s."""
    times = case.output.times
    between = times[bisect_right(times, start) : bisect_left(times, end)]
    return [t for t in between if not _same(t, start, end)]


def wants(asked: str | tuple[float, ...], time: float, finished: bool, before: float) -> bool:
    """Tell whether a stored state is asked for.

    Parameters
    ----------
    asked : "none", "last", "all", or times (s) from each of which on the first stored state is.
    time : s, of the state.
    finished : whether it is the last.
    before : s, time of the stored state before it; negative: there is none.
    """
    if isinstance(asked, str):
        return asked == "all" or (asked == "last" and finished)
    near = SAME_TIME * time
    return any(before + near < t <= time + near for t in asked)


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
        return wants(self._which, time, instant.finished, before)

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
            return max(times_within(self._case, -1.0, time), default=0.0 if time > 0.0 else -1.0)
        if not self._case.time.adaptive and steps > 0:
            # a shorter run's last state, from which this one may go on, is forgotten
            return (steps - 1) // output.every * output.every * self._case.time.step
        return self._last_stored
