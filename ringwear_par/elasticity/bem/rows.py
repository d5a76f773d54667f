"""Compiled: the rows of the boundary equation that are collocated at some nodes.

All elements that take the same rule from a source are integrated side by side, point by point, so
that the processor's vector instructions serve them; those that hold the source, or are so close to
it that they are cut in parts, one after another with their points side by side.

The source's own column needs no integrals: shape functions sum to one, and to radius or height when
they are weighted with that of their nodes, so that the rigid or constant-strain field that is
subtracted (see ``assembly``) is a sum over the columns of the other nodes.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.bem.compiling import compiled
from ringwear_par.elasticity.bem.kernels import TILE, TILE_ROWS, fill_tile
from ringwear_par.elasticity.bem.quadrature import MAX_POINTS, Quadrature
from ringwear_par.elasticity.bem.systems import BoundaryConditions, DofMap, Moving

Pair = tuple[FloatArray, FloatArray]
#: no index of it counts from the end, which need not be looked at
UnsignedArray = NDArray[np.uint64]
#: most parts of an element that wait to be integrated
MAX_PARTS = 128
#: doubles that the widest vectors of common processors hold
_VECTOR = 4

# Work space, rows of TILE numbers: the tile of the kernels; an element's first node from the
# source, its vector, length and normal, or a point's parameter and weight; the integrals of T (rr,
# rz, zr, zz, theta theta) times shape function 0, 1, 2, and of U
_U_RR, _U_RZ, _U_ZR, _U_ZZ = 4 * TILE, 5 * TILE, 6 * TILE, 7 * TILE
_T_RR, _T_RZ, _T_ZR, _T_ZZ = 8 * TILE, 9 * TILE, 10 * TILE, 11 * TILE
_U_TT, _T_TT = 12 * TILE, 13 * TILE
_AR, _AZ, _DR, _DZ, _LENGTH, _NR, _NZ = (row * TILE for row in range(TILE_ROWS, TILE_ROWS + 7))
_H = (TILE_ROWS + 7) * TILE
_G = _H + 15 * TILE
_WORK = _G + 5 * TILE
_T, _WEIGHT = _AR, _AZ
# pairs rr, rz, zr, zz, theta theta: force at the source and component on the element
_FORCE = np.array([0, 0, 1, 1, 2])
_COMPONENT = np.array([0, 1, 0, 1, 2])


@compiled(fastmath={"contract"}, error_model="numpy")
def _distances(xr: float, xz: float, lines: FloatArray, ratio: FloatArray) -> None:
    """Set the distances of the source from both ends of elements, over their lengths."""
    for e in range(len(ratio)):
        ar, az = lines[0, e] - xr, lines[1, e] - xz
        br, bz = ar + lines[2, e], az + lines[3, e]
        ratio[e] = (math.sqrt(ar * ar + az * az) + math.sqrt(br * br + bz * bz)) / lines[4, e]


@compiled(fastmath={"contract"}, error_model="numpy")
def _place(work: FloatArray, start: int, count: int, t: float) -> None:
    """Set the same point of elements side by side, from a place in the tile on."""
    for i in range(count):
        work[start + i] = work[_AR + i] + t * work[_DR + i]
        work[TILE + start + i] = work[_AZ + i] + t * work[_DZ + i]
        work[2 * TILE + start + i] = work[_NR + i]
        work[3 * TILE + start + i] = work[_NZ + i]


@compiled(fastmath={"contract"}, error_model="numpy")
def _add_points(
    work: FloatArray, start: int, count: int, weight: float, s0: float, s1: float, s2: float
) -> None:
    """Add the same point of elements side by side to their integrals."""
    for i in range(count):
        w = weight * work[_LENGTH + i]
        w0, w1, w2 = w * s0, w * s1, w * s2
        t = work[_T_RR + start + i]
        work[_H + i] += w0 * t
        work[_H + TILE + i] += w1 * t
        work[_H + 2 * TILE + i] += w2 * t
        t = work[_T_RZ + start + i]
        work[_H + 3 * TILE + i] += w0 * t
        work[_H + 4 * TILE + i] += w1 * t
        work[_H + 5 * TILE + i] += w2 * t
        t = work[_T_ZR + start + i]
        work[_H + 6 * TILE + i] += w0 * t
        work[_H + 7 * TILE + i] += w1 * t
        work[_H + 8 * TILE + i] += w2 * t
        t = work[_T_ZZ + start + i]
        work[_H + 9 * TILE + i] += w0 * t
        work[_H + 10 * TILE + i] += w1 * t
        work[_H + 11 * TILE + i] += w2 * t
        t = work[_T_TT + start + i]
        work[_H + 12 * TILE + i] += w0 * t
        work[_H + 13 * TILE + i] += w1 * t
        work[_H + 14 * TILE + i] += w2 * t
        work[_G + i] += w * work[_U_RR + start + i]
        work[_G + TILE + i] += w * work[_U_RZ + start + i]
        work[_G + 2 * TILE + i] += w * work[_U_ZR + start + i]
        work[_G + 3 * TILE + i] += w * work[_U_ZZ + start + i]
        work[_G + 4 * TILE + i] += w * work[_U_TT + start + i]


@compiled
def padded(work: FloatArray, first: int, last: int, count: int) -> int:
    """Repeat the last number of rows of a tile up to whole vectors; return how many there are.

    Parameters
    ----------
    first, last : numbers of the rows from, and up to which.
    count : numbers that each has.
    """
    whole = count + -count % _VECTOR
    for row in range(first, last):
        for i in range(row * TILE + count, row * TILE + whole):
            work[i] = work[row * TILE + count - 1]
    return whole


@compiled(error_model="numpy")
def _integrate_together(
    work: FloatArray,
    xr: float,
    xz: float,
    lines: FloatArray,
    chosen: IntArray,
    n: int,
    rules: Quadrature,
    poisson: float,
) -> None:
    """Integrate over elements that take the same n-point rule, at most TILE."""
    for i in range(len(chosen)):
        e = chosen[i]
        work[_AR + i], work[_AZ + i] = lines[0, e] - xr, lines[1, e] - xz
        work[_DR + i], work[_DZ + i] = lines[2, e], lines[3, e]
        work[_LENGTH + i], work[_NR + i], work[_NZ + i] = lines[4, e], lines[5, e], lines[6, e]
    count = padded(work, TILE_ROWS, TILE_ROWS + 7, len(chosen))
    for row in range(20):
        work[_H + row * TILE : _H + row * TILE + count] = 0.0
    at_once = TILE // count
    for first in range(0, n, at_once):
        last = min(first + at_once, n)
        for q in range(first, last):
            _place(work, (q - first) * count, count, rules.points[n, q])
        fill_tile(work, (last - first) * count, xr, poisson)
        for q in range(first, last):
            t = rules.points[n, q]
            _add_points(
                work, (q - first) * count, count, rules.weights[n, q],
                (1.0 - t) * (1.0 - 2.0 * t), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0),
            )  # fmt: skip


@compiled(fastmath={"contract"}, error_model="numpy")
def _add_tile(work: FloatArray, count: int, at: int, xr: float, poisson: float) -> None:
    """Add points of one element to its integrals, the first of the rows of H and G."""
    filled = padded(work, 0, 4, count)
    fill_tile(work, filled, xr, poisson)
    for i in range(count):
        t, w = work[_T + i], work[_WEIGHT + i]
        s0 = 0.0 if at == 0 else w * (1.0 - t) * (1.0 - 2.0 * t)
        s1 = 0.0 if at == 1 else w * 4.0 * t * (1.0 - t)
        s2 = 0.0 if at == 2 else w * t * (2.0 * t - 1.0)
        for pair in range(5):
            kernel = work[(_T_RR + pair * TILE if pair < 4 else _T_TT) + i]
            work[_H + 3 * pair * TILE] += s0 * kernel
            work[_H + (3 * pair + 1) * TILE] += s1 * kernel
            work[_H + (3 * pair + 2) * TILE] += s2 * kernel
            work[_G + pair * TILE] += w * work[(_U_RR + pair * TILE if pair < 4 else _U_TT) + i]


@compiled(error_model="numpy")
def _integrate_alone(
    work: FloatArray,
    parts_of: FloatArray,
    xr: float,
    xz: float,
    line: FloatArray,
    at: int,
    rules: Quadrature,
    poisson: float,
) -> int:
    """Integrate over one element in parts, it being close to the source or holding it.

    Parameters
    ----------
    parts_of : (2, ...), work space: ends of the parts that wait, as many as there may be.
    line : (7,), the element's column of ``lines``.
    at : local node 0, 1, 2 where the source lies on the element, -1 elsewhere; the integrals with
        the shape function of that node are left out.

    Returns
    -------
    Number of kernel evaluations; -1: the work space has no room for all parts.
    """
    ar, az, dr, dz = line[0] - xr, line[1] - xz, line[2], line[3]
    length, nr, nz = line[4], line[5], line[6]
    work[_H:_WORK:TILE] = 0.0
    part_from, part_to = parts_of[0], parts_of[1]
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
    count = int(np.int64(0))  # a literal would be compiled once more
    evaluations = 0
    while parts > 0:
        parts -= 1
        t0, t1 = part_from[parts], part_to[parts]
        span = t1 - t0
        singular = at >= 0 and t0 == 0.5 * at
        n = 1
        if singular:
            reach = xr / length  # near the axis the kernels change over the radius, not the element
            cut = xr > 0.0 and abs(span) > 1.5 * reach
            middle = t0 + math.copysign(reach, span)
            n = len(rules.singular_points)
        else:
            d0 = math.hypot(ar + t0 * dr, az + t0 * dz)
            d1 = math.hypot(ar + t1 * dr, az + t1 * dz)
            ratio = (d0 + d1) / (length * abs(span))
            cut = ratio < rules.reach[MAX_POINTS]
            middle = 0.5 * (t0 + t1)
            while n < MAX_POINTS and rules.reach[n] > ratio:
                n += 1
        if cut:
            if parts + 2 > len(part_from):
                return -1
            part_from[parts], part_to[parts] = t0, middle
            part_from[parts + 1], part_to[parts + 1] = middle, t1
            parts += 2
            continue
        if count + n > TILE:
            _add_tile(work, count, at, xr, poisson)
            count = 0
        for q in range(n):
            # offsets from the source, without cancellation on its own element
            if singular:
                dt = span * rules.singular_points[q]
                weight = rules.singular_weights[q]
            else:
                dt = t0 + span * rules.points[n, q] - 0.5 * max(at, 0)
                weight = rules.weights[n, q]
            if at >= 0:
                t = 0.5 * at + dt
                a, b = dt * dr, dt * dz
            else:
                t = dt
                a, b = ar + t * dr, az + t * dz
            i = count + q
            work[i], work[TILE + i], work[2 * TILE + i], work[3 * TILE + i] = a, b, nr, nz
            work[_T + i], work[_WEIGHT + i] = t, weight * abs(span) * length
        count += n
        evaluations += n
    _add_tile(work, count, at, xr, poisson)
    return evaluations


@compiled
def _scatter(
    work: FloatArray,
    chosen: IntArray,
    columns: UnsignedArray,
    gathered: FloatArray,
    tractions: FloatArray,
) -> None:
    """Add the integrals over elements to the columns of their nodes.

    Parameters
    ----------
    gathered : (3, ...) float, added to: rows of a force along r, z and theta.
    tractions : (5, k) float, set to the integrals of U.
    """
    radial, axial, angular = gathered[0], gathered[1], gathered[2]
    for i in range(len(chosen)):
        e = chosen[i]
        for c in range(3):
            column = columns[e, c]
            radial[column] += work[_H + c * TILE + i]
            axial[column] += work[_H + (6 + c) * TILE + i]
            column = columns[e, 3 + c]
            radial[column] += work[_H + (3 + c) * TILE + i]
            axial[column] += work[_H + (9 + c) * TILE + i]
            angular[columns[e, 6 + c]] += work[_H + (12 + c) * TILE + i]
        for pair in range(5):
            tractions[pair, e] = work[_G + pair * TILE + i]


# sums of the same numbers in the same order, several at a time
@compiled(fastmath={"contract", "reassoc"}, error_model="numpy")
def _dot(x: FloatArray, y: FloatArray) -> float:
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@compiled
def element_lines(boundary: BoundaryMesh) -> FloatArray:
    """Return (7, k): first node r and z, vector, length, outward normal of each element."""
    k = len(boundary.elements)
    lines = np.empty((7, k))
    for e in range(k):
        first, last = (
            boundary.nodes[boundary.elements[e, 0]],
            boundary.nodes[boundary.elements[e, 2]],
        )
        dr, dz = last[0] - first[0], last[1] - first[1]
        length = math.hypot(dr, dz)
        lines[0, e], lines[1, e], lines[2, e], lines[3, e] = first[0], first[1], dr, dz
        lines[4, e], lines[5, e], lines[6, e] = length, dz / length, -dr / length
    return lines


@compiled
def _number_columns(
    boundary: BoundaryMesh, displacement: IntArray, unknowns: tuple[int, int]
) -> tuple[UnsignedArray, FloatArray]:
    """Return the columns of elements' nodes, and what they weigh in the source's own column.

    Known displacements have columns too, behind the unknown ones.

    Returns
    -------
    columns : (k, 9) unsigned int, of the three nodes' r, z and theta.
    weights : (4, ...) float, radii of r columns, ones of z columns, radii of theta columns, heights
        of z columns.
    """
    by_node = displacement.copy()
    ends = [unknowns[0], unknowns[1]]
    for i in range(3):
        system = 0 if i < 2 else 1
        for v in range(len(by_node)):
            if by_node[v, i] < 0:
                by_node[v, i] = ends[system]
                ends[system] += 1
    weights = np.zeros((4, max(ends[0], ends[1])))
    for v in range(len(by_node)):
        weights[0, by_node[v, 0]] = weights[2, by_node[v, 2]] = boundary.nodes[v, 0]
        weights[1, by_node[v, 1]] = 1.0
        weights[3, by_node[v, 1]] = boundary.nodes[v, 1]
    columns = np.empty((len(boundary.elements), 9), dtype=np.uint64)
    for e in range(len(columns)):
        for c in range(3):
            for i in range(3):
                columns[e, 3 * i + c] = by_node[boundary.elements[e, c], i]
    return columns, weights


@compiled
def assemble_rows(
    first_node: int,
    last_node: int,
    boundary: BoundaryMesh,
    conditions: BoundaryConditions,
    dofs: DofMap,
    moving: Moving,
    moved: bool,
    young: float,
    poisson: float,
    rules: Quadrature,
    starts: IntArray,
    matrices: Pair,
    loads: Pair,
    most_parts: int,
) -> int:
    """Add to the rows collocated at nodes first_node <= p < last_node; return kernel evaluations.

    -1: an element would have to be cut in more parts than may wait.

    The integrals added are those that move with the geometry, or those that do not.

    Parameters
    ----------
    boundary : BoundaryMesh, and further BoundaryConditions, DofMap, Moving.
    young : modulus over the one that tractions are scaled with.
    rules : Quadrature.
    starts : (2,) int, number of the first row of each matrix.
    matrices, loads : those of the (r, z) and of the theta system, row-major.
    most_parts : most parts of an element that may wait to be integrated.
    """
    elements, load, traction = boundary.elements, conditions.load, dofs.traction
    k = len(elements)
    soft, lines = 1.0 / young, element_lines(boundary)
    # u* = (r1 e_r - thinner (z1 - z) e_z) / r has no axial stress, and stresses that stay finite as
    # Poisson's ratio goes to 1/2; its traction, along r, is this over r
    thinner, star_r = 2.0 * poisson / (1.0 - poisson), lines[5] / (1.0 - poisson)
    columns, weights = _number_columns(
        boundary, dofs.displacement, (matrices[0].shape[1], matrices[1].shape[1])
    )
    laden = np.array([e for e in range(k) if max(traction[e].max(), load[e].max()) >= 0])
    work, parts_of = np.zeros(_WORK), np.empty((2, most_parts))
    ratio, tractions = np.empty(k), np.empty((5, k))
    order, chosen = np.empty(k, dtype=np.int64), np.empty(k, dtype=np.int64)
    ends = np.empty(MAX_POINTS + 3, dtype=np.int64)
    # rows of forces along r, z and theta
    gathered, rights = np.empty((3, weights.shape[1])), np.empty((3, loads[0].shape[1]))
    evaluations = 0
    for p in range(first_node, last_node):
        source_moves = moving.nodes[p]
        if (source_moves and not moved) or dofs.equation[p].max() < 0:
            continue
        gathered[:] = 0.0
        rights[:] = 0.0
        tractions[:] = 0.0
        xr, xz = boundary.nodes[p, 0], boundary.nodes[p, 1]
        _distances(xr, xz, lines, ratio)
        # elements sorted by the points that they take; those to be cut come last
        ends[:] = 0
        for e in range(k):
            n = 0
            if (source_moves or moving.elements[e]) == moved:
                n = 1
                while n <= MAX_POINTS and rules.reach[n] > ratio[e]:
                    n += 1
            order[e] = n
            ends[n + 1] += 1
        for n in range(1, MAX_POINTS + 3):
            ends[n] += ends[n - 1]
        for e in range(k):
            chosen[ends[order[e]]] = e
            ends[order[e]] += 1
        for n in range(1, MAX_POINTS + 1):
            for first in range(ends[n - 1], ends[n], TILE):
                together = chosen[first : min(first + TILE, ends[n])]
                _integrate_together(work, xr, xz, lines, together, n, rules, poisson)
                evaluations += n * len(together)
                _scatter(work, together, columns, gathered, tractions)
        for i in range(ends[MAX_POINTS], ends[MAX_POINTS + 1]):
            e = chosen[i]
            local = int(np.int64(-1))
            for c in range(3):
                if elements[e, c] == p:
                    local = c
            added = _integrate_alone(work, parts_of, xr, xz, lines[:, e], local, rules, poisson)
            if added < 0:
                return -1
            evaluations += added
            _scatter(work, chosen[i : i + 1], columns, gathered, tractions)
        # the source's own columns
        inv_r = 1.0 / xr if xr > 0.0 else 0.0  # on the axis u_r = u_theta = 0: nothing to subtract
        source_columns = dofs.displacement[p]
        if source_columns[0] >= 0:
            for force in range(2):
                gathered[force, source_columns[0]] += inv_r * (
                    _dot(star_r, tractions[2 * force])
                    - _dot(weights[0], gathered[force])
                    + thinner * _dot(weights[3], gathered[force])
                    - thinner * xz * _dot(weights[1], gathered[force])
                )
        if source_columns[1] >= 0:
            for force in range(2):
                gathered[force, source_columns[1]] -= _dot(weights[1], gathered[force])
        if source_columns[2] >= 0:
            gathered[2, source_columns[2]] -= inv_r * _dot(weights[2], gathered[2])
        for e in laden:
            for pair in range(5):
                i, force = _COMPONENT[pair], _FORCE[pair]
                if traction[e, i] >= 0:
                    gathered[force, traction[e, i]] -= dofs.sign[e] * soft * tractions[pair, e]
                if load[e, i] >= 0:
                    prescribed = conditions.traction[e, i]
                    rights[force, load[e, i]] += soft * tractions[pair, e] * prescribed
        for force in range(3):
            if dofs.equation[p, force] >= 0:
                system = 0 if force < 2 else 1
                row = dofs.equation[p, force] - starts[system]
                matrix = matrices[system]
                for column in range(matrix.shape[1]):
                    matrix[row, column] += gathered[force, column]
                loads[system][row] += rights[force]
    return evaluations
