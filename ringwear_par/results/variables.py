"""The variables of results: one table that recorder, files, tables and ensembles read.

Depths of wear are losses, so never negative: vertically downward for lower, upward for upper, also
where faces slope. Pressure is normal to the faces.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import COMPONENTS, FACES, SIDES

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


def _table(*rows: Sequence[str]) -> dict[str, Variable]:
    """Return variables by their places in a file, see ``VARIABLES``.

    Parameters
    ----------
    rows : place, axes, unit and meaning of each; "int" after them, of whole numbers.
    """
    return {
        place: Variable(
            place[place.rfind("/") + 1 :], tuple(axes.split()), unit, meaning, bool(kind)
        )
        for place, axes, unit, meaning, *kind in rows
    }


def _of_bodies(*rows: Sequence[str]) -> dict[str, Variable]:
    """Return variables of lower, which these rows are of, and the same ones of upper."""
    both: list[Sequence[str]] = []
    for place, axes, *rest in rows:
        other = " ".join("layer_upper" if axis == "layer" else axis for axis in axes.split())
        both.append((place, axes, *rest))
        both.append([text.replace("lower", "upper") for text in (place, other, *rest)])
    return _table(*both)


def axis(name: str) -> Variable:
    """Return the coordinate of an axis, whose entries are words or numbered from 0."""
    meaning = name if name in WORDS else f"number of the {name.replace('_', ' ')}"
    return Variable(name, (name,), "1", meaning, integer=name not in WORDS)


#: components of vectors; of places the first two
DIRECTIONS = ("r", "z", "theta")
#: entries of axes that are words
WORDS = {"component": COMPONENTS, "side": SIDES, "plane": DIRECTIONS[:2], "direction": DIRECTIONS}
ELEMENT, LAYER, UPPER_LAYER, POINT = map(axis, ("element", "layer", "layer_upper", "point"))
# fmt: off
_AXES = _table(
    ("step", "step", "1", "number of time steps made", "int"),
    ("line/edges", "edge", "mm", "radius of the end of a contact element"),
    ("checkpoint/state", "state", "1", "state that the history goes on from, as an .npy file",
     "int"),
)
#: the contact line
LINE = _table(
    ("r", "element", "mm", "radius of the element's mid-point"),
    ("width", "element", "mm", "radial length of the element"),
)
#: numbers at each stored state
HISTORIES = _table(
    ("time", "step", "s", "time"),
    ("approach", "step", "mm", "downward displacement of the upper ring's top"),
    ("penetration", "step", "mm", "penetration depth: approach since the start"),
    ("force", "step", "N", "axial contact force"),
    ("torque", "step", "N mm", "friction torque"),
    ("twist", "step", "mm", "area mean of the circumferential displacement jump"),
    *((f"worn_volume_{body}", "step", "mm3", f"volume lost by the {body} ring") for body in BODIES),
    ("dissipated_energy", "step", "N mm", "energy dissipated by friction"),
    ("normal_work", "step", "N mm", "contact pressure times sliding distance, over the contact"),
    ("contact_iterations", "step", "1",
     "iterations of the contact solver since the last stored step", "int"),
)
#: fields along the contact line at each stored state, or at the last one (``at_last_step``)
PROFILES = _table(
    ("pressure", "step element", "MPa",
     "contact pressure, normal to the faces, mean over the element"),
    ("gap", "step element", "mm",
     "gap between the deformed profiles at the element's mid-point, along the axis"),
    *((f"wear_{body}", "step element", "mm",
       f"depth worn off the {body} ring at the element's mid-point, along the axis")
      for body in BODIES),
)
#: of every pressure that is stored, see ``edge_elements``
EDGE_ELEMENT = Variable(
    "edge_element", ("step", "element"), "1",
    "1: the element is beside an edge of contact that can move (the last closed or the first open "
    "one), 0: it is not", integer=True,
)

#: of bodies with layers: at each stored state, ...
LAYER_HISTORIES = _of_bodies(
    ("share_through_lower", "step", "1",
     "share of the contact area where all layers of the lower ring are worn through"),
)
#: ... by layer, ...
LAYER_VOLUMES = _of_bodies(
    ("worn_volume_lower_layers", "step layer", "mm3",
     "volume lost by each layer of the lower ring, and by the ring itself"),
)
#: ... and along the contact line, as ``PROFILES``
LAYER_PROFILES = _of_bodies(
    ("layer_left_lower", "step element", "mm",
     "thickness left of all layers of the lower ring, along the axis"),
)
LAYERS = {**LAYER_HISTORIES, **LAYER_VOLUMES, **LAYER_PROFILES}
#: along the contact line, the same at all states
LAYER_ENDS = _of_bodies(
    ("layer_end_lower", "interface_lower element", "mm",
     "depth of the end of each layer of the lower ring below its unworn face, along the axis"),
)
#: of a history, s; an attribute of its file
TIMES_THROUGH = _of_bodies(
    ("time_through_lower", "", "s",
     "when wear first got through all layers of the lower ring; none if it has not"),
)

_TENSOR = "rr, tt, zz, rz, rt, tz; tension positive, z upwards"
#: how the blocks of a sweep number sides
POINT_SIDES = ("", *SIDES)
POINTS = _table(
    ("point_r", "point", "mm", "radius of the point"),
    ("point_z", "point", "mm", "height of the point"),
    ("point_side", "point", "1",
     "side of the face or interface that the point lies on, as in stress.points"),
)
POINT_SIDE = POINTS["point_side"]


def _largest_of(place: str, bodies: str) -> dict[str, Variable]:
    """Return the variables of the largest stress of bodies."""
    return _table(
        (place, "stress_step", "MPa", f"largest von Mises stress of {bodies}"),
        (f"{place}_r", "stress_step", "mm", "radius at which it is"),
        (f"{place}_z", "stress_step", "mm", "height at which it is"),
        (f"{place}_layer", "stress_step", "1",
         "layer that it is in, from the contact face on; the last is the body itself", "int"),
    )


_MAX_MISES = _largest_of("max_mises", "both rings")
#: stresses and where they are, at the states that cases ask for
STRESSES = {
    **_table(
        ("stress_time", "stress_step", "s", "time"),
        ("stress_steps_made", "stress_step", "1", "number of time steps made", "int"),
        ("stress_exclude", "", "mm",
         "radius round edges, within which no largest stress is looked for"),
        ("principal", "stress_step point principal_value", "MPa",
         "principal stresses, the largest first"),
        ("grid_r", "grid_r", "mm", "radius of the grid"),
        ("grid_z", "grid_z", "mm", "height of the grid"),
        ("stress", "stress_step point component", "MPa", f"stress {_TENSOR}"),
        ("mises", "stress_step point", "MPa", "von Mises stress"),
        ("max_shear", "stress_step point", "MPa", "largest shear stress"),
        ("stress_grid", "stress_step grid_r grid_z component", "MPa", f"stress {_TENSOR}"),
        ("mises_grid", "stress_step grid_r grid_z", "MPa", "von Mises stress"),
        ("max_shear_grid", "stress_step grid_r grid_z", "MPa", "largest shear stress"),
    ),
    **POINTS, **_MAX_MISES,
    **_largest_of("max_mises_lower", "the lower ring"),
    **_largest_of("max_mises_upper", "the upper ring"),
    **_of_bodies(
        ("surface_stress_lower", "stress_step element component", "MPa",
         f"stress of the lower ring at its contact face {_TENSOR}"),
        ("interface_r_lower", "interface_element_lower", "mm", "radius of the element's mid-point"),
        ("interface_z_lower", "interface_lower", "mm", "height of the interface, unworn"),
        ("interface_stress_lower",
         "stress_step interface_lower side interface_element_lower component", "MPa",
         f"stress on both sides of the interfaces of the lower ring {_TENSOR}"),
        ("interface_mises_lower", "stress_step interface_lower side interface_element_lower",
         "MPa", "von Mises stress on both sides of the interfaces of the lower ring"),
        ("max_mises_lower_layers", "stress_step layer", "MPa",
         "largest von Mises stress in each layer of the lower ring, and in the ring itself"),
    ),
}


def _at_stored_states(*names: str) -> dict[str, Variable]:
    """Return variables of stress as sweeps have them, at all stored states."""
    at = {name: STRESSES[name].dimensions[1:] for name in names}
    return {name: replace(STRESSES[name], dimensions=("step", *rest)) for name, rest in at.items()}


#: what sweeps store, at the stored states that stress is asked for of: the largest, and points
LARGEST_STRESS = _at_stored_states(*_MAX_MISES)
LAYER_STRESS = _at_stored_states("max_mises_lower_layers", "max_mises_upper_layers")
POINT_STRESS = _at_stored_states("mises", "max_shear")

#: the fields on the whole boundary of a body, in a group with axes of its own
BOUNDARY = _table(
    ("time", "boundary_step", "s", "time"),
    ("steps_made", "boundary_step", "1", "number of time steps made", "int"),
    ("nodes", "boundary_step boundary_node plane", "mm", "nodes of the worn, undeformed body"),
    ("elements", "boundary_element corner", "1",
     "first, middle and last node of an element; its outward normal lies to the right", "int"),
    ("face", "boundary_element", "1",
     "face of the body: " + ", ".join(f"{i} {name}" for i, name in enumerate(FACES)), "int"),
    ("displacement", "boundary_step boundary_node direction", "mm", "displacement"),
    ("traction", "boundary_step boundary_element direction", "MPa", "traction"),
    ("pressure", "boundary_step boundary_element", "MPa", "contact pressure, 0 elsewhere"),
    ("wear", "boundary_step boundary_element", "mm",
     "worn depth along the axis, 0 off the contact"),
)
SLIDING = _table(
    ("sliding_distance", "step", "m", "sliding distance at the mean radius"),
    ("pressure_velocity", "step", "MPa m/s",
     "p V: mean pressure on the nominal area times speed at the mean radius"),
)
#: what laboratories report: mass lost, rates of wear, distance, p V
LABORATORY_NUMBERS = {
    **_of_bodies(
        ("mass_lost_lower", "step", "mg",
         "mass lost by the lower ring, by its density; nothing where that is not given"),
        ("mean_wear_rate_lower", "step", "um/h",
         "mean rate of wear of the lower ring since the start: volume over contact area and time"),
        ("specific_wear_rate_lower", "step", "mm3/(N m)",
         "specific wear rate of the lower ring since the start: volume over force and distance"),
    ),
    **SLIDING,
}
# fmt: on

#: all variables of a result by their places in its file; groups have axes of their own
VARIABLES = {
    **_AXES, **HISTORIES, **LINE, **PROFILES, EDGE_ELEMENT.name: EDGE_ELEMENT,
    **LAYERS, **LAYER_ENDS, **STRESSES, **LABORATORY_NUMBERS,
    **{f"boundary/{body}/{name}": v for body in BODIES for name, v in BOUNDARY.items()},
}  # fmt: skip
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
