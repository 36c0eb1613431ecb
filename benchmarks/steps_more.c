/* The algebra of topcli's other steps in C, operation by operation, each in the loop that a C programmer would write.
   ``name(work, p, h, n)`` takes n steps of a working state. With -ffp-contract=off the results equal the compiled
   Python bit for bit. */
#include <math.h>

#include "hk_kowalevski.h"
#include "rotations.h"

typedef struct { double x, y; } two;

static const double switch_below = -0.8;

static inline void carried_sum(double *y, double *e, double d)
{
    const double t = d + *e, s = *y + t;
    *e = (*y - s) + t;
    *y = s;
}

static inline vec rodrigues(double a1, double a2, double a3, double g1, double g2, double g3)
{
    const double t = a1 * a1 + (a2 * a2 + a3 * a3), sinc = sinc_of_square(t), cosc = cosc_of_square(t);
    const double b1 = g2 * a3 - g3 * a2, b2 = g3 * a1 - g1 * a3, b3 = g1 * a2 - g2 * a1;
    return (vec){sinc * b1 + cosc * (b2 * a3 - b3 * a2), sinc * b2 + cosc * (b3 * a1 - b1 * a3),
                 sinc * b3 + cosc * (b1 * a2 - b2 * a1)};
}

static inline two turn(double chi, double x, double y)
{
    const double t = chi * chi, s = chi * sinc_of_square(t), k = t * cosc_of_square(t);
    return (two){s * y - k * x, -(s * x + k * y)};
}

static inline two root_nearest(double x, double y, double p1, double p2)
{
    const double m = 0.5 * (sqrt(x * x + y * y) + fabs(x)), b = 0.5 * y, ratio = b / (m + 1e-290);
    double t = sqrt(m);
    if (x >= 0.0) {
        if (m * p1 + b * p2 < 0.0) t = -t;
        return (two){t, ratio * t};
    }
    if (b * p1 + m * p2 < 0.0) t = -t;
    return (two){ratio * t, t};
}

/* ------------------------------------------------------------------------------------------- HK, Kowalevski */

#define LOAD double w1 = y[0], w2 = y[1], w3 = y[2], g1 = y[3], g2 = y[4], g3 = y[5]
#define STORE y[0] = w1; y[1] = w2; y[2] = w3; y[3] = g1; y[4] = g2; y[5] = g3
#define COMPENSATE                                                                            \
    carried_sum(&w1, &e1, x.x1); carried_sum(&w2, &e2, x.x2); carried_sum(&w3, &e3, x.x3);    \
    carried_sum(&g1, &e4, x.y1); carried_sum(&g2, &e5, x.y2); carried_sum(&g3, &e6, x.y3)
#define PLAIN w1 += x.x1; w2 += x.x2; w3 += x.x3; g1 += x.y1; g2 += x.y2; g3 += x.y3

void hk_compensated(double *y, const double *p, double h, long long n)
{
    const double c = p[0];
    LOAD;
    double e1 = y[6], e2 = y[7], e3 = y[8], e4 = y[9], e5 = y[10], e6 = y[11];
    for (long long i = 0; i < n; i++) {
        const six x = hk_change(w1, w2, w3, g1, g2, g3, h, c);
        COMPENSATE;
    }
    STORE;
    y[6] = e1; y[7] = e2; y[8] = e3; y[9] = e4; y[10] = e5; y[11] = e6;
}

/* --------------------------------------------------------------------------------------------- the hybrids */

static inline double to_length_sq(double now, double wanted)
{
    return wanted > 0.0 ? 0.5 * ((wanted - now) / wanted) : 0.0;
}

void hybrid_xi(double *y, const double *p, double h, long long n)
{
    const double c = p[0], k = y[8], g_sq = y[9], m = 0.25 * h;
    LOAD;
    double u1 = y[6], u2 = y[7];
    for (long long i = 0; i < n; i++) {
        const six x = hk_change(w1, w2, w3, g1, g2, g3, h, c);
        const double q1 = w1 + x.x1, q2 = w2 + x.x2, v3 = w3 + x.x3;
        const vec d = cayley(m * (q1 + w1), m * (q2 + w2), m * (v3 + w3), g1, g2, g3);
        const double to_g = to_length_sq(g1 * g1 + (g2 * g2 + g3 * g3), g_sq);
        const two t = turn((0.5 * h) * (v3 + w3), u1, u2);
        const double to_u = to_length_sq(u1 * u1 + u2 * u2, 1.0);
        g3 += d.z + to_g * g3;
        g1 += d.x + to_g * g1;
        g2 += d.y + to_g * g2;
        u1 += t.x + to_u * u1;
        u2 += t.y + to_u * u2;
        const two v = root_nearest(k * u1 + c * g1, k * u2 + c * g2, q1, q2);
        w1 = v.x; w2 = v.y; w3 = v3;
    }
    STORE;
    y[6] = u1; y[7] = u2;
}

void hybrid_xi_compensated(double *y, const double *p, double h, long long n)
{
    const double c = p[0], k = y[8], g_sq = y[9], m = 0.25 * h;
    LOAD;
    double u1 = y[6], u2 = y[7], e3 = y[10], e4 = y[11], e5 = y[12], e6 = y[13], e7 = y[14], e8 = y[15];
    for (long long i = 0; i < n; i++) {
        const six x = hk_change(w1, w2, w3, g1, g2, g3, h, c);
        const double o3 = 2.0 * w3 + x.x3;
        const vec d = cayley(m * (2.0 * w1 + x.x1), m * (2.0 * w2 + x.x2), m * o3, g1, g2, g3);
        const double to_g = to_length_sq(g1 * g1 + (g2 * g2 + g3 * g3), g_sq);
        const two t = turn((0.5 * h) * o3, u1, u2);
        const double to_u = to_length_sq(u1 * u1 + u2 * u2, 1.0);
        const double q1 = w1 + x.x1, q2 = w2 + x.x2;
        carried_sum(&w3, &e3, x.x3);
        carried_sum(&g1, &e4, d.x + to_g * g1);
        carried_sum(&g2, &e5, d.y + to_g * g2);
        carried_sum(&g3, &e6, d.z + to_g * g3);
        carried_sum(&u1, &e7, t.x + to_u * u1);
        carried_sum(&u2, &e8, t.y + to_u * u2);
        const two v = root_nearest(k * u1 + c * g1, k * u2 + c * g2, q1, q2);
        w1 = v.x; w2 = v.y;
    }
    STORE;
    y[6] = u1; y[7] = u2; y[10] = e3; y[11] = e4; y[12] = e5; y[13] = e6; y[14] = e7; y[15] = e8;
}

/* ------------------------------------------------------------------------------------------ Bohlin's method */

static inline vec on_chart(double side, double w1, double w2, double w3, double g1, double g2, double g3, double h)
{
    const double r = 1.0 / (1.0 + side * g3), x = g1 * r, y = g2 * r, a1 = side * w1, a2 = side * w2;
    const double xx = x * x - y * y, xy = 2.0 * x * y;
    const double re = (a1 - 2.0 * w3 * x) - (a1 * xx + a2 * xy), im = (a2 - 2.0 * w3 * y) - (a1 * xy - a2 * xx);
    const double d = 0.5 * h, z1 = x - d * im, z2 = y + d * re, t = z1 * z1 + z2 * z2, n = 1.0 / (1.0 + t);
    return (vec){2.0 * z1 * n, 2.0 * z2 * n, side * (1.0 - t) * n};
}

#define BOHLIN(name, setup, gamma, after, end)                                                \
    void name(double *y, const double *p, double h, long long n)                              \
    {                                                                                         \
        const double c = p[0], d = 0.5 * h;                                                   \
        LOAD;                                                                                 \
        setup;                                                                                \
        for (long long i = 0; i < n; i++) {                                                   \
            gamma;                                                                            \
            const double v3 = w3 - (d * c) * (n2 + g2);                                       \
            const double x = (w1 - w2) * (w1 + w2) - c * g1, im = 2.0 * w1 * w2 - c * g2;     \
            const two t = turn(d * (v3 + w3), x, im);                                         \
            const double q1 = w1 + d * (w3 * w2), q2 = w2 - d * (w3 * w1 - c * g3);           \
            const two v = root_nearest((x + t.x) + c * n1, (im + t.y) + c * n2, q1, q2);      \
            after;                                                                            \
            w1 = v.x; w2 = v.y; w3 = v3; g1 = n1; g2 = n2; g3 = n3;                           \
        }                                                                                     \
        STORE;                                                                                \
        end;                                                                                  \
    }

BOHLIN(bohlin_a, , const vec m = cayley(d * w1, d * w2, d * w3, g1, g2, g3);
       const double n1 = g1 + m.x; const double n2 = g2 + m.y; const double n3 = g3 + m.z, , )
BOHLIN(bohlin_b, double count = y[6],
       const vec m = on_chart(g3 < switch_below ? -1.0 : 1.0, w1, w2, w3, g1, g2, g3, h);
       const double n1 = m.x; const double n2 = m.y; const double n3 = m.z,
       if ((n3 < switch_below) != (g3 < switch_below)) count += 1.0, y[6] = count)
BOHLIN(bohlin_c, , const vec m = rodrigues(h * w1, h * w2, h * w3, g1, g2, g3);
       const double n1 = g1 + m.x; const double n2 = g2 + m.y; const double n3 = g3 + m.z, , )

/* -------------------------------------------------------------------------------------- any top: HK, midpoint */

typedef struct { double a, b, c, d, e, f, g, h, i; } matrix;

static inline vec resolvent(double a1, double a2, double a3, double b1, double b2, double b3)
{
    const double r = 1.0 / ((1.0 + a1 * a1) + (a2 * a2 + a3 * a3)), k = a1 * b1 + a2 * b2 + a3 * b3;
    return (vec){r * (b1 + (b2 * a3 - b3 * a2) + k * a1), r * (b2 + (b3 * a1 - b1 * a3) + k * a2),
                 r * (b3 + (b1 * a2 - b2 * a1) + k * a3)};
}

static inline vec solve3(matrix m, double r1, double r2, double r3)
{
    const double c11 = m.e * m.i - m.f * m.h, c12 = m.f * m.g - m.d * m.i, c13 = m.d * m.h - m.e * m.g;
    const double q = 1.0 / (m.a * c11 + m.b * c12 + m.c * c13);
    return (vec){q * (r1 * c11 + r2 * (m.c * m.h - m.b * m.i) + r3 * (m.b * m.f - m.c * m.e)),
                 q * (r1 * c12 + r2 * (m.a * m.i - m.c * m.g) + r3 * (m.c * m.d - m.a * m.f)),
                 q * (r1 * c13 + r2 * (m.b * m.g - m.a * m.h) + r3 * (m.a * m.e - m.b * m.d))};
}

static inline matrix implicit_matrix(double a1, double a2, double a3, double g1, double g2, double g3, double d,
                                     double A, double B, double C, double x, double y, double z)
{
    const double e1 = d * g1, e2 = d * g2, e3 = d * g3;
    const vec p = resolvent(a1, a2, a3, 0.0, e3, -e2), q = resolvent(a1, a2, a3, -e3, 0.0, e1);
    const vec r = resolvent(a1, a2, a3, e2, -e1, 0.0);
    double f1 = 1.0 / A, f2 = 1.0 / B, f3 = 1.0 / C;
    const double k1 = f1 * (B - C), k2 = f2 * (C - A), k3 = f3 * (A - B);
    f1 = d * f1; f2 = d * f2; f3 = d * f3;
    return (matrix){1.0 - f1 * (p.y * z - p.z * y), -k1 * a3 - f1 * (q.y * z - q.z * y),
                    -k1 * a2 - f1 * (r.y * z - r.z * y), -k2 * a3 - f2 * (p.z * x - p.x * z),
                    1.0 - f2 * (q.z * x - q.x * z), -k2 * a1 - f2 * (r.z * x - r.x * z),
                    -k3 * a2 - f3 * (p.x * y - p.y * x), -k3 * a1 - f3 * (q.x * y - q.y * x),
                    1.0 - f3 * (r.x * y - r.y * x)};
}

static inline double two_sum(double a, double b, double *e)
{
    const double s = a + b, t = s - a;
    *e = (a - (s - t)) + (b - t);
    return s;
}

static inline vec acceleration(double o1, double o2, double o3, double q1, double q2, double q3, double A, double B,
                               double C, double x, double y, double z)
{
    double r1, r2, r3;
    const double k1 = two_sum(B, -C, &r1), k2 = two_sum(C, -A, &r2), k3 = two_sum(A, -B, &r3);
    const double o23 = o2 * o3, o31 = o3 * o1, o12 = o1 * o2;
    return (vec){((k1 * o23 + r1 * o23) + (q2 * z - q3 * y)) / A, ((k2 * o31 + r2 * o31) + (q3 * x - q1 * z)) / B,
                 ((k3 * o12 + r3 * o12) + (q1 * y - q2 * x)) / C};
}

static inline six hk_heavy_change(double w1, double w2, double w3, double g1, double g2, double g3, double h, double A,
                                  double B, double C, double x, double y, double z)
{
    const double d = 0.5 * h, a1 = d * w1, a2 = d * w2, a3 = d * w3;
    const vec b = cayley(a1, a2, a3, g1, g2, g3);
    const double t1 = g1 + 0.5 * b.x, t2 = g2 + 0.5 * b.y, t3 = g3 + 0.5 * b.z;
    const vec u = solve3(implicit_matrix(a1, a2, a3, g1, g2, g3, d, A, B, C, x, y, z),
                         (h / A) * ((B - C) * w2 * w3 + (t2 * z - t3 * y)),
                         (h / B) * ((C - A) * w3 * w1 + (t3 * x - t1 * z)),
                         (h / C) * ((A - B) * w1 * w2 + (t1 * y - t2 * x)));
    const vec v = resolvent(a1, a2, a3, d * (g2 * u.z - g3 * u.y), d * (g3 * u.x - g1 * u.z),
                            d * (g1 * u.y - g2 * u.x));
    return (six){u.x, u.y, u.z, b.x + v.x, b.y + v.y, b.z + v.z};
}

void hk_heavy(double *y, const double *p, double h, long long n)
{
    LOAD;
    for (long long i = 0; i < n; i++) {
        const six x = hk_heavy_change(w1, w2, w3, g1, g2, g3, h, p[0], p[1], p[2], p[3], p[4], p[5]);
        PLAIN;
    }
    STORE;
}

void midpoint(double *y, const double *p, double h, long long n)
{
    LOAD;
    const double A = y[6], B = y[7], C = y[8], px = y[9], py = y[10], pz = y[11], d = 0.5 * h;
    double status = y[12], iterations = y[13];
    for (long long i = 0; i < n; i++) {
        const double gravity = (fabs(px) + fabs(py) + fabs(pz)) * (fabs(g1) + fabs(g2) + fabs(g3))
                               * (1.0 / A + 1.0 / B + 1.0 / C);
        const double tolerance = 0x1p-33 * (fabs(w1) + fabs(w2) + fabs(w3) + fabs(d) * gravity);
        double v1 = 0.0, v2 = 0.0, v3 = 0.0, more = 0.0;
        status = NAN;
        for (int k = 0; k < 25; k++) {
            more += 1.0;
            const double o1 = w1 + v1, o2 = w2 + v2, o3 = w3 + v3, a1 = d * o1, a2 = d * o2, a3 = d * o3;
            const vec b = cayley(a1, a2, a3, g1, g2, g3);
            const double q1 = g1 + 0.5 * b.x, q2 = g2 + 0.5 * b.y, q3 = g3 + 0.5 * b.z;
            const vec f = acceleration(o1, o2, o3, q1, q2, q3, A, B, C, px, py, pz);
            const vec e = solve3(implicit_matrix(a1, a2, a3, q1, q2, q3, d, A, B, C, px, py, pz), d * f.x - v1,
                                 d * f.y - v2, d * f.z - v3);
            v1 += e.x; v2 += e.y; v3 += e.z;
            if (fabs(e.x) + fabs(e.y) + fabs(e.z) <= tolerance) {
                status = 0.0;
                break;
            }
        }
        const double o1 = w1 + v1, o2 = w2 + v2, o3 = w3 + v3;
        const vec b = cayley(d * o1, d * o2, d * o3, g1, g2, g3);
        const vec f = acceleration(o1, o2, o3, g1 + 0.5 * b.x, g2 + 0.5 * b.y, g3 + 0.5 * b.z, A, B, C, px, py, pz);
        w1 += h * f.x; w2 += h * f.y; w3 += h * f.z;
        g1 += b.x; g2 += b.y; g3 += b.z;
        iterations += more;
    }
    STORE;
    y[12] = status; y[13] = iterations;
}

/* --------------------------------------------------------------------------------------------- HK, Lagrange */

static inline double two_prod(double a, double b, double *e)
{
    const double p = a * b;
    const double ta = 134217729.0 * a, a1 = ta - (ta - a), a2 = a - a1;
    const double tb = 134217729.0 * b, b1 = tb - (tb - b), b2 = b - b1;
    *e = ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2;
    return p;
}

void hk_lagrange(double *y, const double *p, double h, long long n)
{
    LOAD;
    const double d = 0.5 * h, f = d * p[1];
    double K = d * (p[0] * w3), sk_low, kk_low, q_low, one_low;
    const double D2 = d * w3 + K, S = D2 - K;
    K = D2 - S;
    const double sk = two_prod(S, K, &sk_low), kk = two_prod(K, K, &kk_low), q = two_sum(1.0, kk, &q_low);
    const double rq = 1.0 / q, one = two_prod(rq, q, &one_low);
    const double rq_low = rq * (((1.0 - one) - one_low) - rq * (q_low + kk_low)), F = f * rq;
    for (long long i = 0; i < n; i++) {
        const double z = (d * f) * g3, b = (z + sk_low) + sk, D1 = 1.0 - b, DD = D1 * D1 + D2 * D2, r = 1.0 / DD;
        const double e = d * g3;
        const double P1 = 2.0 * ((b * g1 + S * g2) - e * w2), P2 = 2.0 * ((b * g2 - S * g1) + e * w1);
        const double Q1 = -d * (w2 + K * w1), Q2 = d * (w1 - K * w2);
        const double t1 = K * w1 + f * g1, t2 = K * w2 + f * g2;
        const double T1 = 2.0 * (t2 - K * t1), T2 = -2.0 * (t1 + K * t2);
        const double X1 = rq * T1 + rq_low * T1, X2 = rq * T2 + rq_low * T2;
        const double V1 = -F * (K * g1 + g2) - w1, V2 = F * (K * g2 - g1) + w2;
        const double U1 = V1 * D1 + V2 * D2, U2 = V2 * D1 - V1 * D2;
        const double turned = 2.0 * (g1 * w2 - g2 * w1) + (g1 * X2 - g2 * X1);
        const double x = d * (turned * DD + (P1 * U2 + P2 * U1)) / (DD - d * (Q1 * U2 + Q2 * U1));
        const double N1 = P1 + x * Q1, N2 = P2 + x * Q2;
        const double Y1 = r * (N1 * D1 + N2 * D2), Y2 = r * (N2 * D1 - N1 * D2);
        w1 += X1 + F * (Y2 - K * Y1);
        w2 += X2 - F * (Y1 + K * Y2);
        g1 += Y1;
        g2 += Y2;
        g3 += x;
    }
    STORE;
}
