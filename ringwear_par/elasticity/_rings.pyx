# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Rows of the boundary equation and of stresses: integrals of ring kernels over elements.

The kernels and the integrals are in ``_rings.h``. Sources that take the same rule of an element are
integrated side by side, so that the processor's vector instructions serve them; those on an
element, or so close to it that it is cut in parts, one by one.
"""

import numpy as np

from libc.math cimport sqrt
from libc.stdint cimport int64_t

cdef extern from "_rings.h" nogil:
    enum: TILE, VECTOR, ROW, MAX_POINTS, MOST_POINTS, RING_KERNELS, STRESS_KERNELS, OWN
    ctypedef struct Tile:
        double r[ROW]
        double a[ROW]
        double b[ROW]
        double nr[ROW]
        double nz[ROW]
        double value[STRESS_KERNELS][ROW]
    ctypedef struct Integrals:
        double u[5][ROW]
        double t[5][3][ROW]
        double own[OWN][ROW]
    ctypedef struct Element:
        double r, z, dr, dz, length, nr, nz
    ctypedef struct Rules:
        const double *reach
        const double *points
        const double *weights
        const double *singular_points
        const double *singular_weights
    ctypedef struct Points:
        int count
        double place[MOST_POINTS]
        double weight[MOST_POINTS]
    ctypedef struct Moments:
        double i10, i11, i30, i31, i32, i50, i51, i52, i53, i70, i71, i72, i73, i74
    Moments moments_by_recursion(double r, double a, double b)
    Moments moments_by_quadrature(double r, double a, double b)
    int is_small(double r, double a, double b)
    void fill_ring_kernels(Tile *tile, int count, double nu)
    void fill_stress_kernels(Tile *tile, int count, double nu)
    void weighted_shapes(double t, double weight, double *s)
    int add_points(Points *points, const Rules *rules, const Element *e, double ar, double az,
                   double start, double end, int depth)
    void add_to_column(double *column, const int64_t *rows, int count, double factor,
                       const double *integrals)
    void integrate(Tile *tile, Integrals *sums, const Element *e, int count, const double *r,
                   const double *z, int n, const Rules *rules, double nu)
    int integrate_near(Tile *tile, Integrals *sums, Points *points, const Element *e, double r,
                       double z, int at, const Rules *rules, double nu)


cdef class Workspace:
    """Field points and their kernels, points on an element, and rules of quadrature."""

    cdef Tile tile
    cdef Points points
    cdef Rules rules
    cdef object quadrature

    def __cinit__(self, quadrature=None):
        cdef int i
        for i in range(ROW):  # kernels are computed for whole vectors of points
            self.tile.r[i] = self.tile.a[i] = self.tile.b[i] = self.tile.nr[i] = 1.0
            self.tile.nz[i] = 0.0
        if quadrature is not None:
            self.quadrature = quadrature  # what is pointed to stays
            self.rules = _rules(quadrature)


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


cdef _need(bint fits, what):
    """Refuse arrays that do not fit each other: they would be read and written beyond."""
    if not fits:
        raise ValueError(f"integrals over elements need {what}")


def _lines(nodes, elements):
    """Return (k, 7) float: first node r and z, vector, length, outward normal of elements."""
    first = nodes[elements[:, 0]]
    along = nodes[elements[:, 2]] - first
    length = np.hypot(along[:, 0], along[:, 1])[:, None]
    return np.hstack([first, along, length, along[:, 1:] / length, -along[:, :1] / length])


cdef Element _element(const double[:, ::1] lines, Py_ssize_t e) noexcept:
    return Element(lines[e, 0], lines[e, 1], lines[e, 2], lines[e, 3], lines[e, 4], lines[e, 5],
                   lines[e, 6])


# ---- kernels at points ----

def moments(double r, double a, double b):
    """Return I(1,0), I(1,1), I(3,0) to I(3,2), I(5,0) to I(5,3) and I(7,0) to I(7,4).

    Parameters
    ----------
    r : radius of the source, mm, >= 0.
    a, b : radial and axial offset of the field point, mm, not both zero.
    """
    cdef Moments i
    i = moments_by_quadrature(r, a, b) if is_small(r, a, b) else moments_by_recursion(r, a, b)
    return (i.i10, i.i11, i.i30, i.i31, i.i32, i.i50, i.i51, i.i52, i.i53,
            i.i70, i.i71, i.i72, i.i73, i.i74)


def ring_kernels(points, poisson):
    """Return U_rr, U_rz, U_zr, U_zz, U_tt, T_rr, T_rz, T_zr, T_zz, T_tt, (10, p) float.

    The first letter is the direction of the force at the source, the second the component at the
    field point; ``t`` stands for theta, which uncouples. U in 1/MPa at E = 1, T in 1; both carry
    the ``r1`` of ``dS = r1 dtheta ds``.

    Parameters
    ----------
    points : (5, p) float, radius of the source, offsets a and b of the field point, mm, and the
        normal there, along r and z.
    poisson : Poisson's ratio.
    """
    return _kernels(points, poisson, False)


def stress_kernels(points, poisson):
    """Return the kernels D and S of stresses, (20, p) float.

    D of rr, tt, zz, rz for tractions along r, then along z, and of rt, tz along theta; then S of
    displacements likewise. Parameters are those of ``ring_kernels``.
    """
    return _kernels(points, poisson, True)


cdef _kernels(const double[:, ::1] points, double poisson, bint stress):
    _need(points.shape[0] == 5, "five numbers of each point")
    cdef int n_kernels = STRESS_KERNELS if stress else RING_KERNELS
    values = np.empty((n_kernels, points.shape[1]))
    cdef double[:, ::1] out = values
    cdef Py_ssize_t first, i, k, count
    cdef Workspace work = Workspace()
    for first in range(0, points.shape[1], TILE):
        count = min(<Py_ssize_t> TILE, points.shape[1] - first)
        for i in range(count):
            work.tile.r[i], work.tile.a[i] = points[0, first + i], points[1, first + i]
            work.tile.b[i] = points[2, first + i]
            work.tile.nr[i], work.tile.nz[i] = points[3, first + i], points[4, first + i]
        if stress:
            fill_stress_kernels(&work.tile, count, poisson)
        else:
            fill_ring_kernels(&work.tile, count, poisson)
        for k in range(n_kernels):
            for i in range(count):
                out[k, first + i] = work.tile.value[k][i]
    return values


# ---- rows of the boundary equation ----

cdef enum:
    PAIRS = 5  # rr, rz, zr, zz, theta theta: force at the source and component on the element
    SUMS = 25  # of an element: for each pair displacements of three nodes, traction, load

cdef int[PAIRS] FORCE = [0, 0, 1, 1, 2]
cdef int[PAIRS] COMPONENT = [0, 1, 0, 1, 2]


cdef class Assembler(Workspace):
    """Rows of both systems, to which the integrals over elements are added.

    The source's own column needs no integrals: shape functions sum to one, and to radius or height
    when they are weighted with that of their nodes, so that the rigid or constant-strain field that
    is subtracted (see ``assembly``) is a sum over the columns of the other nodes.
    """

    cdef double poisson
    cdef const double[:, ::1] nodes
    # (3, m), rows of the matrices for forces along r, z and theta at a node, -1 for none
    cdef const int64_t[:, ::1] rows
    # (OWN, m), entries of nodes' own columns, see ``_rings.h``
    cdef double[:, ::1] own
    # the matrices, transposed
    cdef double[:, ::1] normal
    cdef double[:, ::1] torsion
    # the element and its nodes, its integrals, and to which columns they are added
    cdef Element element
    cdef int64_t local[3]
    cdef Integrals sums
    cdef int listed
    cdef int force[SUMS]
    cdef double *column[SUMS]
    cdef double *integral[SUMS]
    cdef double factor[SUMS]
    # sources that wait to be integrated side by side, by the points of their rule
    cdef int64_t waiting[MAX_POINTS + 1][TILE]
    cdef int count[MAX_POINTS + 1]

    cdef void list_sum(self, int pair, int64_t column, double factor, double *integral) noexcept:
        """List that an integral is added to a column, unless there is none."""
        cdef int k = self.listed
        if column >= 0:
            self.force[k], self.factor[k], self.integral[k] = FORCE[pair], factor, integral
            self.column[k] = &self.normal[column, 0] if pair < 4 else &self.torsion[column, 0]
            self.listed += 1

    cdef int64_t integrate(self, const int64_t[::1] sources) noexcept:
        """Add the integrals over the element; return kernel evaluations, -1: one is too close."""
        cdef const Element *e = &self.element
        cdef const double *reach = self.rules.reach
        cdef double ar, az, ratio
        cdef int64_t source, evaluations = 0
        cdef Py_ssize_t i
        cdef int added, n = 1
        for i in range(ROW):
            self.tile.nr[i], self.tile.nz[i] = e.nr, e.nz
        for i in range(sources.shape[0]):
            source = sources[i]
            ar, az = e.r - self.nodes[source, 0], e.z - self.nodes[source, 1]
            ratio = sqrt(ar * ar + az * az)
            ar, az = ar + e.dr, az + e.dz
            ratio = (ratio + sqrt(ar * ar + az * az)) / e.length
            while n > 1 and reach[n - 1] <= ratio:  # from the last source's rule: often the same
                n -= 1
            while n <= MAX_POINTS and reach[n] > ratio:
                n += 1
            if n > MAX_POINTS:
                added = self.integrate_near(source)
                if added < 0:
                    return -1
                evaluations += added
            else:
                self.waiting[n][self.count[n]] = source
                self.count[n] += 1
                if (self.count[n] + 1) * n > TILE:
                    evaluations += self.integrate_waiting(n)
        for n in range(1, MAX_POINTS + 1):
            evaluations += self.integrate_waiting(n)
        return evaluations

    cdef int integrate_near(self, int64_t source) noexcept:
        """Integrate for one source; return kernel evaluations, -1: it is too close."""
        cdef int c, added, at = -1
        for c in range(3):
            if self.local[c] == source:
                at = c
        added = integrate_near(&self.tile, &self.sums, &self.points, &self.element,
                               self.nodes[source, 0], self.nodes[source, 1], at, &self.rules,
                               self.poisson)
        if added >= 0:
            self.add(&source, 1)
        return added

    cdef int integrate_waiting(self, int n) noexcept:
        """Integrate for sources that wait for a rule of n points; return kernel evaluations."""
        cdef int i, count = self.count[n]
        cdef int64_t source
        cdef double r[ROW]
        cdef double z[ROW]
        if count == 0:
            return 0
        for i in range(count + VECTOR):  # the last is repeated, for whole vectors
            source = self.waiting[n][i if i < count else count - 1]
            r[i], z[i] = self.nodes[source, 0], self.nodes[source, 1]
        integrate(&self.tile, &self.sums, &self.element, count, r, z, n, &self.rules, self.poisson)
        self.add(self.waiting[n], count)
        self.count[n] = 0
        return n * count

    cdef void add(self, const int64_t *sources, int count) noexcept:
        """Add integrals to the rows of sources."""
        cdef int64_t rows[3][TILE]
        cdef int force, k, i
        for force in range(3):
            for i in range(count):
                rows[force][i] = self.rows[force, sources[i]]
        for k in range(self.listed):
            add_to_column(self.column[k], rows[self.force[k]], count, self.factor[k],
                          self.integral[k])
        for k in range(OWN):
            for i in range(count):
                self.own[k, sources[i]] += self.sums.own[k][i]


def assemble_rows(first_node, last_node, boundary, conditions, dofs, double young, double poisson,
                  rules, starts, widths, double[:, ::1] normal, double[:, ::1] torsion):
    """Add to the rows collocated at nodes first_node <= p < last_node; return kernel evaluations.

    -1: some nodes and elements are too close to each other to be integrated.

    Parameters
    ----------
    boundary : BoundaryMesh, and further BoundaryConditions, DofMap.
    young, poisson : modulus over the one that tractions are scaled with, Poisson's ratio.
    rules : Quadrature.
    starts : number of the first row of each matrix.
    widths : number of unknowns of the (r, z) and of the theta system.
    normal, torsion : their matrices, transposed, row-major, and behind the last unknown the loads.

    Raises
    ------
    ValueError : arrays do not fit each other.
    """
    cdef const double[:, ::1] nodes = boundary.nodes, value = conditions.traction
    cdef const double[:, ::1] lines = _lines(boundary.nodes, boundary.elements)
    cdef const int64_t[:, ::1] elements = boundary.elements, displacement = dofs.displacement
    cdef const int64_t[:, ::1] traction = dofs.traction, load = conditions.load
    cdef const double[::1] sign = dofs.sign
    cdef Py_ssize_t e, p, m = nodes.shape[0]
    cdef int64_t added, column, evaluations = 0
    cdef int pair, c, i
    cdef double inverse, soft = 1.0 / young
    chosen = (np.arange(m) >= first_node) & (np.arange(m) < last_node)
    equations = np.ascontiguousarray(dofs.equation.T)
    first_rows = np.array([starts[0], starts[0], starts[1]])[:, None]
    equations = np.where(chosen & (equations >= 0), equations - first_rows, -1)
    sources = np.flatnonzero((equations >= 0).any(axis=0))
    _need(
        nodes.shape[1] == 2 and elements.shape[1] == traction.shape[1] == load.shape[1] == 3
        and displacement.shape[0] == m and displacement.shape[1] == value.shape[1] == 3
        and lines.shape[0] == traction.shape[0] == load.shape[0] == value.shape[0] == sign.shape[0]
        and boundary.elements.min() >= 0 and boundary.elements.max() < m
        and conditions.load.max() < conditions.n_loads
        and all(
            matrix.shape[0] >= width + conditions.n_loads
            and equations[at].max() < matrix.shape[1]
            and max(dofs.displacement[:, at].max(), dofs.traction[:, at].max()) < width
            for matrix, width, at in zip((normal, torsion), widths, (slice(2), slice(2, 3)))
        ),
        "numbers of nodes, rows and columns that are in their arrays",
    )
    cdef Assembler matrices = Assembler(rules)
    cdef const int64_t[:, ::1] rows = equations
    cdef int64_t loads[2]
    matrices.poisson, matrices.nodes, matrices.rows = poisson, nodes, rows
    matrices.own, matrices.normal, matrices.torsion = np.zeros((OWN, m)), normal, torsion
    loads[0], loads[1] = widths
    for e in range(elements.shape[0]):
        matrices.element, matrices.listed = _element(lines, e), 0
        for c in range(3):
            matrices.local[c] = elements[e, c]
        for pair in range(PAIRS):
            i = COMPONENT[pair]
            for c in range(3):
                column = displacement[elements[e, c], i]
                matrices.list_sum(pair, column, 1.0, matrices.sums.t[pair][c])
            matrices.list_sum(pair, traction[e, i], -sign[e] * soft, matrices.sums.u[pair])
            column = loads[pair // 4] + load[e, i] if load[e, i] >= 0 else -1
            matrices.list_sum(pair, column, soft * value[e, i], matrices.sums.u[pair])
        added = matrices.integrate(sources)
        if added < 0:
            return -1
        evaluations += added
    for p in sources:
        inverse = 1.0 / nodes[p, 0] if nodes[p, 0] > 0.0 else 0.0  # on the axis u_r = u_theta = 0
        for i in range(2):
            if rows[i, p] >= 0 and displacement[p, 0] >= 0:
                normal[displacement[p, 0], rows[i, p]] += inverse * matrices.own[2 * i, p]
            if rows[i, p] >= 0 and displacement[p, 1] >= 0:
                normal[displacement[p, 1], rows[i, p]] += matrices.own[2 * i + 1, p]
        if rows[2, p] >= 0 and displacement[p, 2] >= 0:
            torsion[displacement[p, 2], rows[2, p]] += inverse * matrices.own[4, p]
    return evaluations


# ---- rows of stresses ----

cdef class StressRows(Workspace):
    """What tractions and displacements of a boundary say of the stress at a point inside."""

    # (4, 2 m + 2 k) and (2, m + k), see ``stress_rows``
    cdef double[:, ::1] normal
    cdef double[:, ::1] torsion
    cdef const int64_t[:, ::1] elements
    cdef Py_ssize_t m
    cdef double poisson
    # of the field points in the tile: how many, their elements, places there, weights
    cdef int count
    cdef int64_t element[TILE]
    cdef double place[TILE]
    cdef double weight[TILE]

    cdef int integrate(self, Element e, int64_t number, double r, double z) noexcept:
        """Put points on an element in the tile; return how many, -1: it is too close."""
        cdef double ar = e.r - r, az = e.z - z
        cdef int q, i
        self.points.count = 0
        if not add_points(&self.points, &self.rules, &e, ar, az, 0.0, 1.0, 0):
            return -1
        for q in range(self.points.count):
            i = self.count
            self.tile.r[i] = r
            self.tile.a[i] = ar + self.points.place[q] * e.dr
            self.tile.b[i] = az + self.points.place[q] * e.dz
            self.tile.nr[i], self.tile.nz[i] = e.nr, e.nz
            self.element[i], self.place[i] = number, self.points.place[q]
            self.weight[i] = self.points.weight[q]
            self.count += 1
            if self.count == TILE:
                self.add_tile()
        return self.points.count

    cdef void add_tile(self) noexcept:
        """Add the points in the tile to the columns of their elements."""
        cdef int i, c, row
        cdef int64_t e, node
        cdef double w
        cdef double s[3]
        fill_stress_kernels(&self.tile, self.count, self.poisson)
        for i in range(self.count):
            e, w = self.element[i], self.weight[i]
            weighted_shapes(self.place[i], w, s)
            for row in range(4):
                self.normal[row, 2 * (self.m + e)] += w * self.tile.value[row][i]
                self.normal[row, 2 * (self.m + e) + 1] += w * self.tile.value[4 + row][i]
            for row in range(2):
                self.torsion[row, self.m + e] += w * self.tile.value[8 + row][i]
            for c in range(3):
                node = self.elements[e, c]
                for row in range(4):
                    self.normal[row, 2 * node] -= s[c] * self.tile.value[10 + row][i]
                    self.normal[row, 2 * node + 1] -= s[c] * self.tile.value[14 + row][i]
                for row in range(2):
                    self.torsion[row, node] -= s[c] * self.tile.value[18 + row][i]
        self.count = 0


def stress_rows(const double[:, ::1] points, const int64_t[::1] nearest, boundary, double poisson,
                rules, double[:, :, ::1] normal, double[:, :, ::1] torsion):
    """Set the rows of stresses at points inside a body; return kernel evaluations.

    -1: some points and elements are too close to each other to be integrated.

    The elements are those of ``assemble_rows``: displacements quadratic, tractions constant. The
    integrands are smooth, but steep close to the boundary, where elements are halved until their
    parts are not. What is left of the quadrature's error is multiplied by u - u*, with the field
    u* = c e + d e_z + w r e_theta, e = r e_r - 2 nu / (1 - nu) (z - z0) e_z, that agrees with u at
    the nearest node, at z0; its stress, known, is added again, and finite for all nu.

    Parameters
    ----------
    points : (p, 2) float, mm, inside and not on the boundary.
    nearest : (p,) int, the nearest node of each.
    boundary : BoundaryMesh of m nodes and k elements.
    poisson : Poisson's ratio; Young's modulus is 1.
    rules : Quadrature.
    normal : (p, 4, 2 m + 2 k) float, set: stresses rr, tt, zz, rz for the displacements r, z of
        each node, then for the tractions r, z of each element.
    torsion : (p, 2, m + k) float, set: rt, tz for the theta ones.

    Raises
    ------
    ValueError : arrays do not fit each other.
    """
    cdef const double[:, ::1] nodes = boundary.nodes
    cdef const double[:, ::1] lines = _lines(boundary.nodes, boundary.elements)
    cdef Py_ssize_t p, e, m = nodes.shape[0], k = lines.shape[0]
    cdef int64_t added, evaluations = 0
    _need(
        nodes.shape[1] == points.shape[1] == 2
        and nearest.shape[0] == normal.shape[0] == torsion.shape[0] == points.shape[0]
        and normal.shape[1] == 4 and normal.shape[2] == 2 * (m + k)
        and torsion.shape[1] == 2 and torsion.shape[2] == m + k
        and all(np.min(a) >= 0 and np.max(a) < m for a in (boundary.elements, nearest)),
        "points, nodes and elements that are in their arrays",
    )
    cdef StressRows rows = StressRows(rules)
    rows.elements, rows.m, rows.poisson = boundary.elements, m, poisson
    normal[:] = 0.0
    torsion[:] = 0.0
    for p in range(points.shape[0]):
        rows.normal, rows.torsion = normal[p], torsion[p]
        for e in range(k):
            added = rows.integrate(_element(lines, e), e, points[p, 0], points[p, 1])
            if added < 0:
                return -1
            evaluations += added
        rows.add_tile()
    _add_own_columns(boundary.nodes, np.asarray(nearest), poisson, np.asarray(lines)[:, 5],
                     np.asarray(normal), np.asarray(torsion))
    return evaluations


def _add_own_columns(nodes, nearest, poisson, radial_normal, normal, torsion):
    """Subtract the integrals over u*, t* of the nearest nodes, and add the stress of u*."""
    m, r, z = len(nodes), nodes[nearest, 0], nodes[nearest, 1]
    # stresses rr = tt of u_r = r where zz is 0, and minus the strain along z
    across, lateral = 1.0 / (1.0 - poisson), 2.0 * poisson / (1.0 - poisson)
    star, axial = np.zeros((2, normal.shape[2]))
    star[: 2 * m : 2], star[1 : 2 * m : 2] = nodes[:, 0], -lateral * nodes[:, 1]
    star[2 * m :: 2], axial[1 : 2 * m : 2] = across * radial_normal, 1.0
    along = normal @ axial
    total = normal @ star + (lateral * z)[:, None] * along
    inverse = np.divide(1.0, r, where=r > 0.0, out=np.zeros_like(r))[:, None]  # 0 on the axis
    points = np.arange(len(nearest))
    normal[points, :, 2 * nearest + 1] -= along
    normal[points, :, 2 * nearest] += inverse * (across * np.array([1.0, 1.0, 0.0, 0.0]) - total)
    torsion[points, :, nearest] -= inverse * (torsion[:, :, :m] @ nodes[:, 0])
