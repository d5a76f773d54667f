"""Discretisation of a contact pair, the elements of its contact line, and their slopes.

The face is a polyline over the radius. Elements of the two faces over the same interval of radii
are paired. Pressure acts along their common normal, and the gap is what it is along the axis: with
the slope t = tan alpha = dz/dr in a body's own frame, the traction per area projected on the
contact plane is (t, -1) p, and what the body gives way is -(u_z - t u_r). The axial force is the
projected area times p; friction and wear act on the true area, which is larger by 1 / cos alpha.

Both bodies need the same slope, or their compliance would not be symmetric. Where the faces differ,
as a chamfer and a flat face do, it is the flatter one's, and none where they slope apart: the
radial motion of a flat face closes no gap.
"""

import itertools
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, read_only
from ringwear_par.elasticity.sections import Body, Section, corners
from ringwear_par.errors import InputError

#: fewest elements of a piece of the contact line
FEWEST = 4
#: largest grading of the contact line towards the axis
_AXIS_GRADING = 1.5


@dataclass(frozen=True)
class Mesh:
    """Discretisation of a contact pair."""

    #: number of elements of the contact line
    contact_elements: int = 64
    #: exponent of the grading towards the ends of the contact line and its corners; 1 is a uniform
    #: mesh
    grading: float = 2.5
    #: relative accuracy of the element integrals
    quadrature_tolerance: float = 1e-7
    #: radii (mm) to which the contact line is cut, None for no cut
    contact: tuple[float, float] | None = None
    #: whether the elements follow the worn profile ("updated") or not ("fixed")
    geometry: Literal["fixed", "updated"] = "fixed"
    #: mm of wear since the last assembly that asks for a new one
    geometry_tolerance: float = 0.005


@dataclass(frozen=True)
class ContactLine:
    """Contact elements of constant pressure, from the inner to the outer edge.

    Cases share the arrays that are worked out once: these cannot be written to.
    """

    #: (n+1,) float, mm, increasing radii of the element ends
    edges: FloatArray

    def __repr__(self) -> str:
        a, b = self.edges[[0, -1]]
        return f"<ContactLine: {self.n} elements, r = {a:g} to {b:g} mm>"

    @cached_property
    def r(self) -> FloatArray:
        """(n,) mm, mid-points, where gaps and displacements are taken, as the equation is."""
        return read_only(0.5 * (self.edges[1:] + self.edges[:-1]))

    @property
    def width(self) -> FloatArray:
        """(n,) mm, radial lengths."""
        return np.diff(self.edges)

    @cached_property
    def area(self) -> FloatArray:
        """(n,) mm^2, annular areas ``m`` on the contact plane, so that the force is ``m . p``."""
        return read_only(2.0 * np.pi * self.r * self.width)

    @property
    def arm(self) -> FloatArray:
        """(n,) mm, Int r dr / Int dr: lever arm of friction, and radius of sliding: the mid-points.

        With it, force and torque of the pressures p0 + c / r to which wear leads are exact, also
        next to the axis. The same radius in the torque and in the sliding speed makes friction
        power = torque x omega, and hence the energy identity, exact for the discrete problem.
        """
        return self.r

    @cached_property
    def uniform_arm(self) -> FloatArray:
        """(n,) mm, Int r^2 dr / Int r dr: lever arm of a constant traction."""
        return read_only(2.0 / 3.0 * np.diff(self.edges**3) / np.diff(self.edges**2))

    @property
    def n(self) -> int:
        """Number of elements."""
        return len(self.edges) - 1

    def element_at(self, r: FloatArray) -> IntArray:
        """Return the elements in which radii (mm) lie, the line's ends included; -1 off it."""
        element: IntArray = np.where(r == self.edges[0], 0, np.searchsorted(self.edges, r) - 1)
        return np.where(element < self.n, element, -1)


def graded(start: float, end: float, n: int, first: float, last: float) -> FloatArray:
    """Return n+1 coordinates from start to end, graded towards both ends.

    Element sizes fall like ``t^(first-1)`` and ``(1-t)^(last-1)`` of the element number t in
    (0, 1) (incomplete beta function), so that doubling n splits every element smoothly.
    """
    from scipy.special import betainc  # slow to import, and reading a case needs no mesh

    x = start + (end - start) * betainc(first, last, np.arange(n + 1) / n)
    x[0], x[-1] = start, end  # exactly: faces share their ends
    return x


def pieces(start: float, end: float, cuts: Iterable[float], size: float) -> list[float]:
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
    ends = pieces(*contact, cuts, contact[1])
    shares = _shares(mesh.contact_elements, [float(length) for length in np.diff(ends)])
    return [(a, b, n) for (a, b), n in zip(itertools.pairwise(ends), shares, strict=True)]


@lru_cache(maxsize=64)
def contact_line(contact: tuple[float, float], mesh: Mesh, *faces: Section) -> ContactLine:
    """Return the contact elements between two radii (mm), cut at the corners of the faces.

    Every piece is graded towards its ends, towards the axis (where pressures 1 / r grow as wear
    goes on) by ``_AXIS_GRADING`` at most.

    Raises
    ------
    InputError : too few elements for the pieces.
    """
    lines = []
    for a, b, n in contact_pieces(contact, mesh, *faces):
        towards_axis = min(_AXIS_GRADING, mesh.grading) if a == 0 else mesh.grading
        lines.append(graded(b, a, n, mesh.grading, towards_axis)[::-1])
    return ContactLine(np.concatenate([lines[0], *(line[1:] for line in lines[1:])]))


def pair_key(bodies: tuple[Body, Body], contact: tuple[float, float], mesh: Mesh) -> Hashable:
    """Return the key of a contact pair, equal for bodies that can share it. Not collective.

    Parameters
    ----------
    contact : mm, inner and outer radius of the contact line.
    """
    # the unworn pair is the same whether the elements will follow the wear or not
    unworn = Mesh()
    mesh = replace(mesh, geometry=unworn.geometry, geometry_tolerance=unworn.geometry_tolerance)
    return mesh, contact, *((body.section, body.grip, body.relative) for body in bodies)


def face_slope(section: Section, line: ContactLine, mesh: Mesh, worn: FloatArray) -> FloatArray:
    """Return (..., n), tan alpha of a contact face on each element, in the body's own frame.

    Worn faces are not looked at more closely than ``mesh.geometry_tolerance``, about which their
    elements follow the wear: over elements far smaller, the round-off of depths would be a slope.

    Parameters
    ----------
    worn : (..., n) float, mm, depths worn off the elements.
    """
    slope: FloatArray = np.diff(section.depth(line.edges)) / line.width
    r = line.r
    half = np.maximum(0.5 * line.width, mesh.geometry_tolerance)
    below, above = (np.clip(r + side * half, r[0], r[-1]) for side in (-1.0, 1.0))
    lowered = _interpolated(above, r, worn) - _interpolated(below, r, worn)
    return slope - lowered / (above - below)


def _interpolated(x: FloatArray, r: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (..., n) at increasing radii r (n,) interpolated at x (n,) between them."""
    i = np.clip(np.searchsorted(r, x, side="right") - 1, 0, len(r) - 2)
    start, end = values[..., i], values[..., i + 1]
    return start + (end - start) / (r[i + 1] - r[i]) * (x - r[i])


def case_slopes(
    sections: tuple[Section, Section], line: ContactLine, mesh: Mesh, worn: FloatArray
) -> FloatArray:
    """Return (2, ..., n), tan alpha of the faces of lower and upper in the frame of the case.

    Parameters
    ----------
    worn : (2, ..., n) float, mm, depths worn off.
    """
    lower, upper = (
        face_slope(section, line, mesh, depth)
        for section, depth in zip(sections, worn, strict=True)
    )
    return np.stack([lower, -upper])


def common_slope(slopes: FloatArray) -> FloatArray:
    """Return (n,), the flatter of two slopes (2, n), 0 where they slope apart."""
    lower, upper = slopes
    flatter = np.where(np.abs(lower) < np.abs(upper), lower, upper)
    return np.where(lower * upper > 0.0, flatter, 0.0)


def pair_slope(
    sections: tuple[Section, Section], line: ContactLine, mesh: Mesh, worn: FloatArray
) -> FloatArray:
    """Return (n,), tan alpha of the normals that pressure acts along, in the frame of the case.

    Arguments are those of ``case_slopes``. Lower has it in its own frame, upper the negative.
    """
    return common_slope(case_slopes(sections, line, mesh, worn))


def obliquity(slope: FloatArray) -> FloatArray:
    """Return 1 / cos alpha: true area over projected area, of slopes tan alpha."""
    return np.hypot(1.0, slope)
