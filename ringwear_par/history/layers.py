"""Steps end about where elements reach the ends of their layers.

An element that is beyond the end of its layer has worn the next one since then. Where that changes
its depth by more than the tolerance, the step is repeated, to where the first element gets there.
"""

from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.history.block import Block
from ringwear_par.history.schemes import rates_at
from ringwear_par.history.state import State, Step

#: share of the tolerance by which steps aim to change depths where elements cross
_AIM = 0.5
#: share of a depth that is round-off
_ROUND_OFF = 1e-13
#: least rate at the end of a step, over its mean: a pressure may have fallen to the threshold
_LEAST_RATE = 0.01
#: largest factor by which errors of depth grow as elements cross
_MOST_GROWTH = 3000.0


def ends_of(block: Block, layer: IntArray) -> FloatArray:
    """Return the depths at which layers end, (w, B, n) mm."""
    return np.array(
        [
            np.take_along_axis(body.ends, here[None], axis=0)[0]
            for body, here in zip(block.wearing, layer, strict=True)
        ]
    )


def layer_volumes(area: FloatArray, ends: FloatArray, wear: FloatArray) -> FloatArray:
    """Return the worn volumes of each layer and the body itself, (B, layers + 1) mm3.

    Parameters
    ----------
    ends : (layers + 1, B, n) mm, see ``Wearing``.
    wear : (B, n) mm.
    """
    starts = np.concatenate([np.zeros_like(ends[:1]), ends[:-1]])
    worn = np.maximum(np.minimum(wear, ends) - starts, 0.0)
    return (worn @ area).T


def layer_left(ends: FloatArray, wear: FloatArray) -> FloatArray:
    """Return the thickness left of all layers of a body, (B, n) mm, see ``layer_volumes``."""
    last = ends[-2]
    return np.where(wear >= (1.0 - _ROUND_OFF) * last, 0.0, last - wear)


def enter_layers(block: Block, before: State, step: Step) -> Step:
    """Return the step with elements that are through in their next layers."""
    after, tolerance = step.state, block.tolerance[:, None]
    h = (after.time - before.time)[:, None]
    ends = ends_of(block, before.layer)
    has_end = np.isfinite(ends)
    below = before.layer + has_end
    through = after.wear >= (1.0 - _ROUND_OFF) * ends
    worn = after.wear - before.wear
    rate = np.maximum(np.maximum(after.rates, _LEAST_RATE * worn / h), 1e-300)
    at_end = np.where(through, ends, after.wear)
    next_rate = rates_at(block, below, after.time, at_end, after.pressure)
    ratio = np.where(has_end, next_rate / rate, 1.0)
    beyond = np.where(through, after.wear - ends, 0.0)
    wear = after.wear + beyond * (ratio - 1.0)
    wrong = np.abs(wear - after.wear) > tolerance
    wrong |= through & (wear > ends_of(block, below))
    too_far = wrong.any(axis=(0, 2))
    aim = np.where(has_end, _AIM * tolerance / np.maximum(np.abs(ratio - 1.0), 1e-3), 0.0)
    entered = through & ~too_far[:, None]
    layer = np.where(entered, below, before.layer)
    rates = np.where(entered, next_rate, after.rates)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(through, (ends + aim - before.wear) / worn, np.inf).min(axis=(0, 2))
        reached = before.time + h[:, 0] * np.clip(share, 0.02, 0.98)
        left = ends_of(block, layer) - wear + np.where(entered, 0.0, aim)
        soon = after.time + np.where(rates > 0.0, left / rates, np.inf).min(axis=(0, 2))
        crossed = after.time[:, None] - np.where(entered, beyond / rate, -np.inf)
    # an element crosses too late by its error over its rate, and wears faster or slower then
    more = np.where(has_end, next_rate - after.rates, 0.0).max(axis=0)
    growth = 1.0 + np.clip(more / np.maximum(after.rates.sum(axis=0), 1e-300), 0.0, _MOST_GROWTH)
    gone = before.through.copy()
    for body, here, times in zip(block.wearing, layer, crossed, strict=True):
        last = np.where(here == len(body.laws) - 1, times, np.inf).min(axis=1)
        gone[:, body.body] = np.minimum(gone[:, body.body], last)
    return replace(
        step,
        state=replace(
            after,
            wear=np.where(entered, wear, after.wear),
            rates=rates,
            layer=layer,
            through=gone,
            interface=np.where(too_far, reached, soon),
        ),
        error=step.error * growth,
        too_far=too_far,
    )
