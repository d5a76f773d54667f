"""Displacement and traction on the whole boundaries of both bodies, from a contact solution."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.body import (
    BoundaryResponse,
    body_zones,
    in_case_frame,
    solve_zones,
)
from ringwear_par.elasticity.bem.boundary import BoundaryMesh, node_wear, zone_meshes
from ringwear_par.elasticity.mesh import ContactLine, Mesh, pair_slope
from ringwear_par.elasticity.sections import BODIES, Body
from ringwear_par.elasticity.stress.fields import FACES, BoundaryFields


class BoundaryRecovery:
    """The boundary fields of two bodies, for any contact solution, wear and elasticity.

    Responses to unit loads are solved for when first needed, and anew for a body whose elements
    have moved.

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
        self._bodies, self._line, self._mesh, self._planes = bodies, line, mesh, planes
        self._comm, self._fine = comm, fine
        # of each body the wear and the slope that its responses are of
        self._known: dict[int, tuple[FloatArray, list[BoundaryResponse]]] = {}

    def responses(self, shape: FloatArray | None) -> list[list[BoundaryResponse]]:
        """Return the responses of the zones of lower and upper, in the frame of the case.

        Collective on comm; the same objects as long as the elements are the same.

        Parameters
        ----------
        shape : (2, n) float, mm, wear that the elements have followed; None: none.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        line, mesh, (lower, upper) = self._line, self._mesh, self._bodies
        shape = np.zeros((2, line.n)) if shape is None else shape
        slope = pair_slope((lower.section, upper.section), line, mesh, shape)
        for i, (body, own) in enumerate(zip(self._bodies, (slope, -slope), strict=True)):
            at = np.stack([own, shape[i]])
            # the slopes and the shape are the same on all ranks, and so is the decision
            if i in self._known and np.array_equal(self._known[i][0], at):
                continue
            self._known.pop(i, None)  # not two at a time
            worn = node_wear(line, shape[i])
            zones = body_zones(body, line, mesh, worn, own, fine=self._fine)
            found, _ = solve_zones(zones, mesh.quadrature_tolerance, self._comm)
            shown = [in_case_frame(zone, BODIES[i], self._planes[i]) for zone in found]
            self._known[i] = at, shown
        return [self._known[i][1] for i in range(2)]

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
        lower, upper = (
            self._of_body(i, units, pressure, approach, friction, wear[i])
            for i, units in enumerate(self.responses(shape))
        )
        return lower, upper

    def _of_body(
        self, i: int, units: list[BoundaryResponse], p: FloatArray, approach: float,
        friction: float, wear: FloatArray,
    ) -> BoundaryFields:  # fmt: skip
        loads = np.stack([p, p, friction * p])
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
                pressure[worn.contact], depth[worn.contact] = p, wear
            face = np.zeros(len(worn.elements), dtype=np.int64)
            for name in ("contact", "fixed", "inner_side", "outer_side", "above", "below"):
                number = "interface" if name in ("above", "below") else name
                face[getattr(worn, name)] = FACES.index(number)
            displacement /= self._bodies[i].young
            displacement[:, 1] -= approach if i == 1 else 0.0
            elements, first = shown.elements + first, first + len(shown.nodes)
            zones.append((shown.nodes, elements, face, displacement, traction, pressure, depth))
        return BoundaryFields(*(np.concatenate(parts) for parts in zip(*zones, strict=True)))

    def _worn_zones(self, i: int, wear: FloatArray) -> list[BoundaryMesh]:
        """Return the boundary elements of a body after (n,) mm of wear, in its own frame.

        Mid-points of contact elements lie where gaps are taken, on the worn face.
        """
        section, line = self._bodies[i].section, self._line
        first, *layers_below = zone_meshes(
            section, line, self._mesh, node_wear(line, wear), fine=self._fine
        )
        nodes = first.nodes.copy()
        middle = first.elements[first.contact, 1]
        nodes[middle, 0] = line.gap_point
        nodes[middle, 1] = section.depth(line.gap_point) - wear
        return [first._replace(nodes=nodes), *layers_below]


def _lengths(boundary: BoundaryMesh) -> FloatArray:
    ends = boundary.nodes[boundary.elements]
    return np.hypot(*(ends[:, 2] - ends[:, 0]).T)
