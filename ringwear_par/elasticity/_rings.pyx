# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Integrals of ring kernels over elements, added to rows of equations: ``_rings.h``."""

import numpy as np

from ringwear_par.errors import ComputationError

from libc.stdint cimport int64_t

cdef extern from "_rings.h" nogil:
    enum: TILE, ROW, MAX_POINTS, PAIRS, STRESS_PAIRS
    ctypedef struct Powers:
        double c[5]
    ctypedef struct Tile:
        double r[ROW]
        double a[ROW]
        double b[ROW]
        double nr[ROW]
        double nz[ROW]
        double value[2 * STRESS_PAIRS][ROW]
    ctypedef struct Element:
        double r, z, dr, dz, length, nr, nz
    ctypedef struct Rules:
        const double *reach
        const double *points
        const double *weights
        const double *singular_points
        const double *singular_weights
    ctypedef struct Work:
        int64_t count
        int pairs, components
        double nu
        const double *sources
        const int64_t *nodes
        const int64_t *rows
        const int64_t *local
        const int64_t *columns
        const double *factors
        double *matrix
        double *own
        Rules rules
        Element e
        Tile tile
    int is_small(double r, double a, double b)
    void moments_by_recursion(double r, double a, double b, Powers *i)
    void moments_by_quadrature(double r, double a, double b, Powers *i)
    void fill_kernels(Tile *tile, int pairs, int count, double nu)
    int integrate_element(Work *work)


cdef _need(bint fits, what):
    """Refuse arrays that do not fit each other: they would be read and written beyond."""
    if not fits:
        raise ValueError(f"integrals over elements need {what}")


cdef Rules _rules(quadrature) except *:
    cdef const double[::1] reach = quadrature.reach
    cdef const double[:, ::1] points = quadrature.points, weights = quadrature.weights
    cdef const double[::1] singular_points = quadrature.singular_points
    cdef const double[::1] singular_weights = quadrature.singular_weights
    _need(
        reach.shape[0] == points.shape[0] == weights.shape[0] == MAX_POINTS + 1
        and points.shape[1] == weights.shape[1] == MAX_POINTS
        and singular_points.shape[0] == singular_weights.shape[0] == MAX_POINTS,
        f"rules of up to {MAX_POINTS} points",
    )
    return Rules(&reach[0], &points[0, 0], &weights[0, 0], &singular_points[0],
                 &singular_weights[0])


cdef class _Workspace:
    """What is too large for the stack; kernels are computed for whole vectors of points."""

    cdef Work work

    def __cinit__(self):
        cdef Tile *tile = &self.work.tile
        cdef int i
        for i in range(ROW):
            tile.r[i] = tile.a[i] = tile.b[i] = tile.nr[i] = 1.0
            tile.nz[i] = 0.0


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
    columns, factors : (k, pairs, 4) int and float, where in the matrix the column of each integral
        starts, -1 for none, and its factor.
    rows : (3 or 6, p) int, the row of each source for components r, z, theta or rr, tt, zz, rz, rt,
        tz, -1 for none.
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
    own = np.zeros((columns.shape[1], len(sources)))
    cdef const double[:, ::1] lines = np.hstack(
        [first, along, length, along[:, 1:] / length, -along[:, :1] / length])
    cdef const double[:, ::1] x = sources
    cdef const int64_t[::1] node_of = nodes
    cdef const int64_t[:, ::1] elements = boundary.elements, row_of = rows
    cdef const int64_t[:, :, ::1] column_of = columns
    cdef const double[:, :, ::1] factor_of = factors
    cdef double[::1] entries = matrix
    cdef double[:, ::1] own_entries = own
    cdef _Workspace space = _Workspace()
    cdef Work *work = &space.work
    cdef int pairs = column_of.shape[1]
    cdef Py_ssize_t e
    _need(
        pairs in (PAIRS, STRESS_PAIRS) and 5 * row_of.shape[0] == 3 * pairs
        and x.shape[1] == elements.shape[1] == 3
        and node_of.shape[0] == row_of.shape[1] == x.shape[0]
        and column_of.shape[0] == factor_of.shape[0] == elements.shape[0]
        and factor_of.shape[1] == pairs
        and column_of.shape[2] == factor_of.shape[2] == 4
        and (columns.max(axis=(0, 2))
             + np.vstack([rows[:2 * pairs // PAIRS], rows]).max(axis=1, initial=-1)).max()
        < entries.shape[0],
        "numbers of sources, elements, rows and columns that are in their arrays",
    )
    if not len(sources):
        return own
    work.count, work.pairs, work.components = x.shape[0], pairs, 2 * pairs // PAIRS
    work.nu, work.rules = poisson, _rules(rules)
    work.sources, work.nodes, work.rows = &x[0, 0], &node_of[0], &row_of[0, 0]
    work.matrix, work.own = &entries[0], &own_entries[0, 0]
    for e in range(elements.shape[0]):
        work.e = (<const Element *> &lines[e, 0])[0]
        work.local, work.columns = &elements[e, 0], &column_of[e, 0, 0]
        work.factors = &factor_of[e, 0, 0]
        if not integrate_element(work):
            raise ComputationError(
                "boundary elements, or points of stress, lie too close to others, which are long "
                "for that, to be integrated over: thicker layers or bodies, or a milder "
                "mesh.grading, are needed"
            )
    return own


def moments(double r, double a, double b):
    """Return I(1,0), I(1,1), I(3,0) to I(3,2), I(5,0) to I(5,3) and I(7,0) to I(7,4).

    Parameters
    ----------
    r : radius of the source, mm, >= 0.
    a, b : radial and axial offset of the field point, mm, not both zero.
    """
    cdef Powers i[5]
    if is_small(r, a, b):
        moments_by_quadrature(r, a, b, i)
    else:
        moments_by_recursion(r, a, b, i)
    return tuple(i[k].c[q] for k in range(1, 5) for q in range(k + 1))


def kernels(const double[:, ::1] points, double poisson, bint stress=False):
    """Return the kernels U, then T, (10, p) float, in the order of ``integrate_rows``.

    Or D, then S, of stresses, (20, p). U is in 1/MPa at E = 1, T in 1, D in 1/mm and S in MPa/mm^2;
    all carry the ``r1`` of ``dS = r1 dtheta ds``.

    Parameters
    ----------
    points : (5, p) float, radius of the source, offsets a and b of the field point, mm, and the
        normal there, along r and z.
    poisson : Poisson's ratio.
    """
    _need(points.shape[0] == 5, "five numbers of each point")
    cdef int pairs = STRESS_PAIRS if stress else PAIRS
    values = np.empty((2 * pairs, points.shape[1]))
    cdef double[:, ::1] out = values
    cdef Py_ssize_t first, i, k, count
    cdef _Workspace space = _Workspace()
    cdef Tile *tile = &space.work.tile
    for first in range(0, points.shape[1], TILE):
        count = min(<Py_ssize_t> TILE, points.shape[1] - first)
        for i in range(count):
            tile.r[i], tile.a[i], tile.b[i] = points[0, first + i], points[1, first + i], points[2, first + i]
            tile.nr[i], tile.nz[i] = points[3, first + i], points[4, first + i]
        fill_kernels(tile, pairs, count, poisson)
        for k in range(2 * pairs):
            for i in range(count):
                out[k, first + i] = tile.value[k][i]
    return values
