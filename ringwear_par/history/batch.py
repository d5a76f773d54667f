"""Histories that step together."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringwear_par import batched
from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.contact.problem import WarmStart
from ringwear_par.errors import (
    ComputationError,
    HistoriesError,
    InputError,
    InterfaceError,
    LawError,
    RingwearError,
    UnfitError,
    reason_of,
)
from ringwear_par.history.ensemble import Ensemble, Present
from ringwear_par.history.schemes.interfaces import next_to_cross
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.state import State
from ringwear_par.history.step_control import NO_STEP
from ringwear_par.history.stop_criteria import have_reached
from ringwear_par.parallel import as_on_first_rank, together

log = logging.getLogger(__name__)


class Batch:
    """Histories that step together.

    Parameters
    ----------
    ensemble : of all cases.
    numbers : (B,) int, the histories of this batch.
    """

    def __init__(self, ensemble: Ensemble, numbers: IntArray) -> None:
        self._ensemble, self.numbers = ensemble, numbers
        #: None before the start
        self._present: Present | None = None
        #: (B,) s, end of the present try, and from where contacts were solved in it, put back if it
        #: fails; None: there is no try
        self._end: FloatArray | None = None
        self._warm: WarmStart | None = None
        #: of a single history, why its last try failed
        self._failure = ""

    def advance(self) -> list["Batch"]:
        """Make a round; return the batches that go on. Collective.

        Histories in trouble leave, and go on alone: each tries a shorter step, or says why not.
        """
        before, self._warm = self._present, None
        try:
            snapshots = self._start() if before is None else self._round(before)
        except Exception as error:
            if isinstance(error, InputError) and not isinstance(error, UnfitError):
                raise  # an option for PETSc
            if self._present is not None and self._warm is not None:
                self._present.contacts.warm = self._warm
            return self._after_failure(error)
        if not snapshots:
            return [self]
        self._ensemble.show([snapshot for snapshot in snapshots if snapshot.accepted.any()])
        if snapshots[-1].accepted.all():
            self._failure = ""
        ended = snapshots[-1].finished
        if ended.all():
            self.close()
            return []
        if ended.any():
            assert self._present is not None
            del before, snapshots  # states of all of them, which would be there beside the rest
            rest = np.flatnonzero(~ended)
            self.numbers, self._present = self.numbers[rest], self._present.keep(rest)
        return [self]

    def close(self) -> None:
        """Free the contacts."""
        if self._present is not None:
            self._present.contacts.close()

    # -- the start ---------------------------------------------------------------------------------

    def _start(self) -> list[Snapshot]:
        """Return the states at the start, unless the history continues. Collective."""
        numbers, present = self.numbers, self._ensemble.begin(self.numbers)
        self._present = present
        if self._ensemble.start is not None:
            return []
        state = present.state
        every = np.ones(len(numbers), dtype=bool)
        return [
            Snapshot(
                numbers, present.physics, present.contacts, state, None, present.progress,
                state.contact.iterations, every, every, ~every,
            )
        ]  # fmt: skip

    # -- a round -----------------------------------------------------------------------------------

    def _round(self, before: Present) -> list[Snapshot]:
        """Return the states that a try of each history leads to, states within it first."""
        ensemble, self._end = self._ensemble, None
        if before.geometry is not None:
            physics, contacts, state = before.geometry.follow(
                before.physics, before.contacts, before.state
            )
            before = self._present = replace(
                before, physics=physics, contacts=contacts, state=state
            )
        pace = ensemble.pace(self.numbers, before.progress.steps)
        if pace is not None:
            physics, state = before.physics.at_pace(pace), before.state
            with together(ensemble.comm):
                rates = physics.rates_at(state.time, state.wear, state.contact.pressure)
            before = replace(before, physics=physics, state=replace(state, rates=rates))
        control, physics, contacts = before.control, before.physics, before.contacts
        self._warm = contacts.warm
        end, progress = as_on_first_rank(
            ensemble.comm, control.next_try(before.state, before.progress)
        )
        self._end, self._present = end, replace(before, progress=progress)
        with together(ensemble.comm):  # a law may raise on one rank alone
            step = ensemble.method.scheme(physics, contacts, before.state, end)
        # ranks may differ by round-off, or by their processor: the first decides
        decision = as_on_first_rank(ensemble.comm, control.decide(before.state, step, progress))
        accepted, progress = decision.accepted, decision.progress
        with together(ensemble.comm):
            snapshots = self._within(before, end, accepted)
        state = step.state
        if not accepted.all():
            state = batched.where(accepted, state, _with_entries_of(before.state, state))
        self._present = replace(before, state=state, progress=progress)
        new = accepted & decision.complete
        stopped = have_reached(physics.inputs.stop_limits, state)
        finished = new & (control.finished(state, progress) | stopped)
        return [
            *snapshots,
            Snapshot(
                self.numbers, physics, contacts, state, step, progress,
                progress.iterations - before.progress.iterations, new,
                new & (finished | physics.inputs.stored.at(progress.steps, state.time)), finished,
            ),
        ]  # fmt: skip

    def _within(self, before: Present, end: FloatArray, accepted: BoolArray) -> list[Snapshot]:
        """Return the states at times of output within accepted steps, which leave no trace."""
        stored = before.physics.inputs.stored
        if stored.times is None:
            return []
        histories, which = np.nonzero(stored.within(before.state.time, end) & accepted[:, None])
        times = stored.times[histories, which]
        # the first of each history, then the second ones
        turn = np.arange(len(histories)) - np.searchsorted(histories, histories)
        return [
            self._at_times(before, histories[turn == k], times[turn == k])
            for k in range(turn.max(initial=-1) + 1)
        ]

    def _at_times(self, before: Present, histories: IntArray, times: FloatArray) -> Snapshot:
        """Return the states of some histories at times within their steps."""
        part = before.take(histories)
        try:
            step = self._ensemble.method.within(part.physics, part.contacts, part.state, times)
        except HistoriesError as error:
            which = np.zeros(len(self.numbers), dtype=bool)
            which[histories[error.which]] = True
            raise HistoriesError(which) from error
        finally:
            part.contacts.close()
        every = np.ones(len(histories), dtype=bool)
        progress = replace(part.progress, steps=part.progress.steps + 1)
        return Snapshot(
            self.numbers[histories], part.physics, part.contacts, step.state, step, progress,
            step.state.contact.iterations, every, every, ~every, passing=True,
        )  # fmt: skip

    # -- failures ----------------------------------------------------------------------------------

    def _after_failure(self, error: Exception) -> list["Batch"]:
        """Return the batches that go on after a round that failed."""
        if len(self.numbers) > 1:
            return self._parted(error)
        if self._tries_shorter(error):
            return [self]
        self._ensemble.failures[int(self.numbers[0])] = self._named(error)
        self.close()
        return []

    def _parted(self, error: Exception) -> list["Batch"]:
        """Return batches that go on, histories in trouble apart, as far as it is known which."""
        count = len(self.numbers)
        if isinstance(error, HistoriesError):
            parts = [np.flatnonzero(~error.which), *np.flatnonzero(error.which)[:, None]]
        else:  # whatever a user's law may raise, nobody knows for whom
            expected = isinstance(error, RingwearError)
            log.log(
                logging.DEBUG if expected else logging.WARNING,
                "%d histories cannot step together (%s)", count, reason_of(error),
                exc_info=error if expected else None,
            )  # fmt: skip
            parts = list(np.array_split(np.arange(count), 2))
        return self._split(parts)

    def _tries_shorter(self, error: Exception) -> bool:
        """Tell whether a single history tries a shorter step after an error, and prepare it."""
        passed, present = LawError | InputError | HistoriesError, self._present
        if not isinstance(error, ComputationError) or isinstance(error, passed):
            return False
        if present is None or self._end is None:  # there was no try
            return False
        progress = present.control.shorten(present.state, self._end, present.progress)
        if progress is None:
            return False
        self._present, self._end = replace(present, progress=progress), None
        self._failure = str(error)
        return True

    def _named(self, error: Exception) -> Exception:
        """Return the error of a single history with its step and time."""
        present = self._present
        if present is None or not isinstance(error, ComputationError):
            return error
        state = present.state
        why = f"{self._failure}, {NO_STEP}" if self._failure else str(error)
        if isinstance(error, InterfaceError):
            why += f": {next_to_cross(present.physics, state)}"
        named = type(error)(
            f"{why}; in step {int(present.progress.steps[0]) + 1}, from time {state.time[0]:g} s"
        )
        named.__cause__ = error
        return named

    def _split(self, parts: Sequence[IntArray]) -> list["Batch"]:
        """Return batches of some of the histories each; this one ends."""
        batches = []
        for part in parts:
            if len(part):
                batch = Batch(self._ensemble, self.numbers[part])
                batch._present = None if self._present is None else self._present.take(part)
                batches.append(batch)
        self.close()
        return batches


def _with_entries_of(other: State, state: State) -> State:
    """Return ``other`` with an entry wherever ``state`` has one."""
    if other.gap_offset is None and state.gap_offset is not None:
        return replace(other, gap_offset=np.zeros_like(state.gap_offset))
    return other
