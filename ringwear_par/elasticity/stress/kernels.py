"""Ring kernels of the stress inside: Somigliana's stress identity integrated over a circle.

    sigma(x) = Int D t - S u dS,

with tractions t and displacements u on the boundary, and the source and the field point as in
``kernels``: x = (r, 0, z) inside the body, y = (r + a, z + b) on its boundary, s = sin(theta/2).
In the frame of x the components of R are X = a - 2 (r + a) s^2, Y = (r + a) sin(theta) and b; every
entry is a polynomial in s^2 of small numbers, times a moment I(p, q) with p = 3, 5 for D and up to
7 for S.

Young's modulus is 1: D has the unit 1/mm, S MPa/mm^2 for displacements at E = 1; both carry the
radius of ``dS``.
"""

import math

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.compiling import compiled
from ringwear_par.elasticity.bem.kernels import (
    TILE,
    Moments,
    is_small,
    moments_by_quadrature,
    moments_by_recursion,
)

#: rows of a tile: a, b, nr, nz and the twenty kernels
STRESS_TILE_ROWS = 24
#: those kernels: of rr, tt, zz, rz the two of r and z, and of rt, tz the one of theta
N_KERNELS = 10

_N_THETA = 10
_SIN2 = np.sin((np.arange(_N_THETA) + 0.5) * (0.5 * math.pi / _N_THETA)) ** 2

Sevenths = tuple[float, float, float, float, float]


@compiled(inline="always")
def _sevenths_by_recursion(i: Moments, r: float, a: float, b: float) -> Sevenths:
    i30, i50, i51, i52, i53 = i[2], i[5], i[6], i[7], i[8]
    near2 = a * a + b * b
    span2 = 4.0 * r * (r + a)
    far2 = near2 + span2
    inv = 1.0 / span2
    i70 = (4.0 * (far2 + near2) * i50 - 3.0 * i30) / (5.0 * near2 * far2)
    i71 = (i50 - near2 * i70) * inv
    i72 = (i51 - near2 * i71) * inv
    i73 = (i52 - near2 * i72) * inv
    i74 = (i53 - near2 * i73) * inv
    return i70, i71, i72, i73, i74


@compiled(inline="always")
def _sevenths_by_quadrature(r: float, a: float, b: float) -> Sevenths:
    near2 = a * a + b * b
    span2 = 4.0 * r * (r + a)
    i70 = i71 = i72 = i73 = i74 = 0.0
    for s2 in _SIN2:
        inv2 = 1.0 / (near2 + span2 * s2)
        w = math.sqrt(inv2) * inv2 * inv2 * inv2
        i70 += w
        i71 += w * s2
        i72 += w * s2**2
        i73 += w * s2**3
        i74 += w * s2**4
    c = 2.0 * math.pi / _N_THETA
    return c * i70, c * i71, c * i72, c * i73, c * i74


@compiled
def seventh_moments(r: float, a: float, b: float) -> Sevenths:
    """Return I(7,0), I(7,1), I(7,2), I(7,3), I(7,4); see ``kernels.moments``."""
    if is_small(r, a, b):
        return _sevenths_by_quadrature(r, a, b)
    return _sevenths_by_recursion(moments_by_recursion(r, a, b), r, a, b)


# a tuple of 20, which as a type is no easier to read than this sentence
@compiled(inline="always")
def _from_moments(i, sevenths, r, a, b, nr, nz, nu):  # noqa: ANN001, ANN202
    """Return D and S, each of rr, tt, zz, rz for loads along r, then along z; rt, tz for theta."""
    _, _, j0, j1, j2, k0, k1, k2, k3 = i  # I(3, q) and I(5, q)
    l0, l1, l2, l3, l4 = sevenths  # I(7, q)
    r1 = r + a
    # X = a - x1 s2,  P = R.e_r(y) = a + y1 s2,  N = R.n = n0 + n1 s2,  cos = 1 - 2 s2
    x1 = 2.0 * r1
    y1 = 2.0 * r
    n0 = nr * a + nz * b
    n1 = nr * y1
    # X P = a2 + q1 s2 + q2 s2^2,  X X,  X cos,  X X P
    a2 = a * a
    q1 = a * (y1 - x1)
    q2 = -x1 * y1
    h1 = -2.0 * a * x1
    h2 = x1 * x1
    c1 = -(x1 + 2.0 * a)
    c2 = 2.0 * x1
    e0 = a2 * a
    e1 = a * q1 - x1 * a2
    e2 = a * q2 - x1 * q1
    e3 = -x1 * q2
    # sin^2 = 4 (s2 - s2^2) against the moments
    sj = 4.0 * (j1 - j2)
    sk0, sk1 = 4.0 * (k1 - k2), 4.0 * (k2 - k3)
    b2 = b * b
    w1 = 1.0 - 2.0 * nu
    w4 = 1.0 - 4.0 * nu

    # of the third powers
    p3 = a * j0 + y1 * j1
    x3 = a * j0 - x1 * j1
    cos3 = j0 - 2.0 * j1
    cosx3 = a * j0 + c1 * j1 + c2 * j2
    coscos3 = j0 - 4.0 * j1 + 4.0 * j2
    # of the fifth powers
    p5 = a * k0 + y1 * k1
    x5 = a * k0 - x1 * k1
    cos5 = k0 - 2.0 * k1
    xp5 = a2 * k0 + q1 * k1 + q2 * k2
    xx5 = a2 * k0 + h1 * k1 + h2 * k2
    cosx5 = a * k0 + c1 * k1 + c2 * k2
    cosp5 = a * cos5 + y1 * (k1 - 2.0 * k2)
    cosxp5 = a2 * cos5 + q1 * (k1 - 2.0 * k2) + q2 * (k2 - 2.0 * k3)
    sinp5 = a * sk0 + y1 * sk1
    sinx5 = a * sk0 - x1 * sk1
    nk0 = n0 * k0 + n1 * k1
    nk1 = n0 * k1 + n1 * k2
    nk2 = n0 * k2 + n1 * k3
    np5 = a * nk0 + y1 * nk1
    nx5 = a * nk0 - x1 * nk1
    ncos5 = nk0 - 2.0 * nk1
    ncosx5 = a * nk0 + c1 * nk1 + c2 * nk2
    nsin5 = 4.0 * (nk1 - nk2)
    # of the seventh powers
    nl0 = n0 * l0 + n1 * l1
    nl1 = n0 * l1 + n1 * l2
    nl2 = n0 * l2 + n1 * l3
    nl3 = n0 * l3 + n1 * l4
    nsl0, nsl1 = 4.0 * (nl1 - nl2), 4.0 * (nl2 - nl3)

    cd = r1 * (1.0 / (8.0 * math.pi * (1.0 - nu)))
    d_rr_r = cd * (w1 * (2.0 * cosx3 - p3) + 3.0 * (e0 * k0 + e1 * k1 + e2 * k2 + e3 * k3))
    d_tt_r = cd * (w1 * (2.0 * r1 * sj - p3) + 3.0 * r1 * r1 * sinp5)
    d_zz_r = cd * (3.0 * b2 * p5 - w1 * p3)
    d_rz_r = cd * b * (w1 * cos3 + 3.0 * xp5)
    d_rr_z = cd * b * (3.0 * xx5 - w1 * j0)
    d_tt_z = cd * b * (3.0 * r1 * r1 * sk0 - w1 * j0)
    d_zz_z = cd * b * (3.0 * b2 * k0 + w1 * j0)
    d_rz_z = cd * (w1 * x3 + 3.0 * b2 * x5)
    d_rt = cd * (w1 * (cosx3 - r1 * sj) + 3.0 * r * r1 * sinx5)
    d_tz = cd * b * (w1 * cos3 + 3.0 * r * r1 * sk0)

    cs = r1 * (1.0 / (8.0 * math.pi * (1.0 - nu * nu)))
    common_r = 3.0 * w1 * np5 - w4 * nr * j0
    s_rr_r = cs * (
        common_r
        + 6.0 * nu * (ncosx5 + nr * cosxp5)
        - 15.0 * (e0 * nl0 + e1 * nl1 + e2 * nl2 + e3 * nl3)
        + w1 * nr * (3.0 * xx5 + 2.0 * coscos3)
    )
    s_tt_r = cs * (
        common_r
        + 6.0 * nu * r1 * (nsin5 + nr * sinp5)
        - 15.0 * r1 * r1 * (a * nsl0 + y1 * nsl1)
        + w1 * nr * (3.0 * r1 * r1 * sk0 + 2.0 * sj)
    )
    s_zz_r = cs * (
        common_r
        - 15.0 * b2 * (a * nl0 + y1 * nl1)
        + 6.0 * nu * nz * b * p5
        + 3.0 * w1 * nr * b2 * k0
    )
    s_rz_r = cs * (
        3.0 * nu * (b * (ncos5 + nr * cosp5) + nz * xp5)
        - 15.0 * b * (a2 * nl0 + q1 * nl1 + q2 * nl2)
        + w1 * (3.0 * nr * b * x5 + nz * cos3)
    )
    common_z = 3.0 * w1 * b * nk0 - w4 * nz * j0
    s_rr_z = cs * (
        common_z
        - 15.0 * b * (a2 * nl0 + h1 * nl1 + h2 * nl2)
        + 6.0 * nu * nr * b * cosx5
        + 3.0 * w1 * nz * xx5
    )
    s_tt_z = cs * (
        common_z
        - 15.0 * b * r1 * r1 * nsl0
        + 6.0 * nu * nr * b * r1 * sk0
        + 3.0 * w1 * nz * r1 * r1 * sk0
    )
    s_zz_z = cs * (
        common_z
        + 6.0 * nu * b * (nk0 + nz * b * k0)
        - 15.0 * b2 * b * nl0
        + w1 * nz * (3.0 * b2 * k0 + 2.0 * j0)
    )
    s_rz_z = cs * (
        3.0 * nu * (nx5 + b * (nr * b * cos5 + nz * x5))
        - 15.0 * b2 * (a * nl0 - x1 * nl1)
        + w1 * (3.0 * nz * b * x5 + nr * cos3)
    )
    s_rt = cs * (
        3.0 * nu * (ncosx5 - r1 * nsin5 + nr * r * (r1 * (sk0 - 2.0 * sk1) + sinx5))
        - 15.0 * r * r1 * (a * nsl0 - x1 * nsl1)
        + w1 * nr * (coscos3 - sj)
    )
    s_tz = cs * (
        3.0 * nu * (b * ncos5 + r * (nr * b + nz * r1) * sk0)
        - 15.0 * b * r * r1 * nsl0
        + w1 * nz * cos3
    )
    return (
        d_rr_r, d_tt_r, d_zz_r, d_rz_r, d_rr_z, d_tt_z, d_zz_z, d_rz_z, d_rt, d_tz,
        s_rr_r, s_tt_r, s_zz_r, s_rz_r, s_rr_z, s_tt_z, s_zz_z, s_rz_z, s_rt, s_tz,
    )  # fmt: skip


# contraction as in ``kernels.fill_tile``
@compiled(fastmath={"contract"}, error_model="numpy")
def fill_stress_tile(tile: FloatArray, count: int, r: float, nu: float) -> None:
    """Set the stress kernels of the first field points of a tile, those of one source.

    Parameters
    ----------
    tile : (STRESS_TILE_ROWS * TILE,) float, one row behind the other: a, b, nr, nz; D of rr, tt,
        zz, rz for tractions along r, then along z, and of rt, tz along theta; S likewise.
    count : number of field points, at most TILE.
    r, nu : radius of the source, Poisson's ratio.
    """
    small = 0
    for i in range(count):
        a, b, nr, nz = tile[i], tile[TILE + i], tile[2 * TILE + i], tile[3 * TILE + i]
        first = moments_by_recursion(r, a, b)
        values = _from_moments(first, _sevenths_by_recursion(first, r, a, b), r, a, b, nr, nz, nu)
        tile[4 * TILE + i] = values[0]
        tile[5 * TILE + i] = values[1]
        tile[6 * TILE + i] = values[2]
        tile[7 * TILE + i] = values[3]
        tile[8 * TILE + i] = values[4]
        tile[9 * TILE + i] = values[5]
        tile[10 * TILE + i] = values[6]
        tile[11 * TILE + i] = values[7]
        tile[12 * TILE + i] = values[8]
        tile[13 * TILE + i] = values[9]
        tile[14 * TILE + i] = values[10]
        tile[15 * TILE + i] = values[11]
        tile[16 * TILE + i] = values[12]
        tile[17 * TILE + i] = values[13]
        tile[18 * TILE + i] = values[14]
        tile[19 * TILE + i] = values[15]
        tile[20 * TILE + i] = values[16]
        tile[21 * TILE + i] = values[17]
        tile[22 * TILE + i] = values[18]
        tile[23 * TILE + i] = values[19]
        small += is_small(r, a, b)
    if small == 0:
        return
    for i in range(count):
        a, b = tile[i], tile[TILE + i]
        if is_small(r, a, b):
            _fill_near_axis(tile, i, r, a, b, nu)


@compiled
def _fill_near_axis(tile: FloatArray, i: int, r: float, a: float, b: float, nu: float) -> None:
    values = _from_moments(
        moments_by_quadrature(r, a, b), _sevenths_by_quadrature(r, a, b), r, a, b,
        tile[2 * TILE + i], tile[3 * TILE + i], nu,
    )  # fmt: skip
    for k in range(2 * N_KERNELS):
        tile[(4 + k) * TILE + i] = values[k]
