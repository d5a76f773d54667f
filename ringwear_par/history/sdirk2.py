"""Adaptive steps of second order: SDIRK2 with an error estimate, steps growing to the steady state.

Both stages are implicit in the same way (L-stable, stiffly accurate, all coefficients positive, so
that wear never falls and the last stage is the contact with the worn profile). The error is the
difference to the integral of the quadratic through the rates at the start and the two stages;
its stiff part, which the formula damps but the estimate does not, is filtered by (I + gamma h W
C^-1)^-1, with what the last stage knows (Hosea and Shampine, Appl. Numer. Math. 20 (1996) 21-37).
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ringwear_par.errors import ComputationError, LawError
from ringwear_par.schedules import in_time

if TYPE_CHECKING:
    from ringwear_par.history.model import State, WearHistory

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
# weights of the rates at 0, gamma and 1; what the integral of the quadratic through them has more
_WEIGHTS = np.array([0.0, 1.0 - GAMMA, GAMMA])
_AT_START, _AT_STAGE = 0.5 - 1.0 / (6.0 * GAMMA), 1.0 / (6.0 * GAMMA * (1.0 - GAMMA))
_DEFECT = np.array([_AT_START, _AT_STAGE, 1.0 - _AT_START - _AT_STAGE]) - _WEIGHTS
_SAFETY, _LARGEST_GROWTH, _LARGEST_CUT = 0.9, 5.0, 0.1
#: wear of the first step, in tolerances: edges wear fast and not for long
_FIRST_WEAR = 50.0
#: largest error of the dissipated energy of one step, relative to that of the whole history as it
#: would be if the power stayed
_ENERGY_TOLERANCE = 1e-4


def advance(history: "WearHistory", state: "State") -> "State":
    """Return the state after one step that meets the tolerance. Collective.

    Steps end at the times at which a schedule or a parameter bends.

    Raises
    ------
    ComputationError : no step, however small, succeeds.
    """
    time = history.case.time
    limit = next((t for t in history.case.breakpoints if t > state.time), time.end)
    step = min(state.next_step or _first_step(history, state), history.longest_step(state))
    rejected, iterations, failure = state.rejected, 0, ""
    while True:
        left = limit - state.time
        cut = step >= left * (1.0 - 1e-9)
        if cut:
            end = limit
        else:  # no sliver at the end
            end = state.time + (step if step < 0.5 * left or step > 0.9 * left else 0.5 * left)
        if end - state.time <= 4.0 * np.spacing(state.time):
            raise ComputationError(
                f"time.tolerance = {time.tolerance:g} mm is not met by any step; the last one "
                f"would be {end - state.time:.3g} s{failure}"
            )
        try:
            after, error = _stages(history, state, end)
        except LawError:
            raise
        except ComputationError as reason:
            rejected, failure, step = rejected + 1, f" ({reason})", 0.25 * (end - state.time)
            continue
        iterations += after.contact.iterations
        ratio = max(error, 1e-6)
        change = _SAFETY * ratio ** (-1.0 / 3.0)
        if ratio <= 1.0:
            break
        rejected, step = rejected + 1, (end - state.time) * max(change, _LARGEST_CUT)
    growth = min(max(change, _LARGEST_CUT), _LARGEST_GROWTH)
    following = (end - state.time) * growth
    return replace(
        after,
        contact=replace(after.contact, iterations=iterations),
        iterations=state.iterations + iterations,
        next_step=max(following, step) if cut else following,
        rejected=rejected,
    )


def between(history: "WearHistory", state: "State", time: float) -> "State":
    """Return the state at a time within the step that follows a state. Collective."""
    return _stages(history, state, time)[0]


def _first_step(history: "WearHistory", state: "State") -> float:
    fastest = history.fastest(state)
    end, tolerance = history.case.time.end, history.case.time.tolerance
    return min(end, _FIRST_WEAR * tolerance / fastest) if fastest > 0.0 else end


def _stages(history: "WearHistory", state: "State", end: float) -> tuple["State", float]:
    """Return the state at a time, and the estimated error of this step in units of what it may be.

    That of the wear of both bodies together, or of the energy, which schedules may change where
    nothing wears.
    """
    step = end - state.time
    middle = state.time + GAMMA * step
    omega = history.case.load.omega
    speeds = [in_time(omega, t) for t in (state.time, middle, end)]

    first = history.step_wear(middle, speeds[1], state.wear, GAMMA * step)
    stage = history.contact(middle, state.wear, first)
    worn_first = first.depths(stage.pressure)
    # what the first stage wears off counts (1 - gamma) h, the stage itself was gamma h long
    share = (1.0 - GAMMA) / GAMMA
    carried = state.wear + share * worn_first
    last = history.step_wear(end, speeds[2], carried, GAMMA * step)
    contact = history.contact(end, carried, last)
    worn_last = last.depths(contact.pressure)

    pressures = state.contact.pressure, stage.pressure, contact.pressure
    powers = np.array(
        [speed * history.torque(p) for speed, p in zip(speeds, pressures, strict=True)]
    )
    energy = float(step * (_WEIGHTS @ powers))
    contact = replace(
        contact,
        iterations=stage.iterations + contact.iterations,
        residual=max(stage.residual, contact.residual),
    )
    volumes = share * first.volumes(worn_first, stage.pressure, history.area)
    volumes += last.volumes(worn_last, contact.pressure, history.area)
    depths = share * worn_first + worn_last
    after = history.after(state, end, depths, volumes, energy, contact)

    off = abs(step * float(_DEFECT @ powers))
    whole = after.energy + float(powers.max()) * (history.case.time.end - end)
    error = off / (_ENERGY_TOLERANCE * whole) if off > 0.0 else 0.0
    k0 = history.rates(state.time, speeds[0], state.wear, pressures[0])
    defect = (
        _DEFECT[0] * step * k0 + (_DEFECT[1] * worn_first + _DEFECT[2] * worn_last) / GAMMA
    ).sum(axis=0)
    if defect.any():
        # the wear that the defect undoes by the pressure that it takes away
        relief = history.solver.response(defect, history.case.load.force is not None)
        filtered = defect + last.linear(contact.pressure, relief)
        error = max(error, float(np.abs(filtered).max()) / history.case.time.tolerance)
    return after, error
