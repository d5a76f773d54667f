"""The contacts from which histories start: before any wear, or as they were stored."""

import numpy as np
from mpi4py import MPI

from ringwear_par.batched import one
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.problem import ContactState
from ringwear_par.errors import ComputationError, HistoriesError
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.physics import Physics
from ringwear_par.history.refusals.states import check_interpenetration, check_state
from ringwear_par.history.state import State


def first_contact(case: Case, comm: MPI.Comm) -> ContactState:
    """Return the contact of a case before any wear. Collective on comm."""
    physics = Physics.of([case], assemble(case, comm))
    with physics.contacts() as contacts:
        return one(initial_state(physics, contacts).contact, 0)


def initial_state(physics: Physics, contacts: CorrectedContacts) -> State:
    """Return the contacts before any wear.

    Raises
    ------
    ComputationError : a contact failed; HistoriesError of several histories.
    UnfitError : the bodies interpenetrate by more than the load presses them together.
    """
    time, shape = np.zeros(len(physics.inputs.cases)), physics.inputs.shape
    wear = np.zeros((2, *shape))
    try:
        contact = contacts.solve(physics.contact_inputs(time, wear), np.zeros(shape), exact=True)
    except HistoriesError:
        raise
    except ComputationError as error:
        raise type(error)(f"{error}; in step 0, before any wear") from error
    check_interpenetration(physics, contacts)
    rates = physics.rates_at(time, wear, contact.pressure)
    worn = np.zeros(wear.shape[:-1])
    state = State(
        time, wear, worn, np.zeros_like(time), np.zeros_like(time), contact, contact.approach,
        rates, np.zeros(shape),
        through=np.full(worn.shape, np.inf) if physics.inputs.layered else None,
    )  # fmt: skip
    return check_state(physics.inputs, state)
