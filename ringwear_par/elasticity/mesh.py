"""Boundary elements of meridian sections, and the elements of the contact line.

The face is a polyline over the radius. Elements of the two faces over the same interval of radii
are paired (see ``slopes``).
"""

import itertools
import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.sections import Body, Section, corners
from ringwear_par.errors import ComputationError, InputError

#: fewest elements of a piece of the contact line
FEWEST = 4
#: grading exponent of the free and fixed faces towards every corner and contact edge
CORNER_GRADING = 3.5


@dataclass(frozen=True)
class Mesh:
    """Discretisation of a contact pair.

    Parameters
    ----------
    contact_elements : number of elements of the contact line.
    grading : exponent of the grading towards the ends of the contact line and its corners; 1 is a
        uniform mesh.
    quadrature_tolerance : relative accuracy of the element integrals.
    contact : radii (mm) to which the contact line is cut, None for no cut.
    geometry : whether the elements follow the worn profile ("updated") or not ("fixed").
    geometry_tolerance : mm of wear since the last assembly that asks for a new one.
    """

    contact_elements: int = 64
    grading: float = 2.5
    quadrature_tolerance: float = 1e-7
    contact: tuple[float, float] | None = None
    geometry: Literal["fixed", "updated"] = "fixed"
    geometry_tolerance: float = 0.005


@dataclass(frozen=True)
class ContactLine:
    """Contact elements of constant pressure, from the inner to the outer edge.

    Parameters
    ----------
    edges : (n+1,) float, mm, increasing radii of the element ends.
    """

    edges: FloatArray

    def __repr__(self) -> str:
        a, b = self.edges[[0, -1]]
        return f"<ContactLine: {self.n} elements, r = {a:g} to {b:g} mm>"

    @property
    def r(self) -> FloatArray:
        """(n,) mm, mid-points."""
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    @property
    def gap_point(self) -> FloatArray:
        """(n,) mm, where gaps and displacements are taken: the mid-points, as the equation is."""
        return self.r

    @property
    def width(self) -> FloatArray:
        """(n,) mm, radial lengths."""
        return np.diff(self.edges)

    @property
    def area(self) -> FloatArray:
        """(n,) mm^2, annular areas ``m`` on the contact plane, so that the force is ``m . p``."""
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


class BoundaryMesh(NamedTuple):
    """Straight quadratic elements along a section's boundary, counter-clockwise.

    A named tuple because compiled code reads it.

    Parameters
    ----------
    nodes : (m, 2) float, mm, radius and height of element ends and mid-points.
    elements : (k, 3) int, first, middle and last node of each element; the outward normal lies to
        the right of the direction of travel.
    contact : (n,) int, elements of the contact line, by increasing radius.
    fixed : (h,) int, elements of the fixed face.
    inner_side, outer_side : int arrays, elements of the free cylindrical faces.
    """

    nodes: FloatArray
    elements: IntArray
    contact: IntArray
    fixed: IntArray
    inner_side: IntArray
    outer_side: IntArray


def graded(start: float, end: float, n: int, first: float, last: float) -> FloatArray:
    """Return n+1 coordinates from start to end, graded towards both ends.

    Element sizes fall like ``t^(first-1)`` and ``(1-t)^(last-1)`` of the element number t in
    (0, 1) (incomplete beta function), so that doubling n splits every element smoothly.
    """
    from scipy.special import betainc  # slow to import, and reading a case needs no mesh

    x = start + (end - start) * betainc(first, last, np.arange(n + 1) / n)
    x[0], x[-1] = start, end  # exactly: faces share their ends
    return x


def _pieces(start: float, end: float, cuts: Iterable[float], size: float) -> list[float]:
    """Return start, the cuts between and end, increasing; cuts nearer than 1e-9 size are one."""
    radii = [start]
    for cut in sorted(cuts):
        if cut - radii[-1] > 1e-9 * size and end - cut > 1e-9 * size:
            radii.append(cut)
    return [*radii, end]


def _shares(n: int, lengths: Sequence[float]) -> list[int]:
    """Share n elements out by the square roots of the lengths, at least FEWEST each."""
    if n < FEWEST * len(lengths):
        raise InputError(
            f"mesh.contact_elements = {n}: the contact line has {len(lengths)} pieces between its "
            f"corners; must be at least {FEWEST * len(lengths)}"
        )
    weights = np.sqrt(lengths)
    shares = np.maximum(FEWEST, np.floor(n * weights / weights.sum()).astype(int))
    while shares.sum() > n:
        shares[np.argmax(np.where(shares > FEWEST, (shares - 0.5) / weights, -1.0))] -= 1
    while shares.sum() < n:
        shares[np.argmin((shares + 0.5) / weights)] += 1
    return shares.tolist()


def contact_pieces(
    contact: tuple[float, float], mesh: Mesh, *faces: Section
) -> list[tuple[float, float, int]]:
    """Return the pieces of a contact line between the corners of the faces: ends, elements.

    Raises
    ------
    InputError : too few elements for the pieces.
    """
    cuts = [cut for face in faces for cut in corners(face) if contact[0] < cut < contact[1]]
    ends = _pieces(*contact, cuts, contact[1])
    shares = _shares(mesh.contact_elements, [float(length) for length in np.diff(ends)])
    return [(a, b, n) for (a, b), n in zip(itertools.pairwise(ends), shares, strict=True)]


def contact_line(contact: tuple[float, float], mesh: Mesh, *faces: Section) -> ContactLine:
    """Return the contact elements between two radii (mm), cut at the corners of the faces.

    Every piece is graded towards its ends, but not towards the axis.

    Raises
    ------
    InputError : too few elements for the pieces.
    """
    lines = []
    for a, b, n in contact_pieces(contact, mesh, *faces):
        towards_axis = 1.0 if a == 0 else mesh.grading
        lines.append(graded(b, a, n, mesh.grading, towards_axis)[::-1])
    return ContactLine(np.concatenate([lines[0], *(line[1:] for line in lines[1:])]))


@dataclass(frozen=True)
class _Face:
    """A piece of a section: its corners, element number, grading at both ends.

    Straight where it has two points; otherwise graded along the arc of the polyline.
    """

    name: str
    points: FloatArray
    n: int
    grading: tuple[float, float]

    def coordinates(self) -> FloatArray:
        if len(self.points) == 2:
            (r0, z0), (r1, z1) = self.points
            return np.stack(
                [graded(r0, r1, self.n, *self.grading), graded(z0, z1, self.n, *self.grading)],
                axis=1,
            )
        arc = np.append(0.0, np.cumsum(np.hypot(*np.diff(self.points, axis=0).T)))
        at = graded(0.0, arc[-1], self.n, *self.grading)
        return np.stack([np.interp(at, arc, x) for x in self.points.T], axis=1)


def _between(section: Section, a: float, b: float) -> FloatArray:
    """Return the vertices of the contact face from radius a to radius b > a, ends included."""
    radii = section.points[:, 0]
    inside = radii[(radii > a) & (radii < b)]
    r = np.concatenate([[a], inside, [b]])
    return np.stack([r, section.depth(r)], axis=1)


def _faces(section: Section, contact: tuple[float, float], mesh: Mesh) -> list[_Face]:
    """Return the pieces counter-clockwise, from the inner end of the fixed face.

    Element numbers on the free and fixed faces follow ``mesh.contact_elements``, so that one number
    refines everything: half of it on faces that end at a contact edge and on the fixed face, a
    quarter on the other sides, and as many on the flats beside the contact as their length asks.
    The piece "contact" has but its number of elements; its nodes are the contact line's.
    """
    (inner, outer), (a, b), base = section.r, contact, -section.height
    n = mesh.contact_elements
    near, far = max(4, n // 2), max(4, n // 4)
    g = CORNER_GRADING
    axis = 1.0 if inner == 0 else g

    def flats(start: float, end: float) -> list[_Face]:
        """Return the free pieces of the contact face from start inwards to end."""
        if start == end:
            return []
        cuts = [cut for cut in corners(section) if end < cut < start]
        pieces = []
        for low, high in itertools.pairwise(_pieces(end, start, cuts, outer)):
            count = max(4, round(n / 10.0 * (1.0 + math.log1p((high - low) / (b - a)))))
            points = _between(section, low, high)[::-1]
            pieces.append(_Face("flat", points, count, (g, 1.0 if low == 0 else g)))
        return pieces[::-1]

    z_inner, z_outer = section.points[0, 1], section.points[-1, 1]

    def straight(*ends: tuple[float, float]) -> FloatArray:
        return np.array(ends)

    faces = [
        _Face("fixed", straight((inner, base), (outer, base)), near, (axis, g)),
        _Face(
            "outer_side", straight((outer, base), (outer, z_outer)),
            near if b == outer else far, (g, g),
        ),
        *flats(outer, b),
        _Face("contact", _between(section, a, b)[::-1], n, (1.0, 1.0)),
        *flats(a, inner),
        _Face(
            "inner_side", straight((inner, z_inner), (inner, base)),
            near if a == inner else far, (g, g),
        ),
    ]  # fmt: skip
    return faces[:-1] if inner == 0 else faces


def count_elements(section: Section, contact: tuple[float, float], mesh: Mesh) -> int:
    """Return the number of boundary elements that ``boundary_mesh`` would make."""
    return sum(face.n for face in _faces(section, contact, mesh))


def _lowered(side: FloatArray, top: int, worn: float) -> FloatArray:
    """Return the nodes of a side face whose upper half is shortened to an end ``worn`` lower.

    The lower half stays where it is, so that its elements need not be integrated again.
    """
    z, middle = side[:, 1], 0.5 * (side[0, 1] + side[-1, 1])
    shrink = worn / (side[top, 1] - middle)
    lowered = side.copy()
    lowered[:, 1] = np.where(z > middle, z - shrink * (z - middle), z)
    lowered[top, 1] = side[top, 1] - worn
    return lowered


def boundary_mesh(
    section: Section, line: ContactLine, mesh: Mesh, worn: FloatArray | None = None
) -> BoundaryMesh:
    """Return the boundary elements of a section with the elements of a contact line.

    Parameters
    ----------
    line : contact elements, within the section's radii.
    worn : (n+1,) mm >= 0, lowering of the contact line's nodes in the body's own frame. Where the
        line ends inside the face, the neighbouring free element becomes the wall of the wear track;
        where it ends at a side face, that face's upper half is shortened.

    Raises
    ------
    InputError : the contact line leaves the section.
    ComputationError : more is worn than half of the body's height.
    """
    a, b = float(line.edges[0]), float(line.edges[-1])
    inner, outer = section.r
    if not inner <= a < b <= outer:
        raise InputError(f"section r = {section.r}: the contact line {a}, {b} must lie within")
    faces = _faces(section, (a, b), mesh)
    lines = {i: face.coordinates() for i, face in enumerate(faces) if face.name != "contact"}
    contact = np.stack([line.edges, section.depth(line.edges)], axis=1)
    at = next(i for i, face in enumerate(faces) if face.name == "contact")
    if worn is not None:
        if not worn.max() < 0.5 * (section.height + contact[:, 1].min()):
            raise ComputationError(
                f"wear of {worn.max():.3g} mm is more than half of the height of its body, "
                f"{section.height + contact[:, 1].min():g} mm: the elements cannot follow it"
            )
        contact[:, 1] -= worn
        # the ends are shared with whatever piece comes before and after
        for other, row, loss in ((at - 1, -1, worn[-1]), (at + 1, 0, worn[0])):
            if other not in lines:
                continue
            if faces[other].name.endswith("side"):
                lines[other] = _lowered(lines[other], row, loss)
            else:
                lines[other][row, 1] -= loss
    lines[at] = contact[::-1]
    ends = np.concatenate([lines[i][:-1] for i in range(len(faces))])
    after = np.concatenate([lines[i][1:] for i in range(len(faces))])
    k = len(ends)
    closed = inner > 0  # otherwise the contour runs from axis to axis
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

    return BoundaryMesh(
        nodes, elements, of("contact")[::-1].copy(), of("fixed"), of("inner_side"), of("outer_side")
    )


def node_wear(line: ContactLine, worn: FloatArray) -> FloatArray:
    """Return (n+1,) mm, the wear at the line's nodes from (n,) that of its elements.

    Linear between the gap points; at the ends extrapolated, but not below the last element's own.
    """
    if line.n == 1:
        return np.repeat(worn, 2)
    x, r = line.gap_point, line.edges
    nodes = np.interp(r, x, worn)
    for end, a, b in ((0, 0, 1), (-1, -1, -2)):
        slope = (worn[a] - worn[b]) / (x[a] - x[b])
        nodes[end] = max(worn[a] + slope * (r[end] - x[a]), worn[a], 0.0)
    return nodes


def pair_key(bodies: tuple[Body, Body], contact: tuple[float, float], mesh: Mesh) -> Hashable:
    """Return what a contact pair depends on; equal for bodies that can share it. Not collective.

    Parameters
    ----------
    contact : mm, inner and outer radius of the contact line.
    """
    # the unworn pair is the same whether the elements will follow the wear or not
    unworn = Mesh()
    mesh = replace(mesh, geometry=unworn.geometry, geometry_tolerance=unworn.geometry_tolerance)
    return mesh, contact, *((body.section, body.poisson, body.grip) for body in bodies)
