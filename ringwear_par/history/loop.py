"""The time loop, section 3 of the paper, of B >= 1 histories on one contact pair.

``pressure[n]``, ``approach[n]``... are the contact solution with the profile worn up to
``time[n]``, for every scheme.

Each round every history of a batch tries a step as long as its control says. One whose try is
rejected tries again with the others' next step, and one that has ended leaves its place to another
case. Digits of a history do not depend on the others. One whose step cannot be made steps alone
until it has made it, or fails with the reason.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par import batched
from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.forecast import unit_question
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import (
    ComputationError,
    HistoriesError,
    InputError,
    LawError,
    RingwearError,
    UnfitError,
    reason_of,
)
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.moving_geometry import MovingGeometry
from ringwear_par.history.physics import Physics
from ringwear_par.history.saving import stores, times_within
from ringwear_par.history.schemes import euler, sdirk2
from ringwear_par.history.schemes.step import Scheme
from ringwear_par.history.snapshots import Observer, Snapshot
from ringwear_par.history.start import initial_state
from ringwear_par.history.state import Progress, Start, State
from ringwear_par.history.step_control import (
    NO_STEP,
    Control,
    ErrorControl,
    FixedSteps,
    step_times_of,
)
from ringwear_par.parallel import as_on_first_rank, together

log = logging.getLogger(__name__)


class Method(NamedTuple):
    """A ``time.scheme``: how a step is made, and how its length is controlled."""

    scheme: Scheme
    control: type[FixedSteps] | type[ErrorControl]


#: by the name of ``time.scheme``
METHODS: dict[str, Method] = {
    "explicit": Method(euler.forward, FixedSteps),
    "implicit": Method(euler.backward, FixedSteps),
    "adaptive": Method(sdirk2.step, ErrorControl),
}


class Outcome(NamedTuple):
    """How histories ended.

    Parameters
    ----------
    failures : why, of those that failed, by number.
    stopped : whether an observer stopped all.
    """

    failures: dict[int, Exception]
    stopped: bool


def simulate(
    cases: Sequence[Case],
    comm: MPI.Comm,
    *,
    pair: ContactPair | None = None,
    start: Start | None = None,
    observers: Sequence[Observer] = (),
    most: int | None = None,
    derivatives: Sequence[str] = (),
    step_times: Sequence[Sequence[float]] | None = None,
) -> Outcome:
    """Step wear histories from their starts to their ends, or until an observer says stop.

    Collective on comm.

    Parameters
    ----------
    cases : one, or several of one ``lockstep.batch_key``.
    comm : communicator; histories are the same on all ranks.
    pair : contact pair of the cases; None: assembled first.
    start : where an interrupted history continues, of one case.
    observers : called with all new states, in this order.
    most : histories that step at a time; as they end others take their places. None: all.
    derivatives : keys that states have derivatives with respect to; not of one that continues.
    step_times : s, ends of the steps of each history, its last one that of its case; None: each
        steps as its case says.

    Raises
    ------
    ValueError : steps that are given do not increase to the ends of the cases, or a history
        continues with derivatives.
    """
    if start is not None and derivatives:
        raise ValueError("a history that continues has no derivatives: they are not stored")
    for times, case in () if step_times is None else zip(step_times, cases, strict=True):
        step_times_of(times, case)
    run = _Run(cases, comm, pair, start, observers, tuple(derivatives), step_times)
    batches: list[_Batch] = []
    begun, most = 0, most or len(cases)
    try:
        while (batches or begun < len(cases)) and not run.stopped:
            stepping = sum(len(batch.numbers) for batch in batches)
            if begun < len(cases) and 2 * stepping <= most:
                count = min(most - stepping, len(cases) - begun)
                batches.append(_Batch(run, np.arange(begun, begun + count)))
                begun += count
            if len(batches) > 1 and all(batch.may_join for batch in batches[-2:]):
                batches[-2:] = [batches[-2].joined(batches[-1])]
            batches += batches.pop().advanced()
    finally:
        for batch in batches:
            batch.close()
    return Outcome(run.failures, run.stopped)


def simulate_one(
    case: Case,
    comm: MPI.Comm,
    *,
    pair: ContactPair | None = None,
    start: Start | None = None,
    observers: Sequence[Observer] = (),
    derivatives: Sequence[str] = (),
    step_times: Sequence[float] | None = None,
) -> None:
    """Step one wear history, see ``simulate``. Collective on comm.

    Raises
    ------
    ComputationError : a step could not be made; it is named with its time.
    UnfitError : the case's own numbers do not go together, as its first contact shows.
    """
    outcome = simulate(
        [case], comm, pair=pair, start=start, observers=observers, derivatives=derivatives,
        step_times=None if step_times is None else [step_times],
    )  # fmt: skip
    for error in outcome.failures.values():
        raise error


class _Run:
    """All cases, and how their histories ended so far."""

    def __init__(
        self,
        cases: Sequence[Case],
        comm: MPI.Comm,
        pair: ContactPair | None,
        start: Start | None,
        observers: Sequence[Observer],
        derivatives: tuple[str, ...],
        step_times: Sequence[Sequence[float]] | None,
    ) -> None:
        self.cases, self.comm, self.pair, self.start = cases, comm, pair, start
        self.derivatives, self.step_times = derivatives, step_times
        self._observers = observers
        self.method = METHODS[cases[0].time.scheme]
        self.failures: dict[int, Exception] = {}
        self.stopped = False

    def control(self, numbers: IntArray) -> Control:
        """Return the control of some histories."""
        cases = [self.cases[i] for i in numbers.tolist()]
        if self.step_times is None:
            return self.method.control.of(cases, None)
        return FixedSteps.of(cases, [self.step_times[i] for i in numbers.tolist()])

    def show(self, snapshots: Sequence[Snapshot]) -> None:
        """Show new states to the observers."""
        for snapshot in snapshots:
            for observer in self._observers:
                self.stopped |= bool(observer(snapshot))


class _Batch:
    """Histories that step together.

    Parameters
    ----------
    run : of all cases.
    numbers : (B,) int, the histories of this batch.
    """

    def __init__(self, run: _Run, numbers: IntArray) -> None:
        self._run, self.numbers = run, numbers
        self._begun = False
        self._control: Control
        self._physics: Physics
        self._contacts: CorrectedContacts
        #: of elements that follow the wear; None where they stay
        self._geometry: MovingGeometry | None = None
        self._state: State
        self._progress: Progress
        #: (B,) s, end of the present try; None: there is none
        self._tried: FloatArray | None = None
        #: whether a history steps alone until it has made a step, and why its last try failed
        self._alone, self._failure = False, ""

    @property
    def may_join(self) -> bool:
        """Whether the histories may step with others."""
        return self._begun and not self._alone

    def advanced(self) -> list["_Batch"]:
        """Return the batches that go on after a round. Collective.

        Histories in trouble leave: alone, each says why, and tries a shorter step if there is one.
        """
        count = len(self.numbers)
        warm = self._contacts.warm if self._begun else None
        try:
            snapshots = self._round() if self._begun else self._start()
        except Exception as error:
            if isinstance(error, InputError) and not isinstance(error, UnfitError):
                raise  # an option for PETSc
            if warm is not None:  # a state that was not found is no place to start from
                self._contacts.warm = warm
            if count > 1:
                return self._parted(error)
            if self._retries(error):
                return [self]
            self._run.failures[int(self.numbers[0])] = self._named(error)
            self.close()
            return []
        if not snapshots:
            return [self]
        if snapshots[-1].accepted.any():
            self._run.show(snapshots)
        if self._alone and snapshots[-1].accepted.all():
            self._alone, self._failure = False, ""
        ended = snapshots[-1].finished
        if not ended.any():
            return [self]
        return self._split([np.flatnonzero(~ended)])

    def _parted(self, error: Exception) -> list["_Batch"]:
        """Return those that go on together, and those in trouble, as far as it is known which."""
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
        batches = self._split(parts)
        for batch in batches:
            batch._alone = len(batch.numbers) == 1 or not isinstance(error, HistoriesError)
        return batches

    def _retries(self, error: Exception) -> bool:
        """Tell whether a single history tries a shorter step after an error."""
        passed = LawError | InputError | HistoriesError
        if not self._begun or not isinstance(error, ComputationError) or isinstance(error, passed):
            return False
        if self._tried is None:  # there was no try
            return False
        progress = self._control.shorten(self._state, self._tried, self._progress)
        if progress is None:
            return False
        self._progress, self._alone, self._failure = progress, True, str(error)
        self._tried = None
        return True

    def _named(self, error: Exception) -> Exception:
        """Return the error of a single history with its step and time."""
        if not self._begun or not isinstance(error, ComputationError):
            return error
        case, state = self._run.cases[int(self.numbers[0])], self._state
        why = f"{self._failure}, {NO_STEP}" if self._failure else str(error)
        wear = state.wear[:, 0]
        named = type(error)(
            f"{why}{unit_question(case, wear)}; in step {int(self._progress.steps[0]) + 1}, "
            f"from time {state.time[0]:g} s"
        )
        named.__cause__ = error
        return named

    def _start(self) -> list[Snapshot]:
        run, numbers = self._run, self.numbers
        cases = [run.cases[i] for i in numbers.tolist()]
        self._control = run.control(numbers)
        self._physics = self._assembled(cases)
        self._contacts = self._physics.contacts()
        self._every = np.array([case.output.every for case in cases])
        every = np.ones(len(numbers), dtype=bool)
        try:
            if run.start is not None:
                self._resume(run.start)
            else:
                with together(run.comm):
                    self._state = initial_state(self._physics, self._contacts)
                self._progress = Progress.at_start(len(numbers))
        except BaseException:
            self._contacts.close()
            raise
        self._begun = True
        if run.start is not None:
            return []
        return [
            Snapshot(
                numbers, self._physics, self._contacts, self._state, None, self._progress,
                self._state.contact.iterations, every, every, ~every,
            )
        ]  # fmt: skip

    def _assembled(self, cases: Sequence[Case]) -> Physics:
        """Return the physics of the cases before any wear. Collective."""
        run, pair = self._run, self._run.pair
        if cases[0].follows_wear:
            self._geometry = MovingGeometry(cases[0], run.comm)
        if pair is None:
            geometry = self._geometry
            pair = assemble(cases[0], run.comm) if geometry is None else geometry.unworn()
        physics = Physics.of(cases, pair, derivatives=run.derivatives)
        return replace(physics, pair_is_shared=run.pair is not None)

    def _resume(self, start: Start) -> None:
        """Continue a stored history as if its state had just been computed. Collective."""
        state = self._state = start.state
        self._progress = start.progress
        if self._geometry is not None and state.meshed_wear is not None:
            self._physics, self._contacts = self._geometry.remesh_to(
                state.meshed_wear, self._physics, self._contacts
            )
        self._physics = replace(self._physics, gap_offset=state.gap_offset, updates=start.updates)
        self._contacts.warm = start.warm

    def _round(self) -> list[Snapshot]:
        """Return the states that a try of each history leads to, states within it first."""
        run, control = self._run, self._control
        self._tried = None
        if self._geometry is not None:
            self._physics, self._contacts, self._state = self._geometry.follow(
                self._physics, self._contacts, self._state
            )
        physics, contacts, state = self._physics, self._contacts, self._state
        before = self._progress
        end, progress = as_on_first_rank(run.comm, control.next_try(state, before))
        self._progress, self._tried = progress, end
        with together(run.comm):  # a law may raise on one rank alone
            step = run.method.scheme(physics, contacts, state, end)
        # ranks may differ by round-off, or by their processor: the first decides
        decision = as_on_first_rank(run.comm, control.decide(state, step, progress))
        with together(run.comm):
            snapshots = self._within(state, end, decision.accepted, decision.progress)
        self._progress, accepted = decision.progress, decision.accepted
        if accepted.all():
            self._state = step.state
        else:
            self._state = batched.where(accepted, step.state, _like(state, step.state))
        finished = accepted & control.finished(self._state, self._progress)
        return [
            *snapshots,
            Snapshot(
                self.numbers, physics, contacts, self._state, step, self._progress,
                self._progress.iterations - before.iterations, accepted,
                self._stored(accepted, finished), finished,
            ),
        ]  # fmt: skip

    def _stored(self, accepted: BoolArray, finished: BoolArray) -> BoolArray:
        """Return which of the new states are stored."""
        cases, steps = self._physics.inputs.cases, self._progress.steps
        if cases[0].output.times:
            rows = zip(cases, steps.tolist(), self._state.time.tolist(), strict=True)
            return accepted & np.array([stores(*row) for row in rows])
        return accepted & (finished | (steps % self._every == 0))

    def _within(
        self, before: State, end: FloatArray, accepted: BoolArray, progress: Progress
    ) -> list[Snapshot]:
        """Return the states at times of output within accepted steps, which leave no trace."""
        cases = self._physics.inputs.cases
        if not cases[0].output.times:
            return []
        rows = zip(cases, before.time.tolist(), end.tolist(), accepted, strict=True)
        times = [times_within(case, t0, t1) if new else [] for case, t0, t1, new in rows]
        snapshots = []
        for k in range(max(map(len, times))):
            histories = np.array([i for i, row in enumerate(times) if len(row) > k])
            to = np.array([times[i][k] for i in histories])
            snapshots.append(self._at_times(before, histories, to, progress))
        return snapshots

    def _at_times(
        self, before: State, histories: IntArray, times: FloatArray, progress: Progress
    ) -> Snapshot:
        """Return the states of some histories at times within their steps."""
        physics, contacts = self._physics.take(histories), self._contacts.take(histories)
        try:
            step = self._run.method.scheme(
                physics, contacts, batched.take(before, histories), times
            )
        except HistoriesError as error:
            which = np.zeros(len(self.numbers), dtype=bool)
            which[histories[error.which]] = True
            raise HistoriesError(which) from error
        finally:
            contacts.close()
        every = np.ones(len(histories), dtype=bool)
        return Snapshot(
            self.numbers[histories], physics, contacts, step.state, step,
            batched.take(progress, histories), step.state.contact.iterations,
            every, every, ~every, passing=True,
        )  # fmt: skip

    def _split(self, parts: Sequence[IntArray]) -> list["_Batch"]:
        """Return batches of some of the histories each; this one ends."""
        batches = []
        for part in parts:
            if not len(part):
                continue
            batch = _Batch(self._run, self.numbers[part])
            if self._begun:
                batch._begun = True
                batch._control = batched.take(self._control, part)
                batch._physics = self._physics.take(part)
                batch._contacts = self._contacts.take(part)
                batch._geometry = self._geometry
                batch._state = batched.take(self._state, part)
                batch._progress = batched.take(self._progress, part)
                batch._every = self._every[part]
            batches.append(batch)
        self.close()
        return batches

    def joined(self, other: "_Batch") -> "_Batch":
        """Return one batch of the histories of both, which end."""
        batch = _Batch(self._run, np.append(self.numbers, other.numbers))
        batch._begun = True
        batch._control = self._run.control(batch.numbers)
        batch._physics = self._physics.joined(other._physics)
        batch._contacts = batch._physics.contacts()
        batch._contacts.start_from(self._contacts, other._contacts)
        batch._state = batched.concat([self._state, other._state])
        batch._progress = batched.concat([self._progress, other._progress])
        batch._every = np.append(self._every, other._every)
        self.close()
        other.close()
        return batch

    def close(self) -> None:
        """Free the contacts."""
        if self._begun:
            self._contacts.close()


def _like(state: State, other: State) -> State:
    """Return a state that has an entry wherever another has one."""
    if state.gap_offset is None and other.gap_offset is not None:
        return replace(state, gap_offset=np.zeros_like(other.gap_offset))
    return state
