/* The algebra of topcli's HK step of the Euler top in C, operation by operation, in the loop that a C programmer would
   write. With -ffp-contract=off the results equal the compiled Python bit for bit. */

typedef struct { double w1, w2, w3; } state;

static inline state hk_step(state y, double h, const double *p)
{
    const double d = 0.5 * h, c1 = d * p[3], c2 = d * p[4], c3 = d * p[5];
    const double w1 = y.w1, w2 = y.w2, w3 = y.w3;
    const double u1 = c1 * (w2 * w3), u2 = c2 * (w3 * w1), u3 = c3 * (w1 * w2);
    const double k1 = c2 * c3;
    const double b1 = k1 * (w1 * w1), b2 = (c3 * c1) * (w2 * w2), b3 = (c1 * c2) * (w3 * w3);
    const double r = 2.0 / ((1.0 - b1) - ((b2 + b3) + (2.0 * k1) * (u1 * w1)));
    return (state){
        w1 + r * ((u1 + b1 * u1) + c1 * (w2 * u3 + w3 * u2)),
        w2 + r * ((u2 + b2 * u2) + c2 * (w3 * u1 + w1 * u3)),
        w3 + r * ((u3 + b3 * u3) + c3 * (w1 * u2 + w2 * u1)),
    };
}

void hk(double *y, const double *p, double h, long long n)
{
    state s = {y[0], y[1], y[2]};
    for (long long i = 0; i < n; i++) s = hk_step(s, h, p);
    y[0] = s.w1; y[1] = s.w2; y[2] = s.w3;
}
