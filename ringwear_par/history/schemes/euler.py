"""Forward and backward Euler steps, of first order.

Forward, (6) of the paper: the pressure at the start of a step wears throughout it. Backward: the
pressure at its end does, which is found together with the wear inside the contact problem; stable
for steps of any length. What a step misses is about half of its length times the change of the
rate.
"""

import numpy as np

from ringwear_par.arrays import FloatArray, columns
from ringwear_par.history.model import WearModel
from ringwear_par.history.schemes.step import Step, advanced, first_through
from ringwear_par.history.schemes.tangent import along_step
from ringwear_par.history.state import State
from ringwear_par.schedules import mean
from ringwear_par.wear.layered_increment import LayeredIncrement


def forward(model: WearModel, state: State, end: FloatArray) -> Step:
    """Return the explicit step to a time. Collective."""
    length = end - state.time
    omega = mean(model.inputs.omega, state.time, end)
    p, rates = state.contact.pressure, state.rates
    if not model.inputs.steady_speed:
        rates = model.rates(state.time, omega, state.wear, p)
    depths, volumes = columns(length) * rates, length * model.integrals(rates)
    through = None
    if model.inputs.layered:
        start = model.increment(state.time, omega, state.wear, length)
        assert isinstance(start, LayeredIncrement)
        depths = start.explicit(p)
        volumes = model.integrals(depths)
        through = first_through(state, (state.time, length, start, p, 1.0))
    along = along_step(model, state)
    if along is not None:
        along.explicit(model.increment(state.time, omega, state.wear, length), p)
        along.work(length, omega, p, along.pressure)
    contact = model.contact(end, state.wear + depths, p, along=along)
    then = model.rates_at(end, state.wear + depths, contact.pressure)
    energy = length * omega * model.torque(p)
    after = advanced(model, state, end, depths, volumes, energy, contact, then, along, through)
    return _judged(state, after)


def backward(model: WearModel, state: State, end: FloatArray) -> Step:
    """Return the implicit step to a time. Collective."""
    length = end - state.time
    omega = mean(model.inputs.omega, state.time, end)
    during = model.increment(end, omega, state.wear, length)
    along = along_step(model, state)
    contact = model.contact(end, state.wear, state.contact.pressure, during, along=along)
    p = contact.pressure
    depths = during.depths(p)
    if model.inputs.layered:
        volumes = model.integrals(during.apart(p, depths, 1.0))
    else:
        then = during.rates(p, depths)
        volumes = length * model.integrals(then)
    if not model.inputs.rates_last:
        then = model.rates_at(end, state.wear + depths, p)
    energy = length * omega * model.torque(p)
    if along is not None:
        along.implicit()
        along.work(length, omega, p, along.pressure)
    through = first_through(state, (state.time, length, during, p, 1.0))
    after = advanced(model, state, end, depths, volumes, energy, contact, then, along, through)
    return _judged(state, after)


def _judged(state: State, after: State) -> Step:
    """Return the step from one state to another, half of what the rates changed as its error."""
    lower, upper = after.rates - state.rates
    change = lower + upper
    error = 0.5 * (after.time - state.time) * np.abs(change).max(axis=-1)
    return Step(after, error, error)
