"""The scheme of Hirota and Kimura (Kahan's method) for the Kowalevski top: a 6x6 linear system, solved in closed form.

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

With y2 and y3 as unknowns everything is multiplied by q, so that no division precedes the determinant's: 82 products
instead of 50. Many trajectories side by side wait for products only. Products are fused with sums by hand (``fma``),
never by the compiler. Every term of the change is of its size, so that round-off is random.

What makes it fast:
- the 6x6 system shrinks to one 2x2 system in closed form: 50 products, most of them fused with a sum, two divisions;
- every component is old + change, with what the determinant does not decide ready before it is known;
- scaled by h/2 inside the step only: the state stays physical, resumes bit for bit, and c = 0 is no special case.

**Compensated.** Kahan's method for y' = f(y), f quadratic, is x = h f(y) + h/2 J(y) x with the Jacobian J. A computed
change x has its rounding error, and it belongs to the rounded state y instead of y + e. Put into the right side once
more it gives the wanted change up to terms smaller by h. With t = x + e, the number that is added to y::

    e' = (y + t - y') + r,    r = (h f(y) - t) + h/2 J(y) (x + 2 e) + e

where h f(y), whose difference from t leaves only the last bits, is formed exactly. The next step does not wait for it.
It is done for gamma, whose change is rounded two to three times as much as omega's, and then gamma² does not move; for
omega as well it would cost a sixth more.
"""

from __future__ import annotations

from topcli.arithmetic.double_double import quick_two_sum, two_prod, two_sum
from topcli.arithmetic.fused import fma
from topcli.arithmetic.increments import carried_sum, first6, plain6
from topcli.contracts import Floats, Stepper, Top
from topcli.schemes.compensated import CompensatedOption, compensation_wanted, enter_compensated
from topcli.schemes.counting import NEAR_SINGULAR, counting, small_determinant
from topcli.schemes.limits import LONG_HK, SINGULAR
from topcli.schemes.registry import scheme


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


def kowalevski_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """That of ``hk_kowalevski``'s two equations; where it is small, both of its terms are as large."""
    w, g = (state[0], state[1], state[2]), (state[3], state[4], state[5])
    m11, m12, m21, m22, _, _, _, _ = coefficients(w, g, h, p[0])
    term = m11 * m22
    return (fma(-m12, m21, term), 2.0 * abs(term))


def _missing(h: float, a: float, b: float, u: float, v: float, rest: float, t: float, e: float) -> float:
    """h (a b - u v) + h/2 ``rest`` + e - t, where that is small: exact but for its own last bits."""
    p, p_low = two_prod(a, b)
    q, q_low = two_prod(u, v)
    s, s_low = two_sum(p, -q)
    x, x_low = two_prod(h, s)
    return fma(0.5 * h, rest, ((x - t) + e) + fma(h, (p_low - q_low) + s_low, x_low))


def hk_kowalevski_refined(state: Floats, h: float, p: Floats) -> Floats:
    """One step of (omega, gamma) and of the six numbers e by which they fall short."""
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
    r1 = _missing(h, g2, w3, g3, w2, j1, t1, e4)
    r2 = _missing(h, g3, w1, g1, w3, j2, t2, e5)
    r3 = _missing(h, g1, w2, g2, w1, j3, t3, e6)
    w1, e1 = carried_sum(w1, e1, x1)
    w2, e2 = carried_sum(w2, e2, x2)
    w3, e3 = carried_sum(w3, e3, x3)
    g1, e4 = quick_two_sum(g1, t1)
    g2, e5 = quick_two_sum(g2, t2)
    g3, e6 = quick_two_sum(g3, t3)
    return (w1, w2, w3, g1, g2, g3, e1, e2, e3, e4 + r1, e5 + r2, e6 + r3)


@scheme(
    "hk",
    top="kowalevski",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    citation="Hirota, Kimura 2000; Kimura, Hirota 2000; Sogo, Discrete Spinning Tops, section 3.2.1",
    equations="dEulerPoisson, with the last term of its last line corrected to gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build(top: Top, options: CompensatedOption) -> Stepper:
    """Linear in the new state, solved in closed form.

    Every quadratic term y z of the field becomes (y' z + y z')/2, every linear term its mean. The step is its own
    inverse under h -> -h. It conserves none of the four integrals exactly; their deviations stay bounded, of size h².
    Compensated, what the change of gamma rounds is carried along as well.
    """
    if compensation_wanted(options):
        stepper = Stepper(hk_kowalevski_refined, 12, enter_compensated, first6, checked=6)
    else:
        stepper = Stepper(hk_kowalevski, 6)
    return counting(stepper, NEAR_SINGULAR, small_determinant(kowalevski_determinant))
