"""Forward and backward Euler steps, of first order.

Forward, (6) of the paper: the pressure at the start of a step wears throughout it. Backward: the
pressure at its end does, which is found together with the wear inside the contact problem; stable
for steps of any length. What a step misses is about half of its length times the change of the
rate.
"""

import numpy as np

from ringwear_par.arrays import FloatArray, Numbers, columns
from ringwear_par.history.model import WearModel
from ringwear_par.history.schemes import Step, advanced
from ringwear_par.history.state import State
from ringwear_par.schedules import in_time, mean


def forward(model: WearModel, state: State, end: Numbers) -> Step:
    """Return the explicit step to a time. Collective."""
    length = end - state.time
    omega = mean(model.omega, state.time, end)
    p = state.contact.pressure
    rates = model.rates(state.time, omega, state.wear, p)
    depths, volumes = columns(length) * rates, length * model.integrals(rates)
    wear = state.wear + depths
    contact = model.contact(end, wear)
    energy = length * omega * model.torque(p)
    after = advanced(model, state, end, depths, volumes, energy, contact)
    now = in_time(model.omega, end)
    return _judged(model, state, after, model.rates(end, now, wear, contact.pressure) - rates)


def backward(model: WearModel, state: State, end: Numbers) -> Step:
    """Return the implicit step to a time. Collective."""
    length = end - state.time
    omega = mean(model.omega, state.time, end)
    during = model.increment(end, omega, state.wear, length)
    contact = model.contact(end, state.wear, during)
    p = contact.pressure
    depths = during.depths(p)
    volumes = during.volumes(depths, p, model.area)
    energy = length * omega * model.torque(p)
    after = advanced(model, state, end, depths, volumes, energy, contact)
    now = in_time(model.omega, state.time)
    rates = model.rates(state.time, now, state.wear, state.contact.pressure)
    return _judged(model, state, after, depths / columns(length) - rates)


def _judged(model: WearModel, state: State, after: State, change: FloatArray) -> Step:
    """Return a step with its errors, the rates of wear (2, ..., n) having changed by so much."""
    half = 0.5 * (after.time - state.time)
    before, then = (
        in_time(model.omega, s.time) * model.torque(s.contact.pressure) for s in (state, after)
    )
    wear_error = half * np.abs(change.sum(axis=0)).max(axis=-1)
    return Step(after, wear_error, half * abs(then - before), np.maximum(before, then))
