"""Stresses and fields on whole boundaries: as arrays by name, and what a result has of them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import (
    BoundaryFields,
    BoundaryState,
    Interfaces,
    Largest,
    StressHistory,
    StressState,
    max_shear,
    mises,
    principal,
)
from ringwear_par.errors import InputError
from ringwear_par.results.result import Result
from ringwear_par.results.variables import (
    LARGEST_STRESS,
    LAYER_STRESS,
    POINT_SIDE,
    POINT_SIDES,
    POINT_STRESS,
)

#: ends of the names of the numbers of a ``Largest``
_LARGEST = {"": "mises", "_r": "r", "_z": "z", "_layer": "layer"}
#: arrays of a ``StressState`` by the name of its field, the later ones of each body
_OF_STATE = {"points": "stress", "grid": "stress_grid"}
_OF_BODY = {
    "surface": "surface_stress_{}",
    "interfaces": "interface_stress_{}",
    "layers": "max_mises_{}_layers",
}


def stress_arrays(history: StressHistory) -> dict[str, Any]:
    """Return the stresses of stored states by name, nothing where there is no state."""
    states = history.states
    if not states:
        return {}
    values: dict[str, Any] = {
        "stress_time": [state.time for state in states],
        "stress_steps_made": [state.step for state in states],
        "grid_r": history.grid[0],
        "grid_z": history.grid[1],
    }
    for field, name in _OF_STATE.items():
        values[name] = [getattr(state, field) for state in states]
    for i, (body, lines) in enumerate(zip(BODIES, history.interfaces, strict=True)):
        values |= {f"interface_r_{body}": lines.r, f"interface_z_{body}": lines.z}
        for field, name in _OF_BODY.items():
            values[name.format(body)] = [getattr(state, field)[i] for state in states]
        for end, number in _LARGEST.items():
            values[f"max_mises_{body}{end}"] = [getattr(s.largest[i], number) for s in states]
    data = {name: np.array(v) for name, v in values.items() if len(v) and np.size(v[0])}
    return {**data, **_points(history), "stress_exclude": np.array(history.exclude)}


def stress_history(data: Mapping[str, Any]) -> StressHistory | None:
    """Return the stresses of which these are the arrays, None where there are none."""
    if "stress_time" not in data:
        return None
    times, steps = data["stress_time"].tolist(), data["stress_steps_made"].tolist()
    none, no_stress = np.empty(0), np.empty((len(times), 0, 6))
    largest = [[data[f"max_mises_{body}{end}"].tolist() for end in _LARGEST] for body in BODIES]

    def state(t: int) -> StressState:
        of_bodies: Any = {
            field: tuple(data.get(name.format(body), no_stress)[t] for body in BODIES)
            for field, name in _OF_BODY.items()
        }
        lower, upper = (Largest(*(numbers[t] for numbers in of_body)) for of_body in largest)
        fields = {field: data.get(name, no_stress)[t] for field, name in _OF_STATE.items()}
        return StressState(steps[t], times[t], **fields, **of_bodies, largest=(lower, upper))

    lower, upper = (
        Interfaces(*(data.get(f"interface_{axis}_{body}", none) for axis in "rz"))
        for body in BODIES
    )
    return StressHistory(
        np.stack([data.get(name, none) for name in ("point_r", "point_z")], axis=1),
        tuple(data.get("point_side", ())), (data.get("grid_r", none), data.get("grid_z", none)),
        float(data["stress_exclude"]), (lower, upper), tuple(map(state, range(len(times)))),
    )  # fmt: skip


def stress_measures(data: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Return what follows from stored stresses: von Mises' and others, the largest of both bodies.

    Parameters
    ----------
    data : see ``stress_arrays``.
    """
    measures: dict[str, FloatArray] = {}
    for place in ("", "_grid"):
        if f"stress{place}" in data:
            measures[f"mises{place}"] = mises(data[f"stress{place}"])
            measures[f"max_shear{place}"] = max_shear(data[f"stress{place}"])
    if "stress" in data:
        measures["principal"] = principal(data["stress"])
    for body in BODIES:
        if f"interface_stress_{body}" in data:
            measures[f"interface_mises_{body}"] = mises(data[f"interface_stress_{body}"])
    if "stress_time" in data:
        lower, upper = (data[f"max_mises_{body}"] for body in BODIES)
        of_upper = np.where(np.isnan(lower), -np.inf, lower) < upper
        for end in _LARGEST:
            lower, upper = (data[f"max_mises_{body}{end}"] for body in BODIES)
            measures[f"max_mises{end}"] = np.where(of_upper, upper, lower)
    return measures


# -- in sweeps -------------------------------------------------------------------------------------


def stress_rows(history: StressHistory, times: FloatArray) -> dict[str, FloatArray]:
    """Return the stresses of a history that sweeps store, NaN in states without stress.

    Parameters
    ----------
    times : (rows,) float, s, of all stored states.
    """
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(LARGEST_STRESS, ())
    shapes |= {n: (size,) for n, size in zip(LAYER_STRESS, history.layers, strict=True) if size}
    if count := len(history.points):
        shapes |= dict.fromkeys(POINT_STRESS, (count,))
    columns = {name: np.full((len(times), *shape), np.nan) for name, shape in shapes.items()}
    if data := stress_arrays(history):
        data |= stress_measures(data)
        rows = np.searchsorted(times, data["stress_time"])
        for name, column in columns.items():
            column[rows] = data[name]
    return columns


def _points(history: StressHistory) -> dict[str, Any]:
    """Return radii, heights and sides of the points by name, nothing where there are none."""
    if not len(history.points):
        return {}
    r, z = history.points.T
    return {"point_r": r, "point_z": z, POINT_SIDE.name: list(history.sides)}


def point_columns(history: StressHistory) -> dict[str, FloatArray]:
    """Return radii, heights and sides of the points in numbers, nothing where there are none."""
    columns = _points(history)
    if columns:
        sides = map(POINT_SIDES.index, columns[POINT_SIDE.name])
        columns[POINT_SIDE.name] = np.array([*sides], dtype=float)
    return columns


def side_words(numbers: FloatArray) -> Any:
    """Return the sides, as bytes, that a sweep's numbers stand for, none for NaN."""
    return np.array(POINT_SIDES, dtype="S")[np.nan_to_num(numbers).astype(int)]


# -- boundaries ------------------------------------------------------------------------------------

#: arrays of ``BoundaryFields`` that are the same at all states, and those that are not
_MESH = ("elements", "face")
_MOVING = ("nodes", "displacement", "traction", "pressure", "wear")


def boundary_arrays(states: Sequence[BoundaryState]) -> dict[str, Any]:
    """Return the fields of stored states on both boundaries by name, nothing of no state."""
    data: dict[str, Any] = {}
    for i, body in enumerate(BODIES if states else ()):
        bodies = [state.bodies[i] for state in states]
        of_body = {name: getattr(bodies[0], name) for name in _MESH}
        of_body |= {n: np.array([getattr(fields, n) for fields in bodies]) for n in _MOVING}
        of_body["time"] = np.array([state.time for state in states])
        of_body["steps_made"] = np.array([state.step for state in states])
        data |= {f"boundary/{body}/{name}": values for name, values in of_body.items()}
    return data


def boundary_states(data: Mapping[str, Any]) -> tuple[BoundaryState, ...]:
    """Return the fields on boundaries of which these are the arrays, () where there are none."""
    if "boundary/lower/time" not in data:
        return ()

    def of(body: str, t: int) -> BoundaryFields:
        mesh = {name: data[f"boundary/{body}/{name}"] for name in _MESH}
        return BoundaryFields(**mesh, **{n: data[f"boundary/{body}/{n}"][t] for n in _MOVING})

    times, steps = (data[f"boundary/lower/{name}"].tolist() for name in ("time", "steps_made"))
    return tuple(
        BoundaryState(step, time, (of("lower", t), of("upper", t)))
        for t, (step, time) in enumerate(zip(steps, times, strict=True))
    )


# -- what a result has of them ---------------------------------------------------------------------


def stresses(result: Result) -> StressHistory:
    """Return the stored stresses.

    Raises
    ------
    InputError : there are none.
    """
    if result.stress is None:
        raise _lacks(result, "stresses", "computed with [stress] in its case")
    return result.stress


def check_grid(result: Result) -> None:
    """Refuse a result without stresses on a grid.

    Raises
    ------
    InputError : there are none, or none on a grid.
    """
    if not len(stresses(result).grid[0]):
        raise _lacks(result, "stresses on a grid", "computed with stress.grid")


def nearest_states(states: Sequence[StressState], times: Sequence[float]) -> list[StressState]:
    """Return the states nearest to times (s), the last one for none."""
    stored = np.array([state.time for state in states])
    rows = {int(np.abs(stored - time).argmin()) for time in times} or {len(stored) - 1}
    return [states[row] for row in sorted(rows)]


class Interface(NamedTuple):
    """An interface of a result's bodies."""

    #: 0 for lower, 1 for upper
    body: int
    #: number of the layer over it, towards the contact
    layer: int
    #: (m,) float, mm, mid-points of its elements
    r: FloatArray
    #: mm, its height, unworn
    z: float

    @property
    def name(self) -> str:
        """What it is called in pictures."""
        return f"under layer {self.layer} of {BODIES[self.body]}, z = {self.z:.6g} mm"

    def stress(self, state: StressState) -> FloatArray:
        """Return (2, m, 6) MPa, above and below."""
        return state.interfaces[self.body][self.layer]


def interfaces_of(result: Result) -> list[Interface]:
    """Return the interfaces along which a result has stresses.

    Raises
    ------
    InputError : there are none.
    """
    interfaces = [
        Interface(body, layer, line.r, float(z))
        for body, line in enumerate(stresses(result).interfaces)
        for layer, z in enumerate(line.z)
    ]
    if not interfaces:
        raise _lacks(result, "stresses along interfaces", "of a body with layers")
    return interfaces


def boundaries(result: Result) -> tuple[BoundaryState, ...]:
    """Return the stored states of both bodies' boundaries.

    Raises
    ------
    InputError : there are none.
    """
    if not (states := result.boundary):
        how = 'computed with output.boundary = "last" or "all", or with times'
        raise _lacks(result, "fields on the bodies' boundaries", how)
    return states


def _lacks(result: Result, what: str, must: str) -> InputError:
    return InputError(f"{result.name}: holds no {what}; must be {must}")
