"""Change of the state in one Bäcklund step of the Kowalevski top: a 3x3 linear system and a rotation.

Two Bäcklund transformations of the 5x5 Lax matrix, at lambda = -2/h and its two eigenvalues near 4/h, are together a
rational map. With a, b, n = -(h/2) (w1, w2, w3/2), d = (c h²/8) gamma and t = 2 - tau, solve ::

    (t - d1) x - d2 y - a z = b - d3
    -d2 x + (t + d1) y - (b + d3) z = -a
    a x + (b - d3) y + (2 + t - d1) z = 2 n + d2

by Cramer's rule in homogeneous form, (e0; e1, e2, e3) = (1; y, -x, -z) times the determinant. The new momentum and the
rotation of gamma are rational in e and have one common divisor. Nothing branches, and there is no root.

With N = |e|², f = (e0 e1 - e3 e2, e0 e2 + e3 e1), g = (e0 e1 + e3 e2, e0 e2 - e3 e1), cc = e0² + e3²::

    X = 8 e0 e3 + 2 (n cc + a f2 - b f1),  Y = t N,  H = X² + Y²,  R(u) = (Y u1 + X u2, Y u2 - X u1)
    (a, b)' = (a, b) - (2t/H) R(N (a, b) + 2 g),    n' = n + (4t/H) (2 Y e0 e3 - X (e0² - e3²))

and gamma is turned by the unit quaternion ((Y² - X²) cc - H (e1² + e2²); -2 Y R(f); -2 X Y cc)/(H N).

For small h the sums N a + 2 g1 and the like cancel. The code inserts the linear equations, q = (a e0 + 2 e1,
b e0 + 2 e2, 2 n e0 + 4 e3), so that every change is a sum of terms of its own size.

The code turns gamma by the quaternion (v0; -2Y v)/(H N) with v = (R(f); X cc): with s = v x gamma and i = -2/(H N)
the change is Y i² (2Y v x s - v0 s).

Performance: 132 operations and one division; the order of the terms keeps the longest chain at 17 of them. The scaling
is internal, and only changes are scaled back, so that the state stays physical and a scaling error cannot accumulate
when steps of several lengths follow each other.
"""

from __future__ import annotations

from topcli.arithmetic.fused import fma
from topcli.arithmetic.vectors import Floats6
from topcli.contracts import Floats


def numerators(z: Floats, D: float, tau: float) -> Floats:
    """Numerators of the changes of (a, b, n) and of gamma, and the factor of each; ``D`` is c h²/8."""
    a, b, n, g1, g2, g3 = z
    d2, d3 = D * g2, D * g3

    t = 2.0 - tau
    tm, tp, f = fma(-D, g1, t), fma(D, g1, t), fma(-D, g1, 2.0 + t)
    bm, bp = fma(-D, g3, b), fma(D, g3, b)
    n2 = n + n
    r3 = n2 + d2
    c00, c01, c02 = fma(tp, f, bm * bp), fma(d2, f, -(a * bp)), -fma(a, tp, d2 * bm)
    c10, c11, c12 = fma(d2, f, -(a * bm)), fma(tm, f, a * a), -fma(tm, bm, d2 * a)
    c20, c21, c22 = fma(a, tp, d2 * bp), fma(tm, bp, a * d2), fma(tm, tp, -(d2 * d2))
    e0 = fma(tm, c00, -fma(d2, c01, a * c02))
    e1 = fma(bm, c01, fma(r3, c21, -(a * c11)))
    e2 = fma(a, c10, -fma(bm, c00, r3 * c20))
    e3 = fma(a, c12, -fma(bm, c02, r3 * c22))

    um, up = fma(-D, g1, tau), fma(D, g1, tau)
    q1 = fma(um, e1, -fma(d2, e2, bp * e3))
    q2 = fma(up, e2, -(d2 * e1)) + fma(a, e3, d3 * e0)
    q3 = fma(up, e3, -(bp * e1)) + fma(a, e2, -(d2 * e0))  # 2 n e0 + 4 e3 + 2 (a e2 - b e1)

    e00, e33, twice = e0 * e0, e3 * e3, e3 + e3
    four = (e0 + e0) * twice
    cc, pp = e00 + e33, fma(e1, e1, e2 * e2)
    N, rest = cc + pp, pp + e33
    across, along = fma(a, e1, b * e2), n2 * e33
    # X, and X without its largest term, which cancels in the change of n
    X, xs = fma(e0, q3, fma(twice, across, along + four)), fma(e0, q3, fma(twice, across, along))
    f1, f2 = fma(e0, e1, -(e3 * e2)), fma(e0, e2, e3 * e1)
    Y = t * N
    XX, YY = X * X, Y * Y
    inverse = -2.0 / fma(XX, N, YY * N)
    factor = Y * inverse

    u1 = fma(e0, q1, fma(a, rest, e2 * twice))
    u2 = fma(e0, q2, fma(b, rest, -(e1 * twice)))
    lift = fma(four, fma(-0.5 * tau, N, rest + e33), -(xs * (e00 - e33)))

    m = Y + Y
    v0 = fma(-XX, N, YY * (cc - pp))
    v1, v2, v3 = fma(X, f2, Y * f1), fma(Y, f2, -(X * f1)), X * cc
    s1, s2, s3 = fma(v2, g3, -(v3 * g2)), fma(v3, g1, -(v1 * g3)), fma(v1, g2, -(v2 * g1))
    return (
        fma(Y, u1, X * u2),
        fma(Y, u2, -(X * u1)),
        -(lift + lift),
        fma(m, fma(v2, s3, -(v3 * s2)), -(v0 * s1)),
        fma(m, fma(v3, s1, -(v1 * s3)), -(v0 * s2)),
        fma(m, fma(v1, s2, -(v2 * s1)), -(v0 * s3)),
        factor,
        factor * inverse,
    )


def scaled_step(z: Floats, D: float, tau: float) -> Floats6:
    """New (a, b, n) and gamma after one step."""
    x1, x2, x3, y1, y2, y3, r, q = numerators(z, D, tau)
    return (
        fma(x1, r, z[0]),
        fma(x2, r, z[1]),
        fma(x3, r, z[2]),
        fma(y1, q, z[3]),
        fma(y2, q, z[4]),
        fma(y3, q, z[5]),
    )


def scales_of(h: float) -> tuple[float, float, float]:
    """Constants of a length: k = -h/2, and 1/k with its rounding error.

    The scale of omega, 1/k, is not a floating-point number. Its rounding error, the same in every step, would make the
    integrals drift; it is therefore used with its error.
    """
    k = -0.5 * h
    scale = 1.0 / k
    return (k, scale, fma(-k, scale, 1.0) * scale)


def scaled_change(z: Floats, D: float, tau: float) -> Floats6:
    """Change of (a, b, n) and gamma in one step."""
    x1, x2, x3, y1, y2, y3, r, q = numerators(z, D, tau)
    return (x1 * r, x2 * r, x3 * r, y1 * q, y2 * q, y3 * q)


def length_numerators(y: Floats, c: float, k: float, scale: float, error: float, tau: float) -> Floats:
    """Changes of omega, numerators of those of gamma, and their factor, for ``scales_of`` a length and its ``tau``."""
    z = (k * y[0], k * y[1], (0.5 * k) * y[2], y[3], y[4], y[5])
    x1, x2, x3, y1, y2, y3, r, q = numerators(z, (0.5 * c) * (k * k), tau)
    x1, x2, x3 = x1 * r, x2 * r, 2.0 * (x3 * r)
    w1, w2, w3 = fma(x1, scale, x1 * error), fma(x2, scale, x2 * error), fma(x3, scale, x3 * error)
    return (w1, w2, w3, y1, y2, y3, q)


def length_step(y: Floats, c: float, k: float, scale: float, error: float, tau: float) -> Floats6:
    """New (omega, gamma) after one step, whose length is given by its ``scales_of`` and ``tau``."""
    w1, w2, w3, y1, y2, y3, q = length_numerators(y, c, k, scale, error, tau)
    return (y[0] + w1, y[1] + w2, y[2] + w3, fma(y1, q, y[3]), fma(y2, q, y[4]), fma(y3, q, y[5]))


def physical_change(y: Floats, h: float, c: float, tau: float) -> Floats6:
    """Change of (omega, gamma) in one step of length h with the parameter ``tau``."""
    k, scale, error = scales_of(h)
    w1, w2, w3, y1, y2, y3, q = length_numerators(y, c, k, scale, error, tau)
    return (w1, w2, w3, y1 * q, y2 * q, y3 * q)


def physical_step(y: Floats, h: float, c: float, tau: float) -> Floats6:
    """New (omega, gamma) after one step of length h with the parameter ``tau``."""
    k, scale, error = scales_of(h)
    return length_step(y, c, k, scale, error, tau)
