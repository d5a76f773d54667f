"""Compiled: what tractions and nodal displacements of a boundary say of the stress inside.

The elements of ``rows``: displacements quadratic, tractions constant. The integrands are smooth,
but steep close to the boundary, where elements are halved until their parts are not. What is left
of the quadrature's error is multiplied by u - u*, with the field u* = c e + d e_z + w r e_theta,
e = r e_r - 2 nu / (1 - nu) (z - z0) e_z, that agrees with u at the nearest node, at z0; its stress,
known, is added again, and finite for all nu.
"""

import math

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.bem.compiling import compiled
from ringwear_par.elasticity.bem.kernels import TILE
from ringwear_par.elasticity.bem.quadrature import MAX_POINTS, Quadrature
from ringwear_par.elasticity.bem.rows import MAX_PARTS as MAX_PARTS
from ringwear_par.elasticity.bem.rows import element_lines, whole_vectors
from ringwear_par.elasticity.stress.kernels import N_KERNELS, STRESS_TILE_ROWS, fill_stress_tile

# rows of the work space behind the tile: a point's parameter on its element, and its weight
_T, _WEIGHT = STRESS_TILE_ROWS * TILE, (STRESS_TILE_ROWS + 1) * TILE
WORK = (STRESS_TILE_ROWS + 2) * TILE


@compiled
def _add_tile(
    work: FloatArray,
    owner: IntArray,
    count: int,
    r: float,
    poisson: float,
    elements: IntArray,
    n_nodes: int,
    normal: FloatArray,
    torsion: FloatArray,
) -> None:
    """Add quadrature points to the columns of their elements."""
    fill_stress_tile(work, whole_vectors(count), r, poisson)
    for i in range(count):
        e, t, w = owner[i], work[_T + i], work[_WEIGHT + i]
        traction = 2 * (n_nodes + e)
        for row in range(4):
            normal[row, traction] += w * work[(4 + row) * TILE + i]
            normal[row, traction + 1] += w * work[(8 + row) * TILE + i]
        for row in range(2):
            torsion[row, n_nodes + e] += w * work[(12 + row) * TILE + i]
        for c in range(3):
            if c == 0:
                s = (1.0 - t) * (1.0 - 2.0 * t)
            elif c == 1:
                s = 4.0 * t * (1.0 - t)
            else:
                s = t * (2.0 * t - 1.0)
            s *= w
            node = elements[e, c]
            for row in range(4):
                normal[row, 2 * node] -= s * work[(4 + N_KERNELS + row) * TILE + i]
                normal[row, 2 * node + 1] -= s * work[(8 + N_KERNELS + row) * TILE + i]
            for row in range(2):
                torsion[row, node] -= s * work[(12 + N_KERNELS + row) * TILE + i]


@compiled
def _add_own_column(
    node: int,
    nodes: FloatArray,
    lines: FloatArray,
    poisson: float,
    normal: FloatArray,
    torsion: FloatArray,
) -> None:
    """Subtract the integrals over u*, t* of the nearest node, and add the stress of u*."""
    n_nodes = len(nodes)
    # stresses rr = tt of u_r = r where zz is 0, and what it is thinner by
    across, thinner = 1.0 / (1.0 - poisson), 2.0 * poisson / (1.0 - poisson)
    for row in range(4):
        rigid = 0.0
        for v in range(n_nodes):
            rigid += normal[row, 2 * v + 1]
        normal[row, 2 * node + 1] -= rigid
    r = nodes[node, 0]
    if r == 0.0:
        return  # u_r = u_theta = 0: nothing was to be subtracted
    for row in range(4):
        total = 0.0
        for v in range(n_nodes):
            total += normal[row, 2 * v] * nodes[v, 0]
            total -= normal[row, 2 * v + 1] * thinner * (nodes[v, 1] - nodes[node, 1])
        for e in range(lines.shape[1]):
            total += across * normal[row, 2 * (n_nodes + e)] * lines[5, e]
        added = across if row < 2 else 0.0
        normal[row, 2 * node] += (added - total) / r
    for row in range(2):
        total = 0.0
        for v in range(n_nodes):
            total += torsion[row, v] * nodes[v, 0]
        torsion[row, node] -= total / r


@compiled
def stress_rows(
    points: FloatArray,
    nearest: IntArray,
    boundary: BoundaryMesh,
    poisson: float,
    rules: Quadrature,
    normal: FloatArray,
    torsion: FloatArray,
    most_parts: int,
) -> int:
    """Set the rows of stresses at points inside a body; return kernel evaluations.

    -1: an element would have to be cut in more parts than may wait.

    Parameters
    ----------
    points : (p, 2) float, mm, inside and not on the boundary.
    nearest : (p,) int, the nearest node of each.
    boundary : BoundaryMesh of m nodes and k elements; Quadrature.
    poisson : Poisson's ratio; Young's modulus is 1.
    normal : (p, 4, 2 m + 2 k) float, set: stresses rr, tt, zz, rz for the displacements r, z of
        each node, then for the tractions r, z of each element.
    torsion : (p, 2, m + k) float, set: rt, tz for the theta ones.
    most_parts : most parts of an element that may wait to be integrated.
    """
    nodes, elements, lines = boundary.nodes, boundary.elements, element_lines(boundary)
    n_nodes = len(nodes)
    work, owner = np.zeros(WORK), np.zeros(TILE, dtype=np.int64)
    part_from, part_span = np.empty(most_parts), np.empty(most_parts)
    evaluations = 0
    normal[:] = 0.0
    torsion[:] = 0.0
    for p in range(len(points)):
        r, z = points[p, 0], points[p, 1]
        count = int(np.int64(0))  # a literal would be compiled once more
        for e in range(len(elements)):
            ar, az = lines[0, e] - r, lines[1, e] - z
            dr, dz, length = lines[2, e], lines[3, e], lines[4, e]
            nr, nz = lines[5, e], lines[6, e]
            part_from[0], part_span[0] = 0.0, 1.0
            parts = 1
            while parts > 0:
                parts -= 1
                t0, span = part_from[parts], part_span[parts]
                t1 = t0 + span
                d0 = math.hypot(ar + t0 * dr, az + t0 * dz)
                d1 = math.hypot(ar + t1 * dr, az + t1 * dz)
                ratio = (d0 + d1) / (length * span)
                if ratio < rules.reach[MAX_POINTS]:
                    if parts + 2 > most_parts:
                        return -1
                    half = 0.5 * span
                    part_from[parts], part_span[parts] = t0, half
                    part_from[parts + 1], part_span[parts + 1] = t0 + half, half
                    parts += 2
                    continue
                n = 1
                while n < MAX_POINTS and rules.reach[n] > ratio:
                    n += 1
                if count + n > TILE:
                    _add_tile(
                        work, owner, count, r, poisson, elements, n_nodes, normal[p], torsion[p]
                    )
                    count = 0
                for q in range(n):
                    t = t0 + span * rules.points[n, q]
                    i = count + q
                    work[i], work[TILE + i] = ar + t * dr, az + t * dz
                    work[2 * TILE + i], work[3 * TILE + i] = nr, nz
                    work[_T + i], work[_WEIGHT + i] = t, rules.weights[n, q] * span * length
                    owner[i] = e
                count += n
                evaluations += n
        _add_tile(work, owner, count, r, poisson, elements, n_nodes, normal[p], torsion[p])
        _add_own_column(nearest[p], nodes, lines, poisson, normal[p], torsion[p])
    return evaluations
