/* Ring kernels: Kelvin's solution integrated over a circle, eq. (5) of the paper, and its stress.

   The source is a point x = (r, 0, z); the field point runs over the circle through
   y = (r + a, z + b) with outward normal n = (nr, nz). With s = sin(theta/2), s2 = s^2,

       R^2 = a^2 + b^2 + 4 r (r + a) s2,
       R . e_r(x) = a - 2 (r + a) s2,   R . e_r(y) = a + 2 r s2,

   so that every entry is a sum of products of small numbers with the moments

       I(p, q) = Int_0^2pi  s^(2q) / R^p  dtheta,

   and nothing cancels as y comes close to x. Offsets a and b are arguments, never differences of
   rounded coordinates: the caller forms them from the element's local parameter.

   Lengths are in mm, Young's modulus is 1. All kernels carry the radius of dS = (r + a) dtheta ds:
   U has the unit 1/MPa, T 1, D 1/mm, and S MPa/mm^2 for displacements at E = 1.

   Loops over the points of a tile are for the compiler to vectorise, without branches and with few
   divisions and roots; tests/elasticity/test_kernels.py watches that it does. */
#include <math.h>
#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))
/* several versions of a function; the processor's own is taken when the module is loaded */
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__) && __GNUC__ >= 12
#define VERSIONS __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define VERSIONS
#endif

#define PI 3.14159265358979323846

enum {
    TILE = 136,          /* most field points that are evaluated at once */
    VECTOR = 8,          /* doubles that the widest vectors of common processors hold */
    ROW = TILE + VECTOR, /* loops run on to whole vectors, over what comes next */
    MAX_POINTS = 16,     /* of a Gauss rule, as in quadrature.py */
    DEEPEST = 40,        /* most halvings of an element: what is closer touches it */
    MOST_POINTS = 4096,  /* on all of its parts */
    THETA = 10           /* points of the quadrature over the circle */
};

typedef double Vector __attribute__((vector_size(8 * VECTOR), aligned(8), may_alias));

/* Kernels come in pairs of a component at the source and a direction on the element: forces and
   displacements of the boundary equation, or stresses. The first PAIRS multiply tractions (U, D),
   the others displacements (T, S). Directions r, z and then theta, which uncouples. */
enum { RR, ZR, RZ, ZZ, TT, PAIRS };
enum { RR_R, TT_R, ZZ_R, RZ_R, RR_Z, TT_Z, ZZ_Z, RZ_Z, RT_T, TZ_T, STRESS_PAIRS };

/* Field points with the radii of their sources, and kernels there */
typedef struct {
    double r[ROW], a[ROW], b[ROW], nr[ROW], nz[ROW];
    double value[2 * STRESS_PAIRS][ROW];
} Tile;

/* A straight element: its first node, the vector to the last, length and outward normal */
typedef struct {
    double r, z, dr, dz, length, nr, nz;
} Element;

/* Sources one after another: radius, offset of the element's start (or of the source itself, where
   the element holds it), and height z0 of the fields that are subtracted */
typedef struct {
    double r[ROW], a[ROW], b[ROW], z0[ROW];
} Sources;

/* Integrals over an element for each source: of each pair's second kernel times the three shape
   functions and of its first kernel, and what they add to the sources' own columns */
typedef struct {
    double of[STRESS_PAIRS][4][ROW], own[STRESS_PAIRS][ROW];
} Integrals;

/* See quadrature.py: n points serve where distances of the ends over the length are reach[n] */
typedef struct {
    const double *reach, *points, *weights, *singular_points, *singular_weights;
} Rules;

/* Points on an element: how far along it from where the offsets are, and weights over its length */
typedef struct {
    int count;
    double place[MOST_POINTS], weight[MOST_POINTS];
} Points;

/* ---- moments ---- */

/* K = A(m1) - log(m1) B(m1) and E = C(m1) - log(m1) m1 D(m1) to the last digit; S. L. Moshier's
   minimax polynomials (Cephes Math Library, ellpk.c and ellpe.c) */
static const double K_REGULAR[11] = {
    1.37982864606273237150e-4, 2.28025724005875567385e-3, 7.97404013220415179367e-3,
    9.85821379021226008714e-3, 6.87489687449949877925e-3, 6.18901033637687613229e-3,
    8.79078273952743772254e-3, 1.49380448916805252718e-2, 3.08851465246711995998e-2,
    9.65735902811690126535e-2, 1.38629436111989062502};
static const double K_SINGULAR[11] = {
    2.94078955048598507511e-5, 9.14184723865917226571e-4, 5.94058303753167793257e-3,
    1.54850516649762399335e-2, 2.39089602715924892727e-2, 3.01204715227604046988e-2,
    3.73774314173823228969e-2, 4.88280347570998239232e-2, 7.03124996963957469739e-2,
    1.24999999999870820058e-1, 4.99999999999999999821e-1};
static const double E_REGULAR[11] = {
    1.53552577301013293365e-4, 2.50888492163602060990e-3, 8.68786816565889628429e-3,
    1.07350949056076193403e-2, 7.77395492516787092951e-3, 7.58395289413514708519e-3,
    1.15688436810574127319e-2, 2.18317996015557253103e-2, 5.68051945617860553470e-2,
    4.43147180560990850618e-1, 1.0};
static const double E_SINGULAR[10] = {
    3.27954898576485872656e-5, 1.00962792679356715133e-3, 6.50609489976927491433e-3,
    1.68862163993311317300e-2, 2.61769742454493659583e-2, 3.34833904888224918614e-2,
    4.27180926518931511717e-2, 5.85936634471101055642e-2, 9.37499997197644278445e-2,
    2.49999999999888314361e-1};
/* log f = 2 t (1 + z/3 + z^2/5 ...) with t = (f-1)/(f+1), z = t^2 < 0.03 */
static const double ATANH[9] = {2.0 / 17, 2.0 / 15, 2.0 / 13, 2.0 / 11, 2.0 / 9,
                                2.0 / 7,  2.0 / 5,  2.0 / 3,  2.0};

INLINE double polynomial(const double *c, int n, double x)
{
    /* odd and even powers apart: two short chains are quicker than a long one */
    const double x2 = x * x;
    double first = c[0], second = c[1];
#pragma GCC unroll 8
    for (int i = 2; i + 1 < n; i += 2) {
        first = first * x2 + c[i];
        second = second * x2 + c[i + 1];
    }
    return n % 2 ? first * x2 + c[n - 1] + second * x : first * x + second;
}

/* Set the complete elliptic integrals of parameter 1 - m1, 0 < m1 <= 1: m1 is the argument because
   it, and not 1 - m1, is known to full precision where the field point is close to the source. */
INLINE void elliptic(double m1, double *k, double *e)
{
    /* m1 = 2^doublings f with f from sqrt(1/2) to sqrt(2) */
    const uint64_t one = 0x3FF0000000000000, root_half = 0x3FE6A09E667F3BCD;
    uint64_t bits, exponent;
    double f, doublings;
    memcpy(&bits, &m1, sizeof bits);
    exponent = (bits + (one - root_half)) >> 52;
    bits += one - (exponent << 52);
    memcpy(&f, &bits, sizeof f);
    exponent |= 0x4330000000000000; /* in the place of the mantissa it is 2^52 plus itself */
    memcpy(&doublings, &exponent, sizeof doublings);
    const double t = (f - 1.0) / (f + 1.0);
    const double log = (doublings - (4503599627370496.0 + 1023.0)) * 0.69314718055994530942
                       + t * polynomial(ATANH, 9, t * t);
    *k = polynomial(K_REGULAR, 11, m1) - log * polynomial(K_SINGULAR, 11, m1);
    *e = polynomial(E_REGULAR, 11, m1) - log * m1 * polynomial(E_SINGULAR, 10, m1);
}

typedef struct {
    double i10, i11, i30, i31, i32, i50, i51, i52, i53, i70, i71, i72, i73, i74;
} Moments;

INLINE Moments moments_by_recursion(double r, double a, double b)
{
    const double near2 = a * a + b * b, span2 = 4.0 * r * (r + a), far2 = near2 + span2;
    const double far = sqrt(far2), both = 1.0 / (near2 * far2), inverse = 1.0 / span2;
    double k, e;
    elliptic(near2 * near2 * both, &k, &e);
    Moments i;
    i.i10 = 4.0 * k * far * near2 * both;
    i.i11 = (4.0 * far * e - near2 * i.i10) * inverse;
    i.i30 = 4.0 * far * e * both;
    i.i31 = (i.i10 - near2 * i.i30) * inverse;
    i.i32 = (i.i11 - near2 * i.i31) * inverse;
    i.i50 = (2.0 * (far2 + near2) * i.i30 - i.i10) * (both * (1.0 / 3.0));
    i.i51 = (i.i30 - near2 * i.i50) * inverse;
    i.i52 = (i.i31 - near2 * i.i51) * inverse;
    i.i53 = (i.i32 - near2 * i.i52) * inverse;
    i.i70 = (4.0 * (far2 + near2) * i.i50 - 3.0 * i.i30) * (both * 0.2);
    i.i71 = (i.i50 - near2 * i.i70) * inverse;
    i.i72 = (i.i51 - near2 * i.i71) * inverse;
    i.i73 = (i.i52 - near2 * i.i72) * inverse;
    i.i74 = (i.i53 - near2 * i.i73) * inverse;
    return i;
}

/* sin((k + 1/2) pi / 20)^2 */
static const double SIN2[THETA] = {
    0.0061558297024311365, 0.05449673790581606, 0.14644660940672624,
    0.2730047501302265, 0.4217827674798846, 0.5782172325201155,
    0.7269952498697734, 0.8535533905932737, 0.9455032620941839,
    0.9938441702975689};

/* Near the axis or far from the source the moments hardly vary over the circle. */
static Moments moments_by_quadrature(double r, double a, double b)
{
    const double near2 = a * a + b * b, span2 = 4.0 * r * (r + a);
    double sums[14] = {0.0};
    for (int k = 0; k < THETA; k++) {
        const double inv2 = 1.0 / (near2 + span2 * SIN2[k]);
        double power = 2.0 * PI / THETA * sqrt(inv2), *sum = sums;
        for (int p = 1; p <= 7; p += 2, power *= inv2) {
            double term = power;
            for (int q = 0; q <= (p + 1) / 2; q++, term *= SIN2[k]) *sum++ += term;
        }
    }
    Moments i;
    memcpy(&i, sums, sizeof i);
    return i;
}

/* Recursions divide by m = 4 r r1 / S^2 once for each power of s2: below this they are not used. */
INLINE int is_small(double r, double a, double b)
{
    const double span2 = 4.0 * r * (r + a);
    return span2 < 0.3 * (a * a + b * b + span2);
}

INLINE Moments moments_of(double r, double a, double b)
{
    return is_small(r, a, b) ? moments_by_quadrature(r, a, b) : moments_by_recursion(r, a, b);
}

/* ---- kernels ---- */

INLINE void ring_kernels_of(Moments i, double r, double a, double b, double nr, double nz,
                            double nu, double *out)
{
    const double r1 = r + a, x1 = 2.0 * r1, y1 = 2.0 * r;
    /* R.e_r(x) = a - x1 s2,  R.e_r(y) = a + y1 s2,  R.n = n0 + n1 s2,  n.e_r(x) = nr - 2 nr s2 */
    const double n0 = nr * a + nz * b, n1 = nr * y1;
    /* product of the two projections: a^2 + q1 s2 + q2 s2^2 */
    const double q1 = a * (y1 - x1), q2 = -x1 * y1;

    const double shear = 0.5 / (1.0 + nu), cu = r1 / (16.0 * PI * shear * (1.0 - nu));
    const double k1 = 3.0 - 4.0 * nu, cosine = i.i10 - 2.0 * i.i11;
    const double at_x = a * i.i30 - x1 * i.i31, at_y = a * i.i30 + y1 * i.i31;
    out[RR * ROW] = cu * (k1 * cosine + a * a * i.i30 + q1 * i.i31 + q2 * i.i32);
    out[RZ * ROW] = cu * b * at_x;
    out[ZR * ROW] = cu * b * at_y;
    out[ZZ * ROW] = cu * (k1 * i.i10 + b * b * i.i30);
    out[TT * ROW] = r1 / (4.0 * PI * shear) * cosine;

    const double ct = -r1 / (8.0 * PI * (1.0 - nu)), k2 = 1.0 - 2.0 * nu, b3 = 3.0 * b;
    /* Int R.n s2^q / R^3 and / R^5 */
    const double m0 = n0 * i.i30 + n1 * i.i31, m1 = n0 * i.i31 + n1 * i.i32, along = m0 - 2.0 * m1;
    const double g0 = n0 * i.i50 + n1 * i.i51, g1 = n0 * i.i51 + n1 * i.i52;
    const double g2 = n0 * i.i52 + n1 * i.i53;
    /* antisymmetric for rr: R.e_r(y) n.e_r(x) - R.e_r(x) n.e_r(y) = 2 y1 nr (s2 - s2^2) */
    out[(PAIRS + RR) * ROW] = ct * (k2 * (along + 2.0 * y1 * nr * (i.i31 - i.i32))
                            + 3.0 * (a * a * g0 + q1 * g1 + q2 * g2));
    out[(PAIRS + RZ) * ROW] = ct * (b3 * (a * g0 - x1 * g1)
                            + k2 * (b * nr * (i.i30 - 2.0 * i.i31) - nz * at_x));
    out[(PAIRS + ZR) * ROW] = ct * (b3 * (a * g0 + y1 * g1) + k2 * (nz * at_y - b * nr * i.i30));
    out[(PAIRS + ZZ) * ROW] = ct * (k2 * m0 + b3 * b * g0);
    out[(PAIRS + TT) * ROW] = (r1 * along + nr * cosine) * (-0.25 / PI);
}

/* sigma(x) = Int D t - S u dS; in the frame of x the components of R are X = a - 2 r1 s2,
   Y = r1 sin(theta) and b */
INLINE void stress_kernels_of(Moments i, double r, double a, double b, double nr, double nz,
                              double nu, double *out)
{
    const double r1 = r + a, x1 = 2.0 * r1, y1 = 2.0 * r, a2 = a * a, b2 = b * b;
    /* X = a - x1 s2,  P = R.e_r(y) = a + y1 s2,  N = R.n = n0 + n1 s2,  cos = 1 - 2 s2 */
    const double n0 = nr * a + nz * b, n1 = nr * y1;
    /* X P = a2 + q1 s2 + q2 s2^2,  X X,  X cos,  X X P */
    const double q1 = a * (y1 - x1), q2 = -x1 * y1, h1 = -2.0 * a * x1, h2 = x1 * x1;
    const double c1 = -(x1 + 2.0 * a), c2 = 2.0 * x1;
    const double e0 = a2 * a, e1 = a * q1 - x1 * a2, e2 = a * q2 - x1 * q1, e3 = -x1 * q2;
    /* sin^2 = 4 (s2 - s2^2) against the moments */
    const double sj = 4.0 * (i.i31 - i.i32);
    const double sk0 = 4.0 * (i.i51 - i.i52), sk1 = 4.0 * (i.i52 - i.i53);
    const double w1 = 1.0 - 2.0 * nu, w4 = 1.0 - 4.0 * nu;

    /* of the third powers */
    const double p3 = a * i.i30 + y1 * i.i31, x3 = a * i.i30 - x1 * i.i31;
    const double cos3 = i.i30 - 2.0 * i.i31, cosx3 = a * i.i30 + c1 * i.i31 + c2 * i.i32;
    const double coscos3 = i.i30 - 4.0 * i.i31 + 4.0 * i.i32;
    /* of the fifth powers */
    const double p5 = a * i.i50 + y1 * i.i51, x5 = a * i.i50 - x1 * i.i51;
    const double cos5 = i.i50 - 2.0 * i.i51;
    const double xp5 = a2 * i.i50 + q1 * i.i51 + q2 * i.i52;
    const double xx5 = a2 * i.i50 + h1 * i.i51 + h2 * i.i52;
    const double cosx5 = a * i.i50 + c1 * i.i51 + c2 * i.i52;
    const double cosp5 = a * cos5 + y1 * (i.i51 - 2.0 * i.i52);
    const double cosxp5 = a2 * cos5 + q1 * (i.i51 - 2.0 * i.i52) + q2 * (i.i52 - 2.0 * i.i53);
    const double sinp5 = a * sk0 + y1 * sk1, sinx5 = a * sk0 - x1 * sk1;
    const double nk0 = n0 * i.i50 + n1 * i.i51, nk1 = n0 * i.i51 + n1 * i.i52;
    const double nk2 = n0 * i.i52 + n1 * i.i53;
    const double np5 = a * nk0 + y1 * nk1, nx5 = a * nk0 - x1 * nk1, ncos5 = nk0 - 2.0 * nk1;
    const double ncosx5 = a * nk0 + c1 * nk1 + c2 * nk2, nsin5 = 4.0 * (nk1 - nk2);
    /* of the seventh powers */
    const double nl0 = n0 * i.i70 + n1 * i.i71, nl1 = n0 * i.i71 + n1 * i.i72;
    const double nl2 = n0 * i.i72 + n1 * i.i73, nl3 = n0 * i.i73 + n1 * i.i74;
    const double nsl0 = 4.0 * (nl1 - nl2), nsl1 = 4.0 * (nl2 - nl3);

    const double cd = r1 / (8.0 * PI * (1.0 - nu));
    out[RR_R * ROW] = cd * (w1 * (2.0 * cosx3 - p3)
                              + 3.0 * (e0 * i.i50 + e1 * i.i51 + e2 * i.i52 + e3 * i.i53));
    out[TT_R * ROW] = cd * (w1 * (2.0 * r1 * sj - p3) + 3.0 * r1 * r1 * sinp5);
    out[ZZ_R * ROW] = cd * (3.0 * b2 * p5 - w1 * p3);
    out[RZ_R * ROW] = cd * b * (w1 * cos3 + 3.0 * xp5);
    out[RR_Z * ROW] = cd * b * (3.0 * xx5 - w1 * i.i30);
    out[TT_Z * ROW] = cd * b * (3.0 * r1 * r1 * sk0 - w1 * i.i30);
    out[ZZ_Z * ROW] = cd * b * (3.0 * b2 * i.i50 + w1 * i.i30);
    out[RZ_Z * ROW] = cd * (w1 * x3 + 3.0 * b2 * x5);
    out[RT_T * ROW] = cd * (w1 * (cosx3 - r1 * sj) + 3.0 * r * r1 * sinx5);
    out[TZ_T * ROW] = cd * b * (w1 * cos3 + 3.0 * r * r1 * sk0);

    const double cs = r1 / (8.0 * PI * (1.0 - nu * nu));
    const double common_r = 3.0 * w1 * np5 - w4 * nr * i.i30;
    out[(STRESS_PAIRS + RR_R) * ROW] = cs * (common_r + 6.0 * nu * (ncosx5 + nr * cosxp5)
                              - 15.0 * (e0 * nl0 + e1 * nl1 + e2 * nl2 + e3 * nl3)
                              + w1 * nr * (3.0 * xx5 + 2.0 * coscos3));
    out[(STRESS_PAIRS + TT_R) * ROW] = cs * (common_r + 6.0 * nu * r1 * (nsin5 + nr * sinp5)
                              - 15.0 * r1 * r1 * (a * nsl0 + y1 * nsl1)
                              + w1 * nr * (3.0 * r1 * r1 * sk0 + 2.0 * sj));
    out[(STRESS_PAIRS + ZZ_R) * ROW] = cs * (common_r - 15.0 * b2 * (a * nl0 + y1 * nl1)
                              + 6.0 * nu * nz * b * p5 + 3.0 * w1 * nr * b2 * i.i50);
    out[(STRESS_PAIRS + RZ_R) * ROW] = cs * (3.0 * nu * (b * (ncos5 + nr * cosp5) + nz * xp5)
                              - 15.0 * b * (a2 * nl0 + q1 * nl1 + q2 * nl2)
                              + w1 * (3.0 * nr * b * x5 + nz * cos3));
    const double common_z = 3.0 * w1 * b * nk0 - w4 * nz * i.i30;
    out[(STRESS_PAIRS + RR_Z) * ROW] = cs * (common_z - 15.0 * b * (a2 * nl0 + h1 * nl1 + h2 * nl2)
                              + 6.0 * nu * nr * b * cosx5 + 3.0 * w1 * nz * xx5);
    out[(STRESS_PAIRS + TT_Z) * ROW] = cs * (common_z - 15.0 * b * r1 * r1 * nsl0
                              + 6.0 * nu * nr * b * r1 * sk0 + 3.0 * w1 * nz * r1 * r1 * sk0);
    out[(STRESS_PAIRS + ZZ_Z) * ROW] = cs * (common_z + 6.0 * nu * b * (nk0 + nz * b * i.i50)
                              - 15.0 * b2 * b * nl0 + w1 * nz * (3.0 * b2 * i.i50 + 2.0 * i.i30));
    out[(STRESS_PAIRS + RZ_Z) * ROW] = cs * (3.0 * nu * (nx5 + b * (nr * b * cos5 + nz * x5))
                              - 15.0 * b2 * (a * nl0 - x1 * nl1)
                              + w1 * (3.0 * nz * b * x5 + nr * cos3));
    out[(STRESS_PAIRS + RT_T) * ROW] = cs * (3.0 * nu * (ncosx5 - r1 * nsin5
                                          + nr * r * (r1 * (sk0 - 2.0 * sk1) + sinx5))
                              - 15.0 * r * r1 * (a * nsl0 - x1 * nsl1)
                              + w1 * nr * (coscos3 - sj));
    out[(STRESS_PAIRS + TZ_T) * ROW] = cs * (3.0 * nu * (b * ncos5 + r * (nr * b + nz * r1) * sk0)
                              - 15.0 * b * r * r1 * nsl0 + w1 * nz * cos3);
}

typedef void Kernels(Moments, double, double, double, double, double, double, double *);

INLINE void fill(Tile *tile, int count, double nu, Kernels kernels)
{
    int small = 0;
    count += -count & (VECTOR - 1);
#pragma GCC ivdep
    for (int i = 0; i < count; i++) {
        const double r = tile->r[i], a = tile->a[i], b = tile->b[i];
        kernels(moments_by_recursion(r, a, b), r, a, b, tile->nr[i], tile->nz[i], nu,
                tile->value[0] + i);
    }
    for (int i = 0; i < count; i++) small += is_small(tile->r[i], tile->a[i], tile->b[i]);
    for (int i = 0; small && i < count; i++) {
        const double r = tile->r[i], a = tile->a[i], b = tile->b[i];
        if (is_small(r, a, b))
            kernels(moments_by_quadrature(r, a, b), r, a, b, tile->nr[i], tile->nz[i], nu,
                    tile->value[0] + i);
    }
}

/* Set the kernels of PAIRS, or STRESS_PAIRS, at the first points of a tile. */
VERSIONS static void fill_kernels(Tile *tile, int pairs, int count, double nu)
{
    if (pairs == PAIRS)
        fill(tile, count, nu, ring_kernels_of);
    else
        fill(tile, count, nu, stress_kernels_of);
}

/* ---- integrals over an element ---- */

/* Set what integrals add to the sources' own columns: shape functions sum to one, and to radius or
   height when weighted with that of their nodes, so that the integral over a field u*, t* needs no
   kernels of its own. The fields are uniform along z; turn; or are u* = (r1 e_r - lateral
   (z1 - z0) e_z) / r, which has no axial stress, and stresses that stay finite as Poisson's ratio
   goes to 1/2; its traction, along r, is star over r. */
INLINE void set_own(Integrals *sums, const Element *e, int pairs, int count, const double *z0,
                    double nu)
{
    const double lateral = 2.0 * nu / (1.0 - nu), star = e->nr / (1.0 - nu);
    const double r[3] = {e->r, e->r + 0.5 * e->dr, e->r + e->dr};
    const double z[3] = {e->z, e->z + 0.5 * e->dz, e->z + e->dz};
    const int components = 2 * pairs / PAIRS; /* at the source, of directions r and z */
    for (int k = 0; k < components; k++) {
        double(*radial)[ROW] = sums->of[k], (*axial)[ROW] = sums->of[components + k];
#pragma GCC ivdep
        for (int i = 0; i < count; i++) {
            const double a0 = axial[0][i], a1 = axial[1][i], a2 = axial[2][i];
            sums->own[k][i] =
                star * radial[3][i]
                - (r[0] * radial[0][i] + r[1] * radial[1][i] + r[2] * radial[2][i])
                + lateral * ((z[0] - z0[i]) * a0 + (z[1] - z0[i]) * a1 + (z[2] - z0[i]) * a2);
            sums->own[components + k][i] = -(a0 + a1 + a2);
        }
    }
    for (int k = 2 * components; k < pairs; k++) {
        double(*turning)[ROW] = sums->of[k];
#pragma GCC ivdep
        for (int i = 0; i < count; i++)
            sums->own[k][i] = -(r[0] * turning[0][i] + r[1] * turning[1][i] + r[2] * turning[2][i]);
    }
}

/* Set, or add to, the integrals over an element for sources, by n points with places and weights.
   Where a source is its node `at`, elsewhere -1, places are from there, and that node's shape
   function is left out. */
VERSIONS static void integrate(Tile *tile, Integrals *sums, const Element *e, int pairs,
                               const Sources *sources, int count, int at, int n,
                               const double *place, const double *weight, int add, double nu)
{
    const double origin = at < 0 ? 0.0 : 0.5 * at;
    double w[TILE], s[TILE][3];
    for (int q = 0; q < n; q++) {
        double *tr = tile->r + q * count, *ta = tile->a + q * count, *tb = tile->b + q * count;
        for (int i = 0; i < count; i += VECTOR) {
            *(Vector *)(tr + i) = *(const Vector *)(sources->r + i);
            *(Vector *)(ta + i) = *(const Vector *)(sources->a + i) + place[q] * e->dr;
            *(Vector *)(tb + i) = *(const Vector *)(sources->b + i) + place[q] * e->dz;
        }
        const double t = origin + place[q];
        w[q] = e->length * weight[q];
        s[q][0] = w[q] * (1.0 - t) * (1.0 - 2.0 * t);
        s[q][1] = w[q] * 4.0 * t * (1.0 - t);
        s[q][2] = w[q] * t * (2.0 * t - 1.0);
        if (at >= 0) s[q][at] = 0.0;
    }
    fill_kernels(tile, pairs, n * count, nu);
    for (int pair = 0; pair < pairs; pair++)
        for (int i = 0; i < count; i += VECTOR) {
            Vector *h0 = (Vector *)(sums->of[pair][0] + i), *h1 = (Vector *)(sums->of[pair][1] + i);
            Vector *h2 = (Vector *)(sums->of[pair][2] + i), *g = (Vector *)(sums->of[pair][3] + i);
            Vector x0 = {0.0}, x1 = x0, x2 = x0, x3 = x0;
            if (add) x0 = *h0, x1 = *h1, x2 = *h2, x3 = *g;
            for (int q = 0; q < n; q++) {
                const Vector u = *(const Vector *)(tile->value[pair] + q * count + i);
                const Vector k = *(const Vector *)(tile->value[pairs + pair] + q * count + i);
                x3 += w[q] * u;
                x0 += s[q][0] * k;
                x1 += s[q][1] * k;
                x2 += s[q][2] * k;
            }
            *h0 = x0, *h1 = x1, *h2 = x2, *g = x3;
        }
    set_own(sums, e, pairs, count + (-count & (VECTOR - 1)), sources->z0, nu);
}

/* Return the least n points that serve, more than MAX_POINTS: none do. From the last answer on, as
   it is often the same. */
INLINE int points_needed(const Rules *rules, double ratio, int n)
{
    while (n > 1 && rules->reach[n - 1] <= ratio) n--;
    while (n <= MAX_POINTS && rules->reach[n] > ratio) n++;
    return n;
}

/* Add points on a part of an element that starts at (ar, az) from the source; 0: too many. */
static int add_points(Points *points, const Rules *rules, const Element *e, double ar, double az,
                      double from, double to, int depth)
{
    const double span = to - from, middle = 0.5 * (from + to);
    const double distances = hypot(ar + from * e->dr, az + from * e->dz)
                             + hypot(ar + to * e->dr, az + to * e->dz);
    const int n = points_needed(rules, distances / (e->length * span), 1);
    if (n > MAX_POINTS)
        return depth < DEEPEST
               && add_points(points, rules, e, ar, az, from, middle, depth + 1)
               && add_points(points, rules, e, ar, az, middle, to, depth + 1);
    if (points->count + n > MOST_POINTS) return 0;
    for (int q = 0; q < n; q++) {
        points->place[points->count] = from + span * rules->points[n * MAX_POINTS + q];
        points->weight[points->count++] = rules->weights[n * MAX_POINTS + q] * span;
    }
    return 1;
}

/* Set points on an element that holds its source at t = origin: with a singular rule beside it. */
static int set_points_around(Points *points, const Rules *rules, const Element *e, double r,
                             double origin)
{
    const double reach = r / e->length; /* near the axis kernels change over the radius */
    for (int side = -1; side <= 1; side += 2) {
        const double whole = side < 0 ? origin : 1.0 - origin;
        const double span = r > 0.0 && whole > 1.5 * reach ? reach : whole;
        for (int q = 0; q < MAX_POINTS && whole > 0.0; q++) {
            points->place[points->count] = side * span * rules->singular_points[q];
            points->weight[points->count++] = rules->singular_weights[q] * span;
        }
        if (span < whole
            && !add_points(points, rules, e, 0.0, 0.0, side < 0 ? -whole : span,
                           side < 0 ? -span : whole, 0))
            return 0;
    }
    return 1;
}

/* Set the integrals over an element that is close to the first of sources, or holds it as its node
   `at`, elsewhere -1; 0: it is too close. */
static int integrate_near(Tile *tile, Integrals *sums, Points *points, const Element *e, int pairs,
                          const Sources *sources, int at, const Rules *rules, double nu)
{
    points->count = 0;
    if (!(at < 0 ? add_points(points, rules, e, sources->a[0], sources->b[0], 0.0, 1.0, 0)
                 : set_points_around(points, rules, e, sources->r[0], 0.5 * at)))
        return 0;
    for (int first = 0; first < points->count; first += TILE) {
        const int n = points->count - first < TILE ? points->count - first : TILE;
        integrate(tile, sums, e, pairs, sources, 1, at, n, points->place + first,
                  points->weight + first, first > 0, nu);
    }
    return 1;
}

/* Add integrals for sources to a column, at their rows, of which -1 is none. */
static inline void add_to_column(double *restrict column, const int64_t *restrict rows, int count,
                                 double factor, const double *restrict integrals)
{
    for (int i = 0; i < count; i++)
        if (rows[i] >= 0) column[rows[i]] += factor * integrals[i];
}
