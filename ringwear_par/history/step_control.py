"""Step control: how far the next step of each history goes, and whether a try is accepted.

A control is frozen data of B histories; what changes from step to step is their ``Progress``, which
its functions take and return. Another control is a class with the same methods, in any file of
``history``, and a line in ``SCHEMES`` of ``cases/schema.py``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.compiled import step_rows
from ringwear_par.compiled.machine_code import load
from ringwear_par.compiled.step_rows import StepErrors, Tolerances, Tries
from ringwear_par.errors import ComputationError, HistoriesError, InterfaceError
from ringwear_par.history.schemes.step import Step
from ringwear_par.history.state import Progress, State

#: length of the next try over one whose step could not be made
_AFTER_FAILURE = 0.25
#: end of a sentence about a step
NO_STEP = "and no step is short enough"
#: beginning of a sentence about a step that is to end at an interface
_UNREACHED = "the time at which an element reaches the end of its layer cannot be computed"
#: length of a first step after a crossing over the shortest one since the crossing before
_AFTER_CROSSING = 1.2


@dataclass(frozen=True)
class Decision:
    """What a control decides of tries."""

    #: (B,) bool, which histories accept their try
    accepted: BoolArray
    #: (B,) bool, which of these have come to the end of a step; the others to an interface of
    #: layers within it
    complete: BoolArray
    #: after the tries
    progress: Progress


class Control(Protocol):
    """The step control of B histories."""

    @classmethod
    def of(cls, cases: Sequence[Case], step_times: Sequence[Sequence[float]] | None) -> Self:
        """Return the control of some cases; ``step_times`` (s) are ends of steps for each."""
        ...

    def next_try(self, state: State, progress: Progress) -> tuple[FloatArray, Progress]:
        """Return the times to which steps are tried, (B,) s, and the progress with their lengths.

        Raises
        ------
        ComputationError : there is no such step; HistoriesError of several histories.
        """
        ...

    def decide(self, before: State, step: Step, progress: Progress) -> Decision:
        """Return which tries are accepted."""
        ...

    def shorten(self, before: State, end: FloatArray, progress: Progress) -> Progress | None:
        """Return the progress for a shorter try, where one failed; None: there is none."""
        ...

    def finished(self, state: State, progress: Progress) -> BoolArray:
        """Return which histories are at their end, (B,)."""
        ...


def step_times_of(times: Sequence[float], case: Case) -> list[float]:
    """Return the ends of steps of a case as numbers.

    Raises
    ------
    ValueError : they do not increase to its end, or there are more or less than fixed ones.
    """
    ends = [float(time) for time in times]
    if not ends or ends[-1] != case.time.end or not np.all(np.diff([0.0, *ends]) > 0.0):
        raise ValueError(f"step_times: must increase from 0 to {case.time.end:g} s")
    if not case.time.adaptive and len(ends) != case.time.steps:
        raise ValueError(f"step_times: must be {case.time.steps} of them")
    return ends


def _padded(rows: Sequence[Sequence[float]]) -> FloatArray:
    """Return rows of unlike lengths as one array, each row's last number repeated."""
    most = max(map(len, rows))
    return np.array([[*row, *[row[-1]] * (most - len(row))] for row in rows], dtype=float)


@dataclass(frozen=True)
class FixedSteps:
    """Steps of one length, or to given times."""

    #: (B,) s
    length: FloatArray
    #: (B,) number of them
    steps: IntArray
    #: (B, m) s, given times, each history's last one repeated; None: multiples of the length
    ends: FloatArray | None = None

    @classmethod
    def of(cls, cases: Sequence[Case], step_times: Sequence[Sequence[float]] | None) -> Self:
        """Return the control of some cases."""
        length = np.array([case.time.step for case in cases])
        if step_times is None:
            return cls(length, np.array([case.time.steps for case in cases]))
        ends = [step_times_of(*both) for both in zip(step_times, cases, strict=True)]
        return cls(length, np.array([len(times) for times in ends]), _padded(ends))

    def next_try(self, state: State, progress: Progress) -> tuple[FloatArray, Progress]:
        """Return the times of the next steps' ends."""
        end = _until_interface(state, self._end(progress), progress)
        if (stuck := _is_short(state.time, end)).any():
            if len(stuck) > 1:
                raise HistoriesError(stuck)
            raise InterfaceError(f"{_UNREACHED}, {NO_STEP}")
        return end, progress

    def _end(self, progress: Progress) -> FloatArray:
        """Return the times of the present steps' ends."""
        if self.ends is None:
            return (progress.steps + 1) * self.length
        return self.ends[np.arange(len(self.ends)), progress.steps]

    def decide(self, before: State, step: Step, progress: Progress) -> Decision:
        """Accept every step, and every part of one that ends at an interface of layers.

        After such an end the rest of the step is tried, so that histories whose numbers differ a
        little make the same steps.
        """
        iterations = progress.tried_iterations + step.state.contact.iterations
        accepted = np.logical_not(step.too_far) & np.ones(len(self.length), dtype=bool)
        complete = accepted & (step.state.time == self._end(progress))
        return Decision(
            accepted,
            complete,
            replace(
                progress,
                steps=progress.steps + complete,
                iterations=progress.iterations + np.where(complete, iterations, 0),
                tried_iterations=np.where(complete, 0, iterations),
                begun=~complete & (accepted | progress.begun),
                interface=np.where(accepted, np.inf, step.interface),
            ),
        )

    def shorten(self, before: State, end: FloatArray, progress: Progress) -> Progress | None:
        """Return None: there is no other step."""
        return None

    def finished(self, state: State, progress: Progress) -> BoolArray:
        """Return which histories have made all of their steps."""
        return progress.steps >= self.steps


@dataclass(frozen=True)
class ErrorControl:
    """Steps whose estimated errors of wear, pressure and energy are within tolerances.

    The error of wear is that of the history: a step may make an error of the tolerance less the
    propagated error of the steps before it. Steps end at the times at which a schedule or a
    parameter bends, and while elements follow the wear they wear about the tolerance of the
    geometry at most.
    """

    #: (B,) s, of the histories
    end: FloatArray
    #: (B,) mm, and relative to the mean pressure
    wear_tolerance: FloatArray
    pressure_tolerance: FloatArray
    #: (B, m) s, times at which steps end, each history's last one repeated
    limits: FloatArray
    #: (B,) mm, most wear of a step of elements that follow it; infinite for others
    meshed_wear: FloatArray

    @classmethod
    def of(cls, cases: Sequence[Case], step_times: Sequence[Sequence[float]] | None) -> Self:
        """Return the control of some cases."""
        times = [case.time for case in cases]
        return cls(
            np.array([time.end for time in times], dtype=float),
            np.array([case.wear_tolerance for case in cases], dtype=float),
            np.array([time.pressure_tolerance for time in times], dtype=float),
            _padded([[*case.breakpoints, case.time.end] for case in cases]),
            np.array(
                [case.mesh.geometry_tolerance if case.follows_wear else np.inf for case in cases],
                dtype=float,
            ),
        )

    @cached_property
    def _tolerances(self) -> Tolerances:
        return Tolerances(self.end, self.wear_tolerance, self.pressure_tolerance, self.meshed_wear)

    def next_try(self, state: State, progress: Progress) -> tuple[FloatArray, Progress]:
        """Return the times to which the next steps are tried.

        Raises
        ------
        ComputationError : no step, however short, meets the tolerance.
        """
        end, cut, length = self._try(state, progress)
        if (stuck := _is_short(state.time, end)).any():
            if len(stuck) > 1:
                raise HistoriesError(stuck)
            if progress.interface[0] == end[0]:
                raise InterfaceError(f"{_UNREACHED}, {NO_STEP}")
            reason = (
                "the estimated error of the step is not a number"
                if progress.undefined[0]
                else f"errors exceed {self.wear_tolerance[0]:g} mm (time.tolerance; with layers "
                f"half of it) or time.pressure_tolerance = {self.pressure_tolerance[0]:g} (try "
                "larger tolerances)"
            )
            raise ComputationError(f"{reason}, {NO_STEP}")
        return end, replace(
            progress,
            length=length,
            cut=cut,
            begun=np.ones(len(end), dtype=bool),
            pressed=progress.pressed & progress.begun,
            tried_iterations=progress.tried_iterations * progress.begun,
        )

    def _try(self, state: State, progress: Progress) -> tuple[FloatArray, BoolArray, FloatArray]:
        """Return the end of the next try, whether a limit of time cuts it, and its length uncut."""
        limit = self.limits[:, 0]
        if self.limits.shape[1] > 1:
            ahead = self.limits > state.time[:, None]
            limit = np.take_along_axis(self.limits, ahead.argmax(axis=1)[:, None], axis=1)[:, 0]
        limit = np.ascontiguousarray(_until_interface(state, limit, progress))
        new, end = _new_tries(len(limit)), np.empty(len(limit))
        load(step_rows).choose_ends(
            *state.error.shape, state.time, limit, progress.begun, _tries_of(progress),
            self._tolerances, state.rates, new, end,
        )  # fmt: skip
        return end, new.are_cut, new.lengths

    def decide(self, before: State, step: Step, progress: Progress) -> Decision:
        """Accept steps within the tolerances; change the next one with the third root of its error.

        The errors to expect of the next step are those of a step of this length over the error that
        the next step is allowed. That of energy counts, too: schedules may change the power where
        nothing wears. What is no number counts as infinite.
        """
        state, count = step.state, len(self.end)
        iterations = progress.tried_iterations + state.contact.iterations
        too_far = _of_each(step.too_far, count)
        errors = StepErrors(
            step.wear_error,
            step.history_error,
            *(
                _of_each(values, count)
                for values in (
                    step.carried_error, step.energy_error, step.power, step.pressure_error,
                )
            ),
        )  # fmt: skip
        new, (accepted, undefined) = _new_tries(count), np.empty((2, count), dtype=bool)
        load(step_rows).judge_tries(
            *before.error.shape, before.error, before.time, state.time, state.energy, errors,
            self._tolerances, too_far, _tries_of(progress), accepted, undefined, new,
        )  # fmt: skip
        rejected = ~accepted
        next_step, shortest = _after_crossing(step, accepted, new.next_lengths, progress)
        return Decision(
            accepted,
            accepted,
            Progress(
                progress.steps + accepted,
                next_step,
                progress.rejected + rejected,
                progress.iterations + accepted * iterations,
                new.lengths,
                progress.cut,
                rejected,
                new.are_pressed,
                iterations,
                undefined,
                np.where(accepted | too_far, step.interface, progress.interface),
                shortest,
                step.history_error,
            ),
        )

    def shorten(self, before: State, end: FloatArray, progress: Progress) -> Progress | None:
        """Return the progress for a try of a quarter."""
        return replace(
            progress,
            length=_AFTER_FAILURE * (end - before.time),
            rejected=progress.rejected + 1,
        )

    def finished(self, state: State, progress: Progress) -> BoolArray:
        """Return which histories are at their end."""
        return state.time >= self.end


def _tries_of(progress: Progress) -> Tries:
    return Tries(progress.length, progress.next_step, progress.pressed, progress.cut)


def _new_tries(count: int) -> Tries:
    return Tries(*np.empty((2, count)), *np.empty((2, count), dtype=bool))


def _after_crossing(
    step: Step, accepted: BoolArray, next_step: FloatArray, progress: Progress
) -> tuple[FloatArray, FloatArray]:
    """Return the next steps and the shortest ones, s, shortened where an element has crossed.

    Rates have jumped then, as they did at the crossing before, after which steps were short.
    """
    shortest = np.where(accepted, np.minimum(progress.shortest, next_step), progress.shortest)
    crossed = accepted & step.crossed
    if not crossed.any():
        return next_step, shortest
    return (
        np.where(crossed, np.minimum(next_step, _AFTER_CROSSING * shortest), next_step),
        np.where(crossed, np.inf, shortest),
    )


def _until_interface(state: State, end: FloatArray, progress: Progress) -> FloatArray:
    """Return ends of steps, s, or when an element is at the end of its layer, if it is before."""
    interface = progress.interface
    if interface.min() == np.inf:
        return end
    within = (state.time < interface) & (interface < end) & ~_is_short(interface, end)
    return np.where(within, interface, end)


def _is_short(time: FloatArray, end: FloatArray) -> BoolArray:
    """Return which steps are as short as the round-off of their times."""
    return end - time <= 4.0 * np.spacing(time)


def _of_each(values: Any, count: int) -> Any:
    """Return values of histories, (B,), from these or from one of all."""
    return values if isinstance(values, np.ndarray) else np.full(count, values)
