"""Displacement and traction on the whole boundaries of both bodies, from a contact solution."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.body import BoundaryResponse, boundary_responses, in_case_frame
from ringwear_par.elasticity.bem.boundary import BoundaryMesh, node_wear, zone_meshes
from ringwear_par.elasticity.mesh import ContactLine, Mesh, pair_slope
from ringwear_par.elasticity.sections import BODIES, Body, BodyName
from ringwear_par.elasticity.stress.fields import FACES, BoundaryFields, joined


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
        self._known: dict[BodyName, tuple[FloatArray, list[BoundaryResponse]]] = {}

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
        the top of the upper body has come down by the approach. What remains there is the
        difference between the collocated compliance and the symmetric one that the contact was
        solved with (see ``symmetric``), which vanishes with the mesh. All of the contact slides,
        so that friction is mu p everywhere.

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
            joined(
                [
                    self._of_zone(i, unit, worn, pressure, approach, friction, wear[i])
                    for unit, worn in zip(units, self._worn_zones(i, wear[i]), strict=True)
                ]
            )
            for i, units in enumerate(self.responses(shape))
        )
        return lower, upper

    def responses(self, shape: FloatArray | None) -> list[list[BoundaryResponse]]:
        """Return the responses of the zones of lower and upper, in the bodies' own frames.

        Collective on comm.

        Parameters
        ----------
        shape : (2, n) float, mm, wear that the elements have followed; None: none.
        """
        if shape is not None and not shape.any():
            shape = None
        sections = self._bodies[0].section, self._bodies[1].section
        slope = pair_slope(sections, self._line, self._mesh, shape)
        return [
            self._of_body(i, body_slope, None if shape is None else shape[i])
            for i, body_slope in enumerate((slope, -slope))
        ]

    def _of_zone(
        self,
        i: int,
        unit: BoundaryResponse,
        worn: BoundaryMesh,
        p: FloatArray,
        approach: float,
        friction: float,
        wear: FloatArray,
    ) -> BoundaryFields:
        which, young = BODIES[i], self._bodies[i].young
        # unit loads summed: one load is left, that of the case
        shear = friction * p
        displacement, traction = (
            np.concatenate([loads[:, :2] @ p, loads[:, 2:] @ shear], axis=1)
            for loads in (unit.displacement, unit.traction)
        )
        # the same force on elements that wear has tilted, and so lengthened, since the reference
        longer = (_lengths(unit.boundary) / _lengths(worn))[worn.contact, None]
        traction[worn.contact] *= longer
        response = in_case_frame(
            replace(
                unit, boundary=worn, displacement=displacement[..., None] / young,
                traction=traction[..., None],
            ),
            which, self._planes[i],
        )  # fmt: skip
        moved = response.displacement[..., 0].copy()
        if which == "upper":
            moved[:, 1] -= approach
        elements = len(worn.elements)
        pressure, depth = np.zeros(elements), np.zeros(elements)
        if len(worn.contact):
            pressure[worn.contact], depth[worn.contact] = p, wear
        face = np.zeros(elements, dtype=np.int64)
        for name in ("contact", "fixed", "inner_side", "outer_side", "above", "below"):
            number = "interface" if name in ("above", "below") else name
            face[getattr(worn, name)] = FACES.index(number)
        return BoundaryFields(
            response.boundary.nodes, response.boundary.elements, face, moved,
            response.traction[..., 0], pressure, depth,
        )  # fmt: skip

    def _of_body(
        self, i: int, slope: FloatArray, shape: FloatArray | None
    ) -> list[BoundaryResponse]:
        """Return the responses of lower (0) or upper (1), of slope and wear (n,). Collective."""
        line, which = self._line, BODIES[i]
        worn = None if shape is None or not shape.any() else node_wear(line, shape)
        at = np.concatenate([slope, np.zeros(line.n + 1) if worn is None else worn])
        stored = self._known.get(which)
        # the slopes and the shape are the same on all ranks, and so is the decision
        if stored is None or not np.array_equal(stored[0], at):
            self._known.pop(which, None)  # not two at a time
            responses = boundary_responses(
                self._bodies[i], line, self._mesh, self._comm, worn, slope, fine=self._fine
            )
            stored = self._known[which] = (at, responses)
        return stored[1]

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
