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

Field points of one element are evaluated together, in a tile, by the processor's vector
instructions; that is why what follows has no branches, and few divisions and roots.
"""

import math

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.compiling import compiled

#: below this parameter m = 4 r r1 / S^2 the moments come from quadrature in theta: the recursions
#: divide by m once for each power of s^2
SMALL_PARAMETER = 0.3
_N_THETA = 8
_SIN2 = np.sin((np.arange(_N_THETA) + 0.5) * (0.5 * math.pi / _N_THETA)) ** 2

#: most field points that are evaluated at once
TILE = 136
#: rows of a tile: r, a, b and the ten kernels
TILE_ROWS = 13
_KERNELS = 3 * TILE

Moments = tuple[float, float, float, float, float, float, float, float, float]
RingKernels = tuple[float, float, float, float, float, float, float, float, float, float]

# K = A(m1) - log(m1) B(m1) and E = C(m1) - log(m1) m1 D(m1) to the last digit; S. L. Moshier's
# minimax polynomials (Cephes Math Library, ellpk.c and ellpe.c)
_K_REGULAR = (
    1.37982864606273237150e-4, 2.28025724005875567385e-3, 7.97404013220415179367e-3,
    9.85821379021226008714e-3, 6.87489687449949877925e-3, 6.18901033637687613229e-3,
    8.79078273952743772254e-3, 1.49380448916805252718e-2, 3.08851465246711995998e-2,
    9.65735902811690126535e-2, 1.38629436111989062502,
)  # fmt: skip
_K_SINGULAR = (
    2.94078955048598507511e-5, 9.14184723865917226571e-4, 5.94058303753167793257e-3,
    1.54850516649762399335e-2, 2.39089602715924892727e-2, 3.01204715227604046988e-2,
    3.73774314173823228969e-2, 4.88280347570998239232e-2, 7.03124996963957469739e-2,
    1.24999999999870820058e-1, 4.99999999999999999821e-1,
)  # fmt: skip
_E_REGULAR = (
    1.53552577301013293365e-4, 2.50888492163602060990e-3, 8.68786816565889628429e-3,
    1.07350949056076193403e-2, 7.77395492516787092951e-3, 7.58395289413514708519e-3,
    1.15688436810574127319e-2, 2.18317996015557253103e-2, 5.68051945617860553470e-2,
    4.43147180560990850618e-1, 1.0,
)  # fmt: skip
_E_SINGULAR = (
    3.27954898576485872656e-5, 1.00962792679356715133e-3, 6.50609489976927491433e-3,
    1.68862163993311317300e-2, 2.61769742454493659583e-2, 3.34833904888224918614e-2,
    4.27180926518931511717e-2, 5.85936634471101055642e-2, 9.37499997197644278445e-2,
    2.49999999999888314361e-1,
)  # fmt: skip
#: log f = 2 t (1 + z/3 + z^2/5 ...) with t = (f-1)/(f+1), z = t^2 < 0.03
_ATANH = tuple(2.0 / k for k in range(17, 0, -2))
_LOG2 = math.log(2.0)

# to split a positive number in its exponent and a factor from sqrt(1/2) to sqrt(2)
_MANTISSA_BITS = np.uint64(52)
_BITS_OF_ONE = np.uint64(0x3FF0000000000000)
_ONE_OVER_ROOT_HALF = np.uint64(0x3FF0000000000000 - 0x3FE6A09E667F3BCD)
#: an integer below 2^52 in the place of the mantissa is the number 2^52 plus that integer
_BITS_OF_2_52 = np.uint64(0x4330000000000000)
_2_52_AND_BIAS = 2.0**52 + 1023.0


@compiled(inline="always")
def _polynomial(coefficients: tuple[float, ...], x: float) -> float:
    # odd and even powers apart: two short chains are quicker than a long one
    n, x2 = len(coefficients), x * x
    first, second = coefficients[0], coefficients[1]
    for i in range(2, n - n % 2, 2):
        first = first * x2 + coefficients[i]
        second = second * x2 + coefficients[i + 1]
    if n % 2 == 0:
        return first * x + second
    return first * x2 + coefficients[n - 1] + second * x


@compiled(inline="always")
def elliptic(m1: float) -> tuple[float, float]:
    """Return the complete elliptic integrals K and E of parameter ``1 - m1``, 0 < m1 <= 1.

    The complementary parameter is the argument because it, and not ``1 - m1``, is known to full
    precision when the field point is close to the source.
    """
    bits = np.float64(m1).view(np.uint64)
    exponent = (bits + _ONE_OVER_ROOT_HALF) >> _MANTISSA_BITS
    f = np.uint64(bits - (exponent << _MANTISSA_BITS) + _BITS_OF_ONE).view(np.float64)
    t = (f - 1.0) / (f + 1.0)
    doublings = np.uint64(exponent | _BITS_OF_2_52).view(np.float64) - _2_52_AND_BIAS
    log = doublings * _LOG2 + t * _polynomial(_ATANH, t * t)
    big_k = _polynomial(_K_REGULAR, m1) - log * _polynomial(_K_SINGULAR, m1)
    big_e = _polynomial(_E_REGULAR, m1) - log * m1 * _polynomial(_E_SINGULAR, m1)
    return big_k, big_e


@compiled(inline="always")
def moments_by_recursion(r: float, a: float, b: float) -> Moments:
    """Return the moments of ``moments``, away from the axis."""
    near2 = a * a + b * b
    span2 = 4.0 * r * (r + a)
    far2 = near2 + span2
    far = math.sqrt(far2)
    inv_near2_far2 = 1.0 / (near2 * far2)
    inv_far2 = near2 * inv_near2_far2
    inv = 1.0 / span2
    big_k, big_e = elliptic(near2 * inv_far2)
    i10 = 4.0 * big_k * far * inv_far2
    far_e = 4.0 * far * big_e
    i11 = (far_e - near2 * i10) * inv
    i30 = far_e * inv_near2_far2
    i31 = (i10 - near2 * i30) * inv
    i32 = (i11 - near2 * i31) * inv
    i50 = (2.0 * (far2 + near2) * i30 - i10) * (inv_near2_far2 * (1.0 / 3.0))
    i51 = (i30 - near2 * i50) * inv
    i52 = (i31 - near2 * i51) * inv
    i53 = (i32 - near2 * i52) * inv
    return i10, i11, i30, i31, i32, i50, i51, i52, i53


@compiled(inline="always")
def moments_by_quadrature(r: float, a: float, b: float) -> Moments:
    """Return the moments of ``moments``, near the axis or far from the source."""
    near2 = a * a + b * b
    span2 = 4.0 * r * (r + a)
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


@compiled(inline="always")
def is_small(r: float, a: float, b: float) -> bool:
    """Tell whether the parameter is too small for the recursions."""
    span2 = 4.0 * r * (r + a)
    return span2 < SMALL_PARAMETER * (a * a + b * b + span2)


@compiled
def moments(r: float, a: float, b: float) -> Moments:
    """Return I(1,0), I(1,1), I(3,0), I(3,1), I(3,2), I(5,0), I(5,1), I(5,2), I(5,3).

    Parameters
    ----------
    r : radius of the source, mm, >= 0.
    a, b : radial and axial offset of the field point, mm, not both zero.
    """
    if is_small(r, a, b):
        return moments_by_quadrature(r, a, b)
    return moments_by_recursion(r, a, b)


@compiled(inline="always")
def _from_moments(
    i: Moments, r: float, a: float, b: float, nr: float, nz: float, nu: float
) -> RingKernels:
    i10, i11, i30, i31, i32, i50, i51, i52, i53 = i
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
    cu = r1 * (1.0 / (16.0 * math.pi * shear * (1.0 - nu)))
    k1 = 3.0 - 4.0 * nu
    cosine = i10 - 2.0 * i11
    at_x = a * i30 - x1 * i31
    at_y = a * i30 + y1 * i31
    u_rr = cu * (k1 * cosine + a * a * i30 + q1 * i31 + q2 * i32)
    u_rz = cu * b * at_x
    u_zr = cu * b * at_y
    u_zz = cu * (k1 * i10 + b * b * i30)

    ct = r1 * (-1.0 / (8.0 * math.pi * (1.0 - nu)))
    k2 = 1.0 - 2.0 * nu
    # Int (R.n)/R^3 and Int (R.n) s2 / R^3
    m0 = n0 * i30 + n1 * i31
    m1 = n0 * i31 + n1 * i32
    along = m0 - 2.0 * m1
    # Int (R.n) s2^q / R^5
    g0 = n0 * i50 + n1 * i51
    g1 = n0 * i51 + n1 * i52
    g2 = n0 * i52 + n1 * i53
    # the antisymmetric part for rr: R.e_r(y) n.e_r(x) - R.e_r(x) n.e_r(y) = 2 y1 nr (s2 - s2^2)
    t_rr = ct * (
        k2 * (along + 2.0 * y1 * nr * (i31 - i32)) + 3.0 * (a * a * g0 + q1 * g1 + q2 * g2)
    )
    b3 = 3.0 * b
    t_rz = ct * (b3 * (a * g0 - x1 * g1) + k2 * (b * nr * (i30 - 2.0 * i31) - nz * at_x))
    t_zr = ct * (b3 * (a * g0 + y1 * g1) + k2 * (nz * at_y - b * nr * i30))
    t_zz = ct * (k2 * m0 + b3 * b * g0)

    u_tt = r1 * (1.0 / (4.0 * math.pi * shear)) * cosine
    t_tt = (r1 * along + nr * cosine) * (-0.25 / math.pi)
    return u_rr, u_rz, u_zr, u_zz, u_tt, t_rr, t_rz, t_zr, t_zz, t_tt


@compiled
def _near_axis(r: float, a: float, b: float, nr: float, nz: float, nu: float) -> RingKernels:
    return _from_moments(moments_by_quadrature(r, a, b), r, a, b, nr, nz, nu)


@compiled
def ring_kernels(r: float, a: float, b: float, nr: float, nz: float, nu: float) -> RingKernels:
    """Return U_rr, U_rz, U_zr, U_zz, U_tt, T_rr, T_rz, T_zr, T_zz, T_tt.

    The first letter is the direction of the force at the source, the second the component at the
    field point; ``t`` stands for theta, which uncouples. U in 1/MPa at E = 1, T in 1; both carry
    the ``r1`` of ``dS = r1 dtheta ds``.
    """
    if is_small(r, a, b):
        return _near_axis(r, a, b, nr, nz, nu)
    return _from_moments(moments_by_recursion(r, a, b), r, a, b, nr, nz, nu)


# contraction: products and sums in one instruction; nothing else may be reordered
@compiled(fastmath={"contract"}, error_model="numpy")
def fill_tile(tile: FloatArray, count: int, nr: float, nz: float, nu: float) -> None:
    """Set the kernels of the first field points of a tile, those of one normal.

    Parameters
    ----------
    tile : (TILE_ROWS * TILE,) float, one row behind the other: r, a, b, and the kernels as
        ``ring_kernels`` returns them.
    count : number of field points, at most TILE.
    nr, nz, nu : normal, Poisson's ratio.
    """
    small = 0
    for i in range(count):
        r, a, b = tile[i], tile[TILE + i], tile[2 * TILE + i]
        values = _from_moments(moments_by_recursion(r, a, b), r, a, b, nr, nz, nu)
        tile[_KERNELS + i] = values[0]
        tile[_KERNELS + TILE + i] = values[1]
        tile[_KERNELS + 2 * TILE + i] = values[2]
        tile[_KERNELS + 3 * TILE + i] = values[3]
        tile[_KERNELS + 4 * TILE + i] = values[4]
        tile[_KERNELS + 5 * TILE + i] = values[5]
        tile[_KERNELS + 6 * TILE + i] = values[6]
        tile[_KERNELS + 7 * TILE + i] = values[7]
        tile[_KERNELS + 8 * TILE + i] = values[8]
        tile[_KERNELS + 9 * TILE + i] = values[9]
        small += is_small(r, a, b)
    if small == 0:
        return
    for i in range(count):
        r, a, b = tile[i], tile[TILE + i], tile[2 * TILE + i]
        if is_small(r, a, b):
            values = _near_axis(r, a, b, nr, nz, nu)
            for k in range(10):
                tile[_KERNELS + k * TILE + i] = values[k]
