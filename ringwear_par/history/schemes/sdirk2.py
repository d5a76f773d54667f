"""SDIRK2 steps, of second order, with an error estimate.

Both stages are implicit in the same way (L-stable, stiffly accurate, all coefficients positive, so
that wear never falls and the last stage is the contact with the worn profile). The error of a step
is the difference to the integral of the quadratic through the rates at the start and the two
stages, with an estimate of the error of that integral itself: values of stages are of first order,
which the quadratic does not see. Its stiff part, which the formula damps but the estimate does not,
is filtered by (I + gamma h W C^-1)^-1, with what the last stage knows (Hosea and Shampine, Appl.
Numer. Math. 20 (1996) 21-37); the pressure that the filter takes away is the error of the pressure.
The error of a history is its error at the start of the step, propagated to its end as any small
change of depth is, and that of the step. Elements that wear brings into contact within a step are
dealt with apart, see ``closing_elements``.
"""

import math
from dataclasses import replace

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, largest
from ringwear_par.compiled import error_rows, step_rows
from ringwear_par.compiled.error_rows import Errors, Estimates, Formula
from ringwear_par.compiled.machine_code import load
from ringwear_par.compiled.product_rows import SPARE_ROWS
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.engine import ContactEngine
from ringwear_par.contact.problem import ContactState
from ringwear_par.history.physics import Physics, Sliding
from ringwear_par.history.schemes.closing_elements import (
    ClosingElements,
    entry_error,
    find_closing_elements,
)
from ringwear_par.history.schemes.interfaces import Passage, end_at_interfaces
from ringwear_par.history.schemes.step import Step, advanced
from ringwear_par.history.state import State
from ringwear_par.wear.increment import WearIncrement

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
# weights of the rates at 0, gamma and 1; what the integral of the quadratic through them has more
_WEIGHTS = np.array([0.0, 1.0 - GAMMA, GAMMA])
_AT_START, _AT_STAGE = 0.5 - 1.0 / (6.0 * GAMMA), 1.0 / (6.0 * GAMMA * (1.0 - GAMMA))
_DEFECT = np.array([_AT_START, _AT_STAGE, 1.0 - _AT_START - _AT_STAGE]) - _WEIGHTS
#: what the integral of the quadratic lacks of h^3 J^2 f, J being d rate / d depth: 1/6 is exact
_LACKING = 1.0 / 6.0 - (
    _AT_STAGE * GAMMA**2 + (1.0 - _AT_START - _AT_STAGE) * ((1.0 - GAMMA) * GAMMA + GAMMA)
)
#: the first stage is solved over gamma h, and its wear enters with the weight (1 - gamma) h
_FIRST_STAGE_FACTOR = (1.0 - GAMMA) / GAMMA
_ERRORS = Formula(_DEFECT, GAMMA, _LACKING / GAMMA, _FIRST_STAGE_FACTOR)


def step_within(
    physics: Physics, contacts: CorrectedContacts, state: State, end: FloatArray
) -> Step:
    """Return the step to a time, without its errors where there are no layers."""
    return step(physics, contacts, state, end, with_errors=physics.inputs.layered)


def step(
    physics: Physics,
    contacts: CorrectedContacts,
    state: State,
    end: FloatArray,
    *,
    with_errors: bool = True,
) -> Step:
    """Return the step to a time; without layers perhaps without its errors, which are 0 then."""
    at_face, physics = physics, physics.in_present_layers(state.wear)
    length, p_before = end - state.time, state.contact.pressure
    middle, stage_length = state.time + GAMMA * length, GAMMA * length
    sliding = [physics.sliding(t) for t in (state.time, middle, end)]

    is_closed = bool(p_before.min() > 0.0)  # then no element can close a gap
    closing = None if is_closed else find_closing_elements(physics, state, length)
    gap_closing = (
        None if closing is None else closing.closing(stage_length, np.ones_like(closing.gap))
    )
    first = physics.increment(middle, sliding[1], state.wear, stage_length, gap_closing)
    stage = contacts.solve(physics.contact_inputs(middle, state.wear, first), p_before)
    weights = None if closing is None else closing.stage_weights(stage.pressure, 0.0)
    carried, first_volumes = first.wear_off(
        stage.pressure, state.wear, _FIRST_STAGE_FACTOR * stage_length, physics.area, weights
    )
    in_first = first.total_if_always_in_contact(stage.pressure)  # the last stage may be the same
    last, contact, weights_last = _last_stage(
        physics, contacts, closing, end, sliding[2], carried, stage_length, stage.pressure
    )
    wear, last_volumes = last.wear_off(
        contact.pressure, carried, stage_length, physics.area, weights_last
    )
    sums, with_weights = np.empty((5, len(length))), weights is not None
    load(step_rows).add_power(
        *p_before.shape, length, np.array(sliding, dtype=float), p_before, stage.pressure,
        contact.pressure, weights if with_weights else p_before,
        weights_last if with_weights else p_before, with_weights, physics.torque_arm,
        physics.area, _WEIGHTS, _DEFECT, sums,
    )  # fmt: skip
    energy, work, energy_error, power, touching = sums
    contact = replace(
        contact,
        iterations=stage.iterations + contact.iterations,
        residual=np.maximum(stage.residual, contact.residual),
    )
    then = (
        last.rates(contact.pressure)
        if physics.inputs.rates_last
        else physics.rates(end, sliding[2], wear, contact.pressure)
    )
    volumes = length * (_WEIGHTS[1] * first_volumes + _WEIGHTS[2] * last_volumes)
    after = advanced(physics, state, end, wear, volumes, energy, work, contact, then)
    if not with_errors:
        return Step(after, np.zeros_like(length), np.zeros_like(length))
    in_last = last.total_if_always_in_contact(contact.pressure)
    came = None if is_closed else entry_error(physics, closing, state, after, in_last)
    if closing is not None and weights_last is not None:
        in_last = in_last / np.where(closing.mask, 1.0, weights_last)
    errors = _errors_of(
        contacts, state, length, in_first, in_last, last, contact.pressure,
        None if closing is None else closing.mask,
    )  # fmt: skip
    after = replace(after, error=errors.at_end)
    passage = Passage.of(at_face, physics, state, after, end, sliding[2], contact.pressure, then)
    wear_error, history_error, carried_error = errors.largest
    mean_pressure = contact.force / np.maximum(touching, physics.least_area)
    if passage is not None:
        growth = passage.growth_at(mean_pressure[:, None])
        wear_error = largest(np.abs(errors.defect * growth))
    relief = errors.relief[: len(length)]
    relief = relief if came is None else np.maximum(came, np.abs(relief))
    pressure_errors = np.empty_like(length)
    # the scale is the pressure at the start, but not less than the mean at the end, and than what
    # an approach as small as the tolerance of wear presses
    least = np.maximum(mean_pressure, physics.slight_pressure)
    load(error_rows).largest_ratios(*relief.shape, relief, p_before, least, pressure_errors)
    judged = Step(
        after, wear_error, history_error, energy_error, power, pressure_errors,
        carried_error, False if is_closed else _closing(p_before, state.wear, wear),
    )  # fmt: skip
    return end_at_interfaces(contacts, state, judged, passage)


def _errors_of(
    contacts: CorrectedContacts,
    state: State,
    length: FloatArray,
    in_first: FloatArray,
    in_last: FloatArray,
    last: WearIncrement,
    p: FloatArray,
    closing: BoolArray | None,
) -> Errors:
    """Return the errors of steps from a state, estimated and propagated.

    Wear of a stage for a depth d at its start is ((I - gamma h J)^-1 - I) d, J = d rate/d depth.

    Parameters
    ----------
    length : (B,) s.
    in_first, in_last : (B, n) mm, depths of both bodies together in stages of usual length.
    last : of the last stage, at (B, n) MPa.
    closing : (B, n) elements that close a gap in the step.
    """
    slope, memory = last.slope(p), last.memory(p)
    estimates = Estimates(length, state.rates, in_first, in_last, state.error)
    errors = Errors.empty(*p.shape)
    engine = contacts.engine
    if memory is not None or not last.local or last.layered:
        left = np.arange(len(p))
    else:
        left = engine.propagate_errors(slope, closing, estimates, _ERRORS, errors)
    if len(left) == len(p):
        _set_errors(errors, engine, None, estimates, closing, last, slope, memory)
    elif len(left):
        of_left = Errors.empty(len(left), p.shape[1])
        _set_errors(
            of_left, engine, left,
            Estimates(
                length[left], state.rates.take(left, axis=1), in_first[left], in_last[left],
                state.error[left],
            ),
            None if closing is None else closing[left], last, slope[left], None,
        )  # fmt: skip
        errors.defect[left], errors.at_end[left] = of_left.defect, of_left.at_end
        errors.relief[left], errors.largest[:, left] = of_left.relief[:-SPARE_ROWS], of_left.largest
    return errors


def _set_errors(
    errors: Errors,
    engine: ContactEngine,
    histories: IntArray | None,
    estimates: Estimates,
    closing: BoolArray | None,
    last: WearIncrement,
    slope: FloatArray,
    memory: FloatArray | None,
) -> None:
    """Set the errors of steps of some histories or all, by responses to them."""
    loops, shape = load(error_rows), estimates.in_last.shape
    unfiltered, propagated = np.empty((3, *shape)), np.empty((2, *shape))
    loops.rate_errors(*shape, estimates, _ERRORS, unfiltered)
    if closing is not None:  # those make one step of first order, see ``entry_error``
        unfiltered[:2, closing] = 0.0
    ones = None if last.local else np.ones(shape)

    def relieved(growth: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the pressures that depths too many take away, and theirs times slopes."""
        reliefs = engine.response(growth, histories)
        if ones is not None:
            return reliefs, last.depth_change(slope, reliefs), ones
        return reliefs, reliefs, slope

    remembered = unfiltered if memory is None else memory, memory is not None
    # the filter: the pressure that a depth too many takes away, times d depth / d p
    reliefs, *changing = relieved(
        unfiltered if memory is None else np.concatenate([unfiltered[:1], memory * unfiltered[1:]])
    )
    errors.relief[: shape[0]] = reliefs[0]
    # (1 + (1 - 2 gamma) z) / (1 - gamma z)^2 of the error before, z being h J
    loops.propagate(
        *shape, unfiltered, *changing, *remembered, estimates, _ERRORS, errors, propagated
    )
    _, *changing = relieved(propagated if memory is None else memory * propagated)
    loops.sum_errors(*shape, propagated, *changing, *remembered, errors)


def _closing(p: FloatArray, before: FloatArray, after: FloatArray) -> BoolArray:
    """Return where elements that are apart at pressures wear, (B,), from wear before and after."""
    return ((p <= 0.0) & (after > before).any(axis=0)).any(axis=-1)


def _last_stage(
    physics: Physics,
    contacts: CorrectedContacts,
    closing: ClosingElements | None,
    end: FloatArray,
    sliding: Sliding,
    carried: FloatArray,
    step: FloatArray,
    pressure_guess: FloatArray,
) -> tuple[WearIncrement, ContactState, FloatArray | None]:
    """Return the last stage, its contact, and how many times its weight it counts, (..., n).

    Parameters
    ----------
    step : s, of the stage.
    pressure_guess : pressures near those at its end, (..., n) MPa.
    """
    if closing is None:
        last = physics.increment(end, sliding, carried, step)
        contact = contacts.solve(physics.contact_inputs(end, carried, last), pressure_guess)
        return last, contact, None
    weights = np.where(closing.mask, 1.0 + _FIRST_STAGE_FACTOR, 1.0)
    last = physics.increment(end, sliding, carried, step, closing.closing(step, weights))
    contact = contacts.solve(physics.contact_inputs(end, carried, last), pressure_guess)
    p = contact.pressure
    inside = last.share(last.depth_if_always_in_contact(p))
    if closing.force_kept:
        # the others' weight depends on what closing elements carry: so little that twice will do
        weights = np.where(closing.mask, weights, closing.stage_weights(p, weights * inside))
        last = physics.increment(end, sliding, carried, step, closing.closing(step, weights))
        solved = np.logical_not(closing.mask.any(axis=-1)), contact
        inputs = physics.contact_inputs(end, carried, last)
        again = contacts.solve(inputs, pressure_guess, already_solved=solved)
        more = np.where(solved[0], 0, contact.iterations)
        contact = replace(again, iterations=again.iterations + more)
        inside = last.share(last.depth_if_always_in_contact(contact.pressure))
    return last, contact, weights * inside
