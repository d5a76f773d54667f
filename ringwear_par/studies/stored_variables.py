"""The variables of a sweep's files, in one table: of its cases, and of each case over them all."""

from dataclasses import replace

from ringwear_par.results.laboratory_numbers import LABORATORY_NUMBERS
from ringwear_par.results.variables import (
    HISTORIES,
    LARGEST_STRESS,
    LAYER,
    LAYER_HISTORIES,
    LAYER_PROFILES,
    LAYER_STRESS,
    LAYER_VOLUMES,
    LINE,
    POINT,
    POINT_STRESS,
    POINTS,
    PROFILES,
    TIMES_THROUGH,
    UPPER_LAYER,
    Variable,
)

#: at the stored states that stress is computed for
STRESS = {**LARGEST_STRESS, **LAYER_STRESS, **POINT_STRESS}
#: at each stored state a number, or one a layer or point: padded with NaN where cases have others
AT_STATES = {**HISTORIES, **LAYER_HISTORIES, **LAYER_VOLUMES, **STRESS}
#: along the contact line, at each stored state or at the last one
FIELDS = {**PROFILES, **LAYER_PROFILES}
#: a number of each case, or one a point
OF_A_CASE = {
    **TIMES_THROUGH, **POINTS,
    **{name: replace(v, dimensions=()) for name, v in LABORATORY_NUMBERS.items()},
}  # fmt: skip
#: the stored variables of a case's history; all but ``HISTORIES`` are of some cases only
STORED = {**AT_STATES, **LINE, **FIELDS, **OF_A_CASE}

#: variables of results.h5 with dimension (case,)
OF_CASES = {
    variable.name: variable
    for variable in (
        Variable("status", ("case",), "1", "done, failed or incomplete"),
        Variable("error", ("case",), "1", "why the case failed"),
        Variable(
            "flags", ("case",), "1",
            "what makes the answer doubtful or ended the case early, separated by commas",
        ),
        Variable("seconds", ("case",), "s", "wall time of the case"),
        Variable(
            "imbalance", ("case",), "1",
            "worst balance of force, volume, energy or KKT residual of its steps",
        ),
        Variable("steps_stored", ("case",), "1", "number of stored steps", integer=True),
        Variable("elements", ("case",), "1", "number of contact elements", integer=True),
    )
}  # fmt: skip

#: axes other than those of steps and elements, and their coordinates
AXES = {axis.name: axis for axis in (LAYER, UPPER_LAYER, POINT)}
#: replaces a layer's number, since cases of a sweep may have other numbers of layers
BODY = "body"


def over_cases(variable: Variable) -> Variable:
    """Return a variable of one case as the results of all have it, padded with NaN."""
    return replace(variable, dimensions=("case", *variable.dimensions), integer=False)


def axis_of(variable: Variable) -> str:
    """Return the axis of a variable other than steps and elements, "" where it has none."""
    return next((name for name in variable.dimensions if name in AXES), "")


def has_layers(variable: Variable) -> bool:
    """Tell whether a variable runs over layers; the last number is of the body itself."""
    return axis_of(variable) in (LAYER.name, UPPER_LAYER.name)


def entry_names(variable: Variable, size: int) -> tuple[str, ...]:
    """Return the names of the numbers of a variable with such an axis."""
    numbers = tuple(map(str, range(size)))
    return (*numbers[:-1], BODY) if has_layers(variable) else numbers


def entry_label(variable: Variable, entry: str) -> str:
    """Return the name in sentences of one of the numbers of a variable with such an axis."""
    if entry == BODY:
        return "the body itself"
    return f"{axis_of(variable).removesuffix('_upper')} {entry}"
