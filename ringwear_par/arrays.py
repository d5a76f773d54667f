"""Types of arrays."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def read_only(values: FloatArray) -> FloatArray:
    """Return a view that cannot be written to."""
    view = values.view()
    view.flags.writeable = False
    return view
