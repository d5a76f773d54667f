# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Integrals of ring kernels over elements, added to rows of equations.

The kernels and the integrals are in ``_rings.h``. Sources that take the same rule of an element are
integrated side by side, so that the processor's vector instructions serve them; those on an
element, or so close to it that it is cut in parts, one by one.
"""

import numpy as np

from ringwear_par.errors import ComputationError

from libc.math cimport sqrt
from libc.stdint cimport int64_t

cdef extern from "_rings.h" nogil:
    enum: TILE, VECTOR, ROW, MAX_POINTS, MOST_POINTS, PAIRS, STRESS_PAIRS
    ctypedef struct Tile:
        double r[ROW]
        double a[ROW]
        double b[ROW]
        double nr[ROW]
        double nz[ROW]
        double value[2 * STRESS_PAIRS][ROW]
    ctypedef struct Element:
        double r, z, dr, dz, length, nr, nz
    ctypedef struct Sources:
        double r[ROW]
        double a[ROW]
        double b[ROW]
        double z0[ROW]
    ctypedef struct Integrals:
        double of[STRESS_PAIRS][4][ROW]
        double own[STRESS_PAIRS][ROW]
    ctypedef struct Rules:
        const double *reach
        const double *points
        const double *weights
        const double *singular_points
        const double *singular_weights
    ctypedef struct Points:
        int count
    ctypedef struct Moments:
        double i10, i11, i30, i31, i32, i50, i51, i52, i53, i70, i71, i72, i73, i74
    Moments moments_of(double r, double a, double b)
    void fill_kernels(Tile *tile, int pairs, int count, double nu)
    int points_needed(const Rules *rules, double ratio, int n)
    void integrate(Tile *tile, Integrals *sums, const Element *e, int pairs,
                   const Sources *sources, int count, int at, int n, const double *place,
                   const double *weight, int add, double nu)
    int integrate_near(Tile *tile, Integrals *sums, Points *points, const Element *e, int pairs,
                       const Sources *sources, int at, const Rules *rules, double nu)
    void add_to_column(double *column, const int64_t *rows, int count, double factor,
                       const double *integrals)


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


cdef class Integrator:
    """Integrals over elements for sources, added to the columns of a matrix."""

    cdef Tile tile
    cdef Integrals sums
    cdef Points points
    cdef Rules rules
    cdef Sources side_by_side
    cdef int pairs
    cdef double poisson
    # see ``integrate_rows``
    cdef const double[:, ::1] sources
    cdef const int64_t[::1] nodes
    cdef const int64_t[:, ::1] rows
    cdef const int64_t[:, :, ::1] columns
    cdef const double[:, :, ::1] factors
    cdef double[::1] matrix
    cdef double[:, ::1] own
    # the element, its number and its nodes
    cdef Element element
    cdef Py_ssize_t number
    cdef int64_t local[3]
    # sources that wait to be integrated side by side, by the points of their rule
    cdef int64_t waiting[MAX_POINTS + 1][TILE]
    cdef int count[MAX_POINTS + 1]

    def __cinit__(self):
        cdef int i
        for i in range(ROW):  # kernels are computed for whole vectors of points
            self.tile.r[i] = self.tile.a[i] = self.tile.b[i] = self.tile.nr[i] = 1.0
            self.tile.nz[i] = 0.0

    cdef bint integrate(self) noexcept:
        """Add the integrals over the element; tell whether no source is too close."""
        cdef const Element *e = &self.element
        cdef double a, b, distance
        cdef int64_t source
        cdef int i, n = 1
        for i in range(ROW):
            self.tile.nr[i], self.tile.nz[i] = e.nr, e.nz
        for source in range(self.sources.shape[0]):
            a, b = e.r - self.sources[source, 0], e.z - self.sources[source, 1]
            distance = sqrt(a * a + b * b)
            a, b = a + e.dr, b + e.dz
            n = points_needed(&self.rules, (distance + sqrt(a * a + b * b)) / e.length, n)
            if n > MAX_POINTS:
                if not self.integrate_near(source):
                    return False
            else:
                self.waiting[n][self.count[n]] = source
                self.count[n] += 1
                if (self.count[n] + 1) * n > TILE:
                    self.integrate_waiting(n)
        for n in range(1, MAX_POINTS + 1):
            if self.count[n] > 0:
                self.integrate_waiting(n)
        return True

    cdef bint integrate_near(self, int64_t source) noexcept:
        """Integrate for one source; tell whether it is not too close."""
        cdef int c, at = -1
        for c in range(3):
            if self.local[c] == self.nodes[source]:
                at = c
        self.put_side_by_side(&source, 1, at)
        if not integrate_near(&self.tile, &self.sums, &self.points, &self.element, self.pairs,
                              &self.side_by_side, at, &self.rules, self.poisson):
            return False
        self.add(&source, 1)
        return True

    cdef void integrate_waiting(self, int n) noexcept:
        """Integrate for sources that wait for a rule of n points."""
        cdef int count = self.count[n], rule = n * MAX_POINTS
        self.put_side_by_side(self.waiting[n], count, -1)
        integrate(&self.tile, &self.sums, &self.element, self.pairs, &self.side_by_side, count, -1,
                  n, self.rules.points + rule, self.rules.weights + rule, 0, self.poisson)
        self.add(self.waiting[n], count)
        self.count[n] = 0

    cdef void put_side_by_side(self, const int64_t *sources, int count, int at) noexcept:
        cdef Sources *s = &self.side_by_side
        cdef int i
        cdef int64_t source
        for i in range(count + VECTOR):  # the last is repeated, for whole vectors
            source = sources[i if i < count else count - 1]
            s.r[i], s.z0[i] = self.sources[source, 0], self.sources[source, 2]
            s.a[i] = self.element.r - self.sources[source, 0] if at < 0 else 0.0
            s.b[i] = self.element.z - self.sources[source, 1] if at < 0 else 0.0

    cdef void add(self, const int64_t *sources, int count) noexcept:
        """Add integrals to the rows of sources."""
        cdef int64_t rows[STRESS_PAIRS][TILE]
        cdef int64_t column
        cdef int64_t *at
        cdef int pair, k, i, along_r = 2 * self.pairs // PAIRS
        for k in range(self.rows.shape[0]):
            for i in range(count):
                rows[k][i] = self.rows[k, sources[i]]
        for pair in range(self.pairs):
            for i in range(count):
                self.own[pair, sources[i]] += self.sums.own[pair][i]
            at = rows[pair if pair < along_r else pair - along_r]
            for k in range(4):
                column = self.columns[self.number, pair, k]
                if column >= 0:
                    add_to_column(&self.matrix[column], at, count,
                                  self.factors[self.number, pair, k], self.sums.of[pair][k])


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
    cdef const double[:, ::1] lines = np.hstack(
        [first, along, length, along[:, 1:] / length, -along[:, :1] / length])
    cdef const int64_t[:, ::1] elements = boundary.elements
    cdef Integrator work = Integrator()
    cdef Py_ssize_t e
    cdef int c
    work.sources, work.nodes, work.rows, work.columns = sources, nodes, rows, columns
    work.factors, work.matrix, work.rules, work.poisson = factors, matrix, _rules(rules), poisson
    work.pairs = work.columns.shape[1]
    along_r = 2 * work.pairs // PAIRS
    _need(
        work.pairs in (PAIRS, STRESS_PAIRS)
        and work.sources.shape[1] == elements.shape[1] == 3
        and work.nodes.shape[0] == work.rows.shape[1] == work.sources.shape[0]
        and work.columns.shape[0] == work.factors.shape[0] == elements.shape[0]
        and work.factors.shape[1] == work.pairs and 5 * work.rows.shape[0] == 3 * work.pairs
        and work.columns.shape[2] == work.factors.shape[2] == 4
        and (columns.max(axis=(0, 2))
             + np.vstack([rows[:along_r], rows]).max(axis=1, initial=-1)).max()
        < work.matrix.shape[0],
        "numbers of sources, elements, rows and columns that are in their arrays",
    )
    own = np.zeros((work.pairs, work.sources.shape[0]))
    work.own = own
    for e in range(elements.shape[0]):
        work.element = Element(lines[e, 0], lines[e, 1], lines[e, 2], lines[e, 3], lines[e, 4],
                               lines[e, 5], lines[e, 6])
        work.number = e
        for c in range(3):
            work.local[c] = elements[e, c]
        if not work.integrate():
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
    cdef Moments i = moments_of(r, a, b)
    return (i.i10, i.i11, i.i30, i.i31, i.i32, i.i50, i.i51, i.i52, i.i53,
            i.i70, i.i71, i.i72, i.i73, i.i74)


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
    cdef Integrator work = Integrator()
    for first in range(0, points.shape[1], TILE):
        count = min(<Py_ssize_t> TILE, points.shape[1] - first)
        for i in range(count):
            work.tile.r[i], work.tile.a[i] = points[0, first + i], points[1, first + i]
            work.tile.b[i] = points[2, first + i]
            work.tile.nr[i], work.tile.nz[i] = points[3, first + i], points[4, first + i]
        fill_kernels(&work.tile, pairs, count, poisson)
        for k in range(2 * pairs):
            for i in range(count):
                out[k, first + i] = work.tile.value[k][i]
    return values
