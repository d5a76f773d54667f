"""What is known of stresses in the bodies, after they have been computed or read."""

from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray

#: faces of a body; their numbers are stored
FACES = ("free", "contact", "fixed", "inner_side", "outer_side", "interface")

#: names of ``BoundaryFields`` that are the same at all states
MESH_FIELDS = ("elements", "face")


@dataclass(frozen=True)
class BoundaryFields:
    """Fields on the boundary of one body, in the frame of the case.

    Layers have boundaries of their own, one after another from the contact face on; an interface
    has elements on both sides.
    """

    #: (m, 2) float, mm, r and z of the worn, undeformed body
    nodes: FloatArray
    #: (k, 3) int, first, middle and last node; the outward normal lies to the right
    elements: IntArray
    #: (k,) int, index in FACES
    face: IntArray
    #: (m, 3) float, mm, along r, z and theta, elastic but for the approach: the upper body's u_z
    #: includes the descent of its fixed top
    displacement: FloatArray
    #: (k, 3) float, MPa, along r, z and theta, per area of the boundary, constant on each element.
    #: On the contact line it is that of pressure along the common normal of the faces and of
    #: friction; the axial force is that on the projected area.
    traction: FloatArray
    #: (k,) float, MPa and mm, 0 off the contact line
    pressure: FloatArray
    wear: FloatArray

    @property
    def contours(self) -> list[IntArray]:
        """Numbers of the nodes on the boundary of each zone, along it."""
        apart = (self.elements[1:, [0, 2]] != self.elements[:-1, [2, 0]]).all(axis=1)
        zones = np.split(self.elements, np.flatnonzero(apart) + 1)
        return [np.arange(zone.min(), zone.max() + 1) for zone in zones]


@dataclass(frozen=True)
class BoundaryState:
    """Fields on the boundaries of lower and upper after ``step`` steps, at ``time`` (s)."""

    step: int
    time: float
    bodies: tuple[BoundaryFields, BoundaryFields]


@dataclass(frozen=True)
class Largest:
    """The largest von Mises stress (MPa) of a body, its place (mm), and the layer it is in.

    Layers are numbered from the contact face on, the last is the body itself. NaN and -1 where
    there is no stress.
    """

    mises: float
    r: float
    z: float
    layer: int


#: in the order of the last axis of stresses; tension is positive, z points upwards
COMPONENTS = ("rr", "tt", "zz", "rz", "rt", "tz")
#: sides of an interface, in the order of the axis of stresses there
SIDES = ("above", "below")


def mises(stress: FloatArray) -> FloatArray:
    """Return von Mises' equivalent (...) of stresses (..., 6)."""
    rr, tt, zz, rz, rt, tz = np.moveaxis(stress, -1, 0)
    normal = (rr - tt) ** 2 + (tt - zz) ** 2 + (zz - rr) ** 2
    return np.sqrt(0.5 * normal + 3.0 * (rz**2 + rt**2 + tz**2))


def principal(stress: FloatArray) -> FloatArray:
    """Return the principal values (..., 3) of stresses (..., 6), the largest first."""
    rr, tt, zz, rz, rt, tz = np.moveaxis(stress, -1, 0)
    tensor = np.stack([rr, rt, rz, rt, tt, tz, rz, tz, zz], axis=-1).reshape(*rr.shape, 3, 3)
    finite = np.isfinite(stress).all(axis=-1)
    values = np.linalg.eigvalsh(np.where(finite[..., None, None], tensor, 0.0))[..., ::-1]
    return np.where(finite[..., None], values, np.nan)


def max_shear(stress: FloatArray) -> FloatArray:
    """Return the largest shear stress (...) of stresses (..., 6), half of Tresca's equivalent."""
    values = principal(stress)
    return 0.5 * (values[..., 0] - values[..., 2])
