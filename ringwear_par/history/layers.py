"""What wear has taken of layers, and left of them."""

import itertools
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, inner
from ringwear_par.history.physics import Physics
from ringwear_par.wear.layered import worn_through


def layer_left(physics: Physics, body: int, wear: FloatArray) -> FloatArray:
    """Return what is left of all layers of a body, (..., n) mm, worn by (..., n) mm."""
    ends = physics.layer_ends[body]
    assert ends is not None
    return np.where(worn_through(ends[-1], wear), 0.0, ends[-1] - wear)


def layer_volumes(physics: Physics, body: int, wear: FloatArray) -> FloatArray:
    """Return what is worn off each layer and the body itself, (..., layers + 1) mm3."""
    ends = physics.layer_ends[body]
    assert ends is not None
    bounds = [np.zeros(physics.line.n), *ends, np.full(physics.line.n, np.inf)]
    parts: list[Any] = [
        inner(physics.area, np.clip(wear, start, end) - start)
        for start, end in itertools.pairwise(bounds)
    ]
    return np.stack(parts, axis=-1)
