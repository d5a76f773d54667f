"""Stresses and fields on whole boundaries as arrays by name, for files, and back again."""

from collections.abc import Mapping, Sequence
from typing import Any

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
from ringwear_par.results.variables import (
    LARGEST_STRESS,
    LAYER_STRESS,
    POINT_SIDE,
    POINT_SIDES,
    POINT_STRESS,
)

_AXES = ("r", "z", "theta")
#: arrays of ``BoundaryFields``, and the variables of their columns
_COLUMNS = {
    "nodes": _AXES[:2],
    "displacement": tuple(f"displacement_{axis}" for axis in _AXES),
    "traction": tuple(f"traction_{axis}" for axis in _AXES),
    "pressure": ("pressure",),
    "wear": ("wear",),
}
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
    states, rows = history.states, np.searchsorted(times, [state.time for state in history.states])
    largest = [state.of_both for state in states]
    values: dict[str, tuple[tuple[int, ...], Sequence[Any]]] = {
        name: ((), [getattr(entry, number) for entry in largest])
        for name, number in zip(LARGEST_STRESS, _LARGEST.values(), strict=True)
    }
    for i, (name, size) in enumerate(zip(LAYER_STRESS, history.layers, strict=True)):
        if size:
            values[name] = (size,), [state.layers[i] for state in states]
    if points := len(history.points):
        for name, measure in zip(POINT_STRESS, (mises, max_shear), strict=True):
            values[name] = (points,), [measure(state.points) for state in states]
    columns = {name: np.full((len(times), *shape), np.nan) for name, (shape, _) in values.items()}
    for name, (shape, entries) in values.items():
        columns[name][rows] = np.reshape(entries, (-1, *shape))
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


def boundary_arrays(states: Sequence[BoundaryState]) -> dict[str, Any]:
    """Return the fields of stored states on both boundaries by name, nothing of no state."""
    data: dict[str, Any] = {}
    for i, body in enumerate(BODIES if states else ()):
        fields, group = [state.bodies[i] for state in states], f"boundary/{body}"
        data[f"{group}/time"] = np.array([state.time for state in states])
        data[f"{group}/steps_made"] = np.array([state.step for state in states])
        data[f"{group}/nodes"], data[f"{group}/face"] = fields[0].elements, fields[0].face
        for attribute, names in _COLUMNS.items():
            values = np.array([getattr(field, attribute) for field in fields])
            columns = values.reshape(*values.shape[:2], len(names))
            data |= {f"{group}/{name}": columns[..., j] for j, name in enumerate(names)}
    return data


def boundary_states(data: Mapping[str, Any]) -> tuple[BoundaryState, ...]:
    """Return the fields on boundaries of which these are the arrays, () where there are none."""
    groups = [f"boundary/{body}" for body in BODIES]
    if f"{groups[0]}/time" not in data:
        return ()

    def of(group: str, t: int) -> BoundaryFields:
        columns = {
            attribute: np.stack([data[f"{group}/{name}"][t] for name in names], axis=-1)
            for attribute, names in _COLUMNS.items()
        }
        return BoundaryFields(
            columns["nodes"], data[f"{group}/nodes"], data[f"{group}/face"],
            columns["displacement"], columns["traction"], columns["pressure"][:, 0],
            columns["wear"][:, 0],
        )  # fmt: skip

    times, steps = (data[f"{groups[0]}/{name}"].tolist() for name in ("time", "steps_made"))
    return tuple(
        BoundaryState(step, time, (of(groups[0], t), of(groups[1], t)))
        for t, (step, time) in enumerate(zip(steps, times, strict=True))
    )
