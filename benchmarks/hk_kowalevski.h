/* The change of (omega, gamma) in one HK step of the Kowalevski top, as in topcli/schemes/kowalevski/hk.py. */
#include <math.h>

typedef struct { double x1, x2, x3, y1, y2, y3; } six;

static inline __attribute__((always_inline)) six hk_change(double w1, double w2, double w3, double g1, double g2,
                                                           double g3, double h, double c)
{
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
    return (six){
        fma(a, two_x2, fma(-k * w2, y2, t + t)),
        two_x2,
        -fma(f, y2, fg2 + fg2),
        fma(js - s, y2, fma(-n, b, h * eta)),
        y2,
        fma(-v, y2, q * b),
    };
}
