"""Elasticity of bodies whose elements follow the worn profile, assembled anew where they moved.

Wear moves the nodes of the contact line and few others. What the rest of a body's boundary says of
itself is assembled once and kept; each update adds the rows and columns that moved to a copy. A
body without wear law is assembled once and for all.
"""

import time

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.assembly import Assembly, Moving, assemble, number_dofs
from ringwear_par.elasticity.body import (
    Compliance,
    boundary_conditions,
    compliance,
    condense,
    solve_assembled,
)
from ringwear_par.elasticity.mesh import ContactLine, Mesh, boundary_mesh, node_wear, pair_key
from ringwear_par.elasticity.pair import ContactPair, join_bodies
from ringwear_par.elasticity.quadrature import quadrature
from ringwear_par.elasticity.sections import Body, Section


def moving_parts(section: Section, line: ContactLine, mesh: Mesh) -> Moving:
    """Return the nodes and elements of a boundary mesh that wear of its contact line moves."""
    unworn = boundary_mesh(section, line, mesh)
    worn = boundary_mesh(section, line, mesh, np.full(line.n + 1, 1e-3 * section.height))
    nodes = (worn.nodes != unworn.nodes).any(axis=1)
    return Moving(nodes, nodes[unworn.elements].any(axis=1))


class _MovingBody:
    """One body that wears: its base, and the compliance for any wear of it."""

    def __init__(self, body: Body, line: ContactLine, mesh: Mesh) -> None:
        self._body, self._line, self._mesh = body, line, mesh
        self._moving = moving_parts(body.section, line, mesh)
        boundary = boundary_mesh(body.section, line, mesh)
        # which values are unknown, and where they stand, does not change with the wear
        self._dofs = number_dofs(boundary, boundary_conditions(boundary, body.grip))
        self._rules = quadrature(mesh.quadrature_tolerance)
        self._base: Assembly | None = None

    def compliance(self, worn: FloatArray, comm: MPI.Comm) -> Compliance:
        """Return the compliance after (n+1,) mm of wear at the line's nodes. Collective on comm."""
        started = time.perf_counter()
        boundary = boundary_mesh(self._body.section, self._line, self._mesh, worn)
        conditions = boundary_conditions(boundary, self._body.grip)
        arguments = boundary, conditions, self._dofs, self._body.poisson, self._rules, comm
        evaluations = 0
        if self._base is None:
            self._base = assemble(*arguments, self._moving)
            evaluations = self._base.kernel_evaluations
        rows = assemble(*arguments, self._moving, self._base)
        rows = Assembly(rows.normal, rows.torsion, rows.kernel_evaluations + evaluations)
        seconds = time.perf_counter() - started
        middle = boundary.elements[boundary.contact, 1]
        response = solve_assembled(rows, self._dofs, middle, boundary.fixed, seconds, comm)
        return condense(boundary, response)


class UpdatedGeometry:
    """The contact pair of two bodies for any wear of them.

    The state are matrices that do not depend on the wear, so that a pair is the same whatever
    updates came before.

    Parameters
    ----------
    bodies : lower and upper.
    wears : which of them wear, and so move.
    line : contact elements.
    mesh : discretisation.
    comm : communicator of the collective methods; each rank keeps its rows of the matrices.
    """

    def __init__(
        self,
        bodies: tuple[Body, Body],
        wears: tuple[bool, bool],
        line: ContactLine,
        mesh: Mesh,
        comm: MPI.Comm,
    ) -> None:
        self._bodies, self._line, self._mesh, self._comm = bodies, line, mesh, comm
        self._key = pair_key(bodies, (float(line.edges[0]), float(line.edges[-1])), mesh)
        self._moving = [
            _MovingBody(body, line, mesh) if moves else None
            for body, moves in zip(bodies, wears, strict=True)
        ]
        self._still: list[Compliance | None] = [None, None]

    def update(self, worn: FloatArray) -> ContactPair:
        """Return the pair after wear, its cost being that of this update. Collective on comm.

        Parameters
        ----------
        worn : (2, n) float, mm >= 0, wear of the elements of lower and upper.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        nodes = [node_wear(self._line, depth) for depth in worn]
        compliances, new = [], []
        for i, (body, moving) in enumerate(zip(self._bodies, self._moving, strict=True)):
            if moving is not None:
                known = moving.compliance(nodes[i], self._comm)
                new.append(known)
            else:
                still = self._still[i]
                if still is None:
                    still = compliance(body, self._line, self._mesh, self._comm)
                    self._still[i] = still
                    new.append(still)
                known = still
            compliances.append(known)
        key = (self._key, worn.tobytes()) if worn.any() else self._key
        return join_bodies(self._line, compliances, key, new)
