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
from ringwear_par.elasticity.stress.fields import FACES, SIDES

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

    def named(self, name: str) -> "Variable":
        """Return the variable under another name."""
        return replace(self, name=name)

    def at_last_step(self) -> "Variable":
        """Return the variable of the last stored step alone."""
        rest = tuple(name for name in self.dimensions if name != "step")
        return replace(self, dimensions=rest, meaning=f"{self.meaning}, at the last step")


def axis(name: str, meaning: str) -> Variable:
    """Return the whole numbers along an axis of this name."""
    return Variable(name, (name,), "1", meaning, integer=True)


def variable_table(*variables: Variable) -> dict[str, Variable]:
    """Return variables by their names."""
    return {variable.name: variable for variable in variables}


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


#: coordinate of the stored states, where they are named by the steps made ...
STEP = axis("step", "number of time steps made")
#: ... and where they are numbered, since states at times of output repeat a number of steps
STATE_NUMBER = replace(STEP, meaning="number of the stored state")
#: beside STATE_NUMBER only
STEPS_MADE = replace(STEP, name="steps_made")
ELEMENT = axis("element", "contact element, from the inner edge outwards")
#: ends of the contact elements, in the group "line"
EDGE = axis("edge", "end of a contact element")
EDGES = Variable("edges", ("edge",), "mm", "radius of the end of a contact element")

#: the contact line
LINE = variable_table(
    Variable("r", ("element",), "mm", "radius of the element's mid-point"),
    Variable("width", ("element",), "mm", "radial length of the element"),
)
#: numbers at each stored state
HISTORIES = variable_table(
    Variable("time", ("step",), "s", "time"),
    Variable("approach", ("step",), "mm", "downward displacement of the upper ring's top"),
    Variable("penetration", ("step",), "mm", "penetration depth: approach since the start"),
    Variable("force", ("step",), "N", "axial contact force"),
    Variable("torque", ("step",), "N mm", "friction torque"),
    Variable("twist", ("step",), "mm", "area mean of the circumferential displacement jump"),
    Variable("worn_volume_lower", ("step",), "mm3", "volume lost by the lower ring"),
    Variable("worn_volume_upper", ("step",), "mm3", "volume lost by the upper ring"),
    Variable("dissipated_energy", ("step",), "N mm", "energy dissipated by friction"),
    Variable(
        "contact_iterations", ("step",), "1",
        "iterations of the contact solver since the last stored step", integer=True,
    ),
)  # fmt: skip
#: those that pictures and pages tell in another unit, and how many of it are one of the file's
DISPLAY_UNITS = {
    "approach": ("\N{MICRO SIGN}m", 1e3),
    "penetration": ("\N{MICRO SIGN}m", 1e3),
    "torque": ("N m", 1e-3),
    "dissipated_energy": ("J", 1e-3),
}
#: fields along the contact line at each stored state, or at the last one (``at_last_step``)
PROFILES = variable_table(
    Variable(
        "pressure", ("step", "element"), "MPa",
        "contact pressure, normal to the faces, mean over the element",
    ),
    Variable(
        "gap", ("step", "element"), "mm",
        "gap between the deformed profiles at the element's mid-point, along the axis",
    ),
    Variable(
        "wear_lower", ("step", "element"), "mm",
        "depth worn off the lower ring at the element's mid-point, along the axis",
    ),
    Variable(
        "wear_upper", ("step", "element"), "mm",
        "depth worn off the upper ring at the element's mid-point, along the axis",
    ),
)  # fmt: skip
#: largest error of the pressure of such an element, relative to the largest (docs/accuracy.md)
EDGE_ERROR = 0.28
#: of every pressure that is stored, see ``edge_elements``
EDGE_ELEMENT = Variable(
    "edge_element", ("step", "element"), "1",
    "1: the element is beside an edge of contact that can move (the last closed or the first open "
    "one), 0: it is not", integer=True,
)  # fmt: skip

# -- layers ----------------------------------------------------------------------------------------

#: coordinates of volumes by layer; the second where upper has other numbers of layers than lower
LAYER = axis("layer", "layer from the contact face inwards; the last is the body itself")
UPPER_LAYER = replace(LAYER, name="layer_upper", dimensions=("layer_upper",))


def _of_both(
    name: str, dimensions: tuple[str, ...], units: str, meaning: str
) -> dict[str, Variable]:
    """Return the variables of lower and upper, whose names and meanings have the body's."""
    axes_of_bodies = (dimensions, tuple("layer_upper" if d == "layer" else d for d in dimensions))
    return variable_table(
        *(
            Variable(name.format(body), axes, units, meaning.format(body))
            for body, axes in zip(BODIES, axes_of_bodies, strict=True)
        )
    )


#: of bodies with layers: at each stored state
LAYER_HISTORIES = _of_both(
    "share_through_{}", ("step",), "1",
    "share of the contact area where all layers of the {} ring are worn through",
)  # fmt: skip
#: along the contact line, as ``PROFILES``
LAYER_PROFILES = _of_both(
    "layer_left_{}", ("step", "element"), "mm",
    "thickness left of all layers of the {} ring, along the axis",
)  # fmt: skip
#: and by layer
LAYER_VOLUMES = _of_both(
    "worn_volume_{}_layers", ("step", "layer"), "mm3",
    "volume lost by each layer of the {} ring, and by the ring itself",
)  # fmt: skip
#: along the contact line, the same at all states
LAYER_ENDS = variable_table(
    *(
        Variable(
            f"layer_end_{body}", (f"interface_{body}", "element"), "mm",
            f"depth of the end of each layer of the {body} ring below its unworn face, along the "
            "axis",
        )
        for body in BODIES
    )
)  # fmt: skip
#: of a history, s; an attribute of its file
TIMES_THROUGH = _of_both(
    "time_through_{}", (), "s",
    "when wear first got through all layers of the {} ring; none if it has not",
)  # fmt: skip
#: all of them
LAYERS = {**LAYER_HISTORIES, **LAYER_VOLUMES, **LAYER_PROFILES}

#: all variables of a row
VARIABLES = {**HISTORIES, **PROFILES, **LAYERS}


def layer_names(bodies: tuple[bool, bool]) -> tuple[str, ...]:
    """Return the variables of layers where lower, upper or both have some."""
    layered = [body for body, has in zip(BODIES, bodies, strict=True) if has]
    return tuple(name for name in LAYERS if any(f"_{body}" in name for body in layered))


# -- stresses --------------------------------------------------------------------------------------

_STEP, _TENSOR = ("stress_step",), "rr, tt, zz, rz, rt, tz; tension positive, z upwards"
#: how the shards of a sweep number sides
POINT_SIDES = ("", *SIDES)
POINT = axis("point", "point of stress.points")
POINT_SIDE = Variable(
    "point_side", ("point",), "1",
    "side of the face or interface that the point lies on, as in stress.points",
)  # fmt: skip
POINTS = variable_table(
    Variable("point_r", ("point",), "mm", "radius of the point"),
    Variable("point_z", ("point",), "mm", "height of the point"),
    POINT_SIDE,
)


def _stresses(place: str, dimensions: tuple[str, ...]) -> dict[str, Variable]:
    """Return the stress at points or on the grid, and what follows from it."""
    dimensions = (*_STEP, *dimensions)
    return variable_table(
        Variable(f"stress{place}", (*dimensions, "component"), "MPa", f"stress {_TENSOR}"),
        Variable(f"mises{place}", dimensions, "MPa", "von Mises stress"),
        Variable(f"max_shear{place}", dimensions, "MPa", "largest shear stress"),
    )


def _largest(suffix: str, bodies: str) -> dict[str, Variable]:
    name = f"max_mises{suffix}"
    return variable_table(
        Variable(name, _STEP, "MPa", f"largest von Mises stress of {bodies}"),
        Variable(f"{name}_r", _STEP, "mm", "radius at which it is"),
        Variable(f"{name}_z", _STEP, "mm", "height at which it is"),
        Variable(
            f"{name}_layer", _STEP, "1",
            "layer that it is in, from the contact face on; the last is the body itself",
            integer=True,
        ),
    )  # fmt: skip


def _stresses_in(body: str, layer: str) -> dict[str, Variable]:
    """Return the stresses at the face and the interfaces of a body, and the largest in it."""
    number, element = f"interface_{body}", f"interface_element_{body}"
    fields = *_STEP, number, "side", element
    on = f"on both sides of the interfaces of the {body} ring"
    return _largest(f"_{body}", f"the {body} ring") | variable_table(
        Variable(
            f"surface_stress_{body}", (*_STEP, "element", "component"), "MPa",
            f"stress of the {body} ring at its contact face {_TENSOR}",
        ),
        axis(number, f"interface of the {body} ring: the layer that it is under"),
        axis(element, "element of the interfaces, from the inner edge outwards"),
        Variable(f"interface_r_{body}", (element,), "mm", "radius of the element's mid-point"),
        Variable(f"interface_z_{body}", (number,), "mm", "height of the interface, unworn"),
        Variable(
            f"interface_stress_{body}", (*fields, "component"), "MPa", f"stress {on} {_TENSOR}"
        ),
        Variable(f"interface_mises_{body}", fields, "MPa", f"von Mises stress {on}"),
        Variable(
            f"max_mises_{body}_layers", (*_STEP, layer), "MPa",
            f"largest von Mises stress in each layer of the {body} ring, and in the ring itself",
        ),
    )  # fmt: skip


#: of both bodies together
MAX_MISES = _largest("", "both rings")
STRESSES = {
    **variable_table(
        axis("stress_step", "number of the stored state of stress"),
        replace(HISTORIES["time"], name="stress_time", dimensions=_STEP),
        replace(STEPS_MADE, name="stress_steps_made", dimensions=_STEP),
        Variable("component", ("component",), "1", "component of stress"),
        Variable("side", ("side",), "1", "side of an interface"),
        Variable(
            "stress_exclude", (), "mm",
            "radius round edges, within which no largest stress is looked for",
        ),
        POINT,
        axis("principal_value", "principal value, the largest first"),
        Variable(
            "principal", (*_STEP, "point", "principal_value"), "MPa", "principal stresses"
        ),
        Variable("grid_r", ("grid_r",), "mm", "radius of the grid"),
        Variable("grid_z", ("grid_z",), "mm", "height of the grid"),
    ),
    **POINTS,
    **_stresses("", ("point",)),
    **_stresses("_grid", ("grid_r", "grid_z")),
    **MAX_MISES,
    **_stresses_in(BODIES[0], LAYER.name),
    **_stresses_in(BODIES[1], UPPER_LAYER.name),
}  # fmt: skip
#: what sweeps store, at the stored states that stress is asked for of: the largest, and points
LARGEST_STRESS = {name: replace(v, dimensions=("step",)) for name, v in MAX_MISES.items()}
LAYER_STRESS = {
    name: replace(STRESSES[name], dimensions=("step", STRESSES[name].dimensions[-1]))
    for name in (f"max_mises_{body}_layers" for body in BODIES)
}
POINT_STRESS = {
    name: replace(STRESSES[name], dimensions=("step", "point")) for name in ("mises", "max_shear")
}

# -- boundaries ------------------------------------------------------------------------------------


def _boundary(body: str) -> dict[str, Variable]:
    """Return the fields on the whole boundary of a body, in a group with axes of its own."""
    at_nodes, at_elements = (
        ("boundary_step", "boundary_node"),
        ("boundary_step", "boundary_element"),
    )
    along = ("r", "z", "theta")
    variables = (
        axis("boundary_step", "number of the stored boundary state"),
        axis("boundary_node", "node of the boundary"),
        axis(
            "boundary_element",
            "element of the boundary; its outward normal lies to the right of its direction",
        ),
        axis("corner", "first, middle and last node of an element"),
        replace(HISTORIES["time"], dimensions=at_nodes[:1]),
        replace(STEPS_MADE, dimensions=at_nodes[:1]),
        Variable(
            "nodes", ("boundary_element", "corner"), "1", "nodes of the element", integer=True
        ),
        Variable(
            "face", ("boundary_element",), "1",
            "face of the body: " + ", ".join(f"{i} {name}" for i, name in enumerate(FACES)),
            integer=True,
        ),
        *(Variable(x, at_nodes, "mm", f"{x} of the worn, undeformed body") for x in along[:2]),
        *(
            Variable(f"displacement_{x}", at_nodes, "mm", f"displacement along {x}") for x in along
        ),
        *(Variable(f"traction_{x}", at_elements, "MPa", f"traction along {x}") for x in along),
        Variable("pressure", at_elements, "MPa", "contact pressure, 0 elsewhere"),
        Variable(
            "wear", at_elements, "mm", "worn depth along the axis, 0 off the contact"
        ),
    )  # fmt: skip
    return {f"boundary/{body}/{variable.name}": variable for variable in variables}


#: all variables of a result by their places in its file; groups have axes of their own
VARIABLES = {
    **variable_table(STEP, STEPS_MADE, ELEMENT, LAYER, UPPER_LAYER),
    "line/edge": EDGE, "line/edges": EDGES,
    "checkpoint/state": axis("state", "state that the history goes on from, as an .npz file"),
    **LINE, **HISTORIES, **PROFILES, EDGE_ELEMENT.name: EDGE_ELEMENT,
    **LAYERS, **LAYER_ENDS, **STRESSES,
    **_boundary(BODIES[0]), **_boundary(BODIES[1]),
}  # fmt: skip
#: coordinates that are no dimensions
COORDINATES = (
    "time", *LINE, "stress_time", *POINTS,
    *(f"interface_{axis}_{body}" for body in BODIES for axis in "rz"),
)  # fmt: skip


def edge_elements(pressure: FloatArray) -> BoolArray:
    """Return where elements lie beside an edge of contact: the last closed and the first open one.

    Contact that reaches an end of the contact line has no such element there. Not collective.

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
