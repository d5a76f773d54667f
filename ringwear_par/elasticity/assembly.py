"""Rows of the collocated, regularised boundary equation (5), on the rank that owns them.

Displacements are continuous and quadratic, tractions constant, on straight elements. The equation
is collocated where an unknown lives: at a node for its displacement, at an element's mid-point
for its traction. The traction kernel acts on u(y) - u*(y), where u* is the rigid or
constant-strain field that agrees with u at the collocation point, so every integrand is bounded.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.mesh import BoundaryMesh, Mesh, boundary_mesh, contact_line
from ringwear_par.elasticity.quadrature import Quadrature, quadrature
from ringwear_par.elasticity.sections import Section


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
    matrix : (local, n) float, row-major.
    loads : (local, n_loads) float, row-major.
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


def load_kernels(comm: MPI.Comm) -> None:
    """Compile the kernels, or load them from the cache of an earlier run. Collective on comm.

    See ``load_compiled``.
    """
    from ringwear_par.elasticity.compiling import load_compiled  # numba: not for a known shape

    mesh = Mesh(4)
    boundary = boundary_mesh(Section((1.0, 2.0), 1.0), contact_line((1.0, 2.0), mesh), mesh)
    k = len(boundary.elements)
    free = BoundaryConditions(np.zeros((k, 3), bool), np.full((k, 3), -1), np.zeros((k, 3)), 0)
    dofs = number_dofs(boundary, free)

    def load() -> None:
        assemble(boundary, free, dofs, 0.0, quadrature(0.1), MPI.COMM_SELF)

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
            matrices.append(before.matrix.copy())
            loads.append(before.loads.copy())
            continue
        rows = np.count_nonzero(collocated[mine])
        matrices.append(np.zeros((rows, np.count_nonzero(collocated))))
        loads.append(np.zeros((rows, conditions.n_loads)))

    from ringwear_par.elasticity.rows import assemble_rows

    evaluations = assemble_rows(
        mine.start, mine.stop, boundary, conditions, dofs, moving, moved, poisson, rules, starts,
        (matrices[0], matrices[1]), (loads[0], loads[1]),
    )  # fmt: skip
    normal, torsion = (Rows(matrices[i], loads[i], int(starts[i])) for i in (0, 1))
    return Assembly(normal, torsion, evaluations)
