# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Integrals of ring kernels over elements, added to rows of equations: ``_rings.h``."""

import numpy as np

from ringwear_par.errors import ComputationError

from libc.stdint cimport int64_t

cdef extern from "_rings.h" nogil:
    enum: TILE, ROW, MAX_POINTS, PAIRS, STRESS_PAIRS
    ctypedef double Row[ROW]
    ctypedef const double *Doubles
    ctypedef const int64_t *Integers
    ctypedef struct Tile:
        Row r, a, b, nr, nz
        Row value[2 * STRESS_PAIRS]
    ctypedef struct Element:
        pass
    ctypedef struct Work:
        int64_t count
        int pairs, components
        double nu
        double *matrix
        double *own
        Doubles sources, reach, points, weights, factors
        Integers nodes, rows, local, columns
        Element e
        Tile tile
    void fill_kernels(Tile *tile, int pairs, int count, double nu)
    int integrate_element(Work *work)

# too large for the stack; one call at a time uses it, that which has Python's lock
cdef Work work


def integrate_rows(sources, nodes, boundary, double poisson, rules, columns, factors, rows, matrix):
    """Add integrals over the elements of a boundary, times factors, to the rows of sources.

    Of the five pairs of the boundary equation (component at the source, direction on the element:
    rr, zr, rz, zz, theta theta), or of the ten of stresses (rr, tt, zz, rz for the directions r and
    z, then rt, tz for theta). Of each the integrals of the kernel that displacements are multiplied
    with, T or S, times the three shape functions, then of that for the traction, U or D.

    Parameters
    ----------
    sources : (p, 3) float, mm, r and z, and the height z0 of the fields subtracted.
    nodes : (p,) int, the boundary's node that a source is; -1: none.
    boundary : BoundaryMesh of k elements.
    poisson : Poisson's ratio; Young's modulus is 1.
    rules : Quadrature.
    columns, factors : (k, 3, 4) int and float, of each direction where in the matrix the column of
        each integral starts, -1 for none, and its factor.
    rows : (3 or 6, p) int, the row of each source for components r, z, theta or, of stresses, rr, tt,
        zz, rz, rt, tz, -1 for none.
    matrix : (size,) float, to which is added.

    Returns
    -------
    own : (pairs, p) float, integrals over the fields that are subtracted, see ``_rings.h``.

    Raises
    ------
    ComputationError : some sources and elements are too close to each other.
    ValueError : arrays do not fit each other.
    """
    first = boundary.nodes[boundary.elements[:, 0]]
    along = boundary.nodes[boundary.elements[:, 2]] - first
    length = np.hypot(along[:, 0], along[:, 1])[:, None]
    own = np.zeros((5 * len(rows) // 3, len(sources)))
    cdef const double[:, ::1] lines = np.hstack(
        [first, along, length, along[:, 1:] / length, -along[:, :1] / length])
    cdef const double[:, ::1] x = sources, points = rules.points, weights = rules.weights
    cdef const double[::1] reach = rules.reach
    cdef const int64_t[::1] node_of = nodes
    cdef const int64_t[:, ::1] elements = boundary.elements, row_of = rows
    cdef const int64_t[:, :, ::1] column_of = columns
    cdef const double[:, :, ::1] factor_of = factors
    cdef double[::1] entries = matrix
    cdef double[:, ::1] own_entries = own
    cdef int pairs = own.shape[0], along_r = 2 * pairs // PAIRS
    cdef Py_ssize_t e
    # what does not fit would be read and written beyond
    if not (
        reach.shape[0] == points.shape[0] == weights.shape[0] == MAX_POINTS + 1
        and points.shape[1] == weights.shape[1] == MAX_POINTS
        and rows.shape == (3 * along_r // 2, len(sources)) and pairs in (PAIRS, STRESS_PAIRS)
        and sources.shape == (len(nodes), 3) and boundary.elements.shape == (len(lines), 3)
        and columns.shape == factors.shape == (len(lines), 3, 4)
        and (columns.max(axis=(0, 2))
             + [rows[:along_r].max(initial=-1), rows[:along_r].max(initial=-1),
                rows[along_r:].max(initial=-1)]).max() < len(matrix)
    ):
        raise ValueError("integrals over elements need rules and arrays that fit each other")
    work.count, work.pairs, work.components = len(sources), pairs, along_r
    work.nu, work.sources, work.nodes, work.rows = poisson, &x[0, 0], &node_of[0], &row_of[0, 0]
    work.reach, work.points, work.weights = &reach[0], &points[0, 0], &weights[0, 0]
    work.matrix, work.own = &entries[0], &own_entries[0, 0]
    for e in range(elements.shape[0]):
        work.e = (<const Element *> &lines[e, 0])[0]
        work.local, work.columns = &elements[e, 0], &column_of[e, 0, 0]
        work.factors = &factor_of[e, 0, 0]
        if not integrate_element(&work):
            raise ComputationError(
                "boundary elements, or points of stress, lie too close to others, which are long "
                "for that, to be integrated over: thicker layers or bodies, or a milder "
                "mesh.grading, are needed"
            )
    return own


def kernels(const double[:, ::1] points, double poisson, bint stress=False):
    """Return the kernels U, then T, (10, p) float, in the order of ``integrate_rows``, for tests.

    Or D, then S, of stresses, (20, p). U is in 1/MPa at E = 1, T in 1, D in 1/mm and S in MPa/mm^2;
    all carry the ``r1`` of ``dS = r1 dtheta ds``.

    Parameters
    ----------
    points : (5, p) float, radius of the source, offsets a and b of the field point, mm, and the
        normal there, along r and z.
    poisson : Poisson's ratio.
    """
    if points.shape[0] != 5:
        raise ValueError("kernels need five numbers of each point")
    cdef int pairs = STRESS_PAIRS if stress else PAIRS
    values = np.empty((2 * pairs, points.shape[1]))
    cdef double[:, ::1] out = values
    cdef Py_ssize_t first, i, k, count
    cdef Tile *tile = &work.tile
    for first in range(0, points.shape[1], TILE):
        count = min(<Py_ssize_t> TILE, points.shape[1] - first)
        for i in range(count):
            tile.r[i], tile.a[i] = points[0, first + i], points[1, first + i]
            tile.b[i], tile.nr[i] = points[2, first + i], points[3, first + i]
            tile.nz[i] = points[4, first + i]
        fill_kernels(tile, pairs, count, poisson)
        for k in range(2 * pairs):
            for i in range(count):
                out[k, first + i] = tile.value[k][i]
    return values
