"""Array types that the package's functions take and return."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
#: a number of a history: a float, or an array (B,) of B histories
Numbers = Any


def columns(numbers: Any) -> Any:
    """Return numbers of histories so that they go with (..., n) fields: (B,) as (B, 1).

    The number of a single history, and what has columns already, stay as they are.
    """
    return numbers[:, None] if isinstance(numbers, np.ndarray) and numbers.ndim == 1 else numbers


def inner(weights: FloatArray, values: FloatArray) -> Any:
    """Return the sums of weights (n,), or (B, n), times values (..., n): a float, or (...).

    The digits of a history among others do not depend on them: no BLAS, which rounds by how many
    there are.
    """
    if values.ndim == 1:
        return float(weights @ values)
    return np.einsum("...i,...i->...", weights, values)


def share(weights: FloatArray, which: BoolArray) -> Any:
    """Return the share of weights (n,) where it is so, (..., n): a float, or (...).

    Never more than 1, and 1 everywhere: both sums round alike.
    """
    return inner(weights, which.astype(float)) / inner(weights, np.ones(which.shape))


def rows_of(values: Any, histories: IntArray) -> Any:
    """Return numbers (B,), or fields (B, ...), of some histories; what is no array stays."""
    return values[histories] if isinstance(values, np.ndarray) and values.ndim else values


def chosen(which: Any, one: Any, other: Any) -> Any:
    """Return one where it is so, else the other: of one history, or (B,) of B."""
    return np.where(which, one, other) if isinstance(which, np.ndarray) else one if which else other


def relative(off: Any, exact: Any) -> Any:
    """Return what numbers of histories are off relative to others, 0 where those are 0 or less.

    NaN where either is.
    """
    if isinstance(exact, float):  # of one history, in every step
        return 0.0 if exact <= 0.0 else off / exact
    return np.divide(off, exact, out=np.zeros_like(exact), where=~(exact <= 0.0))


def larger(one: Any, other: Any) -> Any:
    """Return the larger of numbers of histories: floats, or arrays (B,); NaN if either is."""
    if isinstance(one, float) and isinstance(other, float):  # of one history, and quicker
        return one if one > other or one != one else other
    return np.maximum(one, other)


def smaller(one: Any, other: Any) -> Any:
    """Return the smaller of numbers of histories: floats, or arrays (B,); NaN if either is."""
    if isinstance(one, float) and isinstance(other, float):  # of one history, and quicker
        return one if one < other or one != one else other
    return np.minimum(one, other)
