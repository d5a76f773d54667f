"""Ring kernels: the Kelvin solution integrated over a circle, eq. (5) of the paper.

The source is a point ``x = (r, 0, z)``; the field point runs over the circle through
``y = (r + a, z + b)`` with outward normal ``n = (nr, nz)``. With ``s = sin(theta/2)``,

    R^2 = a^2 + b^2 + 4 r (r + a) s^2,
    R . e_r(x) = a - 2 (r + a) s^2,   R . e_r(y) = a + 2 r s^2,

so that every entry is a sum of products of small numbers with the moments

    I(p, q) = Int_0^2pi  s^(2q) / R^p  dtheta,

and nothing cancels as ``y`` comes close to ``x``. Offsets ``a`` and ``b`` are arguments, never
differences of rounded coordinates: the caller forms them from the element's local parameter.

Lengths are in mm, Young's modulus is 1 (displacements scale by 1/E).
"""

import math

import numpy as np

from ringwear_par.elasticity.compiling import compiled

#: below this parameter m = 4 r r1 / S^2 the moments come from quadrature in theta: the recursions
#: divide by m once for each power of s^2
SMALL_PARAMETER = 0.3
_N_THETA = 8
_SIN2 = np.sin((np.arange(_N_THETA) + 0.5) * (0.5 * math.pi / _N_THETA)) ** 2

Moments = tuple[float, float, float, float, float, float, float, float, float]
RingKernels = tuple[float, float, float, float, float, float, float, float, float, float]


@compiled(inline="always")
def elliptic(m1: float) -> tuple[float, float]:
    """Return the complete elliptic integrals K and E of parameter ``1 - m1``, 0 < m1 <= 1.

    Arithmetic-geometric mean; the complementary parameter is the argument because it, and not
    ``1 - m1``, is known to full precision when the field point is close to the source.
    """
    x, y = 1.0, math.sqrt(m1)
    total, power = 0.5 * (1.0 - m1), 0.5
    while True:
        c = 0.5 * (x - y)
        x, y = x - c, math.sqrt(x * y)
        power *= 2.0
        total += power * c * c
        if c < 1e-8 * x:  # quadratic convergence: the next correction is below round-off
            break
    big_k = 0.5 * math.pi / (0.5 * (x + y))
    return big_k, big_k * (1.0 - total)


@compiled
def moments(r: float, a: float, b: float) -> Moments:
    """Return I(1,0), I(1,1), I(3,0), I(3,1), I(3,2), I(5,0), I(5,1), I(5,2), I(5,3).

    Parameters
    ----------
    r : radius of the source, mm, >= 0.
    a, b : radial and axial offset of the field point, mm, not both zero.
    """
    near2 = a * a + b * b
    span2 = 4.0 * r * (r + a)
    far2 = near2 + span2
    if span2 < SMALL_PARAMETER * far2:
        i10 = i11 = i30 = i31 = i32 = i50 = i51 = i52 = i53 = 0.0
        for s2 in _SIN2:
            inv2 = 1.0 / (near2 + span2 * s2)
            w1 = math.sqrt(inv2)
            w3 = w1 * inv2
            w5 = w3 * inv2
            i10 += w1
            i11 += w1 * s2
            i30 += w3
            i31 += w3 * s2
            i32 += w3 * s2 * s2
            i50 += w5
            i51 += w5 * s2
            i52 += w5 * s2 * s2
            i53 += w5 * s2 * s2 * s2
        c = 2.0 * math.pi / _N_THETA
        return c * i10, c * i11, c * i30, c * i31, c * i32, c * i50, c * i51, c * i52, c * i53
    far = math.sqrt(far2)
    big_k, big_e = elliptic(near2 / far2)
    inv = 1.0 / span2
    i10 = 4.0 * big_k / far
    i11 = (4.0 * far * big_e - near2 * i10) * inv
    i30 = 4.0 * big_e / (far * near2)
    i31 = (i10 - near2 * i30) * inv
    i32 = (i11 - near2 * i31) * inv
    i50 = (2.0 * (far2 + near2) * i30 - i10) / (3.0 * far2 * near2)
    i51 = (i30 - near2 * i50) * inv
    i52 = (i31 - near2 * i51) * inv
    i53 = (i32 - near2 * i52) * inv
    return i10, i11, i30, i31, i32, i50, i51, i52, i53


@compiled
def ring_kernels(r: float, a: float, b: float, nr: float, nz: float, nu: float) -> RingKernels:
    """Return U_rr, U_rz, U_zr, U_zz, T_rr, T_rz, T_zr, T_zz, U_tt, T_tt.

    The first letter is the direction of the force at the source, the second the component at the
    field point; ``t`` stands for theta, which uncouples. U in 1/MPa at E = 1, T in 1; both carry
    the ``r1`` of ``dS = r1 dtheta ds``.
    """
    i10, i11, i30, i31, i32, i50, i51, i52, i53 = moments(r, a, b)
    r1 = r + a
    # R.e_r(x) = a - x1 s2,  R.e_r(y) = a + y1 s2,  R.n = n0 + n1 s2,  n.e_r(x) = nr - 2 nr s2
    x1 = 2.0 * r1
    y1 = 2.0 * r
    n0 = nr * a + nz * b
    n1 = nr * y1
    # product of the two projections: a^2 + q1 s2 + q2 s2^2
    q1 = a * (y1 - x1)
    q2 = -x1 * y1

    shear = 0.5 / (1.0 + nu)
    cu = r1 / (16.0 * math.pi * shear * (1.0 - nu))
    k1 = 3.0 - 4.0 * nu
    u_rr = cu * (k1 * (i10 - 2.0 * i11) + a * a * i30 + q1 * i31 + q2 * i32)
    u_rz = cu * b * (a * i30 - x1 * i31)
    u_zr = cu * b * (a * i30 + y1 * i31)
    u_zz = cu * (k1 * i10 + b * b * i30)

    ct = -r1 / (8.0 * math.pi * (1.0 - nu))
    k2 = 1.0 - 2.0 * nu
    # Int (R.n)/R^3 and Int (R.n) s2 / R^3
    m0 = n0 * i30 + n1 * i31
    m1 = n0 * i31 + n1 * i32
    # Int (R.n) s2^q / R^5
    g0 = n0 * i50 + n1 * i51
    g1 = n0 * i51 + n1 * i52
    g2 = n0 * i52 + n1 * i53
    # the antisymmetric part for rr: R.e_r(y) n.e_r(x) - R.e_r(x) n.e_r(y) = 2 y1 nr (s2 - s2^2)
    t_rr = ct * (
        k2 * (m0 - 2.0 * m1 + 2.0 * y1 * nr * (i31 - i32)) + 3.0 * (a * a * g0 + q1 * g1 + q2 * g2)
    )
    t_rz = ct * (
        3.0 * b * (a * g0 - x1 * g1) + k2 * (b * nr * (i30 - 2.0 * i31) - nz * (a * i30 - x1 * i31))
    )
    t_zr = ct * (3.0 * b * (a * g0 + y1 * g1) + k2 * (nz * (a * i30 + y1 * i31) - b * nr * i30))
    t_zz = ct * (k2 * m0 + 3.0 * b * b * g0)

    cosine = i10 - 2.0 * i11
    u_tt = r1 / (4.0 * math.pi * shear) * cosine
    t_tt = -(r1 * (m0 - 2.0 * m1) + nr * cosine) / (4.0 * math.pi)
    return u_rr, u_rz, u_zr, u_zz, t_rr, t_rz, t_zr, t_zz, u_tt, t_tt
