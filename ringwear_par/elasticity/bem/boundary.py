"""Boundary elements of meridian sections, zone by zone.

A body without layers is one zone. Layers make more of it, each with a closed boundary of its own:
zones are bonded along interfaces, where the boundaries on both sides have the same nodes.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.mesh import ContactLine, Mesh, graded, pieces
from ringwear_par.elasticity.sections import Section, corners
from ringwear_par.errors import ComputationError

#: grading exponent of the free and fixed faces towards every corner and contact edge
CORNER_GRADING = 3.5
#: elements of the contact face beside the contact: how many times as many as on a body without
#: layers, and grading towards the contact and towards the face's ends
_PLAIN = 1.0, CORNER_GRADING, CORNER_GRADING
_LAYERED = 1.6, 3.5, 1.3
#: the same where stresses beside the contact are computed
_FINE = 3.0, 4.0, 1.3
#: most contact elements of a mesh that is made to count its elements
_MOST_MADE = 1000
#: fewest elements of a free or fixed face
_FEWEST = 4
#: longest elements of the fixed face, in distances from the contact line over the number of contact
#: elements; under the contact of a thin body they would be long against its height
_FIXED_LENGTH = 16.0
#: mm of a layer, or half of one that is thinner, that stays where elements follow the wear
_RESIDUAL = 1e-3


class BoundaryMesh(NamedTuple):
    """Straight quadratic elements along a zone's boundary, counter-clockwise."""

    #: (m, 2) float, mm, radius and height of element ends and mid-points
    nodes: FloatArray
    #: (k, 3) int, first, middle and last node of each element; the outward normal lies to the right
    #: of the direction of travel
    elements: IntArray
    #: (n,) int, elements of the contact line, by increasing radius; none but in the zone at the
    #: contact face
    contact: IntArray
    #: (h,) int, elements of the fixed face; none but in the zone there
    fixed: IntArray
    #: int arrays, elements of the free cylindrical faces
    inner_side: IntArray
    outer_side: IntArray
    #: (q,) int, elements of the interfaces to the zones towards the contact face and towards the
    #: fixed face, by increasing radius
    above: IntArray
    below: IntArray


def _along(points: FloatArray, n: int, grading: tuple[float, float]) -> FloatArray:
    """Return n+1 element ends graded along the arc of a polyline."""
    if len(points) == 2:
        return np.stack([graded(x0, x1, n, *grading) for x0, x1 in points.T], axis=1)
    arc = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    at = graded(0.0, arc[-1], n, *grading)
    return np.stack([np.interp(at, arc, x) for x in points.T], axis=1)


def _face(
    section: Section, line: ContactLine, mesh: Mesh, fine: bool
) -> tuple[FloatArray, list[str]]:
    """Return element ends of the contact face, from its outer to its inner end, and their names.

    Free pieces inside and outside the contact have as many elements as their length asks.
    """
    (inner, outer), (a, b), radii = section.r, line.edges[[0, -1]].tolist(), section.points[:, 0]
    times, near, far = _FINE if fine else _LAYERED if section.layers else _PLAIN

    def free(start: float, end: float) -> list[FloatArray]:
        if start == end:
            return []
        cuts = [cut for cut in corners(section) if start < cut < end]
        lines = []
        for low, high in reversed(list(itertools.pairwise(pieces(start, end, cuts, outer)))):
            length = 1.0 + math.log1p((high - low) / (b - a))
            n = max(_FEWEST, round(0.1 * mesh.contact_elements * times * length))
            towards_high, towards_low = (far if r in section.r else near for r in (high, low))
            r = np.concatenate([[high], radii[(radii > low) & (radii < high)][::-1], [low]])
            points = np.stack([r, section.depth(r)], axis=1)
            lines.append(_along(points, n, (towards_high, 1.0 if low == 0 else towards_low))[1:])
        return lines

    contact = np.stack([line.edges, section.depth(line.edges)], axis=1)[::-1]
    outside, inside = free(b, outer), free(inner, a)
    first = np.stack([[outer], section.depth(np.array([outer]))], axis=1)
    ends = np.concatenate([first, *outside, contact[1:], *inside])
    before, after = (sum(map(len, lines)) for lines in (outside, inside))
    return ends, ["flat"] * before + ["contact"] * line.n + ["flat"] * after


def _fixed_face(section: Section, contact: tuple[float, float], mesh: Mesh) -> FloatArray:
    """Return the radii of the element ends of the fixed face, from its outer to its inner end, mm.

    Half as many elements as the contact line has, graded towards the corners. Those that are long
    against their distance from the contact line are split in equal parts, but none below the mean
    length of contact elements.
    """
    (inner, outer), (a, b) = section.r, contact
    n = max(_FEWEST, mesh.contact_elements // 2)
    ends = graded(outer, inner, n, CORNER_GRADING, 1.0 if inner == 0 else CORNER_GRADING)
    r = 0.5 * (ends[:-1] + ends[1:])
    nearest = np.clip(r, a, b)
    distance = np.hypot(section.height + section.depth(nearest), r - nearest)
    longest = np.maximum(_FIXED_LENGTH * distance, b - a) / mesh.contact_elements
    parts = np.ceil(-np.diff(ends) / longest).astype(int)
    splits = [
        np.linspace(start, end, count, endpoint=False)
        for start, end, count in zip(ends[:-1], ends[1:], parts, strict=True)
    ]
    return np.append(np.concatenate(splits), inner)


def _side_elements(section: Section, at_contact_edge: bool, height: float, mesh: Mesh) -> int:
    """Return the number of elements of a zone's side face.

    On a body without layers half of ``mesh.contact_elements``, so that one number refines
    everything, or a quarter where the face does not end at a contact edge. On zones that are less
    high so many that the smallest elements are about as large as there.
    """
    whole = max(_FEWEST, mesh.contact_elements // (2 if at_contact_edge else 4))
    return max(_FEWEST, math.ceil(whole * (height / section.height) ** (1.0 / CORNER_GRADING)))


@lru_cache(maxsize=64)
def count_elements(section: Section, contact: tuple[float, float], mesh: Mesh) -> int:
    """Return about how many boundary elements ``zone_meshes`` would make.

    Of large meshes in proportion to a smaller one: they may be larger than any machine's memory.
    """
    n = min(mesh.contact_elements, _MOST_MADE)
    line = ContactLine(np.linspace(*contact, n + 1))
    zones = zone_meshes(section, line, replace(mesh, contact_elements=n))
    return sum(len(zone.elements) for zone in zones) * mesh.contact_elements // n


def _lower_face(section: Section, line: ContactLine, face: FloatArray, worn: FloatArray) -> None:
    """Lower the contact line's part of the element ends of a face by (n+1,) mm of wear."""
    first = int(np.flatnonzero(face[:, 0] == line.edges[-1])[0])
    contact = face[first : first + line.n + 1]
    thinnest = section.height + contact[:, 1].min()
    if not worn.max() < 0.5 * thinnest:
        raise ComputationError(
            f"wear of {worn.max():.3g} mm is more than half of the height of its body, "
            f"{thinnest:g} mm: the elements cannot follow it"
        )
    contact[:, 1] -= worn[::-1]


def zone_meshes(
    section: Section,
    line: ContactLine,
    mesh: Mesh,
    worn: FloatArray | None = None,
    *,
    fine: bool = False,
) -> tuple[BoundaryMesh, ...]:
    """Return the boundary elements of a section's zones, from the contact face downwards.

    Element ends of interfaces lie below those of the contact face.

    Parameters
    ----------
    line : contact elements, within the section's radii.
    worn : (n+1,) mm >= 0, lowering of the contact line's nodes in the body's own frame. Where the
        line ends inside the face, the neighbouring free element becomes the wall of the wear track;
        where it ends at a side face, that face is shortened. Interfaces give way where less than a
        residual film of a layer would stay.
    fine : whether the contact face has more elements beside the contact than pressures need, for
        stresses there.

    Raises
    ------
    ComputationError : more is worn than half of the body's height.
    """
    a, b = float(line.edges[0]), float(line.edges[-1])
    top, names = _face(section, line, mesh, fine)
    worn_top = top.copy()
    if worn is not None:
        _lower_face(section, line, worn_top, worn)
    zones = []
    levels = [0.0, *(-depth for depth in itertools.accumulate(section.layers)), -section.height]
    for k, (high, low) in enumerate(itertools.pairwise(levels)):
        base_name = "below" if k < len(section.layers) else "fixed"
        radii = top[:, 0] if base_name == "below" else _fixed_face(section, (a, b), mesh)
        base = np.stack([radii, np.full(len(radii), low)], axis=1)
        worn_base = base.copy()
        if base_name == "below":
            film = np.minimum(min(_RESIDUAL, 0.5 * (high - low)), top[:, 1] - low)
            worn_base[:, 1] = np.minimum(low, worn_top[:, 1] - film)
        outer, inner = (
            _side(worn_base[at], worn_top[at], _side_elements(section, is_edge, high - low, mesh))
            for at, is_edge in ((0, section.r[1] == b), (-1, section.r[0] == a))
        )
        contour = [(worn_base[::-1], [base_name]), (outer, ["outer_side"]), (worn_top, names)]
        if section.r[0] > 0:  # otherwise the contour runs from axis to axis
            contour.append((inner[::-1], ["inner_side"]))
        zones.append(_closed(contour))
        top, worn_top, names = base, worn_base, ["above"]
    return tuple(zones)


def _side(low: FloatArray, high: FloatArray, n: int) -> FloatArray:
    """Return n+1 element ends of a side face, upwards."""
    z = graded(low[1], high[1], n, CORNER_GRADING, CORNER_GRADING)
    return np.stack([np.full(n + 1, high[0]), z], axis=1)


def _closed(contour: Sequence[tuple[FloatArray, list[str]]]) -> BoundaryMesh:
    """Return the elements of pieces one after another, counter-clockwise.

    Pieces are element ends, the first of each the last of the one before, and names, one of each
    element or one of all.
    """
    ends = np.concatenate([contour[0][0][:1], *(piece[1:] for piece, _ in contour)])
    names = np.concatenate([np.broadcast_to(of, len(piece) - 1) for piece, of in contour])
    k = len(names)
    nodes = np.empty((2 * k + 1, 2))
    nodes[0::2], nodes[1::2] = ends, 0.5 * (ends[:-1] + ends[1:])
    if np.array_equal(ends[0], ends[-1]):
        nodes = nodes[:-1]
    first = 2 * np.arange(k)
    elements = np.stack([first, first + 1, (first + 2) % len(nodes)], axis=1)

    def of(name: str) -> IntArray:
        numbers = np.flatnonzero(names == name)
        inwards = name in ("contact", "above")
        return numbers[::-1].copy() if inwards else numbers

    return BoundaryMesh(nodes, elements, *(of(name) for name in BoundaryMesh._fields[2:]))


def node_wear(line: ContactLine, worn: FloatArray) -> FloatArray:
    """Return (n+1,) mm, the wear at the line's nodes from (n,) that of its elements.

    Linear between the mid-points; at the ends extrapolated, but not below the last element's own.
    """
    x, r = line.r, line.edges
    nodes = np.interp(r, x, worn)
    for end, a, b in ((0, 0, 1), (-1, -1, -2)):
        slope = (worn[a] - worn[b]) / (x[a] - x[b])
        nodes[end] = max(worn[a] + slope * (r[end] - x[a]), worn[a], 0.0)
    return nodes
