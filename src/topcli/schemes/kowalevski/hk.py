"""Hirota-Kimura (Kahan) step of the Kowalevski top: a 6x6 linear system, solved in closed form.

With d = h/2, c = ``p[0]``, the change 2 x of omega and the change 2 y of gamma, the discrete equations (Sogo,
dEulerPoisson with A = B = 2C, y0 = z0 = 0, last sign corrected) are linear in x and y. Write W = d omega, X = d x,
Y = d**2 c y, G = d**2 c gamma, a = W3/2, q = 1 + a**2, s = W3 - G2, v = W1 + a W2. Then:

1. the third equation gives X3 = -(G2 + Y2), the first X1 = W2 (s - Y2)/2 + a X2;
2. the second, 2 q X2 = (G3 + Y3) - v (s - Y2), is solved for y3, not for X2. Let b be the part of X2 that depends on y,
   scaled as below; with b as the unknown, q is the only divisor::

       X2 = (X2 at y = 0) + d**2 c b/2,    y3 = q b - v y2;

3. the first equation of gamma gives y1 = eta + j y2 - n b with j = s + W2 v, n = q W2 + G3/2;
4. two equations remain, whose determinant is that of the 6x6 system and a polynomial::

       m11 y2 - m12 b = e2
       m22 b - m21 y2 = e3

   Their right-hand sides, like eta, are those of gamma x (omega + x), evaluated at y = 0.

With y2 and y3 as unknowns and all equations multiplied by q, no division would precede that by the determinant, but
there would be 82 products instead of 50, and the speed of an ensemble depends only on the number of products. Products
are fused with sums by hand (``fma``), never by the compiler. No term is larger than the change itself, so that
round-off is random.

Performance:
- the 6x6 system reduces to a 2x2 system in closed form: 50 products, most of them fused with a sum, two divisions;
- every component is old + change, and terms independent of the determinant are computed before it is known;
- code generated from the field takes as long for one trajectory and up to 10 % longer in an ensemble;
- the scaling by h/2 is internal to the step: the state stays physical, resumes bit for bit, and c = 0 is not a special
  case.

**Compensated step.** Kahan's method for y' = f(y), f quadratic, is x = h f(y) + h/2 J(y) x with the Jacobian J. The
computed change x has a rounding error, and it is the change from the rounded state y instead of y + e. Inserted into
the right-hand side once more, it gives the exact change up to terms smaller by a factor of h. With t = x + e, the
number that is added to y::

    e' = (y + t - y') + r,    r = (h f(y) - t) + h/2 J(y) (x + 2 e) + e

where h f(y) is computed exactly, because its difference from t consists of the last bits only. This is off the critical
path of the next step. It is done for gamma, whose change has rounding errors two to three times as large as that of
omega; gamma² then does not drift. Doing it for omega as well would increase the cost by a sixth.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from topcli.arithmetic.fused import compensated_sum, fma, quick_two_sum, two_prod, two_sum
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.any_top.kahan import kahan_tangent
from topcli.schemes.layout import (
    HIROTA_KIMURA,
    LONG_HK,
    NEAR_SINGULAR,
    SINGULAR,
    CompensatedOption,
    first,
    is_compensated,
    small_determinant,
    summed,
    with_counter,
)
from topcli.schemes.registry import scheme


def coefficients(w: Floats, g: Floats, h: float, c: float) -> Floats:
    """Coefficients m11, m12, m21, m22 of the two equations for y2 and b, then q, v, j, n."""
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
    """Change of (omega, gamma) in one HK step.

    Accurate to round-off for useful steps, h |omega| < 3. The determinant vanishes for some h of the order of 1/|omega|
    and larger, where the step is singular. The sizes of the terms of the closed form differ by (h |omega|/6)**4: three
    digits are lost at h |omega| = 30, and above about 1e4 the result is finite but has no correct digits.
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
    # computed at this point because the compiler partly keeps the source order; worth 3 % of a step
    m11, m12, m21, m22, q, v, j, n = coefficients((w1, w2, w3), (g1, g2, g3), h, p[0])
    eta = fma(-g3, b2, g2 * S)  # times d, as are e2 and e3
    e2 = fma(-(a + a), eta, fma(g3, b1, -(g1 * S)))
    e3 = fma(-g2, b1, fma(W2, eta, g1 * b2))

    # the order of the sums minimizes the length of the dependency chain
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


hk_kowalevski = summed(hk_kowalevski_change, 6)
"""HK step of (omega, gamma)."""


def kowalevski_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """Determinant of the 2x2 system of ``hk_kowalevski`` and the size of its terms, equal if they nearly cancel."""
    w, g = (state[0], state[1], state[2]), (state[3], state[4], state[5])
    m11, m12, m21, m22, _, _, _, _ = coefficients(w, g, h, p[0])
    term = m11 * m22
    return (fma(-m12, m21, term), 2.0 * abs(term))


def _residual(h: float, a: float, b: float, u: float, v: float, rest: float, t: float, e: float) -> float:
    """Residual h (a b - u v) + h/2 ``rest`` + e - t, if small, accurate to its own last bits."""
    p, p_low = two_prod(a, b)
    q, q_low = two_prod(u, v)
    s, s_low = two_sum(p, -q)
    x, x_low = two_prod(h, s)
    return fma(0.5 * h, rest, ((x - t) + e) + fma(h, (p_low - q_low) + s_low, x_low))


def hk_kowalevski_compensated(state: Floats, h: float, p: Floats) -> Floats:
    """Compensated HK step of (omega, gamma), which are followed by their six compensation terms e."""
    w1, w2, w3, g1, g2, g3, e1, e2, e3, e4, e5, e6 = state
    x1, x2, x3, y1, y2, y3 = hk_kowalevski_change((w1, w2, w3, g1, g2, g3), h, p)
    u1 = fma(2.0, e1, x1)
    u2 = fma(2.0, e2, x2)
    u3 = fma(2.0, e3, x3)
    v1 = fma(2.0, e4, y1)
    v2 = fma(2.0, e5, y2)
    v3 = fma(2.0, e6, y3)
    j1 = fma(g2, u3, w3 * v2) - fma(g3, u2, w2 * v3)
    j2 = fma(g3, u1, w1 * v3) - fma(g1, u3, w3 * v1)
    j3 = fma(g1, u2, w2 * v1) - fma(g2, u1, w1 * v2)
    t1 = y1 + e4
    t2 = y2 + e5
    t3 = y3 + e6
    r1 = _residual(h, g2, w3, g3, w2, j1, t1, e4)
    r2 = _residual(h, g3, w1, g1, w3, j2, t2, e5)
    r3 = _residual(h, g1, w2, g2, w1, j3, t3, e6)
    w1, e1 = compensated_sum(w1, e1, x1)
    w2, e2 = compensated_sum(w2, e2, x2)
    w3, e3 = compensated_sum(w3, e3, x3)
    g1, e4 = quick_two_sum(g1, t1)
    g2, e5 = quick_two_sum(g2, t2)
    g3, e6 = quick_two_sum(g3, t3)
    return (w1, w2, w3, g1, g2, g3, e1, e2, e3, e4 + r1, e5 + r2, e6 + r3)


def enter_compensated(y: Floats, h: float, p: Floats) -> Floats:
    """Physical state and compensation terms."""
    return (*y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@scheme(
    "hk",
    top="kowalevski",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    citation="Kahan 1993; Hirota, Kimura 2000; Kimura, Hirota 2000; Sogo, Discrete Spinning Tops, section 3.2.1",
    formula=HIROTA_KIMURA,
    equations="(dEulerPoisson) of the paper, with the last line corrected so that it ends with gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build(top: Top, options: CompensatedOption) -> Stepper:
    """Kahan's method for quadratic equations of motion: each step solves one linear system, in closed form.

    In the equations of motion, every product y z of two variables becomes (y' z + y z')/2, and every linear term y
    becomes the mean (y + y')/2; a prime marks a value after the step. The step is self-adjoint. HK conserves none of
    the four integrals exactly; for small h their deviations remain of size h². With `compensated: true`, the scheme
    compensates the rounding errors of the change of gamma and of the sums of old state and change.
    """
    made = Stepper(hk_kowalevski, 6)
    if is_compensated(options):
        made = Stepper(hk_kowalevski_compensated, 12, enter_compensated, first(6), checked=6)
    made = with_counter(made, NEAR_SINGULAR, small_determinant(kowalevski_determinant))
    return replace(made, tangent=partial(kahan_tangent, top))
