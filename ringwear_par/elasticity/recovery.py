"""Displacement and traction on the whole boundaries of both bodies, from a contact solution."""

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.contact.solver import ContactState
from ringwear_par.elasticity.body import BoundaryResponse, boundary_response, in_case_frame
from ringwear_par.elasticity.boundary_fields import BODIES, FACES, BoundaryFields, Which
from ringwear_par.elasticity.mesh import BoundaryMesh, boundary_mesh, node_wear


def wants_boundary(case: Case, time: float, finished: bool, before: float) -> bool:
    """Tell whether the case asks for the boundary fields of a stored state.

    Parameters
    ----------
    time : s, of the state.
    finished : whether it is the last.
    before : s, time of the stored state before it; negative: there is none.
    """
    asked = case.output.boundary
    if isinstance(asked, str):
        return asked == "all" or (asked == "last" and finished)
    near = SAME_TIME * time
    return any(before + near < t <= time + near for t in asked)


class WholeBoundary:
    """The boundary fields of a case, for any contact solution, wear and elasticity.

    Responses to unit loads are solved for when first needed, and anew for a body whose elements
    have moved.

    Parameters
    ----------
    case : the case.
    comm : communicator of the collective methods; every rank keeps the responses.
    """

    def __init__(self, case: Case, comm: MPI.Comm) -> None:
        self._case, self._comm = case, comm
        self._known: dict[Which, tuple[FloatArray | None, BoundaryResponse]] = {}

    def fields(
        self, contact: ContactState, wear: FloatArray, shape: FloatArray | None = None
    ) -> tuple[BoundaryFields, BoundaryFields]:
        """Return the fields of lower and upper. Collective on comm, the same on all ranks.

        Displaced by their fields, the bodies touch at the mid-points of elements under pressure:
        u_z is that of the collocated equations, and the top of the upper body has come down by the
        approach. What remains there is the difference between the collocated compliance and its
        symmetric part, which the contact was solved with (see pair.symmetric) and which vanishes
        with the mesh. All of the contact slides, so that friction is mu p everywhere.

        Parameters
        ----------
        contact : its solution.
        wear : (2, n) float, mm, wear of lower and upper, which lowers the nodes shown.
        shape : (2, n) float, mm, wear that the elastic bodies have followed; None: none.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        lower, upper = (
            self._body(i, contact, wear[i], None if shape is None else shape[i]) for i in (0, 1)
        )
        return lower, upper

    def _body(
        self, i: int, contact: ContactState, wear: FloatArray, shape: FloatArray | None
    ) -> BoundaryFields:
        case, which = self._case, BODIES[i]
        ring = case.rings[i]
        plane = (case.lower.z[1], case.upper.z[0])[i]
        unit = self._response(i, shape)
        # unit loads summed: one load is left, that of the case
        p, shear = contact.pressure, case.friction * contact.pressure
        displacement, traction = (
            np.concatenate([loads[:, :2] @ p, loads[:, 2:] @ shear], axis=1)
            for loads in (unit.displacement, unit.traction)
        )
        shown = _worn_contour(case, i, wear)
        # the same force on elements that wear has tilted, and so lengthened, since the reference
        traction[shown.contact] *= (_lengths(unit.body) / _lengths(shown))[shown.contact, None]
        response = in_case_frame(
            BoundaryResponse(shown, displacement[..., None] / ring.young, traction[..., None]),
            which, plane,
        )  # fmt: skip
        moved = response.displacement[..., 0].copy()
        if which == "upper":
            moved[:, 1] -= contact.approach
        elements = len(shown.elements)
        pressure, depth = np.zeros(elements), np.zeros(elements)
        pressure[shown.contact], depth[shown.contact] = p, wear
        face = np.zeros(elements, dtype=np.int64)
        for name in FACES[1:]:
            face[getattr(shown, name)] = FACES.index(name)
        return BoundaryFields(
            response.body.nodes, response.body.elements, face, moved, response.traction[..., 0],
            pressure, depth,
        )  # fmt: skip

    def _response(self, i: int, shape: FloatArray | None) -> BoundaryResponse:
        """Return the responses of a body whose elements followed (n,) mm of wear. Collective."""
        case, which = self._case, BODIES[i]
        ring = case.rings[i]
        if shape is not None and not shape.any():
            shape = None
        known = self._known.get(which)
        # the shape is the same on all ranks, and so is the decision
        if known is None or not _same(known[0], shape):
            worn = None if shape is None else node_wear(case.line, shape)
            self._known.pop(which, None)  # not two at a time
            response = boundary_response(
                case.sections[i], case.line, ring.poisson, ring.grip, case.mesh, self._comm, worn
            )
            known = self._known[which] = (None if shape is None else shape.copy(), response)
        return known[1]


def _lengths(body: BoundaryMesh) -> FloatArray:
    ends = body.nodes[body.elements]
    return np.hypot(*(ends[:, 2] - ends[:, 0]).T)


def _same(one: FloatArray | None, other: FloatArray | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)


def _worn_contour(case: Case, i: int, wear: FloatArray) -> BoundaryMesh:
    """Return the boundary elements of a body after (n,) mm of wear, in its own frame.

    Mid-points of contact elements lie where gaps are taken, on the worn face.
    """
    section, line = case.sections[i], case.line
    body = boundary_mesh(section, line, case.mesh, node_wear(line, wear))
    nodes = body.nodes.copy()
    middle = body.elements[body.contact, 1]
    nodes[middle, 0] = line.gap_point
    nodes[middle, 1] = section.depth(line.gap_point) - wear
    return body._replace(nodes=nodes)
