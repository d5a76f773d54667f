"""What is known on the whole boundary of a body, after it has been recovered or read."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray

Which = Literal["lower", "upper"]
BODIES: tuple[Which, Which] = ("lower", "upper")
#: faces of a body; their numbers are stored
FACES = ("free", "contact", "fixed", "inner_side", "outer_side", "interface")


@dataclass(frozen=True)
class BoundaryFields:
    """Fields on the boundary of one body, in the frame of the case.

    Layers have boundaries of their own, one after another from the contact face on; an interface
    has elements on both sides.

    Parameters
    ----------
    nodes : (m, 2) float, mm, r and z of the worn, undeformed body.
    elements : (k, 3) int, first, middle and last node; the outward normal lies to the right.
    face : (k,) int, index in FACES.
    displacement : (m, 3) float, mm, along r, z and theta, elastic but for the approach: the upper
        body's u_z includes the descent of its fixed top.
    traction : (k, 3) float, MPa, along r, z and theta, per area of the boundary, constant on each
        element. On the contact line it is that of pressure along the common normal of the faces
        and of friction; the axial force is that on the projected area.
    pressure, wear : (k,) float, MPa and mm, 0 off the contact line.
    """

    nodes: FloatArray
    elements: IntArray
    face: IntArray
    displacement: FloatArray
    traction: FloatArray
    pressure: FloatArray
    wear: FloatArray

    @property
    def contours(self) -> list[IntArray]:
        """Numbers of the nodes on the boundary of each zone, along it."""
        apart = (self.elements[1:, [0, 2]] != self.elements[:-1, [2, 0]]).all(axis=1)
        zones = np.split(self.elements, np.flatnonzero(apart) + 1)
        return [np.arange(zone.min(), zone.max() + 1) for zone in zones]


def joined(zones: Sequence[BoundaryFields]) -> BoundaryFields:
    """Return the fields of the zones of a body as one."""
    if len(zones) == 1:
        return zones[0]
    first = np.cumsum([0, *(len(zone.nodes) for zone in zones[:-1])])
    elements = [zone.elements + shift for zone, shift in zip(zones, first, strict=True)]
    fields = [
        np.concatenate([getattr(zone, name) for zone in zones])
        for name in ("face", "displacement", "traction", "pressure", "wear")
    ]
    nodes = np.concatenate([zone.nodes for zone in zones])
    return BoundaryFields(nodes, np.concatenate(elements), *fields)


@dataclass(frozen=True)
class BoundaryState:
    """Fields on the boundaries of lower and upper after ``step`` steps, at ``time`` (s)."""

    step: int
    time: float
    bodies: tuple[BoundaryFields, BoundaryFields]
