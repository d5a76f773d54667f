"""How far steps go, and whether they are good."""

from dataclasses import replace

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.batched import choose
from ringwear_par.history.block import Block
from ringwear_par.history.state import State, Step

_SAFETY, _MOST_GROWTH, _MOST_CUT, _AFTER_FAILURE = 0.82, 5.0, 0.1, 0.25
#: error of each step over the tolerance of wear of the whole history, and a factor of it with
#: layers, at whose ends errors grow: 95 of 100 random histories are within the tolerance so
STEP_SHARE, _LAYERED = 0.125, 0.25
#: wear of the first step, in tolerances: edges wear fast and not for long
_FIRST_WEAR = 50.0
#: error of the dissipated energy of one step, over that of the history if the power stayed
_ENERGY = 1e-4
#: shortest step, over the length of the history; of a given step, over its own mean length
_SHORTEST, _SHORTEST_PART = 1e-12, 1e-3


def _share(block: Block) -> float:
    """Return the share of the tolerance that the error of each step may be."""
    return STEP_SHARE * (_LAYERED if block.layered else 1.0)


def first_length(block: Block, state: State) -> FloatArray:
    """Return the lengths of the first tries, (B,) s; those of given steps go to the first limit."""
    whole = block.limits[:, -1]
    if block.given_steps:
        return whole
    with np.errstate(divide="ignore"):
        fastest = state.rates.max(axis=(0, 2), initial=0.0)
        return np.minimum(_FIRST_WEAR * _share(block) * block.tolerance / fastest, whole)


def next_ends(
    block: Block, state: State, limit: IntArray, going: BoolArray
) -> tuple[FloatArray, BoolArray]:
    """Return the ends of the next steps, (B,) s, and whether a limit of time cuts them.

    Parameters
    ----------
    limit : (B,) which of the block's limits is next.
    """
    until, time = block.limits[np.arange(len(block)), limit], state.time
    due = (state.interface > time) & (state.interface < until)
    left = np.where(due, state.interface, until) - time
    is_cut = (state.length >= left * (1.0 - 1e-9)) & going
    # where the step after this one would be tiny, halves; what idle ones do is not looked at
    half = (state.length > 0.9 * left) & going
    end = time + np.where(half, 0.5 * left, state.length)
    return np.where(is_cut, np.where(due, state.interface, until), end), is_cut


def judge(
    block: Block, before: State, step: Step, is_cut: BoolArray, going: BoolArray
) -> tuple[BoolArray, BoolArray, State]:
    """Return which steps are accepted, which histories are stuck, (B,), and their states now."""
    error, h, whole = _error(block, step), step.state.time - before.time, block.limits[:, -1]
    good = (error <= 1.0) & ~step.failed
    accepted = good & ~step.too_far & going
    change = np.clip(_SAFETY * np.maximum(error, 1e-6) ** (-1.0 / 3.0), _MOST_CUT, _MOST_GROWTH)
    change[step.failed | ~np.isfinite(error)] = _AFTER_FAILURE
    if block.given_steps:
        length = np.where(good, whole, _AFTER_FAILURE * h)
    else:
        length = np.where(is_cut & good, np.maximum(h * change, before.length), h * change)
    next_one = np.where(step.too_far, step.state.interface - before.time, length)
    # parts of given steps whose contacts are not solved need not become as short
    failing = step.failed & block.given_steps
    shortest = np.where(failing, _SHORTEST_PART / block.limits.shape[1], _SHORTEST)
    stuck = going & ~accepted & ~(next_one > shortest * whole)  # or NaN
    after = replace(step.state, error=np.maximum(before.error, error * block.tolerance))
    state = replace(
        after if accepted.all() else choose(accepted, after, before),
        iterations=after.iterations,  # those of rejected tries count, too
        length=np.where(going, length, before.length),
        interface=np.where(going, step.state.interface, np.inf),
    )
    return accepted, stuck, state


def _error(block: Block, step: Step) -> FloatArray:
    """Return the errors of steps over those that are allowed, (B,); 0 of given steps."""
    if block.given_steps:
        return np.zeros(len(block))
    left = np.maximum(block.limits[:, -1] - step.state.time, 0.0)
    energy = step.energy_error / (_ENERGY * (step.state.energy + step.power * left) + 1e-300)
    return np.maximum(step.error.max(axis=1) / (_share(block) * block.tolerance), energy)
