"""Points of a body at which the largest von Mises stress is looked for.

Edges of the contact are left out with a radius round them, as stresses are infinite there as long
as no wear has rounded them; and ends of interfaces, where they are infinite for ever. So are the
corners of the held face, further round: what a stiff grip makes of them has nothing to do with the
contact.
"""

import math
from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.stress.fields import Largest
from ringwear_par.elasticity.stress.surface import faces
from ringwear_par.elasticity.stress.zone import locate

#: columns under the contact, and depths in each: those of the deepest and the shallowest point
#: over the width of the contact line
_COLUMNS, _DEPTHS = 48, 30
_DEEPEST, _SHALLOWEST = 1.5, 0.003
#: points on a circle round an edge; axial and radial faces are among their directions
_ON_CIRCLE = 24
#: radius left out round corners of the held face, over the smaller side of the body
_AT_GRIP = 0.25
#: share of a body's size within which a point lies on a boundary
_ON_BOUNDARY = 1e-9


def zones_of(
    boundaries: Sequence[BoundaryMesh], points: FloatArray, sides: FloatArray
) -> tuple[IntArray, BoolArray]:
    """Return the zone that each point (p, 2) is in, the nearest for points outside; and if it is.

    Parameters
    ----------
    sides : (p,) float, for points on interfaces 1 for the zone above, -1 for that below, 0 for the
        one towards the contact face.
    """
    size = np.ptp(np.concatenate([b.nodes for b in boundaries]), axis=0).max()
    distance = np.array([locate(boundary, points).distance for boundary in boundaries])
    inside = distance >= -_ON_BOUNDARY * size
    within = inside.any(axis=0)
    height = np.array([boundary.nodes[:, 1].mean() for boundary in boundaries])
    rank = np.where(inside, sides * height[:, None], -np.inf)
    zones = np.where(sides != 0.0, rank.argmax(axis=0), inside.argmax(axis=0))
    return np.where(within, zones, distance.argmax(axis=0)), within


def edges(boundaries: Sequence[BoundaryMesh]) -> FloatArray:
    """Return (e, 2) mm, ends and corners of a body's contact line, ends of interfaces; no axis."""
    run_ends = []
    for boundary in boundaries:
        near = np.concatenate([boundary.contact, boundary.above, boundary.below])
        for run in faces(boundary).runs:
            if run[0] in near:
                ends = boundary.elements[run[0], 0], boundary.elements[run[-1], 2]
                run_ends.append(boundary.nodes[list(ends)])
    ends = np.unique(np.concatenate(run_ends), axis=0)
    return ends[ends[:, 0] > 0.0]


class Search:
    """Points of a body among which the largest von Mises stress is looked for.

    Parameters
    ----------
    boundaries : of the body's zones from the contact face on, in the frame of the case.
    around : (e, 2) float, mm, edges of both bodies.
    exclude : mm, how far round them is left out.
    """

    def __init__(
        self, boundaries: Sequence[BoundaryMesh], around: FloatArray, exclude: float
    ) -> None:
        top = boundaries[0]
        nodes = np.concatenate([boundary.nodes for boundary in boundaries])
        fixed = boundaries[-1].elements[boundaries[-1].fixed]
        corners = boundaries[-1].nodes[np.setxor1d(fixed[:, 0], fixed[:, 2])]
        corners = corners[corners[:, 0] > 0.0]  # of the held face, off the axis
        self._around = np.concatenate([around, corners])
        grip = _AT_GRIP * np.ptp(nodes, axis=0).min()
        self._reach = np.repeat([exclude, max(exclude, grip)], [len(around), len(corners)])
        contact = top.elements[top.contact]
        width = np.hypot(*(top.nodes[contact[0, 0]] - top.nodes[contact[-1, 2]]))
        chosen = np.unique(np.linspace(0, len(contact) - 1, _COLUMNS).round().astype(int))
        along = top.nodes[contact[chosen, 2]] - top.nodes[contact[chosen, 0]]
        inwards = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
        depths = np.append(0.0, width * np.geomspace(_SHALLOWEST, _DEEPEST, _DEPTHS - 1))
        columns = top.nodes[contact[chosen, 1], None] + depths[:, None] * inwards[:, None]
        angle = 2.0 * np.pi * np.arange(_ON_CIRCLE) / _ON_CIRCLE
        circle = exclude * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        circles = (around[:, None] + circle).reshape(-1, 2) if exclude > 0.0 else np.empty((0, 2))
        self._shape = columns.shape[:2]
        inside = np.concatenate([columns.reshape(-1, 2), circles])
        middles = [boundary.nodes[boundary.elements[:, 1]] for boundary in boundaries]
        points = np.concatenate([inside, *middles])
        zones, within = zones_of(boundaries, inside, np.zeros(len(inside)))
        of_middles = np.repeat(np.arange(len(middles)), [len(m) for m in middles])
        zones = np.concatenate([zones, of_middles])
        allowed = self.allows(points) & (points[:, 0] >= 0.0)
        allowed[: len(inside)] &= within
        self._number = np.where(allowed, np.cumsum(allowed) - 1, -1)
        #: (s, 2) float, mm, and (s,) int, the zone of each
        self.points, self.zones = points[allowed], zones[allowed]

    def allows(self, points: FloatArray) -> BoolArray:
        """Tell which points are not left out."""
        away = np.hypot(*np.moveaxis(points[:, None] - self._around, -1, 0))
        return (away >= self._reach * (1.0 - 1e-9)).all(axis=1)

    def largest(self, points: FloatArray, zones: IntArray, values: FloatArray) -> Largest:
        """Return the largest of von Mises stresses, between columns and depths by parabolas.

        Parameters
        ----------
        points, zones : (p, 2) float, mm, and (p,) int; its own first.
        values : (p,) float, MPa; NaN where there is none.
        """
        if not np.isfinite(values).any():
            return Largest(np.nan, np.nan, np.nan, -1)
        best = int(np.nanargmax(values))
        at, place = float(values[best]), points[best]
        numbers = self._number[: math.prod(self._shape)].reshape(self._shape)
        for index in np.argwhere(numbers == best):  # once, or not at all
            for line in (numbers[:, index[1]], numbers[index[0]]):
                i = int(np.flatnonzero(line == best)[0])
                three = line[max(i - 1, 0) : i + 2]
                if len(three) < 3 or three.min() < 0 or len(np.unique(zones[three])) > 1:
                    continue
                before, largest, after = values[three]
                bend = before - 2.0 * largest + after
                if bend < 0.0:
                    x = 0.5 * (before - after) / bend
                    low, middle, high = points[three]
                    at -= 0.5 * bend * x * x
                    place = place + 0.5 * x * (high - low)
                    place = place + 0.5 * x * x * (high - 2.0 * middle + low)
        return Largest(at, float(place[0]), float(place[1]), int(zones[best]))
