"""What a sweep stores: the variables of its cases, and the end values that tables and figures show.

End values are columns of ``cases.csv``, variables ``final_...`` of ``results.h5``, and what
surrogates answer for.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.units import in_signs
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.results.variables import (
    DISPLAY_UNITS,
    HISTORIES,
    LABORATORY_NUMBERS,
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

# -- variables of cases ----------------------------------------------------------------------------

#: at the stored states that stress is computed for
STRESS = {**LARGEST_STRESS, **LAYER_STRESS, **POINT_STRESS}
#: along the contact line, at each stored state or at the last one
FIELDS = {**PROFILES, **LAYER_PROFILES}
#: a number of each case, or one a point
OF_A_CASE = {
    **TIMES_THROUGH, **POINTS,
    **{
        name: replace(
            number, dimensions=("case",), meaning=f"{number.meaning}, at the last stored step"
        )
        for name, number in LABORATORY_NUMBERS.items()
    },
}  # fmt: skip
#: of a case's history; all but ``HISTORIES`` are of some cases only, padded with NaN in the others
STORED = {
    **HISTORIES, **LAYER_HISTORIES, **LAYER_VOLUMES, **STRESS, **LINE, **FIELDS, **OF_A_CASE,
}  # fmt: skip
#: about each case
OF_CASES = {
    variable.name: variable
    for variable in (
        Variable("case", ("case",), "1", "case, by its content"),
        Variable("number", ("case",), "1", "number of the case in the design", integer=True),
        Variable("status", ("case",), "1", "done, failed or incomplete"),
        Variable("error", ("case",), "1", "why the case failed"),
        Variable(
            "flags", ("case",), "1",
            "what makes the answer doubtful or ended the case early, separated by commas",
        ),
        Variable("seconds", ("case",), "s", "wall time of the case"),
        Variable(
            "imbalance", ("case",), "1",
            "worst balance of force, energy or contact, eq. (3), of its steps",
        ),
        Variable("steps_stored", ("case",), "1", "number of stored steps", integer=True),
        Variable("elements", ("case",), "1", "number of contact elements", integer=True),
    )
}  # fmt: skip

#: axes other than those of steps and elements, and their coordinates
AXES = {axis.name: axis for axis in (LAYER, UPPER_LAYER, POINT)}
#: replaces a layer's number, since cases of a sweep may have other numbers of layers
BODY = "body"


def axis_of(variable: Variable) -> str:
    """Return the axis of a variable other than steps and elements, "" where it has none."""
    return next((name for name in variable.dimensions if name in AXES), "")


def has_layers(variable: Variable) -> bool:
    """Tell whether a variable runs over layers; the last number is of the body itself."""
    return axis_of(variable) in (LAYER.name, UPPER_LAYER.name)


# -- end values ------------------------------------------------------------------------------------

#: end values that all cases have
MAIN_END_VALUES = ("penetration", "worn_volume_lower", "worn_volume_upper")
#: the variable that is finite at the states with stress
STRESS_STATES = "max_mises"
_ENTRY = re.compile(rf"(.+)\[(\d+|{BODY})\]")


@dataclass(frozen=True)
class EndValue:
    """A number of each case, or of each of its layers or points, each a column of ``cases.csv``."""

    #: in the table
    name: str
    #: name of the variable that it is taken of
    source: str
    #: the variable of the results file
    stored: Variable
    #: whether surrogates answer for it: places of the largest stress jump, numbers of laboratories
    #: follow from others
    smooth: bool

    def of(self, tables: Mapping[str, Any]) -> FloatArray:
        """Return the values of cases, (cases,) or (cases, layers or points), NaN without any.

        Of their variables, (cases, ...) by name: the last stored row, of stress the last that has
        some; of fields the least along the contact line.
        """
        table, last = tables[self.source], tables["steps_stored"] - 1
        if self.source in STRESS:
            with_stress = np.isfinite(tables[STRESS_STATES])
            last = table.shape[1] - 1 - with_stress[:, ::-1].argmax(axis=1)
            last = np.where(with_stress.any(axis=1), last, -1)
        some = np.flatnonzero(last >= 0)
        if self.source in OF_A_CASE or (self.source in FIELDS and table.ndim == 2):
            rows = table[some]
        else:
            rows = table[some, last[some]]
        if self.source in FIELDS:
            least = np.min(rows, axis=-1, where=np.isfinite(rows), initial=np.inf)
            rows = np.where(np.isfinite(least), least, np.nan)
        values = np.full((len(table), *rows.shape[1:]), np.nan)
        values[some] = rows
        return values


def _end_value(source: Variable) -> EndValue:
    """Return the end value of a variable by what kind it is of."""
    name, meaning, smooth = source.name, source.meaning, True
    axes = ("case", axis_of(source)) if axis_of(source) else ("case",)
    if name in OF_A_CASE:
        return EndValue(
            name, name, replace(source, dimensions=axes), smooth=name not in LABORATORY_NUMBERS
        )
    when = "at the last stored step"
    stored = f"final_{name}"
    if name in STRESS:
        when, smooth = "at the last time that it is stored of", source.unit == "MPa"
    elif name in FIELDS:
        name, stored, meaning = f"least_{name}", f"final_least_{name}", f"least {meaning}"
    variable = Variable(stored, axes, source.unit, f"{meaning}, {when}")
    return EndValue(name, source.name, variable, smooth)


_BY_BODY = zip(
    *(table.values() for table in (LAYER_VOLUMES, LAYER_HISTORIES, TIMES_THROUGH, LAYER_PROFILES)),
    strict=True,
)
#: in the order of the table
END_VALUES = {
    end_value.name: end_value
    for end_value in map(
        _end_value,
        (
            *(HISTORIES[name] for name in MAIN_END_VALUES),
            *(OF_A_CASE[name] for name in LABORATORY_NUMBERS),
            *(variable for of_a_body in _BY_BODY for variable in of_a_body),
            *STRESS.values(),
        ),
    )
}


def end_value_of(name: str) -> tuple[EndValue, str]:
    """Return the end value that a column is of, and its entry, "" where it has but one."""
    match = _ENTRY.fullmatch(name)
    return (END_VALUES[match[1]], match[2]) if match else (END_VALUES[name], "")


def entries(end_value: EndValue, values: FloatArray) -> dict[str, FloatArray]:
    """Return numbers of cases by their names, the last axis of those that have one taken apart."""
    if not axis_of(end_value.stored):
        return {end_value.name: values}
    names = [str(i) for i in range(values.shape[-1])]
    if has_layers(end_value.stored):
        names[-1] = BODY
    return {f"{end_value.name}[{name}]": values[..., i] for i, name in enumerate(names)}


# -- how they are drawn ----------------------------------------------------------------------------


class Display(NamedTuple):
    """How a number is drawn: times a factor, and under which name, with its unit."""

    factor: float
    name: str
    unit: str

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})"


#: words for names that do not speak for themselves, without their bodies
_WORDS = {
    "mean_wear_rate": "mean rate",
    "sliding_distance": "distance",
    "pressure_velocity": "p V",
    "share_through": "share worn through",
    "time_through": "worn through from",
    "least_layer_left": "least left of layers",
    "max_mises": "largest von Mises stress",
    "max_mises_r": "its radius",
    "max_mises_z": "its height",
    "max_mises_layer": "its layer",
    "mises": "von Mises stress",
    "max_shear": "largest shear stress",
}
_UNITS = DISPLAY_UNITS | {"share_through": ("%", 100.0), "least_layer_left": ("um", 1e3)}


def _entry_words(end_value: EndValue, entry: str) -> str:
    """Return the words for one of the numbers of an end value with layers or points."""
    axis = axis_of(end_value.stored).removesuffix("_upper")
    return "the body itself" if entry == BODY else f"{axis} {entry}"


def display_of(name: str) -> Display:
    """Return how a number is drawn: its name, then its body, then its entry."""
    end_value, entry = end_value_of(name)
    words = end_value.name.removesuffix("_layers")
    body = words.rpartition("_")[2]
    body = body if body in BODIES else ""
    words = words.removesuffix(f"_{body}")
    unit, factor = _UNITS.get(words, (end_value.stored.unit, 1.0))
    parts = [_WORDS.get(words, words.replace("_", " ")), body]
    parts.append(_entry_words(end_value, entry) if entry else "")
    return Display(factor, ", ".join(filter(None, parts)), in_signs(unit))


def final_name(name: str) -> str:
    """Return the name of a number in sentences."""
    return f"final {display_of(name).name}"


def meaning_of(name: str) -> str:
    """Return what a column of the table is."""
    end_value, entry = end_value_of(name)
    meaning = end_value.stored.meaning
    return f"{meaning}; {_entry_words(end_value, entry)}" if entry else meaning


def figure_columns(final: Mapping[str, Any], cases: IntArray) -> list[str]:
    """Return the numbers of some cases that figures draw.

    Volumes of bodies that wear in some of them, or of the lower one; shares worn through, where
    there are some; the largest stress. Numbers of each layer and point would make figures too
    long to read.
    """
    volumes = ("worn_volume_lower", "worn_volume_upper")
    worn = [name for name in volumes if np.nan_to_num(final[name][cases]).any()]
    through = [name for name in LAYER_HISTORIES if np.nan_to_num(final.get(name, [])).any()]
    stress = [STRESS_STATES] if STRESS_STATES in final else []
    return ["penetration", *(worn or ["worn_volume_lower"]), *through, *stress]
