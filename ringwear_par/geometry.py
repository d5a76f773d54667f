"""Meridian sections of rings and discs, and their boundary elements.

Every body is described in its own frame: the contact face is the plane z = 0, the body lies below
it and the held face is z = -height. The upper ring is the mirror image of that picture, with the
same compliance, so one description serves both.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

from ringwear_par.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: grading exponent of the free and held faces towards every corner and contact edge
CORNER_GRADING = 3.5


@dataclass(frozen=True)
class Mesh:
    """Discretisation of a contact pair.

    Parameters
    ----------
    contact_elements : number of elements of the contact line.
    grading : exponent of the grading towards the two contact edges; 1 is a uniform mesh.
    quadrature_tolerance : relative accuracy of the element integrals.
    """

    contact_elements: int = 64
    grading: float = 2.5
    quadrature_tolerance: float = 1e-7


@dataclass(frozen=True)
class Section:
    """Rectangular meridian section with its contact line, in the body's own frame (mm).

    Parameters
    ----------
    r : inner and outer radius; inner radius 0 is a solid disc.
    height : distance from the held face to the contact plane.
    contact : inner and outer radius of the contact line, inside ``r``.
    """

    r: tuple[float, float]
    height: float
    contact: tuple[float, float]

    def __post_init__(self) -> None:
        (inner, outer), (a, b) = self.r, self.contact
        if not (0 <= inner <= a < b <= outer and self.height > 0):
            raise InputError(
                f"section r = {self.r}, height = {self.height}, contact = {self.contact}: "
                "0 <= inner <= contact <= outer radius and a positive height are needed"
            )


@dataclass(frozen=True)
class ContactLine:
    """Contact elements of constant pressure, from the inner to the outer edge.

    Parameters
    ----------
    edges : (n+1,) float, mm, increasing radii of the element ends.
    """

    edges: FloatArray

    @property
    def r(self) -> FloatArray:
        """(n,) mm, mid-points, where gaps and displacements are taken."""
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    @property
    def width(self) -> FloatArray:
        """(n,) mm, radial lengths."""
        return np.diff(self.edges)

    @property
    def area(self) -> FloatArray:
        """(n,) mm^2, annular areas ``m``, so that the force is ``m . p``."""
        return 2.0 * np.pi * self.r * self.width

    @property
    def arm(self) -> FloatArray:
        """(n,) mm, Int r^2 dr / Int r dr: lever arm of a constant traction, and radius of sliding.

        The same radius in the torque and in the sliding speed makes friction power = torque x
        omega, and hence the energy identity, exact for the discrete problem.
        """
        return 2.0 / 3.0 * np.diff(self.edges**3) / np.diff(self.edges**2)

    @property
    def n(self) -> int:
        """Number of elements."""
        return len(self.edges) - 1


class Contour(NamedTuple):
    """Straight quadratic elements along a section's boundary, counter-clockwise.

    A named tuple because compiled code reads it.

    Parameters
    ----------
    nodes : (m, 2) float, mm, radius and height of element ends and mid-points.
    elements : (k, 3) int, first, middle and last node of each element; the outward normal lies to
        the right of the direction of travel.
    contact : (n,) int, elements of the contact line, by increasing radius.
    held : (h,) int, elements of the held face.
    inner_side, outer_side : int arrays, elements of the free cylindrical faces.
    """

    nodes: FloatArray
    elements: IntArray
    contact: IntArray
    held: IntArray
    inner_side: IntArray
    outer_side: IntArray


def graded(start: float, end: float, n: int, first: float, last: float) -> FloatArray:
    """Return n+1 coordinates from start to end, graded towards both ends.

    Element sizes fall like ``t^(first-1)`` and ``(1-t)^(last-1)`` of the element number t in
    (0, 1) (incomplete beta function), so that doubling n splits every element smoothly.
    """
    x = start + (end - start) * betainc(first, last, np.arange(n + 1) / n)
    x[0], x[-1] = start, end  # exactly: faces share their ends
    return x


def contact_line(contact: tuple[float, float], mesh: Mesh) -> ContactLine:
    """Return the contact elements between two radii (mm); not graded towards the axis."""
    a, b = contact
    towards_axis = 1.0 if a == 0 else mesh.grading
    return ContactLine(graded(b, a, mesh.contact_elements, mesh.grading, towards_axis)[::-1].copy())


@dataclass(frozen=True)
class _Face:
    """A straight piece of a section: end points, element number, grading at both ends."""

    name: str
    start: tuple[float, float]
    end: tuple[float, float]
    n: int
    grading: tuple[float, float]

    def coordinates(self) -> FloatArray:
        (r0, z0), (r1, z1) = self.start, self.end
        return np.stack(
            [graded(r0, r1, self.n, *self.grading), graded(z0, z1, self.n, *self.grading)], axis=1
        )


def _faces(section: Section, mesh: Mesh) -> list[_Face]:
    """Return the pieces counter-clockwise, from the inner end of the held face.

    Element numbers on the free and held faces follow ``mesh.contact_elements``, so that one number
    refines everything: half of it on faces that end at a contact edge and on the held face, a
    quarter on the other sides, and as many on the flats beside the contact as their length asks.
    """
    (inner, outer), (a, b), base = section.r, section.contact, -section.height
    n = mesh.contact_elements
    near, far = max(4, n // 2), max(4, n // 4)

    def flat(length: float) -> int:
        return max(4, round(n / 10.0 * (1.0 + math.log1p(length / (b - a)))))

    g = CORNER_GRADING
    axis = 1.0 if inner == 0 else g
    faces = [
        _Face("held", (inner, base), (outer, base), near, (axis, g)),
        _Face("outer_side", (outer, base), (outer, 0.0), near if b == outer else far, (g, g)),
        _Face("flat", (outer, 0.0), (b, 0.0), flat(outer - b), (g, g)),
        _Face("contact", (b, 0.0), (a, 0.0), n, (mesh.grading, 1.0 if a == 0 else mesh.grading)),
        _Face("flat", (a, 0.0), (inner, 0.0), flat(a - inner), (g, axis)),
        _Face("inner_side", (inner, 0.0), (inner, base), near if a == inner else far, (g, g)),
    ]
    on_axis = inner == 0
    return [f for f in faces if f.start != f.end and not (on_axis and f.name == "inner_side")]


def count_elements(section: Section, mesh: Mesh) -> int:
    """Return the number of boundary elements that ``contour`` would make."""
    return sum(face.n for face in _faces(section, mesh))


def contour(section: Section, mesh: Mesh) -> Contour:
    """Return the boundary elements of a section."""
    faces = _faces(section, mesh)
    lines = [face.coordinates() for face in faces]
    ends = np.concatenate([line[:-1] for line in lines])
    after = np.concatenate([line[1:] for line in lines])
    k = len(ends)
    closed = section.r[0] > 0  # otherwise the contour runs from axis to axis
    nodes = np.empty((2 * k + (not closed), 2))
    nodes[0 : 2 * k : 2] = ends
    nodes[1 : 2 * k : 2] = 0.5 * (ends + after)
    if not closed:
        nodes[-1] = after[-1]
    first = 2 * np.arange(k)
    elements = np.stack([first, first + 1, (first + 2) % len(nodes)], axis=1)
    names = np.repeat([face.name for face in faces], [face.n for face in faces])

    def of(name: str) -> IntArray:
        return np.flatnonzero(names == name)

    return Contour(
        nodes, elements, of("contact")[::-1].copy(), of("held"), of("inner_side"), of("outer_side")
    )
