"""Elasticity of bodies whose elements follow the worn profile, assembled anew where they moved.

Wear moves the nodes of the contact line and few others. What the rest of a body's boundary says of
itself is assembled once and kept; each update adds the rows and columns that moved to a copy. A
body without wear law is assembled once and for all if its face is flat. Otherwise the direction of
the pressure on its contact elements may turn with the other face, and they count as moving.
"""

import time

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.assembly import Assembly, Moving, assemble, number_dofs
from ringwear_par.elasticity.body import (
    Assembled,
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
from ringwear_par.elasticity.slopes import case_slopes, pair_slope


def moving_parts(section: Section, line: ContactLine, mesh: Mesh, wears: bool = True) -> Moving:
    """Return the nodes and elements of a boundary mesh that wear of its contact line moves.

    Of a body that does not wear, the elements that pressure may turn on.
    """
    unworn = boundary_mesh(section, line, mesh)
    if not wears:
        elements = np.zeros(len(unworn.elements), dtype=bool)
        elements[unworn.contact] = True
        return Moving(np.zeros(len(unworn.nodes), dtype=bool), elements)
    worn = boundary_mesh(section, line, mesh, np.full(line.n + 1, 1e-3 * section.height))
    nodes = (worn.nodes != unworn.nodes).any(axis=1)
    return Moving(nodes, nodes[unworn.elements].any(axis=1))


class _MovingBody:
    """One body of which something moves: its base, and the compliance for any wear."""

    def __init__(self, body: Body, line: ContactLine, mesh: Mesh, wears: bool) -> None:
        self._body, self._line, self._mesh = body, line, mesh
        self._moving = moving_parts(body.section, line, mesh, wears)
        boundary = boundary_mesh(body.section, line, mesh)
        # which values are unknown, and where they stand, does not change with the wear
        self._dofs = number_dofs(boundary, boundary_conditions(boundary, body.grip))
        self._rules = quadrature(mesh.quadrature_tolerance)
        self._base: Assembly | None = None

    def compliance(self, worn: FloatArray, slope: FloatArray, comm: MPI.Comm) -> Compliance:
        """Return the compliance after wear. Collective on comm.

        Parameters
        ----------
        worn : (n,) float, mm, of the line's elements.
        slope : (n,) float, that of ``boundary_conditions``.
        """
        started = time.perf_counter()
        nodes = node_wear(self._line, worn)
        boundary = boundary_mesh(self._body.section, self._line, self._mesh, nodes)
        conditions = boundary_conditions(boundary, self._body.grip, slope)
        arguments = boundary, conditions, self._dofs, self._body.poisson, self._rules, comm
        evaluations = 0
        if self._base is None:
            self._base = assemble(*arguments, self._moving)
            evaluations = self._base.kernel_evaluations
        rows = assemble(*arguments, self._moving, self._base)
        rows = Assembly(rows.normal, rows.torsion, rows.kernel_evaluations + evaluations)
        seconds = time.perf_counter() - started
        middle = boundary.elements[boundary.contact, 1]
        assembled = Assembled(rows, self._dofs, middle, boundary.fixed, seconds)
        return condense(boundary, solve_assembled([assembled], comm)[0], slope)


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
        lower, upper = bodies
        self._bodies, self._line, self._mesh, self._comm = bodies, line, mesh, comm
        self._sections, self._wears = (lower.section, upper.section), wears
        self._key = pair_key(bodies, (float(line.edges[0]), float(line.edges[-1])), mesh)
        sloping = np.any(case_slopes(self._sections, line, mesh), axis=1)
        self._moving = [
            _MovingBody(body, line, mesh, moves) if moves or slopes else None
            for body, moves, slopes in zip(bodies, wears, sloping, strict=True)
        ]
        # of bodies that do not wear: the last compliance, and the slope that it is of
        self._still: list[tuple[FloatArray, Compliance] | None] = [None, None]

    def update(self, worn: FloatArray) -> ContactPair:
        """Return the pair after wear, its cost being that of this update. Collective on comm.

        Parameters
        ----------
        worn : (2, n) float, mm >= 0, wear of the elements of lower and upper.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        worn = np.where(np.array(self._wears)[:, None], worn, 0.0)
        slope = pair_slope(self._sections, self._line, self._mesh, worn)
        compliances, new = [], []
        for i, own in enumerate((slope, -slope)):
            still = self._still[i]
            if still is not None and np.array_equal(still[0], own):
                compliances.append(still[1])
                continue
            moving = self._moving[i]
            if moving is not None:
                found = moving.compliance(worn[i], own, self._comm)
            else:
                found = compliance(self._bodies[i], self._line, self._mesh, self._comm)
            if not self._wears[i]:
                self._still[i] = own, found
            compliances.append(found)
            new.append(found)
        key = (self._key, worn.tobytes()) if worn.any() else self._key
        return join_bodies(self._line, compliances, slope, key, new)
