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
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, columns, largest
from ringwear_par.compiled import step_rows
from ringwear_par.compiled.machine_code import load
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.problem import ContactState
from ringwear_par.history.physics import Physics, Sliding
from ringwear_par.history.schemes.closing_elements import (
    ClosingElements,
    entry_error,
    find_closing_elements,
)
from ringwear_par.history.schemes.interfaces import Passage, end_at_interfaces
from ringwear_par.history.schemes.step import Step, advanced
from ringwear_par.history.schemes.tangent import StepTangent, tangent_of_step
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
    physics = physics.in_present_layers(state.wear)
    length = end - state.time
    middle = state.time + GAMMA * length
    sliding = [physics.sliding(t) for t in (state.time, middle, end)]

    closing = find_closing_elements(physics, state, length)
    gap_closing = (
        None if closing is None else closing.closing(GAMMA * length, np.ones_like(closing.gap))
    )
    first = physics.increment(middle, sliding[1], state.wear, GAMMA * length, gap_closing)
    step_tangent = tangent_of_step(physics, contacts, state, end, middle, closing)
    stage = contacts.solve(
        physics.contact_inputs(middle, state.wear, first),
        state.contact.pressure,
        tangents=step_tangent,
    )
    worn_first = first.depth_if_always_in_contact(stage.pressure)
    weights = 1.0 if closing is None else closing.stage_weights(stage.pressure, 0.0)
    carried = state.wear + (_FIRST_STAGE_FACTOR * weights) * worn_first
    if step_tangent is not None:
        step_tangent.first_stage(stage.pressure, weights, _FIRST_STAGE_FACTOR)
    last, contact, weights_last = _last_stage(
        physics, contacts, closing, end, sliding[2], carried, length, stage.pressure, step_tangent
    )
    worn_last = last.depth_if_always_in_contact(contact.pressure)
    losses = worn_last if closing is None else last.depths(contact.pressure)

    pressures = (
        state.contact.pressure, _weighted(weights, stage.pressure),
        _weighted(weights_last, contact.pressure),
    )  # fmt: skip
    moments = np.array([physics.moment(p) for p in pressures])
    omega, friction = (np.array(of) for of in zip(*sliding, strict=True))
    powers, normal_powers = omega * (friction * moments), omega * moments
    contact = replace(
        contact,
        iterations=stage.iterations + contact.iterations,
        residual=np.maximum(stage.residual, contact.residual),
    )
    energy, work = (length * _sum(_WEIGHTS, power) for power in (powers, normal_powers))
    wear = carried + losses
    then = last.rates(contact.pressure, worn_last)
    volumes = length * (
        _WEIGHTS[1] * physics.integrals(_weighted(weights, first.rates(stage.pressure, worn_first)))
        + _WEIGHTS[2] * physics.integrals(_weighted(weights_last, then))
    )
    if not physics.inputs.rates_last:
        then = physics.rates(end, sliding[2], wear, contact.pressure)
    if step_tangent is not None:
        step_tangent.last_stage(last, contact.pressure, GAMMA * length)
        for i, d_p in enumerate(step_tangent.weighted, start=1):
            step_tangent.work(_WEIGHTS[i] * length, sliding[i], pressures[i], d_p)
    after = advanced(physics, state, end, wear, volumes, energy, work, contact, then, step_tangent)
    if not with_errors:
        return Step(after, np.zeros_like(length), np.zeros_like(length))
    stages = (first, stage.pressure), (last, contact.pressure)
    in_first, in_last = (wear_of.total_if_always_in_contact(p) for wear_of, p in stages)
    if closing is not None:
        in_last = in_last / np.where(closing.mask, 1.0, weights_last)
    came = entry_error(physics, closing, state, after, worn_last)
    errors = _errors_of(
        contacts, state, length, in_first, in_last, last, contact.pressure, worn_last,
        None if closing is None else closing.mask,
    )  # fmt: skip
    after = replace(after, error=errors.at_end)
    passage = Passage.of(physics, state, after, end, sliding[2], contact.pressure)
    wear_error = errors.of_step
    if passage is not None:
        growth = passage.growth_at(_mean_pressure(physics, contact))
        wear_error = largest(np.abs(errors.defect * growth))
    relief = errors.relief if came is None else np.maximum(came, np.abs(errors.relief))
    pressure_errors = np.empty_like(length)
    load(step_rows).largest_ratios(
        *relief.shape, relief, state.contact.pressure, _least_scale(physics, contact),
        pressure_errors,
    )  # fmt: skip
    judged = Step(
        after,
        wear_error,
        errors.of_history,
        np.abs(length * _sum(_DEFECT, powers)),
        powers.max(axis=0),
        pressure_errors,
        errors.of_before,
        _closing(state.contact.pressure, losses),
    )
    return end_at_interfaces(contacts, state, judged, passage, step_tangent)


class _Errors(NamedTuple):
    """Estimated errors of steps and histories."""

    #: (B, n) mm, of the wear of steps, and of histories at their ends
    defect: FloatArray
    at_end: FloatArray
    #: (B, n) MPa, the pressure that a step's unfiltered error takes away
    relief: FloatArray
    #: (B,) mm, the largest of the steps, of the histories, and of these what was before the steps
    of_step: FloatArray
    of_history: FloatArray
    of_before: FloatArray


def _errors_of(
    contacts: CorrectedContacts,
    state: State,
    length: FloatArray,
    in_first: FloatArray,
    in_last: FloatArray,
    last: WearIncrement,
    p: FloatArray,
    worn_last: FloatArray,
    closing: BoolArray | None,
) -> _Errors:
    """Return the errors of steps from a state, estimated and propagated.

    Wear of a stage for a depth d at its start is ((I - gamma h J)^-1 - I) d, J = d rate/d depth.

    Parameters
    ----------
    length : (B,) s.
    in_first, in_last : (B, n) mm, depths of both bodies together in stages of usual length.
    last : of the last stage, at (B, n) MPa, in which bodies lose ``worn_last`` (2, B, n) mm.
    closing : (B, n) elements that close a gap in the step.
    """
    loops, shape = load(step_rows), in_last.shape
    errors, propagated = np.empty((3, *shape)), np.empty((2, *shape))
    loops.rate_errors(
        *shape, length, state.rates, in_first, in_last, state.error, _DEFECT, GAMMA, errors
    )
    if closing is not None:  # those make one step of first order, see ``entry_error``
        errors[:2, closing] = 0.0
    slope, memory = last.slope(p), last.memory(p, worn_last)
    respond, forgets = contacts.engine.derivatives.response, isinstance(memory, float)
    remembered = (errors if isinstance(memory, float) else memory), not forgets
    # the filter: the pressure that a depth too many takes away, times d depth / d p
    growth = errors if forgets else np.concatenate([errors[:1], memory * errors[1:]])
    reliefs = respond(growth)
    # (1 + (1 - 2 gamma) z) / (1 - gamma z)^2 of the error before, z being h J
    defect, at_end, sizes = np.empty(shape), np.empty(shape), np.empty((3, len(length)))
    changes = last.depth_change(slope, reliefs)
    loops.propagate(
        *shape,
        errors,
        changes,
        *remembered,
        state.error,
        _LACKING / GAMMA,
        _FIRST_STAGE_FACTOR,
        defect,
        propagated,
    )
    changes = last.depth_change(slope, respond(propagated if forgets else memory * propagated))
    loops.sum_errors(*shape, propagated, changes, *remembered, defect, at_end, sizes)
    return _Errors(defect, at_end, reliefs[0], *sizes)


def _closing(p: FloatArray, losses: FloatArray) -> BoolArray:
    """Return where elements that are apart at pressures wear, (B,)."""
    if p.min() > 0.0:
        return np.zeros(len(p), dtype=bool)
    return ((p <= 0.0) & (losses > 0.0).any(axis=0)).any(axis=-1)


def _weighted(weights: FloatArray | float, values: FloatArray) -> FloatArray:
    """Return weights times values; a number stands for 1, where no elements close."""
    return values if isinstance(weights, float) else weights * values


def _sum(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Return the weighted sum of values at the start and of both stages, (3, B), term by term."""
    start, stage, last = weights.tolist()
    total: FloatArray = start * values[0] + stage * values[1] + last * values[2]
    return total


def _last_stage(
    physics: Physics,
    contacts: CorrectedContacts,
    closing: ClosingElements | None,
    end: FloatArray,
    sliding: Sliding,
    carried: FloatArray,
    length: FloatArray,
    pressure_guess: FloatArray,
    step_tangent: StepTangent | None,
) -> tuple[WearIncrement, ContactState, FloatArray | float]:
    """Return the last stage, its contact, and how many times its weight it counts, (..., n).

    ``pressure_guess`` are pressures near those at its end, (..., n) MPa.
    """
    step = GAMMA * length
    if closing is None:
        last = physics.increment(end, sliding, carried, step)
        contact = contacts.solve(
            physics.contact_inputs(end, carried, last), pressure_guess, tangents=step_tangent
        )
        return last, contact, 1.0
    weights = np.where(closing.mask, 1.0 + _FIRST_STAGE_FACTOR, 1.0)
    last = physics.increment(end, sliding, carried, step, closing.closing(step, weights))
    contact = contacts.solve(
        physics.contact_inputs(end, carried, last), pressure_guess, tangents=step_tangent
    )
    p = contact.pressure
    inside = last.share(last.depth_if_always_in_contact(p))
    if closing.force_kept:
        # the others' weight depends on what closing elements carry: so little that twice will do
        if step_tangent is not None:
            step_tangent.lengthen(last, p, step)
        weights = np.where(closing.mask, weights, closing.stage_weights(p, weights * inside))
        last = physics.increment(end, sliding, carried, step, closing.closing(step, weights))
        solved = np.logical_not(closing.mask.any(axis=-1)), contact
        inputs = physics.contact_inputs(end, carried, last)
        again = contacts.solve(inputs, pressure_guess, already_solved=solved, tangents=step_tangent)
        more = np.where(solved[0], 0, contact.iterations)
        contact = replace(again, iterations=again.iterations + more)
        inside = last.share(last.depth_if_always_in_contact(contact.pressure))
    return last, contact, weights * inside


def _least_scale(physics: Physics, after: ContactState) -> FloatArray:
    """Return the least scale of errors of pressure, (B,) MPa; it is the pressure at the start.

    The mean pressure at the end, but not less than what an approach as small as the tolerance of
    wear presses.
    """
    return np.maximum(_mean_pressure(physics, after)[:, 0], physics.slight_pressure)


def _mean_pressure(physics: Physics, contact: ContactState) -> FloatArray:
    """Return the force over the area in contact, MPa, a number or (B, 1)."""
    touching = physics.area_in_contact(contact.pressure)
    return columns(contact.force / np.maximum(touching, physics.area.min()))
