"""What boundary elements say of both bodies under a contact solution: on boundaries and inside."""

import itertools
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.bem.body import (
    BoundaryResponse,
    body_zones,
    in_case_frame,
    solve_zones,
)
from ringwear_par.elasticity.bem.boundary import BoundaryMesh, node_wear, zone_meshes
from ringwear_par.elasticity.mesh import ContactLine, Mesh, pair_slope
from ringwear_par.elasticity.sections import BODIES, Body
from ringwear_par.elasticity.stress.fields import (
    FACES,
    BoundaryFields,
    Largest,
    mises,
)
from ringwear_par.elasticity.stress.largest import Search, edges, zones_of
from ringwear_par.elasticity.stress.zone import ZoneStress
from ringwear_par.parallel import together

#: points that a rank does in one go; the same whatever the ranks, and so the digits
_BLOCK = 64


class BoundaryRecovery:
    """The boundary fields of two bodies, for any contact solution, wear and elasticity.

    Responses to unit loads are solved for when first needed, and anew where elements have moved.

    Parameters
    ----------
    bodies : lower and upper.
    line : contact elements.
    mesh : discretisation.
    planes : mm, height of the contact plane of lower and upper in the frame of the case.
    comm : communicator of the collective methods; every rank keeps the responses.
    fine : of ``zone_meshes``.
    """

    def __init__(
        self,
        bodies: tuple[Body, Body],
        line: ContactLine,
        mesh: Mesh,
        planes: tuple[float, float],
        comm: MPI.Comm,
        *,
        fine: bool = False,
    ) -> None:
        self._bodies, self.line, self._mesh, self._planes = bodies, line, mesh, planes
        self.comm, self._fine = comm, fine
        # of each body the wear and the slope that its responses are of
        self._known: dict[int, tuple[FloatArray, list[BoundaryResponse]]] = {}

    def responses(self, shape: FloatArray | None) -> list[list[BoundaryResponse]]:
        """Return the responses of the zones of lower and upper, in the frame of the case.

        Collective on comm.

        Parameters
        ----------
        shape : (2, n) float, mm, wear that the elements have followed; None: none.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        line, mesh, (lower, upper) = self.line, self._mesh, self._bodies
        shape = np.zeros((2, line.n)) if shape is None else shape
        slope = pair_slope((lower.section, upper.section), line, mesh, shape)
        for i, (body, own) in enumerate(zip(self._bodies, (slope, -slope), strict=True)):
            at = np.stack([own, shape[i]])  # the same on all ranks
            if i in self._known and np.array_equal(self._known[i][0], at):
                continue
            self._known.pop(i, None)  # not two at a time
            worn = node_wear(line, shape[i])
            zones = body_zones(body, line, mesh, worn, own, fine=self._fine)
            found, _ = solve_zones(zones, mesh.quadrature_tolerance, self.comm)
            self._known[i] = at, [in_case_frame(zone, BODIES[i], self._planes[i]) for zone in found]
        return [self._known[i][1] for i in range(2)]

    def interfaces(self) -> list[tuple[FloatArray, FloatArray]]:
        """Return where the interfaces of lower and upper are. Not collective.

        That is (m,) mm, the radii of mid-points of their elements, the same for all, increasing;
        and (i,) mm, their heights, unworn, from the contact face on. Both are empty without layers.
        """
        found = []
        for body, plane, upward in zip(self._bodies, self._planes, (1.0, -1.0), strict=True):
            zones = zone_meshes(body.section, self.line, self._mesh, fine=self._fine)
            middles = [zone.nodes[zone.elements[zone.below, 1]] for zone in zones[:-1]]
            heights = [plane + upward * middle[0, 1] for middle in middles]
            found.append((middles[0][:, 0] if middles else np.empty(0), np.array(heights)))
        return found

    def fields(
        self,
        pressure: FloatArray,
        approach: float,
        friction: float,
        wear: FloatArray,
        shape: FloatArray | None = None,
    ) -> tuple[BoundaryFields, BoundaryFields]:
        """Return the fields of lower and upper. Collective on comm, the same on all ranks.

        Displaced by their fields, the bodies touch at the mid-points of elements under pressure,
        measured along the common normal: displacements are those of the collocated equations, and
        the top of the upper body has come down by the approach. All of the contact slides, so that
        friction is mu p everywhere.

        Parameters
        ----------
        pressure : (n,) float, MPa, of the contact solution.
        approach : mm, likewise.
        friction : mu.
        wear : (2, n) float, mm, wear of lower and upper, which lowers the nodes shown.
        shape : (2, n) float, mm, wear that the elastic bodies have followed; None: none.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        loads = np.stack([pressure, pressure, friction * pressure])
        lower, upper = (
            self._of_body(i, units, loads, approach, wear[i])
            for i, units in enumerate(self.responses(shape))
        )
        return lower, upper

    def _of_body(
        self, i: int, units: list[BoundaryResponse], loads: FloatArray, approach: float,
        wear: FloatArray,
    ) -> BoundaryFields:  # fmt: skip
        zones, first = [], 0
        for unit, worn in zip(units, self._worn_zones(i, wear), strict=True):
            # unit loads summed: one load is left, that of the case
            displacement, traction = (
                np.einsum("mcn,cn->mc", values, loads)
                for values in (unit.displacement, unit.traction)
            )
            # the same force on elements that wear has tilted, and so lengthened
            traction[worn.contact] *= (_lengths(unit.boundary) / _lengths(worn))[worn.contact, None]
            shown = in_case_frame(replace(unit, boundary=worn), BODIES[i], self._planes[i]).boundary
            pressure, depth = np.zeros((2, len(worn.elements)))
            if len(worn.contact):
                pressure[worn.contact], depth[worn.contact] = loads[0], wear
            face = np.zeros(len(worn.elements), dtype=np.int64)
            for number, name in enumerate(FACES[1:-1], 1):
                face[getattr(worn, name)] = number
            face[np.concatenate([worn.above, worn.below])] = FACES.index("interface")
            displacement /= self._bodies[i].young
            displacement[:, 1] -= approach if i == 1 else 0.0
            elements, first = shown.elements + first, first + len(shown.nodes)
            zones.append((shown.nodes, elements, face, displacement, traction, pressure, depth))
        return BoundaryFields(*(np.concatenate(parts) for parts in zip(*zones, strict=True)))

    def _worn_zones(self, i: int, wear: FloatArray) -> list[BoundaryMesh]:
        """Return the boundary elements of a body after (n,) mm of wear, in its own frame.

        Mid-points of contact elements lie where gaps are taken, on the worn face.
        """
        section, line = self._bodies[i].section, self.line
        first, *layers_below = zone_meshes(
            section, line, self._mesh, node_wear(line, wear), fine=self._fine
        )
        nodes = first.nodes.copy()
        middle = first.elements[first.contact, 1]
        nodes[middle, 0] = line.r
        nodes[middle, 1] = section.depth(line.r) - wear
        return [first._replace(nodes=nodes), *layers_below]


def _lengths(boundary: BoundaryMesh) -> FloatArray:
    ends = boundary.nodes[boundary.elements]
    return np.hypot(*(ends[:, 2] - ends[:, 0]).T)


class BodyStress(NamedTuple):
    """Stress of one body, the same on all ranks."""

    #: (p, 6) float, MPa, rr, tt, zz, rz, rt, tz at the points asked for; NaN where wear has left
    #: none of the body, or of the layer
    points: FloatArray
    #: (n, 6) float, MPa, likewise on the contact elements
    surface: FloatArray
    #: the largest von Mises stress outside the radius round edges
    largest: Largest
    #: (i, 2, m, 6) float, MPa, above and below each interface
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
class _UnitStress:
    """Stress of one body for unit loads (..., 6, n), see ``ZoneStress``."""

    #: whose points come before those asked for
    search: Search
    #: (p, 2) and (p,), points, their zones, and elements of the contact line over or under them, -1
    #: for none
    points: FloatArray
    zones: IntArray
    under: IntArray
    #: numbers of this rank's points, and the stress there
    numbers: IntArray
    inside: FloatArray
    #: (n, 6, n), of the contact elements
    surface: FloatArray
    #: (i, 2, m, 6, n), of the elements above and below each interface, and (m,) as ``under``
    interfaces: FloatArray
    under_interfaces: IntArray
    #: number of zones of a body with layers, 0 of one without
    layers: int


class StressRecovery:
    """The stress in two bodies, for any contact solution and wear.

    Points are integrated over when first needed, shared out over the ranks, and anew where elements
    have moved; from then on a state takes one product.

    Parameters
    ----------
    boundaries : of the bodies, with the fine elements for stresses.
    points : of lower and of upper.
    exclude : mm, radius round edges in which the largest stress is not looked for.
    """

    def __init__(
        self,
        boundaries: BoundaryRecovery,
        points: tuple[StressPoints, StressPoints],
        exclude: float,
    ) -> None:
        self._boundaries, self._points, self._exclude = boundaries, points, exclude
        self._line, self._comm = boundaries.line, boundaries.comm
        self._shape, self._units = np.empty(0), list[_UnitStress]()

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
        shape = np.zeros((2, self._line.n)) if shape is None else shape
        if not self._units or not np.array_equal(shape, self._shape):
            self._shape, self._units = shape.copy(), []  # not two at a time
            bodies = self._boundaries.responses(shape)
            around = np.concatenate([edges([zone.boundary for zone in body]) for body in bodies])
            self._units = [self._integrated(i, body, around) for i, body in enumerate(bodies)]
        lower, upper = (
            self._of_body(units, pressure, friction, None if gone is None else gone[i])
            for i, units in enumerate(self._units)
        )
        return lower, upper

    def _of_body(
        self, units: _UnitStress, pressure: FloatArray, friction: float, gone: BoolArray | None
    ) -> BodyStress:
        def under_load(unit: FloatArray) -> FloatArray:
            stress: FloatArray = unit @ pressure
            stress[..., 4:] *= friction
            return stress

        stress = np.zeros((len(units.points), 6))
        stress[units.numbers] = under_load(units.inside)
        self._comm.Allreduce(MPI.IN_PLACE, stress, MPI.SUM)  # each is known to one rank
        surface, along = under_load(units.surface), under_load(units.interfaces)
        if gone is not None and gone.any():
            lost = np.zeros((units.layers, gone.shape[1] + 1), dtype=bool)
            lost[:-1, :-1] = gone  # nothing of the body itself, nothing beside the contact (-1)
            stress[lost[units.zones, units.under]] = np.nan
            surface[gone[0]] = np.nan
            along[np.repeat(lost[:-1, None, units.under_interfaces], 2, axis=1)] = np.nan
        n_search = len(units.search.points)
        values = mises(stress)
        values[n_search:][~units.search.allows(units.points[n_search:])] = np.nan
        largest, *in_layers = (
            units.search.largest(units.points, units.zones, np.where(there, values, np.nan))
            for there in (True, *(units.zones == k for k in range(units.layers)))
        )
        of_layers = np.array([each.mises for each in in_layers])
        return BodyStress(stress[n_search:], surface, largest, along, of_layers)

    def _integrated(self, i: int, zones: list[BoundaryResponse], around: FloatArray) -> _UnitStress:
        """Return the stress of lower (0) or upper (1) for unit loads. Collective on comm."""
        boundaries, stresses = [zone.boundary for zone in zones], list(map(ZoneStress, zones))
        search = Search(boundaries, around, self._exclude)
        wanted, sides = self._points[i]
        points = np.concatenate([search.points, wanted])
        of_zones = np.concatenate([search.zones, zones_of(boundaries, wanted, sides)[0]])
        parts = [
            (zone, of_zone[first : first + _BLOCK])
            for k, zone in enumerate(stresses)
            for of_zone in [np.flatnonzero(of_zones == k)]
            for first in range(0, len(of_zone), _BLOCK)
        ]
        mine, faces, n = parts[self._comm.rank :: self._comm.size], boundaries[0], self._line.n
        with together(self._comm):
            blocks = [zone.at(points[of_zone]) for zone, of_zone in mine]
        middles = faces.nodes[faces.elements[faces.below, 1], 0]
        interfaces = [
            (outer.surface[above.below], inner.surface[below.above])[:: 1 if i == 0 else -1]
            for (outer, above), (inner, below) in itertools.pairwise(
                zip(stresses, boundaries, strict=True)
            )
        ]
        return _UnitStress(
            search=search,
            points=points,
            zones=of_zones,
            under=self._line.element_at(points[:, 0]),
            numbers=np.concatenate([np.empty(0, np.int64), *(of_zone for _, of_zone in mine)]),
            inside=np.concatenate([np.empty((0, 6, n)), *blocks]),
            surface=stresses[0].surface[faces.contact],
            interfaces=np.array(interfaces).reshape(len(zones) - 1, 2, len(middles), 6, n),
            under_interfaces=self._line.element_at(middles),
            layers=len(zones) if len(zones) > 1 else 0,
        )
