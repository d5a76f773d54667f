"""The variables of results: the table ``variables.csv``, for recorder, files, tables, ensembles.

Depths of wear are losses, so never negative: vertically downward for lower, upward for upper, also
where faces slope. Pressure is normal to the faces.
"""

import csv
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import COMPONENTS, SIDES

if TYPE_CHECKING:
    import xarray

#: name of the program in files
SOFTWARE = "ringwear-par"


@dataclass(frozen=True)
class Variable:
    """What an array of a result is called, runs over, is measured in and means."""

    #: in files and in Python
    name: str
    #: names of its axes; a variable named as its only dimension is its coordinate
    dimensions: tuple[str, ...]
    #: "1" for none
    unit: str
    #: the ``long_name`` of files
    meaning: str
    #: whether its values are whole numbers
    integer: bool = False

    @property
    def dtype(self) -> "np.dtype[Any]":
        """Type of its values in memory and in files."""
        return np.dtype(np.int64 if self.integer else np.float64)

    @property
    def attributes(self) -> dict[str, str]:
        """What files say of it."""
        return {"units": self.unit, "long_name": self.meaning}

    def at_last_step(self) -> "Variable":
        """Return the variable of the last stored step alone."""
        rest = tuple(name for name in self.dimensions if name != "step")
        return replace(self, dimensions=rest, meaning=f"{self.meaning}, at the last step")


def to_dataset(
    variables: Sequence[tuple[Variable, Any]],
    attributes: Mapping[str, Any],
    coordinates: Sequence[str],
) -> "xarray.Dataset":
    """Return variables with their values as xarray has them.

    Parameters
    ----------
    coordinates : names of those that are no dimensions.
    """
    import xarray

    dataset = xarray.Dataset(
        {v.name: (v.dimensions, values, v.attributes) for v, values in variables},
        attrs={"software": SOFTWARE, **attributes},
    )
    return dataset.set_coords(coordinates)


# -- axes ------------------------------------------------------------------------------------------

#: components of vectors; of places the first two
DIRECTIONS = ("r", "z", "theta")
#: entries of axes that are words
WORDS = {"component": COMPONENTS, "side": SIDES, "plane": DIRECTIONS[:2], "direction": DIRECTIONS}
#: how the blocks of a sweep number sides
POINT_SIDES = ("", *SIDES)


def axis(name: str) -> Variable:
    """Return the coordinate of an axis, whose entries are words or numbered from 0."""
    meaning = name if name in WORDS else f"number of the {name.replace('_', ' ')}"
    return Variable(name, (name,), "1", meaning, integer=name not in WORDS)


# -- the table -------------------------------------------------------------------------------------


def _groups() -> dict[str, dict[str, Variable]]:
    """Return the variables of the table by group, and by their places in a file."""
    groups: dict[str, dict[str, Variable]] = defaultdict(dict)
    with Path(__file__).with_name("variables.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            name, axes = row["place"].rpartition("/")[2], tuple(row["axes"].split())
            variable = Variable(name, axes, row["unit"], row["meaning"], row["type"] == "int")
            groups[row["group"]][row["place"]] = variable
    return groups


_GROUPS = _groups()
#: numbers at each stored state
HISTORIES = _GROUPS["history"]
#: the contact line, and fields along it at each stored state or at the last (``at_last_step``)
LINE, PROFILES = _GROUPS["line"], _GROUPS["profile"]
#: of every pressure that is stored, see ``edge_elements``
EDGE, EDGE_ELEMENT = _GROUPS["edge"], _GROUPS["edge"]["edge_element"]
#: of bodies with layers: at each stored state, by layer, and along the contact line as ``PROFILES``
LAYER_HISTORIES, LAYER_VOLUMES = _GROUPS["layer history"], _GROUPS["layer volume"]
LAYER_PROFILES = _GROUPS["layer profile"]
LAYERS = {**LAYER_HISTORIES, **LAYER_VOLUMES, **LAYER_PROFILES}
FIELDS = {**PROFILES, **LAYER_PROFILES}
#: of a history, s; an attribute of its file
TIMES_THROUGH = _GROUPS["time through"]
#: what laboratories report; the first two follow from the state alone
SLIDING = _GROUPS["sliding"]
LABORATORY_NUMBERS = {**_GROUPS["laboratory"], **SLIDING}
#: stresses and where they are, at the states that cases ask for
STRESSES = _GROUPS["stress"]
POINTS = {name: STRESSES[name] for name in ("point_r", "point_z", "point_side")}
#: all variables of a result by their places in its file; groups have axes of their own
VARIABLES = {
    **_GROUPS["axis"], **HISTORIES, **LINE, **PROFILES, **EDGE,
    **LAYERS, **_GROUPS["layer end"], **STRESSES, **LABORATORY_NUMBERS,
    **{f"boundary/{body}/{name}": v for body in BODIES for name, v in _GROUPS["boundary"].items()},
}  # fmt: skip


def _at_stored_states(*names: str) -> dict[str, Variable]:
    """Return variables of stress as sweeps have them, at all stored states."""
    at = {name: STRESSES[name].dimensions[1:] for name in names}
    return {name: replace(STRESSES[name], dimensions=("step", *rest)) for name, rest in at.items()}


#: what sweeps store, at the stored states that stress is asked for of: the largest, and points
LARGEST_STRESS = _at_stored_states(*(f"max_mises{end}" for end in ("", "_r", "_z", "_layer")))
LAYER_STRESS = _at_stored_states("max_mises_lower_layers", "max_mises_upper_layers")
POINT_STRESS = _at_stored_states("mises", "max_shear")
#: what sweeps store about each case
OF_CASES = _GROUPS["sweep"]
#: coordinates that are no dimensions
COORDINATES = (
    "time", *LINE, "stress_time", *POINTS,
    *(f"interface_{axis}_{body}" for body in BODIES for axis in "rz"),
)  # fmt: skip
#: variables that pictures and pages tell in another unit, and how many of it are one of the file's
DISPLAY_UNITS = {
    "approach": ("\N{MICRO SIGN}m", 1e3),
    "penetration": ("\N{MICRO SIGN}m", 1e3),
    "torque": ("N m", 1e-3),
    "dissipated_energy": ("J", 1e-3),
}
#: largest error of the pressure of an ``edge_element``, relative to the largest (docs/accuracy.md)
EDGE_ERROR = 0.28


def layer_names(bodies: tuple[bool, bool]) -> tuple[str, ...]:
    """Return the variables of layers where lower, upper or both have some."""
    layered = [body for body, has in zip(BODIES, bodies, strict=True) if has]
    return tuple(name for name in LAYERS if any(f"_{body}" in name for body in layered))


def edge_elements(pressure: FloatArray) -> BoolArray:
    """Return where elements lie beside an edge of contact: the last closed and the first open one.

    Contact that reaches an end of the contact line has no such element there.

    Parameters
    ----------
    pressure : (..., n) MPa; NaN: there is no such element.
    """
    closed, known = pressure > 0.0, ~np.isnan(pressure)
    edge = (closed[..., 1:] != closed[..., :-1]) & known[..., 1:] & known[..., :-1]
    beside = np.zeros(np.shape(pressure), dtype=bool)
    beside[..., 1:] |= edge
    beside[..., :-1] |= edge
    return beside
