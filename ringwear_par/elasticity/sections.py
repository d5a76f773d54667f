"""Meridian sections of rings and discs, and their contact faces as case files give them.

Every body is described in its own frame: the contact plane is z = 0, the contact face lies in it or
below it, and the fixed face is z = -height. The upper ring is the mirror image of that picture,
with the same compliance, so one description serves both.
"""

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal, NamedTuple

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
            raise InputError(
                f"section r = {self.r}, height = {self.height}, layers = {self.layers}, face = "
                f"{self.face}: 0 <= inner < outer radius, layers thicker than 0 that are together "
                "thinner than the body, and a face over increasing radii within the first of them, "
                "or above the fixed face, are needed"
            )

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
    #: materials of the section's layers
    layers: tuple[Material, ...] = ()

    def __post_init__(self) -> None:
        if len(self.layers) != len(self.section.layers):
            raise InputError(
                f"body: {len(self.layers)} materials for {len(self.section.layers)} layers"
            )

    @property
    def relative(self) -> tuple[Material, ...]:
        """Materials from the contact face downwards, moduli over that of the body itself."""
        base = Material(1.0, self.poisson)
        return *(Material(m.young / self.young, m.poisson) for m in self.layers), base


Pair = tuple[float, float]
#: what counts as equal, relative to the size of a body
CLOSE = 1e-9
#: the shapes that have names, and the units of their numbers
SHAPE_UNITS = {"crown": "mm", "sphere": "mm", "cone": "deg", "fillet": "mm", "trace": "mm"}
#: points of a crown or sphere, and of a fillet's quarter of a circle
_SAMPLES, _ARC = 101, 31


class Shape(NamedTuple):
    """A contact face by the name of its shape."""

    #: one of ``SHAPE_UNITS``, or "chamfer"
    name: str
    #: what it has: radii in mm (of a chamfer or fillet one or two), an angle in degrees, radii and
    #: heights in mm in turns
    numbers: tuple[float, ...]


def shape_faults(shape: Shape, r: Pair, z: Pair) -> list[str]:
    """Return the faults of the shape of a body's face, "key = value: sentence"."""
    (a, b), height, first = r, z[1] - z[0], shape.numbers[0]
    entry, faults = f"profile = {{ {shape.name} = {first:g} }}", []
    if shape.name == "crown" and first <= 0.5 * (b - a):
        faults.append(f"{entry}: must be > {0.5 * (b - a):g}, half the width of the face (mm)")
    elif shape.name == "sphere" and first <= b:
        faults.append(f"{entry}: must be > {b:g}, the outer radius (mm)")
    elif shape.name in ("chamfer", "fillet"):
        inner, outer = _at_edges(shape.numbers, r)
        entry = f"{shape.name} = [{inner:g}, {outer:g}]"
        entry = f"profile = {{ {entry} }}" if shape.name == "fillet" else entry
        if a == 0 and inner > 0:
            faults.append(f"{entry}: a solid disc has no inner corner; the first must be 0 (mm)")
        if inner + outer >= b - a:
            faults.append(f"{entry}: both together must be < {b - a:g}, the width of the face (mm)")
    elif shape.name == "trace":
        entry, end = f"profile: a trace from r = {first:g}", shape.numbers[-2]
        if first > a + CLOSE * b or end < b - CLOSE * b:
            faults.append(f"{entry} to {end:g} mm; must cover the face, from {a:g} to {b:g} mm")
    deepest = 0.0 if faults else -min((depth for _, depth in shape_face(shape, r)), default=0.0)
    if deepest >= height:
        faults.append(
            f"{entry}: recedes by {deepest:g}; must be < {height:g}, the height of the body (mm)"
        )
    return faults


def shape_face(shape: Shape, r: Pair) -> Polyline:
    """Return a face of a sound shape in the body's own frame, its highest point at z = 0.

    Curves are sampled so densely that they are taken for smooth.
    """
    (a, b), numbers = r, shape.numbers
    if shape.name in ("chamfer", "fillet"):
        return _edged(*_at_edges(numbers, r), r, shape.name)
    if shape.name == "trace":
        radii, heights = np.array(numbers[::2]), np.array(numbers[1::2])
        x = np.unique([a, *radii[(radii > a) & (radii < b)], b])
        z = np.interp(x, radii, heights)
    else:
        x, size = np.linspace(a, b, _SAMPLES), numbers[0]
        if shape.name == "cone":
            x = np.array([a, b])
            z = -math.tan(math.radians(size)) * x
        else:
            centre = 0.5 * (a + b) if shape.name == "crown" else 0.0
            z = -((x - centre) ** 2) / (size + np.sqrt(size**2 - (x - centre) ** 2))
    z = z - z.max()
    return tuple(zip(x.tolist(), z.tolist(), strict=True)) if z.any() else ()


def _at_edges(numbers: tuple[float, ...], r: Pair) -> Pair:
    """Return the sizes at the inner and outer edge; one number is for the edges that there are."""
    inner = 0.0 if len(numbers) == 1 and r[0] == 0 else numbers[0]
    return inner, numbers[-1]


def _edged(inner: float, outer: float, r: Pair, name: str) -> Polyline:
    """Return the flat face with edges cut off at 45 degrees or rounded by quarters of circles."""
    edge = np.array([[1.0, -1.0], [0.0, 0.0]])  # of size 1, from the side face to the flat one
    if name == "fillet":
        angles = np.radians(np.linspace(90.0, 0.0, _ARC))
        edge = np.stack([np.sin(angles), np.cos(angles) - 1.0], axis=1)
    a, b = r
    points = [(a, 0.0), (b, 0.0)]
    if inner > 0:
        points[:1] = [(a + inner * (1.0 - x), inner * z) for x, z in edge]
    if outer > 0:
        points[-1:] = [(b - outer * (1.0 - x), outer * z) for x, z in edge[::-1]]
    return tuple((float(x), float(z)) for x, z in points) if inner or outer else ()


def profile_faults(ring: str, profile: Polyline, r: Pair, z: Pair) -> list[str]:
    """Return the faults of the profile of "lower" or "upper", "key = value: sentence"."""
    faults = []

    def point(i: int) -> str:
        return f"profile[{i}] = [{profile[i][0]:.12g}, {profile[i][1]:.12g}]"

    back = next((i for i, (p, q) in enumerate(itertools.pairwise(profile), 1) if q[0] <= p[0]), 0)
    if back:
        faults.append(
            f"{point(back)}: the face does not face the other body where r does not increase; "
            f"must be > {profile[back - 1][0]:.12g}, the radius before"
        )
    for i, end, where in ((0, r[0], "inner"), (len(profile) - 1, r[1], "outer")):
        if not back and abs(profile[i][0] - end) > CLOSE * max(1.0, r[1]):
            faults.append(
                f"{point(i)}: the profile must run from the inner to the outer radius; its "
                f"{where} end must have r = {end:.12g} (mm)"
            )
    slack = CLOSE * max(1.0, *map(abs, z))
    low, high = (">", "<=") if ring == "lower" else (">=", "<")
    for i, (_, height) in enumerate(profile):
        depth = z[1] - height if ring == "lower" else height - z[0]
        if not -slack <= depth < z[1] - z[0] - slack:
            faults.append(
                f"{point(i)}: leaves the body; z must be {low} {z[0]:g} and {high} {z[1]:g} (mm)"
            )
            break  # one sentence for all points outside
    return faults


def profile_face(ring: str, profile: Polyline, r: Pair, z: Pair) -> Polyline:
    """Return a sound profile of "lower" or "upper" in the body's own frame, its ends snapped."""
    radii = [r[0], *(p[0] for p in profile[1:-1]), r[1]]
    heights_of_points = [p[1] - z[1] if ring == "lower" else z[0] - p[1] for p in profile]
    heights = [min(0.0, v) for v in heights_of_points]  # the contact plane is met but for round-off
    return tuple(zip(radii, heights, strict=True)) if any(heights) else ()
