"""Array types that the package's functions take and return."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def columns(x: FloatArray) -> FloatArray:
    """Return numbers of B histories, (B,), as (B, 1), so that they go with (B, n) elements."""
    return x[:, None] if x.ndim == 1 else x
