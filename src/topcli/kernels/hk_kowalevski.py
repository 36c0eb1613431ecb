"""One HK step of the Kowalevski top: the 6x6 linear system, eliminated in closed form.

With d = h/2, c = ``p[0]``, the change 2 x of omega and the change 2 y of gamma, the discrete equations (Sogo,
dEulerPoisson with A = B = 2C, y0 = z0 = 0, last sign corrected) are linear in x and y. Write W = d omega, X = d x,
G = d**2 c gamma, a = W3/2, q = 1 + a**2, s = W3 - G2, v = W1 + a W2. Then, Y being d**2 c y:

1. the third equation gives X3 = -(G2 + Y2), the first X1 = W2 (s - Y2)/2 + a X2;
2. the second, 2 q X2 = (G3 + Y3) - v (s - Y2), gives y3 where X2 is known, and not the other way round: with b, the
   part of X2 that comes from y, as the unknown in the place of y3, nothing is divided by but q::

       X2 = (X2 at y = 0) + d**2 c b/2,    y3 = q b - v y2;

3. the first equation of gamma gives y1 = eta + j y2 - n b with j = s + W2 v, n = q W2 + G3/2;
4. which leaves two equations, whose determinant is that of the six and a polynomial::

       m11 y2 - m12 b = e2
       m22 b - m21 y2 = e3

   Their right sides, like eta, are those of gamma x (omega + x), taken at y = 0.

With y2 and y3 as unknowns everything is multiplied by q, lest a division come before the determinant's: 82 products in
the place of 50. Many trajectories side by side wait for products and for nothing else. Products are fused with sums by
hand (``fma``), never by the compiler. Every term of the change is of its size: round-off is random.
"""

from __future__ import annotations

from topcli.contracts import Floats
from topcli.kernels.fused import fma
from topcli.kernels.increments import plain6


def coefficients(w: Floats, g: Floats, h: float, c: float) -> Floats:
    """(m11, m12, m21, m22) of the two equations for y2 and b, then q, v, j, n."""
    w1, w2, w3 = w
    g1, g2, g3 = g
    d = 0.5 * h
    f = d * c
    k = 0.5 * (d * f)
    a = (0.5 * d) * w3
    W2 = d * w2
    half_s = (0.5 * d) * (w3 - f * g2)
    s = half_s + half_s
    H = d * ((0.5 * f) * g3)  # G3/2
    q = fma(a, a, 1.0)
    v = d * fma(a, w2, w1)
    n = fma(W2, q, H)
    js = fma(W2, v, s + s)  # j + s
    z = a + (a - half_s)  # a + G2/2
    m11 = fma(a, js, fma(v, v, fma(H, W2, fma(-(k + k), g1, 1.0))))
    m12 = fma(a, n + (H + H), q * v)
    m21 = W2 * (js + (z - s))
    m22 = fma(W2, n, fma(a, z, fma(-k, g1, 1.0)))
    return (m11, m12, m21, m22, q, v, js - s, n)


def hk_kowalevski_change(state: Floats, h: float, p: Floats) -> Floats:
    """The change of (omega, gamma) in one HK step.

    Exact up to round-off for steps of any use, h |omega| < 3. The determinant vanishes for some h of the order of
    1/|omega| and beyond, where the step is singular; and the terms of the closed form differ by (h |omega|/6)**4: three
    digits are lost where h |omega| is 30, and above 1e4 or so the result, though finite, has no correct digit left.
    """
    w1, w2, w3, g1, g2, g3 = state
    d = 0.5 * h
    f = d * p[0]
    k = 0.5 * (d * f)
    a = (0.5 * d) * w3
    W2 = d * w2
    fg2 = f * g2
    S = w3 - fg2  # s/d
    half_s = (0.5 * d) * S

    # omega + x at y = 0 is (b1, b2, S)
    x2 = (1.0 / fma(a, a, 1.0)) * fma(-fma(a, w2, w1), half_s, (0.5 * f) * g3)
    t = w2 * half_s
    b1 = fma(a, x2, w1 + t)
    b2 = w2 + x2
    # Here, because the compiler keeps something of this order: 3 % of a step.
    m11, m12, m21, m22, q, v, j, n = coefficients((w1, w2, w3), (g1, g2, g3), h, p[0])
    eta = fma(-g3, b2, g2 * S)  # times d, as are e2 and e3
    e2 = fma(-(a + a), eta, fma(g3, b1, -(g1 * S)))
    e3 = fma(-g2, b1, fma(W2, eta, g1 * b2))

    # The order of the sums is chosen for the length of the dependency chain.
    r = h / fma(-m12, m21, m11 * m22)
    two_y2 = r * fma(e3, m12, e2 * m22)
    two_b = r * fma(e3, m11, e2 * m21)
    two_x2 = fma(0.5 * f, two_b, x2 + x2)
    return (
        fma(a, two_x2, fma(-k * w2, two_y2, t + t)),
        two_x2,
        -fma(f, two_y2, fg2 + fg2),
        fma(j, two_y2, fma(-n, two_b, h * eta)),
        two_y2,
        fma(-v, two_y2, q * two_b),
    )


hk_kowalevski = plain6(hk_kowalevski_change)
"""The HK step from (omega, gamma)."""
