"""Assembly of the boundary equation (5) of a body, on the rank that owns its rows.

The traction kernel acts on u(y) - u*(y), where u* is the rigid or constant-strain field that agrees
with u at the collocation point, so every integrand is bounded.
"""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity.bem.boundary import BoundaryMesh, boundary_mesh
from ringwear_par.elasticity.bem.quadrature import Quadrature, quadrature
from ringwear_par.elasticity.bem.systems import (
    SYSTEMS,
    Assembly,
    BoundaryConditions,
    DofMap,
    Moving,
    Rows,
    Zone,
    number_dofs,
)
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Material, Section
from ringwear_par.errors import ComputationError
from ringwear_par.parallel import together

#: why integrals over boundary elements are refused
TOO_CLOSE = (
    "boundary elements lie too close to each other, or are too long for it, to be integrated over: "
    "thicker layers or bodies, or a milder mesh.grading, are needed"
)
#: nodes whose rows are written row by row, before they are copied to column-major matrices
_NODES_AT_ONCE = 64


def load_kernels(comm: MPI.Comm) -> None:
    """Compile the kernels, or load them from the cache of an earlier run. Collective on comm.

    See ``load_compiled``.
    """
    from ringwear_par.elasticity.bem.compiling import load_compiled  # numba: not for a known shape

    mesh = Mesh(4)
    boundary = boundary_mesh(Section((1.0, 2.0), 1.0), contact_line((1.0, 2.0), mesh), mesh)
    k = len(boundary.elements)
    free = BoundaryConditions(np.zeros((k, 3), bool), np.full((k, 3), -1), np.zeros((k, 3)), 0)
    zones = [Zone(boundary, free, Material(1.0, 0.0))]
    dofs = number_dofs(zones)

    def load() -> None:
        assemble(zones, dofs, quadrature(0.1), MPI.COMM_SELF)

    load_compiled(comm, load)


def assemble(
    zones: Sequence[Zone],
    dofs: Sequence[DofMap],
    rules: Quadrature,
    comm: MPI.Comm,
    moving: Sequence[Moving] = (),
    base: Assembly | None = None,
) -> Assembly:
    """Assemble this rank's rows of both systems at modulus 1 of the body itself.

    Collective on comm. Nodes of all zones are shared out in equal runs, so a rank holds about
    1/size of the rows and no rank holds a whole matrix.

    Parameters
    ----------
    dofs : of ``number_dofs``, one a zone.
    moving : what moves of each zone, if only a part is to be assembled: what stays, or with
        ``base`` what moves.
    base : the part that stays, to a copy of which the other is added.

    Raises
    ------
    ComputationError : a node too close to an element that it does not belong to.
    """
    from ringwear_par.elasticity.bem.rows import MAX_PARTS, assemble_rows

    moved = base is not None or not moving
    moving = moving or [_all_moving(zone.boundary) for zone in zones]
    first = np.cumsum([0, *(len(zone.boundary.nodes) for zone in zones)])
    begin, end = (rank * int(first[-1]) // comm.size for rank in (comm.rank, comm.rank + 1))
    # number of the first row of each node in the (r, z) and in the theta system
    equations = np.concatenate([zone.equation for zone in dofs])
    counts = np.stack([(equations[:, block] >= 0).sum(axis=1) for block in SYSTEMS])
    row = np.concatenate([np.zeros((2, 1), dtype=np.int64), np.cumsum(counts, axis=1)], axis=1)
    widths = row[0, -1], row[1, -1], zones[0].conditions.n_loads

    def shapes(first: int, last: int) -> list[tuple[int, int]]:
        heights = row[:, last] - row[:, first]
        return [(heights[i % 2], widths[min(i, 2)]) for i in range(4)]

    if base is None:
        arrays = tuple(np.empty(shape, order="F") for shape in shapes(begin, end))
    else:
        stored = base.normal.matrix, base.torsion.matrix, base.normal.loads, base.torsion.loads
        arrays = tuple(array.copy(order="F") for array in stored)
    evaluations = 0
    for zone, numbers, parts, start, stop in zip(
        zones, dofs, moving, first[:-1].tolist(), first[1:].tolist(), strict=True
    ):
        with together(comm):
            for node in range(max(begin, start), min(end, stop), _NODES_AT_ONCE):
                nodes = node, min(node + _NODES_AT_ONCE, end, stop)
                added = tuple(np.zeros(shape) for shape in shapes(*nodes))
                done = assemble_rows(
                    nodes[0] - start, nodes[1] - start, zone.boundary, zone.conditions, numbers,
                    parts, moved, zone.material.young, zone.material.poisson, rules, row[:, node],
                    added[:2], added[2:], MAX_PARTS,
                )  # fmt: skip
                if done < 0:
                    raise ComputationError(TOO_CLOSE)
                evaluations += done
                for i, (array, block) in enumerate(zip(arrays, added, strict=True)):
                    from_row = row[i % 2, node] - row[i % 2, begin]
                    rows = array[from_row : from_row + len(block)]
                    if base is None:
                        rows[:] = block
                    else:
                        rows += block
    normal, torsion = (
        Rows(arrays[i], arrays[i + 2], int(row[i, begin]), tuple(row[i, first[:-1]].tolist()))
        for i in range(2)
    )
    return Assembly(normal, torsion, evaluations)


def _all_moving(boundary: BoundaryMesh) -> Moving:
    return Moving(np.ones(len(boundary.nodes), bool), np.ones(len(boundary.elements), bool))
