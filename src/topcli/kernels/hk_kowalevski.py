"""One HK step of the Kowalevski top: the 6x6 linear system, eliminated in closed form.

With d = h/2, c = ``p[0]``, the change x of omega and the change 2 y of gamma, the discrete equations (Sogo,
dEulerPoisson with A = B = 2C, y0 = z0 = 0, last sign corrected) are linear in x and y. Write W = d omega,
G = d**2 c gamma, a = W3/2, q = 1 + a**2, s = W3 - G2, u = W2 - a W1, v = W1 + a W2. Then, Y being d**2 c y:

1. the omega equations give x from y alone::

       d q x1 = u (s - Y2) + a (G3 + Y3)
       d q x2 = (G3 + Y3) - v (s - Y2)
       d x3 = -2 (G2 + Y2)

2. put into the first gamma equation they give y1 = r1 + A y2 - B y3 with A = s - G3 v/(2q), B = W2 + G3/(2q);
3. which leaves two equations, multiplied through by q so that no division comes before the determinant's::

       m11 y2 - m12 y3 = b1
       m21 y2 + m22 y3 = b2
"""

from __future__ import annotations

from topcli.contracts import Floats
from topcli.kernels.increments import plain6


def hk_kowalevski_change(state: Floats, h: float, p: Floats) -> Floats:
    """The change of (omega, gamma) in one HK step.

    Exact up to round-off for steps of any use. The determinant vanishes for some h of the order of 1/|omega| and
    beyond, where the step is singular; and for h |omega| above 1e5 or so the terms of the closed form differ by more
    than a double can hold, and the result, though finite, has no correct digit left.
    """
    w1, w2, w3, g1, g2, g3 = state
    d = 0.5 * h
    f = d * p[0]
    e = d * f
    k = 0.5 * e
    W1 = d * w1
    W2 = d * w2
    W3 = d * w3
    a = (0.5 * d) * w3
    b = 3.0 * a
    s = W3 - e * g2
    H = k * g3  # G3/2
    half = 0.5 * g3
    q = 1.0 + a * a
    rq = 1.0 / q
    u = W2 - a * W1
    v = W1 + a * W2

    # The parentheses below are there for the length of the dependency chain.
    n = W2 * (1.0 - W3 * a) - b * W1  # u - W3 v
    j = g1 - W2 * g3
    m = W1 + W3 * W2
    l = W1 - W2 * s  # noqa: E741
    P = v * j + u * g2
    Q = j - a * g2
    m11 = q * ((1.0 - e * g1) + W3 * s) + H * n
    m12 = q * m + b * H
    m21 = q * l - k * P
    m22 = q * (1.0 + W2 * W2) - k * Q
    r = 2.0 / (m11 * m22 + m12 * m21)
    b1 = q * (g3 * m - s * (g1 + W3 * g2)) + half * (s * n + (b * e) * g3)
    b2 = q * (W2 * j - g2 * l) + (H * Q - (0.5 * s) * P)
    n2 = b1 * m22 + b2 * m12  # r n2 = 2 y2
    n3 = b2 * m11 - b1 * m21  # r n3 = 2 y3

    # Each as (what does not wait for the determinant) + r * the rest.
    F = (0.5 * f) * rq
    fg = f * g3
    two_r1 = 2.0 * (g2 * s - g3 * W2) + rq * (g3 * (v * s - e * g3))
    return (
        rq * ((w2 - a * w1) * s + a * fg) + r * (F * (a * n3 - u * n2)),
        rq * (fg - (w1 + a * w2) * s) + r * (F * (n3 + v * n2)),
        -(2.0 * (f * g2) + r * (f * n2)),
        two_r1 + r * ((s - (H * rq) * v) * n2 - (W2 + H * rq) * n3),
        r * n2,
        r * n3,
    )


hk_kowalevski = plain6(hk_kowalevski_change)
"""The HK step from (omega, gamma)."""
