/* The algebra of topcli's HK and hybrid steps in C, operation by operation, in the loop that a C programmer would write.
   With -ffp-contract=off the results equal the compiled Python bit for bit. */
#include <math.h>

#include "hk_kowalevski.h"
#include "rotations.h"

typedef struct { double w1, w2, w3, g1, g2, g3; } state;

static inline __attribute__((always_inline)) state hk_step(state y, double h, double c)
{
    const six x = hk_change(y.w1, y.w2, y.w3, y.g1, y.g2, y.g3, h, c);
    return (state){y.w1 + x.x1, y.w2 + x.x2, y.w3 + x.x3, y.g1 + x.y1, y.g2 + x.y2, y.g3 + x.y3};
}

static inline __attribute__((always_inline)) state hybrid_step(state y, double h, double c)
{
    const double w1 = y.w1, w2 = y.w2, w3 = y.w3, g1 = y.g1, g2 = y.g2, g3 = y.g3;
    const state p = hk_step(y, h, c);
    const double k = 0.25 * h;
    const double a1 = k * (p.w1 + w1), a2 = k * (p.w2 + w2), a3 = k * (p.w3 + w3);
    const vec r = cayley_rotated(a1, a2, a3, g1, g2, g3);
    const double n1 = r.x, n2 = r.y, n3 = r.z;
    const double half = 0.5 * c, x = 0.5 * ((w1 - w2) * (w1 + w2)) - half * g1, im = w1 * w2 - half * g2;
    const two t = turn((0.5 * h) * (p.w3 + w3), x, im);
    const two v = root_nearest(fma(half, n1, x + t.x), fma(half, n2, im + t.y), p.w1, p.w2);
    return (state){v.x, v.y, p.w3, n1, n2, n3};
}

#define LOOP(name, step)                                       \
    void name(double *y, double h, double c, long long n)      \
    {                                                          \
        state s = {y[0], y[1], y[2], y[3], y[4], y[5]};        \
        for (long long i = 0; i < n; i++) s = step(s, h, c);   \
        y[0] = s.w1; y[1] = s.w2; y[2] = s.w3;                 \
        y[3] = s.g1; y[4] = s.g2; y[5] = s.g3;                 \
    }

LOOP(hk, hk_step)
LOOP(hybrid, hybrid_step)
