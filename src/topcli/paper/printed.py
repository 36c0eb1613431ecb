"""Equations of the paper as they are printed, for numbers of any kind. Names are the labels of its equations.

No scheme of topcli uses them: the ledger compares these transcriptions with each other and with the schemes.
"""

from __future__ import annotations

from typing import Any

from topcli.paper.algebra import I_UNIT, Gauss, Matrix, Vector, cross, dot, minus, plus, times, weighted


def euler_poisson(moments: Vector, g: Vector, omega: Vector, gamma: Vector) -> tuple[Vector, Vector]:
    """Vector equations (EulerPoisson): rates of m and gamma; ``g`` is mg(x0, y0, z0)."""
    m = weighted(moments, omega)
    first = plus(cross(m, omega), cross(gamma, g))
    return (first[0], first[1], first[2]), cross(gamma, omega)


def euler(moments: Vector, g: Vector, w: Vector, c: Vector) -> Vector:
    """Components (Euler): A, B, C times the rates of omega."""
    A, B, C = moments
    x0, y0, z0 = g
    return (
        (B - C) * w[1] * w[2] + (c[1] * z0 - c[2] * y0),
        (C - A) * w[2] * w[0] + (c[2] * x0 - c[0] * z0),
        (A - B) * w[0] * w[1] + (c[0] * y0 - c[1] * x0),
    )


def poisson(w: Vector, c: Vector) -> Vector:
    """Components (Poisson): rates of gamma."""
    return (c[1] * w[2] - c[2] * w[1], c[2] * w[0] - c[0] * w[2], c[0] * w[1] - c[1] * w[0])


def euler_top(moments: Vector, w: Vector) -> Vector:
    """Equations of the Euler top, section 1.2: A, B, C times the rates of omega."""
    A, B, C = moments
    return ((B - C) * w[1] * w[2], (C - A) * w[2] * w[0], (A - B) * w[0] * w[1])


EPSILON: Matrix = ((0, 1), (0, 0))
"""The 2x2 matrix of the Grassmann symbol epsilon."""


def hat(v: Vector) -> Matrix:
    """Antisymmetric matrix of a vector, as M, Omega, Gamma and G are printed."""
    return ((0, v[2], -v[1]), (-v[2], 0, v[0]), (v[1], -v[0], 0))


def laws(moments: Vector, g: Vector, w: Vector, c: Vector) -> tuple[Any, Any, Any]:
    """The three quantities of (constant): gamma², m·gamma, E."""
    m = weighted(moments, w)
    return dot(c, c), dot(m, c), dot(m, w) / 2 + dot(g, c)


def hk_euler(moments: Vector, h: Any, w: Vector, v: Vector) -> Vector:
    """Left minus right sides of the HK scheme of the Euler top, section 1.2; v is the new omega."""
    A, B, C = moments
    return (
        v[0] - w[0] - h * (B - C) / (2 * A) * (v[1] * w[2] + w[1] * v[2]),
        v[1] - w[1] - h * (C - A) / (2 * B) * (v[2] * w[0] + w[2] * v[0]),
        v[2] - w[2] - h * (A - B) / (2 * C) * (v[0] * w[1] + w[0] * v[1]),
    )


def hk_euler_vector(h: Any, m: Vector, n: Vector, w: Vector, v: Vector) -> tuple[Any, ...]:
    """Left minus right side of the HK scheme in vector form; n and v are new."""
    return minus(minus(n, m), times(h / 2, plus(cross(n, w), cross(m, v))))


def bs(h: Any, m: Vector, n: Vector, w: Vector) -> tuple[Any, ...]:
    """Left minus right side of n - m = h/2 (n + m) x w: (EulerBS) and, for gamma, Method (A)."""
    total = plus(n, m)
    return minus(minus(n, m), times(h / 2, cross((total[0], total[1], total[2]), w)))


def midpoint(h: Any, m: Vector, n: Vector, w: Vector, v: Vector) -> tuple[Any, ...]:
    """Left minus right side of n - m = h/4 (n + m) x (v + w): the last scheme of section 1.2, modified BS."""
    total, turn = plus(n, m), plus(v, w)
    right = cross((total[0], total[1], total[2]), (turn[0], turn[1], turn[2]))
    return minus(minus(n, m), times(h / 4, right))


def hk_heavy(
    moments: Vector, g: Vector, h: Any, old: tuple[Any, ...], new: tuple[Any, ...], corrected: bool
) -> tuple[Any, ...]:
    """Left minus right sides of (dEulerPoisson); with ``corrected``, its last term is gamma_2^n omega_1^{n+1}."""
    A, B, C = moments
    x0, y0, z0 = g
    w, c = old[:3], old[3:]
    v, e = new[:3], new[3:]
    last = c[1] * v[0] if corrected else c[0] * v[1]
    return (
        v[0]
        - w[0]
        - h * (B - C) / (2 * A) * (v[1] * w[2] + w[1] * v[2])
        - h / (2 * A) * (z0 * (e[1] + c[1]) - y0 * (e[2] + c[2])),
        v[1]
        - w[1]
        - h * (C - A) / (2 * B) * (v[2] * w[0] + w[2] * v[0])
        - h / (2 * B) * (x0 * (e[2] + c[2]) - z0 * (e[0] + c[0])),
        v[2]
        - w[2]
        - h * (A - B) / (2 * C) * (v[0] * w[1] + w[0] * v[1])
        - h / (2 * C) * (y0 * (e[0] + c[0]) - x0 * (e[1] + c[1])),
        e[0] - c[0] - h / 2 * (e[1] * w[2] + c[1] * v[2] - e[2] * w[1] - c[2] * v[1]),
        e[1] - c[1] - h / 2 * (e[2] * w[0] + c[2] * v[0] - e[0] * w[2] - c[0] * v[2]),
        e[2] - c[2] - h / 2 * (e[0] * w[1] + c[0] * v[1] - e[1] * w[0] - last),
    )


def lagrange_l1(h: Any, m: Vector, n: Vector, a: Vector) -> tuple[Any, ...]:
    """Left minus right side of (L1); n is the new m, and p = e_z."""
    return minus(minus(n, m), times(h, cross((0, 0, 1), a)))


def lagrange_l2(h: Any, n: Vector, a: Vector, b: Vector) -> tuple[Any, ...]:
    """Left minus right side of (L2); n and b are the new m and a."""
    total = plus(b, a)
    return minus(minus(b, a), times(h / 2, cross(n, (total[0], total[1], total[2]))))


def kowalevski(c0: Any, w: Vector, c: Vector) -> tuple[Vector, Vector]:
    """Components (K1), (K2): rates of omega and gamma."""
    return (
        (w[1] * w[2] / 2, -w[2] * w[0] / 2 + c0 / 2 * c[2], -c0 * c[1]),
        (c[1] * w[2] - c[2] * w[1], c[2] * w[0] - c[0] * w[2], c[0] * w[1] - c[1] * w[0]),
    )


def kowalevski_laws(c0: Any, w: Vector, c: Vector) -> tuple[Any, Any, Any, Any]:
    """The four quantities of the list in section 3.1: gamma², 2l, E, k²."""
    return (
        c[0] * c[0] + c[1] * c[1] + c[2] * c[2],
        2 * (w[0] * c[0] + w[1] * c[1]) + w[2] * c[2],
        w[0] * w[0] + w[1] * w[1] + w[2] * w[2] / 2 + c0 * c[0],
        k_squared(c0, w, c),
    )


def k_squared(c0: Any, w: Vector, c: Vector) -> Any:
    """Kowalevski's |omega² - c0 gamma|²."""
    x, y = w[0] * w[0] - w[1] * w[1] - c0 * c[0], 2 * w[0] * w[1] - c0 * c[1]
    return x * x + y * y


def k_squared_hybrid(c0: Any, w: Vector, c: Vector) -> Any:
    """|omega - c0 gamma|², as section 3.2.3 prints it."""
    x, y = w[0] - c0 * c[0], w[1] - c0 * c[1]
    return x * x + y * y


def complex_omega(c0: Any, omega: Gauss, w3: Any, c3: Any) -> tuple[Gauss, Gauss]:
    """Rates of omega and its conjugate, section 3.1."""
    half = I_UNIT / 2
    return -half * (w3 * omega - c0 * c3), half * (w3 * omega.bar - c0 * c3)


def complex_gamma(omega: Gauss, w3: Any, gamma: Gauss, c3: Any) -> tuple[Gauss, Gauss, Gauss]:
    """Rates of gamma, its conjugate and gamma_3, section 3.1."""
    return (
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


def rotation(n: Vector, c: Any, s: Any) -> Matrix:
    """Matrix R of Method (C) for a unit vector n and c = cos theta, s = sin theta."""
    a, b, d = n
    e = 1 - c
    return (
        (a * a + (1 - a * a) * c, a * b * e + d * s, a * d * e - b * s),
        (b * a * e - d * s, b * b + (1 - b * b) * c, b * d * e + a * s),
        (d * a * e + b * s, d * b * e - a * s, d * d + (1 - d * d) * c),
    )


def bohlin(c0: Any, turn: Gauss, old: tuple[Any, ...], new: tuple[Any, ...]) -> Gauss:
    """Left minus right side of Bohlin's method: xi' - e^{-i chi} xi; ``turn`` is e^{-i chi}."""
    omega, gamma = Gauss(old[0], old[1]), Gauss(old[3], old[4])
    v, e = Gauss(new[0], new[1]), Gauss(new[3], new[4])
    return v * v - c0 * e - turn * (omega * omega - c0 * gamma)
