"""Meridian sections of rings and discs, and bodies with them.

Every body is described in its own frame: the contact plane is z = 0, the contact face lies in it or
below it, and the fixed face is z = -height. The upper ring is the mirror image of that picture,
with the same compliance, so one description serves both.
"""

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

#: the two bodies, in the order of everything that is of both
BodyName = Literal["lower", "upper"]
BODIES: tuple[BodyName, BodyName] = ("lower", "upper")
#: vertices (r, z) of a face, a tuple so that it can be hashed
Polyline = tuple[tuple[float, float], ...]
#: how the fixed face is gripped: "clamped" fixes u_r too, "platen" leaves it free
Grip = Literal["clamped", "platen"]
#: turn of a face (rad) from which on a vertex is a corner rather than a sample of a smooth curve
CORNER_ANGLE = math.radians(5.0)
#: fewest vertices of about the same curvature that count as samples of a smooth face
_DENSE = 6


@dataclass(frozen=True)
class Section:
    """Meridian section in the body's own frame (mm): a rectangle but for its contact face."""

    #: inner and outer radius; inner radius 0 is a solid disc
    r: tuple[float, float]
    #: distance from the fixed face to the contact plane
    height: float
    #: contact face as a polyline of (r, z) from the inner to the outer radius, z <= 0; none is the
    #: flat face
    face: Polyline = ()
    #: thicknesses of bonded layers of other materials, from the contact plane downwards; the face
    #: lies within the first
    layers: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        (inner, outer), first = self.r, self.layers[0] if self.layers else self.height
        radii, z = [p[0] for p in self.face], [p[1] for p in self.face]
        over_all = not self.face or (
            (radii[0], radii[-1]) == self.r and all(p < q for p, q in itertools.pairwise(radii))
        )
        if not (
            0 <= inner < outer
            and min((self.height, *self.layers)) > 0
            and sum(self.layers) < self.height
            and over_all
            and all(-first < v <= 0 for v in z)
        ):
            raise InputError(f"{self}: radii, height, layers and face make no section of a body")

    @property
    def points(self) -> FloatArray:
        """(m, 2) mm, vertices of the contact face."""
        return np.array(self.face or [(self.r[0], 0.0), (self.r[1], 0.0)])

    def depth(self, r: FloatArray) -> FloatArray:
        """Return the height z (mm) of the contact face at radii (mm).

        On the polyline, or on cubic splines where its points are dense samples of a smooth face.
        """
        z = np.interp(r, *self.points.T)
        for spline in _splines(self.face):
            inside = (r > spline.x[0]) & (r < spline.x[-1])
            z = np.where(inside, spline(r), z)
        return z

    def contour(self, plane: float, fixed: float) -> FloatArray:
        """Return (m, 2) mm, r and z of the corners, in the frame of the case.

        The contact face from the inner to the outer radius, then two corners of the fixed face.

        Parameters
        ----------
        plane, fixed : mm, heights of the contact plane and of the fixed face.
        """
        r, z = self.points.T
        face = np.stack([r, plane + np.sign(plane - fixed) * z], axis=1)
        return np.concatenate([face, [(self.r[1], fixed), (self.r[0], fixed)]])

    @property
    def face_description(self) -> str:
        """The shape that the contact face is computed with, in words."""
        if not self.face:
            return "flat"
        points, dense = len(self.face), sum(len(spline.x) for spline in _splines(self.face))
        shape = f"straight lines between {points} points"
        if dense == points:
            shape = f"spline through {points} points"
        elif dense:
            shape = f"spline through {dense} of {points} points, straight lines between the others"
        return f"{shape}, {-1e3 * min(z for _, z in self.face):.4g} um deep"


@lru_cache(maxsize=64)
def _splines(face: Polyline) -> tuple["CubicSpline", ...]:
    """Return cubic splines over the dense samples of a face.

    Samples are dense where neighbouring vertices, ``_DENSE`` at least, turn by little and by about
    the same curvature; straight runs are their own splines.
    """
    if len(face) < _DENSE + 2:
        return ()
    from scipy.interpolate import CubicSpline  # slow to import, and most faces need none

    r, z = np.array(face).T
    step = np.diff(r)
    turn = np.diff(np.arctan(np.diff(z) / step))
    bend = turn / (0.5 * (step[1:] + step[:-1]))  # 1/mm, at the inner vertices
    low = np.abs(turn) < CORNER_ANGLE
    alike = np.abs(np.diff(bend)) <= 0.55 * np.maximum(np.abs(bend[1:]), np.abs(bend[:-1]))
    alike &= low[1:] & low[:-1] & (np.abs(bend[1:]) > 1e-9)
    splines, start = [], 0
    for end in [*map(int, np.flatnonzero(~alike)), len(alike)]:
        if end - start + 1 >= _DENSE:
            # vertices start+1 to end+1 of the face; to its ends where there is nothing between
            first = 0 if start == 0 else start + 1
            last = len(r) if end == len(alike) else end + 2
            splines.append(CubicSpline(r[first:last], z[first:last]))
        start = end + 1
    return tuple(splines)


def corners(section: Section) -> list[float]:
    """Return the radii inside the face where its direction turns by more than CORNER_ANGLE."""
    along = np.diff(section.points, axis=0)
    turn = np.abs(np.diff(np.arctan2(along[:, 1], along[:, 0])))
    return section.points[1:-1, 0][turn > CORNER_ANGLE].tolist()


@dataclass(frozen=True)
class Material:
    """Isotropic elasticity: Young's modulus (MPa) and Poisson's ratio."""

    young: float
    poisson: float


@dataclass(frozen=True)
class Body:
    """An elastic body of revolution in contact, fixed at the face away from it."""

    #: meridian section, mm, in the body's own frame
    section: Section
    #: MPa, Young's modulus, under the layers
    young: float
    #: Poisson's ratio, likewise
    poisson: float
    #: how the face away from the contact is fixed
    grip: Grip
    #: materials of the section's layers, one each
    layers: tuple[Material, ...] = ()

    @property
    def relative(self) -> tuple[Material, ...]:
        """Materials from the contact face downwards, moduli over that of the body itself."""
        base = Material(1.0, self.poisson)
        return *(Material(m.young / self.young, m.poisson) for m in self.layers), base
