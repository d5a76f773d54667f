"""How far the next step goes, and whether it is taken: fixed steps, or steps held to a tolerance.

A control remembers what it needs between two steps, and gives it as ``Progress``, from which an
interrupted history goes on. Another control is a class with the same four methods.
"""

from dataclasses import replace
from typing import Protocol

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.errors import ComputationError, LawError
from ringwear_par.history.schemes import Step
from ringwear_par.history.state import Progress, State

_SAFETY, _LARGEST_GROWTH, _LARGEST_CUT = 0.9, 5.0, 0.1
#: wear of the first step, in tolerances: edges wear fast and not for long
_FIRST_WEAR = 50.0
#: largest error of the dissipated energy of one step, relative to that of the whole history as it
#: would be if the power stayed
_ENERGY_TOLERANCE = 1e-4


class Control(Protocol):
    """What ``simulate`` asks of step control."""

    @property
    def progress(self) -> Progress:
        """What it remembers."""
        ...

    def end(self, state: State) -> float:
        """Return the time, s, to which the next step is tried."""
        ...

    def accepts(self, step: Step) -> bool:
        """Tell whether a step is taken; if not, another one is tried from the same state."""
        ...

    def failed(self, error: ComputationError) -> None:
        """Take note of a step that could not be made; raise the error if no other will do."""
        ...


class FixedSteps:
    """Steps of one length; what they miss is told, not held.

    Parameters
    ----------
    case : its ``time.step``.
    progress : from where on.
    """

    def __init__(self, case: Case, progress: Progress) -> None:
        self._length, self.progress = case.time.step, progress

    def end(self, state: State) -> float:
        """Return the time of the next multiple of the step, s."""
        return (self.progress.steps + 1) * self._length

    def accepts(self, step: Step) -> bool:
        """Take every step."""
        made = self.progress
        iterations = made.iterations + step.state.contact.iterations
        self.progress = Progress(made.steps + 1, 0.0, 0, iterations)
        return True

    def failed(self, error: ComputationError) -> None:
        """Raise the error: there is no other step."""
        raise error


class ErrorControl:
    """Steps whose estimated errors of wear, pressure and energy are within tolerances.

    They end at the times at which a schedule or a parameter bends, and while elements follow the
    wear they wear about the tolerance of the geometry at most.

    Parameters
    ----------
    case : its ``time.end``, ``time.tolerance`` (mm), ``time.pressure_tolerance`` and breakpoints.
    progress : from where on.
    """

    def __init__(self, case: Case, progress: Progress) -> None:
        self._case, self.progress = case, progress
        self._from: State | None = None  # the state that the present tries start from
        self._length = self._end = 0.0
        self._cut = False
        self._iterations, self._failure = 0, ""
        self._pressed = False  # whether a try of the present step failed by its pressure

    def end(self, state: State) -> float:
        """Return the time to which the next step is tried, s.

        Raises
        ------
        ComputationError : no step, however small, meets the tolerance.
        """
        time = self._case.time
        limit = next((t for t in self._case.breakpoints if t > state.time), time.end)
        if self._from is None:
            self._iterations, self._failure, self._pressed = 0, "", False
            self._length = self.progress.next_step or _first_length(self._case, state)
            if self._case.follows_wear:
                self._length = min(self._length, _longest_length(self._case, state))
        self._from = state
        left = limit - state.time
        self._cut = self._length >= left * (1.0 - 1e-9)
        if self._cut:
            self._end = limit
        else:  # no sliver at the end
            whole = self._length < 0.5 * left or self._length > 0.9 * left
            self._end = state.time + (self._length if whole else 0.5 * left)
        if self._end - state.time <= 4.0 * np.spacing(state.time):
            raise ComputationError(
                f"time.tolerance = {time.tolerance:g} mm and time.pressure_tolerance = "
                f"{time.pressure_tolerance:g} are not met by any step; the last one "
                f"would be {self._end - state.time:.3g} s{self._failure}"
            )
        return self._end

    def failed(self, error: ComputationError) -> None:
        """Try a quarter of the step; a law that fails will fail in any."""
        if isinstance(error, LawError) or self._from is None:
            raise error
        self._failure = f" ({error})"
        self._length = 0.25 * (self._end - self._from.time)
        self.progress = replace(self.progress, rejected=self.progress.rejected + 1)

    def accepts(self, step: Step) -> bool:
        """Take a step within the tolerances; change the next one with the third root of its error.

        The energy is held too: schedules may change it where nothing wears.
        """
        assert self._from is not None
        made, time = self.progress, self._case.time
        length = self._end - self._from.time
        self._iterations += step.state.contact.iterations
        ratio = 0.0
        if step.energy_error > 0.0:
            whole = step.state.energy + step.power * (time.end - self._end)
            ratio = step.energy_error / (_ENERGY_TOLERANCE * whole)
        ratio = max(ratio, step.wear_error / time.tolerance, 1e-6)
        pressed = step.pressure_error / time.pressure_tolerance
        if pressed > 1.0:
            ratio, self._pressed = max(ratio, pressed), True
        change = max(_SAFETY * ratio ** (-1.0 / 3.0), _LARGEST_CUT)
        if ratio > 1.0:
            self._length = length * change
            self.progress = replace(made, rejected=made.rejected + 1)
            return False
        # errors of pressure come and go with elements: they limit steps, but do not foretell them
        following = length * min(change, 1.0 if self._pressed else _LARGEST_GROWTH)
        self.progress = replace(
            made,
            steps=made.steps + 1,
            next_step=max(following, self._length) if self._cut else following,
            iterations=made.iterations + self._iterations,
        )
        self._from = None
        return True


def _first_length(case: Case, state: State) -> float:
    time, fastest = case.time, float(state.rates.max())
    return min(time.end, _FIRST_WEAR * time.tolerance / fastest) if fastest > 0.0 else time.end


def _longest_length(case: Case, state: State) -> float:
    """Return the length in which wear stays about the tolerance of the geometry, s."""
    fastest = float(state.rates.max())
    return case.mesh.geometry_tolerance / fastest if fastest > 0.0 else np.inf
