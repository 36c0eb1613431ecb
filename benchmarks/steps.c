/* The algebra of topcli's HK and hybrid steps in C, operation by operation, in the loop that a C programmer would write.
   With -ffp-contract=off the results equal the compiled Python bit for bit. */
#include <math.h>

#include "rotations.h"

typedef struct { double w1, w2, w3, g1, g2, g3; } state;

static inline state hk_step(state y, double h, double c)
{
    const double w1 = y.w1, w2 = y.w2, w3 = y.w3, g1 = y.g1, g2 = y.g2, g3 = y.g3;
    const double d = 0.5 * h, f = d * c, e = d * f, k = 0.5 * e;
    const double W1 = d * w1, W2 = d * w2, W3 = d * w3;
    const double a = (0.5 * d) * w3, b = 3.0 * a, s = W3 - e * g2, H = k * g3, half = 0.5 * g3;
    const double q = 1.0 + a * a, rq = 1.0 / q, u = W2 - a * W1, v = W1 + a * W2;
    const double n = W2 * (1.0 - W3 * a) - b * W1, j = g1 - W2 * g3, m = W1 + W3 * W2, l = W1 - W2 * s;
    const double P = v * j + u * g2, Q = j - a * g2;
    const double m11 = q * ((1.0 - e * g1) + W3 * s) + H * n, m12 = q * m + b * H;
    const double m21 = q * l - k * P, m22 = q * (1.0 + W2 * W2) - k * Q;
    const double r = 2.0 / (m11 * m22 + m12 * m21);
    const double b1 = q * (g3 * m - s * (g1 + W3 * g2)) + half * (s * n + (b * e) * g3);
    const double b2 = q * (W2 * j - g2 * l) + (H * Q - (0.5 * s) * P);
    const double n2 = b1 * m22 + b2 * m12, n3 = b2 * m11 - b1 * m21;
    const double F = (0.5 * f) * rq, fg = f * g3;
    const double two_r1 = 2.0 * (g2 * s - g3 * W2) + rq * (g3 * (v * s - e * g3));
    return (state){
        w1 + (rq * ((w2 - a * w1) * s + a * fg) + r * (F * (a * n3 - u * n2))),
        w2 + (rq * (fg - (w1 + a * w2) * s) + r * (F * (n3 + v * n2))),
        w3 - (2.0 * (f * g2) + r * (f * n2)),
        g1 + (two_r1 + r * ((s - (H * rq) * v) * n2 - (W2 + H * rq) * n3)),
        g2 + r * n2,
        g3 + r * n3,
    };
}

static inline state hybrid_step(state y, double h, double c)
{
    const double w1 = y.w1, w2 = y.w2, w3 = y.w3, g1 = y.g1, g2 = y.g2, g3 = y.g3;
    const state p = hk_step(y, h, c);
    const double k = 0.25 * h;
    const double a1 = k * (p.w1 + w1), a2 = k * (p.w2 + w2), a3 = k * (p.w3 + w3);
    const vec r = cayley_added(a1, a2, a3, g1, g2, g3);
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
