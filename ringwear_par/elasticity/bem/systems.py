"""Unknowns, boundary conditions and rows of the boundary equation (5) of a body.

Displacements are continuous and quadratic, tractions constant, on straight elements. The equation
is collocated where an unknown lives: at a node for its displacement, at an element's mid-point
for its traction.

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

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.sections import Material

#: components of the (r, z) and of the theta system
SYSTEMS = slice(0, 2), slice(2, 3)


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
    #: number of the first row
    start: int
    #: numbers of the first rows of the body's zones
    zones: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Assembly:
    """The two systems of a body and the work that they took on this rank."""

    normal: Rows
    torsion: Rows
    kernel_evaluations: int


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
