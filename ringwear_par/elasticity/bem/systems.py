"""Unknowns, boundary conditions and rows of the boundary equation (5) of a body.

Displacements are continuous and quadratic, tractions constant, on straight elements. The equation
is collocated where an unknown lives: at a node for its displacement, at an element's mid-point
for its traction. The traction kernel acts on u(y) - u*(y), where u* is the rigid or constant-strain
field that agrees with u at the collocation point, so every integrand is bounded.

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
from ringwear_par.elasticity._rings import integrate_rows
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.bem.quadrature import Quadrature
from ringwear_par.elasticity.sections import Material

#: components of the (r, z) and of the theta system
SYSTEMS = slice(0, 2), slice(2, 3)
#: component at the source and direction on the element of each pair of kernels
_COMPONENT, _DIRECTION = np.array([0, 1, 0, 1, 2]), np.array([0, 0, 1, 1, 2])


class BoundaryConditions(NamedTuple):
    """Boundary conditions of every element, for the components r, z and theta."""

    #: (k, 3) bool, displacement zero on the element, traction unknown
    fixed: BoolArray
    #: (k, 3) int, right-hand side that holds the element's known traction, -1 for none
    load: IntArray
    #: (k, 3) float, MPa, that known traction
    traction: FloatArray
    #: number of right-hand sides
    n_loads: int


class DofMap(NamedTuple):
    """Where each unknown of a zone stands, (r, z) and theta being two systems, -1 for none."""

    #: (m, 3) int, row collocated at the node in that direction
    equation: IntArray
    #: (m, 3) int, column of the nodal displacement
    displacement: IntArray
    #: (k, 3) int, column of the element's traction
    traction: IntArray
    #: (k,) float, -1 on elements whose traction is the opposite of the unknown, else 1
    sign: FloatArray


@dataclass(frozen=True)
class Zone:
    """A zone of a body, with all that its rows need."""

    #: its boundary elements
    boundary: BoundaryMesh
    #: displacements and tractions known there
    conditions: BoundaryConditions
    #: its elasticity, the modulus over that of the body itself
    material: Material


@dataclass(frozen=True)
class Rows:
    """Rows of one system owned by this rank: ``matrix @ unknowns = loads``."""

    #: (local, n) float, column-major, as PETSc's dense matrices are
    matrix: FloatArray
    #: (local, n_loads) float, column-major
    loads: FloatArray
    #: numbers of the first rows of the body's zones
    zones: tuple[int, ...] = (0,)


def number_dofs(zones: Sequence[Zone]) -> list[DofMap]:
    """Return the numbering of the unknowns of zones, each bonded to the next. Not collective."""
    prescribed, collocated = [], []
    for zone in zones:
        boundary, elements, fixed = zone.boundary, zone.boundary.elements, zone.conditions.fixed
        prescribed_dofs = np.zeros((len(boundary.nodes), 3), dtype=bool)
        for local in range(3):
            prescribed_dofs[elements[:, local]] |= fixed
        prescribed_dofs[np.ix_(boundary.nodes[:, 0] == 0.0, [0, 2])] = True
        rows = ~prescribed_dofs
        rows[elements[:, 1]] |= fixed
        prescribed.append(prescribed_dofs)
        collocated.append(rows)
    pairs = list(itertools.pairwise(range(len(zones))))
    # of each interface the stiffer zone, which is collocated at the ends of elements too
    stiffer = [max(pair, key=lambda i: (zones[i].material.young, -i)) for pair in pairs]
    for (outer, inner), stiff in zip(pairs, stiffer, strict=True):
        softer, name = (inner, "above") if stiff == outer else (outer, "below")
        interface_nodes = zones[softer].boundary.elements[getattr(zones[softer].boundary, name)]
        collocated[softer][np.setdiff1d(interface_nodes, interface_nodes[:, 1])] = False
    first = np.cumsum([0, *(len(rows) for rows in collocated)])
    numbers = np.split(_numbers(np.concatenate(collocated)), first[1:-1])
    dofs = [
        DofMap(
            equation, np.where(prescribed_dofs, -1, equation),
            np.where(zone.conditions.fixed, equation[zone.boundary.elements[:, 1]], -1),
            np.ones(len(zone.boundary.elements)),
        )
        for zone, prescribed_dofs, equation in zip(zones, prescribed, numbers, strict=True)
    ]  # fmt: skip
    for (outer, inner), stiff in zip(pairs, stiffer, strict=True):
        outer_mesh, inner_mesh = zones[outer].boundary, zones[inner].boundary
        nodes = outer_mesh.elements[outer_mesh.below, ::-1]  # the other way round
        bonded = inner_mesh.elements[inner_mesh.above]
        if stiff == outer:
            dofs[inner].displacement[bonded] = dofs[outer].displacement[nodes]
            traction = dofs[inner].equation[bonded[:, 1]]
        else:
            dofs[outer].displacement[nodes] = dofs[inner].displacement[bonded]
            traction = dofs[outer].equation[nodes[:, 1]]
        dofs[inner].traction[inner_mesh.above] = dofs[outer].traction[outer_mesh.below] = traction
        dofs[outer].sign[outer_mesh.below] = -1.0
    return dofs


def _numbers(collocated: BoolArray) -> IntArray:
    """Return the number of each equation in its system, (m, 3), -1 for none."""
    numbers = np.full(collocated.shape, -1)
    for block in SYSTEMS:
        rows = np.cumsum(collocated[:, block]).reshape(-1, block.stop - block.start) - 1
        numbers[:, block] = np.where(collocated[:, block], rows, -1)
    return numbers


def assemble(
    zones: Sequence[Zone], dofs: Sequence[DofMap], rules: Quadrature, comm: MPI.Comm
) -> tuple[Rows, Rows]:
    """Return this rank's rows of the (r, z) and of the theta system.

    Not collective. Nodes of all zones are shared out in equal runs, so a rank holds about 1/size of
    the rows.

    Parameters
    ----------
    dofs : of ``number_dofs``, one a zone.

    Raises
    ------
    ComputationError : a node too close to an element that it does not belong to.
    """
    first = np.cumsum([0, *(len(zone.boundary.nodes) for zone in zones)])
    begin, end = (rank * int(first[-1]) // comm.size for rank in (comm.rank, comm.rank + 1))
    # number of the first row of each node in the (r, z) and in the theta system
    equations = np.concatenate([zone.equation for zone in dofs])
    counts = np.stack([(equations[:, block] >= 0).sum(axis=1) for block in SYSTEMS])
    row = np.concatenate([np.zeros((2, 1), dtype=np.int64), np.cumsum(counts, axis=1)], axis=1)
    heights, widths, n_loads = row[:, end] - row[:, begin], row[:, -1], zones[0].conditions.n_loads
    # both systems in one array, column by column, the loads behind the last unknown
    sizes = heights * (widths + n_loads)
    entries = np.zeros(sizes.sum())
    # of the components: where their system starts, its rows before those of this rank, its shape
    systems = np.stack([[0, sizes[0]], row[:, begin], heights, widths])[:, [0, 0, 1]]
    for zone, numbers, start in zip(zones, dofs, first[:-1].tolist(), strict=True):
        nodes = np.arange(max(begin - start, 0), min(end - start, len(zone.boundary.nodes)))
        _add_rows(zone, numbers, rules, nodes, systems, entries)
    normal, torsion = (
        Rows(columns[:, :width], columns[:, width:], tuple(zone_starts.tolist()))
        for width, zone_starts, columns in (
            (width, starts, part.reshape((height, width + n_loads), order="F"))
            for width, height, starts, part in zip(
                widths, heights, row[:, first[:-1]], np.split(entries, sizes[:1]), strict=True
            )
        )
    )
    return normal, torsion


def _add_rows(
    zone: Zone, dofs: DofMap, rules: Quadrature, nodes: IntArray, systems: IntArray,
    entries: FloatArray,
) -> None:  # fmt: skip
    """Add the rows collocated at some nodes of a zone."""
    boundary, (_, load, traction, _) = zone.boundary, zone.conditions
    starts, before, heights, widths = systems
    rows = np.where(dofs.equation[nodes] >= 0, dofs.equation[nodes] - before, -1)
    collocated = (rows >= 0).any(axis=1)
    nodes, rows = nodes[collocated], rows[collocated].T.copy()
    # where displacements of an element's nodes are multiplied, and its traction, unknown or given
    unknown = dofs.traction >= 0
    of_traction = np.where(unknown, dofs.traction, np.where(load >= 0, widths + load, -1))
    numbers = np.stack([*dofs.displacement[boundary.elements.T], of_traction], axis=2)
    columns = np.where(numbers >= 0, starts[:, None] + heights[:, None] * numbers, -1)
    factors = np.ones(columns.shape)
    factors[:, :, 3] = np.where(unknown, -dofs.sign[:, None], traction) / zone.material.young
    sources = np.ascontiguousarray(boundary.nodes[nodes][:, [0, 1, 1]])
    own = integrate_rows(
        sources, nodes, boundary, zone.material.poisson, rules, columns, factors, rows, entries,
    )  # fmt: skip
    # on the axis u_r = u_theta = 0, elsewhere the field that is subtracted goes with u over r
    radius = sources[:, 0]
    own[_DIRECTION != 1] *= np.divide(1.0, radius, where=radius > 0.0, out=np.zeros(len(nodes)))
    row, column = rows[_COMPONENT], dofs.displacement[nodes].T[_DIRECTION]
    at = (row >= 0) & (column >= 0)
    place = starts[_DIRECTION, None] + heights[_DIRECTION, None] * column + row
    entries[place[at]] += own[at]
