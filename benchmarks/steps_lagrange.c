/* The algebra of topcli's BS step of the Lagrange top (inertial frame) in C, in the loop that a C programmer would
   write. With -ffp-contract=off the results equal the compiled Python bit for bit. */

#include <math.h>

#include "rotations.h"

typedef struct { double m1, m2, m3, a1, a2, a3; } state;

static inline state bs_step(state y, double h)
{
    const double n1 = fma(-h, y.a2, y.m1), n2 = fma(h, y.a1, y.m2);
    const double d = -0.5 * h, u1 = d * n1, u2 = d * n2, u3 = d * y.m3;
    const vec a = cayley_rotated(u1, u2, u3, y.a1, y.a2, y.a3);
    return (state){n1, n2, y.m3, a.x, a.y, a.z};
}

void bs(double *y, double h, long long n)
{
    state s = {y[0], y[1], y[2], y[3], y[4], y[5]};
    for (long long i = 0; i < n; i++) s = bs_step(s, h);
    y[0] = s.m1; y[1] = s.m2; y[2] = s.m3;
    y[3] = s.a1; y[4] = s.a2; y[5] = s.a3;
}
