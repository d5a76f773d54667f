"""What wear has taken of layers, and left of them."""

import itertools
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, inner
from ringwear_par.history.model import WearModel
from ringwear_par.wear.layered import worn_through


def layer_left(model: WearModel, body: int, wear: FloatArray) -> FloatArray:
    """Return what is left of all layers of a body, (..., n) mm, worn by (..., n) mm."""
    ends = model.layer_ends[body]
    assert ends is not None
    return np.where(worn_through(ends[-1], wear), 0.0, ends[-1] - wear)


def layer_volumes(model: WearModel, body: int, wear: FloatArray) -> FloatArray:
    """Return what is worn off each layer and the body itself, (..., layers + 1) mm3."""
    ends = model.layer_ends[body]
    assert ends is not None
    bounds = [np.zeros(model.line.n), *ends, np.full(model.line.n, np.inf)]
    parts: list[Any] = [
        inner(model.area, np.clip(wear, start, end) - start)
        for start, end in itertools.pairwise(bounds)
    ]
    return np.stack(parts, axis=-1)
