"""Equations of the paper in their printed form, and the formulas that claims test, for numbers of any kind.

No scheme of topcli uses them: the claims compare these transcriptions with each other and with the schemes.
``moments`` are A, B, C; ``g`` is mg(x0, y0, z0); w and v are the old and new omega, c and e gamma, m and n the
momentum, a and b the vector a of the Lagrange top. The parameters of a function name the variables of a random point,
see ``Draws.point``. An equation of a scheme gives its left minus right sides, and so does a *difference*, whose
docstring says of what; *integrals* are some quantities of the state (w, c). ``as_printed`` keeps a misprint.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from topcli.paper.numbers import I_UNIT, SMALL, Array60, commutator, conj, exact, plane, unit_complex, vector_product

HeavyTop = tuple[Array60, Array60]
"""Moments of inertia and gravity."""


# the printed equations


def euler_poisson(moments: Array60, g: Array60, w: Array60, c: Array60) -> tuple[Array60, Array60]:
    """Vector equations (EulerPoisson): rates of m and gamma."""
    return vector_product(moments * w, w) + vector_product(c, g), vector_product(c, w)


def euler(moments: Array60, g: Array60, w: Array60, c: Array60) -> Array60:
    """Components (Euler): A, B, C times the rates of omega."""
    A, B, C = moments
    x0, y0, z0 = g
    return exact(
        (B - C) * w[1] * w[2] + (c[1] * z0 - c[2] * y0),
        (C - A) * w[2] * w[0] + (c[2] * x0 - c[0] * z0),
        (A - B) * w[0] * w[1] + (c[0] * y0 - c[1] * x0),
    )


def poisson(w: Array60, c: Array60) -> Array60:
    """Components (Poisson): rates of gamma."""
    return exact(c[1] * w[2] - c[2] * w[1], c[2] * w[0] - c[0] * w[2], c[0] * w[1] - c[1] * w[0])


def free_top(moments: Array60, w: Array60) -> Array60:
    """Equations of the Euler top, section 1.2: A, B, C times the rates of omega."""
    A, B, C = moments
    return exact((B - C) * w[1] * w[2], (C - A) * w[2] * w[0], (A - B) * w[0] * w[1])


EPSILON = exact([0, 1], [0, 0])
"""The 2x2 matrix of the Grassmann symbol epsilon."""


def hat(v: Array60) -> Array60:
    """Antisymmetric matrix of a vector, as M, Omega, Gamma and G are printed."""
    return exact([0, v[2], -v[1]], [-v[2], 0, v[0]], [v[1], -v[0], 0])


def laws(moments: Array60, g: Array60, w: Array60, c: Array60) -> Array60:
    """The three quantities of (constant): gamma², m·gamma, E."""
    m = moments * w
    return exact(c @ c, m @ c, m @ w / 2 + g @ c)


def hk_euler(moments: Array60, h: Any, w: Array60, new: Array60) -> Array60:
    """HK scheme of the Euler top, section 1.2."""
    A, B, C = moments
    v = new
    return exact(
        v[0] - w[0] - h * (B - C) / (2 * A) * (v[1] * w[2] + w[1] * v[2]),
        v[1] - w[1] - h * (C - A) / (2 * B) * (v[2] * w[0] + w[2] * v[0]),
        v[2] - w[2] - h * (A - B) / (2 * C) * (v[0] * w[1] + w[0] * v[1]),
    )


def hk_euler_vector(h: Any, m: Array60, n: Array60, w: Array60, v: Array60) -> Array60:
    """HK scheme of the Euler top in vector form."""
    return n - m - h / 2 * (vector_product(n, w) + vector_product(m, v))


def bs(h: Any, m: Array60, new: Array60, w: Array60) -> Array60:
    """Equation new - m = h/2 (new + m) x w: (EulerBS) and, for gamma, Method (A)."""
    return new - m - h / 2 * vector_product(new + m, w)


def midpoint(h: Any, m: Array60, new: Array60, w: Array60, v: Array60) -> Array60:
    """Equation new - m = h/4 (new + m) x (v + w): the last scheme of section 1.2, modified BS."""
    return new - m - h / 4 * vector_product(new + m, v + w)


def hk_heavy(moments: Array60, g: Array60, h: Any, old: Array60, new: Array60, as_printed: bool = False) -> Array60:
    """(dEulerPoisson), whose first three lines are the HK scheme of the Euler top with gravity.

    As printed, its last term is gamma_1 omega_2' instead of gamma_2 omega_1'.
    """
    w, c, v, e = old[:3], old[3:], new[:3], new[3:]
    gamma = e - c - h / 2 * (vector_product(e, w) + vector_product(c, v))
    if as_printed:
        gamma[2] += h / 2 * (c[0] * v[1] - c[1] * v[0])
    return exact(*hk_euler(moments, h, w, v) - h / (2 * moments) * vector_product(e + c, g), *gamma)


def lagrange_l1(h: Any, m: Array60, n: Array60, a: Array60) -> Array60:
    """(L1), with p = e_z."""
    return n - m - h * vector_product(exact(0, 0, 1), a)


def lagrange_l2(h: Any, n: Array60, a: Array60, b: Array60) -> Array60:
    """(L2)."""
    return b - a - h / 2 * vector_product(n, b + a)


def kowalevski(c0: Any, w: Array60, c: Array60) -> tuple[Array60, Array60]:
    """Components (K1), (K2): rates of omega and gamma."""
    return exact(w[1] * w[2] / 2, -w[2] * w[0] / 2 + c0 / 2 * c[2], -c0 * c[1]), poisson(w, c)


def kowalevski_laws(c0: Any, w: Array60, c: Array60) -> Array60:
    """The four quantities of the list in section 3.1: gamma², 2l, E, k²."""
    return exact(
        c[0] * c[0] + c[1] * c[1] + c[2] * c[2],
        2 * (w[0] * c[0] + w[1] * c[1]) + w[2] * c[2],
        w[0] * w[0] + w[1] * w[1] + w[2] * w[2] / 2 + c0 * c[0],
        k_squared(c0, w, c),
    )


def xi(c0: Any, w: Array60, c: Array60) -> Any:
    """Kowalevski's xi = omega² - c0 gamma."""
    return plane(w) * plane(w) - c0 * plane(c)


def k_squared(c0: Any, w: Array60, c: Array60) -> Any:
    """Kowalevski's k² = |omega² - c0 gamma|²."""
    return abs(xi(c0, w, c)) ** 2


def k_squared_hybrid(c0: Any, w: Array60, c: Array60) -> Any:
    """|omega - c0 gamma|², as section 3.2.3 prints it."""
    root = plane(w) - c0 * plane(c)
    return abs(root) ** 2


def complex_omega(c0: Any, omega: Any, w3: Any, c3: Any) -> Array60:
    """Rates of omega and its conjugate, section 3.1."""
    half = I_UNIT / 2
    return exact(-half * (w3 * omega - c0 * c3), half * (w3 * conj(omega) - c0 * c3))


def complex_gamma(omega: Any, w3: Any, gamma: Any, c3: Any) -> Array60:
    """Rates of gamma, its conjugate and gamma_3, section 3.1."""
    return exact(
        -I_UNIT * (w3 * gamma - omega * c3),
        I_UNIT * (w3 * conj(gamma) - conj(omega) * c3),
        I_UNIT / 2 * (conj(omega) * gamma - omega * conj(gamma)),
    )


def direct_prediction(c0: Any, h: Any, omega: Any, w3: Any, c3: Any) -> Any:
    """New omega by (direct), the prediction that chooses the root."""
    return omega - I_UNIT * h / 2 * (w3 * omega - c0 * c3)


def stereographic_rate(omega: Any, w3: Any, z: Any) -> Any:
    """Rate of z in Method (B)."""
    return I_UNIT / 2 * (omega - 2 * w3 * z - conj(omega) * z * z)


def rotation(unit: Array60, c: Any, s: Any) -> Array60:
    """Matrix R of Method (C) for a unit vector and c = cos theta, s = sin theta."""
    a, b, d = unit
    e = 1 - c
    return exact(
        [a * a + (1 - a * a) * c, a * b * e + d * s, a * d * e - b * s],
        [b * a * e - d * s, b * b + (1 - b * b) * c, b * d * e + a * s],
        [d * a * e + b * s, d * b * e - a * s, d * d + (1 - d * d) * c],
    )


def bohlin_equation(c0: Any, turn: Any, old: Array60, new: Array60) -> Any:
    """Bohlin's method: xi' = e^{-i chi} xi; ``turn`` is e^{-i chi}."""
    return xi(c0, new[:3], new[3:]) - turn * xi(c0, old[:3], old[3:])


# differences, integrals and equations for a new state


# section 1.1: the Euler-Poisson equations


def components(top: HeavyTop, w: Array60, c: Array60) -> Any:
    """(Euler) and (Poisson) against (EulerPoisson)."""
    return exact(euler(*top, w, c), poisson(w, c)) - exact(*euler_poisson(*top, w, c))


def top_integrals(top: HeavyTop, w: Array60, c: Array60) -> Array60:
    """The three quantities of (constant), for any top."""
    return laws(*top, w, c)


def euler_integrals(euler_top: HeavyTop, w: Array60, c: Array60) -> Array60:
    """The three quantities of (constant) and m², without gravity."""
    m = euler_top[0] * w
    return exact(*laws(*euler_top, w, c), m @ m)


def lagrange_integrals(lagrange_top: HeavyTop, w: Array60, c: Array60) -> Array60:
    """The three quantities of (constant) and omega_3, with A = B and gravity on the third axis."""
    return exact(*laws(*lagrange_top, w, c), w[2])


def kowalevski_integrals(kowalevski_top: HeavyTop, w: Array60, c: Array60, as_printed: bool = False) -> Array60:
    """The three quantities of (constant) and k² with c0/C, for A = B = 2C, gravity c0; as printed, k² with c0."""
    (_, _, C), (c0, _, _) = kowalevski_top
    return exact(*laws(*kowalevski_top, w, c), k_squared(c0 if as_printed else c0 / C, w, c))


def matrix_m(top: HeavyTop, w: Array60, c: Array60) -> Any:
    """[Omega, M] + [G, Gamma] against the matrix of m x omega + gamma x g."""
    moments, g = top
    right = commutator(hat(w), hat(moments * w)) + commutator(hat(g), hat(c))
    return hat(euler_poisson(moments, g, w, c)[0]) - right


def matrix_gamma(top: HeavyTop, w: Array60, c: Array60) -> Any:
    """[Omega, Gamma] against the matrix of gamma x omega."""
    return hat(euler_poisson(*top, w, c)[1]) - commutator(hat(w), hat(c))


def audin(top: HeavyTop, w: Array60, c: Array60) -> Any:
    """(Audin): d/dt (Gamma + epsilon M) against [Omega + epsilon G, Gamma + epsilon M], with a negligible epsilon²."""
    moments, g = top
    m_rate, c_rate = euler_poisson(moments, g, w, c)
    right = commutator(hat(w + SMALL * g), hat(c + SMALL * moments * w))
    return hat(c_rate + SMALL * m_rate) - right


def _block(upper: Array60, diagonal: Array60) -> Array60:
    """6x6 matrix of diagonal + epsilon upper, with epsilon² = 0."""
    return np.block([[diagonal, upper], [0 * diagonal, diagonal]])


def epsilon(m: Array60, c: Array60) -> Any:
    """The square of the 2x2 matrix of epsilon, and Gamma + epsilon M with it against the 6x6 matrix L."""
    matrix, unit = EPSILON, np.eye(2, dtype=int)
    whole = np.kron(unit, hat(c)) + np.kron(matrix, hat(m))
    return [*(matrix @ matrix).flat, *(_block(hat(m), hat(c)) - whole).flat]


def combined(top: HeavyTop, w: Array60, c: Array60) -> Any:
    """(Audin) in the 6x6 matrices of the Lax-Moser-like form."""
    moments, g = top
    m_rate, c_rate = euler_poisson(moments, g, w, c)
    right = commutator(_block(hat(g), hat(w)), _block(hat(moments * w), hat(c)))
    return _block(hat(m_rate), hat(c_rate)) - right


def block_traces(top: HeavyTop, w: Array60, c: Array60) -> Array60:
    """Traces of both 3x3 blocks of L, ..., L^6 for the 6x6 matrix L of the Lax-Moser-like form."""
    matrix = power = _block(hat(top[0] * w), hat(c))
    traces = []
    for _ in range(6):
        traces += [np.trace(power[:3, :3]), np.trace(power[:3, 3:])]
        power = power @ matrix
    return exact(*traces)


# section 1.2: the Euler top


def euler_without_gravity(euler_top: HeavyTop, w: Array60, c: Array60) -> Any:
    """The equations of the Euler top against (Euler) with g = 0."""
    return free_top(euler_top[0], w) - euler(*euler_top, w, c)


def hk_euler_consistent(moments: Array60, h: Any, w: Array60) -> Any:
    """The HK scheme as both states coincide, divided by h, against the equations of the Euler top."""
    return 1 / h * hk_euler(moments, h, w, w) + free_top(moments, w) / moments


def hk_euler_symmetric(moments: Array60, h: Any, w: Array60, v: Array60) -> Any:
    """The HK scheme with h -> -h and both states exchanged, plus the scheme itself."""
    return hk_euler(moments, h, w, v) + hk_euler(moments, -h, v, w)


def hk_euler_forms(moments: Array60, h: Any, w: Array60, v: Array60) -> Any:
    """The vector form of the HK scheme against the moments times its components."""
    left = hk_euler_vector(h, moments * w, moments * v, w, v)
    return left - moments * hk_euler(moments, h, w, v)


def hk_euler_chain(h: Any, m: Array60, n: Array60, w: Array60, v: Array60) -> Any:
    """Neighbouring lines of the computation of m'² - m²."""
    return np.diff(
        exact(
            (n + m) @ (h / 2 * (vector_product(n, w) + vector_product(m, v))),
            h / 2 * (m @ vector_product(n, w) + n @ vector_product(m, v)),
            h / 2 * (w - v) @ vector_product(m, n),
        )
    )


def bs_new_omega(new: Array60, m: Array60, moments: Array60, h: Any) -> Any:
    """(EulerBS) with the new omega, as an equation for the new m."""
    return bs(h, m, new, new / moments)


def midpoint_rule(new: Array60, m: Array60, moments: Array60, h: Any) -> Any:
    """Last scheme of section 1.2 as an equation for the new m, with omega = m/I."""
    return midpoint(h, m, new, m / moments, new / moments)


def midpoint_energy(moments: Array60, w: Array60, v: Array60) -> Any:
    """The identity m'·omega = m·omega', and (omega' + omega)·(m' - m) against m'·omega' - m·omega."""
    m, n = moments * w, moments * v
    return [n @ w - m @ v, (v + w) @ (n - m) - (n @ v - m @ w)]


# sections 2.1 to 2.3: heavy tops


def hk_heavy_consistent(top: HeavyTop, w: Array60, c: Array60, h: Any, as_printed: bool = False) -> Any:
    """Difference of (dEulerPoisson) from the continuous equations as both states coincide, divided by h."""
    state = exact(*w, *c)
    discrete = -hk_heavy(*top, h, state, state, as_printed) / h
    return discrete - exact(*euler(*top, w, c) / top[0], *poisson(w, c))


def lagrange_bs(h: Any, old: Array60, new: Array60) -> Any:
    """(L1) and (L2)."""
    return [lagrange_l1(h, old[:3], new[:3], old[3:]), lagrange_l2(h, new[:3], old[3:], new[3:])]


def lagrange_bs_in_turn(new: Array60, h: Any, m: Array60, a: Array60, n: Array60) -> Any:
    """(L1) as an equation for the new m, and (L2) for the new a at a given new m."""
    return exact(lagrange_l1(h, m, new[:3], a), lagrange_l2(h, n, a, new[3:]))


def lagrange_cubic(m: Array60, unit: Array60) -> Any:
    """u = a·p: (du/dt)² against a cubic of u with the integrals as coefficients, along m' = p x a, a' = m x a."""
    u, about, vertical = unit[2], m @ unit, m[2]
    energy, rate = m @ m / 2 + u, vector_product(m, unit)[2]
    return [rate * rate - (2 * (energy - u) * (1 - u * u) + 2 * vertical * about * u - vertical**2 - about**2)]


# section 3.1: the Kowalevski top


def kowalevski_equations(c0: Any, w: Array60, c: Array60) -> Any:
    """(K1), (K2) against (EulerPoisson) with A = B = 2, C = 1, g = (c0, 0, 0)."""
    moments = exact(2, 2, 1)
    w_rate, c_rate = kowalevski(c0, w, c)
    return exact(moments * w_rate, c_rate) - exact(*euler_poisson(moments, exact(c0, 0, 0), w, c))


def kowalevski_scaling(C: Any, x0: Any, w: Array60, c: Array60) -> Any:
    """The equations with A = B = 2C for any C against those with C = 1 and c0/C."""
    moments = exact(2 * C, 2 * C, C)
    m_rate, _ = euler_poisson(moments, exact(x0, 0, 0), w, c)
    return m_rate / moments - kowalevski(x0 / C, w, c)[0]


def complex_omega_components(c0: Any, w: Array60, c: Array60) -> Any:
    """Complex equations for omega and its conjugate against the components."""
    rate = plane(kowalevski(c0, w, c)[0])
    return complex_omega(c0, plane(w), w[2], c[2]) - exact(rate, conj(rate))


def complex_gamma_components(c0: Any, w: Array60, c: Array60) -> Any:
    """Complex equations for gamma, its conjugate and gamma_3 against the components."""
    rates = kowalevski(c0, w, c)[1]
    rate = plane(rates)
    return complex_gamma(plane(w), w[2], plane(c), c[2]) - exact(rate, conj(rate), rates[2])


def xi_parts(c0: Any, w: Array60, c: Array60) -> Any:
    """First line of (Kxi): the rates of omega² and c0 gamma."""
    w_rate, c_rate = map(plane, kowalevski(c0, w, c))
    omega, pull = plane(w), I_UNIT * c0 * c[2] * plane(w)
    return (
        2 * omega * w_rate - (-I_UNIT * w[2] * omega * omega + pull),
        c0 * c_rate - (-I_UNIT * c0 * w[2] * plane(c) + pull),
    )


def xi_turns(c0: Any, w: Array60, c: Array60) -> Any:
    """Second line of (Kxi): xi turns with the angular velocity -omega_3."""
    w_rate, c_rate = map(plane, kowalevski(c0, w, c))
    return [2 * plane(w) * w_rate - c0 * c_rate + I_UNIT * w[2] * xi(c0, w, c)]


def listed_laws(c0: Any, w: Array60, c: Array60) -> Any:
    """2l and E as listed against m·gamma and E of (constant)."""
    return kowalevski_laws(c0, w, c)[:3] - laws(exact(2, 2, 1), exact(c0, 0, 0), w, c)


def opposite_gravity(c0: Any, w: Array60, c: Array60) -> Any:
    """The equations for -c0 against those for c0 after a half turn about the third axis."""
    half_turn = exact(-1, -1, 1)
    turned = exact(*kowalevski(c0, half_turn * w, half_turn * c))
    return half_turn * turned - exact(*kowalevski(-c0, w, c))


# section 3.2: methods A, B, C, Bohlin's method, and the hybrid


def gamma_of_method_b(new: Array60, h: Any, w: Array60, unit: Array60) -> Any:
    """Euler's rule for z as an equation for the new z."""
    z = plane(unit) / (1 + unit[2])
    return [plane(new) - z - h * stereographic_rate(plane(w), w[2], z)]


def gamma_of_method_c(new: Array60, unit: Array60, turn: Array60, c: Array60) -> Any:
    """(C) as an equation for the new gamma; the angle h |omega| and its axis are those of the old omega."""
    return new - rotation(unit, *turn) @ c


def bohlin_square(new: Array60, c0: Any, turn: Array60, old: Array60, e: Array60) -> Any:
    """Bohlin's equation for the square of the new omega_1 + i omega_2, at the new gamma and omega_3."""
    return [bohlin_equation(c0, plane(turn), old, exact(0, 0, 0, *e)) + plane(new)]


def direct_is_euler(c0: Any, h: Any, w: Array60, c: Array60) -> Any:
    """(direct) against omega + h d omega/dt with the printed rate."""
    omega = plane(w)
    return [direct_prediction(c0, h, omega, w[2], c[2]) - omega - h * complex_omega(c0, omega, w[2], c[2])[0]]


def stereographic(unit: Array60) -> Any:
    """The three formulas for gamma and the three for z, at a point of the sphere."""
    z = plane(unit) / (1 + unit[2])
    size = abs(z) ** 2
    gamma, third = 2 * z / (1 + size), (1 - size) / (1 + size)
    return [
        gamma - plane(unit),
        conj(gamma) - 2 * conj(z) / (1 + size),
        third - unit[2],
        size - (1 - unit[2]) / (1 + unit[2]),
        gamma * conj(gamma) + third * third - 1,
    ]


def stereographic_motion(w: Array60, unit: Array60) -> Any:
    """The equation for z against the rate of (gamma_1 + i gamma_2)/(1 + gamma_3) along (K2)."""
    rate, omega = poisson(w, unit), plane(w)
    z = plane(unit) / (1 + unit[2])
    expected = plane(rate) / (1 + unit[2]) - z * rate[2] / (1 + unit[2])
    conjugate = -I_UNIT / 2 * (conj(omega) - 2 * w[2] * conj(z) - omega * conj(z) * conj(z))
    return [stereographic_rate(omega, w[2], z) - expected, conjugate - conj(expected)]


def rotation_properties(unit: Array60, turn: Array60) -> Any:
    """R is orthogonal, leaves its axis, and has the trace 1 + 2 cos theta."""
    R = rotation(unit, *turn)
    return [*(R @ R.T - np.eye(3, dtype=int)).flat, *(R @ unit - unit), np.trace(R) - (1 + 2 * turn[0])]


def rotation_generator(unit: Array60, turn: Array60) -> Any:
    """dR/dtheta R^{-1} against the matrix of gamma -> gamma x n, the equation (K2) for constant omega."""
    cosine, sine = turn
    # R is affine in (cosine, sine), whose derivatives are (-sine, cosine)
    slope = rotation(unit, -sine, cosine) - rotation(unit, 0, 0)
    return slope - hat(unit) @ rotation(unit, *turn)


def kepler(w: Array60, v: Array60) -> Any:
    """Hooke's motion w'' = -w as z = w² in the time tau, dtau = |w|² dt, against Kepler's d²z/dtau² = -4 E z/|z|³."""
    root, rate = plane(w), plane(v)
    square = abs(root) ** 2
    energy = (abs(rate) ** 2 + square) / 2
    # dz/dtau = 2 w'/conj(w), differentiated once more with w'' = -w
    second = (-2 * root / conj(root) - 2 * rate * conj(rate) / (conj(root) * conj(root))) / square
    return [second + 4 * energy * root * root / (square * square * square)]


# equations for a step from ``old`` to ``new``


def trapezoidal(c0: Any, h: Any, old: Array60, new: Array60) -> Any:
    """Bohlin's equation xi' = e^{-i chi} xi with chi = h/2 (omega_3' + omega_3), section 3.2.2 (2)."""
    return [bohlin_equation(c0, unit_complex(-h / 2 * (new[2] + old[2])), old, new)]
