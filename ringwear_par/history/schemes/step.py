"""What a scheme is: a function that makes one step and estimates its error.

``scheme(physics, contacts, state, end) -> Step``, for B histories with ends of their own. Schemes
store nothing and decide nothing; a new one is a file with such a function, and a line in
``SCHEMES`` of ``cases/schema.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.problem import ContactState
from ringwear_par.history.physics import Physics
from ringwear_par.history.refusals.states import check_state
from ringwear_par.history.state import State


@dataclass(frozen=True)
class Step:
    """One step of B histories, with its estimated errors."""

    #: at its end; the iterations of its contact are those of all stages
    state: State
    #: (B,), mm, estimated error of the wear of both bodies together in the step, of the worst
    #: element
    wear_error: FloatArray
    #: (B,), mm, estimated error of the wear of the history up to the end of the step; from a scheme
    #: that does not carry it, that of the step
    history_error: FloatArray
    #: (B,), N mm, estimated error of the energy dissipated in the step; 0 from a scheme that leaves
    #: it to the wear
    energy_error: Any = 0.0
    #: (B,), N mm/s, largest power of friction in the step, where there is such error
    power: Any = 0.0
    #: (B,), estimated error of the pressure at the end, of the worst element, over the mean
    #: pressure (force over the area in contact); 0 from a scheme that does not know it
    pressure_error: Any = 0.0
    #: (B,), mm, the error of the history at the start of the step, propagated to its end; 0 from a
    #: scheme that does not propagate it
    carried_error: Any = 0.0
    #: (B,), whether elements came into contact within the step: errors of wear leave these out
    closing: Any = False
    #: (B,), whether an element went too far beyond its layer; the step is no good then
    too_far: Any = False
    #: (B,), s, when the first element got to the end of its layer, or is expected to
    interface: Any = np.inf
    #: (B,), whether an element is in its next layer at the end
    crossed: Any = False


Scheme = Callable[[Physics, CorrectedContacts, State, FloatArray], Step]


def advanced(
    physics: Physics,
    state: State,
    end: FloatArray,
    wear: FloatArray,
    volumes: FloatArray,
    energy: FloatArray,
    normal_work: FloatArray,
    contact: ContactState,
    rates: FloatArray,
) -> State:
    """Return the state at the end of a step.

    Parameters
    ----------
    wear : (2, ..., n) float, mm, at its end.
    volumes : (2, ...) float, mm^3, integrals over the step of the rates of the worn volumes.
    energy, normal_work : (B,), N mm, in it, see ``State``.
    rates : (2, ..., n) float, mm/s, of wear at its end.

    Raises
    ------
    ComputationError : the physics no longer holds, see ``check_state``.
    """
    after = State(
        end, wear, state.worn + volumes, state.energy + energy,
        state.normal_work + normal_work, contact, state.first_approach, rates, state.error,
        state.meshed_wear, state.gap_offset, state.through,
    )  # fmt: skip
    return check_state(physics.inputs, after)
