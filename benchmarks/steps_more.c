/* The algebra of topcli's other steps in C, operation by operation, each in the loop that a C programmer would write.
   ``name(work, p, h, n)`` takes n steps of a working state. With -ffp-contract=off the results equal the compiled
   Python bit for bit. */
#include <math.h>

#include "hk_kowalevski.h"
#include "rotations.h"

static const double switch_below = -0.8;

static inline void carried_sum(double *y, double *e, double d)
{
    const double t = d + *e, s = *y + t;
    *e = (*y - s) + t;
    *y = s;
}

static inline vec rodrigues(double a1, double a2, double a3, double g1, double g2, double g3)
{
    const two k = sinc_cosc(a1 * a1 + fma(a2, a2, a3 * a3));
    const double b1 = fma(g2, a3, -(g3 * a2)), b2 = fma(g3, a1, -(g1 * a3)), b3 = fma(g1, a2, -(g2 * a1));
    return (vec){k.x * b1 + k.y * fma(b2, a3, -(b3 * a2)), k.x * b2 + k.y * fma(b3, a1, -(b1 * a3)),
                 k.x * b3 + k.y * fma(b1, a2, -(b2 * a1))};
}

/* ------------------------------------------------------------------------------------------- HK, Kowalevski */

#define LOAD double w1 = y[0], w2 = y[1], w3 = y[2], g1 = y[3], g2 = y[4], g3 = y[5]
#define STORE y[0] = w1; y[1] = w2; y[2] = w3; y[3] = g1; y[4] = g2; y[5] = g3
#define PLAIN w1 += x.x1; w2 += x.x2; w3 += x.x3; g1 += x.y1; g2 += x.y2; g3 += x.y3

static inline double missing(double h, double a, double b, double u, double v, double rest, double t, double e)
{
    const double p = a * b, p_low = fma(a, b, -p), q = u * v, q_low = fma(u, v, -q), s = p - q, back = s - p;
    const double s_low = (p - (s - back)) + (-q - back), x = h * s, x_low = fma(h, s, -x);
    return fma(0.5 * h, rest, ((x - t) + e) + fma(h, (p_low - q_low) + s_low, x_low));
}

static inline void add_up(double *y, double *e, double t, double missed)
{
    const double s = *y + t;
    *e = ((*y - s) + t) + missed;
    *y = s;
}

void hk_compensated(double *y, const double *p, double h, long long n)
{
    const double c = p[0];
    LOAD;
    double e1 = y[6], e2 = y[7], e3 = y[8], e4 = y[9], e5 = y[10], e6 = y[11];
    for (long long i = 0; i < n; i++) {
        const six x = hk_change(w1, w2, w3, g1, g2, g3, h, c);
        const double u1 = fma(2.0, e1, x.x1), u2 = fma(2.0, e2, x.x2), u3 = fma(2.0, e3, x.x3);
        const double v1 = fma(2.0, e4, x.y1), v2 = fma(2.0, e5, x.y2), v3 = fma(2.0, e6, x.y3);
        const double j1 = fma(g2, u3, w3 * v2) - fma(g3, u2, w2 * v3), j2 = fma(g3, u1, w1 * v3) - fma(g1, u3, w3 * v1);
        const double j3 = fma(g1, u2, w2 * v1) - fma(g2, u1, w1 * v2);
        const double t1 = x.y1 + e4, t2 = x.y2 + e5, t3 = x.y3 + e6;
        e4 = missing(h, g2, w3, g3, w2, j1, t1, e4);
        e5 = missing(h, g3, w1, g1, w3, j2, t2, e5);
        e6 = missing(h, g1, w2, g2, w1, j3, t3, e6);
        carried_sum(&w1, &e1, x.x1); carried_sum(&w2, &e2, x.x2); carried_sum(&w3, &e3, x.x3);
        add_up(&g1, &e4, t1, e4); add_up(&g2, &e5, t2, e5); add_up(&g3, &e6, t3, e6);
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
        const two v = root_nearest(fma(0.5 * c, g1, (0.5 * k) * u1), fma(0.5 * c, g2, (0.5 * k) * u2), q1, q2);
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
        const two v = root_nearest(fma(0.5 * c, g1, (0.5 * k) * u1), fma(0.5 * c, g2, (0.5 * k) * u2), q1, q2);
        w1 = v.x; w2 = v.y;
    }
    STORE;
    y[6] = u1; y[7] = u2; y[10] = e3; y[11] = e4; y[12] = e5; y[13] = e6; y[14] = e7; y[15] = e8;
}

/* ------------------------------------------------------------------------------------------ Bohlin's method */

static inline vec on_chart(double side, double w1, double w2, double w3, double g1, double g2, double g3, double h)
{
    const double r = 1.0 / fma(side, g3, 1.0), x = g1 * r, y = g2 * r, d = side * (0.5 * h);
    const double xx = x * x - y * y, xy = d * (2.0 * x * y), turn = h * w3;
    const double z1 = fma(-w2, fma(d, xx, d), fma(w1, xy, fma(turn, y, x)));
    const double z2 = fma(w1, fma(-d, xx, d), fma(-w2, xy, fma(-turn, x, y)));
    const double n = 2.0 / (fma(z1, z1, 1.0) + z2 * z2);
    return (vec){z1 * n, z2 * n, (0.5 * side) * n * (1.0 - fma(z1, z1, z2 * z2))};
}

#define BOHLIN(name, setup, gamma, after, end)                                                                \
    void name(double *y, const double *p, double h, long long n)                                              \
    {                                                                                                         \
        const double c = p[0], d = 0.5 * h, half = 0.5 * c, f = h * half;                                     \
        LOAD;                                                                                                 \
        setup;                                                                                                \
        for (long long i = 0; i < n; i++) {                                                                   \
            gamma;                                                                                            \
            const double x = 0.5 * ((w1 - w2) * (w1 + w2)) - half * g1, im = w1 * w2 - half * g2;             \
            const double chi = fma(-(d * f), n2, fma(-(d * f), g2, h * w3));                                  \
            const two z = turn_added(chi, x, im, fma(half, n1, x), fma(half, n2, im));                        \
            const double q1 = w1 + d * (w3 * w2), q2 = w2 - d * (w3 * w1 - c * g3);                           \
            const two v = root_nearest(z.x, z.y, q1, q2);                                                     \
            after;                                                                                            \
            w3 = fma(-f, n2 + g2, w3);                                                                        \
            w1 = v.x; w2 = v.y; g1 = n1; g2 = n2; g3 = n3;                                                    \
        }                                                                                                     \
        STORE;                                                                                                \
        end;                                                                                                  \
    }

BOHLIN(bohlin_a, , const vec m = cayley_rotated(d * w1, d * w2, d * w3, g1, g2, g3);
       const double n1 = m.x; const double n2 = m.y; const double n3 = m.z, , )
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
        const double b = fma(d * f, g3, sk_low) + sk, D1 = 1.0 - b, DD = fma(D1, D1, D2 * D2), half = 0.5 * d;
        const double Q1 = -half * fma(K, w1, w2), Q2 = half * fma(-K, w2, w1);
        const double V1 = h * fma(-F, fma(K, g1, g2), -w1), V2 = h * fma(F, fma(K, g2, -g1), w2);
        const double T1 = fma(Q1, D1, Q2 * D2), T2 = fma(Q2, D1, -(Q1 * D2));
        const double rest = 1.0 / fma(-T1, V2, fma(-T2, V1, DD)), r = 2.0 / DD, e = d * g3;
        const double P1 = fma(b, g1, fma(S, g2, -(e * w2))), P2 = fma(b, g2, fma(-S, g1, e * w1));
        const double R1 = fma(P1, D1, P2 * D2), R2 = fma(P2, D1, -(P1 * D2));
        const double turned = fma(-f, fma(g1, g1, g2 * g2), fma(-K, fma(g1, w1, g2 * w2), fma(g1, w2, -(g2 * w1))));
        const double x = rest * fma(h * fma(rq, turned, rq_low * turned), DD, fma(R2, V1, R1 * V2));
        const double t1 = fma(K, w1, f * g1), t2 = fma(K, w2, f * g2);
        const double U1 = 2.0 * fma(-K, t1, t2), U2 = -2.0 * fma(K, t2, t1);
        const double X1 = fma(rq, U1, rq_low * U1), X2 = fma(rq, U2, rq_low * U2);
        const double A1 = r * R1, A2 = r * R2, B1 = r * T1, B2 = r * T2;
        w1 += fma(x, F * fma(-K, B1, B2), fma(F, fma(-K, A1, A2), X1));
        w2 += fma(x, -F * fma(K, B2, B1), fma(-F, fma(K, A2, A1), X2));
        g1 += fma(x, B1, A1);
        g2 += fma(x, B2, A2);
        g3 += x;
    }
    STORE;
}

/* ---------------------------------------------------------------------------------------- HK, Euler with gamma */

void hk_euler_gamma(double *y, const double *p, double h, long long n)
{
    LOAD;
    const double d = 0.5 * h, c1 = d * p[3], c2 = d * p[4], c3 = d * p[5];
    for (long long i = 0; i < n; i++) {
        const double k1 = (c2 * c3) * w1, t1 = (2.0 * c1) * w2 * w3, k2 = (c3 * c1) * w2, k3 = (c1 * c2) * w3;
        const double b2 = k2 * w2, b3 = k3 * w3;
        const double r = 2.0 / (fma(-k1, t1, fma(-k1, w1, 1.0)) - (b2 + b3));
        const double b1 = k1 * w1, u1 = 0.5 * t1, u2 = c2 * (w3 * w1), u3 = c3 * (w1 * w2);
        const double n1 = fma(c1, fma(w2, u3, w3 * u2), fma(b1, u1, u1));
        const double n2 = fma(c2, fma(w3, u1, w1 * u3), fma(b2, u2, u2));
        const double n3 = fma(c3, fma(w1, u2, w2 * u1), fma(b3, u3, u3)), f = d * r;
        const double a1 = d * w1, a2 = d * w2, a3 = d * w3;
        const double s1 = fma(2.0, a1, f * n1), s2 = fma(2.0, a2, f * n2), s3 = fma(2.0, a3, f * n3);
        const double e1 = fma(g2, s3, -(g3 * s2)), e2 = fma(g3, s1, -(g1 * s3)), e3 = fma(g1, s2, -(g2 * s1));
        const double q = 1.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3)), along = a1 * e1 + fma(a2, e2, a3 * e3);
        w1 = fma(r, n1, w1); w2 = fma(r, n2, w2); w3 = fma(r, n3, w3);
        g1 += q * fma(a1, along, e1 + fma(e2, a3, -(e3 * a2)));
        g2 += q * fma(a2, along, e2 + fma(e3, a1, -(e1 * a3)));
        g3 += q * fma(a3, along, e3 + fma(e1, a2, -(e2 * a1)));
    }
    STORE;
}

/* ------------------------------------------------------------------------------------------- backlund */

void backlund(double *y, const double *p, double h, long long n_steps)
{
    const double D = (0.125 * p[0]) * (h * h), tau = y[6];
    double a = y[0], b = y[1], n = y[2], g1 = y[3], g2 = y[4], g3 = y[5];
    for (long long i = 0; i < n_steps; i++) {
        const double d2 = D * g2, d3 = D * g3, t = 2.0 - tau;
        const double tm = fma(-D, g1, t), tp = fma(D, g1, t), f = fma(-D, g1, 2.0 + t);
        const double bm = fma(-D, g3, b), bp = fma(D, g3, b), n2 = n + n, r3 = n2 + d2;
        const double c00 = fma(tp, f, bm * bp), c01 = fma(d2, f, -(a * bp)), c02 = -fma(a, tp, d2 * bm);
        const double c10 = fma(d2, f, -(a * bm)), c11 = fma(tm, f, a * a), c12 = -fma(tm, bm, d2 * a);
        const double c20 = fma(a, tp, d2 * bp), c21 = fma(tm, bp, a * d2), c22 = fma(tm, tp, -(d2 * d2));
        const double e0 = fma(tm, c00, -fma(d2, c01, a * c02)), e1 = fma(bm, c01, fma(r3, c21, -(a * c11)));
        const double e2 = fma(a, c10, -fma(bm, c00, r3 * c20)), e3 = fma(a, c12, -fma(bm, c02, r3 * c22));
        const double um = fma(-D, g1, tau), up = fma(D, g1, tau);
        const double q1 = fma(um, e1, -fma(d2, e2, bp * e3)), q2 = fma(up, e2, -(d2 * e1)) + fma(a, e3, d3 * e0);
        const double q3 = fma(up, e3, -(bp * e1)) + fma(a, e2, -(d2 * e0));
        const double e00 = e0 * e0, e33 = e3 * e3, twice = e3 + e3, four = (e0 + e0) * twice;
        const double cc = e00 + e33, pp = fma(e1, e1, e2 * e2), N = cc + pp, rest = pp + e33;
        const double across = fma(a, e1, b * e2), along = n2 * e33;
        const double X = fma(e0, q3, fma(twice, across, along + four)), xs = fma(e0, q3, fma(twice, across, along));
        const double f1 = fma(e0, e1, -(e3 * e2)), f2 = fma(e0, e2, e3 * e1), Y = t * N, XX = X * X, YY = Y * Y;
        const double inverse = -2.0 / fma(XX, N, YY * N), factor = Y * inverse, square = factor * inverse;
        const double u1 = fma(e0, q1, fma(a, rest, e2 * twice)), u2 = fma(e0, q2, fma(b, rest, -(e1 * twice)));
        const double lift = fma(four, fma(-0.5 * tau, N, rest + e33), -(xs * (e00 - e33))), m = Y + Y;
        const double v0 = fma(-XX, N, YY * (cc - pp)), v1 = fma(X, f2, Y * f1), v2 = fma(Y, f2, -(X * f1)), v3 = X * cc;
        const double s1 = fma(v2, g3, -(v3 * g2)), s2 = fma(v3, g1, -(v1 * g3)), s3 = fma(v1, g2, -(v2 * g1));
        a = fma(fma(Y, u1, X * u2), factor, a);
        b = fma(fma(Y, u2, -(X * u1)), factor, b);
        n = fma(-(lift + lift), factor, n);
        g1 = fma(fma(m, fma(v2, s3, -(v3 * s2)), -(v0 * s1)), square, g1);
        g2 = fma(fma(m, fma(v3, s1, -(v1 * s3)), -(v0 * s2)), square, g2);
        g3 = fma(fma(m, fma(v1, s2, -(v2 * s1)), -(v0 * s3)), square, g3);
    }
    y[0] = a; y[1] = b; y[2] = n; y[3] = g1; y[4] = g2; y[5] = g3;
}
