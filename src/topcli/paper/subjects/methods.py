"""Claims of section 3.2.2: three methods for gamma, and Bohlin's method for omega."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import I_UNIT, Draws, Gauss, dot, flat, minus, product
from topcli.paper.claim import Claim
from topcli.paper.kinds.conservation import CONSERVED, IRREVERSIBLE, conserved, irreversible
from topcli.paper.kinds.equation_order import EQUATION_ORDER, equation_order, trapezoidal
from topcli.paper.kinds.exchange import EXCHANGE, exchanged
from topcli.paper.kinds.identity import (
    IDENTITY,
    LINEAR,
    Difference,
    identity,
    linear_in_new,
    rotation_residual,
)
from topcli.paper.kinds.integrability import GENERIC
from topcli.paper.kinds.roots import ANGLES, BY_SIGN, FIGURE_2, ROOTS, both_roots, next_to_axis, wrong_roots
from topcli.paper.scenes import AND_VARIED, FIFTY, Scene

SECTION = "section 3.2.2"
LETTERS = "abc"


def _scene(letter: str) -> Scene:
    return Scene(f"kowalevski_bohlin_{letter}", (*FIFTY, "N=50", *GENERIC))


def method_b(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """Euler's rule for z as an equation for the new z."""
    h, w, c = draws.number(), draws.vector(), draws.unit()
    z = Gauss(c[0], c[1]) / (1 + c[2])
    return [Gauss(new[0], new[1]) - z - h * printed.stereographic_rate(Gauss(w[0], w[1]), w[2], z)]


def method_c(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """(C) as an equation for the new gamma; the angle h |omega| and its axis are those of the old omega."""
    n, (cosine, sine), c = draws.unit(), draws.circle(), draws.vector()
    return minus(new, [dot(row, c) for row in printed.rotation(n, cosine, sine)])


def bohlin_square(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """Bohlin's equation for the square of the new omega_1 + i omega_2, at the new gamma and omega_3."""
    c0, turn, w, c, e = draws.number(), Gauss(*draws.circle()), draws.vector(), draws.vector(), draws.vector()
    old = (*w, *c)
    at_zero = printed.bohlin(c0, turn, old, (0, 0, 0, *e))
    return [at_zero + Gauss(new[0], new[1])]


def euler_rule(draws: Draws) -> Sequence[Any]:
    """(direct) against omega + h d omega/dt with the printed rate."""
    c0, h, w, c = draws.number(), draws.number(), draws.vector(), draws.vector()
    omega = Gauss(w[0], w[1])
    return [printed.direct(c0, h, omega, w[2], c[2]) - omega - h * printed.complex_omega(c0, omega, w[2], c[2])[0]]


def stereographic(draws: Draws) -> Sequence[Any]:
    """The three formulas for gamma and the three for z, at a point of the sphere."""
    c = draws.unit()
    z = Gauss(c[0], c[1]) / (1 + c[2])
    size = (z * z.bar).re
    gamma = 2 * z / (1 + size)
    return [
        gamma - Gauss(c[0], c[1]),
        gamma.bar - 2 * z.bar / (1 + size),
        (1 - size) / (1 + size) - c[2],
        size - (1 - c[2]) / (1 + c[2]),
        (gamma * gamma.bar).re + ((1 - size) / (1 + size)) * ((1 - size) / (1 + size)) - 1,
    ]


def stereographic_rate(draws: Draws) -> Sequence[Any]:
    """The equation for z against the rate of (gamma_1 + i gamma_2)/(1 + gamma_3) along (K2)."""
    w, c = draws.vector(), draws.unit()
    rate = printed.poisson(w, c)
    z = Gauss(c[0], c[1]) / (1 + c[2])
    expected = Gauss(rate[0], rate[1]) / (1 + c[2]) - z * rate[2] / (1 + c[2])
    found = printed.stereographic_rate(Gauss(w[0], w[1]), w[2], z)
    conjugate = -I_UNIT / 2 * (Gauss(w[0], -w[1]) - 2 * w[2] * z.bar - Gauss(w[0], w[1]) * z.bar * z.bar)
    return [found - expected, conjugate - expected.bar]


def rotation(draws: Draws) -> Sequence[Any]:
    """R is orthogonal, leaves its axis, and R - 1 is odd in s as for a rotation."""
    n, (c, s) = draws.unit(), draws.circle()
    R = printed.rotation(n, c, s)
    transposed = tuple(zip(*R, strict=True))
    one = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    turned = [dot(row, n) for row in R]
    trace = R[0][0] + R[1][1] + R[2][2]
    return [*minus(flat(product(R, transposed)), flat(one)), *minus(turned, n), trace - (1 + 2 * c)]


def rotation_generator(draws: Draws) -> Sequence[Any]:
    """dR/dtheta R^{-1} against the matrix of gamma -> gamma x n, the equation (K2) for constant omega."""
    n, (c, s) = draws.unit(), draws.circle()
    # R is affine in (c, s), whose derivatives are (-s, c)
    fixed = printed.rotation(n, 0, 0)
    slope = tuple(minus(a, b) for a, b in zip(printed.rotation(n, -s, c), fixed, strict=True))
    return minus(flat(slope), flat(product(printed.hat(n), printed.rotation(n, c, s))))


def kepler(draws: Draws) -> Sequence[Any]:
    """Hooke's motion w'' = -w as z = w² in the time tau, dtau = |w|² dt, against Kepler's d²z/dtau² = -4 E z/|z|³."""
    w, rate = Gauss(*draws.vector()[:2]), Gauss(*draws.vector()[:2])
    square = (w * w.bar).re
    energy = ((rate * rate.bar).re + square) / 2
    # dz/dtau = 2 w'/conj(w), differentiated once more with w'' = -w
    second = (-2 * w / w.bar - 2 * rate * rate.bar / (w.bar * w.bar)) / square
    return [second - -4 * energy * w * w / (square * square * square)]


def _conserves(letter: str, invariant: str, symbol: str, where: str) -> Claim:
    scene = _scene(letter)
    return Claim(
        f"bohlin-{letter}-{invariant.replace('_', '-')}",
        f"Bohlin's method with ({letter.upper()}) keeps {symbol} exactly.",
        f"{SECTION}, {where}",
        CONSERVED,
        scene.code + AND_VARIED,
        partial(conserved, scene, invariant),
    )


def _breaks(letter: str) -> Claim:
    scene = _scene(letter)
    return Claim(
        f"bohlin-{letter}-irreversible",
        f"Method ({letter.upper()}) breaks time reversal symmetry.",
        f"{SECTION}, end of (1)",
        IRREVERSIBLE,
        scene.code,
        partial(irreversible, scene),
    )


def _formula(name: str, statement: str, where: str, difference: Difference) -> Claim:
    return Claim(name, statement, f"{SECTION}, {where}", IDENTITY, "rational identity", partial(identity, difference))


CLAIMS = (
    Claim(
        "method-a-explicit",
        "(A) is explicit.",
        f"{SECTION}, (A)",
        LINEAR,
        "rational test of the printed equation",
        partial(linear_in_new, rotation_residual, 3),
    ),
    Claim(
        "method-b-explicit",
        "(B) with Euler's rule is explicit.",
        f"{SECTION}, title and (B)",
        LINEAR,
        "rational test of z' = z + h (i/2)(ω - 2ω₃z - ω*z²)",
        partial(linear_in_new, method_b, 2),
    ),
    Claim(
        "method-c-explicit",
        "(C) is explicit.",
        f"{SECTION}, title and (C)",
        LINEAR,
        "rational test of the printed equation",
        partial(linear_in_new, method_c, 3),
    ),
    Claim(
        "bohlin-explicit",
        "Bohlin's equation has a known right-hand side: it is explicit up to a square root.",
        f"{SECTION}, title and (2)",
        LINEAR,
        "rational test of the printed equation, for the unknown (ω₁' + iω₂')²",
        partial(linear_in_new, bohlin_square, 2),
    ),
    _formula("stereographic", "The formulas of (B) map z to the sphere and back.", "(B)", stereographic),
    _formula("stereographic-rate", "In z, (K2) is dz/dt = (i/2)(ω - 2ω₃z - ω*z²).", "(B)", stereographic_rate),
    _formula("bohlin-kepler", "w² = z relates Hooke's motion with Kepler's.", "Bohlin's method", kepler),
    _formula("rotation", "R of (C) is a rotation about ω.", "(C)", rotation),
    _formula("rotation-flow", "R turns γ as (K2) does for constant ω.", "(C)", rotation_generator),
    *(_conserves(letter, "gamma_sq", "γ²", f"({letter.upper()})") for letter in LETTERS),
    *(_conserves(letter, "k_sq", "k²", "(2)") for letter in LETTERS),
    *(_breaks(letter) for letter in LETTERS),
    Claim(
        "bohlin-reversible",
        "Bohlin's method for ω has time reversal symmetry.",
        f"{SECTION}, end of (2)",
        EXCHANGE,
        f"{_scene('a').with_sets('N=1').code}, states exchanged and h reversed in the printed equation{AND_VARIED}",
        partial(exchanged, _scene("a").with_sets("N=1"), "bohlin"),
    ),
    Claim(
        "trapezoidal",
        "(Kxi) can be integrated for small h by the trapezoidal rule (to second order).",
        f"{SECTION}, (2)",
        EQUATION_ORDER,
        "the equation for ξ along the reference from a generic state, at h = 0.02, 0.01, 0.005",
        partial(equation_order, trapezoidal, 2),
    ),
    Claim(
        "bohlin-angle",
        "Both solutions of w² = z have angles φ = Φ/2 mod 2π.",
        f"{SECTION}, solution of w² = z",
        ANGLES,
        "both roots of 50 random z, Φ by atan2; corrected to mod π",
        partial(both_roots, 0.5, 2.0 * math.pi, math.pi),
    ),
    _formula("direct", "(direct) is Euler's rule for the equation of ω.", "(direct)", euler_rule),
    Claim(
        "branch-by-sign-fig2",
        "The sign of the argument chooses the right root (in the run of Figure 2).",
        f"{SECTION}, after (direct)",
        ROOTS,
        "`kowalevski_bohlin_a` with `branch: sign`",
        partial(wrong_roots, FIGURE_2),
        slow=True,
    ),
    Claim(
        "branch-by-sign",
        "The sign of the argument is sufficient to choose the root (for any orbit).",
        f"{SECTION}, after (direct)",
        ROOTS,
        "200 random orbits of `kowalevski_bohlin_a` at E = 5 with `branch: sign`, h = 0.05, N = 2000",
        partial(wrong_roots, BY_SIGN, next_to_axis(0.001)),
        slow=True,
    ),
)
