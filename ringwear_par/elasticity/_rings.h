/* Ring kernels: Kelvin's solution integrated over a circle, eq. (5) of the paper, and its stress.

   The source is a point x = (r, 0, z); the field point runs over the circle through
   y = (r + a, z + b) with outward normal n = (nr, nz). With s = sin(theta/2), s2 = s^2,

       R^2 = a^2 + b^2 + 4 r (r + a) s2,
       R . e_r(x) = a - 2 (r + a) s2,   R . e_r(y) = a + 2 r s2,

   so that every entry is a polynomial of s2 against the moments

       I(p, q) = Int_0^2pi  s^(2q) / R^p  dtheta,

   a sum of products of small numbers, and nothing cancels as y comes close to x. Offsets a and b are
   arguments, never differences of rounded coordinates: the caller forms them from the element's
   local parameter.

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
    THETA = 10,          /* points of the quadrature over the circle */
    PAIRS = 5,           /* of a component at the source and a direction on the element: forces and */
    STRESS_PAIRS = 10    /* displacements of the boundary equation, or stresses */
};

typedef double Row[ROW];
typedef const double *Doubles;
typedef const int64_t *Integers;
typedef double Vector __attribute__((vector_size(8 * VECTOR), aligned(8), may_alias));

/* Field points with the radii of their sources, and kernels there: of each pair that which
   multiplies tractions, U or D, then of each that which multiplies displacements, T or S */
typedef struct {
    Row r, a, b, nr, nz, value[2 * STRESS_PAIRS];
} Tile;

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

/* Factors of 1, s2 ... s2^4 in a polynomial, or moments of these; times sin(theta) if odd */
typedef struct {
    double c[5];
    int odd;
} Powers;

/* Set i[k] to the moments I(2k-1, 0) to I(2k-1, k). */
INLINE void moments_by_recursion(double r, double a, double b, Powers i[5])
{
    const double near2 = a * a + b * b, span2 = 4.0 * r * (r + a), far2 = near2 + span2;
    const double far = sqrt(far2), both = 1.0 / (near2 * far2), inverse = 1.0 / span2;
    double k, e;
    elliptic(near2 * near2 * both, &k, &e);
    memset(i, 0, 5 * sizeof *i);
    i[0].c[0] = 4.0 * far * e;
    i[1].c[0] = 4.0 * k * far * near2 * both;
#pragma GCC unroll 3
    for (int n = 2; n < 5; n++) {
        const double p = 2 * n - 3, sum = (p - 1.0) * (far2 + near2) * i[n - 1].c[0];
        i[n].c[0] = (sum - (p - 2.0) * i[n - 2].c[0]) * (both * (1.0 / p));
    }
#pragma GCC unroll 4
    for (int n = 1; n < 5; n++)
#pragma GCC unroll 4
        for (int q = 1; q <= n; q++)
            i[n].c[q] = (i[n - 1].c[q - 1] - near2 * i[n].c[q - 1]) * inverse;
}

/* sin((k + 1/2) pi / 20)^2 */
static const double SIN2[THETA] = {
    0.0061558297024311365, 0.05449673790581606, 0.14644660940672624, 0.2730047501302265,
    0.4217827674798846, 0.5782172325201155, 0.7269952498697734, 0.8535533905932737,
    0.9455032620941839, 0.9938441702975689};

/* The same near the axis or far from the source, where they hardly vary over the circle. */
static void moments_by_quadrature(double r, double a, double b, Powers i[5])
{
    const double near2 = a * a + b * b, span2 = 4.0 * r * (r + a);
    memset(i, 0, 5 * sizeof *i);
    for (int k = 0; k < THETA; k++) {
        const double inverse = 1.0 / (near2 + span2 * SIN2[k]);
        double power = 2.0 * PI / THETA * sqrt(inverse);
        for (int n = 1; n < 5; n++, power *= inverse) {
            double term = power;
            for (int q = 0; q <= n; q++, term *= SIN2[k]) i[n].c[q] += term;
        }
    }
}

/* ---- kernels ---- */

INLINE Powers product(Powers p, Powers q)
{
    const double *u = p.c, *v = q.c;
    const double c[5] = {
        u[0] * v[0],
        u[0] * v[1] + u[1] * v[0],
        u[0] * v[2] + u[1] * v[1] + u[2] * v[0],
        u[0] * v[3] + u[1] * v[2] + u[2] * v[1] + u[3] * v[0],
        u[0] * v[4] + u[1] * v[3] + u[2] * v[2] + u[3] * v[1] + u[4] * v[0],
    };
    if (p.odd && q.odd) /* sin^2 = 4 (s2 - s2^2) */
        return (Powers){{0.0, 4.0 * c[0], 4.0 * (c[1] - c[0]), 4.0 * (c[2] - c[1]),
                         4.0 * (c[3] - c[2])}, 0};
    return (Powers){{c[0], c[1], c[2], c[3], c[4]}, p.odd || q.odd};
}

/* Return the moments of a polynomial times 1, s2 ... */
INLINE Powers weighted(Powers p, Powers moments)
{
    const double *c = p.c, *m = moments.c;
    return (Powers){{
        c[0] * m[0] + c[1] * m[1] + c[2] * m[2] + c[3] * m[3] + c[4] * m[4],
        c[0] * m[1] + c[1] * m[2] + c[2] * m[3] + c[3] * m[4],
        c[0] * m[2] + c[1] * m[3] + c[2] * m[4],
        c[0] * m[3] + c[1] * m[4],
        c[0] * m[4],
    }, p.odd};
}

INLINE double integral(Powers p, Powers moments)
{
    const Powers turning = {{1.0}, moments.odd};
    return weighted(product(p, turning), moments).c[0];
}

/* Components along r, theta and z of the source */
enum { R, T, Z };

/* What kernels are made of: R, n and the directions e of r, theta and z on the element by
   components at the source, R . n, R . e and n . e; and the moments */
typedef struct {
    Powers away[3], normal[3], e[3][3], rn, re[3], i[5];
    double ne[3], ring, nu;
} Point;

/* Set U and T of component i at the source and direction k on the element. */
INLINE void boundary_kernel(const Point *x, int i, int k, double *u, double *t)
{
    const double nu = x->nu, w2 = 1.0 - 2.0 * nu;
    const Powers e = x->e[k][i], away = x->away[i], along = product(away, x->re[k]);
    const Powers n3 = weighted(x->rn, x->i[2]), n5 = weighted(x->rn, x->i[3]);
    const double bend = x->ne[k] * integral(away, x->i[2])
                        - integral(x->normal[i], weighted(x->re[k], x->i[2]));
    *u = x->ring * (1.0 + nu)
         * ((3.0 - 4.0 * nu) * integral(e, x->i[1]) + integral(along, x->i[2]));
    *t = x->ring * (w2 * (bend - integral(e, n3)) - 3.0 * integral(along, n5));
}

/* Return the symmetric part, twice, of the product of two vectors. */
INLINE Powers both(const Powers *u, const Powers *v, int i, int j)
{
    const Powers p = product(u[i], v[j]), q = product(u[j], v[i]);
    return (Powers){{p.c[0] + q.c[0], p.c[1] + q.c[1], p.c[2] + q.c[2], p.c[3] + q.c[3],
                     p.c[4] + q.c[4]}, p.odd};
}

/* Set D and S of component ij of stress at the source, sigma = Int D t - S u dS, and direction k. */
INLINE void stress_kernel(const Point *x, int i, int j, int k, double *d, double *s)
{
    const double nu = x->nu, w2 = 1.0 - 2.0 * nu, ne = x->ne[k], same = i == j;
    const Powers re = x->re[k], square = product(x->away[i], x->away[j]);
    const Powers shear = both(x->e[k], x->away, i, j), slant = both(x->normal, x->away, i, j);
    const Powers n5 = weighted(x->rn, x->i[3]), n7 = weighted(x->rn, x->i[4]);
    const Powers re5 = weighted(re, x->i[3]);
    *d = x->ring * (w2 * (integral(shear, x->i[2]) - same * integral(re, x->i[2]))
                    + 3.0 * integral(square, re5));
    *s = x->ring / (1.0 + nu)
         * (3.0 * nu * (integral(shear, n5) + integral(slant, re5))
            + 3.0 * w2 * (same * integral(re, n5) + ne * integral(square, x->i[3]))
            - 15.0 * integral(square, weighted(re, n7))
            + w2 * integral(both(x->normal, x->e[k], i, j), x->i[2])
            - same * (1.0 - 4.0 * nu) * ne * x->i[2].c[0]);
}

/* Recursions divide by m = 4 r r1 / S^2 once for each power of s2: below this they are not used. */
INLINE int is_small(double r, double a, double b)
{
    const double span2 = 4.0 * r * (r + a);
    return span2 < 0.3 * (a * a + b * b + span2);
}

/* Set the kernels of pairs at a point of a tile. */
INLINE void set_kernels(Tile *tile, int pairs, int at, double nu, int small)
{
    const double r = tile->r[at], a = tile->a[at], b = tile->b[at], r1 = r + a;
    const double nr = tile->nr[at], nz = tile->nz[at];
    const Powers zero = {{0.0}}, one = {{1.0}}, cosine = {{1.0, -2.0}}, sine = {{1.0}, 1};
    Point x = {
        .away = {{{a, -2.0 * r1}}, {{r1}, 1}, {{b}}},
        .normal = {{{nr, -2.0 * nr}}, {{nr}, 1}, {{nz}}},
        .e = {{cosine, sine, zero}, {{{-1.0}, 1}, cosine, zero}, {zero, zero, one}},
        .rn = {{nr * a + nz * b, 2.0 * r * nr}},
        .re = {{{a, 2.0 * r}}, {{r}, 1}, {{b}}},
        .ne = {nr, 0.0, nz},
        .ring = r1 / (8.0 * PI * (1.0 - nu)),
        .nu = nu,
    };
    if (small)
        moments_by_quadrature(r, a, b, x.i);
    else
        moments_by_recursion(r, a, b, x.i);
    Row *first = tile->value, *second = tile->value + pairs;
#define BOUNDARY(pair, i, k) boundary_kernel(&x, i, k, &first[pair][at], &second[pair][at])
#define STRESS(pair, i, j, k) stress_kernel(&x, i, j, k, &first[pair][at], &second[pair][at])
    if (pairs == PAIRS) {
        BOUNDARY(0, R, R), BOUNDARY(1, Z, R), BOUNDARY(2, R, Z), BOUNDARY(3, Z, Z);
        BOUNDARY(4, T, T);
    } else {
        STRESS(0, R, R, R), STRESS(1, T, T, R), STRESS(2, Z, Z, R), STRESS(3, R, Z, R);
        STRESS(4, R, R, Z), STRESS(5, T, T, Z), STRESS(6, Z, Z, Z), STRESS(7, R, Z, Z);
        STRESS(8, R, T, T), STRESS(9, T, Z, T);
    }
}

INLINE void fill(Tile *tile, int pairs, int count, double nu)
{
    const double *r = tile->r, *a = tile->a, *b = tile->b;
    int small = 0;
#pragma GCC ivdep
    for (int i = 0; i < count; i++) set_kernels(tile, pairs, i, nu, 0);
    for (int i = 0; i < count; i++) small += is_small(r[i], a[i], b[i]);
    for (int i = 0; small && i < count; i++)
        if (is_small(r[i], a[i], b[i])) set_kernels(tile, pairs, i, nu, 1);
}

/* Set the kernels of PAIRS, or STRESS_PAIRS, at the first points of a tile. */
VERSIONS static void fill_kernels(Tile *tile, int pairs, int count, double nu)
{
    count += -count & (VECTOR - 1);
    if (pairs == PAIRS)
        fill(tile, PAIRS, count, nu);
    else
        fill(tile, STRESS_PAIRS, count, nu);
}

/* ---- integrals over elements ---- */

/* A straight element: its first node, the vector to the last, length and outward normal */
typedef struct {
    double r, z, dr, dz, length, nr, nz;
} Element;

/* What is integrated for which sources and added where, see integrate_rows in _rings.pyx */
typedef struct {
    int64_t count;
    int pairs, components; /* at the source, of directions r and z */
    double nu;
    Doubles sources;
    Integers nodes, rows;
    double *matrix, *own;
    Doubles reach, points, weights; /* rules, see quadrature.py */
    /* the element; nodes, columns and factors there */
    Element e;
    Integers local, columns;
    Doubles factors;
    /* sources side by side: radii, offsets of the element's start (or of the source itself, where
       the element holds it) and heights of the fields that are subtracted */
    Row r, a, b, z0;
    Tile tile;
    /* integrals: of each pair's second kernel times the three shape functions and of its first
       kernel; over how many parts of the element */
    Row of[STRESS_PAIRS][4];
    int parts;
} Work;

/* Put sources side by side, the last repeated to fill a vector, with nothing integrated. */
static void set_sources(Work *w, const int64_t *sources, int count, int at)
{
    for (int i = 0; i < count + VECTOR; i++) {
        const double *source = w->sources + 3 * sources[i < count ? i : count - 1];
        w->r[i] = source[0];
        w->a[i] = at < 0 ? w->e.r - source[0] : 0.0;
        w->b[i] = at < 0 ? w->e.z - source[1] : 0.0;
        w->z0[i] = source[2];
    }
    w->parts = 0;
}

/* Add the integrals over a part of the element for `count` sources, by a rule of n points, 0 is the
   singular one. The part has a start, from where the offsets are, and a span, backwards if negative,
   over the element's length. Where a source is its node `at`, elsewhere -1, that node's shape
   function is left out. */
VERSIONS static void integrate(Work *w, int count, int at, int rule, double start, double span)
{
    const double *points = w->points + rule * MAX_POINTS, *weights = w->weights + rule * MAX_POINTS;
    const int n = rule ? rule : MAX_POINTS;
    double g[MAX_POINTS], h[MAX_POINTS][3];
    for (int q = 0; q < n; q++) {
        double *r = w->tile.r + q * count, *a = w->tile.a + q * count, *b = w->tile.b + q * count;
        const double place = start + span * points[q], t = place + (at < 0 ? 0.0 : 0.5 * at);
        for (int i = 0; i < count; i += VECTOR) {
            *(Vector *)(r + i) = *(const Vector *)(w->r + i);
            *(Vector *)(a + i) = *(const Vector *)(w->a + i) + place * w->e.dr;
            *(Vector *)(b + i) = *(const Vector *)(w->b + i) + place * w->e.dz;
        }
        g[q] = w->e.length * fabs(span) * weights[q];
        h[q][0] = g[q] * (1.0 - t) * (1.0 - 2.0 * t);
        h[q][1] = g[q] * 4.0 * t * (1.0 - t);
        h[q][2] = g[q] * t * (2.0 * t - 1.0);
        if (at >= 0) h[q][at] = 0.0;
    }
    fill_kernels(&w->tile, w->pairs, n * count, w->nu);
    for (int pair = 0; pair < w->pairs; pair++)
        for (int i = 0; i < count; i += VECTOR) {
            Row *of = w->of[pair];
            Vector x[4] = {{0.0}};
            for (int k = 0; k < 4 && w->parts; k++) x[k] = *(const Vector *)(of[k] + i);
            for (int q = 0; q < n; q++) {
                const double *first = w->tile.value[pair] + q * count + i;
                const Vector second = *(const Vector *)(first + w->pairs * ROW);
                for (int k = 0; k < 3; k++) x[k] += h[q][k] * second;
                x[3] += g[q] * *(const Vector *)first;
            }
            for (int k = 0; k < 4; k++) *(Vector *)(of[k] + i) = x[k];
        }
    w->parts++;
}

/* Return the least n points that serve where distances of the ends over the length are ratio, more
   than MAX_POINTS: none do. From the last answer on, as it is often the same. */
INLINE int points_needed(const double *reach, double ratio, int n)
{
    while (n > 1 && reach[n - 1] <= ratio) n--;
    while (n <= MAX_POINTS && reach[n] > ratio) n++;
    return n;
}

/* Integrate over a part that is close to the source, halved as often as rules need; 0: too close. */
static int integrate_near(Work *w, int at, double start, double span, int depth)
{
    const double a = w->a[0] + start * w->e.dr, b = w->b[0] + start * w->e.dz;
    const double distances = hypot(a, b) + hypot(a + span * w->e.dr, b + span * w->e.dz);
    const int n = points_needed(w->reach, distances / (w->e.length * span), 1);
    if (n > MAX_POINTS)
        return depth < DEEPEST && integrate_near(w, at, start, 0.5 * span, depth + 1)
               && integrate_near(w, at, start + 0.5 * span, 0.5 * span, depth + 1);
    integrate(w, 1, at, n, start, span);
    return 1;
}

/* Integrate over the element around the source, its node `at`, by the singular rule on both sides;
   near the axis, where kernels change over the radius, not beyond that. */
static int integrate_around(Work *w, int at)
{
    const double reach = w->r[0] / w->e.length;
    for (int side = -1; side <= 1; side += 2) {
        const double whole = side < 0 ? 0.5 * at : 1.0 - 0.5 * at;
        const double span = reach > 0.0 && whole > 1.5 * reach ? reach : whole;
        if (whole > 0.0) integrate(w, 1, at, 0, 0.0, side * span);
        if (span < whole && !integrate_near(w, at, side < 0 ? -whole : span, whole - span, 0)) return 0;
    }
    return 1;
}

/* Set what the integrals of a pair add to the sources' own columns: shape functions sum to one, and
   to radius or height when weighted with that of their nodes, so that the integral over a field u*,
   t* needs no kernels of its own. The fields are uniform along z; turn; or are u* = (r1 e_r - lateral
   (z1 - z0) e_z) / r, which has no axial stress, and stresses that stay finite as Poisson's ratio
   goes to 1/2; its traction, along r, is star over r. */
VERSIONS static void set_own(const Work *w, int pair, int count, double *restrict own)
{
    const double lateral = 2.0 * w->nu / (1.0 - w->nu), star = w->e.nr / (1.0 - w->nu);
    const Row *h = w->of[pair], *axial = w->of[pair + w->components];
    const int direction = pair / w->components; /* r, z or theta */
    for (int i = 0; i < count; i += VECTOR) {
        Vector sum = {0.0};
        for (int k = 0; k < 3; k++) {
            const double r = w->e.r + 0.5 * k * w->e.dr, z = w->e.z + 0.5 * k * w->e.dz;
            sum -= (direction == 1 ? 1.0 : r) * *(const Vector *)(h[k] + i);
            if (direction == 0)
                sum += lateral * (z - *(const Vector *)(w->z0 + i)) * *(const Vector *)(axial[k] + i);
        }
        if (direction == 0) sum += star * *(const Vector *)(h[3] + i);
        *(Vector *)(own + i) = sum;
    }
}

/* Add the integrals, times factors, to columns, of which -1 is none, at the rows of sources. */
static void add(const Work *w, const int64_t *sources, int count)
{
    Row own;
    int64_t rows[TILE];
    for (int pair = 0; pair < w->pairs; pair++) {
        const int direction = pair / w->components;
        const int64_t *of_component = w->rows + (pair - (direction > 0) * w->components) * w->count;
        set_own(w, pair, count, own);
        for (int i = 0; i < count; i++) {
            rows[i] = of_component[sources[i]];
            w->own[pair * w->count + sources[i]] += own[i];
        }
        for (int k = 0; k < 4; k++) {
            const int64_t column = w->columns[4 * direction + k];
            const double factor = w->factors[4 * direction + k], *restrict integrals = w->of[pair][k];
            double *restrict entries = w->matrix + column;
            for (int i = 0; column >= 0 && i < count; i++)
                if (rows[i] >= 0) entries[rows[i]] += factor * integrals[i];
        }
    }
}

/* Integrate for sources that wait for a rule of n points. */
static void integrate_waiting(Work *w, int n, const int64_t *sources, int *count)
{
    if (!*count) return;
    set_sources(w, sources, *count, -1);
    integrate(w, *count, -1, n, 0.0, 1.0);
    add(w, sources, *count);
    *count = 0;
}

/* Add the integrals over the element: side by side for sources with the same rule, one by one for
   those on it or so close that it is cut in parts; 0: it is too close to one. */
static int integrate_element(Work *w)
{
    int64_t waiting[MAX_POINTS + 1][TILE];
    int count[MAX_POINTS + 1] = {0}, n = 1;
    for (int i = 0; i < ROW; i++) w->tile.nr[i] = w->e.nr, w->tile.nz[i] = w->e.nz;
    for (int64_t s = 0; s < w->count; s++) {
        const double a = w->e.r - w->sources[3 * s], b = w->e.z - w->sources[3 * s + 1];
        const double a1 = a + w->e.dr, b1 = b + w->e.dz;
        const double distances = sqrt(a * a + b * b) + sqrt(a1 * a1 + b1 * b1);
        n = points_needed(w->reach, distances / w->e.length, n);
        if (n > MAX_POINTS) {
            int at = 2;
            while (at >= 0 && w->local[at] != w->nodes[s]) at--;
            set_sources(w, &s, 1, at);
            if (!(at < 0 ? integrate_near(w, at, 0.0, 1.0, 0) : integrate_around(w, at))) return 0;
            add(w, &s, 1);
            continue;
        }
        waiting[n][count[n]++] = s;
        if ((count[n] + 1) * n > TILE) integrate_waiting(w, n, waiting[n], &count[n]);
    }
    for (n = 1; n <= MAX_POINTS; n++) integrate_waiting(w, n, waiting[n], &count[n]);
    return 1;
}
