"""Elements beside an edge of contact that can move, whose values are less right than others'."""

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray

#: by which the pressure of such an element may be off, relative to the largest (docs/accuracy.md)
EDGE_ERROR = 0.28


def edge_elements(pressure: FloatArray) -> BoolArray:
    """Return where elements lie beside an edge of contact: the last closed and the first open one.

    Contact that reaches an end of the contact line has no such element there. Not collective.

    Parameters
    ----------
    pressure : (..., n) MPa; NaN: there is no such element.
    """
    closed, known = pressure > 0.0, ~np.isnan(pressure)
    edge = (closed[..., 1:] != closed[..., :-1]) & known[..., 1:] & known[..., :-1]
    beside = np.zeros(np.shape(pressure), dtype=bool)
    beside[..., 1:] |= edge
    beside[..., :-1] |= edge
    return beside
