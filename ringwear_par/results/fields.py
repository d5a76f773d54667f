"""Stresses and fields on whole boundaries: what the arrays of a result have of them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
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
from ringwear_par.history.stresses import BOUNDARY_MESHES
from ringwear_par.results.result import Result
from ringwear_par.results.variables import (
    LARGEST_STRESS,
    LAYER_STRESS,
    POINT_SIDES,
    POINT_STRESS,
    VARIABLES,
)

#: ends of the names of the numbers of a ``Largest``
_LARGEST = ("", "_r", "_z", "_layer")
#: what sweeps store of stresses
_SWEPT = (*LARGEST_STRESS, *LAYER_STRESS, *POINT_STRESS)
#: arrays of a ``StressState`` by the name of its field, the later ones of each body
_OF_STATE = {"points": "stress", "grid": "stress_grid"}
_OF_BODY = {
    "surface": "surface_stress_{}",
    "interfaces": "interface_stress_{}",
    "layers": "max_mises_{}_layers",
}


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
    data : see ``variables.VARIABLES``.
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


def stored_states(data: Mapping[str, Any], axis: str, times: FloatArray) -> list[dict[str, Any]]:
    """Return the arrays of each state along an axis of stress or boundaries, at some times, s."""
    names = [n for n in data if n in VARIABLES and VARIABLES[n].dimensions[:1] == (axis,)]
    (at, *_) = [*(data[n] for n in names if n.endswith("time")), ()]
    fixed = {n: data[n] for n in BOUNDARY_MESHES if n in data and axis == "boundary_step"}
    return [{n: data[n][t] for n in names} | fixed for t, time in enumerate(at) if time in times]


# -- in sweeps -------------------------------------------------------------------------------------


def stress_columns(
    stresses: Sequence[Mapping[str, Any]], times: FloatArray, offsets: IntArray
) -> dict[str, FloatArray]:
    """Return the stresses of B histories that sweeps store, NaN in states without stress.

    Parameters
    ----------
    stresses : arrays of each history by name, nothing where it has none.
    times : (rows,) float, s, of all stored states; those of history i are ``offsets[i]`` on.
    """
    columns: dict[str, FloatArray] = {}
    for i, data in enumerate(stresses):
        if not data:
            continue
        first, end = offsets[i : i + 2]
        rows = first + np.searchsorted(times[first:end], data["stress_time"])
        known = {**data, **stress_measures(data)}
        for name in (name for name in _SWEPT if name in known):
            if name not in columns:
                columns[name] = np.full((len(times), *known[name].shape[1:]), np.nan)
            columns[name][rows] = known[name]
    return columns


def side_words(numbers: FloatArray) -> Any:
    """Return the sides, as bytes, that a sweep's numbers stand for, none for NaN."""
    return np.array(POINT_SIDES, dtype="S")[np.nan_to_num(numbers).astype(int)]


# -- boundaries ------------------------------------------------------------------------------------

#: arrays of ``BoundaryFields`` that are the same at all states, and those that are not
_MESH = ("elements", "face")
_MOVING = ("nodes", "displacement", "traction", "pressure", "wear")


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
