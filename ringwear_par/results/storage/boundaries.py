"""Fields on the whole boundaries, in the groups ``boundary/lower`` and ``boundary/upper`` of files.

Dimensions are of their own: those of the contact line have other sizes.
"""

from collections.abc import Sequence
from dataclasses import replace

import h5py
import numpy as np

from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import FACES, BoundaryFields, BoundaryState
from ringwear_par.results.storage.hdf5 import read_array, write_variable
from ringwear_par.results.variables import HISTORIES, STEPS_MADE, Variable, axis, variable_table

_DIMENSIONS = variable_table(
    axis("boundary_step", "number of the stored boundary state"),
    axis("boundary_node", "node of the boundary"),
    axis(
        "boundary_element",
        "element of the boundary; its outward normal lies to the right of its direction",
    ),
    axis("corner", "first, middle and last node of an element"),
)  # fmt: skip
_TIME = replace(HISTORIES["time"], dimensions=("boundary_step",))
_STEPS_MADE = replace(STEPS_MADE, dimensions=("boundary_step",))
#: nodes of the elements, and the face that each belongs to: the same at all times
_MESH = variable_table(
    Variable("nodes", ("boundary_element", "corner"), "1", "nodes of the element", integer=True),
    Variable(
        "face", ("boundary_element",), "1",
        "face of the body: " + ", ".join(f"{i} {name}" for i, name in enumerate(FACES)),
        integer=True,
    ),
)  # fmt: skip


def _components(
    name: str, axes: tuple[str, ...], dimension: str, unit: str, meaning: str
) -> tuple[Variable, ...]:
    return tuple(
        Variable(name.format(axis), ("boundary_step", dimension), unit, meaning.format(axis))
        for axis in axes
    )


_AXES = ("r", "z", "theta")
#: variables of the columns of each array of BoundaryFields
BOUNDARY_FIELDS: dict[str, tuple[Variable, ...]] = {
    "nodes": _components(
        "{}", _AXES[:2], "boundary_node", "mm", "{} of the worn, undeformed body"
    ),
    "displacement": _components(
        "displacement_{}", _AXES, "boundary_node", "mm", "displacement along {}"
    ),
    "traction": _components(
        "traction_{}", _AXES, "boundary_element", "MPa", "traction along {}"
    ),
    "pressure": _components(
        "pressure", ("",), "boundary_element", "MPa", "contact pressure, 0 elsewhere"
    ),
    "wear": _components(
        "wear", ("",), "boundary_element", "mm", "worn depth along the axis, 0 off the contact"
    ),
}  # fmt: skip


def read_boundaries(file: h5py.File) -> tuple[BoundaryState, ...]:
    """Return the stored fields on the boundaries, () where there are none.

    Raises
    ------
    Exception : they are damaged, see ``reading``.
    """
    if "boundary" not in file:
        return ()
    groups = [file["boundary"][name] for name in BODIES]
    sizes: dict[str, int] = {}
    times = read_array(groups[0], _TIME, sizes)
    steps = read_array(groups[0], _STEPS_MADE, sizes).tolist()
    bodies = [_read_body(group, len(times)) for group in groups]
    return tuple(
        BoundaryState(step, time, (lower, upper))
        for step, time, lower, upper in zip(steps, times.tolist(), *bodies, strict=True)
    )


def _read_body(group: h5py.Group, states: int) -> list[BoundaryFields]:
    sizes = {"boundary_step": states, "corner": 3}
    elements, face = (read_array(group, variable, sizes) for variable in _MESH.values())
    columns = {
        attribute: np.stack([read_array(group, v, sizes) for v in variables], axis=-1)
        for attribute, variables in BOUNDARY_FIELDS.items()
    }
    for numbers, size in ((elements, sizes["boundary_node"]), (face, len(FACES))):
        if not ((numbers >= 0) & (numbers < size)).all():
            raise ValueError(group.name)
    return [
        BoundaryFields(
            columns["nodes"][t], elements, face, columns["displacement"][t], columns["traction"][t],
            columns["pressure"][t, :, 0], columns["wear"][t, :, 0],
        )
        for t in range(states)
    ]  # fmt: skip


def write_boundaries(file: h5py.File, states: Sequence[BoundaryState]) -> None:
    """Write the fields on the boundaries of both bodies at all stored times."""
    for i, name in enumerate(BODIES):
        _write_boundary(file.create_group(f"boundary/{name}"), states, i)


def _write_boundary(group: h5py.Group, states: Sequence[BoundaryState], body: int) -> None:
    """Write the fields on the boundary of one body, 0 or 1, at all stored times."""
    fields = [state.bodies[body] for state in states]
    first = fields[0]
    sizes = (len(states), len(first.nodes), len(first.elements), first.elements.shape[1])
    for variable, size in zip(_DIMENSIONS.values(), sizes, strict=True):
        write_variable(group, variable, np.arange(size))
    write_variable(group, _TIME, np.array([state.time for state in states]))
    write_variable(group, _STEPS_MADE, np.array([state.step for state in states]))
    write_variable(group, _MESH["nodes"], first.elements)
    write_variable(group, _MESH["face"], first.face)
    for attribute, variables in BOUNDARY_FIELDS.items():
        values = np.array([getattr(f, attribute) for f in fields])
        columns = values.reshape(*values.shape[:2], len(variables))
        for column, variable in enumerate(variables):
            write_variable(group, variable, columns[..., column])
    group.attrs["coordinates"] = _TIME.name
