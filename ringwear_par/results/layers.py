"""Under the faces of a result: its stresses, interfaces, and where its layers end."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray, share
from ringwear_par.elasticity.sections import BODIES, BodyName
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


#: multiple of the deepest wear within which the end of a layer below the face is drawn
_FAR = 1.5
#: share of its depth within which wear has reached the end of a layer
_ON = 1e-9


@dataclass(frozen=True)
class WornLayer:
    """A layer that wear has got through."""

    #: its number, 0 at the contact face
    layer: int
    #: of the contact area where nothing is left of it, at the end
    share: float
    #: mm, where wear was deepest in the first stored state that shows it
    r: float
    #: s, of that state
    time: float


def ends_near_wear(result: Result, body: BodyName) -> dict[int, FloatArray]:
    """Return depths (n,) mm of ends of layers that wear comes near somewhere, by layer.

    Depths are below the unworn face, along the axis; of the wear a profile is stored.
    """
    deepest = float(result.profiles[f"wear_{body}"].max())
    ends = enumerate(result.data.get(f"layer_end_{body}", ()))
    return {layer: depth for layer, depth in ends if depth.min() <= _FAR * deepest}


def worn_layers(result: Result, body: BodyName) -> list[WornLayer]:
    """Return the layers of a body that wear has got through, as far as stored states tell.

    The result has its last state.
    """
    assert result.checkpoint is not None
    wear, times = result.profiles.get(f"wear_{body}"), result.histories["time"]
    if wear is None or wear.ndim == 1:
        last = result.checkpoint.state
        wear, times = last.wear[BODIES.index(body)][None], np.array([last.time])
    layers, area = [], result.line.area
    for layer, depth in enumerate(result.data.get(f"layer_end_{body}", ())):
        gone = wear >= depth * (1.0 - _ON)
        if gone.any():
            first = int(gone.any(axis=1).argmax())
            deepest = int(np.where(gone[first], wear[first] - depth, -np.inf).argmax())
            r = float(result.line.r[deepest])
            through = share(area, gone[-1])
            layers.append(WornLayer(layer, through, r, float(times[first])))
    return layers
