"""How far the next step goes, and whether it is taken: fixed steps, or steps held to a tolerance.

A control remembers what it needs between two steps, and gives it as ``Progress``, from which an
interrupted history goes on. Another control is a class with the same four methods.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    Numbers,
    chosen,
    larger,
    relative,
    smaller,
)
from ringwear_par.cases.case import Case, Stepping
from ringwear_par.errors import ComputationError, HistoriesError, LawError
from ringwear_par.history.schemes import Step
from ringwear_par.history.state import Progress, State
from ringwear_par.parallel import as_on_first_rank

_SAFETY, _LARGEST_GROWTH, _LARGEST_CUT = 0.82, 5.0, 0.1
#: share of the tolerance that a step may miss whatever the history before it has missed
_LEAST_ALLOWED = 0.05
#: wear of the first step, in tolerances: edges wear fast and not for long
_FIRST_WEAR = 50.0
#: largest error of the dissipated energy of one step, relative to that of the whole history as it
#: would be if the power stayed
_ENERGY_TOLERANCE = 1e-4
_NO_NUMBER = "the estimated error of the step is not a number"


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
    comm : of the history; ranks need not agree, as they have nothing to decide.
    """

    def __init__(self, case: Case, progress: Progress, comm: MPI.Comm) -> None:
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


class GivenSteps(FixedSteps):
    """Steps to given times; what they miss is told, not held.

    Parameters
    ----------
    times : s, increasing; the last one is the end of the case.
    case, progress, comm : as of ``FixedSteps``.
    """

    def __init__(
        self, times: Sequence[float], case: Case, progress: Progress, comm: MPI.Comm
    ) -> None:
        super().__init__(case, progress, comm)
        self._times = step_times_of(times, case)

    def end(self, state: State) -> float:
        """Return the time of the next step's end, s."""
        return self._times[self.progress.steps]


def step_times_of(times: Sequence[float], case: Case) -> list[float]:
    """Return the ends of steps of a case as numbers.

    Raises
    ------
    ValueError : they do not increase to its end, or there are more or less than fixed ones.
    """
    given = [float(time) for time in times]
    if not given or given[-1] != case.time.end or not np.all(np.diff([0.0, *given]) > 0.0):
        raise ValueError(f"step_times: must increase from 0 to {case.time.end:g} s")
    if not case.time.adaptive and len(given) != case.time.steps:
        raise ValueError(f"step_times: must be {case.time.steps} of them")
    return given


class ErrorControl:
    """Steps whose estimated errors of wear, pressure and energy are within tolerances.

    The error of wear is that of the history: a step may miss what the error that is left of the
    steps before it leaves of the tolerance. Steps end at the times at which a schedule or a
    parameter bends, and while elements follow the wear they wear about the tolerance of the
    geometry at most.

    Parameters
    ----------
    case : its ``time.end``, ``time.tolerance`` (mm), ``time.pressure_tolerance`` and breakpoints.
    progress : from where on.
    comm : of the history. What steps are, and whether they are taken, rank 0 decides: others may
        differ by round-off, or by their processor.
    """

    def __init__(self, case: Case, progress: Progress, comm: MPI.Comm) -> None:
        self._case, self.progress, self._comm = case, progress, comm
        self._from: State | None = None  # the state that the present tries start from
        self._length = self._end = 0.0
        self._cut = False
        self._iterations, self._failure = 0, ""
        self._pressed = False  # whether a try of the present step failed by its pressure

    def end(self, state: State) -> float:
        """Return the time to which the next step is tried, s. Collective.

        Raises
        ------
        ComputationError : no step, however small, meets the tolerance.
        """
        time = self._case.time
        limit = next((t for t in self._case.breakpoints if t > state.time), time.end)
        if self._from is None:
            self._iterations, self._failure, self._pressed = 0, "", False
            self._length = self.progress.next_step or _first_length(time, state.rates.max())
            if self._case.follows_wear:
                self._length = min(self._length, _longest_length(self._case, state))
        self._from = state
        self._length = as_on_first_rank(self._comm, self._length)
        self._end, self._cut = _end(state.time, self._length, limit)
        if _vanishes(state.time, self._end):
            why = self._failure or (
                f"errors exceed time.tolerance = {time.tolerance:g} mm or time.pressure_tolerance "
                f"= {time.pressure_tolerance:g} (larger ones may be met)"
            )
            raise ComputationError(
                f"{why}, however short the step: the last one would be "
                f"{self._end - state.time:.3g} s"
            )
        return self._end

    def failed(self, error: ComputationError) -> None:
        """Try a quarter of the step; a law that fails will fail in any."""
        if isinstance(error, LawError) or self._from is None:
            raise error
        self._failure = str(error)
        self._length = 0.25 * (self._end - self._from.time)
        self.progress = replace(self.progress, rejected=self.progress.rejected + 1)

    def accepts(self, step: Step) -> bool:
        """Take a step within the tolerances; change the next one with the third root of its error.

        The energy is held too: schedules may change it where nothing wears. Collective.
        """
        assert self._from is not None
        made, time = self.progress, self._case.time
        length = self._end - self._from.time
        self._iterations += step.state.contact.iterations
        before, tolerances = _largest(self._from), (time.tolerance, time.pressure_tolerance)
        ratio, pressed, ahead = as_on_first_rank(
            self._comm, _ratios(step, before, time.end, *tolerances)
        )
        self._pressed |= pressed
        if ratio > 1.0:
            self._failure = _NO_NUMBER if ratio == np.inf else ""
            self._length = length * _change(ratio)
            self.progress = replace(made, rejected=made.rejected + 1)
            return False
        self.progress = replace(
            made,
            steps=made.steps + 1,
            next_step=_following(length, _change(ahead), self._pressed, self._cut, self._length),
            iterations=made.iterations + self._iterations,
        )
        self._from = None
        return True


# -- formulas of error control, of one history or of B ---------------------------------------------


def _first_length(time: Stepping, fastest: float) -> float:
    """Return the length of the first step, s, the fastest element wearing so much, mm/s."""
    return min(time.end, _FIRST_WEAR * time.tolerance / fastest) if fastest > 0.0 else time.end


def _longest_length(case: Case, state: State) -> float:
    """Return the length in which wear stays about the tolerance of the geometry, s."""
    fastest = float(state.rates.max())
    return case.mesh.geometry_tolerance / fastest if fastest > 0.0 else np.inf


def _end(time: Numbers, length: Numbers, limit: Numbers) -> tuple[Numbers, Any]:
    """Return to where a step of a length goes, s, and whether a limit of time cuts it."""
    left = limit - time
    cut = length >= left * (1.0 - 1e-9)
    whole = (length < 0.5 * left) | (length > 0.9 * left)  # no sliver at the end
    return chosen(cut, limit, time + chosen(whole, length, 0.5 * left)), cut


def _vanishes(time: Numbers, end: Numbers) -> Any:
    """Tell whether a step is no more than round-off of time."""
    return end - time <= 4.0 * np.spacing(time)


def _ratios(
    step: Step, before: Numbers, last: Numbers, wear: Numbers, pressure: Numbers
) -> tuple[Numbers, Any, Numbers]:
    """Return the errors of a step over what they may be, and what there is to say of the next one.

    That is whether the error of pressure was too large, and the errors of a step like this one over
    what the next may miss. What is no number counts as infinite.

    Parameters
    ----------
    before : mm, largest error of the history at the start of the step.
    last : s, end of the history.
    wear, pressure : tolerances, mm and relative.
    """
    state = step.state
    whole = state.energy + step.power * (last - state.time)
    energy = larger(relative(step.energy_error, _ENERGY_TOLERANCE * whole), 1e-6)
    ratio = larger(energy, step.wear_error / _allowed(wear, step.carried_error))
    # the next step is to leave as much of the error before it as this one does
    decay = relative(before - step.carried_error, before)
    left = step.history_error * smaller(1.0 - decay, 1.0)
    ahead = larger(energy, step.wear_error / _allowed(wear, left))
    over = _or_infinite(step.pressure_error / pressure)
    pressed = over > 1.0
    return chosen(pressed, larger(ratio, over), _or_infinite(ratio)), pressed, _or_infinite(ahead)


def _allowed(tolerance: Numbers, missed: Numbers) -> Numbers:
    """Return what a step may miss, mm, where the history before it has missed so much."""
    return larger(tolerance - missed, _LEAST_ALLOWED * tolerance)


def _or_infinite(ratio: Numbers) -> Numbers:
    """Return ratios, infinite ones for those that are no numbers."""
    return chosen(ratio == ratio, ratio, np.inf)


def _largest(state: State) -> Numbers:
    """Return the largest error of the history up to a state, mm, a number or (B,)."""
    return np.abs(state.error).max(axis=-1)


def _change(ratio: Numbers) -> Numbers:
    """Return by which factor the length is to change: the third root of the error, with care."""
    return larger(_SAFETY * ratio ** (-1.0 / 3.0), _LARGEST_CUT)


def _following(length: Numbers, change: Numbers, pressed: Any, cut: Any, asked: Numbers) -> Numbers:
    """Return the length of the next step, s; ``asked`` is what this one was to be before a cut."""
    # errors of pressure come and go with elements: they limit steps, but do not foretell them
    following = length * smaller(change, chosen(pressed, 1.0, _LARGEST_GROWTH))
    return chosen(cut, larger(following, asked), following)


# -- of B histories --------------------------------------------------------------------------------


class FixedBatch:
    """Steps of one length of each of B histories.

    Parameters
    ----------
    cases : their ``time.step`` and ``time.steps``.
    """

    def __init__(self, cases: Sequence[Case]) -> None:
        self._length = np.array([case.time.step for case in cases])
        self._steps = np.array([case.time.steps for case in cases])
        self.progress = Progress.of_many(len(cases))

    def end(self, state: State) -> FloatArray:
        """Return the times of the next multiples of the steps, (B,) s."""
        return (self.progress.steps + 1) * self._length

    def accepts(self, step: Step) -> BoolArray:
        """Take every step."""
        made = self.progress
        iterations = made.iterations + step.state.contact.iterations
        self.progress = replace(made, steps=made.steps + 1, iterations=iterations)
        return np.ones(len(self._length), dtype=bool)

    def finished(self, state: State) -> BoolArray:
        """Tell which histories are at their end."""
        return self.progress.steps >= self._steps

    def take(self, histories: IntArray) -> Self:
        """Return the control of some of the histories."""
        return _taken(self, histories)


class GivenBatch(FixedBatch):
    """Steps of each of B histories to given times.

    Parameters
    ----------
    cases : their ends.
    times : of each, see ``GivenSteps``.
    """

    def __init__(self, cases: Sequence[Case], times: Sequence[Sequence[float]]) -> None:
        super().__init__(cases)
        given = [step_times_of(*each) for each in zip(times, cases, strict=True)]
        self._steps = np.array(list(map(len, given)))
        most = self._steps.max()
        #: (B, m) s, each history's last one repeated
        self._ends = np.array([each + each[-1:] * (most - len(each)) for each in given])

    def end(self, state: State) -> FloatArray:
        """Return the times of the next steps' ends, (B,) s."""
        return self._ends[np.arange(len(self._ends)), self.progress.steps]


class ErrorBatch:
    """Steps of each of B histories as ``ErrorControl`` makes them.

    Parameters
    ----------
    cases : their ``time`` and breakpoints.
    """

    def __init__(self, cases: Sequence[Case]) -> None:
        times, count = [case.time for case in cases], len(cases)
        self._last = np.array([time.end for time in times])
        self._wear = np.array([time.tolerance for time in times])
        self._pressure = np.array([time.pressure_tolerance for time in times])
        limits = [[*case.breakpoints, case.time.end] for case in cases]
        most = max(map(len, limits))
        #: (B, m) s, where steps end, each history's last one repeated
        self._limits = np.array([each + each[-1:] * (most - len(each)) for each in limits])
        self.progress = Progress.of_many(count)
        #: (B,) whether the next try is the first of its step
        self._fresh = np.ones(count, dtype=bool)
        self._pressed = np.zeros(count, dtype=bool)
        self._iterations = np.zeros(count, dtype=np.int64)
        self._length, self._start = np.zeros(count), np.zeros(count)
        #: (B,) mm, largest errors of the histories at the start of their steps
        self._error = np.zeros(count)
        self._cut = np.zeros(count, dtype=bool)

    def end(self, state: State) -> FloatArray:
        """Return the times to which the next steps are tried, (B,) s.

        Raises
        ------
        HistoriesError : some meet their tolerance with no step, however small.
        """
        limit = self._limits[:, 0]
        if self._limits.shape[1] > 1:
            ahead = self._limits > state.time[:, None]
            limit = np.take_along_axis(self._limits, ahead.argmax(axis=1)[:, None], axis=1)[:, 0]
        fresh, wanted = self._fresh, self.progress.next_step
        if (new := fresh & (wanted == 0.0)).any():
            fastest = state.rates.max(axis=(0, 2))
            worn = np.divide(
                _FIRST_WEAR * self._wear, fastest, out=self._last.copy(), where=fastest > 0.0
            )
            wanted = np.where(new, np.minimum(self._last, worn), wanted)
        self._length = np.where(fresh, wanted, self._length)
        self._pressed = self._pressed & ~fresh
        self._iterations = np.where(fresh, 0, self._iterations)
        self._start, self._error = state.time, _largest(state)
        end, self._cut = _end(state.time, self._length, limit)
        if (stuck := _vanishes(state.time, end)).any():
            raise HistoriesError(stuck)
        return end

    def accepts(self, step: Step) -> BoolArray:
        """Tell which steps are taken, those within the tolerances; others are tried again."""
        made, length = self.progress, step.state.time - self._start
        self._iterations = self._iterations + step.state.contact.iterations
        ratio, pressed, ahead = _ratios(step, self._error, self._last, self._wear, self._pressure)
        self._pressed = self._pressed | pressed
        taken = ratio <= 1.0
        following = _following(length, _change(ahead), self._pressed, self._cut, self._length)
        self.progress = Progress(
            made.steps + taken,
            np.where(taken, following, made.next_step),
            made.rejected + ~taken,
            made.iterations + np.where(taken, self._iterations, 0),
        )
        self._length = np.where(taken, self._length, length * _change(ratio))
        self._fresh = taken
        return taken

    def finished(self, state: State) -> BoolArray:
        """Tell which histories are at their end."""
        return state.time >= self._last

    def take(self, histories: IntArray) -> Self:
        """Return the control of some of the histories."""
        return _taken(self, histories)


C = TypeVar("C")


def joined(one: C, other: C) -> C:
    """Return one control of the histories of two."""
    both = copy.copy(one)
    for name, value in vars(one).items():
        more = getattr(other, name)
        if name == "progress":
            setattr(both, name, value.joined(more))
            continue
        if value.ndim > 1:  # the last limits are repeated
            most = max(value.shape[1], more.shape[1])
            value, more = (
                np.pad(v, ((0, 0), (0, most - v.shape[1])), mode="edge") for v in (value, more)
            )
        setattr(both, name, np.concatenate([value, more]))
    return both


def _taken(control: C, histories: IntArray) -> C:
    """Return a control of B histories for some of them."""
    taken = copy.copy(control)
    for name, value in vars(control).items():
        setattr(taken, name, value.take(histories) if name == "progress" else value[histories])
    return taken
