/* The algebra of topcli's HK step of the Euler top in C, operation by operation, in the loop that a C programmer would
   write. With -ffp-contract=off the results equal the compiled Python bit for bit. */

#include <math.h>

typedef struct { double w1, w2, w3; } state;

static inline state hk_step(state y, double h, const double *p)
{
    const double d = 0.5 * h, c1 = d * p[3], c2 = d * p[4], c3 = d * p[5];
    const double w1 = y.w1, w2 = y.w2, w3 = y.w3;
    const double a1 = (c2 * c3) * w1, t1 = (2.0 * c1) * w2 * w3, a2 = (c3 * c1) * w2, a3 = (c1 * c2) * w3;
    const double b2 = a2 * w2, b3 = a3 * w3;
    const double r = 2.0 / (fma(-a1, t1, fma(-a1, w1, 1.0)) - (b2 + b3));
    const double b1 = a1 * w1, u1 = 0.5 * t1, u2 = c2 * (w3 * w1), u3 = c3 * (w1 * w2);
    return (state){
        fma(r, fma(c1, fma(w2, u3, w3 * u2), fma(b1, u1, u1)), w1),
        fma(r, fma(c2, fma(w3, u1, w1 * u3), fma(b2, u2, u2)), w2),
        fma(r, fma(c3, fma(w1, u2, w2 * u1), fma(b3, u3, u3)), w3),
    };
}

void hk(double *y, const double *p, double h, long long n)
{
    state s = {y[0], y[1], y[2]};
    for (long long i = 0; i < n; i++) s = hk_step(s, h, p);
    y[0] = s.w1; y[1] = s.w2; y[2] = s.w3;
}
