/* The algebra of topcli's HK and hybrid steps in C, operation by operation, in the loop that a C programmer would write.
   With -ffp-contract=off the results equal the compiled Python bit for bit. */
#include <math.h>

#include "rotations.h"

typedef struct { double w1, w2, w3, g1, g2, g3; } state;

static inline __attribute__((always_inline)) state hk_step(state y, double h, double c)
{
    const double w1 = y.w1, w2 = y.w2, w3 = y.w3, g1 = y.g1, g2 = y.g2, g3 = y.g3;
    const double d = 0.5 * h, f = d * c, k = 0.5 * (d * f);
    const double a = (0.5 * d) * w3, W2 = d * w2, fg2 = f * g2, S = w3 - fg2, half_s = (0.5 * d) * S;
    const double u = fma(a, w2, w1), q = fma(a, a, 1.0), phi = (0.5 * f) * g3;
    const double x2 = (1.0 / q) * fma(-u, half_s, phi), t = w2 * half_s;
    const double b1 = fma(a, x2, w1 + t), b2 = w2 + x2;
    const double s = half_s + half_s, H = d * phi, v = d * u, n = fma(W2, q, H), js = fma(W2, v, s + s);
    const double z = a + (a - half_s);
    const double m11 = fma(a, js, fma(v, v, fma(H, W2, fma(-(k + k), g1, 1.0))));
    const double m12 = fma(a, n + (H + H), q * v), m21 = W2 * (js + (z - s));
    const double m22 = fma(W2, n, fma(a, z, fma(-k, g1, 1.0)));
    const double eta = fma(-g3, b2, g2 * S);
    const double e2 = fma(-(a + a), eta, fma(g3, b1, -(g1 * S))), e3 = fma(-g2, b1, fma(W2, eta, g1 * b2));
    const double r = h / fma(-m12, m21, m11 * m22);
    const double y2 = r * fma(e3, m12, e2 * m22), b = r * fma(e3, m11, e2 * m21);
    const double two_x2 = fma(0.5 * f, b, x2 + x2);
    return (state){
        w1 + fma(a, two_x2, fma(-k * w2, y2, t + t)),
        w2 + two_x2,
        w3 - fma(f, y2, fg2 + fg2),
        g1 + fma(js - s, y2, fma(-n, b, h * eta)),
        g2 + y2,
        g3 + fma(-v, y2, q * b),
    };
}

static inline __attribute__((always_inline)) state hybrid_step(state y, double h, double c)
{
    const double w1 = y.w1, w2 = y.w2, w3 = y.w3, g1 = y.g1, g2 = y.g2, g3 = y.g3;
    const state p = hk_step(y, h, c);
    const double k = 0.25 * h;
    const double a1 = k * (p.w1 + w1), a2 = k * (p.w2 + w2), a3 = k * (p.w3 + w3);
    const vec turn = cayley(a1, a2, a3, g1, g2, g3);
    const double n1 = g1 + turn.x, n2 = g2 + turn.y, n3 = g3 + turn.z;
    const double x = (w1 - w2) * (w1 + w2) - c * g1, im = 2.0 * w1 * w2 - c * g2;
    const double chi = (0.5 * h) * (p.w3 + w3), t = chi * chi;
    const double sn = chi * sinc_of_square(t), cs = t * cosc_of_square(t);
    const double zx = (x + (sn * im - cs * x)) + c * n1, zy = (im + -(sn * x + cs * im)) + c * n2;
    const double m = 0.5 * (sqrt(zx * zx + zy * zy) + fabs(zx)), b = 0.5 * zy, ratio = b / (m + 1e-290);
    double root = sqrt(m);
    if (zx >= 0.0) {
        if (m * p.w1 + b * p.w2 < 0.0) root = -root;
        return (state){root, ratio * root, p.w3, n1, n2, n3};
    }
    if (b * p.w1 + m * p.w2 < 0.0) root = -root;
    return (state){ratio * root, root, p.w3, n1, n2, n3};
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
