/* The algebra of topcli's splitting and discrete Moser-Veselov steps in C, operation by operation.
   ``name(work, p, h, n)`` takes n steps of a working state. With -ffp-contract=off the results equal the compiled
   Python bit for bit. */
#include <math.h>

#include "rotations.h"

#define LOAD double m1 = y[0], m2 = y[1], m3 = y[2], g1 = y[3], g2 = y[4], g3 = y[5]
#define STORE y[0] = m1; y[1] = m2; y[2] = m3; y[3] = g1; y[4] = g2; y[5] = g3

static inline double difference(double a, double b, double c, double d)
{
    const double p = c * d;
    return fma(a, b, -p) - fma(c, d, -p);
}

static inline vec kick(double d, double g1, double g2, double g3, double x, double y, double z)
{
    return (vec){d * difference(g2, z, g3, y), d * difference(g3, x, g1, z), d * difference(g1, y, g2, x)};
}

/* ------------------------------------------------------------------------------------------------ splitting */

typedef struct { double s, k, s_low, k_low; } rotation;

static inline rotation coefficients(double chi)
{
    const double t = chi * chi;
    const two c = sinc_cosc(t);
    const double s = c.x * chi, k = c.y * t, ss = s * s;
    const double half = 0.5 * (fma(k, k, fma(-2.0, k, ss)) + fma(s, s, -ss));
    return (rotation){s, k, -half * s, fma(-half, k, half)};
}

static inline two increment(rotation r, double x, double y)
{
    return (two){fma(r.s, y, -fma(r.k, x, fma(r.k_low, x, -(r.s_low * y)))),
                 -fma(r.s, x, fma(r.k, y, fma(r.k_low, y, r.s_low * x)))};
}

static inline two rotated(rotation r, double x, double y)
{
    return (two){x + fma(r.s, y, -(r.k * x)), y - fma(r.s, x, r.k * y)};
}

static inline vec orthogonal_rodrigues(double a1, double a2, double a3, double g1, double g2, double g3)
{
    const double t = a1 * a1 + fma(a2, a2, a3 * a3);
    const two c = sinc_cosc(t);
    const double u = t * c.y, ss = c.x * c.x;
    const double half = 0.5 * (fma(c.y, u, fma(-2.0, c.y, ss)) + fma(c.x, c.x, -ss));
    const double b_low = -half * (t * c.x), c_low = fma(-half, u, half);
    const double b1 = fma(g2, a3, -(g3 * a2)), b2 = fma(g3, a1, -(g1 * a3)), b3 = fma(g1, a2, -(g2 * a1));
    const double c1 = fma(b2, a3, -(b3 * a2)), c2 = fma(b3, a1, -(b1 * a3)), c3 = fma(b1, a2, -(b2 * a1));
    return (vec){fma(c.x, b1, fma(c.y, c1, fma(c_low, c1, b_low * b1))),
                 fma(c.x, b2, fma(c.y, c2, fma(c_low, c2, b_low * b2))),
                 fma(c.x, b3, fma(c.y, c3, fma(c_low, c3, b_low * b3)))};
}

void splitting_closed(double *y, const double *p, double h, long long n)
{
    LOAD;
    const double i1 = y[6], i3 = y[8], wx = y[9], wy = y[10], wz = y[11], d = 0.5 * h, f = h * i1, spin = h * (i3 - i1);
    for (long long i = 0; i < n; i++) {
        const vec u = kick(d, g1, g2, g3, wx, wy, wz);
        const double n1 = m1 + u.x, n2 = m2 + u.y, n3 = m3 + u.z;
        const vec q = orthogonal_rodrigues(f * n1, f * n2, f * n3, g1, g2, g3);
        const double e1 = g1 + q.x, e2 = g2 + q.y, e3 = g3 + q.z;
        const rotation r = coefficients(spin * n3);
        const two a = increment(r, n1, n2), b = increment(r, e1, e2);
        const vec v = kick(d, e1 + b.x, e2 + b.y, e3, wx, wy, wz);
        m1 += (u.x + v.x) + a.x; m2 += (u.y + v.y) + a.y; m3 += u.z + v.z;
        g1 += q.x + b.x; g2 += q.y + b.y; g3 += q.z;
    }
    STORE;
}

void splitting_axes(double *y, const double *p, double h, long long n)
{
    LOAD;
    const double wx = y[9], wy = y[10], wz = y[11], d = 0.5 * h, d1 = d * y[6], d2 = d * y[7], d3 = h * y[8];
    for (long long i = 0; i < n; i++) {
        const vec u = kick(d, g1, g2, g3, wx, wy, wz);
        const double n1 = m1 + u.x, n2 = m2 + u.y, n3 = m3 + u.z;
        rotation r = coefficients(d1 * n1);
        const two a = increment(r, n2, n3), p1 = increment(r, g2, g3), o1 = rotated(r, n2, n3);
        const double q2 = g2 + p1.x, q3 = g3 + p1.y;
        r = coefficients(d2 * o1.x);
        const two b = increment(r, o1.y, n1), p2 = increment(r, q3, g1), o2 = rotated(r, o1.y, n1);
        const double r3 = q3 + p2.x, r1 = g1 + p2.y;
        r = coefficients(d3 * o2.x);
        const two c = increment(r, o2.y, o1.x), p3 = increment(r, r1, q2), o3 = rotated(r, o2.y, o1.x);
        const double s1 = r1 + p3.x, s2 = q2 + p3.y;
        r = coefficients(d2 * o3.y);
        const two e = increment(r, o2.x, o3.x), p4 = increment(r, r3, s1), o4 = rotated(r, o2.x, o3.x);
        const double t3 = r3 + p4.x, t1 = s1 + p4.y;
        r = coefficients(d1 * o4.y);
        const two f = increment(r, o3.y, o4.x), p5 = increment(r, s2, t3);
        const vec v = kick(d, t1, s2 + p5.x, t3 + p5.y, wx, wy, wz);
        m1 += (u.x + v.x) + (b.y + (c.x + e.y));
        m2 += (u.y + v.y) + (a.x + (c.y + f.x));
        m3 += (u.z + v.z) + ((a.y + b.x) + (e.x + f.y));
        g1 += p2.y + (p3.x + p4.y);
        g2 += p1.x + (p3.y + p5.x);
        g3 += (p1.y + p2.x) + (p4.x + p5.y);
    }
    STORE;
}

/* ------------------------------------------------------------------------------------------- Moser-Veselov */

typedef struct { double m[9]; } matrix;

static inline vec residual(vec c, vec k, vec r)
{
    const double q = fma(c.x, c.x, 1.0) + fma(c.y, c.y, c.z * c.z);
    return (vec){fma(r.x, c.y * c.z, fma(-k.x, q, c.x)), fma(r.y, c.z * c.x, fma(-k.y, q, c.y)),
                 fma(r.z, c.x * c.y, fma(-k.z, q, c.z))};
}

static inline vec fixed_point(vec c, vec k, vec r)
{
    const double q = fma(c.x, c.x, 1.0) + fma(c.y, c.y, c.z * c.z);
    return (vec){fma(k.x, q, -(r.x * (c.y * c.z))), fma(k.y, q, -(r.y * (c.z * c.x))),
                 fma(k.z, q, -(r.z * (c.x * c.y)))};
}

static inline matrix jacobian(vec c, vec k, vec r)
{
    const double t1 = 2.0 * c.x, t2 = 2.0 * c.y, t3 = 2.0 * c.z;
    return (matrix){{fma(-k.x, t1, 1.0), fma(-k.x, t2, r.x * c.z), fma(-k.x, t3, r.x * c.y),
                     fma(-k.y, t1, r.y * c.z), fma(-k.y, t2, 1.0), fma(-k.y, t3, r.y * c.x),
                     fma(-k.z, t1, r.z * c.y), fma(-k.z, t2, r.z * c.x), fma(-k.z, t3, 1.0)}};
}

static inline vec solve3(matrix a, vec r)
{
    const double *m = a.m;
    const double c11 = m[4] * m[8] - m[5] * m[7], c12 = m[5] * m[6] - m[3] * m[8], c13 = m[3] * m[7] - m[4] * m[6];
    const double q = 1.0 / (m[0] * c11 + m[1] * c12 + m[2] * c13);
    return (vec){q * (r.x * c11 + r.y * (m[2] * m[7] - m[1] * m[8]) + r.z * (m[1] * m[5] - m[2] * m[4])),
                 q * (r.x * c12 + r.y * (m[0] * m[8] - m[2] * m[6]) + r.z * (m[2] * m[3] - m[0] * m[5])),
                 q * (r.x * c13 + r.y * (m[1] * m[6] - m[0] * m[7]) + r.z * (m[0] * m[4] - m[1] * m[3]))};
}

static inline vec minus(vec a, vec b) { return (vec){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline double size(vec a) { return fabs(a.x) + (fabs(a.y) + fabs(a.z)); }

static vec __attribute__((noinline)) newton(vec k, vec r, double *status, double *more)
{
    vec c = k;
    for (int i = 0; i < 30; i++) {
        *more += 1.0;
        const matrix a = jacobian(c, k, r);
        const vec e = solve3(a, residual(c, k, r));
        c = minus(c, e);
        if (size(e) <= 0x1p-50 * size(c)) return c;
    }
    *status = NAN;
    return (vec){0.0, 0.0, 0.0};
}

void dmv(double *y, const double *p, double h, long long n)
{
    LOAD;
    const double i1 = y[6], i2 = y[7], i3 = y[8], wx = y[12], wy = y[13], wz = y[14], d = 0.5 * h;
    const vec r = {y[9], y[10], y[11]};
    double status = y[15], iterations = y[16];
    for (long long i = 0; i < n; i++) {
        const vec u = kick(d, g1, g2, g3, wx, wy, wz);
        const double n1 = m1 + u.x, n2 = m2 + u.y, n3 = m3 + u.z;
        const vec k = {(d * i1) * n1, (d * i2) * n2, (d * i3) * n3};
        vec c = fixed_point(fixed_point(k, k, r), k, r);
        const matrix a = jacobian(c, k, r);
        c = minus(c, solve3(a, residual(c, k, r)));
        const vec one = solve3(a, residual(c, k, r));
        c = minus(c, one);
        const vec two_ = solve3(a, residual(c, k, r));
        c = minus(c, two_);
        const double before = size(one), last = size(two_), bits = 0x1p-50 * size(c);
        double more = 3.0;
        status = 0.0;
        if (__builtin_expect(!(last <= bits || 16.0 * last * last <= before * bits), 0)) c = newton(k, r, &status, &more);
        const vec x = cayley(c.x, c.y, c.z, n1, n2, n3), q = cayley(c.x, c.y, c.z, g1, g2, g3);
        const vec v = kick(d, g1 + q.x, g2 + q.y, g3 + q.z, wx, wy, wz);
        m1 += (u.x + v.x) + (r.x != 0.0 ? x.x : 0.0);
        m2 += (u.y + v.y) + (r.y != 0.0 ? x.y : 0.0);
        m3 += (u.z + v.z) + (r.z != 0.0 ? x.z : 0.0);
        g1 += q.x; g2 += q.y; g3 += q.z;
        iterations += more;
    }
    STORE;
    y[15] = status; y[16] = iterations;
}
