"""Integrals of the HK map of the Euler top, without and with the vertical gamma, and of the Lagrange top.

Euler: with d = h/2, alpha_1 = (B - C)/A and cyclically, I = (A, B, C), i, j, k cyclic:

    K_i = 1 - d² alpha_j alpha_k omega_i²,    q_i = alpha_j omega_k² - alpha_k omega_j²,    K_j - K_k = d² alpha_i q_i,
    R_i = K_j K_k - d⁴ q_j q_k.

The map of omega conserves K_i/K_j, m²/K_i and m·omega/K_i (Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011). The map
of omega and gamma also conserves modified forms of m·gamma and gamma²; K is the mean of the K_i:

    J = sum_i rho_i omega_i gamma_i/K³,
        rho_i = I_i K_j K_k + d² [(I_k K_j + I_j K_k) q_i/2
                                  + (I_i (K_j + K_k) - d² (I_j + I_k) q_i) (alpha_k q_k - alpha_j q_j)/4],
    G = (sum_i R_j R_k gamma_i²/K_i + d² K_1 K_2 K_3 S²)/K⁴,    S = sum_i (1 + d² q_i/K_i) omega_i gamma_i.

No difference of moments appears in a denominator and no two nearly equal terms are subtracted, so that J -> m·gamma and
G -> gamma² without loss of digits as h -> 0, also for bodies with two or three equal moments. The signs of the K_i
relative to each other and those of the R_i are conserved. If all K_i > 0 and all R_i have one sign, G is positive
definite in gamma and bounds its length. Otherwise it is indefinite.

Lagrange: gamma², m·gamma and E with corrections of size h² (``hk_corrections``). The rotor of the Lagrange gyrostat
acts like a change of C.
"""

from __future__ import annotations

import math
from typing import Any

from topcli.contracts import Floats, Integral, Invariant, Top, invariant_of, of_numpy

_LONGEST = 2.0**511
"""Steps from here on have squares that are no double."""
_AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
_PAIRS = ((1, 2), (2, 3), (3, 1))


def euler_hk_integrals(top: Top, h: float) -> tuple[Invariant, ...]:
    """Exact integrals of the HK map: five of omega and, if gamma is part of the state, two with gamma.

    m² and m·omega are divided by the mean of the three K_i. Instead of K_1/K_2 = 1 + (h/2)² alpha_3 q, the integral is
    q = (alpha_1 omega_2² - alpha_2 omega_1²)/K_2: it loses no digits for small h and tends to an integral of the motion
    as h -> 0.
    """
    square, p = ((0.5 * h) ** 2 if abs(h) < _LONGEST else math.inf), top.constants()
    moments, alpha = p[:3], p[3:]

    def parts(y: Floats) -> tuple[Any, Any, Any]:
        k = [1.0 - square * alpha[j] * alpha[n] * y[i] ** 2 for i, j, n in _AXES]
        return k, [alpha[j] * y[n] ** 2 - alpha[n] * y[j] ** 2 for _, j, n in _AXES], (k[0] + k[1] + k[2]) / 3.0

    # integrals of the map of omega
    def modified_m_sq(y: Floats, p: Floats) -> Any:
        """m² divided by the mean of K1, K2, K3."""
        return sum((m * w) ** 2 for m, w in zip(moments, y[:3], strict=True)) / parts(y)[2]

    def modified_m_omega(y: Floats, p: Floats) -> Any:
        """m·ω divided by the mean of K1, K2, K3."""
        return sum(m * w**2 for m, w in zip(moments, y[:3], strict=True)) / parts(y)[2]

    def ratio(i: int, j: int, n: int) -> Integral:
        def integral(y: Floats, p: Floats) -> Any:
            k, x, _ = parts(y)
            return x[n] / k[j]

        integral.__doc__ = f"(K{i + 1}/K{j + 1} - 1)/((h/2)² α{n + 1})"
        return integral

    # and two of the map of omega and gamma
    def modified_m_gamma(y: Floats, p: Floats) -> Any:
        """m·γ, modified so that the HK map conserves it."""
        k, x, mean = parts(y)
        total: Any = 0.0
        for i, j, n in _AXES:
            even = 0.5 * (moments[n] * k[j] + moments[j] * k[n]) * x[i]
            odd = moments[i] * (k[j] + k[n]) - square * (moments[j] + moments[n]) * x[i]
            rho = moments[i] * k[j] * k[n] + square * (even + 0.25 * odd * (alpha[n] * x[n] - alpha[j] * x[j]))
            total = total + rho * y[i] * y[3 + i]
        return total / mean**3

    def modified_gamma_sq(y: Floats, p: Floats) -> Any:
        """γ², modified so that the HK map conserves it."""
        k, x, mean = parts(y)
        R = [k[j] * k[n] - (square * x[j]) * (square * x[n]) for _, j, n in _AXES]
        along = sum((1.0 + square * x[i] / k[i]) * y[i] * y[3 + i] for i in range(3))
        squares = sum(R[j] * R[n] / k[i] * y[3 + i] ** 2 for i, j, n in _AXES)
        return (squares + square * k[0] * k[1] * k[2] * along**2) / mean**4

    # without gravity there are five; gamma adds two
    gamma, m, omega = r"\boldsymbol{\gamma}", r"\boldsymbol{m}", r"\boldsymbol{\omega}"
    integrals: list[tuple[str, Integral, str, str]] = [
        ("modified_m_sq", modified_m_sq, "m²/K", rf"{m}^2/K"),
        ("modified_m_omega", modified_m_omega, "m·ω/K", rf"{m}\cdot{omega}/K"),
        *((f"modified_k{i}{j}", ratio(i - 1, j - 1, 5 - i - j), f"κ{i}{j}", rf"\kappa_{{{i}{j}}}") for i, j in _PAIRS),
        ("modified_m_gamma", modified_m_gamma, "J", rf"J({m}\cdot{gamma})"),
        ("modified_gamma_sq", modified_gamma_sq, "G", rf"G({gamma}^2)"),
    ]
    count = 5 if len(top.components) == 3 else 7
    return tuple(invariant_of(name, integral, p, (symbol, tex)) for name, integral, symbol, tex in integrals[:count])


def hk_corrections(A: Any, nu: Any, k: Any, h: Any, y: Any) -> tuple[Any, Any, Any]:
    """Differences of the integrals of the HK map from gamma², m·gamma and E; ``y`` has the six components.

    omega1' = k omega2 + nu gamma2, omega2' = -k omega1 - nu gamma1, where k = (A - C) omega3/A, minus the momentum of a
    rotor over A, and nu = mu/A.

    They are of size h² and follow from the conserved quantities J = (v + K u + K + S)/y, c2 and c0 of Kimura and Hirota
    (2000), rearranged to avoid cancellation for small h or small mu. With d = h/2,
    W = k (omega1, omega2) + nu (gamma1, gamma2), q = nu gamma3 + k s and H = (omega1, omega2).W + (k + s) q,
    c2 + 1 = d^4 y (N + (d H/y)²)/R, N = |W|² + q².
    """
    d = h / 2
    w1, w2, s, g1, g2, Z = y
    K, S, n = d * k, d * s, d * d * nu
    U, V, G = w1 * w1 + w2 * w2, w1 * g1 + w2 * g2, g1 * g1 + g2 * g2
    wW, gW = k * U + nu * V, k * V + nu * G
    x = nu * Z
    q = x + k * s
    KS, dq = K * S, d * d * q
    Y = dq - 1
    H = wW + (k + s) * q
    N = k * wW + nu * gW + q * q
    z, u, v, r = n * Z, d * d * U, d * n * V, n * n * G
    R = (
        Y * r
        + 2 * v * (K * z + S * (1 + K * K))
        + u * ((K * K - 1) * z + (1 + K * K) * (1 + KS))
        + (z + 1 + KS) * (Y * Y + (K + S) ** 2)
    )
    eps = d**4 * Y * (N + (d * H / Y) ** 2) / R
    # linear coefficient of gamma1² + gamma2² as a polynomial in gamma3, in powers of d²
    a4 = gW + Z * (q - k * k)
    a6 = (
        (V + Z * s) * wW
        + (k * k - k * s - 2 * x) * gW
        + V * (k * x + s * q)
        + Z * (q * (s * s + k * k - q) - (k * k + k * s - q) ** 2)
    )
    a8 = (
        wW * (k * (nu * G + U * Z + (k - s) * V) + k * Z * (2 * (x - k * k) + k * s))
        + (x - k * k) * q * gW
        + k * U * Z * (k * x + s * q)
        + k * s * s * (k * k - q) * V
        + Z * q * q * (q - k * k)
    )
    a10 = -k * (N * (V * q + k * U * Z) + k * k * nu * s * (w1 * g2 - w2 * g1) ** 2)
    a1 = 2 * d * d * (a4 + d * d * (a6 + d * d * (a8 + d * d * a10))) / (Y * R)
    gamma_sq = Z * (Z * (K * K * (1 - eps) - eps) - a1)
    b1 = 2 * K * k * S + d * d * H / Y - 2 * k * (1 + KS) * eps
    m_gamma = -A * Z * (b1 + k * (1 - eps) * z)
    energy = A / 2 * (2 * x * (KS * (1 - eps) - eps) + (1 - eps) * (d * x) ** 2)
    return gamma_sq, m_gamma, energy


def lagrange_hk_integrals(top: Top, h: float) -> tuple[Invariant, ...]:
    """gamma², m·gamma and E with the corrections of the HK map, which conserves them exactly for this h."""
    parameters: Any = top
    A, C, mu, rotor, h = map(of_numpy, (parameters.A, parameters.C, parameters.mu, getattr(top, "k", 0.0), h))
    nu = mu / A

    def modified(index: int, plain: Invariant) -> Invariant:
        def integral(y: Floats, p: Floats) -> Any:
            return hk_corrections(A, nu, ((A - C) * y[2] - rotor) / A, h, y)[index]

        meaning = f"{plain.meaning}, modified so that the HK map conserves it"
        correction = invariant_of("", integral, ())
        return Invariant(
            f"modified_{plain.name}",
            f"{plain.symbol} mod",
            rf"\widetilde{{{plain.tex}}}",
            meaning,
            lambda y: plain.value(y) + correction.value(y),
            lambda y: plain.scale(y) + abs(correction.value(y)),
        )

    return tuple(modified(index, plain) for index, plain in enumerate(top.invariants()[:3]))
