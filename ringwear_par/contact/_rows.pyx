# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, language_level=3
"""Contacts of B histories, one after another, in C; see ``block``."""

import numpy as np

from libc.stdint cimport int64_t

cdef extern from "_rows.h":
    ctypedef struct Line:
        int n, w, by_force
        const double *c
        const double *area
        const double *diagonal
    int solve_contact(const Line *l, const double *gap, double load, const double *konst, const double *slope,
                      long stride, double relative, double depth, double *p, double *d, double *work) nogil
    double conjugate_gradients(const Line *l, const double *inverse, const double *slope, double share,
                               double *g, double *x, double *work) nogil


def aligned(*shape):
    """Return an array that begins at a multiple of 64 bytes, as vectors of registers do."""
    room = np.empty(int(np.prod(shape)) + 8)
    start = -room.ctypes.data // 8 % 8
    return room[start : start + int(np.prod(shape))].reshape(shape)


cdef void combine(const double[:, :, :, ::1] units, const int64_t[::1] pair, const double[:, ::1] softness,
                  int b, double[:, ::1] c) noexcept nogil:
    """Set the compliance of a history, unless the one before has the same."""
    cdef int i, j, n = c.shape[0]
    if b and pair[b] == pair[b - 1] and softness[b, 0] == softness[b - 1, 0] and softness[b, 1] == softness[b - 1, 1]:
        return
    for j in range(n):
        for i in range(n):
            c[j, i] = softness[b, 0] * units[pair[b], 0, j, i] + softness[b, 1] * units[pair[b], 1, j, i]


def solve(compliance, const double[:, ::1] gap, const double[::1] load, bint by_force,
          const double[:, :, ::1] konst, const double[:, :, ::1] slope, double relative,
          const double[::1] depth, double[:, ::1] p, double[::1] d, int[::1] sets):
    """Solve contacts in place, from p (B, n) and d (B,) near them.

    ``konst`` and ``slope`` (w, B, n) are lines of wear, mm and mm/MPa; ``relative`` and ``depth``
    (B,) errors of pressures, over the largest of a history, and of gaps, mm. ``sets`` is set to how
    many sets of elements each took, -1 where it is not solved.
    """
    cdef const double[:, :, :, ::1] units = compliance.line.columns
    cdef const int64_t[::1] pair = compliance.pair
    cdef const double[:, ::1] softness = compliance.softness, diagonal = compliance.diagonal
    cdef const double[::1] area = compliance.line.area
    cdef int b, n = area.shape[0], count = gap.shape[0], w = konst.shape[0]
    assert p.shape[0] == d.shape[0] == sets.shape[0] == load.shape[0] == pair.shape[0] == depth.shape[0] == count
    assert gap.shape[1] == p.shape[1] == diagonal.shape[1] == units.shape[2] == n
    assert w == 0 or (konst.shape[1] == slope.shape[1] == count and konst.shape[2] == slope.shape[2] == n)
    cdef double[:, ::1] c = aligned(n, n), work = aligned(7, n)
    cdef Line line = Line(n, w, by_force, &c[0, 0], &area[0], NULL)
    with nogil:
        for b in range(count):
            combine(units, pair, softness, b, c)
            line.diagonal = &diagonal[b, 0]
            sets[b] = solve_contact(&line, &gap[b, 0], load[b], &konst[0, b, 0] if w else NULL,
                                    &slope[0, b, 0] if w else NULL, count * n, relative, depth[b],
                                    &p[b, 0], &d[b], &work[0, 0])


def respond(compliance, bint by_force, const double[:, ::1] inverse, const double[:, ::1] slope,
            double share, double[:, ::1] g, double[:, ::1] x):
    """Set the changes x of pressures as gaps grow by g, which is overwritten, (B, n).

    (C + slope) x - y = -g on elements in contact, area . x = 0 or y = 0, until residuals are a
    share of those at x = 0. The inverse is that of the diagonal of C + slope, 0 on other elements.
    """
    cdef const double[:, :, :, ::1] units = compliance.line.columns
    cdef const int64_t[::1] pair = compliance.pair
    cdef const double[:, ::1] softness = compliance.softness
    cdef const double[::1] area = compliance.line.area
    cdef int b, n = area.shape[0], count = g.shape[0]
    assert x.shape[0] == slope.shape[0] == inverse.shape[0] == pair.shape[0] == count
    assert g.shape[1] == x.shape[1] == slope.shape[1] == inverse.shape[1] == n
    cdef double[:, ::1] c = aligned(n, n), work = aligned(2, n)
    cdef Line line = Line(n, 0, by_force, &c[0, 0], &area[0], NULL)
    with nogil:
        for b in range(count):
            combine(units, pair, softness, b, c)
            conjugate_gradients(&line, &inverse[b, 0], &slope[b, 0], share, &g[b, 0], &x[b, 0], &work[0, 0])
