"""Array types, and functions of arrays."""

import warnings
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: size of a complex step: its square is lost in round-off
COMPLEX_STEP = 1e-30
#: relative step of differences: their error is its square, their round-off eps over it
_STEP = 1e-5
#: relative deviation from the difference at which a complex step counts as failed
_AGREEMENT = 1e-5


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


def derivative(
    function: Callable[[Any], FloatArray], x: float | FloatArray, smallest: float
) -> FloatArray:
    """Return the derivative of a function whose every value depends on one entry of x only.

    A one-sided difference of second order, which needs nothing below x, where rates may have no
    sense; its place is taken by the complex step, exact to round-off, wherever the two agree: code
    that takes absolute values, interpolates or casts loses the imaginary part.

    Parameters
    ----------
    function : of arrays of the shape of x, real ones and perhaps complex ones.
    x : a number or an array that broadcasts against the function's values.
    smallest : what counts as the size of smaller entries of x.
    """
    h = _STEP * np.maximum(np.abs(x), smallest)
    start, near, far = function(x), function(x + h), function(x + 2.0 * h)
    difference = (4.0 * near - 3.0 * start - far) / (2.0 * h)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            with np.errstate(over="ignore"):
                exact = np.imag(function(x + 1j * COMPLEX_STEP)) / COMPLEX_STEP
    except Exception:  # whatever code that was written for real numbers may raise
        return difference
    with np.errstate(over="ignore", invalid="ignore"):  # where there is no number
        larger = np.maximum(np.abs(exact), np.abs(difference))
        agree = np.abs(exact - difference) <= _AGREEMENT * larger
    return np.where(agree & np.isfinite(exact), exact, difference)
