"""Hirota-Kimura (Kahan) step of the Euler top, without and with the vertical gamma.

Notation: d = h/2, alpha_1 = (B - C)/A and cyclically, c_i = d alpha_i, u_i = c_i omega_j omega_k (half of Euler's
rule), i, j, k cyclic. The matrix of both HK and Newton's method for the midpoint rule is
M = 1 - [c_i (omega_k e_j + omega_j e_k)]. With b_i = c_j c_k omega_i² and v_i = omega_i + u_i, M x = r is solved by

    x_i = ((1 - b_i) r_i + c_i (v_k r_j + v_j r_k))/Delta,    Delta = 1 - (b_1 + b_2 + b_3) - 2 u_1 c_2 c_3 omega_1.

Every function returns omega' - omega (or half of it). The only operation that rounds at the size of omega is then one
addition, so that round-off is a random walk. The step has a closed form with one division, which overlaps with the
computation of gamma.
"""

from __future__ import annotations

from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import Vector
from topcli.contracts import UNKNOWN, Floats, Integrability, Stepper, Top
from topcli.schemes.declarations import SINGULAR
from topcli.schemes.euler.hk_integrals import hk_integrals
from topcli.schemes.euler.omega_gamma import CITATION, FORMS, omega_change
from topcli.schemes.layout import (
    NEAR_SINGULAR,
    CompensatedOption,
    increment_stepper,
    is_compensated,
    small_determinant,
    with_counter,
)
from topcli.schemes.registry import scheme


def hk_quotient(w1: float, w2: float, w3: float, c1: float, c2: float, c3: float) -> tuple[float, Vector]:
    """Factor 2/Delta and vector whose product is the change in the HK scheme, the solution of M x = 2 u.

    With the products c_i v_j u_k expanded, the numerators are u_i (1 + b_i) + c_i (omega_j u_k + omega_k u_j). The last
    term equals omega_i (b_j + b_k), but the rounding errors of the coefficients of b are the same in every step and
    their effect would accumulate. The denominator is computed first, so that the division overlaps with the rest.
    """
    a1 = (c2 * c3) * w1
    t1 = (2.0 * c1) * w2
    a2 = (c3 * c1) * w2
    a3 = (c1 * c2) * w3
    b2 = a2 * w2
    b3 = a3 * w3
    t1 = t1 * w3
    r = 2.0 / (fma(-a1, t1, fma(-a1, w1, 1.0)) - (b2 + b3))
    b1 = a1 * w1
    u1 = 0.5 * t1
    u2 = c2 * (w3 * w1)
    u3 = c3 * (w1 * w2)
    return r, (
        fma(c1, fma(w2, u3, w3 * u2), fma(b1, u1, u1)),
        fma(c2, fma(w3, u1, w1 * u3), fma(b2, u2, u2)),
        fma(c3, fma(w1, u2, w2 * u1), fma(b3, u3, u3)),
    )


def hk_increment(w1: float, w2: float, w3: float, c1: float, c2: float, c3: float) -> Vector:
    """Change omega' - omega in the HK scheme."""
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, c1, c2, c3)
    return (r * n1, r * n2, r * n3)


def hk_gamma_increment(
    a1: float, a2: float, a3: float, x1: float, x2: float, x3: float, g1: float, g2: float, g3: float
) -> Vector:
    """Change y = gamma' - gamma in the HK scheme, from the linear system y - y x a = gamma x (2 a + x).

    ``a`` is d omega and ``x`` is d (omega' - omega). With b = gamma x (2 a + x) the solution is
    y = (b + b x a + a (a.b))/(1 + a.a).
    """
    s1 = fma(2.0, a1, x1)
    s2 = fma(2.0, a2, x2)
    s3 = fma(2.0, a3, x3)
    b1 = fma(g2, s3, -(g3 * s2))
    b2 = fma(g3, s1, -(g1 * s3))
    b3 = fma(g1, s2, -(g2 * s1))
    r = 1.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3))
    along = a1 * b1 + fma(a2, b2, a3 * b3)
    return (
        r * fma(a1, along, b1 + fma(b2, a3, -(b3 * a2))),
        r * fma(a2, along, b2 + fma(b3, a1, -(b1 * a3))),
        r * fma(a3, along, b3 + fma(b1, a2, -(b2 * a1))),
    )


def hk_step(s: Floats, h: float, p: Floats) -> Floats:
    """HK step of omega, p = (A, B, C, alpha_1, alpha_2, alpha_3); each component is rounded once."""
    w1, w2, w3 = s
    d = 0.5 * h
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, d * p[3], d * p[4], d * p[5])
    return (fma(r, n1, w1), fma(r, n2, w2), fma(r, n3, w3))


def hk_gamma_step(s: Floats, h: float, p: Floats) -> Floats:
    """HK step of omega and gamma; omega is the same as in ``hk_step``."""
    w1, w2, w3, g1, g2, g3 = s
    d = 0.5 * h
    r, (n1, n2, n3) = hk_quotient(w1, w2, w3, d * p[3], d * p[4], d * p[5])
    f = d * r
    y1, y2, y3 = hk_gamma_increment(d * w1, d * w2, d * w3, f * n1, f * n2, f * n3, g1, g2, g3)
    return (fma(r, n1, w1), fma(r, n2, w2), fma(r, n3, w3), g1 + y1, g2 + y2, g3 + y3)


def euler_determinant(state: Floats, h: float, p: Floats) -> tuple[float, float]:
    """Delta of ``hk_quotient`` and the sum of the magnitudes of its terms."""
    w1, w2, w3 = state[0], state[1], state[2]
    d = 0.5 * h
    c1, c2, c3 = d * p[3], d * p[4], d * p[5]
    a1 = (c2 * c3) * w1
    a2 = (c3 * c1) * w2
    a3 = (c1 * c2) * w3
    b2 = a2 * w2
    b3 = a3 * w3
    t1 = ((2.0 * c1) * w2) * w3
    value = fma(-a1, t1, fma(-a1, w1, 1.0)) - (b2 + b3)
    return (value, (1.0 + abs(a1 * w1)) + ((abs(b2) + abs(b3)) + abs(a1 * t1)))


GAMMA_GROWS = (
    "omega stays bounded by the modified integrals. The modified gamma² is a quadratic form in gamma that bounds it "
    "while K_i > 0 and R_i > 0 for all i (hk_integrals.py), as for short steps; with steps of about one revolution the "
    "form may be indefinite, and gamma then grows without bound."
)


def hk_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """Change of omega in an HK step."""
    return hk_increment(w1, w2, w3, d * p[3], d * p[4], d * p[5])


def hk_gamma_change(s: Floats, h: float, p: Floats) -> Floats:
    """Change of omega and gamma in an HK step."""
    w1, w2, w3, g1, g2, g3 = s
    d = 0.5 * h
    x1, x2, x3 = hk_change(w1, w2, w3, d, p)
    y1, y2, y3 = hk_gamma_increment(d * w1, d * w2, d * w3, d * x1, d * x2, d * x3, g1, g2, g3)
    return (x1, x2, x3, y1, y2, y3)


BI_HAMILTONIAN = "a family of brackets of its own (Petrera, Suris 2010)"


@scheme(
    "hk",
    top=FORMS,
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    modified=hk_integrals,
    citation="Kahan 1993; Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011 (integrability); " + CITATION,
    formula=r"""
\frac{\omega_i' - \omega_i}{h} = \frac{\alpha_i}{2}\,(\omega_j'\omega_k + \omega_j\omega_k'), \quad
\alpha_1 = \frac{B - C}{A} \text{ and cyclically}, \qquad
\frac{\gamma' - \gamma}{h} = \tfrac12\,(\gamma\times\omega' + \gamma'\times\omega)
""",
    integrable=lambda top: Integrability(UNKNOWN, BI_HAMILTONIAN if top.form == "euler" else UNKNOWN),
    equations="the first difference equations of section 1.2; gamma as in dEulerPoisson with the last term corrected",
    options=CompensatedOption,
    limits=lambda top: {"singular-step": SINGULAR} | ({} if len(top.components) == 3 else {"resonance": GAMMA_GROWS}),
)
def build_hk(top: Top, options: CompensatedOption) -> Stepper:
    """Every product y z of two components becomes (y' z + y z')/2: linear in the new state, solved in closed form.

    m²/K and m·omega/K are conserved, with K = 1 + O(h²); m² and m·omega themselves are not, but their errors are of
    size h² and return to zero. With gamma as part of the state, the same holds for gamma² and m·gamma: modified forms
    of both are conserved.
    """
    d = len(top.components)
    if is_compensated(options):
        made = increment_stepper(omega_change(hk_change) if d == 3 else hk_gamma_change, d, options)
    else:
        made = Stepper(hk_step if d == 3 else hk_gamma_step, d)
    return with_counter(made, NEAR_SINGULAR, small_determinant(euler_determinant), branch=True)
