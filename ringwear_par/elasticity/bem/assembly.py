"""Rows of the collocated, regularised boundary equation (5), on the rank that owns them.

Displacements are continuous and quadratic, tractions constant, on straight elements. The equation
is collocated where an unknown lives: at a node for its displacement, at an element's mid-point
for its traction. The traction kernel acts on u(y) - u*(y), where u* is the rigid or
constant-strain field that agrees with u at the collocation point, so every integrand is bounded.

Bonded zones share the displacements of an interface's nodes and the tractions of its elements,
opposite on both sides. The stiffer zone is collocated at all nodes there, the other at the
mid-points, so that there are as many equations as unknowns, and displacements are as smooth as the
stiffer zone wants them. Tractions are scaled with the modulus of the body itself, the zone at the
fixed face.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh, boundary_mesh
from ringwear_par.elasticity.bem.quadrature import Quadrature, quadrature
from ringwear_par.elasticity.geometry.mesh import Mesh, contact_line
from ringwear_par.elasticity.geometry.sections import Material, Section
from ringwear_par.errors import ComputationError
from ringwear_par.parallel import together

#: components of the (r, z) and of the theta system
_SYSTEMS = slice(0, 2), slice(2, 3)
#: why integrals over boundary elements are refused
TOO_CLOSE = (
    "boundary elements lie too close to each other, or are too long for it, to be integrated over: "
    "thicker layers or bodies, or a milder mesh.grading, are needed"
)


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
    """Where each unknown of a zone stands, (r, z) and theta being two systems, -1 for none.

    Parameters
    ----------
    equation : (m, 3) int, row collocated at the node in that direction.
    displacement : (m, 3) int, column of the nodal displacement.
    traction : (k, 3) int, column of the element's traction.
    sign : (k,) float, -1 on elements whose traction is the opposite of the unknown, else 1.
    """

    equation: IntArray
    displacement: IntArray
    traction: IntArray
    sign: FloatArray


@dataclass(frozen=True)
class Zone:
    """A zone of a body, with all that its rows need.

    Parameters
    ----------
    boundary : its boundary elements.
    conditions : displacements and tractions known there.
    material : its elasticity, the modulus over that of the body itself.
    """

    boundary: BoundaryMesh
    conditions: BoundaryConditions
    material: Material


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
    zones : numbers of the first rows of the body's zones.
    """

    matrix: FloatArray
    loads: FloatArray
    start: int
    zones: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Assembly:
    """The two systems of a body and the work that they took on this rank."""

    normal: Rows
    torsion: Rows
    kernel_evaluations: int


def number_dofs(zones: Sequence[Zone]) -> list[DofMap]:
    """Return the numbering of the unknowns of zones, each bonded to the next. Not collective."""
    known, collocated = [], []
    for zone in zones:
        boundary, elements, fixed = zone.boundary, zone.boundary.elements, zone.conditions.fixed
        of_zone = np.zeros((len(boundary.nodes), 3), dtype=bool)
        for local in range(3):
            of_zone[elements[:, local]] |= fixed
        of_zone[np.ix_(boundary.nodes[:, 0] == 0.0, [0, 2])] = True
        rows = ~of_zone
        rows[elements[:, 1]] |= fixed
        known.append(of_zone)
        collocated.append(rows)
    pairs = list(itertools.pairwise(range(len(zones))))
    # of each interface the stiffer zone, which is collocated at the ends of elements too
    stiffer = [max(pair, key=lambda i: (zones[i].material.young, -i)) for pair in pairs]
    for (outer, inner), stiff in zip(pairs, stiffer, strict=True):
        softer, name = (inner, "above") if stiff == outer else (outer, "below")
        of_interface = zones[softer].boundary.elements[getattr(zones[softer].boundary, name)]
        collocated[softer][np.setdiff1d(of_interface, of_interface[:, 1])] = False
    first = np.cumsum([0, *(len(rows) for rows in collocated)])
    numbers = np.split(_numbers(np.concatenate(collocated)), first[1:-1])
    dofs = [
        DofMap(
            equation, np.where(of_zone, -1, equation),
            np.where(zone.conditions.fixed, equation[zone.boundary.elements[:, 1]], -1),
            np.ones(len(zone.boundary.elements)),
        )
        for zone, of_zone, equation in zip(zones, known, numbers, strict=True)
    ]  # fmt: skip
    for (outer, inner), stiff in zip(pairs, stiffer, strict=True):
        of_outer, of_inner = zones[outer].boundary, zones[inner].boundary
        nodes = of_outer.elements[of_outer.below, ::-1]  # the other way round
        bonded = of_inner.elements[of_inner.above]
        if stiff == outer:
            dofs[inner].displacement[bonded] = dofs[outer].displacement[nodes]
            traction = dofs[inner].equation[bonded[:, 1]]
        else:
            dofs[outer].displacement[nodes] = dofs[inner].displacement[bonded]
            traction = dofs[outer].equation[nodes[:, 1]]
        dofs[inner].traction[of_inner.above] = dofs[outer].traction[of_outer.below] = traction
        dofs[outer].sign[of_outer.below] = -1.0
    return dofs


def _numbers(collocated: BoolArray) -> IntArray:
    """Return the number of each equation in its system, (m, 3), -1 for none."""
    numbers = np.full(collocated.shape, -1)
    for block in _SYSTEMS:
        rows = np.cumsum(collocated[:, block]).reshape(-1, block.stop - block.start) - 1
        numbers[:, block] = np.where(collocated[:, block], rows, -1)
    return numbers


def load_kernels(comm: MPI.Comm) -> None:
    """Compile the kernels, or load them from the cache of an earlier run. Collective on comm.

    See ``load_compiled``.
    """
    from ringwear_par.elasticity.compiling import load_compiled  # numba: not for a known shape

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
    moved = base is not None or not moving
    moving = moving or [_all_moving(zone.boundary) for zone in zones]
    first = np.cumsum([0, *(len(zone.boundary.nodes) for zone in zones)])
    begin, end = (rank * int(first[-1]) // comm.size for rank in (comm.rank, comm.rank + 1))
    starts = np.zeros(2, dtype=np.int64)
    matrices: list[FloatArray] = []
    loads: list[FloatArray] = []
    equations = np.concatenate([of.equation for of in dofs])
    for system, block in enumerate(_SYSTEMS):
        collocated = equations[:, block] >= 0
        starts[system] = np.count_nonzero(collocated[:begin])
        if base is not None:
            before = base.normal if system == 0 else base.torsion
            matrices.append(before.matrix.copy())
            loads.append(before.loads.copy())
            continue
        rows = np.count_nonzero(collocated[begin:end])
        matrices.append(np.zeros((rows, np.count_nonzero(collocated))))
        loads.append(np.zeros((rows, zones[0].conditions.n_loads)))

    from ringwear_par.elasticity.bem.rows import MAX_PARTS, assemble_rows

    evaluations = 0
    for zone, own, parts, start, stop in zip(
        zones, dofs, moving, first[:-1], first[1:], strict=True
    ):
        low, high = (int(np.clip(node, start, stop)) - int(start) for node in (begin, end))
        with together(comm):
            added = assemble_rows(
                low, high, zone.boundary, zone.conditions, own, parts, moved,
                zone.material.young, zone.material.poisson, rules, starts,
                (matrices[0], matrices[1]), (loads[0], loads[1]), MAX_PARTS,
            )  # fmt: skip
            if added < 0:
                raise ComputationError(TOO_CLOSE)
        evaluations += added
    of_zones = [
        tuple(np.count_nonzero(equations[:node, block] >= 0) for node in first[:-1])
        for block in _SYSTEMS
    ]
    normal, torsion = (
        Rows(*parts) for parts in zip(matrices, loads, starts.tolist(), of_zones, strict=True)
    )
    return Assembly(normal, torsion, evaluations)


def _all_moving(boundary: BoundaryMesh) -> Moving:
    return Moving(np.ones(len(boundary.nodes), bool), np.ones(len(boundary.elements), bool))
