"""Formulas that claims on the printed equations test: identities, integrals, equations for a new state.

The parameters of a function name the variables of a random point, see ``Draws.point``. A *difference* returns left
minus right sides of an identity, *integrals* some quantities of the state (w, c), and an *equation* its residual in
the unknown ``new``. ``as_printed`` keeps a misprint of the paper.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from topcli.paper import printed
from topcli.paper.algebra import I_UNIT, Numbers, commutator, cross, dual, exact, plane

Top = tuple[Numbers, Numbers]
"""Moments of inertia and gravity."""


# section 1.1: the Euler-Poisson equations


def components(top: Top, w: Numbers, c: Numbers) -> Any:
    """(Euler) and (Poisson) against (EulerPoisson)."""
    return exact(printed.euler(*top, w, c), printed.poisson(w, c)) - exact(*printed.euler_poisson(*top, w, c))


def top_integrals(top: Top, w: Numbers, c: Numbers) -> Numbers:
    """The three quantities of (constant), for any top."""
    return printed.laws(*top, w, c)


def euler_integrals(euler_top: Top, w: Numbers, c: Numbers) -> Numbers:
    """Those and m², without gravity."""
    m = euler_top[0] * w
    return exact(*printed.laws(*euler_top, w, c), m @ m)


def lagrange_integrals(lagrange_top: Top, w: Numbers, c: Numbers) -> Numbers:
    """Those and omega_3, with A = B and gravity on the third axis."""
    return exact(*printed.laws(*lagrange_top, w, c), w[2])


def kowalevski_integrals(kowalevski_top: Top, w: Numbers, c: Numbers, as_printed: bool = False) -> Numbers:
    """Those and k² with c0/C, for A = B = 2C and gravity c0 on the first axis; as printed, k² with c0."""
    (_, _, C), (c0, _, _) = kowalevski_top
    return exact(*printed.laws(*kowalevski_top, w, c), printed.k_squared(c0 if as_printed else c0 / C, w, c))


def dependent_integrals(w: Numbers, c: Numbers) -> Numbers:
    """gamma², gamma_1 and gamma_1², which are dependent."""
    return exact(c @ c, c[0], c[0] * c[0])


def matrix_m(top: Top, w: Numbers, c: Numbers) -> Any:
    """[Omega, M] + [G, Gamma] against the matrix of m x omega + gamma x g."""
    moments, g = top
    hat = printed.hat
    right = commutator(hat(w), hat(moments * w)) + commutator(hat(g), hat(c))
    return hat(printed.euler_poisson(moments, g, w, c)[0]) - right


def matrix_gamma(top: Top, w: Numbers, c: Numbers) -> Any:
    """[Omega, Gamma] against the matrix of gamma x omega."""
    return printed.hat(printed.euler_poisson(*top, w, c)[1]) - commutator(printed.hat(w), printed.hat(c))


def audin(top: Top, w: Numbers, c: Numbers) -> Any:
    """(Audin): d/dt (Gamma + epsilon M) against [Omega + epsilon G, Gamma + epsilon M]; epsilon² = 0 as in a dual."""
    (moments, g), hat = top, printed.hat
    m_rate, c_rate = printed.euler_poisson(moments, g, w, c)
    return dual(hat(c_rate), hat(m_rate)) - commutator(dual(hat(w), hat(g)), dual(hat(c), hat(moments * w)))


def _block(upper: Numbers, diagonal: Numbers) -> Numbers:
    """6x6 matrix of diagonal + epsilon upper, with epsilon² = 0."""
    return np.block([[diagonal, upper], [0 * diagonal, diagonal]])


def epsilon(m: Numbers, c: Numbers) -> Any:
    """The square of the 2x2 matrix of epsilon, and Gamma + epsilon M with it against the 6x6 matrix L."""
    matrix, unit = printed.EPSILON, np.eye(2, dtype=int)
    whole = np.kron(unit, printed.hat(c)) + np.kron(matrix, printed.hat(m))
    return [*(matrix @ matrix).flat, *(_block(printed.hat(m), printed.hat(c)) - whole).flat]


def combined(top: Top, w: Numbers, c: Numbers) -> Any:
    """(Audin) in the matrices of the Lax-Moser-like form."""
    (moments, g), hat = top, printed.hat
    m_rate, c_rate = printed.euler_poisson(moments, g, w, c)
    right = commutator(_block(hat(g), hat(w)), _block(hat(moments * w), hat(c)))
    return _block(hat(m_rate), hat(c_rate)) - right


# section 1.2: the Euler top


def euler_without_gravity(euler_top: Top, w: Numbers, c: Numbers) -> Any:
    """The equations of the Euler top against (Euler) with g = 0."""
    return printed.euler_top(euler_top[0], w) - printed.euler(*euler_top, w, c)


def hk_euler_consistent(moments: Numbers, h: Any, w: Numbers) -> Any:
    """The HK scheme as both states coincide, divided by h, against the equations of the Euler top."""
    return 1 / h * printed.hk_euler(moments, h, w, w) + printed.euler_top(moments, w) / moments


def hk_euler_symmetric(moments: Numbers, h: Any, w: Numbers, v: Numbers) -> Any:
    """The HK scheme with h -> -h and both states exchanged, plus the scheme itself."""
    return printed.hk_euler(moments, h, w, v) + printed.hk_euler(moments, -h, v, w)


def hk_euler_vector(moments: Numbers, h: Any, w: Numbers, v: Numbers) -> Any:
    """The vector form of the HK scheme against the moments times its components."""
    left = printed.hk_euler_vector(h, moments * w, moments * v, w, v)
    return left - moments * printed.hk_euler(moments, h, w, v)


def hk_euler_chain(h: Any, m: Numbers, n: Numbers, w: Numbers, v: Numbers) -> Any:
    """Neighbouring lines of the computation of m'² - m²."""
    return np.diff(
        exact(
            (n + m) @ (h / 2 * (cross(n, w) + cross(m, v))),
            h / 2 * (m @ cross(n, w) + n @ cross(m, v)),
            h / 2 * (w - v) @ cross(m, n),
        )
    )


def bs_new_omega(new: Numbers, m: Numbers, moments: Numbers, h: Any) -> Any:
    """(EulerBS) with the new omega, as an equation for the new m."""
    return printed.bs(h, m, new, new / moments)


def midpoint_rule(new: Numbers, m: Numbers, moments: Numbers, h: Any) -> Any:
    """Last scheme of section 1.2 as an equation for the new m, with omega = m/I."""
    return printed.midpoint(h, m, new, m / moments, new / moments)


def midpoint_energy(moments: Numbers, w: Numbers, v: Numbers) -> Any:
    """The identity m'·omega = m·omega', and (omega' + omega)·(m' - m) against m'·omega' - m·omega."""
    m, n = moments * w, moments * v
    return [n @ w - m @ v, (v + w) @ (n - m) - (n @ v - m @ w)]


# sections 2.1 to 2.3: heavy tops


def hk_heavy_consistent(top: Top, w: Numbers, c: Numbers, h: Any, as_printed: bool = False) -> Any:
    """Difference of (dEulerPoisson) from the continuous equations as both states coincide, divided by h."""
    state = exact(*w, *c)
    discrete = -printed.hk_heavy(*top, h, state, state, as_printed) / h
    return discrete - exact(*printed.euler(*top, w, c) / top[0], *printed.poisson(w, c))


def lagrange_bs(h: Any, old: Numbers, new: Numbers) -> Any:
    """(L1) and (L2)."""
    return [printed.lagrange_l1(h, old[:3], new[:3], old[3:]), printed.lagrange_l2(h, new[:3], old[3:], new[3:])]


def lagrange_bs_in_turn(new: Numbers, h: Any, m: Numbers, a: Numbers, n: Numbers) -> Any:
    """(L1) as an equation for the new m, and (L2) for the new a at a given new m."""
    return exact(printed.lagrange_l1(h, m, new[:3], a), printed.lagrange_l2(h, n, a, new[3:]))


def lagrange_cubic(m: Numbers, unit: Numbers) -> Any:
    """u = a·p: (du/dt)² against a cubic of u with the integrals as coefficients, along m' = p x a, a' = m x a."""
    u, about, vertical = unit[2], m @ unit, m[2]
    energy, rate = m @ m / 2 + u, cross(m, unit)[2]
    return [rate * rate - (2 * (energy - u) * (1 - u * u) + 2 * vertical * about * u - vertical**2 - about**2)]


# section 3.1: the Kowalevski top


def kowalevski_equations(c0: Any, w: Numbers, c: Numbers) -> Any:
    """(K1), (K2) against (EulerPoisson) with A = B = 2, C = 1, g = (c0, 0, 0)."""
    moments = exact(2, 2, 1)
    w_rate, c_rate = printed.kowalevski(c0, w, c)
    return exact(moments * w_rate, c_rate) - exact(*printed.euler_poisson(moments, exact(c0, 0, 0), w, c))


def kowalevski_scaling(C: Any, x0: Any, w: Numbers, c: Numbers) -> Any:
    """The equations with A = B = 2C for any C against those with C = 1 and c0/C."""
    moments = exact(2 * C, 2 * C, C)
    m_rate, _ = printed.euler_poisson(moments, exact(x0, 0, 0), w, c)
    return m_rate / moments - printed.kowalevski(x0 / C, w, c)[0]


def complex_omega(c0: Any, w: Numbers, c: Numbers) -> Any:
    """Complex equations for omega and its conjugate against the components."""
    rate = plane(printed.kowalevski(c0, w, c)[0])
    return printed.complex_omega(c0, plane(w), w[2], c[2]) - exact(rate, rate.bar)


def complex_gamma(c0: Any, w: Numbers, c: Numbers) -> Any:
    """Complex equations for gamma, its conjugate and gamma_3 against the components."""
    rates = printed.kowalevski(c0, w, c)[1]
    rate = plane(rates)
    return printed.complex_gamma(plane(w), w[2], plane(c), c[2]) - exact(rate, rate.bar, rates[2])


def xi_parts(c0: Any, w: Numbers, c: Numbers) -> Any:
    """First line of (Kxi): the rates of omega² and c0 gamma."""
    w_rate, c_rate = map(plane, printed.kowalevski(c0, w, c))
    omega, pull = plane(w), I_UNIT * c0 * c[2] * plane(w)
    return (
        2 * omega * w_rate - (-I_UNIT * w[2] * omega * omega + pull),
        c0 * c_rate - (-I_UNIT * c0 * w[2] * plane(c) + pull),
    )


def xi_turns(c0: Any, w: Numbers, c: Numbers) -> Any:
    """Second line of (Kxi): xi turns with the angular velocity -omega_3."""
    w_rate, c_rate = map(plane, printed.kowalevski(c0, w, c))
    return [2 * plane(w) * w_rate - c0 * c_rate + I_UNIT * w[2] * printed.xi(c0, w, c)]


def xi_turns_back(w: Numbers, c: Numbers, c0: Any) -> Any:
    """The complex equations against a turn of xi with the opposite sign."""
    rate = 2 * plane(w) * printed.complex_omega(c0, plane(w), w[2], c[2])[0]
    rate -= c0 * printed.complex_gamma(plane(w), w[2], plane(c), c[2])[0]
    return [rate - I_UNIT * w[2] * printed.xi(c0, w, c)]


def listed_laws(c0: Any, w: Numbers, c: Numbers) -> Any:
    """2l and E as listed against m·gamma and E of (constant)."""
    return printed.kowalevski_laws(c0, w, c)[:3] - printed.laws(exact(2, 2, 1), exact(c0, 0, 0), w, c)


def opposite_gravity(c0: Any, w: Numbers, c: Numbers) -> Any:
    """The equations for -c0 against those for c0 after a half turn about the third axis."""
    half_turn = exact(-1, -1, 1)
    turned = exact(*printed.kowalevski(c0, half_turn * w, half_turn * c))
    return half_turn * turned - exact(*printed.kowalevski(-c0, w, c))


# section 3.2: methods A, B, C, Bohlin's method, and the hybrid


def method_b(new: Numbers, h: Any, w: Numbers, unit: Numbers) -> Any:
    """Euler's rule for z as an equation for the new z."""
    z = plane(unit) / (1 + unit[2])
    return [plane(new) - z - h * printed.stereographic_rate(plane(w), w[2], z)]


def method_c(new: Numbers, unit: Numbers, turn: Numbers, c: Numbers) -> Any:
    """(C) as an equation for the new gamma; the angle h |omega| and its axis are those of the old omega."""
    return new - printed.rotation(unit, *turn) @ c


def bohlin_square(new: Numbers, c0: Any, turn: Numbers, old: Numbers, e: Numbers) -> Any:
    """Bohlin's equation for the square of the new omega_1 + i omega_2, at the new gamma and omega_3."""
    return [printed.bohlin(c0, plane(turn), old, exact(0, 0, 0, *e)) + plane(new)]


def direct(c0: Any, h: Any, w: Numbers, c: Numbers) -> Any:
    """(direct) against omega + h d omega/dt with the printed rate."""
    omega = plane(w)
    return [printed.direct(c0, h, omega, w[2], c[2]) - omega - h * printed.complex_omega(c0, omega, w[2], c[2])[0]]


def stereographic(unit: Numbers) -> Any:
    """The three formulas for gamma and the three for z, at a point of the sphere."""
    z = plane(unit) / (1 + unit[2])
    size = (z * z.bar).first
    gamma, third = 2 * z / (1 + size), (1 - size) / (1 + size)
    return [
        gamma - plane(unit),
        gamma.bar - 2 * z.bar / (1 + size),
        third - unit[2],
        size - (1 - unit[2]) / (1 + unit[2]),
        gamma * gamma.bar + third * third - 1,
    ]


def stereographic_rate(w: Numbers, unit: Numbers) -> Any:
    """The equation for z against the rate of (gamma_1 + i gamma_2)/(1 + gamma_3) along (K2)."""
    rate, omega = printed.poisson(w, unit), plane(w)
    z = plane(unit) / (1 + unit[2])
    expected = plane(rate) / (1 + unit[2]) - z * rate[2] / (1 + unit[2])
    conjugate = -I_UNIT / 2 * (omega.bar - 2 * w[2] * z.bar - omega * z.bar * z.bar)
    return [printed.stereographic_rate(omega, w[2], z) - expected, conjugate - expected.bar]


def rotation(unit: Numbers, turn: Numbers) -> Any:
    """R is orthogonal, leaves its axis, and has the trace 1 + 2 cos theta."""
    R = printed.rotation(unit, *turn)
    return [*(R @ R.T - np.eye(3, dtype=int)).flat, *(R @ unit - unit), np.trace(R) - (1 + 2 * turn[0])]


def rotation_generator(unit: Numbers, turn: Numbers) -> Any:
    """dR/dtheta R^{-1} against the matrix of gamma -> gamma x n, the equation (K2) for constant omega."""
    cosine, sine = turn
    # R is affine in (cosine, sine), whose derivatives are (-sine, cosine)
    slope = printed.rotation(unit, -sine, cosine) - printed.rotation(unit, 0, 0)
    return slope - printed.hat(unit) @ printed.rotation(unit, *turn)


def kepler(w: Numbers, v: Numbers) -> Any:
    """Hooke's motion w'' = -w as z = w² in the time tau, dtau = |w|² dt, against Kepler's d²z/dtau² = -4 E z/|z|³."""
    root, rate = plane(w), plane(v)
    square = (root * root.bar).first
    energy = ((rate * rate.bar).first + square) / 2
    # dz/dtau = 2 w'/conj(w), differentiated once more with w'' = -w
    second = (-2 * root / root.bar - 2 * rate * rate.bar / (root.bar * root.bar)) / square
    return [second + 4 * energy * root * root / (square * square * square)]


# equations for a step from ``old`` to ``new``, with the functions cos and sin of their numbers


def method_a(c0: Any, h: Any, old: Numbers, new: Numbers, functions: Any) -> Any:
    """Method (A), whose omega is the old one."""
    return printed.bs(h, old[3:], new[3:], old[:3])


def trapezoidal(c0: Any, h: Any, old: Numbers, new: Numbers, functions: Any) -> Any:
    """Bohlin's equation xi' = e^{-i chi} xi with chi = h/2 (omega_3' + omega_3), section 3.2.2 (2)."""
    chi = h / 2 * (new[2] + old[2])
    return [printed.bohlin(c0, plane([functions.cos(chi), -functions.sin(chi)]), old, new)]
