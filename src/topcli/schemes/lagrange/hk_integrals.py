"""Integrals of the HK map of the Lagrange top, and of the Lagrange gyrostat, whose rotor acts like a change of C."""

from __future__ import annotations

from typing import Any

from topcli.contracts import Floats, Invariant, Top, invariant_of, of_numpy


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
