"""Stresses inside the bodies of a result, and along their interfaces."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import StressHistory, StressState
from ringwear_par.errors import InputError
from ringwear_par.results.result import Result


def stresses(result: Result) -> StressHistory:
    """Return the stored stresses.

    Raises
    ------
    InputError : there are none.
    """
    if result.stress is None or not result.stress.states:
        raise InputError(
            f"{result.name}: holds no stresses; must be computed with [stress] in its case"
        )
    return result.stress


def check_grid(result: Result) -> None:
    """Refuse a result without stresses on a grid.

    Raises
    ------
    InputError : there are none, or none on a grid.
    """
    if not len(stresses(result).grid[0]):
        raise InputError(
            f"{result.name}: holds stresses at points only; must be computed with stress.grid"
        )


def nearest_states(states: Sequence[StressState], times: Sequence[float]) -> list[StressState]:
    """Return the states nearest to times (s), the last one for none."""
    stored = np.array([state.time for state in states])
    rows = {int(np.abs(stored - time).argmin()) for time in times} or {len(stored) - 1}
    return [states[row] for row in sorted(rows)]


@dataclass(frozen=True)
class Interface:
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
        raise InputError(
            f"{result.name}: holds no stresses along interfaces; must be of a body with layers"
        )
    return interfaces
