"""Stored stresses as variables of a result's file, and as rows of a sweep."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.stress.fields import (
    COMPONENTS,
    SIDES,
    Largest,
    StressHistory,
    StressState,
    max_shear,
    mises,
    principal,
)
from ringwear_par.results import variables as table
from ringwear_par.results.variables import Variable, layer_axis


def stress_coordinates(history: StressHistory) -> tuple[str, ...]:
    """Return the names of the coordinates that are no dimensions; there is a state at least."""
    of_points = tuple(name for name, _ in _points(history))
    of_interfaces = (
        names
        for lines, v in zip(history.interfaces, table.INTERFACES, strict=True)
        if len(lines.z)
        for names in (v.r.name, v.z.name)
    )
    return (table.STRESS_TIME.name, *of_points, *of_interfaces)


def stress_variables(history: StressHistory) -> list[tuple[Variable, Any]]:
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

    def layered(of_bodies: Sequence[Any]) -> list[Any]:
        """Return the entries of bodies with layers."""
        return [entry for entry, count in zip(of_bodies, history.layers, strict=True) if count]

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
    """Return the numbers of sides.

    Raises
    ------
    ValueError : some are none.
    """
    numbers = np.full(words.shape, np.nan)
    for number, side in enumerate(table.POINT_SIDES):
        numbers[words == side.encode()] = number
    if np.isnan(numbers).any():
        raise ValueError(table.POINT_SIDE.name)
    return numbers


def _columns(variables: tuple[Variable, ...], places: list[Largest]) -> list[tuple[Variable, Any]]:
    rows = zip(*((place.mises, place.r, place.z, place.layer) for place in places), strict=True)
    return [(v, np.array(row, v.dtype)) for v, row in zip(variables, rows, strict=True)]
