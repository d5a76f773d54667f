"""Batches of histories: dataclasses of arrays with an axis of B histories, cut, joined and mixed.

A field has its histories along axis 0, unless it is declared with the metadata ``along(axis)``.
Fields that are None, and those with ``along(None)``, which all histories share, stay as they are;
dataclasses within are treated alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, TypeVar

import numpy as np

from ringwear_par.arrays import BoolArray, IntArray

T = TypeVar("T")


def along(axis: int | None) -> dict[str, int | None]:
    """Return the metadata of a field whose histories are along an axis; None: along none."""
    return {"histories": axis}


def take(batch: T, histories: IntArray) -> T:
    """Return some of the histories of a batch, in the order of their numbers (h,)."""
    return _apply(lambda axis, values: values.take(histories, axis), batch)


def keep(holder: object, names: Sequence[str], histories: IntArray) -> None:
    """Leave some of the histories in attributes of an object, (B, ...) each."""
    for name in names:
        setattr(holder, name, getattr(holder, name)[histories])


def one(batch: T, history: int) -> T:
    """Return one of the histories of a batch, without the axis."""
    return _apply(lambda axis, values: np.take(values, history, axis), batch)


def concat(batches: Sequence[T]) -> T:
    """Return one batch of the histories of several."""
    return _apply(lambda axis, *values: np.concatenate(values, axis), *batches)


def where(accepted: BoolArray, new: T, old: T) -> T:
    """Return a batch whose histories are the new ones where accepted (B,), else the old ones."""

    def choose(axis: int, after: Any, before: Any) -> Any:
        trailing = np.ndim(after) - axis - 1
        return np.where(accepted.reshape(-1, *(1,) * trailing), after, before)

    return _apply(choose, new, old)


def _apply(function: Callable[..., Any], first: Any, *further: Any) -> Any:
    changed: dict[str, Any] = {}
    for name, axis in _fields(type(first)):
        value, more = getattr(first, name), [getattr(batch, name) for batch in further]
        if axis is None or value is None or (more and any(entry is None for entry in more)):
            changed[name] = value
        elif isinstance(value, np.ndarray) or not is_dataclass(value):
            changed[name] = function(axis, value, *more)
        else:
            changed[name] = _apply(function, value, *more)
    return type(first)(**changed)


def _declared(batch: type) -> tuple[tuple[str, int | None], ...]:
    """Return the fields that make a batch, with the axes of their histories."""
    return tuple((f.name, f.metadata.get("histories", 0)) for f in fields(batch) if f.init)


_fields: Callable[[type], tuple[tuple[str, int | None], ...]] = cache(_declared)
