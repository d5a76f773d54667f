"""Many histories of one contact pair in lock step: each round every one of them makes a step.

Each steps as far as its own control says; one whose step is rejected tries again with the others'
next one, and one that has ended leaves. Digits of a history do not depend on the others. One in
trouble, whatever it is, leaves too: it is to be computed alone from its start, by ``simulate``,
which finds its way or the reason why there is none.
"""

import copy
import logging
from collections.abc import Callable, Hashable, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.pair import ContactPair
from ringwear_par.errors import HistoriesError, RingwearError, reason_of
from ringwear_par.history.control import (
    ErrorBatch,
    FixedBatch,
    GivenBatch,
    joined,
    step_times_of,
)
from ringwear_par.history.model import WearModel
from ringwear_par.history.saving import stores, times_within
from ringwear_par.history.schemes import Scheme
from ringwear_par.history.simulate import METHODS
from ringwear_par.history.snapshots import BatchSnapshot
from ringwear_par.history.state import State
from ringwear_par.wear.catalogue import LAWS
from ringwear_par.wear.law import CompletedLaw, Law
from ringwear_par.wear.layered import LayeredLaw, NoWear
from ringwear_par.wear.parameters import Parameter, parameters_of
from ringwear_par.wear.user import serves_many

log = logging.getLogger(__name__)

#: most contact elements of histories in lock step: beyond it LAPACK takes most of the time anyway
MOST_ELEMENTS = 256

Control = FixedBatch | ErrorBatch


def stays_alone(case: Case) -> bool:
    """Tell whether a case does not step together with others. Not collective."""
    return (
        case.follows_wear
        or case.output.boundary != "none"
        or case.mesh.contact_elements > MOST_ELEMENTS
        or METHODS[case.time.scheme].batch is None
    )


def batch_key(case: Case) -> Hashable | None:
    """Return what cases of one pair have to share to step together; None for one that stays alone.

    Of the case alone. Not collective.
    """
    if stays_alone(case):
        return None
    output = case.output
    kinds = tuple(None if law is None else _kind(law) for law in case.laws)
    force = case.load.force is not None
    stored = output.fields, output.profiles, bool(output.times), case.stress
    return case.time.scheme, force, kinds, *stored


def can_share(case: Case) -> bool:
    """Tell whether cases of this one's ``batch_key`` may step together, as far as laws tell.

    Laws that are not ours are tried. Not collective.
    """
    given = [law for law in case.laws if law is not None]
    every = [each for law in given for each in (law.laws if isinstance(law, LayeredLaw) else [law])]
    own = [law for law in every if type(law) not in (*LAWS.values(), NoWear)]
    return all(serves_many(law, case.line.r) for law in own)


def _kind(law: Law) -> Hashable:
    """Return what laws have to share to be stacked."""
    parts: list[Any] = [type(law)]
    if isinstance(law, LayeredLaw):
        return (*parts, law.thicknesses, law.own, *map(_kind, law.laws))
    if isinstance(law, CompletedLaw):
        return (*parts, *_own_kind(law.own))
    for name, parameter in _fields_of(type(law)):  # type: ignore[arg-type]
        value = getattr(law, name)
        if parameter is not None and parameter.numeric:
            parts.append(value is None)
        elif parameter is not None and parameter.kind == "parameters":
            parts.append(tuple(name for name, _ in value))
        else:
            parts.append(value)
    return tuple(parts)


@cache
def _fields_of(law: type[Law]) -> tuple[tuple[str, Parameter | None], ...]:
    """Return the fields of a law, each with its parameter if it is one."""
    declared = parameters_of(law)
    names: list[str] = [field.name for field in fields(law)] if is_dataclass(law) else []
    return tuple((name, declared.get(name)) for name in names)


def _own_kind(own: Any) -> tuple[Hashable, ...]:
    """Return the same of a user's object: itself."""
    try:
        hash(own)
    except TypeError:
        return (id(own),)
    return (own,)


def _log(what: str, count: int, error: Exception) -> None:
    """Log why histories do not go on together: a warning where no failure of ours tells why.

    Nothing else would show it but time, for histories are the same alone.
    """
    expected = isinstance(error, RingwearError)
    log.log(
        logging.DEBUG if expected else logging.WARNING,
        "%d histories in lock step %s (%s): those that this comes of are computed alone, which "
        "takes longer",
        count, what, reason_of(error), exc_info=error if expected else None,
    )  # fmt: skip


class _Lot:
    """Histories that step together.

    Parameters
    ----------
    cases : of all histories.
    pair : contact pair of the cases.
    numbers : (B,) int, those of this lot.
    derivatives, step_times : as of ``simulate_batch``.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        pair: ContactPair,
        numbers: IntArray,
        derivatives: Sequence[str] = (),
        step_times: Sequence[Sequence[float]] | None = None,
    ) -> None:
        self._all, self._pair, self.numbers = cases, pair, numbers
        self._derivatives, self._step_times = derivatives, step_times
        self.begun = False
        #: whether it was parted from others with which it fails
        self.apart = False
        self._scheme: Scheme
        self.control: Control
        self.model: WearModel
        self.state: State
        self._every: IntArray

    @property
    def _cases(self) -> list[Case]:
        return [self._all[number] for number in self.numbers]

    def advance(self, observe: Callable[[BatchSnapshot], None]) -> None:
        """Find the first contacts, or make a round of steps."""
        if not self.begun:
            self._begin()
            self._show([self._start()], observe)
            self.begun = True
            return
        before = copy.copy(self.control), self.model.batch.solver.start
        try:
            snapshots = self._round()
        except Exception:
            self.control = before[0]
            self.model.batch.solver.start = before[1]
            raise
        self._show(snapshots, observe)
        self.state = snapshots[-1].state

    def _show(
        self, snapshots: Sequence[BatchSnapshot], observe: Callable[[BatchSnapshot], None]
    ) -> None:
        """Show new states; what is seen of them cannot be unseen, so that none may try again."""
        try:
            for snapshot in snapshots:
                observe(snapshot)
        except Exception as error:
            _log("cannot be shown", len(self.numbers), error)
            raise HistoriesError(np.ones(len(self.numbers), dtype=bool)) from error

    def _begin(self) -> None:
        cases = self._cases
        self._scheme, _, make_control = METHODS[cases[0].time.scheme]
        assert make_control is not None  # see ``stays_alone``
        if self._step_times is None:
            self.control = make_control(cases)
        else:
            self.control = GivenBatch(cases, [self._step_times[i] for i in self.numbers.tolist()])
        self.model = WearModel(cases, MPI.COMM_SELF, self._pair, derivatives=self._derivatives)
        self._every = np.array([case.output.every for case in cases])
        self.state = self.model.initial()

    def _start(self) -> BatchSnapshot:
        every = np.ones(len(self.numbers), dtype=bool)
        return BatchSnapshot(
            self.numbers, self.model, self.state, None, self.control.progress,
            self.state.contact.iterations, every, every, ~every,
        )  # fmt: skip

    def _round(self) -> list[BatchSnapshot]:
        """Return what a step of each history leads to, states within it first."""
        model, before, made = self.model, self.state, self.control.progress
        end = self.control.end(before)
        step = self._scheme(model, before, end)
        taken = self.control.accepts(step)
        snapshots = self._passing(before, end, taken)
        progress, every = self.control.progress, taken.all()
        state = step.state if every else before.updated(taken, step.state)
        finished = taken & self.control.finished(state)
        return [
            *snapshots,
            BatchSnapshot(
                self.numbers, model, state, step, progress,
                progress.iterations - made.iterations, taken,
                self._stored(taken, finished, progress.steps, state.time), finished,
            ),
        ]  # fmt: skip

    def _stored(
        self, taken: BoolArray, finished: BoolArray, steps: IntArray, times: FloatArray
    ) -> BoolArray:
        """Tell which of the new states are stored."""
        if self.model.case.output.times:
            rows = zip(self.model.given.cases, steps.tolist(), times.tolist(), strict=True)
            return taken & np.array([stores(*row) for row in rows])
        return taken & (finished | (steps % self._every == 0))

    def _passing(self, before: State, end: FloatArray, taken: BoolArray) -> list[BatchSnapshot]:
        """Return the states at times of output within steps that are taken."""
        if not self.model.case.output.times:
            return []
        rows = zip(self.model.given.cases, before.time.tolist(), end.tolist(), taken, strict=True)
        times = [times_within(case, t0, t1) if shown else [] for case, t0, t1, shown in rows]
        return [
            self._passed(before, np.array([i for i, t in enumerate(times) if len(t) > k]), k, times)
            for k in range(max(map(len, times)))
        ]

    def _passed(
        self, before: State, histories: IntArray, k: int, times: Sequence[Sequence[float]]
    ) -> BatchSnapshot:
        """Return the states of some histories at their k-th times within the step."""
        model = self.model.take(histories)
        try:
            to = np.array([times[i][k] for i in histories])
            step = self._scheme(model, before.take(histories), to)
        except HistoriesError as error:
            which = np.zeros(len(self.numbers), dtype=bool)
            which[histories[error.which]] = True
            raise HistoriesError(which) from error
        finally:
            model.batch.solver.destroy()
        every = np.ones(len(histories), dtype=bool)
        return BatchSnapshot(
            self.numbers[histories], model, step.state, step,
            self.control.progress.take(histories), step.state.contact.iterations, every, every,
            ~every, passing=True,
        )  # fmt: skip

    @property
    def ended(self) -> BoolArray:
        """Which histories have come to their end, (B,)."""
        if not self.begun:
            return np.zeros(len(self.numbers), dtype=bool)
        return self.control.finished(self.state)

    def take(self, histories: IntArray) -> "_Lot":
        """Return a lot of some of the histories, as far as they are."""
        lot = self._of(self.numbers[histories])
        if self.begun:
            lot.begun, lot._scheme = True, self._scheme
            lot.control, lot.model = self.control.take(histories), self.model.take(histories)
            lot.state, lot._every = self.state.take(histories), self._every[histories]
        return lot

    def joined(self, other: "_Lot") -> "_Lot":
        """Return one lot of both, which have begun."""
        lot = self._of(np.append(self.numbers, other.numbers))
        lot.begun, lot._scheme = True, self._scheme
        lot.model = self.model.joined(other.model)
        lot.control = joined(self.control, other.control)
        lot.state = self.state.joined(other.state)
        lot._every = np.append(self._every, other._every)
        return lot

    def _of(self, numbers: IntArray) -> "_Lot":
        """Return a lot of other histories that has not begun."""
        return _Lot(self._all, self._pair, numbers, self._derivatives, self._step_times)

    def close(self) -> None:
        """Free the contact solver."""
        if self.begun:
            self.model.batch.solver.destroy()


def simulate_batch(
    cases: Sequence[Case],
    pair: ContactPair,
    observe: Callable[[BatchSnapshot], None],
    stop: Callable[[], bool] = lambda: False,
    most: int | None = None,
    derivatives: Sequence[str] = (),
    step_times: Sequence[Sequence[float]] | None = None,
) -> list[int] | None:
    """Step the histories of cases in lock step, from their starts to their ends. Not collective.

    Parameters
    ----------
    cases : of one ``batch_key``.
    pair : contact pair of all of them.
    observe : called with new states.
    stop : asked between two rounds.
    most : histories that step at a time; as they end others take their places. None: all.
    derivatives : keys that states have derivatives with respect to.
    step_times : s, ends of the steps of each history, its last one that of its case; None: each
        steps as its case says.

    Returns
    -------
    Numbers of the histories that came to trouble, and are to be computed alone, whatever was shown
    of them; None if all were stopped.

    Raises
    ------
    ValueError : steps that are given do not increase to the ends of the cases.
    """
    for times, case in () if step_times is None else zip(step_times, cases, strict=True):
        step_times_of(times, case)
    alone: list[int] = []
    lots: list[_Lot] = []
    begun, most = 0, most or len(cases)
    while lots or begun < len(cases):
        going = sum(len(lot.numbers) for lot in lots)
        if begun < len(cases) and 2 * going <= most:
            more = np.arange(begun, min(begun + most - going, len(cases)))
            lots.append(_Lot(cases, pair, more, derivatives, step_times))
            begun += len(more)
        if len(lots) > 1 and all(lot.begun and not lot.apart for lot in lots[-2:]):
            one, other = lots[-2:]
            lots[-2:] = [one.joined(other)]
            one.close()
            other.close()
        if stop():
            for lot in lots:
                lot.close()
            return None
        lot, parts, apart = lots.pop(), [], False
        try:
            lot.advance(observe)
            ended = lot.ended
            if not ended.any():
                lots.append(lot)
                continue
            parts = [np.flatnonzero(~ended)]
        except HistoriesError as error:
            alone += lot.numbers[error.which].tolist()
            parts = [np.flatnonzero(~error.which)]
        except Exception as error:  # whatever a user's law may raise, nobody knows for whom
            count = len(lot.numbers)
            if not lot.apart:  # the parts of a lot fail by the same
                _log("failed", count, error)
            if count == 1:
                alone.append(int(lot.numbers[0]))
            else:
                parts, apart = np.array_split(np.arange(count), 2), True
        for part in parts:
            if len(part):
                lots.append(lot.take(part))
                lots[-1].apart = apart or lot.apart
        lot.close()
    return sorted(alone)
