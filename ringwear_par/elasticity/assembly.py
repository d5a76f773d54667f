"""Rows of the collocated, regularised boundary equation (5), on the rank that owns them.

Displacements are continuous and quadratic, tractions constant, on straight elements. The equation
is collocated where an unknown lives: at a node for its displacement, at an element's mid-point
for its traction. The traction kernel acts on u(y) - u*(y), where u* is the rigid or
constant-strain field that agrees with u at the collocation point, so every integrand is bounded.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.compiling import compiled, load_compiled
from ringwear_par.elasticity.kernels import ring_kernels
from ringwear_par.elasticity.mesh import BoundaryMesh, Mesh, boundary_mesh, contact_line
from ringwear_par.elasticity.quadrature import MAX_POINTS, Quadrature, quadrature
from ringwear_par.elasticity.sections import Section

_MAX_PARTS = 128
# the integrals of a source and an element, rr, rz, zr, zz, theta theta: force and component
_FORCE = np.array([0, 0, 1, 1, 2])
_COMPONENT = np.array([0, 1, 0, 1, 2])


class BoundaryConditions(NamedTuple):
    """Boundary conditions of every element, for the components r, z and theta.

    A named tuple because compiled code reads it, like ``DofMap``.

    Parameters
    ----------
    fixed : (k, 3) bool, displacement zero on the element, traction unknown.
    load : (k, 3) int, right-hand side that holds the element's known traction, -1 for none.
    traction : (k, 3) float, MPa, that known traction.
    n_loads : number of right-hand sides.
    """

    fixed: BoolArray
    load: IntArray
    traction: FloatArray
    n_loads: int


class DofMap(NamedTuple):
    """Where each unknown stands, (r, z) and theta being two systems, -1 for none.

    Parameters
    ----------
    equation : (m, 3) int, row collocated at the node in that direction.
    displacement : (m, 3) int, column of the nodal displacement.
    traction : (k, 3) int, column of the element's traction.
    """

    equation: IntArray
    displacement: IntArray
    traction: IntArray


class Moving(NamedTuple):
    """What moves when the geometry changes.

    The integrals of a source over an element stay as they are where neither of them moves.

    Parameters
    ----------
    nodes : (m,) bool.
    elements : (k,) bool, those with a node that moves.
    """

    nodes: BoolArray
    elements: BoolArray


@dataclass(frozen=True)
class Rows:
    """Rows of one system owned by this rank: ``matrix @ unknowns = loads``.

    Parameters
    ----------
    matrix : (local, n) float, column-major.
    loads : (local, n_loads) float, column-major.
    start : number of the first row.
    """

    matrix: FloatArray
    loads: FloatArray
    start: int


@dataclass(frozen=True)
class Assembly:
    """The two systems of a body and the work that they took on this rank."""

    normal: Rows
    torsion: Rows
    kernel_evaluations: int


def number_dofs(boundary: BoundaryMesh, conditions: BoundaryConditions) -> DofMap:
    """Return the numbering of the unknowns. Not collective."""
    elements, fixed = boundary.elements, conditions.fixed
    known = np.zeros((len(boundary.nodes), 3), dtype=bool)
    for local in range(3):
        known[elements[:, local]] |= fixed
    on_axis = boundary.nodes[:, 0] == 0.0
    known[np.ix_(on_axis, [0, 2])] = True
    collocated = ~known
    collocated[elements[:, 1]] |= fixed
    equation = np.full(collocated.shape, -1)
    for block in (slice(0, 2), slice(2, 3)):
        rows = np.cumsum(collocated[:, block]).reshape(-1, block.stop - block.start) - 1
        equation[:, block] = np.where(collocated[:, block], rows, -1)
    displacement = np.where(known, -1, equation)
    traction = np.where(fixed, equation[elements[:, 1]], -1)
    return DofMap(equation, displacement, traction)


@compiled
def _integrate(
    nodes: FloatArray,
    p: int,
    first: int,
    last: int,
    at: int,
    poisson: float,
    rules: Quadrature,
    h: FloatArray,
    g: FloatArray,
    own: FloatArray,
    work: FloatArray,
) -> int:
    """Integrate the kernels of source node p over the element from node first to node last.

    Parameters
    ----------
    at : local node 0, 1, 2 where p lies on the element, -1 elsewhere.
    h : (5, 3), set to the integrals of T times shape function (that of node ``at`` left out), by
        local node; rows rr, rz, zr, zz, theta theta, force direction first.
    g : (5,), set to the integrals of U.
    own : (5,), added to: the coefficients of the displacement at p itself.
    work : (3, _MAX_PARTS), scratch.

    Returns
    -------
    Number of kernel evaluations.
    """
    xr = nodes[p, 0]
    inv_r = 1.0 / xr if xr > 0.0 else 0.0  # on the axis u_r = u_theta = 0: nothing to subtract
    ar, az = nodes[first, 0] - xr, nodes[first, 1] - nodes[p, 1]
    dr, dz = nodes[last, 0] - nodes[first, 0], nodes[last, 1] - nodes[first, 1]
    length = math.hypot(dr, dz)
    nr, nz = dz / length, -dr / length
    shear = 0.5 / (1.0 + poisson)
    lame = poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    star_r = 2.0 * (lame + shear) * nr * inv_r  # traction of u* = (r1/r) e_r
    star_z = 2.0 * lame * nz * inv_r
    h[:] = 0.0
    g[:] = 0.0
    shape, part_from, part_to = work[0], work[1], work[2]
    parts = 0
    if at < 0:
        part_from[0], part_to[0] = 0.0, 1.0
        parts = 1
    if at == 0 or at == 1:
        part_from[parts], part_to[parts] = 0.5 * at, 1.0
        parts += 1
    if at == 1 or at == 2:
        part_from[parts], part_to[parts] = 0.5 * at, 0.0
        parts += 1
    evaluations = 0
    while parts > 0:
        parts -= 1
        t0, t1 = part_from[parts], part_to[parts]
        span = t1 - t0
        singular = at >= 0 and t0 == 0.5 * at
        if singular:
            reach = xr / length  # near the axis the kernels change over the radius, not the element
            if xr > 0.0 and abs(span) > 1.5 * reach and parts + 2 <= _MAX_PARTS:
                middle = t0 + math.copysign(reach, span)
                part_from[parts], part_to[parts] = t0, middle
                part_from[parts + 1], part_to[parts + 1] = middle, t1
                parts += 2
                continue
            n = len(rules.singular_points)
        else:
            d0 = math.hypot(ar + t0 * dr, az + t0 * dz)
            d1 = math.hypot(ar + t1 * dr, az + t1 * dz)
            ratio = (d0 + d1) / (length * abs(span))
            if ratio < rules.reach[MAX_POINTS] and parts + 2 <= _MAX_PARTS:
                middle = 0.5 * (t0 + t1)
                part_from[parts], part_to[parts] = t0, middle
                part_from[parts + 1], part_to[parts + 1] = middle, t1
                parts += 2
                continue
            n = 1
            while n < MAX_POINTS and rules.reach[n] > ratio:
                n += 1
        evaluations += n
        for q in range(n):
            # offsets from the source, without cancellation on its own element
            if singular:
                dt = span * rules.singular_points[q]
                w = rules.singular_weights[q] * abs(span) * length
            else:
                dt = t0 + span * rules.points[n, q] - 0.5 * max(at, 0)
                w = rules.weights[n, q] * abs(span) * length
            if at >= 0:
                t = 0.5 * at + dt
                a, b = dt * dr, dt * dz
            else:
                t = dt
                a, b = ar + t * dr, az + t * dz
            u_rr, u_rz, u_zr, u_zz, t_rr, t_rz, t_zr, t_zz, u_tt, t_tt = ring_kernels(
                xr, a, b, nr, nz, poisson
            )
            shape[0] = (1.0 - t) * (1.0 - 2.0 * t)
            shape[1] = 4.0 * t * (1.0 - t)
            shape[2] = t * (2.0 * t - 1.0)
            if at < 0:
                fz, fr = -1.0, -(xr + a) * inv_r
            else:  # shape function minus 1, and minus r1/r
                if at == 0:
                    fz = dt * (2.0 * dt - 3.0)
                elif at == 1:
                    fz = -4.0 * dt * dt
                else:
                    fz = dt * (2.0 * dt + 3.0)
                fr = fz - a * inv_r
                shape[at] = 0.0
            for c in range(3):
                s = w * shape[c]
                h[0, c] += t_rr * s
                h[1, c] += t_rz * s
                h[2, c] += t_zr * s
                h[3, c] += t_zz * s
                h[4, c] += t_tt * s
            g[0] += w * u_rr
            g[1] += w * u_rz
            g[2] += w * u_zr
            g[3] += w * u_zz
            g[4] += w * u_tt
            own[0] += w * (t_rr * fr + u_rr * star_r + u_rz * star_z)
            own[1] += w * t_rz * fz
            own[2] += w * (t_zr * fr + u_zr * star_r + u_zz * star_z)
            own[3] += w * t_zz * fz
            own[4] += w * t_tt * fr
    return evaluations


@compiled
def _assemble_rows(
    first_node: int,
    last_node: int,
    boundary: BoundaryMesh,
    conditions: BoundaryConditions,
    dofs: DofMap,
    moving: Moving,
    moved: bool,
    poisson: float,
    rules: Quadrature,
    starts: IntArray,
    matrices: tuple[FloatArray, FloatArray],
    loads: tuple[FloatArray, FloatArray],
) -> int:
    """Add to the rows collocated at nodes first_node <= p < last_node; return kernel evaluations.

    The integrals added are those that move with the geometry, or those that do not.
    """
    elements, load = boundary.elements, conditions.load
    displacement, traction = dofs.displacement, dofs.traction
    h, g, own = np.empty((5, 3)), np.empty(5), np.empty(5)
    work = np.empty((3, _MAX_PARTS))
    # a node's rows are gathered here, side by side, and copied once into the column-major matrices
    lines = np.empty((3, max(matrices[0].shape[1], matrices[1].shape[1])))
    rights = np.empty((3, loads[0].shape[1]))
    evaluations = 0
    for p in range(first_node, last_node):
        if moving.nodes[p] and not moved:
            continue
        own[:] = 0.0
        lines[:] = 0.0
        rights[:] = 0.0
        for e in range(len(elements)):
            if (moving.nodes[p] or moving.elements[e]) != moved:
                continue
            at = -1
            for c in range(3):
                if elements[e, c] == p:
                    at = c
            evaluations += _integrate(
                boundary.nodes, p, elements[e, 0], elements[e, 2], at, poisson, rules,
                h, g, own, work,
            )  # fmt: skip
            for pair in range(5):
                k, i = _FORCE[pair], _COMPONENT[pair]
                for c in range(3):
                    column = displacement[elements[e, c], i]
                    if column >= 0:
                        lines[k, column] += h[pair, c]
                if traction[e, i] >= 0:
                    lines[k, traction[e, i]] -= g[pair]
                if load[e, i] >= 0:
                    rights[k, load[e, i]] += g[pair] * conditions.traction[e, i]
        for pair in range(5):
            column = displacement[p, _COMPONENT[pair]]
            if column >= 0:
                lines[_FORCE[pair], column] += own[pair]
        for k in range(3):
            if dofs.equation[p, k] >= 0:
                system = 0 if k < 2 else 1
                row = dofs.equation[p, k] - starts[system]
                matrix, right = matrices[system], loads[system]
                for column in range(matrix.shape[1]):
                    matrix[row, column] += lines[k, column]
                for column in range(right.shape[1]):
                    right[row, column] += rights[k, column]
    return evaluations


def load_kernels(comm: MPI.Comm) -> None:
    """Compile the kernels, or load them from the cache of an earlier run. Collective on comm.

    See ``load_compiled``.
    """

    def load() -> None:
        mesh = Mesh(4)
        boundary = boundary_mesh(Section((1.0, 2.0), 1.0), contact_line((1.0, 2.0), mesh), mesh)
        k = len(boundary.elements)
        nothing = BoundaryConditions(
            np.zeros((k, 3), bool), np.full((k, 3), -1), np.zeros((k, 3)), 0
        )
        still = Moving(np.zeros(len(boundary.nodes), bool), np.zeros(k, bool))
        unused = np.zeros((2, 2), order="F")  # an empty one would be row-major too
        _assemble_rows(
            0, 0, boundary, nothing, number_dofs(boundary, nothing), still, False, 0.0,
            quadrature(0.1),
            np.zeros(2, dtype=np.int64), (unused, unused), (unused, unused),
        )  # fmt: skip

    load_compiled(comm, load)


def assemble(
    boundary: BoundaryMesh,
    conditions: BoundaryConditions,
    dofs: DofMap,
    poisson: float,
    rules: Quadrature,
    comm: MPI.Comm,
    moving: Moving | None = None,
    base: Assembly | None = None,
) -> Assembly:
    """Assemble this rank's rows of both systems at Young's modulus 1.

    Collective on comm. Nodes are shared out in equal runs, so a rank holds about
    1/size of the rows and no rank holds a whole matrix.

    Parameters
    ----------
    moving : what moves, if only a part is to be assembled: what stays, or with ``base`` what moves.
    base : the part that stays, to a copy of which the other is added.
    """
    n_nodes = len(boundary.nodes)
    moved = base is not None or moving is None
    if moving is None:
        moving = Moving(np.ones(n_nodes, bool), np.ones(len(boundary.elements), bool))
    share = [rank * n_nodes // comm.size for rank in range(comm.size + 1)]
    mine = slice(share[comm.rank], share[comm.rank + 1])
    starts = np.zeros(2, dtype=np.int64)
    matrices: list[FloatArray] = []
    loads: list[FloatArray] = []
    for system, block in enumerate((slice(0, 2), slice(2, 3))):
        collocated = dofs.equation[:, block] >= 0
        starts[system] = np.count_nonzero(collocated[: mine.start])
        if base is not None:
            before = base.normal if system == 0 else base.torsion
            matrices.append(before.matrix.copy(order="F"))
            loads.append(before.loads.copy(order="F"))
            continue
        rows = np.count_nonzero(collocated[mine])
        matrices.append(np.zeros((rows, np.count_nonzero(collocated)), order="F"))
        loads.append(np.zeros((rows, conditions.n_loads), order="F"))

    evaluations = _assemble_rows(
        mine.start, mine.stop, boundary, conditions, dofs, moving, moved, poisson, rules, starts,
        (matrices[0], matrices[1]), (loads[0], loads[1]),
    )  # fmt: skip
    normal, torsion = (Rows(matrices[i], loads[i], int(starts[i])) for i in (0, 1))
    return Assembly(normal, torsion, evaluations)
