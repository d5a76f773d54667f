"""The variables of stored stresses: how a result's file has them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.stress.boundary_fields import BODIES
from ringwear_par.elasticity.stress.fields import Interfaces, Largest, StressHistory, StressState
from ringwear_par.elasticity.stress.measures import COMPONENTS, SIDES, max_shear, mises, principal
from ringwear_par.results.hdf5_reading import find_texts, read_array
from ringwear_par.results.variables import (
    HISTORIES,
    LAYER,
    STEPS_MADE,
    UPPER_LAYER,
    Variable,
    layer_axis,
)

_STEP, _TENSOR = ("stress_step",), "rr, tt, zz, rz, rt, tz; tension positive, z upwards"
STRESS_STEP = Variable(
    "stress_step", _STEP, "1", "number of the stored state of stress", integer=True
)
STRESS_TIME = replace(HISTORIES["time"], name="stress_time", dimensions=_STEP)
STRESS_STEPS_MADE = replace(STEPS_MADE, name="stress_steps_made", dimensions=_STEP)
COMPONENT = Variable("component", ("component",), "1", "component of stress")
POINT = Variable("point", ("point",), "1", "point of stress.points", integer=True)
POINT_R = Variable("point_r", ("point",), "mm", "radius of the point")
POINT_Z = Variable("point_z", ("point",), "mm", "height of the point")
POINT_SIDE = Variable(
    "point_side", ("point",), "1",
    "side of the face or interface that the point lies on, as in stress.points",
)  # fmt: skip
#: how the shards of a sweep number sides
_POINT_SIDES = ("", *SIDES)
PRINCIPAL = Variable(
    "principal_value", ("principal_value",), "1", "principal value, the largest first", integer=True
)
GRID_R = Variable("grid_r", ("grid_r",), "mm", "radius of the grid")
GRID_Z = Variable("grid_z", ("grid_z",), "mm", "height of the grid")
_GRID = (*_STEP, "grid_r", "grid_z")
STRESS = Variable("stress", (*_STEP, "point", "component"), "MPa", f"stress {_TENSOR}")
MISES = Variable("mises", (*_STEP, "point"), "MPa", "von Mises stress")
MAX_SHEAR = Variable("max_shear", (*_STEP, "point"), "MPa", "largest shear stress")
PRINCIPALS = Variable(
    "principal", (*_STEP, "point", "principal_value"), "MPa", "principal stresses"
)
STRESS_GRID = Variable("stress_grid", (*_GRID, "component"), "MPa", f"stress {_TENSOR}")
MISES_GRID = Variable("mises_grid", _GRID, "MPa", "von Mises stress")
MAX_SHEAR_GRID = Variable("max_shear_grid", _GRID, "MPa", "largest shear stress")
SURFACE_STRESS = tuple(
    Variable(
        f"surface_stress_{body}", (*_STEP, "element", "component"), "MPa",
        f"stress of the {body} ring at its contact face {_TENSOR}",
    )
    for body in BODIES
)  # fmt: skip
SIDE = Variable("side", ("side",), "1", "side of an interface")


@dataclass(frozen=True)
class _OfInterfaces:
    """The variables of the interfaces of a body."""

    number: Variable
    element: Variable
    r: Variable
    z: Variable
    stress: Variable
    mises: Variable


def _of_interfaces(body: str) -> _OfInterfaces:
    number, element = f"interface_{body}", f"interface_element_{body}"
    fields = *_STEP, number, SIDE.name, element
    on = f"on both sides of the interfaces of the {body} ring"
    return _OfInterfaces(
        Variable(
            number, (number,), "1",
            f"interface of the {body} ring: the layer that it is under", integer=True,
        ),
        Variable(
            element, (element,), "1",
            "element of the interfaces, from the inner edge outwards", integer=True,
        ),
        Variable(f"interface_r_{body}", (element,), "mm", "radius of the element's mid-point"),
        Variable(f"interface_z_{body}", (number,), "mm", "height of the interface, unworn"),
        Variable(
            f"interface_stress_{body}", (*fields, "component"), "MPa", f"stress {on} {_TENSOR}"
        ),
        Variable(f"interface_mises_{body}", fields, "MPa", f"von Mises stress {on}"),
    )  # fmt: skip


INTERFACES = tuple(map(_of_interfaces, BODIES))
EXCLUDE = Variable("stress_exclude", (), "mm", "radius round edges in which it is not looked for")


def _largest(suffix: str, of: str) -> tuple[Variable, ...]:
    return (
        Variable(f"max_mises{suffix}", _STEP, "MPa", f"largest von Mises stress of {of}"),
        Variable(f"max_mises{suffix}_r", _STEP, "mm", "radius at which it is"),
        Variable(f"max_mises{suffix}_z", _STEP, "mm", "height at which it is"),
        Variable(
            f"max_mises{suffix}_layer",
            _STEP,
            "1",
            "layer that it is in, from the contact face on; the last is the body itself",
            integer=True,
        ),
    )


#: of both bodies together, then of each
MAX_MISES = _largest("", "both rings")
MAX_MISES_OF = tuple(_largest(f"_{body}", f"the {body} ring") for body in BODIES)
#: of bodies with layers
MAX_MISES_LAYERS = tuple(
    Variable(
        f"max_mises_{body}_layers", (*_STEP, layer.name), "MPa",
        f"largest von Mises stress in each layer of the {body} ring, and in the ring itself",
    )
    for body, layer in zip(BODIES, (LAYER, UPPER_LAYER), strict=True)
)  # fmt: skip
#: what sweeps store, at the stored states that stress is asked for of: the largest, and points
LARGEST_STRESS = {v.name: replace(v, dimensions=("step",)) for v in MAX_MISES}
LAYER_STRESS = {v.name: replace(v, dimensions=("step", v.dimensions[-1])) for v in MAX_MISES_LAYERS}
POINT_STRESS = {v.name: replace(v, dimensions=("step", "point")) for v in (MISES, MAX_SHEAR)}
POINTS = {v.name: v for v in (POINT_R, POINT_Z, POINT_SIDE)}


def stress_coordinates(history: StressHistory) -> tuple[str, ...]:
    """Return the names of the coordinates that are no dimensions; there is a state at least."""
    of_points = tuple(name for name, _ in _points(history))
    of_interfaces = (
        names
        for of, v in zip(history.interfaces, INTERFACES, strict=True)
        if len(of.z)
        for names in (v.r.name, v.z.name)
    )
    return (STRESS_TIME.name, *of_points, *of_interfaces)


def stress_variables(history: StressHistory) -> list[tuple[Variable, Any]]:
    """Return every variable of stored stresses with its values; there is a state at least."""
    states = history.states
    found: list[tuple[Variable, Any]] = [
        (STRESS_STEP, np.arange(len(states))),
        (STRESS_TIME, np.array([state.time for state in states])),
        (STRESS_STEPS_MADE, np.array([state.step for state in states])),
        (COMPONENT, list(COMPONENTS)),
        (EXCLUDE, np.array(history.exclude)),
    ]
    if len(history.points):
        stress = np.array([state.points for state in states])
        found += [
            (POINT, np.arange(len(history.points))),
            *((POINTS[name], values) for name, values in _points(history)),
            (PRINCIPAL, np.arange(3)),
            (STRESS, stress),
            (MISES, mises(stress)),
            (MAX_SHEAR, max_shear(stress)),
            (PRINCIPALS, principal(stress)),
        ]
    if len(history.grid[0]):
        stress = np.array([state.grid for state in states])
        found += [
            (GRID_R, history.grid[0]),
            (GRID_Z, history.grid[1]),
            (STRESS_GRID, stress),
            (MISES_GRID, mises(stress)),
            (MAX_SHEAR_GRID, max_shear(stress)),
        ]
    for i, variable in enumerate(SURFACE_STRESS):
        found.append((variable, np.array([state.surface[i] for state in states])))
    if any(len(of.z) for of in history.interfaces):
        found.append((SIDE, list(SIDES)))
    for i, (of, names) in enumerate(zip(history.interfaces, INTERFACES, strict=True)):
        if len(of.z):
            stress = np.array([state.interfaces[i] for state in states])
            found += [
                (names.number, np.arange(len(of.z))),
                (names.element, np.arange(len(of.r))),
                (names.r, of.r),
                (names.z, of.z),
                (names.stress, stress),
                (names.mises, mises(stress)),
            ]
    found += _columns(MAX_MISES, [state.of_both for state in states])
    for i, variables in enumerate(MAX_MISES_OF):
        found += _columns(variables, [state.largest[i] for state in states])
    for i, (variable, count) in enumerate(zip(MAX_MISES_LAYERS, history.layers, strict=True)):
        if count:
            axes = (*_STEP, layer_axis(i, history.layers).name)
            values = np.array([state.layers[i] for state in states])
            found.append((replace(variable, dimensions=axes), values))
    return found


def stress_rows(history: StressHistory, times: FloatArray) -> dict[str, FloatArray]:
    """Return what sweeps store of a history, NaN where stress was not asked for.

    Parameters
    ----------
    times : (rows,) float, s, of all stored states.
    """
    row = {time: i for i, time in enumerate(times.tolist())}

    def kept(of_bodies: Sequence[Any]) -> list[Any]:
        """Those of bodies with layers."""
        return [one for one, count in zip(of_bodies, history.layers, strict=True) if count]

    def points(state: StressState) -> tuple[FloatArray, ...]:
        at = state.points
        return (mises(at), max_shear(at)) if len(history.points) else ()

    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(LARGEST_STRESS, ())
    shapes |= {
        name: (size,)
        for name, size in zip(kept(list(LAYER_STRESS)), kept(history.layers), strict=True)
    }
    if len(history.points):
        shapes |= dict.fromkeys(POINT_STRESS, (len(history.points),))
    found = {name: np.full((len(row), *shape), np.nan) for name, shape in shapes.items()}
    for state in history.states:
        largest = state.of_both
        of = largest.mises, largest.r, largest.z, largest.layer
        values = *of, *kept(state.layers), *points(state)
        for name, value in zip(found, values, strict=True):
            found[name][row[state.time]] = value
    return found


def _points(history: StressHistory) -> list[tuple[str, Any]]:
    """Return what is known of the points by name, nothing where there are none."""
    if not len(history.points):
        return []
    r, z = history.points.T
    sides = [(POINT_SIDE.name, list(history.sides))] if history.sides else []
    return [(POINT_R.name, r), (POINT_Z.name, z), *sides]


def point_columns(history: StressHistory) -> dict[str, FloatArray]:
    """Return radii, heights and sides of the points, as far as there are any, in numbers."""
    return {
        name: np.array([_POINT_SIDES.index(side) for side in values], dtype=float)
        if name == POINT_SIDE.name
        else values
        for name, values in _points(history)
    }


def side_words(numbers: FloatArray) -> Any:
    """Return the sides, as bytes, that a sweep's numbers stand for, none for NaN."""
    return np.array(_POINT_SIDES, dtype="S")[np.nan_to_num(numbers).astype(int)]


def side_numbers(words: Any) -> FloatArray:
    """Return the numbers of sides.

    Raises
    ------
    ValueError : some are none.
    """
    numbers = np.full(words.shape, np.nan)
    for number, side in enumerate(_POINT_SIDES):
        numbers[words == side.encode()] = number
    if np.isnan(numbers).any():
        raise ValueError(POINT_SIDE.name)
    return numbers


def _columns(variables: tuple[Variable, ...], places: list[Largest]) -> list[tuple[Variable, Any]]:
    rows = zip(*((of.mises, of.r, of.z, of.layer) for of in places), strict=True)
    return [(v, np.array(row, v.dtype)) for v, row in zip(variables, rows, strict=True)]


def read_stress(file: h5py.File, sizes: dict[str, int]) -> StressHistory | None:
    """Return the stored stresses, None where there are none; any exception means damage."""
    if STRESS_TIME.name not in file:
        return None
    sizes = {**sizes, "component": len(COMPONENTS), SIDE.name: len(SIDES)}

    def read(variable: Variable) -> Any:
        return read_array(file, variable, sizes)

    times, steps = read(STRESS_TIME), read(STRESS_STEPS_MADE)
    if not (len(times) and np.isfinite(times).all() and (np.diff(times) >= 0.0).all()):
        raise ValueError(STRESS_TIME.name)
    count = len(times)
    points, at_points = np.empty((0, 2)), np.empty((count, 0, 6))
    sides: tuple[str, ...] = ()
    if STRESS.name in file:
        points = np.stack([read(POINT_R), read(POINT_Z)], axis=1)
        at_points = read(STRESS)
        sides = tuple(find_texts(file, POINT_SIDE.name, sizes, "point")[()].tolist())
        if not set(sides) <= set(_POINT_SIDES):
            raise ValueError(POINT_SIDE.name)
    axes, on_grid = (np.empty(0), np.empty(0)), np.empty((count, 0, 0, 6))
    if STRESS_GRID.name in file:
        axes = read(GRID_R), read(GRID_Z)
        on_grid = read(STRESS_GRID)
    surface = [read(variable) for variable in SURFACE_STRESS]
    none = Interfaces(np.empty(0), np.empty(0)), np.empty((count, 0, len(SIDES), 0, 6))
    lower, upper = (
        (Interfaces(read(of.r), read(of.z)), read(of.stress)) if of.stress.name in file else none
        for of in INTERFACES
    )
    largest = [
        [Largest(*row) for row in zip(*(read(v).tolist() for v in variables), strict=True)]
        for variables in MAX_MISES_OF
    ]
    layers = [  # which may have a dimension of their own
        read_array(file, variable, {"stress_step": count})
        if variable.name in file
        else np.empty((count, 0))
        for variable in MAX_MISES_LAYERS
    ]
    states = tuple(
        StressState(
            int(steps[t]), float(times[t]), at_points[t], on_grid[t],
            (surface[0][t], surface[1][t]),
            (largest[0][t], largest[1][t]),
            (lower[1][t], upper[1][t]),
            (layers[0][t], layers[1][t]),
        )
        for t in range(count)
    )  # fmt: skip
    return StressHistory(points, sides, axes, float(read(EXCLUDE)), (lower[0], upper[0]), states)
