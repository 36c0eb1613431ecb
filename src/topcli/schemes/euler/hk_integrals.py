"""Integrals of the Hirota-Kimura map of the Euler top, without and with the vertical gamma.

Notation: d = h/2, alpha_1 = (B - C)/A and cyclically, I = (A, B, C), and i, j, k cyclic,

    K_i = 1 - d² alpha_j alpha_k omega_i²,    q_i = alpha_j omega_k² - alpha_k omega_j²,    K_j - K_k = d² alpha_i q_i,
    R_i = K_j K_k - d⁴ q_j q_k.

The map of omega conserves K_i/K_j, m²/K_i and m·omega/K_i (Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011). The map
of omega and gamma also conserves modified forms of m·gamma and gamma²; K is the mean of the K_i:

    J = sum_i rho_i omega_i gamma_i/K³,
        rho_i = I_i K_j K_k + d² [(I_k K_j + I_j K_k) q_i/2
                                  + (I_i (K_j + K_k) - d² (I_j + I_k) q_i) (alpha_k q_k - alpha_j q_j)/4],
    G = (sum_i R_j R_k gamma_i²/K_i + d² K_1 K_2 K_3 S²)/K⁴,    S = sum_i (1 + d² q_i/K_i) omega_i gamma_i.

No difference of moments appears in a denominator and no two nearly equal terms are subtracted, so that J -> m·gamma and
G -> gamma² without loss of digits as h -> 0, also for bodies with two or three equal moments.
The signs of the K_i relative to each other and those of the R_i are conserved. If all K_i > 0 and all R_i have one
sign, G is positive definite in gamma and bounds its length. Otherwise it is indefinite.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from topcli.contracts import Array, Invariant
from topcli.tops.euler import Euler

LONGEST = 2.0**511
"""Steps from here on have squares that are no double."""


def hk_integrals(top: Euler, h: float, options: Any = None) -> tuple[Invariant, ...]:
    """Exact integrals of the HK map: five of omega and, if gamma is part of the state, two with gamma.

    m² and m·omega are divided by the mean of the three K_i. Instead of K_1/K_2 = 1 + (h/2)² alpha_3 q, the integral is
    q = (alpha_1 omega_2² - alpha_2 omega_1²)/K_2: it loses no digits for small h and tends to an integral of the motion
    as h -> 0.
    """
    m_sq, m_omega = top.invariants()[:2]
    of_omega = (
        _over_mean(top, h, m_sq, "m²"),
        _over_mean(top, h, m_omega, "m·ω"),
        _ratio(top, h, 0, 1),
        _ratio(top, h, 1, 2),
        _ratio(top, h, 2, 0),
    )
    return of_omega if len(top.components) == 3 else (*of_omega, *_gamma_integrals(top, h))


def _square(h: float) -> float:
    return (0.5 * h) ** 2 if abs(h) < LONGEST else math.inf


def _k(top: Euler, h: float, y: Array) -> Array:
    """K_1, K_2, K_3 of states (n, d), as an array (n, 3)."""
    alpha = np.array(top.constants()[3:])
    return 1.0 - _square(h) * np.roll(alpha, -1) * np.roll(alpha, -2) * y[:, :3] ** 2


def _over_mean(top: Euler, h: float, invariant: Invariant, subject: str) -> Invariant:
    def value(y: Array) -> Array:
        return invariant.value(y) / _k(top, h, y).mean(axis=1)

    def scale(y: Array) -> Array:
        return invariant.scale(y) / np.abs(_k(top, h, y)).mean(axis=1)

    meaning = f"{subject} over the mean of K1, K2, K3"
    return Invariant(f"modified_{invariant.name}", f"{invariant.symbol}/K", f"{invariant.tex}/K", meaning, value, scale)


def _ratio(top: Euler, h: float, i: int, j: int) -> Invariant:
    alpha = top.constants()[3:]

    def value(y: Array) -> Array:
        return (alpha[i] * y[:, j] ** 2 - alpha[j] * y[:, i] ** 2) / _k(top, h, y)[:, j]

    def scale(y: Array) -> Array:
        return (abs(alpha[i]) * y[:, j] ** 2 + abs(alpha[j]) * y[:, i] ** 2) / np.abs(_k(top, h, y)[:, j])

    a, b = i + 1, j + 1
    meaning = f"(K{a}/K{b} - 1)/((h/2)² α{6 - a - b})"
    return Invariant(f"modified_k{a}{b}", f"κ{a}{b}", rf"\kappa_{{{a}{b}}}", meaning, value, scale)


class _Parts(NamedTuple):
    """Parts of J and G at states (n, 6): the K_i and their mean, rho_i, R_i and the factors of omega_i gamma_i in S."""

    k: Array
    mean: Array
    rho: Array
    r: Array
    along: Array


def _parts(top: Euler, h: float, y: Array) -> _Parts:
    constants = np.array(top.constants())
    moments, alpha, square = constants[:3], constants[3:], _square(h)
    k = _k(top, h, y)
    squares = y[:, :3] ** 2
    alpha_j, alpha_k = np.roll(alpha, -1), np.roll(alpha, -2)
    q = alpha_j * _third(squares) - alpha_k * _second(squares)
    k_j, k_k, q_j, q_k = _second(k), _third(k), _second(q), _third(q)
    moment_j, moment_k = np.roll(moments, -1), np.roll(moments, -2)
    even = 0.5 * (moment_k * k_j + moment_j * k_k) * q
    odd = 0.25 * (moments * (k_j + k_k) - square * (moment_j + moment_k) * q) * (alpha_k * q_k - alpha_j * q_j)
    rho = moments * k_j * k_k + square * (even + odd)
    return _Parts(k, k.mean(axis=1), rho, k_j * k_k - (square * q_j) * (square * q_k), 1.0 + square * q / k)


def _second(values: Array) -> Array:
    """Columns j of ``values`` (n, 3), in the order of i."""
    return np.roll(values, -1, axis=1)


def _third(values: Array) -> Array:
    """Columns k of ``values`` (n, 3), in the order of i."""
    return np.roll(values, -2, axis=1)


def _gamma_integrals(top: Euler, h: float) -> tuple[Invariant, Invariant]:
    """J and G: modified m·gamma and gamma²."""

    def m_gamma(magnitude: Callable[[Array], Array]) -> Callable[[Array], Array]:
        def value(y: Array) -> Array:
            parts = _parts(top, h, y)
            return magnitude(parts.rho * y[:, :3] * y[:, 3:]).sum(axis=1) / magnitude(parts.mean**3)

        return value

    def gamma_sq(magnitude: Callable[[Array], Array]) -> Callable[[Array], Array]:
        def value(y: Array) -> Array:
            parts = _parts(top, h, y)
            diagonal = magnitude(_second(parts.r) * _third(parts.r) / parts.k * y[:, 3:] ** 2).sum(axis=1)
            along = magnitude(parts.along * y[:, :3] * y[:, 3:]).sum(axis=1)
            rank_one = magnitude(_square(h) * parts.k.prod(axis=1) * along**2)
            return (diagonal + rank_one) / parts.mean**4

        return value

    gamma, m = r"\boldsymbol{\gamma}", r"\boldsymbol{m}"
    return (
        Invariant(
            "modified_m_gamma", "J", rf"J({m}\cdot{gamma})", "m·γ of the HK map", m_gamma(np.positive), m_gamma(np.abs)
        ),
        Invariant(
            "modified_gamma_sq", "G", rf"G({gamma}^2)", "γ² of the HK map", gamma_sq(np.positive), gamma_sq(np.abs)
        ),
    )
