"""Stress at points of both bodies, on their contact faces and where it is largest."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.bem.body import BoundaryResponse, in_case_frame
from ringwear_par.elasticity.bem.boundary import BoundaryMesh, zone_meshes
from ringwear_par.elasticity.mesh import ContactLine, Mesh
from ringwear_par.elasticity.sections import BODIES, Body, BodyName
from ringwear_par.elasticity.stress.boundary_recovery import BoundaryRecovery
from ringwear_par.elasticity.stress.fields import Interfaces, Largest, mises
from ringwear_par.elasticity.stress.largest import Search, edges, zones_of
from ringwear_par.elasticity.stress.zone import Influence, ZoneStress
from ringwear_par.parallel import together

#: points that a rank does in one go; the same whatever the ranks, and so the digits
_BLOCK = 64


class BodyStress(NamedTuple):
    """Stress of one body, the same on all ranks."""

    #: (p, 6) float, MPa, rr, tt, zz, rz, rt, tz at the points asked for; NaN where wear has left
    #: none of the body, or of the layer
    points: FloatArray
    #: (n, 6) float, MPa, likewise on the contact elements
    surface: FloatArray
    #: the largest von Mises stress outside the radius round edges
    largest: Largest
    #: (i, 2, m, 6) float, MPa, above and below each interface, see ``Interfaces``
    interfaces: FloatArray
    #: (layers + 1,) float, MPa, that in each layer and in the body itself; (0,) without
    layers: FloatArray


class StressPoints(NamedTuple):
    """Points of a body at which stress is wanted."""

    #: (p, 2) float, mm, r and z in the frame of the case
    at: FloatArray
    #: (p,) float, of points on interfaces: 1 for the material above, -1 for that below, 0 for the
    #: one towards the contact face
    sides: FloatArray


@dataclass(frozen=True)
class _Known:
    """What is known of one body: points, their zones, and influences."""

    #: its points come first
    search: Search
    points: FloatArray
    zones: IntArray
    #: of the points, elements of the contact line over or under them, -1 for none
    under: IntArray
    #: numbers of points and their influences; those that are this rank's
    blocks: list[tuple[IntArray, Influence]]
    #: of the contact elements
    surface: Influence
    #: of the elements above and below each interface
    interfaces: list[tuple[Influence, Influence]]
    #: of these elements, as ``under``
    under_interfaces: IntArray
    #: number of zones
    layers: int

    def stress(self, pressure: FloatArray, shear: FloatArray, comm: MPI.Comm) -> FloatArray:
        """Return (p, 6) MPa at all points. Collective on comm."""
        values = np.zeros((len(self.points), 6))
        for numbers, influence in self.blocks:
            values[numbers] = influence.stress(pressure, shear)
        comm.Allreduce(MPI.IN_PLACE, values, MPI.SUM)  # each is known to one rank: it is exact
        return values

    def largest_of_zones(self, values: FloatArray) -> FloatArray:
        """Return the largest of von Mises stresses in each zone; (0,) where there is one."""
        if self.layers == 1:
            return np.empty(0)
        by_zone = [np.where(self.zones == k, values, np.nan) for k in range(self.layers)]
        return np.array([self.search.largest(self.points, self.zones, v).mises for v in by_zone])


class StressRecovery:
    """The stress in two bodies, for any contact solution and wear.

    Points are integrated over when first needed, shared out over the ranks, and anew for a body
    whose elements have moved; from then on a state takes one product.

    Parameters
    ----------
    bodies : lower and upper.
    line : contact elements.
    mesh : discretisation.
    planes : mm, height of the contact plane of lower and upper in the frame of the case.
    points : of lower and of upper.
    exclude : mm, radius round edges in which the largest stress is not looked for.
    comm : communicator of the collective methods.
    """

    def __init__(
        self,
        bodies: tuple[Body, Body],
        line: ContactLine,
        mesh: Mesh,
        planes: tuple[float, float],
        points: tuple[StressPoints, StressPoints],
        exclude: float,
        comm: MPI.Comm,
    ) -> None:
        self._planes, self._points, self._exclude, self._comm = planes, points, exclude, comm
        self._line = line
        self._boundaries = BoundaryRecovery(bodies, line, mesh, planes, comm, fine=True)
        self._shape: FloatArray | None = None
        self._known: tuple[_Known, _Known] | None = None

    def stresses(
        self,
        pressure: FloatArray,
        friction: float,
        shape: FloatArray | None = None,
        gone: tuple[BoolArray, BoolArray] | None = None,
    ) -> tuple[BodyStress, BodyStress]:
        """Return the stresses of lower and upper. Collective on comm, the same on all ranks.

        Parameters
        ----------
        pressure : (n,) float, MPa, of the contact solution.
        friction : mu; all of the contact slides.
        shape : (2, n) float, mm, wear that the elastic bodies have followed; None: none.
        gone : of lower and upper, (layers, n) bool, where their layers are worn through: there
            they have no stress, nor have the interfaces under them; None: nowhere.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        if shape is not None and not shape.any():
            shape = None
        if self._known is None or not _same(shape, self._shape):
            self._known = None  # not two at a time
            self._known = self._integrated(shape)
            self._shape = None if shape is None else shape.copy()
        shear = friction * pressure
        lower, upper = (
            self._of_body(known, pressure, shear, None if gone is None else gone[i])
            for i, known in enumerate(self._known)
        )
        return lower, upper

    def _of_body(
        self, known: _Known, pressure: FloatArray, shear: FloatArray, gone: BoolArray | None
    ) -> BodyStress:
        stress = known.stress(pressure, shear, self._comm)
        surface = known.surface.stress(pressure, shear)
        along = np.array(
            [[s.stress(pressure, shear) for s in sides] for sides in known.interfaces]
        ).reshape(len(known.interfaces), 2, len(known.under_interfaces), 6)
        if gone is not None and gone.any():
            lost = np.zeros((known.layers, gone.shape[1] + 1), dtype=bool)
            lost[:-1, :-1] = gone  # nothing of the body itself, nothing beside the contact (-1)
            stress[lost[known.zones, known.under]] = np.nan
            surface[gone[0]] = np.nan
            along[np.repeat(lost[:-1, None, known.under_interfaces], 2, axis=1)] = np.nan
        n_search = len(known.search.points)
        values = mises(stress)
        values[n_search:][~known.search.allows(known.points[n_search:])] = np.nan
        return BodyStress(
            stress[n_search:],
            surface,
            known.search.largest(known.points, known.zones, values),
            along,
            known.largest_of_zones(values),
        )

    def _integrated(self, shape: FloatArray | None) -> tuple[_Known, _Known]:
        """Return the influences of both bodies. Collective on comm."""
        zones = [
            [in_case_frame(unit, BODIES[i], self._planes[i]) for unit in units]
            for i, units in enumerate(self._boundaries.responses(shape))
        ]
        around = np.concatenate([edges([zone.boundary for zone in body]) for body in zones])
        lower, upper = (self._of_zones(i, body, around) for i, body in enumerate(zones))
        return lower, upper

    def _of_zones(self, i: int, zones: list[BoundaryResponse], around: FloatArray) -> _Known:
        boundaries, stresses = [zone.boundary for zone in zones], list(map(ZoneStress, zones))
        search = Search(boundaries, around, self._exclude)
        wanted, sides = self._points[i]
        points = np.concatenate([search.points, wanted])
        numbers = np.concatenate([search.zones, zones_of(boundaries, wanted, sides)])
        parts = [
            (zone, of_zone[first : first + _BLOCK])
            for k, zone in enumerate(stresses)
            for of_zone in [np.flatnonzero(numbers == k)]
            for first in range(0, len(of_zone), _BLOCK)
        ]
        mine = parts[self._comm.rank :: self._comm.size]
        with together(self._comm):
            blocks = [(rows, zone.at(points[rows])) for zone, rows in mine]
            faces = [zone.surface for zone in stresses]
        middles = boundaries[0].nodes[boundaries[0].elements[boundaries[0].below, 1], 0]
        return _Known(
            search, points, numbers, self._line.element_at(points[:, 0]), blocks,
            _at(faces[0], boundaries[0].contact),
            _beside_interfaces(boundaries, faces, BODIES[i]), self._line.element_at(middles),
            len(zones),
        )  # fmt: skip


def interfaces(
    body: Body, line: ContactLine, mesh: Mesh, which: BodyName, plane: float
) -> Interfaces:
    """Return where the stresses along the interfaces of a body are. Not collective.

    Parameters
    ----------
    plane : mm, height of the contact plane of the body in the frame of the case.
    """
    zones = zone_meshes(body.section, line, mesh, fine=True)
    middles = [zone.nodes[zone.elements[zone.below, 1]] for zone in zones[:-1]]
    upward = 1.0 if which == "lower" else -1.0
    heights = [plane + upward * middle[0, 1] for middle in middles]
    return Interfaces(middles[0][:, 0] if middles else np.empty(0), np.array(heights))


def _at(influence: Influence, elements: IntArray) -> Influence:
    return Influence(influence.normal[elements], influence.torsion[elements])


def _beside_interfaces(
    boundaries: Sequence[BoundaryMesh], faces: Sequence[Influence], which: BodyName
) -> list[tuple[Influence, Influence]]:
    """Return the stress above and below each interface, from those on the zones' boundaries."""
    sides = []
    for i, (outer, inner) in enumerate(itertools.pairwise(boundaries)):
        towards, away = _at(faces[i], outer.below), _at(faces[i + 1], inner.above)
        sides.append((towards, away) if which == "lower" else (away, towards))
    return sides


def _same(first: FloatArray | None, second: FloatArray | None) -> bool:
    if first is None or second is None:
        return first is second
    return bool(np.array_equal(first, second))
