"""How the time of a step divides among the layers of a body."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray

#: share of the depth of a layer's end below which what is left above it is round-off
ROUND_OFF = 1e-13


def worn_through(ends: FloatArray, wear: FloatArray) -> BoolArray:
    """Tell where wear has come to the ends of layers, but for round-off.

    Parameters
    ----------
    ends : (layers, n) or (n,) float, mm, depths of the layers' ends.
    wear : (..., n) float, mm.
    """
    through: BoolArray = ends - wear <= ROUND_OFF * np.abs(ends)
    return through


@dataclass(frozen=True)
class LayerSplit:
    """How the time of a step divides among the layers of a body.

    Parameters
    ----------
    times : (layers + 1, ..., n) shares of the step.
    depths : (layers + 1, ..., n) mm, worn off each along the normal.
    worn_through : (layers, ..., n) bool, which layers are worn through by then.
    """

    times: FloatArray
    depths: FloatArray
    worn_through: FloatArray


def split(full: FloatArray, remaining: FloatArray, share: FloatArray | float) -> LayerSplit:
    """Return how wear goes through layers in a share of a step.

    A layer of which c mm are left, and which all of the step would wear by a mm, takes the share
    c / a of it, and the next one what remains.

    Parameters
    ----------
    full : (layers + 1, ..., n) mm, what each would lose in all of the step.
    remaining : (layers, ..., n) mm, of each layer.
    share : (..., n) or a number, of the step.
    """
    times, depths = np.zeros_like(full), np.zeros_like(full)
    behind = np.zeros(remaining.shape, dtype=bool)
    remains = np.broadcast_to(np.asarray(share, dtype=float), full.shape[1:])
    for number in range(len(remaining)):
        a, c = full[number], remaining[number]
        # a share that ends at the interface does so in spite of round-off
        behind[number] = through = worn_through(c, remains * a) & ((remains > 0.0) | (c <= 0.0))
        taken = np.divide(c, a, out=np.zeros_like(a), where=through & (a > 0.0))
        taken = np.where(through, np.minimum(taken, remains), remains)
        times[number] = taken
        depths[number] = np.where(through, c, taken * a)
        remains = np.where(through, remains - taken, 0.0)
    times[-1] = remains
    depths[-1] = remains * full[-1]
    return LayerSplit(times, depths, behind)


def d_split(
    full: FloatArray,
    d_full: FloatArray,
    parts: LayerSplit,
    share: FloatArray | float,
    d_share: Any = 0.0,
    d_remaining: FloatArray | None = None,
) -> FloatArray:
    """Return the derivative of the depth of all layers together, (..., n) mm over the unit varied.

    Parameters
    ----------
    d_full : (layers + 1, ..., n), perhaps of P numbers: (layers + 1, P, ..., n).
    parts : the split.
    d_share : as ``d_full`` without its first axis.
    d_remaining : (layers, ..., n) or of P numbers, of what is left.
    """
    total = np.zeros(np.broadcast_shapes(d_full.shape[1:], np.shape(d_share)))
    remains = np.broadcast_to(np.asarray(share, dtype=float), full.shape[1:])
    d_remains: Any = d_share + np.zeros_like(total)
    for number, through in enumerate(parts.worn_through):
        a, taken = full[number], parts.times[number]
        d_c = 0.0 if d_remaining is None else d_remaining[number]
        inside = d_remains * a + remains * d_full[number]
        total = total + np.where(through, d_c, inside)
        d_taken = np.divide(
            d_c - taken * d_full[number], a, out=np.zeros_like(total), where=through & (a > 0.0)
        )
        remains = np.where(through, remains - taken, 0.0)
        d_remains = np.where(through, d_remains - d_taken, 0.0)
    return total + d_remains * full[-1] + remains * d_full[-1]
