/* Rotations of a vector in C, the algebra of topcli's kernels: shared by the steps that turn gamma. */
#include <math.h>

typedef struct { double x, y, z; } vec;

static const double small_angle_sq = 0.6168502750680849;

static inline vec cayley(double a1, double a2, double a3, double g1, double g2, double g3)
{
    const double b1 = fma(g2, a3, -(g3 * a2)), b2 = fma(g3, a1, -(g1 * a3)), b3 = fma(g1, a2, -(g2 * a1));
    const double r = 2.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3));
    return (vec){r * (b1 + fma(b2, a3, -(b3 * a2))), r * (b2 + fma(b3, a1, -(b1 * a3))),
                 r * (b3 + fma(b1, a2, -(b2 * a1)))};
}

static inline double sinc_of_square(double t)
{
    if (t <= small_angle_sq) {
        const double u = t * t;
        const double low = -1.66666666666666324348e-01 + t * 8.33333333332248946124e-03;
        const double mid = -1.98412698298579493134e-04 + t * 2.75573137070700676789e-06;
        const double high = -2.50507602534068634195e-08 + t * 1.58969099521155010221e-10;
        return 1.0 + t * (low + u * (mid + u * high));
    }
    const double x = sqrt(t);
    return sin(x) / x;
}

static inline double cosc_of_square(double t)
{
    if (t <= small_angle_sq) {
        const double u = t * t;
        const double low = 4.16666666666666019037e-02 - t * 1.38888888888741095749e-03;
        const double mid = 2.48015872894767294178e-05 - t * 2.75573143513906633035e-07;
        const double high = 2.08757232129817482790e-09 - t * 1.13596475577881948265e-11;
        return 0.5 - t * (low + u * (mid + u * high));
    }
    const double half = sin(0.5 * sqrt(t));
    return 2.0 * half * half / t;
}
