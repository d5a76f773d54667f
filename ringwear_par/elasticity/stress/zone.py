"""Stress at points of a zone, inside and on its boundary, for unit loads on the contact line.

Inside it is Somigliana's identity (see ``stress_rows``). Closer to the boundary than a good part of
an element, tractions that are constant on elements show through: there the stress is interpolated
along the way inwards, between that on the surface (see ``surface_stress``) and those deeper, or,
where the body is thinner than that, the one on its other side.

Where discs touch, friction jumps on the axis, from one direction to the other: what is under it
depends on r over the depth, of which the way inwards shows nothing. Beside the axis the integrals
are taken, as tractions hardly vary over the element there; on it stresses are as symmetry has them.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity._rings import stress_rows
from ringwear_par.elasticity.bem.body import BoundaryResponse
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.bem.quadrature import quadrature
from ringwear_par.elasticity.stress.surface import Faces, faces, mid_stress
from ringwear_par.errors import ComputationError

#: least depth, in element lengths, at which the integrals are right
_DEEP = 0.6
#: least depth, in element lengths, at which the integrals are taken beside the axis
_SHALLOW = 1e-3
#: share of the body's size within which a point lies on its boundary
_ON_BOUNDARY = 1e-9
#: share of an element's length by which a point may lie beyond it: faces are curved, it is not
_BEYOND = 0.02
#: points that are integrated and multiplied together
_BATCH = 32
_TOLERANCE = 1e-8


@dataclass(frozen=True)
class Influence:
    """Stress at points for loads on the contact elements; the body's modulus does not matter."""

    #: (p, 4, n) float, rr, tt, zz, rz for unit pressures; NaN at points out of it
    normal: FloatArray
    #: (p, 2, n) float, rt, tz for unit shear, likewise
    torsion: FloatArray

    def stress(self, pressure: FloatArray, shear: FloatArray) -> FloatArray:
        """Return (p, 6) MPa, rr, tt, zz, rz, rt, tz under pressures and shears (n,), MPa."""
        return np.concatenate([self.normal @ pressure, self.torsion @ shear], axis=1)


@dataclass(frozen=True)
class Located:
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


class _Recipe:
    """How stress at points (p, 2) is made of integrals at samples and stresses at mid-points."""

    def __init__(self, boundary: BoundaryMesh, along: Faces, points: FloatArray) -> None:
        self._boundary, self._faces = boundary, along
        #: where integrals are taken, for which point, and what they count there
        self.samples: list[FloatArray] = []
        self.of_point: list[int] = []
        self.weights: list[float] = []
        #: points, elements, and what the stresses at their mid-points count there
        self.surface: list[tuple[int, IntArray, FloatArray]] = []
        at = locate(boundary, points)
        thin = _ON_BOUNDARY * np.ptp(boundary.nodes, axis=0).max()
        #: (p,) bool, points on the axis
        self.on_axis: BoolArray = points[:, 0] <= thin
        loaded = np.concatenate([boundary.contact, boundary.above, boundary.below])
        ends = np.sort(boundary.nodes[boundary.elements[loaded][:, [0, 2]], 0], axis=1)
        first = ends[:, 0] <= thin
        #: elements at the axis that friction goes through, and how far they reach, mm
        self._at_axis = dict(zip(loaded[first].tolist(), ends[first, 1].tolist(), strict=True))
        size = self._faces.size(at.element, at.t)
        #: (p,) bool, points that are not in the body
        self.outside: BoolArray = at.distance < -np.maximum(thin, _BEYOND * size)
        inside = at.distance >= _DEEP * size
        for p in np.flatnonzero(inside):
            self._integrate(p, points[p], 1.0)
        for p in np.flatnonzero(~inside & ~self.outside):
            foot = at.foot[p], int(at.element[p]), float(at.t[p])
            if at.distance[p] <= thin:
                self._take_surface(p, *foot[1:], 1.0)
            else:
                self._interpolate(p, points[p], *foot, float(at.distance[p]), _DEEP * size[p])

    def _integrate(self, point: int, sample: FloatArray, weight: float) -> None:
        self.samples.append(sample)
        self.of_point.append(point)
        self.weights.append(weight)

    def _take_surface(self, point: int, element: int, t: float, weight: float) -> None:
        elements, weights = self._faces.weights(element, t)
        self.surface.append((point, elements, weight * weights))

    def _interpolate(
        self, p: int, point: FloatArray, foot: FloatArray, element: int, t: float,
        distance: float, deep: float,
    ) -> None:  # fmt: skip
        """Make the stress at a point near the surface of those on the way inwards."""
        inwards = (point - foot) / distance
        far, far_element, far_t = self._opposite(point, inwards)
        far += distance
        far_deep = 0.0
        if far_element >= 0:
            far_deep = _DEEP * float(self._faces.size(np.array(far_element), np.array(far_t)))
        if far <= deep + far_deep:
            depths, opposite = [0.0, far], True
        elif far <= 2.0 * deep + far_deep:
            depths, opposite = [0.0, far * deep / (deep + far_deep), far], True
        else:
            depths, opposite = [0.0, deep, 2.0 * deep], False
        samples = np.array(
            [foot + depth * inwards for depth in (depths[1:-1] if opposite else depths[1:])]
        ).reshape(-1, 2)
        if not self._right(samples):  # a corner is as near: what the integrals give, blended
            share = _smooth(distance / deep)
            self._integrate(p, point, share)
            self._take_surface(p, element, t, 1.0 - share)
            return
        away = 1.0
        if element in self._at_axis and distance > _SHALLOW / _DEEP * deep:
            share = 2.0 * float(point[0]) / self._at_axis[element] - 1.0  # from its middle on
            away = _smooth(min(max(share, 0.0), 1.0))
            self._integrate(p, point, 1.0 - away)
        weights = [
            away * math.prod((distance - node) / (depth - node) for node in depths if node != depth)
            for depth in depths
        ]
        self._take_surface(p, element, t, weights[0])
        if opposite:
            self._take_surface(p, far_element, far_t, weights[-1])
            weights = weights[:-1]
        for sample, weight in zip(samples, weights[1:], strict=True):
            self._integrate(p, sample, weight)

    def _right(self, samples: FloatArray) -> bool:
        """Tell whether samples are inside, and so deep that the integrals are right."""
        if len(samples) == 0:
            return True
        if samples[:, 0].min() < 0.0:
            return False
        at = locate(self._boundary, samples)
        return bool((at.distance >= 0.9 * _DEEP * self._faces.size(at.element, at.t)).all())

    def _opposite(self, point: FloatArray, way: FloatArray) -> tuple[float, int, float]:
        """Return how far it is from a point along a way to the boundary, the element, the place."""
        first = self._boundary.nodes[self._boundary.elements[:, 0]] - point
        along = self._boundary.nodes[self._boundary.elements[:, 2]] - point - first
        across = way[0] * along[:, 1] - way[1] * along[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (first[:, 0] * along[:, 1] - first[:, 1] * along[:, 0]) / across
            t = (first[:, 0] * way[1] - first[:, 1] * way[0]) / across
        hit = (t >= 0.0) & (t <= 1.0) & (far > 0.0)
        if not hit.any():  # towards the axis
            return np.inf, -1, 0.0
        e = int(np.argmin(np.where(hit, far, np.inf)))
        return float(far[e]), e, float(t[e])


def _smooth(x: float) -> float:
    """Return a smooth step from 0 to 1 with x, level at both ends."""
    return x * x * (3.0 - 2.0 * x)


@dataclass(frozen=True)
class ZoneStress:
    """The stress in a zone and on its boundary, for all loads of its body. Not collective."""

    #: displacements and tractions on the boundary, for each load
    zone: BoundaryResponse

    @cached_property
    def surface(self) -> Influence:
        """The stress at the mid-points of the elements."""
        zone = self.zone
        displacement = zone.material.young * zone.displacement
        return Influence(
            *mid_stress(zone.boundary, zone.material.poisson, displacement, zone.traction)
        )

    @cached_property
    def _faces(self) -> Faces:
        return faces(self.zone.boundary)

    @cached_property
    def _values(self) -> tuple[FloatArray, FloatArray]:
        """Boundary values in the order of ``stress_rows``, (2 m + 2 k, n), (m + k, n).

        Displacements are those at Young's modulus 1 of the zone.
        """
        n = self.zone.displacement.shape[2]
        values = self.zone.material.young * self.zone.displacement, self.zone.traction
        return (
            np.concatenate([v[:, :2].reshape(-1, n) for v in values]),
            np.concatenate([v[:, 2] for v in values]),
        )

    def at(self, points: FloatArray) -> Influence:
        """Return the stress at points.

        Parameters
        ----------
        points : (p, 2) float, mm, r and z in the frame of the zone's boundary.
        """
        n, p = self.zone.displacement.shape[2], len(points)
        recipe = _Recipe(self.zone.boundary, self._faces, points)
        normal, torsion = np.zeros((p, 4, n)), np.zeros((p, 2, n))
        for point, elements, weights in recipe.surface:
            normal[point] += np.tensordot(weights, self.surface.normal[elements], 1)
            torsion[point] += np.tensordot(weights, self.surface.torsion[elements], 1)
        if recipe.samples:
            self._add_integrals(recipe, normal, torsion)
        normal[recipe.on_axis, :2] = normal[recipe.on_axis, :2].mean(axis=1, keepdims=True)
        normal[recipe.on_axis, 3] = torsion[recipe.on_axis] = 0.0
        normal[recipe.outside] = torsion[recipe.outside] = np.nan
        return Influence(normal, torsion)

    def _add_integrals(self, recipe: _Recipe, normal: FloatArray, torsion: FloatArray) -> None:
        """Add the integrals at samples to the influences of their points."""
        boundary, rules = self.zone.boundary, quadrature(_TOLERANCE)
        samples, count = np.array(recipe.samples), min(_BATCH, len(recipe.samples))
        all_rows = [
            np.empty((count, components, len(values)))
            for components, values in zip((4, 2), self._values, strict=True)
        ]
        for first in range(0, len(samples), count):
            batch = samples[first : first + count]
            away = batch[:, None] - boundary.nodes
            nearest = (away**2).sum(2).argmin(1)
            normal_rows, torsion_rows = (rows[: len(batch)] for rows in all_rows)
            evaluations = stress_rows(
                batch, nearest, boundary, self.zone.material.poisson, rules,
                normal_rows, torsion_rows,
            )  # fmt: skip
            if evaluations < 0:
                raise ComputationError(
                    "stress: points lie too close to elements that are long for that, to be "
                    "integrated: thicker layers or bodies, or a milder mesh.grading, are needed"
                )
            for target, rows, values in zip(
                (normal, torsion), (normal_rows, torsion_rows), self._values, strict=True
            ):
                product = (rows.reshape(-1, len(values)) @ values).reshape(
                    len(batch), -1, values.shape[1]
                )
                for i in range(len(batch)):
                    target[recipe.of_point[first + i]] += recipe.weights[first + i] * product[i]
