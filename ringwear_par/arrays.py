"""Array types, and functions of arrays."""

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def relative(off: Any, exact: Any) -> Any:
    """Return the errors ``off`` over the exact numbers, 0 where those are 0 or less.

    NaN where either is.
    """
    return np.divide(off, exact, out=np.zeros_like(exact), where=~(exact <= 0.0))


def read_only(values: FloatArray) -> FloatArray:
    """Return a view that cannot be written to."""
    view = values.view()
    view.flags.writeable = False
    return view


def short_repr(data: Any) -> str:
    """Return the repr of a dataclass with the shapes of its arrays."""

    def text(value: Any) -> str:
        return f"array{value.shape}" if isinstance(value, np.ndarray) else repr(value)

    parts = (
        f"{field.name}={text(getattr(data, field.name))}" for field in fields(data) if field.repr
    )
    return f"{type(data).__name__}({', '.join(parts)})"
