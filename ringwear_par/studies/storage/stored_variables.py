"""What a sweep stores of each case, by the axes that it runs over.

Beside what every case has, there is what cases with layers have, and those with [stress].
"""

from collections.abc import Mapping
from typing import Any

from ringwear_par.results.variables import (
    HISTORIES,
    LARGEST_STRESS,
    LAYER,
    LAYER_HISTORIES,
    LAYER_PROFILES,
    LAYER_STRESS,
    LAYER_VOLUMES,
    LINE,
    POINT_STRESS,
    POINTS,
    PROFILES,
    TIMES_THROUGH,
    UPPER_LAYER,
    Variable,
)

#: at each stored state a number, or one a layer or point: padded with NaN where cases have others
STRESS = {**LARGEST_STRESS, **LAYER_STRESS, **POINT_STRESS}
ROWS = {**HISTORIES, **LAYER_HISTORIES, **LAYER_VOLUMES, **STRESS}
#: along the contact line, at each stored state or at the last one
FIELDS = {**PROFILES, **LAYER_PROFILES}
#: a number of each case, or one a point
EACH = {**TIMES_THROUGH, **POINTS}
_NUMBERS = {**ROWS, **EACH}
#: what not all cases have
OPTIONAL = tuple(name for name in (*FIELDS, *ROWS, *EACH) if name not in HISTORIES)
#: axes beside those of steps and elements, and their coordinates
AXES = {
    LAYER.name: LAYER,
    UPPER_LAYER.name: UPPER_LAYER,
    "point": Variable("point", ("point",), "1", "point of stress.points", integer=True),
}
#: in the place of a layer's number, since cases of a sweep may have other numbers of layers
BODY = "body"


def axis_of(variable: Variable) -> str:
    """Return the axis of a variable beside steps and elements, "" where it has none."""
    return next((name for name in variable.dimensions if name in AXES), "")


def has_layers(variable: Variable) -> bool:
    """Tell whether a variable runs over layers; the last number is of the body itself."""
    return axis_of(variable) in (LAYER.name, UPPER_LAYER.name)


def entries_of(variable: Variable, size: int) -> tuple[str, ...]:
    """Return the names of the numbers of a variable with such an axis."""
    numbers = tuple(map(str, range(size)))
    return (*numbers[:-1], BODY) if has_layers(variable) else numbers


def told_entry(variable: Variable, entry: str) -> str:
    """Return what one of the numbers of a variable with such an axis is called."""
    if entry == BODY:
        return "the body itself"
    return f"{axis_of(variable).removesuffix('_upper')} {entry}"


def sizes_of(arrays: Mapping[str, Any]) -> dict[str, int]:
    """Return the sizes of such axes of a case's arrays, or of those of cases of one pair."""
    return {
        axis: int(values.shape[-1])
        for name, values in arrays.items()
        if name in _NUMBERS and (axis := axis_of(_NUMBERS[name]))
    }


def is_wide(name: str) -> bool:
    """Tell whether a variable has more than a number at each state, or of each case."""
    variable = _NUMBERS.get(name)
    return name in FIELDS or name in LINE or (variable is not None and bool(axis_of(variable)))


def width(name: str, elements: int, sizes: Mapping[str, int]) -> int:
    """Return how many numbers a variable has at each state, or of each case."""
    if not is_wide(name):
        return 1
    return elements if name in FIELDS or name in LINE else sizes[axis_of(_NUMBERS[name])]
