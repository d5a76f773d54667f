"""The contacts from which histories start: before any wear, or as they were stored."""

import numpy as np

from ringwear_par.errors import ComputationError, HistoriesError
from ringwear_par.history.admissible import check_interpenetration, checked
from ringwear_par.history.model import WearModel
from ringwear_par.history.schemes.tangent import Along
from ringwear_par.history.state import State


def initial_state(model: WearModel) -> State:
    """Return the contacts before any wear.

    Raises
    ------
    ComputationError : a contact failed; HistoriesError of several histories.
    UnfitError : the bodies interpenetrate by more than the load presses them together.
    """
    time, shape = np.zeros(len(model.inputs.cases)), model.inputs.shape
    wear = np.zeros((2, *shape))
    along = None if model.sensitivity is None else Along(model, None)
    try:
        contact = model.contact(time, wear, np.zeros(shape), exact=True, along=along)
    except HistoriesError:
        raise
    except ComputationError as error:
        raise type(error)(f"{error}; in step 0, before any wear") from error
    check_interpenetration(model)
    rates = model.rates_at(time, wear, contact.pressure)
    worn = np.zeros(wear.shape[:-1])
    state = State(
        time, wear, worn, np.zeros_like(time), contact, rates, np.zeros(shape),
        tangent=None if along is None else along.reached(contact),
        through=np.full(worn.shape, np.inf) if model.inputs.layered else None,
    )  # fmt: skip
    return checked(model.case, state)
