"""Equations of the paper in their printed form, for numbers of any kind, named after their labels.

No scheme of topcli uses them: the ledger compares these transcriptions with each other and with the schemes.
``moments`` are A, B, C; ``g`` is mg(x0, y0, z0); w and v are the old and new omega, c and e gamma, m and n the
momentum, a and b the vector a of the Lagrange top. An equation of a scheme gives its left minus right sides.
"""

from __future__ import annotations

from typing import Any

from topcli.paper.algebra import I_UNIT, Gauss, Numbers, cross, exact, plane


def euler_poisson(moments: Numbers, g: Numbers, w: Numbers, c: Numbers) -> tuple[Numbers, Numbers]:
    """Vector equations (EulerPoisson): rates of m and gamma."""
    return cross(moments * w, w) + cross(c, g), cross(c, w)


def euler(moments: Numbers, g: Numbers, w: Numbers, c: Numbers) -> Numbers:
    """Components (Euler): A, B, C times the rates of omega."""
    A, B, C = moments
    x0, y0, z0 = g
    return exact(
        (B - C) * w[1] * w[2] + (c[1] * z0 - c[2] * y0),
        (C - A) * w[2] * w[0] + (c[2] * x0 - c[0] * z0),
        (A - B) * w[0] * w[1] + (c[0] * y0 - c[1] * x0),
    )


def poisson(w: Numbers, c: Numbers) -> Numbers:
    """Components (Poisson): rates of gamma."""
    return exact(c[1] * w[2] - c[2] * w[1], c[2] * w[0] - c[0] * w[2], c[0] * w[1] - c[1] * w[0])


def euler_top(moments: Numbers, w: Numbers) -> Numbers:
    """Equations of the Euler top, section 1.2: A, B, C times the rates of omega."""
    A, B, C = moments
    return exact((B - C) * w[1] * w[2], (C - A) * w[2] * w[0], (A - B) * w[0] * w[1])


EPSILON = exact([0, 1], [0, 0])
"""The 2x2 matrix of the Grassmann symbol epsilon."""


def hat(v: Numbers) -> Numbers:
    """Antisymmetric matrix of a vector, as M, Omega, Gamma and G are printed."""
    return exact([0, v[2], -v[1]], [-v[2], 0, v[0]], [v[1], -v[0], 0])


def laws(moments: Numbers, g: Numbers, w: Numbers, c: Numbers) -> Numbers:
    """The three quantities of (constant): gamma², m·gamma, E."""
    m = moments * w
    return exact(c @ c, m @ c, m @ w / 2 + g @ c)


def hk_euler(moments: Numbers, h: Any, w: Numbers, new: Numbers) -> Numbers:
    """HK scheme of the Euler top, section 1.2."""
    A, B, C = moments
    v = new
    return exact(
        v[0] - w[0] - h * (B - C) / (2 * A) * (v[1] * w[2] + w[1] * v[2]),
        v[1] - w[1] - h * (C - A) / (2 * B) * (v[2] * w[0] + w[2] * v[0]),
        v[2] - w[2] - h * (A - B) / (2 * C) * (v[0] * w[1] + w[0] * v[1]),
    )


def hk_euler_vector(h: Any, m: Numbers, n: Numbers, w: Numbers, v: Numbers) -> Numbers:
    """HK scheme of the Euler top in vector form."""
    return n - m - h / 2 * (cross(n, w) + cross(m, v))


def bs(h: Any, m: Numbers, new: Numbers, w: Numbers) -> Numbers:
    """Equation new - m = h/2 (new + m) x w: (EulerBS) and, for gamma, Method (A)."""
    return new - m - h / 2 * cross(new + m, w)


def midpoint(h: Any, m: Numbers, new: Numbers, w: Numbers, v: Numbers) -> Numbers:
    """Equation new - m = h/4 (new + m) x (v + w): the last scheme of section 1.2, modified BS."""
    return new - m - h / 4 * cross(new + m, v + w)


def hk_heavy(moments: Numbers, g: Numbers, h: Any, old: Numbers, new: Numbers, as_printed: bool = False) -> Numbers:
    """(dEulerPoisson), whose first three lines are the HK scheme of the Euler top with gravity.

    As printed, its last term is gamma_1 omega_2' instead of gamma_2 omega_1'.
    """
    w, c, v, e = old[:3], old[3:], new[:3], new[3:]
    gamma = e - c - h / 2 * (cross(e, w) + cross(c, v))
    if as_printed:
        gamma[2] += h / 2 * (c[0] * v[1] - c[1] * v[0])
    return exact(*hk_euler(moments, h, w, v) - h / (2 * moments) * cross(e + c, g), *gamma)


def lagrange_l1(h: Any, m: Numbers, n: Numbers, a: Numbers) -> Numbers:
    """(L1), with p = e_z."""
    return n - m - h * cross(exact(0, 0, 1), a)


def lagrange_l2(h: Any, n: Numbers, a: Numbers, b: Numbers) -> Numbers:
    """(L2)."""
    return b - a - h / 2 * cross(n, b + a)


def kowalevski(c0: Any, w: Numbers, c: Numbers) -> tuple[Numbers, Numbers]:
    """Components (K1), (K2): rates of omega and gamma."""
    return exact(w[1] * w[2] / 2, -w[2] * w[0] / 2 + c0 / 2 * c[2], -c0 * c[1]), poisson(w, c)


def kowalevski_laws(c0: Any, w: Numbers, c: Numbers) -> Numbers:
    """The four quantities of the list in section 3.1: gamma², 2l, E, k²."""
    return exact(
        c[0] * c[0] + c[1] * c[1] + c[2] * c[2],
        2 * (w[0] * c[0] + w[1] * c[1]) + w[2] * c[2],
        w[0] * w[0] + w[1] * w[1] + w[2] * w[2] / 2 + c0 * c[0],
        k_squared(c0, w, c),
    )


def xi(c0: Any, w: Numbers, c: Numbers) -> Gauss:
    """Kowalevski's xi = omega² - c0 gamma."""
    return plane(w) * plane(w) - c0 * plane(c)


def k_squared(c0: Any, w: Numbers, c: Numbers) -> Any:
    """Kowalevski's k² = |omega² - c0 gamma|²."""
    return (xi(c0, w, c) * xi(c0, w, c).bar).first


def k_squared_hybrid(c0: Any, w: Numbers, c: Numbers) -> Any:
    """|omega - c0 gamma|², as section 3.2.3 prints it."""
    root = plane(w) - c0 * plane(c)
    return (root * root.bar).first


def complex_omega(c0: Any, omega: Gauss, w3: Any, c3: Any) -> Numbers:
    """Rates of omega and its conjugate, section 3.1."""
    half = I_UNIT / 2
    return exact(-half * (w3 * omega - c0 * c3), half * (w3 * omega.bar - c0 * c3))


def complex_gamma(omega: Gauss, w3: Any, gamma: Gauss, c3: Any) -> Numbers:
    """Rates of gamma, its conjugate and gamma_3, section 3.1."""
    return exact(
        -I_UNIT * (w3 * gamma - omega * c3),
        I_UNIT * (w3 * gamma.bar - omega.bar * c3),
        I_UNIT / 2 * (omega.bar * gamma - omega * gamma.bar),
    )


def direct(c0: Any, h: Any, omega: Gauss, w3: Any, c3: Any) -> Gauss:
    """New omega by (direct), the prediction that chooses the root."""
    return omega - I_UNIT * h / 2 * (w3 * omega - c0 * c3)


def stereographic_rate(omega: Gauss, w3: Any, z: Gauss) -> Gauss:
    """Rate of z in Method (B)."""
    return I_UNIT / 2 * (omega - 2 * w3 * z - omega.bar * z * z)


def rotation(unit: Numbers, c: Any, s: Any) -> Numbers:
    """Matrix R of Method (C) for a unit vector and c = cos theta, s = sin theta."""
    a, b, d = unit
    e = 1 - c
    return exact(
        [a * a + (1 - a * a) * c, a * b * e + d * s, a * d * e - b * s],
        [b * a * e - d * s, b * b + (1 - b * b) * c, b * d * e + a * s],
        [d * a * e + b * s, d * b * e - a * s, d * d + (1 - d * d) * c],
    )


def bohlin(c0: Any, turn: Gauss, old: Numbers, new: Numbers) -> Gauss:
    """Bohlin's method: xi' = e^{-i chi} xi; ``turn`` is e^{-i chi}."""
    return xi(c0, new[:3], new[3:]) - turn * xi(c0, old[:3], old[3:])
