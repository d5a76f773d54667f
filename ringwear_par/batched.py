"""Blocks of B histories: arrays, and dataclasses of arrays, cut and mixed along their histories.

Histories are the only axis of numbers (B,), and the last axis but one of fields (..., B, n). A
dataclass with ``shared = True`` belongs to all histories and stays as it is.
"""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ringwear_par.arrays import BoolArray, IntArray

T = TypeVar("T")


def take(block: T, histories: IntArray) -> T:
    """Return some of the histories of a block, in the order of their numbers (h,)."""
    return _mapped(lambda a: a[histories] if a.ndim == 1 else a[..., histories, :], block)


def choose(which: BoolArray, new: T, old: T) -> T:
    """Return a block whose histories are the new ones where so, (B,), else the old ones."""

    def mixed(a: Any, b: Any) -> Any:
        return a if a is b else np.where(which if a.ndim == 1 else which[:, None], a, b)

    return _mapped(mixed, new, old)


def _mapped(function: Callable[..., Any], first: Any, *others: Any) -> Any:
    """Return what holds arrays with a function of each; all else is that of the first."""
    if isinstance(first, np.ndarray):
        return function(first, *others)
    if isinstance(first, dict):
        return {key: _mapped(function, first[key], *(o[key] for o in others)) for key in first}
    if isinstance(first, tuple) and not hasattr(first, "_fields"):
        return tuple(_mapped(function, *values) for values in zip(first, *others, strict=True))
    if is_dataclass(first) and not isinstance(first, type) and not getattr(first, "shared", False):
        changes = {}
        for field in (field for field in fields(first) if field.init):
            value = getattr(first, field.name)
            new = _mapped(function, value, *(getattr(other, field.name) for other in others))
            if new is not value:
                changes[field.name] = new
        return replace(first, **changes)
    return first
