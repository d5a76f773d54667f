"""A result as variables with their values, for its file, for xarray and for sweeps."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.stress.fields import (
    COMPONENTS,
    SIDES,
    Interfaces,
    Largest,
    StressHistory,
    StressState,
    max_shear,
    mises,
    principal,
)
from ringwear_par.results import variables as table
from ringwear_par.results.laboratory_numbers import (
    LABORATORY_NUMBERS,
    laboratory_inputs,
    laboratory_numbers,
)
from ringwear_par.results.result import Result
from ringwear_par.results.storage.hdf5 import find_texts, read_array
from ringwear_par.results.variables import Variable, edge_elements, layer_axis

if TYPE_CHECKING:
    import xarray


def to_xarray(result: Result) -> "xarray.Dataset":
    """Return the dataset that xarray makes of a result's file, see ``Result.to_xarray``."""
    return table.to_dataset(result_variables(result), result.attributes, coordinates(result))


def result_variables(result: Result) -> list[tuple[Variable, Any]]:
    """Return every variable on the contact line and in time, with its values."""
    line, numbered = result.line, not np.array_equal(result.step, result.steps_made)
    pairs: list[tuple[Variable, Any]] = [
        (table.STATE_NUMBER if numbered else table.STEP, result.step),
        *([(table.STEPS_MADE, result.steps_made)] if numbered else []),
        (table.ELEMENT, np.arange(line.n)),
        *((table.HISTORIES[name], values) for name, values in result.histories.items()),
        *((variable, getattr(line, name)) for name, variable in table.LINE.items()),
        *((table.PROFILES[name], values) for name, values in result.profiles.items()),
    ]
    if "pressure" in result.profiles:
        edge = edge_elements(result.profiles["pressure"])
        pairs.append((table.EDGE_ELEMENT, edge.astype(table.EDGE_ELEMENT.dtype)))
    pairs += _layer_variables(result)
    numbers = laboratory_numbers(laboratory_inputs(result))
    pairs += [(LABORATORY_NUMBERS[name].variable, values) for name, values in numbers.items()]
    if result.stress is not None and result.stress.states:
        pairs += _stress_variables(result.stress)
    return [(variable.stored_as(np.ndim(values)), values) for variable, values in pairs]


def _layer_variables(result: Result) -> list[tuple[Variable, Any]]:
    """Return the variables of layers, with their coordinates."""
    pairs: list[tuple[Variable, Any]] = []
    counts = [result.layers[v].shape[1] if v in result.layers else 0 for v in table.LAYER_VOLUMES]
    for name, values in result.layers.items():
        variable = table.LAYERS[name]
        if name in table.LAYER_VOLUMES:
            layer = layer_axis(list(table.LAYER_VOLUMES).index(name), counts)
            if all(layer != coordinate for coordinate, _ in pairs):
                pairs.insert(0, (layer, np.arange(values.shape[1])))
            variable = replace(variable, dimensions=("step", layer.name))
        pairs.append((variable, values))
    return pairs


def coordinates(result: Result) -> tuple[str, ...]:
    """Return the names of a result's coordinates that are no dimensions."""
    names = table.COORDINATES
    if result.stress is None or not result.stress.states:
        return names
    return (*names, *_stress_coordinates(result.stress))


# -- stresses --------------------------------------------------------------------------------------


def _stress_coordinates(history: StressHistory) -> tuple[str, ...]:
    """Return the names of the coordinates that are no dimensions; there is a state at least."""
    point_names = tuple(name for name, _ in _points(history))
    interface_names = (
        names
        for lines, v in zip(history.interfaces, table.INTERFACES, strict=True)
        if len(lines.z)
        for names in (v.r.name, v.z.name)
    )
    return (table.STRESS_TIME.name, *point_names, *interface_names)


def _stress_variables(history: StressHistory) -> list[tuple[Variable, Any]]:
    """Return every variable of stored stresses with its values; there is a state at least."""
    states = history.states
    pairs: list[tuple[Variable, Any]] = [
        (table.STRESS_STEP, np.arange(len(states))),
        (table.STRESS_TIME, np.array([state.time for state in states])),
        (table.STRESS_STEPS_MADE, np.array([state.step for state in states])),
        (table.COMPONENT, list(COMPONENTS)),
        (table.EXCLUDE, np.array(history.exclude)),
    ]
    if len(history.points):
        stress = np.array([state.points for state in states])
        pairs += [
            (table.POINT, np.arange(len(history.points))),
            *((table.POINTS[name], values) for name, values in _points(history)),
            (table.PRINCIPAL, np.arange(3)),
            (table.STRESS, stress),
            (table.MISES, mises(stress)),
            (table.MAX_SHEAR, max_shear(stress)),
            (table.PRINCIPALS, principal(stress)),
        ]
    if len(history.grid[0]):
        stress = np.array([state.grid for state in states])
        pairs += [
            (table.GRID_R, history.grid[0]),
            (table.GRID_Z, history.grid[1]),
            (table.STRESS_GRID, stress),
            (table.MISES_GRID, mises(stress)),
            (table.MAX_SHEAR_GRID, max_shear(stress)),
        ]
    for i, variable in enumerate(table.SURFACE_STRESS):
        pairs.append((variable, np.array([state.surface[i] for state in states])))
    if any(len(lines.z) for lines in history.interfaces):
        pairs.append((table.SIDE, list(SIDES)))
    for i, (lines, names) in enumerate(zip(history.interfaces, table.INTERFACES, strict=True)):
        if len(lines.z):
            stress = np.array([state.interfaces[i] for state in states])
            pairs += [
                (names.number, np.arange(len(lines.z))),
                (names.element, np.arange(len(lines.r))),
                (names.r, lines.r),
                (names.z, lines.z),
                (names.stress, stress),
                (names.mises, mises(stress)),
            ]
    pairs += _columns(table.MAX_MISES, [state.of_both for state in states])
    for i, variables in enumerate(table.MAX_MISES_OF):
        pairs += _columns(variables, [state.largest[i] for state in states])
    for i, (variable, count) in enumerate(zip(table.MAX_MISES_LAYERS, history.layers, strict=True)):
        if count:
            axes = (table.STRESS_STEP.name, layer_axis(i, history.layers).name)
            values = np.array([state.layers[i] for state in states])
            pairs.append((replace(variable, dimensions=axes), values))
    return pairs


def stress_rows(history: StressHistory, times: FloatArray) -> dict[str, FloatArray]:
    """Return the stresses of a history that sweeps store, NaN in states without stress.

    Parameters
    ----------
    times : (rows,) float, s, of all stored states.
    """
    row = {time: i for i, time in enumerate(times.tolist())}

    def layered(entries: Sequence[Any]) -> list[Any]:
        """Return the entries of bodies with layers."""
        return [entry for entry, count in zip(entries, history.layers, strict=True) if count]

    def points(state: StressState) -> tuple[FloatArray, ...]:
        at = state.points
        return (mises(at), max_shear(at)) if len(history.points) else ()

    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(table.LARGEST_STRESS, ())
    shapes |= {
        name: (size,)
        for name, size in zip(
            layered(list(table.LAYER_STRESS)), layered(history.layers), strict=True
        )
    }
    if len(history.points):
        shapes |= dict.fromkeys(table.POINT_STRESS, (len(history.points),))
    columns = {name: np.full((len(row), *shape), np.nan) for name, shape in shapes.items()}
    for state in history.states:
        largest = state.of_both
        place = largest.mises, largest.r, largest.z, largest.layer
        values = *place, *layered(state.layers), *points(state)
        for name, value in zip(columns, values, strict=True):
            columns[name][row[state.time]] = value
    return columns


def _points(history: StressHistory) -> list[tuple[str, Any]]:
    """Return radii, heights and sides of the points by name, nothing where there are none."""
    if not len(history.points):
        return []
    r, z = history.points.T
    return [
        (table.POINT_R.name, r), (table.POINT_Z.name, z),
        (table.POINT_SIDE.name, list(history.sides)),
    ]  # fmt: skip


def point_columns(history: StressHistory) -> dict[str, FloatArray]:
    """Return radii, heights and sides of the points in numbers, nothing where there are none."""
    return {
        name: np.array([table.POINT_SIDES.index(side) for side in values], dtype=float)
        if name == table.POINT_SIDE.name
        else values
        for name, values in _points(history)
    }


def side_words(numbers: FloatArray) -> Any:
    """Return the sides, as bytes, that a sweep's numbers stand for, none for NaN."""
    return np.array(table.POINT_SIDES, dtype="S")[np.nan_to_num(numbers).astype(int)]


def side_numbers(words: Any) -> FloatArray:
    """Return the numbers of sides."""
    numbers = np.full(words.shape, np.nan)
    for number, side in enumerate(table.POINT_SIDES):
        numbers[words == side.encode()] = number
    return numbers


def _columns(variables: tuple[Variable, ...], places: list[Largest]) -> list[tuple[Variable, Any]]:
    rows = zip(*((place.mises, place.r, place.z, place.layer) for place in places), strict=True)
    return [(v, np.array(row, v.dtype)) for v, row in zip(variables, rows, strict=True)]


def read_stress(file: h5py.File, sizes: dict[str, int]) -> StressHistory | None:
    """Return the stored stresses, None where there are none; any exception means damage."""
    if table.STRESS_TIME.name not in file:
        return None
    sizes = {**sizes, "component": len(COMPONENTS), table.SIDE.name: len(SIDES)}

    def read(variable: Variable) -> Any:
        return read_array(file, variable, sizes)

    times, steps = read(table.STRESS_TIME), read(table.STRESS_STEPS_MADE)
    count = len(times)
    points, at_points = np.empty((0, 2)), np.empty((count, 0, 6))
    sides: tuple[str, ...] = ()
    if table.STRESS.name in file:
        points = np.stack([read(table.POINT_R), read(table.POINT_Z)], axis=1)
        at_points = read(table.STRESS)
        sides = tuple(find_texts(file, table.POINT_SIDE.name, sizes, "point")[()].tolist())
    axes, on_grid = (np.empty(0), np.empty(0)), np.empty((count, 0, 0, 6))
    if table.STRESS_GRID.name in file:
        axes = read(table.GRID_R), read(table.GRID_Z)
        on_grid = read(table.STRESS_GRID)
    surface = [read(variable) for variable in table.SURFACE_STRESS]
    none = Interfaces(np.empty(0), np.empty(0)), np.empty((count, 0, len(SIDES), 0, 6))
    lower, upper = (
        (Interfaces(read(names.r), read(names.z)), read(names.stress))
        if names.stress.name in file
        else none
        for names in table.INTERFACES
    )
    largest = [
        [Largest(*row) for row in zip(*(read(v).tolist() for v in variables), strict=True)]
        for variables in table.MAX_MISES_OF
    ]
    layers = [  # which may have a dimension of their own
        read_array(file, variable, {"stress_step": count})
        if variable.name in file
        else np.empty((count, 0))
        for variable in table.MAX_MISES_LAYERS
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
    return StressHistory(
        points, sides, axes, float(read(table.EXCLUDE)), (lower[0], upper[0]), states
    )
