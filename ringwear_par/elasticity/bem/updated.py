"""Elasticity of bodies whose elements follow the worn profile, assembled anew where they moved.

Wear moves the nodes of the contact line and few others. What the rest of a body's boundary says of
itself is assembled once and kept; each update adds the rows and columns that moved to a copy. A
body without wear law is assembled once and for all if its face is flat. Otherwise the direction of
the pressure on its contact elements may turn with the other face, and they count as moving. As wear
comes near an interface, this gives way too, and what stays is assembled once more.
"""

import time
from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.assembly import assemble
from ringwear_par.elasticity.bem.body import (
    Assembled,
    Compliance,
    body_zones,
    compliance,
    condense,
    contact_problem,
    solve_assembled,
)
from ringwear_par.elasticity.bem.boundary import node_wear, zone_meshes
from ringwear_par.elasticity.bem.pair import ContactPair, join_bodies
from ringwear_par.elasticity.bem.quadrature import quadrature
from ringwear_par.elasticity.bem.systems import Assembly, Moving, Zone, number_dofs
from ringwear_par.elasticity.mesh import ContactLine, Mesh, case_slopes, pair_key, pair_slope
from ringwear_par.elasticity.sections import Body, Section


def moving_parts(
    section: Section, line: ContactLine, mesh: Mesh, wears: bool = True, *, deep: bool = False
) -> tuple[Moving, ...]:
    """Return the nodes and elements of each zone that wear of the contact line moves.

    Of a body that does not wear, the elements that pressure may turn on.

    Parameters
    ----------
    deep : whether wear is so deep that interfaces give way.
    """
    unworn = zone_meshes(section, line, mesh)
    if not wears:
        elements = np.zeros(len(unworn[0].elements), dtype=bool)
        elements[unworn[0].contact] = True
        still = [Moving(*(np.zeros(len(flags), bool) for flags in zone[:2])) for zone in unworn]
        return Moving(still[0].nodes, elements), *still[1:]
    height = section.height + float(section.depth(line.edges).min())
    little = 1e-3 * min((section.height, *section.layers))
    most = 0.5 * (1.0 - 1e-6) * height  # that elements follow
    wear = np.full(line.n + 1, most if deep else little)
    parts = []
    for before, after in zip(unworn, zone_meshes(section, line, mesh, wear), strict=True):
        nodes = (before.nodes != after.nodes).any(axis=1)
        parts.append(Moving(nodes, nodes[before.elements].any(axis=1)))
    return tuple(parts)


class _MovingBody:
    """One body of which something moves: what stays, and the compliance for any wear."""

    def __init__(self, body: Body, line: ContactLine, mesh: Mesh, wears: bool) -> None:
        self._body, self._line, self._mesh, self._wears = body, line, mesh, wears
        # which values are unknown, and where they stand, does not change with the wear
        self._unworn = body_zones(body, line, mesh)
        self._dofs = number_dofs(self._unworn)
        self._rules = quadrature(mesh.quadrature_tolerance)
        self._moving = [self._parts(deep=False)]
        self._base: dict[bool, Assembly] = {}

    def _parts(self, *, deep: bool) -> tuple[Moving, ...]:
        return moving_parts(self._body.section, self._line, self._mesh, self._wears, deep=deep)

    def compliance(self, worn: FloatArray, slope: FloatArray, comm: MPI.Comm) -> Compliance:
        """Return the compliance after wear. Collective on comm.

        Parameters
        ----------
        worn : (n,) float, mm, of the line's elements.
        slope : (n,) float, that of ``boundary_conditions``.
        """
        started = time.perf_counter()
        nodes = node_wear(self._line, worn)
        problem = contact_problem(self._body, self._line, self._mesh, nodes, slope)
        deep, evaluations = self._is_deep(problem.zones), 0
        if deep and len(self._moving) == 1:
            self._moving.append(self._parts(deep=True))
        arguments = problem.zones, self._dofs, self._rules, comm, self._moving[deep]
        if deep not in self._base:
            self._base[deep] = assemble(*arguments)
            evaluations = self._base[deep].kernel_evaluations
        rows = assemble(*arguments, self._base[deep])
        rows = Assembly(rows.normal, rows.torsion, rows.kernel_evaluations + evaluations)
        assembled = Assembled(rows, problem, self._dofs, time.perf_counter() - started)
        return condense(problem, solve_assembled([assembled], comm)[0], slope)

    def _is_deep(self, zones: Sequence[Zone]) -> bool:
        """Tell whether more has moved than little wear moves: interfaces, or a whole side face."""
        for zone, before, little in zip(zones, self._unworn, self._moving[0], strict=True):
            moved = (zone.boundary.nodes != before.boundary.nodes).any(axis=1)
            if (moved & ~little.nodes).any():
                return True
        return False


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
        for i, body_slope in enumerate((slope, -slope)):
            still = self._still[i]
            if still is not None and np.array_equal(still[0], body_slope):
                compliances.append(still[1])
                continue
            moving = self._moving[i]
            if moving is not None:
                updated = moving.compliance(worn[i], body_slope, self._comm)
            else:
                updated = compliance(self._bodies[i], self._line, self._mesh, self._comm)
            if not self._wears[i]:
                self._still[i] = body_slope, updated
            compliances.append(updated)
            new.append(updated)
        key = (self._key, worn.tobytes()) if worn.any() else self._key
        return join_bodies(self._line, compliances, slope, key, new)
