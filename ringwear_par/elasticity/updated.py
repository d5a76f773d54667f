"""Elasticity of bodies whose elements follow the worn profile, assembled anew where they moved.

Wear moves the nodes of the contact line and few others. What the rest of a body's boundary says of
itself is assembled once and kept; each update adds the rows and columns that moved to a copy. A
body without wear law is assembled once and for all.
"""

import time

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Ring
from ringwear_par.elasticity.assembly import Assembly, Moving, assemble, number_dofs
from ringwear_par.elasticity.body import (
    Compliance,
    compliance,
    condense,
    ring_conditions,
    solve_assembled,
)
from ringwear_par.elasticity.mesh import ContactLine, Mesh, boundary_mesh, node_wear
from ringwear_par.elasticity.pair import BodyCost, Operator, join_bodies
from ringwear_par.elasticity.quadrature import quadrature
from ringwear_par.elasticity.sections import Section


def moving_parts(section: Section, line: ContactLine, mesh: Mesh) -> Moving:
    """Return the nodes and elements of a contour that wear of its contact line moves."""
    unworn = boundary_mesh(section, line, mesh)
    worn = boundary_mesh(section, line, mesh, np.full(line.n + 1, 1e-3 * section.height))
    nodes = (worn.nodes != unworn.nodes).any(axis=1)
    return Moving(nodes, nodes[unworn.elements].any(axis=1))


class _MovingBody:
    """One body that wears: its base, and the compliance for any wear of it."""

    def __init__(self, section: Section, ring: Ring, line: ContactLine, mesh: Mesh) -> None:
        self._section, self._ring, self._line, self._mesh = section, ring, line, mesh
        self._moving = moving_parts(section, line, mesh)
        body = boundary_mesh(section, line, mesh)
        # which values are unknown, and where they stand, does not change with the wear
        self._unknowns = number_dofs(body, ring_conditions(body, ring.grip))
        self._rules = quadrature(mesh.quadrature_tolerance)
        self._base: Assembly | None = None

    def compliance(self, worn: FloatArray, comm: MPI.Comm) -> Compliance:
        """Return the compliance after (n+1,) mm of wear at the line's nodes. Collective on comm."""
        started = time.perf_counter()
        body = boundary_mesh(self._section, self._line, self._mesh, worn)
        conditions = ring_conditions(body, self._ring.grip)
        arguments = body, conditions, self._unknowns, self._ring.poisson, self._rules, comm
        evaluations = 0
        if self._base is None:
            self._base = assemble(*arguments, self._moving)
            evaluations = self._base.kernel_evaluations
        rows = assemble(*arguments, self._moving, self._base)
        rows = Assembly(rows.normal, rows.torsion, rows.kernel_evaluations + evaluations)
        seconds = time.perf_counter() - started
        middle = body.elements[body.contact, 1]
        response = solve_assembled(rows, self._unknowns, middle, body.held, seconds, comm)
        return condense(body, response)


class UpdatedGeometry:
    """The operator of a case for any wear of its bodies.

    The state are matrices that do not depend on the wear, so that an operator is the same whatever
    updates came before.

    Parameters
    ----------
    case : the case; its bodies with wear laws move.
    comm : communicator of the collective methods; each rank keeps its rows of the matrices.
    """

    def __init__(self, case: Case, comm: MPI.Comm) -> None:
        self._case, self._comm = case, comm
        self._moving = [
            None if law is None else _MovingBody(section, ring, case.line, case.mesh)
            for law, section, ring in zip(case.laws, case.sections, case.rings, strict=True)
        ]
        self._still: list[Compliance | None] = [None, None]

    def update(self, worn: FloatArray) -> tuple[Operator, BodyCost]:
        """Return the operator after wear, and what this update took. Collective on comm.

        Parameters
        ----------
        worn : (2, n) float, mm >= 0, wear of the elements of lower and upper, as in State.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        line, rings = self._case.line, self._case.rings
        nodes = [node_wear(line, depth) for depth in worn]
        bodies, new = [], []
        for i, (ring, moving) in enumerate(zip(rings, self._moving, strict=True)):
            if moving is not None:
                body = moving.compliance(nodes[i], self._comm)
                new.append(body)
            else:
                known = self._still[i]
                if known is None:
                    known = compliance(
                        self._case.sections[i], line, ring.poisson, ring.grip, self._case.mesh,
                        self._comm,
                    )  # fmt: skip
                    self._still[i] = known
                    new.append(known)
                body = known
            bodies.append(body)
        return join_bodies(line, bodies), BodyCost.of(new)
