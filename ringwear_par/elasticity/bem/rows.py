"""Compiled: the rows of the boundary equation that are collocated at some nodes.

Element by element: sources one after another that take the same rule of it are integrated side by
side, point by point, so that the processor's vector instructions serve them, and points of several
rules share a tile; sources on the element, or so close to it that it is cut in parts, are
integrated one by one with the points of the parts side by side.

The source's own column needs no integrals: shape functions sum to one, and to radius or height when
they are weighted with that of their nodes, so that the rigid or constant-strain field that is
subtracted (see ``assembly``) is a sum over the columns of the other nodes.
"""

import math
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.bem.compiling import compiled
from ringwear_par.elasticity.bem.kernels import TILE, TILE_ROWS, fill_tile
from ringwear_par.elasticity.bem.quadrature import MAX_POINTS, Quadrature
from ringwear_par.elasticity.bem.systems import BoundaryConditions, DofMap

Pair = tuple[FloatArray, FloatArray]
Shapes = tuple[float, float, float]
#: an index that does not count from the end, which need not be looked at: so loops are vectorised
unsigned = np.uint64
#: most parts of an element that wait to be integrated
MAX_PARTS = 128
#: doubles that the widest vectors of common processors hold
_VECTOR = 8
#: points of a tile: loops over sources run on to whole vectors, over what comes next
_ROOM = TILE - _VECTOR

# rows of TILE numbers: offsets and kernels in a tile; behind it points of parts, their parameters
# and weights; in the sums the integrals of T (rr, rz, zr, zz, theta theta) times shape function 0,
# 1, 2, and of U
_A, _B, _U, _T = unsigned(TILE), unsigned(2 * TILE), unsigned(3 * TILE), unsigned(8 * TILE)
_PARAMETER, _WEIGHT = TILE_ROWS * TILE, (TILE_ROWS + 1) * TILE
# pairs rr, rz, zr, zz, theta theta: force at the source and component on the element
_FORCE = np.array([0, 0, 1, 1, 2])
_COMPONENT = np.array([0, 1, 0, 1, 2])
_ROW, _TWO_ROWS, _G = unsigned(TILE), unsigned(2 * TILE), unsigned(15 * TILE)


class Work(NamedTuple):
    """Work space."""

    #: ((TILE_ROWS + 2) * TILE,) float, see ``fill_tile``
    tile: FloatArray
    #: (20 * TILE,) float, integrals over an element for sources one after another
    sums: FloatArray
    #: (2, ...) float, ends of the parts that wait, as many as there may be
    parts: FloatArray


class Sources(NamedTuple):
    """Nodes at which the equation is collocated, with room for a whole vector behind the last."""

    r: FloatArray
    z: FloatArray
    #: (3, ...) int, rows of the matrices for forces along r, z and theta, -1 for none
    rows: IntArray
    #: (5, ...) float, entries of sources' own columns, of the subtracted fields: r for forces along
    #: r and z, z for both, theta
    rigid: FloatArray


@compiled
def whole_vectors(count: int) -> int:
    """Return the next number of points that fills vectors."""
    return count + -count % _VECTOR


@compiled(fastmath={"contract"}, error_model="numpy")
def _count_points(sources: Sources, line: FloatArray, reach: FloatArray, points: IntArray) -> None:
    """Set how many points each source takes; more than MAX_POINTS: the element is to be cut."""
    start_r, start_z, dr, dz = line[0], line[1], line[2], line[3]
    inverse = 1.0 / line[4]
    n = 1
    for s in range(len(points)):
        ar, az = start_r - sources.r[s], start_z - sources.z[s]
        br, bz = ar + dr, az + dz
        ratio = (math.sqrt(ar * ar + az * az) + math.sqrt(br * br + bz * bz)) * inverse
        while n > 1 and reach[n - 1] <= ratio:
            n -= 1
        while n <= MAX_POINTS and reach[n] > ratio:
            n += 1
        points[s] = n


@compiled(fastmath={"contract"}, error_model="numpy")
def _place_points(
    tile: FloatArray,
    start: int,
    sources: Sources,
    first: int,
    count: int,
    line: FloatArray,
    t: FloatArray,
) -> None:
    """Put the points of a rule, as some sources see them, in a tile."""
    whole, source = unsigned(whole_vectors(count)), unsigned(first)
    for q in range(len(t)):
        at, tr, tz = unsigned(start + q * count), t[q] * line[2], t[q] * line[3]
        for i in range(whole):
            r = sources.r[source + i]
            tile[at + i] = r
            tile[_A + at + i] = line[0] - r + tr
            tile[_B + at + i] = line[1] - sources.z[source + i] + tz


@compiled
def _fill_runs(
    work: Work,
    runs: IntArray,
    sources: Sources,
    first: int,
    points: IntArray,
    line: FloatArray,
    rules: Quadrature,
) -> tuple[int, int]:
    """Put the points of as many sources in the tile as it has room for; return points and runs.

    Parameters
    ----------
    runs : (TILE, 2) int, set: number of sources one after another, points of their rule.
    """
    last, filled, n_runs = first, 0, 0
    while last < len(points) and points[last] <= MAX_POINTS:
        n, begin = points[last], last
        most = min(begin + (_ROOM - filled) // n, len(points))
        while last < most and points[last] == n:
            last += 1
        count = last - begin
        if count == 0:
            break
        _place_points(work.tile, filled, sources, begin, count, line, rules.points[n, :n])
        runs[n_runs, 0], runs[n_runs, 1] = count, n
        n_runs += 1
        filled += n * count
    return filled, n_runs


@compiled(inline="always")
def _weighted_shapes(t: float, weight: float) -> Shapes:
    s1 = 4.0 * t * (1.0 - t)
    return weight * (1.0 - t) * (1.0 - 2.0 * t), weight * s1, weight * t * (2.0 * t - 1.0)


@compiled(fastmath={"contract"}, error_model="numpy")
def _add_points(
    tile: FloatArray,
    start: int,
    sums: FloatArray,
    count: int,
    length: float,
    t: FloatArray,
    weights: FloatArray,
) -> None:
    """Set the integrals over an element for some sources, three points of their rule at a time."""
    whole, end = unsigned(whole_vectors(count)), len(t) - 1
    for q in range(0, end + 1, 3):
        p0, p1, p2 = (
            unsigned(start + q * count), unsigned(start + min(q + 1, end) * count),
            unsigned(start + min(q + 2, end) * count),
        )  # fmt: skip
        w0 = length * weights[q]
        w1 = length * weights[q + 1] if q + 1 <= end else 0.0
        w2 = length * weights[q + 2] if q + 2 <= end else 0.0
        x0, y0, z0 = _weighted_shapes(t[q], w0)
        x1, y1, z1 = _weighted_shapes(t[min(q + 1, end)], w1)
        x2, y2, z2 = _weighted_shapes(t[min(q + 2, end)], w2)
        new = q == 0
        for pair in range(5):
            u, kernel = _U + unsigned(pair * TILE), _T + unsigned(pair * TILE)
            g, h = _G + unsigned(pair * TILE), unsigned(3 * pair * TILE)
            for i in range(whole):
                k0, k1, k2 = tile[kernel + p0 + i], tile[kernel + p1 + i], tile[kernel + p2 + i]
                x, y = x0 * k0 + x1 * k1 + x2 * k2, y0 * k0 + y1 * k1 + y2 * k2
                z = z0 * k0 + z1 * k1 + z2 * k2
                sums[h + i] = x if new else sums[h + i] + x
                sums[_ROW + h + i] = y if new else sums[_ROW + h + i] + y
                sums[_TWO_ROWS + h + i] = z if new else sums[_TWO_ROWS + h + i] + z
            for i in range(whole):
                x = w0 * tile[u + p0 + i] + w1 * tile[u + p1 + i] + w2 * tile[u + p2 + i]
                sums[g + i] = x if new else sums[g + i] + x


@compiled(fastmath={"contract"}, error_model="numpy")
def _add_tile(work: Work, count: int, at: int, line: FloatArray, poisson: float) -> None:
    """Add points of one element and source to its integrals, the first of the rows."""
    tile, sums = work.tile, work.sums
    fill_tile(tile, whole_vectors(count), line[5], line[6], poisson)
    for i in range(count):
        w = tile[_WEIGHT + i]
        s0, s1, s2 = _weighted_shapes(tile[_PARAMETER + i], w)
        s0, s1, s2 = 0.0 if at == 0 else s0, 0.0 if at == 1 else s1, 0.0 if at == 2 else s2
        for pair in range(5):
            kernel = tile[(8 + pair) * TILE + i]
            sums[3 * pair * TILE] += s0 * kernel
            sums[(3 * pair + 1) * TILE] += s1 * kernel
            sums[(3 * pair + 2) * TILE] += s2 * kernel
            sums[(15 + pair) * TILE] += w * tile[(3 + pair) * TILE + i]


@compiled(error_model="numpy")
def _integrate_alone(
    work: Work,
    sources: Sources,
    source: int,
    line: FloatArray,
    at: int,
    rules: Quadrature,
    poisson: float,
) -> int:
    """Integrate over an element in parts, as it is close to one source or holds it.

    Parameters
    ----------
    line : (7,), the element's column of ``lines``.
    at : local node 0, 1, 2 where the source lies on the element, -1 elsewhere; the integrals with
        the shape function of that node are left out.

    Returns
    -------
    Number of kernel evaluations; -1: the work space has no room for all parts.
    """
    xr, xz = sources.r[source], sources.z[source]
    ar, az, dr, dz, length = line[0] - xr, line[1] - xz, line[2], line[3], line[4]
    work.sums[::TILE] = 0.0
    part_from, part_to = work.parts[0], work.parts[1]
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
        if count + n > _ROOM:
            _add_tile(work, count, at, line, poisson)
            count = 0
        for q in range(n):
            # offsets from the source, without cancellation on its own element
            if singular:
                dt, weight = span * rules.singular_points[q], rules.singular_weights[q]
            else:
                dt = t0 + span * rules.points[n, q] - 0.5 * max(at, 0)
                weight = rules.weights[n, q]
            i, a, b = count + q, dt * dr, dt * dz
            work.tile[i], work.tile[TILE + i], work.tile[2 * TILE + i] = xr, a, b
            if at < 0:
                work.tile[TILE + i], work.tile[2 * TILE + i] = ar + a, az + b
            work.tile[_PARAMETER + i] = dt + 0.5 * max(at, 0)
            work.tile[_WEIGHT + i] = weight * abs(span) * length
        count += n
        evaluations += n
    _add_tile(work, count, at, line, poisson)
    return evaluations


@compiled(fastmath={"contract"}, error_model="numpy")
def _add_rigid(
    sums: FloatArray,
    sources: Sources,
    first: int,
    count: int,
    ends: FloatArray,
    thinner: float,
    star_r: float,
) -> None:
    """Add what integrals over an element say of the sources' own columns.

    Parameters
    ----------
    ends : (3, 2) float, the element's nodes.
    """
    r0, r1, r2 = ends[0, 0], ends[1, 0], ends[2, 0]
    z0, z1, z2 = ends[0, 1], ends[1, 1], ends[2, 1]
    for i in range(unsigned(count)):
        s = unsigned(first) + i
        z = sources.z[s]
        for force in range(2):
            h, g = unsigned(6 * force * TILE) + i, _G + unsigned(2 * force * TILE) + i
            axial = h + _ROW + _TWO_ROWS
            a0, a1, a2 = sums[axial], sums[axial + _ROW], sums[axial + _TWO_ROWS]
            sources.rigid[unsigned(force), s] += (
                star_r * sums[g]
                - (r0 * sums[h] + r1 * sums[h + _ROW] + r2 * sums[h + _TWO_ROWS])
                + thinner * ((z0 - z) * a0 + (z1 - z) * a1 + (z2 - z) * a2)
            )
            sources.rigid[unsigned(2 + force), s] -= a0 + a1 + a2
        h = unsigned(12 * TILE) + i
        sources.rigid[unsigned(4), s] -= (
            r0 * sums[h] + r1 * sums[h + _ROW] + r2 * sums[h + _TWO_ROWS]
        )


@compiled
def _list_entries(
    e: int,
    elements: IntArray,
    conditions: BoundaryConditions,
    dofs: DofMap,
    soft: float,
    widths: IntArray,
    entries: IntArray,
    factors: FloatArray,
) -> tuple[int, int]:
    """List which sums of an element are added to which columns; return the ends of both systems.

    Parameters
    ----------
    entries : (3, 25) int, set: force, column and first number of the sums.
    factors : (25,) float, set.
    """
    n = middle = int(np.int64(0))
    for pair in range(5):
        i, force = _COMPONENT[pair], _FORCE[pair]
        for k in range(5):
            if k < 3:
                column, factor = dofs.displacement[elements[e, k], i], 1.0
            elif k == 3:
                column, factor = dofs.traction[e, i], -dofs.sign[e] * soft
            else:
                column, factor = conditions.load[e, i], soft * conditions.traction[e, i]
                column += widths[force // 2] if column >= 0 else 0
            if column >= 0:
                entries[0, n], entries[1, n], factors[n] = force, column, factor
                entries[2, n] = TILE * (3 * pair + k if k < 3 else 15 + pair)
                n += 1
        if force < 2:
            middle = n
    return middle, n


@compiled(fastmath={"contract"}, error_model="numpy")
def _scatter(
    sums: FloatArray,
    rows: IntArray,
    first: int,
    count: int,
    entries: IntArray,
    factors: FloatArray,
    matrix: FloatArray,
) -> None:
    """Add sums of an element for some sources to the columns of a system."""
    for k in range(entries.shape[1]):
        force, column, at = entries[0, k], unsigned(entries[1, k]), unsigned(entries[2, k])
        line, factor, source = unsigned(force), factors[k], unsigned(first)
        for i in range(unsigned(count)):
            row = rows[line, source + i]
            if row >= 0:
                matrix[column, unsigned(row)] += factor * sums[at + i]


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
def _write_rigid(sources: Sources, s: int, columns: IntArray, matrices: Pair) -> None:
    """Add a source's own entries to the columns of its displacements."""
    inv_r = 1.0 / sources.r[s] if sources.r[s] > 0.0 else 0.0  # on the axis u_r = u_theta = 0
    for force in range(2):
        row = sources.rows[force, s]
        if row >= 0 and columns[0] >= 0:
            matrices[0][columns[0], row] += inv_r * sources.rigid[force, s]
        if row >= 0 and columns[1] >= 0:
            matrices[0][columns[1], row] += sources.rigid[2 + force, s]
    if sources.rows[2, s] >= 0 and columns[2] >= 0:
        matrices[1][columns[2], sources.rows[2, s]] += inv_r * sources.rigid[4, s]


@compiled
def _sources(nodes: IntArray, boundary: BoundaryMesh, dofs: DofMap, starts: IntArray) -> Sources:
    """Return some nodes as sources; behind the last it is repeated."""
    room = len(nodes) + _VECTOR
    r, z = np.empty(room), np.empty(room)
    rows = np.full((3, room), -1)
    for s in range(room):
        p = nodes[min(s, len(nodes) - 1)]
        r[s], z[s] = boundary.nodes[p]
        for force in range(3):
            if s < len(nodes) and dofs.equation[p, force] >= 0:
                rows[force, s] = dofs.equation[p, force] - starts[0 if force < 2 else 1]
    return Sources(r, z, rows, np.zeros((5, room)))


@compiled
def assemble_rows(
    first_node: int,
    last_node: int,
    boundary: BoundaryMesh,
    conditions: BoundaryConditions,
    dofs: DofMap,
    young: float,
    poisson: float,
    rules: Quadrature,
    starts: IntArray,
    widths: IntArray,
    matrices: Pair,
    most_parts: int,
) -> int:
    """Add to the rows collocated at nodes first_node <= p < last_node; return kernel evaluations.

    -1: an element would have to be cut in more parts than may wait.

    Parameters
    ----------
    boundary : BoundaryMesh, and further BoundaryConditions, DofMap.
    young : modulus over the one that tractions are scaled with.
    rules : Quadrature.
    starts : (2,) int, number of the first row of each matrix.
    widths : (2,) int, number of unknowns of the (r, z) and of the theta system.
    matrices : theirs, transposed, row-major, and behind the last unknown the loads.
    most_parts : most parts of an element that may wait to be integrated.
    """
    elements, lines = boundary.elements, element_lines(boundary)
    # u* = (r1 e_r - thinner (z1 - z) e_z) / r has no axial stress, and stresses that stay finite as
    # Poisson's ratio goes to 1/2; its traction, along r, is this over r
    thinner, star_r = 2.0 * poisson / (1.0 - poisson), lines[5] / (1.0 - poisson)
    runs = np.empty((TILE, 2), dtype=np.int64)
    work = Work(np.ones((TILE_ROWS + 2) * TILE), np.empty(20 * TILE), np.empty((2, most_parts)))
    sums, entries, factors = work.sums, np.empty((3, 25), dtype=np.int64), np.empty(25)
    normal, torsion = matrices
    evaluations = 0
    nodes = np.array([p for p in range(first_node, last_node) if dofs.equation[p].max() >= 0])
    if len(nodes) == 0:
        return 0
    sources, points = _sources(nodes, boundary, dofs, starts), np.empty_like(nodes)
    for e in range(len(elements)):
        line, ends = lines[:, e].copy(), boundary.nodes[elements[e]]
        middle, last = _list_entries(
            e, elements, conditions, dofs, 1.0 / young, widths, entries, factors
        )
        _count_points(sources, line, rules.reach, points)
        first = 0
        while first < len(nodes):
            if points[first] > MAX_POINTS:
                local = int(np.int64(-1))
                for c in range(3):
                    if elements[e, c] == nodes[first]:
                        local = c
                added = _integrate_alone(work, sources, first, line, local, rules, poisson)
                if added < 0:
                    return -1
                runs[0, 0], runs[0, 1], n_runs = 1, 0, 1
            else:
                added, n_runs = _fill_runs(work, runs, sources, first, points, line, rules)
                fill_tile(work.tile, whole_vectors(added), line[5], line[6], poisson)
            evaluations += added
            start = 0
            for run in range(n_runs):
                count, n = runs[run, 0], runs[run, 1]
                if n > 0:
                    t, weights = rules.points[n, :n], rules.weights[n, :n]
                    _add_points(work.tile, start, sums, count, line[4], t, weights)
                _add_rigid(sums, sources, first, count, ends, thinner, star_r[e])
                _scatter(sums, sources.rows, first, count, entries[:, :middle], factors, normal)
                _scatter(
                    sums, sources.rows, first, count, entries[:, middle:last],
                    factors[middle:], torsion,
                )  # fmt: skip
                first += count
                start += n * count
    for s in range(len(nodes)):
        _write_rigid(sources, s, dofs.displacement[nodes[s]], matrices)
    return evaluations
