"""What is known on the whole boundary of a body, after it has been recovered or read."""

from dataclasses import dataclass
from typing import Literal

from ringwear_par.arrays import FloatArray, IntArray

Which = Literal["lower", "upper"]
BODIES: tuple[Which, Which] = ("lower", "upper")
#: faces of a body; their numbers are stored
FACES = ("free", "contact", "fixed", "inner_side", "outer_side")


@dataclass(frozen=True)
class BoundaryFields:
    """Fields on the boundary of one body, in the frame of the case.

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


@dataclass(frozen=True)
class BoundaryState:
    """Fields on the boundaries of lower and upper after ``step`` steps, at ``time`` (s)."""

    step: int
    time: float
    bodies: tuple[BoundaryFields, BoundaryFields]
