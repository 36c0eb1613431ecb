"""The general Euler-Poisson equations from the paper's lines: vectors, general solvers, and nothing fast."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from topcli.schemes.any_top.hk_midpoint import hk_heavy_change
from topcli.schemes.layout import summed
from topcli.tops.heavy import Heavy
from twins import solve

Vector = Sequence[Any]
hk_heavy = summed(hk_heavy_change, 6)
"""The packaged HK step on (omega, gamma), without its counter."""


def cross(a: Vector, b: Vector) -> list[Any]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def d_euler_poisson(old: Vector, new: Vector, h: Any, p: Vector) -> list[Any]:
    """Left minus right side of the paper's dEulerPoisson (corrected) in vector form: the products are polarized.

    m' - m = h/2 (m' x omega + m x omega') + h/2 (gamma' + gamma) x g,
    gamma' - gamma = h/2 (gamma' x omega + gamma x omega').
    """
    w, g, W, G = old[:3], old[3:], new[:3], new[3:]
    m = [a * b for a, b in zip(p[:3], w, strict=True)]
    M = [a * b for a, b in zip(p[:3], W, strict=True)]
    both = [a + b for a, b in zip(g, G, strict=True)]
    sides = zip(M, m, cross(M, w), cross(m, W), cross(both, p[3:]), strict=True)
    first = [a - b - h / 2 * (c + d + e) for a, b, c, d, e in sides]
    second = [a - b - h / 2 * (c + d) for a, b, c, d in zip(G, g, cross(G, w), cross(g, W), strict=True)]
    return first + second


def midpoint_defect(old: Vector, new: Vector, h: Any, p: Vector) -> list[Any]:
    """Left minus right side of the implicit midpoint rule for the same equations."""
    mean = [(a + b) / 2 for a, b in zip(old, new, strict=True)]
    w, g = mean[:3], mean[3:]
    m = [a * b for a, b in zip(p[:3], w, strict=True)]
    torque = [a + b for a, b in zip(cross(m, w), cross(g, p[3:]), strict=True)]
    first = [i * (b - a) - h * t for i, a, b, t in zip(p[:3], old[:3], new[:3], torque, strict=True)]
    return first + [b - a - h * t for a, b, t in zip(old[3:], new[3:], cross(g, w), strict=True)]


def hk_general(state: Vector, h: Any, p: Vector, equations: Callable[..., list[Any]] = d_euler_poisson) -> list[Any]:
    """The HK step by a general solver of the 6x6 system, read off ``equations`` column by column."""
    zero = state[0] * 0
    constant = equations(state, [zero] * 6, h, p)
    columns = []
    for i in range(6):
        unit = [zero + (1 if j == i else 0) for j in range(6)]
        columns.append([a - b for a, b in zip(equations(state, unit, h, p), constant, strict=True)])
    return solve(list(zip(*columns, strict=True)), [-b for b in constant])


def random_heavy_tops(count: int, seed: int) -> list[Heavy]:
    """Heavy tops of real bodies: moments that are sums of pairs of positive numbers, any centre of gravity."""
    random = np.random.default_rng(seed)
    made = []
    for a, b, c in random.uniform(0.2, 1.5, size=(count, 3)):
        x, y, z = random.normal(size=3)
        made.append(Heavy(A=b + c, B=c + a, C=a + b, x0=x, y0=y, z0=z))
    return made
