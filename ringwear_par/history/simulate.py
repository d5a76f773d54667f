"""The time loop, section 3 of the paper.

``pressure[n]``, ``approach[n]``... are the contact solution with the profile worn up to
``time[n]``, for every scheme.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.cases.forecast import unit_question
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.pair import ContactPair
from ringwear_par.errors import ComputationError
from ringwear_par.history import euler, sdirk2
from ringwear_par.history.control import (
    Control,
    ErrorBatch,
    ErrorControl,
    FixedBatch,
    FixedSteps,
    GivenSteps,
)
from ringwear_par.history.following import update_geometry
from ringwear_par.history.model import WearModel
from ringwear_par.history.saving import stores, times_within
from ringwear_par.history.schemes import Scheme, Step
from ringwear_par.history.snapshots import Observer, Snapshot
from ringwear_par.history.state import Progress, Start, State
from ringwear_par.parallel import together


class Method(NamedTuple):
    """What a ``time.scheme`` is.

    Parameters
    ----------
    scheme, control : of the steps of one history.
    batch : control of histories in lock step; None for a scheme that steps one history only.
    """

    scheme: Scheme
    control: Callable[[Case, Progress, MPI.Comm], Control]
    batch: type[FixedBatch] | type[ErrorBatch] | None


#: by the name that ``time.scheme`` gives them
METHODS: dict[str, Method] = {
    "explicit": Method(euler.forward, FixedSteps, FixedBatch),
    "implicit": Method(euler.backward, FixedSteps, FixedBatch),
    "adaptive": Method(sdirk2.step, ErrorControl, ErrorBatch),
}


def simulate(
    case: Case,
    comm: MPI.Comm,
    *,
    pair: ContactPair | None = None,
    solver: ContactSolver | None = None,
    start: Start | None = None,
    observers: Sequence[Observer] = (),
    derivatives: Sequence[str] = (),
    step_times: Sequence[float] | None = None,
) -> State:
    """Step a wear history from its start to its end, or until an observer says stop.

    Collective on comm.

    Parameters
    ----------
    case : the case.
    comm : communicator.
    pair : its contact pair; None: assembled first.
    solver : contact solver of the pair at the case's moduli, to be used again; None: made here.
    start : where an interrupted history goes on.
    observers : called with every state, in this order.
    derivatives : keys that states have derivatives with respect to; not of one that goes on.
    step_times : s, ends of the steps, the last that of the case; None: the case's own.

    Returns
    -------
    The last state.

    Raises
    ------
    ComputationError : a step could not be made; it is named with its time.
    UnfitError : the case's own numbers do not go together, as its first contact tells.
    """
    if start is not None and derivatives:
        raise ValueError("a history that goes on has no derivatives: they are not stored")
    scheme, make_control, _ = METHODS[case.time.scheme]
    if step_times is not None:
        make_control = partial(GivenSteps, step_times)
    with WearModel(case, comm, pair, solver, derivatives=derivatives) as model:
        control = make_control(case, Progress() if start is None else start.progress, comm)
        show = _Showing(observers, model, control)
        if start is None:
            with together(comm):
                state = model.initial()
            show(state, None, state.contact.iterations)
        else:
            state = model.resume(start)
        while not show.stopped and not case.time.finished(control.progress.steps, state.time):
            made = control.progress
            try:
                state = update_geometry(model, state)
                end = control.end(state)
                try:
                    with together(comm):
                        step = scheme(model, state, end)
                except ComputationError as error:
                    control.failed(error)
                    continue
                if not control.accepts(step):
                    continue
                within = []
                for time in times_within(case, state.time, end):
                    with together(comm):
                        within.append(scheme(model, state, time))
            except ComputationError as error:
                told = (
                    f"{error}{unit_question(case, state.wear)}; in step {made.steps + 1}, "
                    f"from time {state.time:g} s"
                )
                raise type(error)(told) from error
            for passed in within:
                show(passed.state, passed, passed.state.contact.iterations, passing=True)
            state = step.state
            show(state, step, control.progress.iterations - made.iterations)
    return state


class _Showing:
    """Shows states to the observers; ``stopped`` once one of them has said so."""

    def __init__(self, observers: Sequence[Observer], model: WearModel, control: Control) -> None:
        self._observers, self._model, self._control = observers, model, control
        self.stopped = False

    def __call__(
        self, state: State, step: Step | None, iterations: int, *, passing: bool = False
    ) -> None:
        case, progress = self._model.case, self._control.progress
        snapshot = Snapshot(
            self._model,
            state,
            step,
            progress,
            iterations,
            stored=passing or stores(case, progress.steps, state.time),
            passing=passing,
            finished=not passing and case.time.finished(progress.steps, state.time),
        )
        for observer in self._observers:
            self.stopped |= observer(snapshot)
