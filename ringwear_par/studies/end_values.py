"""The end values of a case, in ``cases.csv``, figures and surrogates: names, units, how drawn."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.units import in_signs
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.results.laboratory_numbers import LABORATORY_NUMBERS
from ringwear_par.results.variables import (
    DISPLAY_UNITS,
    HISTORIES,
    LAYER_HISTORIES,
    LAYER_PROFILES,
    LAYER_STRESS,
    LAYER_VOLUMES,
    TIMES_THROUGH,
    Variable,
)
from ringwear_par.studies.stored_variables import (
    BODY,
    FIELDS,
    OF_A_CASE,
    STRESS,
    axis_of,
    entry_label,
    entry_names,
)

#: end values that all cases have
MAIN_END_VALUES = ("penetration", "worn_volume_lower", "worn_volume_upper")
_MM3, _UM = "mm\N{SUPERSCRIPT THREE}", "\N{MICRO SIGN}m"
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
    smooth: bool = True

    def of(self, table: FloatArray, last: IntArray) -> FloatArray:
        """Return values of cases, (cases,) or (cases, layers or points), NaN where there is none.

        By the row ``last`` (cases,), -1 for none, of a table (cases, ...) of its source, padded
        with NaN.
        """
        some = np.flatnonzero(last >= 0)
        if self.source in OF_A_CASE or (self.source in FIELDS and table.ndim == 2):
            rows = table[some]
        else:
            rows = table[some, last[some]]
        if self.source in FIELDS:
            rows = np.min(rows, axis=-1, where=np.isfinite(rows), initial=np.inf)
            rows = np.where(np.isfinite(rows), rows, np.nan)
        values = np.full((len(table), *rows.shape[1:]), np.nan)
        values[some] = rows
        return values


def _end_value(name: str, source: Variable, meaning: str = "") -> EndValue:
    axis = axis_of(source)
    stored = replace(
        source, name=f"final_{name}", dimensions=("case", axis) if axis else ("case",),
        integer=False, meaning=meaning or f"{source.meaning}, at the last stored step",
    )  # fmt: skip
    return EndValue(name, source.name, stored)


def _stress(source: Variable) -> EndValue:
    meaning = f"{source.meaning}, at the last time that it is stored of"
    end_value = _end_value(source.name, source, meaning)
    return replace(end_value, smooth=source.unit == "MPa")


def _of_laboratory(number: Variable) -> EndValue:
    meaning = f"{number.meaning}, at the last stored step"
    stored = replace(number, dimensions=("case",), meaning=meaning)
    return EndValue(stored.name, stored.name, stored, smooth=False)


def _of_layers() -> Iterable[EndValue]:
    bodies = (LAYER_VOLUMES, LAYER_HISTORIES, TIMES_THROUGH, LAYER_PROFILES)
    for volumes, share, time, left in zip(*(table.values() for table in bodies), strict=True):
        yield _end_value(volumes.name, volumes)
        yield _end_value(share.name, share)
        yield EndValue(time.name, time.name, replace(time, dimensions=("case",)))
        least = f"least {left.meaning}, at the last stored step"
        yield _end_value(f"least_{left.name}", left, least)


#: in the order of the table
END_VALUES = {
    end_value.name: end_value
    for end_value in (
        *(_end_value(name, HISTORIES[name]) for name in MAIN_END_VALUES),
        *map(_of_laboratory, LABORATORY_NUMBERS.values()),
        *_of_layers(),
        *map(_stress, STRESS.values()),
    )
}
#: by the variable that each is taken of
BY_SOURCE = {end_value.source: end_value for end_value in END_VALUES.values()}
#: the variable that is finite at the states with stress
STRESS_STATES = "max_mises"


def end_value_of(name: str) -> tuple[EndValue, str]:
    """Return the end value that a column is of, and its entry, "" where it has but one."""
    match = _ENTRY.fullmatch(name)
    return (END_VALUES[match[1]], match[2]) if match else (END_VALUES[name], "")


def entries(end_value: EndValue, values: FloatArray) -> dict[str, FloatArray]:
    """Return numbers of cases by their names, the last axis of those that have one taken apart."""
    if not axis_of(end_value.stored):
        return {end_value.name: values}
    names = entry_names(end_value.stored, values.shape[-1])
    return {f"{end_value.name}[{name}]": values[..., i] for i, name in enumerate(names)}


def last_with_stress(table: FloatArray) -> IntArray:
    """Return the last row of each case that has stress in a table (cases, rows), -1 for none."""
    finite = np.isfinite(table)
    last: IntArray = table.shape[1] - 1 - finite[:, ::-1].argmax(axis=1)
    return np.where(finite.any(axis=1), last, -1)


class Display(NamedTuple):
    """How a number is drawn: times a factor, and under which name, with its unit."""

    factor: float
    name: str
    unit: str

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})"


_BODY = {
    "worn_volume": Display(1.0, "worn volume", _MM3),
    "mass_lost": Display(1.0, "mass lost", "mg"),
    "mean_wear_rate": Display(1.0, "mean rate", in_signs("um/h")),
    "specific_wear_rate": Display(1.0, "specific wear rate", in_signs("mm3/(N m)")),
    "share_through": Display(100.0, "share worn through", "%"),
    "time_through": Display(1.0, "worn through from", "s"),
    "least_layer_left": Display(1e3, "least left of layers", _UM),
}
_DISPLAYS = {
    "sliding_distance": Display(1.0, "distance", "m"),
    "pressure_velocity": Display(1.0, "p V", "MPa m/s"),
    **{
        name: Display(factor, name.replace("_", " "), in_signs(unit))
        for name in MAIN_END_VALUES
        for unit, factor in [DISPLAY_UNITS.get(name, (HISTORIES[name].unit, 1.0))]
    },
    "max_mises": Display(1.0, "largest von Mises stress", "MPa"),
    "max_mises_r": Display(1.0, "its radius", "mm"),
    "max_mises_z": Display(1.0, "its height", "mm"),
    "max_mises_layer": Display(1.0, "its layer", "1"),
    "mises": Display(1.0, "von Mises stress", "MPa"),
    "max_shear": Display(1.0, "largest shear stress", "MPa"),
    **{
        f"{name}_{body}": display._replace(name=f"{display.name}, {body}")
        for name, display in _BODY.items()
        for body in BODIES
    },
    **{
        name: display._replace(name=f"{display.name}, {body}")
        for table, display in (
            (LAYER_VOLUMES, Display(1.0, "worn volume", _MM3)),
            (LAYER_STRESS, Display(1.0, "largest von Mises stress", "MPa")),
        )
        for name, body in zip(table, ("lower", "upper"), strict=True)
    },
}


def display_of(name: str) -> Display:
    """Return how a number is drawn."""
    end_value, entry = end_value_of(name)
    display = _DISPLAYS[end_value.name]
    if not entry:
        return display
    return display._replace(name=f"{display.name}, {entry_label(end_value.stored, entry)}")


def final_name(name: str) -> str:
    """Return the name of a number in sentences."""
    return f"final {display_of(name).name}"


def figure_columns(final: Mapping[str, Any], cases: Any) -> list[str]:
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
