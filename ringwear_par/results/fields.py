"""Stresses and fields on whole boundaries: what the arrays of a result have of them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import (
    MESH_FIELDS,
    BoundaryState,
    max_shear,
    mises,
    principal,
)
from ringwear_par.errors import InputError
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
    fixed = {n: data[n] for n in data if axis == "boundary_step" and n.endswith(MESH_FIELDS)}
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


# -- what a result has of them ---------------------------------------------------------------------


def stresses(result: Result) -> dict[str, Any]:
    """Return the stored stresses by name, see ``Result.stress``; InputError: there are none."""
    if not result.stress:
        raise _lacks(result, "stresses", "computed with [stress] in its case")
    return result.stress


def check_grid(result: Result) -> None:
    """Refuse a result without stresses on a grid by an InputError."""
    if "stress_grid" not in stresses(result):
        raise _lacks(result, "stresses on a grid", "computed with stress.grid")


def boundaries(result: Result) -> tuple[BoundaryState, ...]:
    """Return the stored states of both bodies' boundaries; InputError: there are none."""
    if not (states := result.boundary):
        how = 'computed with output.boundary = "last" or "all", or with times'
        raise _lacks(result, "fields on the bodies' boundaries", how)
    return states


def _lacks(result: Result, what: str, must: str) -> InputError:
    return InputError(f"{result.name}: holds no {what}; must be {must}")


def nearest_rows(stored: FloatArray, times: Sequence[float]) -> list[int]:
    """Return which stored times (s) are nearest to times, the last one for none."""
    return sorted({int(np.abs(stored - time).argmin()) for time in times} or {len(stored) - 1})


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
    #: (t, 2, m, 6) MPa, above and below, at stored times
    stress: FloatArray

    @property
    def name(self) -> str:
        """What it is called in pictures."""
        return f"under layer {self.layer} of {BODIES[self.body]}, z = {self.z:.6g} mm"


def interfaces_of(result: Result) -> list[Interface]:
    """Return the interfaces along which a result has stresses; InputError: there are none."""
    of = stresses(result)
    interfaces = [
        Interface(i, layer, of[f"interface_r_{body}"], z, of[f"interface_stress_{body}"][:, layer])
        for i, body in enumerate(BODIES)
        for layer, z in enumerate(of.get(f"interface_z_{body}", np.empty(0)).tolist())
    ]
    if not interfaces:
        raise _lacks(result, "stresses along interfaces", "of a body with layers")
    return interfaces
