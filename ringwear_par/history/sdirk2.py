"""SDIRK2 steps, of second order, with an error estimate.

Both stages are implicit in the same way (L-stable, stiffly accurate, all coefficients positive, so
that wear never falls and the last stage is the contact with the worn profile). The error is the
difference to the integral of the quadratic through the rates at the start and the two stages;
its stiff part, which the formula damps but the estimate does not, is filtered by (I + gamma h W
C^-1)^-1, with what the last stage knows (Hosea and Shampine, Appl. Numer. Math. 20 (1996) 21-37).
"""

import math
from dataclasses import replace

import numpy as np

from ringwear_par.arrays import Numbers, columns, inner, larger
from ringwear_par.history.model import WearModel
from ringwear_par.history.schemes import Step, advanced
from ringwear_par.history.state import State
from ringwear_par.schedules import in_time

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
# weights of the rates at 0, gamma and 1; what the integral of the quadratic through them has more
_WEIGHTS = np.array([0.0, 1.0 - GAMMA, GAMMA])
_AT_START, _AT_STAGE = 0.5 - 1.0 / (6.0 * GAMMA), 1.0 / (6.0 * GAMMA * (1.0 - GAMMA))
_DEFECT = np.array([_AT_START, _AT_STAGE, 1.0 - _AT_START - _AT_STAGE]) - _WEIGHTS
#: what the first stage wears off counts (1 - gamma) h, the stage itself was gamma h long
_SHARE = (1.0 - GAMMA) / GAMMA


def step(model: WearModel, state: State, end: Numbers) -> Step:
    """Return the step to a time. Collective."""
    length = end - state.time
    middle = state.time + GAMMA * length
    speeds = [in_time(model.omega, t) for t in (state.time, middle, end)]

    first = model.increment(middle, speeds[1], state.wear, GAMMA * length)
    stage = model.contact(middle, state.wear, state.contact.pressure, first)
    worn_first = first.depths(stage.pressure)
    carried = state.wear + _SHARE * worn_first
    last = model.increment(end, speeds[2], carried, GAMMA * length)
    contact = model.contact(end, carried, stage.pressure, last)
    worn_last = last.depths(contact.pressure)

    pressures = state.contact.pressure, stage.pressure, contact.pressure
    powers = np.stack(
        [speed * model.torque(p) for speed, p in zip(speeds, pressures, strict=True)], axis=-1
    )
    contact = replace(
        contact,
        iterations=stage.iterations + contact.iterations,
        residual=larger(stage.residual, contact.residual),
    )
    energy = length * inner(_WEIGHTS, powers)
    depths = _SHARE * worn_first + worn_last
    then = last.rates(contact.pressure, worn_last)
    volumes = length * model.integrals(
        _WEIGHTS[1] * first.rates(stage.pressure, worn_first) + _WEIGHTS[2] * then
    )
    if not model.rates_last:
        then = model.rates(end, speeds[2], state.wear + depths, contact.pressure)
    after = advanced(model, state, end, depths, volumes, energy, contact, then)
    defect = (
        _DEFECT[0] * columns(length) * state.rates
        + (_DEFECT[1] * worn_first + _DEFECT[2] * worn_last) / GAMMA
    ).sum(axis=0)
    if defect.any():
        # the wear that the defect undoes by the pressure that it takes away
        relief = model.pressure_response(defect)
        defect = defect + last.linear(contact.pressure, relief)
    return Step(
        after,
        np.abs(defect).max(axis=-1),
        abs(length * inner(_DEFECT, powers)),
        powers.max(axis=-1),
    )
