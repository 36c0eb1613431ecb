/* Rotations of a vector and of a complex number, and the complex root, in C: the algebra of topcli's kernels, shared by
   the steps that turn gamma and xi. */
#include <math.h>

typedef struct { double x, y, z; } vec;
typedef struct { double x, y; } two;

static const double small_angle_sq = 0.6168502750680849;

/* The change of g and the turned g, from the same r and vector */
#define CAYLEY(name, change_or_sum)                                                                          \
    static inline vec name(double a1, double a2, double a3, double g1, double g2, double g3)                 \
    {                                                                                                        \
        const double b1 = fma(g2, a3, -(g3 * a2)), b2 = fma(g3, a1, -(g1 * a3)), b3 = fma(g1, a2, -(g2 * a1)); \
        const double r = 2.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3));                                    \
        const double x1 = b1 + fma(b2, a3, -(b3 * a2)), x2 = b2 + fma(b3, a1, -(b1 * a3));                   \
        const double x3 = b3 + fma(b1, a2, -(b2 * a1));                                                      \
        return (vec)change_or_sum;                                                                           \
    }
#define LIST(...) {__VA_ARGS__}

CAYLEY(cayley, LIST(r * x1, r * x2, r * x3))
CAYLEY(cayley_rotated, LIST(fma(r, x1, g1), fma(r, x2, g2), fma(r, x3, g3)))

/* sin(x)/x and (1 - cos(x))/x**2 as functions of t = x*x */
static inline two sinc_cosc(double t)
{
    if (t <= small_angle_sq) {
        const double u = t * t;
        const double s1 = fma(t, 8.33333333332248946124e-03, -1.66666666666666324348e-01);
        const double s2 = fma(t, 2.75573137070700676789e-06, -1.98412698298579493134e-04);
        const double s3 = fma(t, 1.58969099521155010221e-10, -2.50507602534068634195e-08);
        const double c1 = fma(t, 1.38888888888741095749e-03, -4.16666666666666019037e-02);
        const double c2 = fma(t, 2.75573143513906633035e-07, -2.48015872894767294178e-05);
        const double c3 = fma(t, 1.13596475577881948265e-11, -2.08757232129817482790e-09);
        return (two){fma(t * u, fma(u, s3, s2), fma(t, s1, 1.0)), fma(t * u, fma(u, c3, c2), fma(t, c1, 0.5))};
    }
    const double x = sqrt(t), half = sin(0.5 * x);
    return (two){sin(x) / x, 2.0 * half * half / t};
}

/* (e^{-i chi} - 1)(x + i y) */
static inline two turn(double chi, double x, double y)
{
    const double t = chi * chi;
    const two k = sinc_cosc(t);
    return (two){fma(k.x, chi * y, -(k.y * (t * x))), -fma(k.x, chi * x, k.y * (t * y))};
}

/* a + i b and that */
static inline two turn_added(double chi, double x, double y, double a, double b)
{
    const double t = chi * chi;
    const two k = sinc_cosc(t);
    return (two){fma(k.x, chi * y, fma(-k.y, t * x, a)), fma(-k.x, chi * x, fma(-k.y, t * y, b))};
}

/* the square root of 2 (x + i y) that is nearest to p1 + i p2 */
static inline two root_nearest(double x, double y, double p1, double p2)
{
    const double m = sqrt(x * x + y * y) + fabs(x), ratio = y / (m + 1e-290);
    double t = sqrt(m);
    if (x >= 0.0) {
        if (fma(m, p1, y * p2) < 0.0) t = -t;
        return (two){t, ratio * t};
    }
    if (fma(m, p2, y * p1) < 0.0) t = -t;
    return (two){ratio * t, t};
}
