"""Stress at points of a zone, inside and on its boundary, for unit loads on the contact line.

Inside it is Somigliana's identity. Closer to the boundary than a good part of an element, tractions
that are constant on elements show through: there the stress is interpolated along the way inwards,
between that on the surface (see ``mid_stress``) and those deeper, or, where the body is thinner
than that, the one on its other side.

Where discs touch, friction jumps on the axis, from one direction to the other: what is under it
depends on r over the depth, of which the way inwards shows nothing. Beside the axis the integrals
are taken, as tractions hardly vary over the element there; on it stresses are as symmetry has them.
"""

from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity._rings import integrate_rows
from ringwear_par.elasticity.bem.body import BoundaryResponse
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.bem.quadrature import quadrature
from ringwear_par.elasticity.stress.surface import faces, mid_stress

#: least depth, in element lengths, at which the integrals are right
_DEEP = 0.6
#: least depth, over that, at which the integrals are taken beside the axis
_SHALLOW = 1.0 / 600.0
#: share of the body's size within which a point lies on its boundary
_ON_BOUNDARY = 1e-9
#: share of an element's length by which a point may lie beyond it: faces are curved, it is not
_BEYOND = 0.02
_TOLERANCE = 1e-8
#: component of stress and direction on the element of each pair of kernels
_COMPONENT = np.array([0, 1, 2, 3, 0, 1, 2, 3, 4, 5])
_DIRECTION = np.array([0, 0, 0, 0, 1, 1, 1, 1, 2, 2])


class Located(NamedTuple):
    """Where points lie relative to a boundary."""

    #: (p,) int, the nearest
    element: IntArray
    #: (p,) float, place on it of the nearest point
    t: FloatArray
    #: (p, 2) float, mm, that point
    foot: FloatArray
    #: (p,) float, mm, to it, negative outside
    distance: FloatArray


def locate(boundary: BoundaryMesh, points: FloatArray) -> Located:
    """Return where points (p, 2) lie to a boundary. Not collective."""
    first = boundary.nodes[boundary.elements[:, 0]]
    along = boundary.nodes[boundary.elements[:, 2]] - first
    element, t = np.empty(len(points), np.int64), np.empty(len(points))
    inside = np.empty(len(points), bool)
    for at in range(0, len(points), 1024):  # all of them would take too much memory
        part = slice(at, at + 1024)
        away = points[part, None] - first
        places = np.clip((away * along).sum(2) / (along**2).sum(1), 0.0, 1.0)
        squares = ((away - places[..., None] * along) ** 2).sum(2)
        element[part] = squares.argmin(1)
        t[part] = np.take_along_axis(places, element[part, None], 1)[:, 0]
        # rays towards larger radii leave the body once more than they enter
        crosses = (away[..., 1] >= 0.0) != (away[..., 1] >= along[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            beyond = away[..., 1] / along[:, 1] * along[:, 0] > away[..., 0]
        inside[part] = (crosses & beyond).sum(1) % 2 == 1
    foot = first[element] + t[:, None] * along[element]
    distance = np.hypot(*(points - foot).T)
    return Located(element, t, foot, np.where(inside, distance, -distance))


class ZoneStress:
    """The stress in a zone and on its boundary, for all loads of its body. Not collective.

    Stresses (..., 6, n) are rr, tt, zz, rz for unit pressures and rt, tz for unit shear, in MPa;
    the body's modulus does not matter.

    Parameters
    ----------
    zone : displacements and tractions on the boundary, for each load.
    """

    def __init__(self, zone: BoundaryResponse) -> None:
        self._boundary, self._poisson = zone.boundary, zone.material.poisson
        self._faces = faces(zone.boundary)
        #: (k, 6, n) MPa, the stress at the mid-points of the elements
        self.surface = mid_stress(zone)
        # (3, m + k, n), displacements at Young's modulus 1 of the zone, and tractions, along r, z
        # and theta
        both = zone.material.young * zone.displacement, zone.traction
        self._values = np.concatenate(both).transpose(1, 0, 2).copy()
        self._thin = _ON_BOUNDARY * np.ptp(zone.boundary.nodes, axis=0).max()

    def at(self, points: FloatArray) -> FloatArray:
        """Return the stress at points, (p, 6, n); NaN at points outside.

        Parameters
        ----------
        points : (p, 2) float, mm, r and z in the frame of the zone's boundary.

        Raises
        ------
        ComputationError : points are too close to elements that are long for that.
        """
        at = locate(self._boundary, points)
        size = self._faces.size(at.element, at.t)
        outside = at.distance < -np.maximum(self._thin, _BEYOND * size)
        on_face = ~outside & (at.distance <= self._thin)
        inside = at.distance >= _DEEP * size
        stress = np.zeros((len(points), 6, self._values.shape[2]))
        for p in np.flatnonzero(on_face):
            stress[p] = self._on_surface(at.element[p], at.t[p])
        near = np.flatnonzero(~outside & ~on_face & ~inside)
        if len(near):
            to = Located(at.element[near], at.t[near], at.foot[near], at.distance[near])
            stress[near] = self._near_surface(points[near], to)
        if inside.any():
            stress[inside] = self._integrated(points[inside])
        on_axis = points[:, 0] <= self._thin
        stress[on_axis, :2] = stress[on_axis, :2].mean(axis=1, keepdims=True)
        stress[on_axis, 3:] = 0.0
        stress[outside] = np.nan
        return stress

    def _near_surface(self, points: FloatArray, at: Located) -> FloatArray:
        """Return the stress at points too near to the surface for integrals, (p, 6, n).

        By parabolas through the surface stress, and the integrals at twice the depth from which on
        they are right and at that depth; where the body is thinner, through that on its other side.
        """
        depth, deep = at.distance, _DEEP * self._faces.size(at.element, at.t)
        inwards = (points - at.foot) / depth[:, None]
        far, far_element, far_t = self._opposite(points, inwards)
        far += depth
        both = deep + _DEEP * self._faces.size(far_element, far_t)
        thick, thin = far > deep + both, far <= both
        middle, end = np.where(thick, deep, far * deep / both), np.where(thick, 2.0 * deep, far)
        at_middle, at_end = (at.foot + x[:, None] * inwards for x in (middle, end))
        surface = np.where(thin, 1.0, 1.0 - depth / middle) * (1.0 - depth / end)
        inner = np.where(thin, 0.0, depth * (end - depth) / (middle * (end - middle)))
        last = 1.0 - surface - inner
        # at a corner, which is as near, what the integrals give at the point itself
        corner = ~thin & ~(self._is_deep(at_middle) & (~thick | self._is_deep(at_end)))
        share = _smooth(np.where(corner, depth / deep, self._beside_axis(points, at, deep)))
        away = 1.0 - share
        surface, inner, last = (
            np.where(corner, x, y) * away for x, y in ((1.0, surface), (0.0, inner), (0.0, last))
        )
        terms = ((share, points), (inner, at_middle), (np.where(thick, last, 0.0), at_end))
        stress = np.zeros((len(points), 6, self._values.shape[2]))
        for weights, places in terms:
            chosen = np.flatnonzero(weights)
            if len(chosen):
                stress[chosen] += weights[chosen, None, None] * self._integrated(places[chosen])
        for p in range(len(points)):
            stress[p] += surface[p] * self._on_surface(at.element[p], at.t[p])
            if not thick[p]:
                stress[p] += last[p] * self._on_surface(far_element[p], far_t[p])
        return stress

    def _on_surface(self, element: int, t: float) -> FloatArray:
        """Return (6, n), the stress at a place of an element."""
        elements, weights = self._faces.weights(element, t)
        return np.tensordot(weights, self.surface[elements], 1)

    def _beside_axis(self, points: FloatArray, at: Located, deep: FloatArray) -> FloatArray:
        """Return where integrals count near the surface beside the axis, as friction jumps there.

        1 in the inner half of an element at the axis that friction goes through, 0 at its end.
        """
        boundary = self._boundary
        loaded = np.concatenate([boundary.contact, boundary.above, boundary.below])
        ends = np.sort(boundary.nodes[boundary.elements[:, [0, 2]], 0], axis=1)[at.element]
        beside = np.isin(at.element, loaded) & (ends[:, 0] <= self._thin)
        beside &= at.distance > _SHALLOW * deep
        return np.where(beside, np.clip(2.0 - 2.0 * points[:, 0] / ends[:, 1], 0.0, 1.0), 0.0)

    def _is_deep(self, samples: FloatArray) -> BoolArray:
        """Tell which samples are inside, and so deep that the integrals are right."""
        at = locate(self._boundary, samples)
        deep = at.distance >= 0.9 * _DEEP * self._faces.size(at.element, at.t)
        return deep & (samples[:, 0] >= 0.0)

    def _opposite(
        self, points: FloatArray, ways: FloatArray
    ) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return how far it is from points along ways to the boundary, the elements, the places."""
        first = self._boundary.nodes[self._boundary.elements[:, 0]] - points[:, None]
        along = self._boundary.nodes[self._boundary.elements[:, 2]] - points[:, None] - first
        way_r, way_z = ways.T[:, :, None]
        across = way_r * along[..., 1] - way_z * along[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (first[..., 0] * along[..., 1] - first[..., 1] * along[..., 0]) / across
            t = (first[..., 0] * way_z - first[..., 1] * way_r) / across
        far = np.where((t >= 0.0) & (t <= 1.0) & (far > 0.0), far, np.inf)
        element, rows = far.argmin(axis=1), np.arange(len(points))
        far = far[rows, element]
        return far, element, np.where(far < np.inf, t[rows, element], 0.0)  # towards the axis: inf

    def _integrated(self, points: FloatArray) -> FloatArray:
        """Return (p, 6, n), Somigliana's identity at points inside.

        The integrands are smooth, but steep close to the boundary, where elements are halved until
        their parts are not. What is left of the quadrature's error is multiplied by u - u*, with
        the field u* = c e + d e_z + w r e_theta, e = r e_r - 2 nu / (1 - nu) (z - z0) e_z, that
        agrees with u at the nearest node, at z0; its stress, known, is added again, and finite for
        all nu.
        """
        nodes, elements, p = self._boundary.nodes, self._boundary.elements, len(points)
        _, width, n = self._values.shape
        nearest = ((points[:, None] - nodes) ** 2).sum(2).argmin(1)
        r, z0 = nodes[nearest].T
        # columns of values along r and z have the rows of four stresses, those along theta of two
        heights, starts = np.array([4 * p, 4 * p, 2 * p]), 4 * p * width * np.arange(3)
        values = np.hstack([elements, len(nodes) + np.arange(len(elements))[:, None]])
        columns = starts[:, None] + heights[:, None] * values[:, None]
        factors = np.tile([-1.0, -1.0, -1.0, 1.0], (len(elements), 3, 1))
        rows = p * np.array([0, 1, 2, 3, 0, 1])[:, None] + np.arange(p)
        entries = np.zeros(10 * p * width)
        own = -integrate_rows(
            np.column_stack([points, z0]), np.full(p, -1), self._boundary, self._poisson,
            quadrature(_TOLERANCE), columns, factors, rows, entries,
        )  # fmt: skip
        own[:2] += 1.0 / (1.0 - self._poisson)  # stresses rr = tt of u_r = r where zz is 0
        own[_DIRECTION != 1] *= np.divide(1.0, r, where=r > 0.0, out=np.zeros_like(r))
        at = starts[_DIRECTION, None] + heights[_DIRECTION, None] * nearest
        entries[at + rows[_COMPONENT]] += own
        normal, torsion = np.split(entries, [8 * p * width])
        stresses = [
            (part.reshape(len(of), -1).T @ of).reshape(-1, p, n)
            for part, of in ((normal, self._values[:2].reshape(-1, n)), (torsion, self._values[2]))
        ]
        return np.concatenate(stresses).transpose(1, 0, 2)


def _smooth(x: FloatArray) -> FloatArray:
    """Return a smooth step from 0 to 1 with x, level at both ends."""
    return x * x * (3.0 - 2.0 * x)
