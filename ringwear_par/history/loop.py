"""The time loop, section 3 of the paper, of B >= 1 histories on one contact pair.

``pressure[n]``, ``approach[n]``... are the contact solution with the profile worn up to
``time[n]``, for every scheme.

Each round every history of a batch tries a step as long as its control says. One whose try is
rejected tries a shorter step in the next round, while the others go on. A history ends where its
step control says that it is finished, or where it reaches a limit of its case (``stop_criteria``);
an observer interrupts all of them. Digits of a history do not depend on the others. One whose step
cannot be made goes on alone, or fails with the reason.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import SCHEMES, import_named
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.batch import Batch
from ringwear_par.history.ensemble import Ensemble, Method
from ringwear_par.history.snapshots import Observer
from ringwear_par.history.state import Start
from ringwear_par.history.step_control import step_times_of
from ringwear_par.history.stop_criteria import have_reached, stop_limits


class Outcome(NamedTuple):
    """How histories ended."""

    #: why, of those that failed, by number
    failures: dict[int, Exception]
    #: whether an observer ended all of them before their ends
    interrupted: bool


def method_of(scheme: str) -> Method:
    """Return how histories of a ``time.scheme`` step: what its line in ``SCHEMES`` names, loaded.

    All ask here for it, so that tests can have histories step in another way.
    """
    names = SCHEMES[scheme]
    functions = names.step, names.control, names.within or names.step
    return Method(*map(import_named, functions))


def simulate(
    cases: Sequence[Case],
    comm: MPI.Comm,
    *,
    pair: ContactPair | Sequence[ContactPair] | None = None,
    start: Start | None = None,
    observers: Sequence[Observer] = (),
    step_times: Sequence[Sequence[float]] | None = None,
    paces: Sequence[FloatArray] | None = None,
) -> Outcome:
    """Step wear histories from their starts to their ends, or until an observer interrupts all.

    Collective on comm.

    Parameters
    ----------
    cases : one, or several of one ``lockstep.batch_key``.
    comm : communicator; histories are the same on all ranks.
    pair : contact pair of the cases, or one of each on the same contact elements; None: assembled
        first.
    start : where an interrupted history continues, of one case.
    observers : called with all new states, in this order.
    step_times : s, ends of the steps of each history, its last one that of its case; None: each
        steps as its case says.
    paces : (2, steps) each, with ``step_times``, factors on the rates of wear of lower and upper
        in each of these steps: wear that is random; None: 1.

    Raises
    ------
    ValueError : steps that are given do not increase to the ends of the cases.
    """
    for times, case in () if step_times is None else zip(step_times, cases, strict=True):
        step_times_of(times, case)
    ensemble = Ensemble(
        cases, comm, pair, start, observers, step_times, paces,
        method_of(cases[0].time.scheme),
    )  # fmt: skip
    batches = [Batch(ensemble, np.arange(len(cases)))]
    try:
        while batches and not ensemble.interrupted:
            # the last batch makes a round, alone: what goes on of it, in one or more parts, is last
            batches += batches.pop().advance()
    finally:
        for batch in batches:
            batch.close()
    return Outcome(ensemble.failures, ensemble.interrupted)


def simulate_one(
    case: Case,
    comm: MPI.Comm,
    *,
    pair: ContactPair | None = None,
    start: Start | None = None,
    observers: Sequence[Observer] = (),
    step_times: Sequence[float] | None = None,
) -> None:
    """Step one wear history, see ``simulate``. Collective on comm.

    Raises
    ------
    ComputationError : a step could not be made; it is named with its time.
    UnfitError : the case's own numbers do not go together, as its first contact shows.
    """
    outcome = simulate(
        [case], comm, pair=pair, start=start, observers=observers,
        step_times=None if step_times is None else [step_times],
    )  # fmt: skip
    for error in outcome.failures.values():
        raise error


def is_at_end(case: Case, start: Start) -> bool:
    """Tell whether a history that continues has come to the end of its case."""
    control = method_of(case.time.scheme).control.of([case], None)
    stopped = have_reached(stop_limits([case]), start.state)
    return bool(control.finished(start.state, start.progress)[0] or stopped[0])
