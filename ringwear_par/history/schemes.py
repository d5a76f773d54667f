"""Time schemes: functions that make one step of B histories, to ends of their own.

``scheme(block, solver, state, end) -> Step``. Elements stay in their layers throughout a step.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.contact.block import BlockSolver
from ringwear_par.contact.problem import Contact
from ringwear_par.contact.tao import TaoContact
from ringwear_par.history.block import Block, total
from ringwear_par.history.state import State, Step

Solver = BlockSolver | TaoContact
Scheme = Callable[[Block, Solver, State, FloatArray], Step]

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
#: weights of the rates at 0, gamma and 1; what the integral of the quadratic through them has more
_WEIGHTS = np.array([0.0, 1.0 - GAMMA, GAMMA])
_START, _STAGE = 0.5 - 1.0 / (6.0 * GAMMA), 1.0 / (6.0 * GAMMA * (1.0 - GAMMA))
_DEFECT = np.array([_START, _STAGE, 1.0 - _START - _STAGE]) - _WEIGHTS
#: error of the depth of an element that came into contact, over its displacement or its wear
_ENTRY = 0.05


def sdirk2(block: Block, solver: Solver, state: State, end: FloatArray) -> Step:
    """Two implicit stages, L-stable and of second order; their embedded error, filtered once.

    Alexander, SIAM J. Numer. Anal. 14 (1977) 1006-1021.
    """
    h, wear, p, d = end - state.time, state.wear, state.pressure, state.approach
    times, trend = (state.time, state.time + GAMMA * h, end), state.trend
    sliding = [block.sliding(t) for t in times]
    rates, moments = [state.rates], [block.moment(p)]
    failed, sets = np.zeros(len(block), bool), np.zeros(len(block), np.int64)
    for t, slide, share in zip(times[1:], sliding[1:], ((1.0 - GAMMA) / GAMMA, 1.0), strict=True):
        stage = block.step_wear(state.layer, t, slide, wear, GAMMA * h)
        gap, load, near = block.worn_gap(wear), block.load.at(t), _near(state, t, trend)
        p, d, lost, more = solver.solve(gap, load, stage, near, d)
        depths, trend = stage.depths(p), _trend(state, t, p)
        wear = wear + (depths if share == 1.0 else share * depths)
        rates.append(depths / (GAMMA * h)[:, None])
        moments.append(block.moment(p))
        failed, sets = failed | lost, sets + more
    error = sum(c * total(rate) for c, rate in zip(_DEFECT, rates, strict=True)) * h[:, None]
    error = np.abs(solver.filtered(error, stage, p))
    entered = (state.pressure <= 0.0) & (p > 0.0)
    if entered.any():  # at some time within the step, which the stages do not know
        elastic, worn = block.compliance.diagonal * p, total(depths)
        error += np.where(entered, _ENTRY * elastic * worn / (elastic + worn + 1e-300), 0.0)
    works = np.array([omega * m for (omega, _), m in zip(sliding, moments, strict=True)])
    powers = works * np.array([friction for _, friction in sliding])
    energy, work = h * (_WEIGHTS @ powers), h * (_WEIGHTS @ works)
    after = _moved(state, end, wear, rates[-1], energy, work, Contact(p, d, failed, sets))
    energy_error, none = h * np.abs(_DEFECT @ powers), np.zeros_like(failed)
    return Step(after, error, energy_error, powers.max(axis=0), failed, none)


def implicit(block: Block, solver: Solver, state: State, end: FloatArray) -> Step:
    """The pressure at the end of a step wears throughout it (backward Euler)."""
    h, sliding, gap = end - state.time, _mean_sliding(block, state, end), block.worn_gap(state.wear)
    stage = block.step_wear(state.layer, end, sliding, state.wear, h)
    near = _near(state, end, state.trend)
    contact = solver.solve(gap, block.load.at(end), stage, near, state.approach)
    depths, work = stage.depths(contact.pressure), h * sliding[0] * block.moment(contact.pressure)
    wear, rates = state.wear + depths, depths / h[:, None]
    return _given(_moved(state, end, wear, rates, sliding[1] * work, work, contact), contact)


def explicit(block: Block, solver: Solver, state: State, end: FloatArray) -> Step:
    """The pressure at the start of a step wears throughout it, eq. (6) of the paper."""
    h, sliding, p = end - state.time, _mean_sliding(block, state, end), state.pressure
    now = block.step_wear(state.layer, state.time, sliding, state.wear, h)
    wear, work = state.wear + h[:, None] * now.rates(p), h * sliding[0] * block.moment(p)
    contact = solver.solve(block.worn_gap(wear), block.load.at(end), None, p, state.approach)
    rates = rates_at(block, state.layer, end, wear, contact.pressure)
    return _given(_moved(state, end, wear, rates, sliding[1] * work, work, contact), contact)


def _mean_sliding(block: Block, state: State, end: FloatArray) -> tuple[FloatArray, FloatArray]:
    return block.omega.mean(state.time, end), block.friction.mean(state.time, end)


def _trend(state: State, time: FloatArray, p: FloatArray) -> FloatArray:
    """Return how fast pressures (B, n) at a time have risen since the state, MPa/s."""
    return (p - state.pressure) / (time - state.time)[:, None]


def _near(state: State, time: FloatArray, trend: FloatArray) -> FloatArray:
    """Return pressures (B, n) to begin a contact from, of a trend since the state."""
    return np.maximum(state.pressure + (time - state.time)[:, None] * trend, 0.0)


def _moved(
    state: State,
    end: FloatArray,
    wear: FloatArray,
    rates: FloatArray,
    energy: FloatArray,
    work: FloatArray,
    contact: Contact,
) -> State:
    """Return states after steps that took these energies of friction, and work, (B,) N mm."""
    return replace(
        state, time=end, energy=state.energy + energy, normal_work=state.normal_work + work,
        wear=wear, rates=rates, pressure=contact.pressure, approach=contact.approach,
        trend=_trend(state, end, contact.pressure),
        iterations=state.iterations + contact.iterations,
    )  # fmt: skip


def _given(after: State, contact: Contact) -> Step:
    """Return steps whose errors nothing estimates."""
    none, fits = np.zeros_like(after.time), np.zeros_like(contact.failed)
    return Step(after, np.zeros_like(after.pressure), none, none, contact.failed, fits)


def rates_at(
    block: Block, layer: IntArray, time: FloatArray, wear: FloatArray, p: FloatArray
) -> FloatArray:
    """Return rates of wear at an instant, (w, B, n) mm/s, at the present pace."""
    ones = np.ones_like(time)
    return block.step_wear(layer, time, block.sliding(time), wear, ones).rates(p)


def settled(block: Block, solver: Solver, state: State) -> tuple[State, BoolArray]:
    """Return states whose contact is that of their profiles, and which have none, (B,)."""
    gap, load = block.worn_gap(state.wear), block.load.at(state.time)
    p, d, failed, _ = solver.solve(gap, load, None, state.pressure, state.approach)
    rates = rates_at(block, state.layer, state.time, state.wear, p)
    return replace(state, pressure=p, approach=d, rates=rates), failed


#: by the name that ``time.scheme`` gives them
BY_NAME: dict[str, Scheme] = {"adaptive": sdirk2, "implicit": implicit, "explicit": explicit}


def start(block: Block, solver: Solver) -> tuple[State, BoolArray]:
    """Return the contacts before any wear, and which failed, or have no rates."""
    zero, p, none = np.zeros(len(block)), np.zeros_like(block.gap), np.zeros(len(block), np.int64)
    wear = np.zeros((len(block.wearing), *p.shape))
    p, d, failed, iterations = solver.solve(block.gap, block.load.at(zero), None, p, zero)
    layer = np.zeros(wear.shape, np.int64)
    for i, body in enumerate(block.wearing):
        layer[i] = (body.ends <= 0.0).sum(axis=0)
    rates, never = rates_at(block, layer, zero, wear, p), np.full_like(zero, np.inf)
    state = State(
        zero, zero, zero, wear, rates, layer, p, d, d, np.zeros_like(p),
        np.full((len(block), 2), np.inf), none, iterations, zero, zero, never,
    )  # fmt: skip
    return state, failed | ~np.isfinite(rates).all(axis=(0, 2))
