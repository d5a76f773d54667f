/* Contacts of histories, one after another: an active set, and conjugate gradients on it.

   Element i gives way by sum_j c[j n + i] p[j] and loses max(0, konst[i] + slope[i] p[i]) on each of
   w bodies. Preconditioned by the diagonal; residuals are those of C, which is not quite symmetric. */
#include <math.h>
typedef double *restrict Out;
typedef const double *restrict In;
typedef struct { int n, w, by_force; const double *c, *area, *diagonal; } Line;
#define BALANCE 1e-9 /* of the force */
enum { SETS = 100, WHOLE_STEPS = 8, ITERATIONS = 80 };
#define EACH for (int i = 0; i < n; i++)
/* several versions of a function; the processor's own is taken when the module is loaded */
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__) && __GNUC__ >= 12
#define VERSIONS __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define VERSIONS
#endif
#define INLINE static inline __attribute__((always_inline))

INLINE void product(int n, In c, In x, Out y)
{
    int j = 0;
    EACH y[i] = 0.0;
    for (; j + 8 <= n; j += 8) { /* eight columns at a time */
        In a = c + (long)j * n, b = a + 4 * (long)n;
        double any = 0.0;
        for (int k = 0; k < 8; k++) any += fabs(x[j + k]);
        if (any == 0.0) continue; /* no contact here */
        EACH y[i] += x[j] * a[i] + x[j + 1] * a[n + i] + x[j + 2] * a[2 * n + i] + x[j + 3] * a[3 * n + i]
                   + x[j + 4] * b[i] + x[j + 5] * b[n + i] + x[j + 6] * b[2 * n + i] + x[j + 7] * b[3 * n + i];
    }
    for (; j < n; j++) EACH y[i] += x[j] * c[(long)j * n + i];
}

/* Solve (C + slope) x - y = -g on the elements in contact, area . x = 0 or y = 0, until the residual
   is this share of that at x = 0; g becomes the gap after the change. The inverse is that of the
   diagonal of C + slope, 0 on other elements. Work is (2 n). */
INLINE double gradients(const Line *l, In inverse, In slope, double share, Out g, Out x, double *work)
{
    const int n = l->n;
    In area = l->area;
    Out s = work, a = work + n;
    double even = 0.0, miss = 0.0, before = 1.0, most = 0.0, along = 0.0;
    EACH {
        x[i] = s[i] = a[i] = 0.0;
        even += area[i] * inverse[i];
        miss += area[i] * inverse[i] * g[i];
    }
    const double per_force = l->by_force && even > 0.0 ? 1.0 / even : 0.0;
    double y = miss * per_force, more = y; /* g is what is left of it beside the approach */
    EACH g[i] -= more;
    for (int k = 0;; k++) {
        double size = 0.0, curve = 0.0;
        miss = 0.0;
        EACH {
            x[i] += along * s[i];
            g[i] += along * a[i];
            miss += area[i] * inverse[i] * g[i];
            size += area[i] * inverse[i] * g[i] * g[i];
        }
        more = miss * per_force;
        size -= miss * more;
        y += more;
        most = k ? most : size;
        const double again = k ? size / before : 0.0;
        EACH {
            g[i] -= more;
            s[i] = again * s[i] - inverse[i] * g[i];
        }
        if (!(size > share * share * most) || k == ITERATIONS) return y;
        product(n, l->c, s, a);
        EACH {
            a[i] += slope[i] * s[i];
            curve += area[i] * s[i] * a[i];
        }
        if (!(curve > 0.0)) return y;
        along = size / curve;
        before = size;
    }
}

VERSIONS static double conjugate_gradients(const Line *l, In inverse, In slope, double share, Out g, Out x,
                                           double *work)
{
    return gradients(l, inverse, slope, share, g, x, work);
}

/* Solve one contact from pressures p and approach d near it, to a share of the largest pressure and
   to a depth; return how many sets it took, -1: not solved. Work is (7 n). */
VERSIONS static int solve_contact(const Line *l, In gap, double load, In konst, In slope, long stride, double relative,
                         double depth, Out p, double *d, double *work)
{
    const int n = l->n;
    Out g = work, x = work + n, rise = work + 2 * n, own = work + 3 * n, inverse = work + 4 * n;
    int is_new = 1;
    for (int set = 0; set < SETS; set++) {
        if (is_new) { /* the gap at these pressures, which carry the force */
            double carried = 0.0, whole = 0.0;
            EACH {
                carried += l->area[i] * p[i];
                whole += l->area[i];
            }
            if (l->by_force) EACH p[i] = carried > 0.0 ? p[i] * (load / carried) : load / whole;
            product(n, l->c, p, g);
            EACH {
                g[i] += gap[i] - *d;
                rise[i] = 0.0;
            }
            for (int b = 0; b < l->w; b++) EACH {
                const double line = konst[b * stride + i] + slope[b * stride + i] * p[i];
                g[i] += line > 0.0 ? line : 0.0;
                rise[i] += line >= 0.0 ? slope[b * stride + i] : 0.0;
            }
            EACH own[i] = l->diagonal[i] + rise[i];
        }
        double off = 0.0, largest = 0.0, deep = 0.0, force = 0.0; /* natural residuals, MPa and mm */
        EACH {
            const double soft = 1.0 / own[i], miss = fabs(p[i] * own[i] < g[i] ? p[i] * own[i] : g[i]);
            off = miss * soft > off ? miss * soft : off;
            deep = miss > deep ? miss : deep;
            largest = p[i] > largest ? p[i] : largest;
            force += l->area[i] * p[i];
            inverse[i] = p[i] > 0.0 || g[i] < 0.0 ? soft : 0.0;
        }
        if (off <= relative * largest && deep <= depth) {
            if (!l->by_force || fabs(force - load) <= BALANCE * load) return set;
            is_new = 1;
            continue;
        }
        const double share = 0.3 * fmin(relative * largest / off, depth / deep);
        *d += gradients(l, inverse, rise, fmin(fmax(share, 1e-2), 0.1), g, x, work + 5 * n);
        double left = 0.0; /* elements that have left contact, or gone through a threshold */
        for (int b = 0; b < l->w; b++) EACH {
            const double line = konst[b * stride + i] + slope[b * stride + i] * p[i];
            left += fabs((line >= 0.0 ? 1.0 : 0.0) - (line + slope[b * stride + i] * x[i] >= 0.0 ? 1.0 : 0.0));
        }
        const double part = set < WHOLE_STEPS ? 1.0 : 0.5; /* sets that cycle settle so */
        EACH {
            p[i] += part * x[i];
            left += p[i] < 0.0 || part < 1.0 ? 1.0 : 0.0;
            p[i] = p[i] > 0.0 ? p[i] : 0.0;
        }
        is_new = left > 0.0;
    }
    return -1;
}
