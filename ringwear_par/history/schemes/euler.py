"""Forward and backward Euler steps, of first order.

Forward, (6) of the paper: the pressure at the start of a step wears throughout it. Backward: the
pressure at its end does, which is found together with the wear inside the contact problem; stable
for steps of any length. The error of a step is about half of its length times the change of the
rate.
"""

import numpy as np

from ringwear_par.arrays import FloatArray, columns, largest
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.history.physics import Physics
from ringwear_par.history.schemes.interfaces import Passage, end_at_interfaces
from ringwear_par.history.schemes.step import Step, advanced
from ringwear_par.history.state import State
from ringwear_par.wear.increment import total_of


def forward(physics: Physics, contacts: CorrectedContacts, state: State, end: FloatArray) -> Step:
    """Return the explicit step to a time."""
    at_face, physics = physics, physics.in_present_layers(state.wear)
    length = end - state.time
    sliding = physics.mean_sliding(state.time, end)
    p, rates = state.contact.pressure, state.rates
    if not physics.inputs.steady_sliding:
        rates = physics.rates(state.time, sliding, state.wear, p)
    wear, volumes = state.wear + columns(length) * rates, length * physics.integrals(rates)
    contact = contacts.solve(physics.contact_inputs(end, wear), p)
    end_rates = physics.rates_at(end, wear, contact.pressure)
    turn, moment = length * sliding.omega, physics.moment(p)
    energy, work = turn * (sliding.friction * moment), turn * moment
    after = advanced(physics, state, end, wear, volumes, energy, work, contact, end_rates)
    passage = Passage.of(at_face, physics, state, after, state.time, sliding, p, rates)
    return end_at_interfaces(contacts, state, _estimate_error(state, after), passage)


def backward(physics: Physics, contacts: CorrectedContacts, state: State, end: FloatArray) -> Step:
    """Return the implicit step to a time."""
    at_face, physics = physics, physics.in_present_layers(state.wear)
    length = end - state.time
    sliding = physics.mean_sliding(state.time, end)
    increment = physics.increment(end, sliding, state.wear, length)
    contact = contacts.solve(
        physics.contact_inputs(end, state.wear, increment), state.contact.pressure
    )
    p = contact.pressure
    wear, volume_rates = increment.wear_off(p, state.wear, length, physics.area)
    rates = increment.rates(p)
    end_rates = rates if physics.inputs.rates_last else physics.rates_at(end, wear, p)
    turn, moment = length * sliding.omega, physics.moment(p)
    energy, work = turn * (sliding.friction * moment), turn * moment
    volumes = length * volume_rates
    after = advanced(physics, state, end, wear, volumes, energy, work, contact, end_rates)
    passage = Passage.of(at_face, physics, state, after, end, sliding, p, rates)
    return end_at_interfaces(contacts, state, _estimate_error(state, after), passage)


def _estimate_error(state: State, after: State) -> Step:
    """Return the step between states; its error is half the change of rates times its length."""
    change = total_of(after.rates) - total_of(state.rates)
    error = 0.5 * (after.time - state.time) * largest(np.abs(change))
    return Step(after, error, error)
