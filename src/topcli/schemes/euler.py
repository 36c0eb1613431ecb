"""Schemes of the Euler top (Sogo, section 1.2), without and with the vertical gamma.

Every step adds increments to the state; gamma, where it is carried, never acts back on omega.

What makes them fast:
- HK and ``bs`` are closed forms with one division, HK's with the fewest operations before it; gamma's starts beside it;
- the implicit ones are Newton's method on three unknowns from HK's step, each correction a closed form;
- everything is an increment, small numbers added to large ones once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from topcli.contracts import Array, Floats, Invariant, Stepper, Top
from topcli.kernels.euler import (
    Vector,
    bs_increment,
    hk_gamma_increment,
    hk_gamma_step,
    hk_increment,
    hk_step,
    implicit_increment,
    midpoint_half,
)
from topcli.kernels.hk_determinant import euler_determinant
from topcli.kernels.increments import Change, first3, first6
from topcli.kernels.so3 import cayley_increment
from topcli.schemes.compensated import CompensatedOption, compensation_wanted, increment_stepper
from topcli.schemes.counting import NEAR_SINGULAR, counting, small_determinant
from topcli.schemes.limits import NEWTON_SINGULAR, NO_SOLUTION, SINGULAR
from topcli.schemes.registry import scheme
from topcli.tops.euler import Euler

FORMS = ("euler", "euler+gamma")
CITATION = "Sogo, Discrete Spinning Tops, section 1.2"
GAMMA_GROWS = (
    "omega stays bounded, as the modified integrals have it, but gamma's linear map has nothing that holds its "
    "length: with steps of about a turn it grows without bound."
)

LONGEST = 2.0**511
"""Steps from here on have squares that are no double."""

OmegaChange = Callable[[float, float, float, float, Floats], Vector]
"""``change(w1, w2, w3, d, p)``: omega' - omega for d = h/2."""
Axis = Callable[[Vector, Vector], Vector]
"""``axis(omega, change)``: the angular velocity that Cayley's rotation turns gamma by."""


def hk_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """HK: every product y z becomes (y' z + y z')/2."""
    return hk_increment(w1, w2, w3, d * p[3], d * p[4], d * p[5])


def bs_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """m' - m = d (m' + m) x omega."""
    return bs_increment(w1, w2, w3, p[0], p[1], p[2], d, d * p[3], d * p[4], d * p[5])


def implicit_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """m' - m = d (m' + m) x omega', solved from HK's change."""
    c1 = d * p[3]
    c2 = d * p[4]
    c3 = d * p[5]
    q = (c1, c2, c3, d / p[0], d / p[1], d / p[2], p[0] * w1, p[1] * w2, p[2] * w3)
    return implicit_increment((w1, w2, w3), q, hk_increment(w1, w2, w3, c1, c2, c3))


def midpoint_change(w1: float, w2: float, w3: float, d: float, p: Floats) -> Vector:
    """omega' - omega = h f((omega' + omega)/2), solved from HK's change.

    At the end the change is computed afresh from the equation: what the iteration leaves is always of the same sign,
    and would drift by 4e-20 a step.
    """
    c1 = d * p[3]
    c2 = d * p[4]
    c3 = d * p[5]
    s1, s2, s3 = hk_increment(w1, w2, w3, c1, c2, c3)
    z1, z2, z3 = midpoint_half((w1, w2, w3), (c1, c2, c3), (0.5 * s1, 0.5 * s2, 0.5 * s3))
    y1, y2, y3 = w1 + z1, w2 + z2, w3 + z3
    return (2.0 * (c1 * (y2 * y3)), 2.0 * (c2 * (y3 * y1)), 2.0 * (c3 * (y1 * y2)))


def old(w: Vector, x: Vector) -> Vector:
    """Omega before the step."""
    return w


def new(w: Vector, x: Vector) -> Vector:
    """Omega after the step."""
    return (w[0] + x[0], w[1] + x[1], w[2] + x[2])


def mean(w: Vector, x: Vector) -> Vector:
    """The mean of omega before and after the step."""
    return (w[0] + 0.5 * x[0], w[1] + 0.5 * x[1], w[2] + 0.5 * x[2])


def omega_change(change: OmegaChange) -> Change:
    """The change of omega alone in a step."""

    def changed(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3 = s
        return change(w1, w2, w3, 0.5 * h, p)

    return changed


def rotating_change(change: OmegaChange, axis: Axis) -> Change:
    """The change of omega and of gamma, which Cayley's rotation turns about ``axis``."""

    def changed(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        d = 0.5 * h
        x1, x2, x3 = change(w1, w2, w3, d, p)
        a1, a2, a3 = axis((w1, w2, w3), (x1, x2, x3))
        y1, y2, y3 = cayley_increment(d * a1, d * a2, d * a3, g1, g2, g3)
        return (x1, x2, x3, y1, y2, y3)

    return changed


def hk_gamma_change(s: Floats, h: float, p: Floats) -> Floats:
    """The change of omega and gamma in an HK step."""
    w1, w2, w3, g1, g2, g3 = s
    d = 0.5 * h
    x1, x2, x3 = hk_change(w1, w2, w3, d, p)
    y1, y2, y3 = hk_gamma_increment(d * w1, d * w2, d * w3, d * x1, d * x2, d * x3, g1, g2, g3)
    return (x1, x2, x3, y1, y2, y3)


def _stepper(top: Top, change: OmegaChange, axis: Axis, options: CompensatedOption) -> Stepper:
    if len(top.components) == 3:
        return increment_stepper(omega_change(change), 3, options)
    return increment_stepper(rotating_change(change, axis), 6, options)


def _iterative(stepper: Stepper, d: int) -> Stepper:
    """``stepper`` with a status behind its state: nan where Newton's method, which then gives nan, did not converge."""
    step, inner_enter = stepper.step, stepper.enter

    def stepped(s: Floats, h: float, p: Floats) -> Floats:
        new = step(s[:-1], h, p)
        status = math.nan if math.isnan(new[0]) else 0.0
        return (*new, status)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*(inner_enter(y, h, p) if inner_enter else y), 0.0)

    return replace(
        stepper,
        step=stepped,
        width=stepper.width + 1,
        enter=enter,
        leave=first3 if d == 3 else first6,
        iterative=True,
    )


def hk_integrals(top: Euler, h: float, options: CompensatedOption) -> tuple[Invariant, ...]:
    """The exact integrals of the HK map (Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011).

    With K_i = 1 - (h/2)² alpha_j alpha_k omega_i², m²/K_i, m·omega/K_i and K_i/K_j are conserved. m² and m·omega are
    divided by the mean K of the three. K_1/K_2 = 1 + (h/2)² alpha_3 q with
    q = (alpha_1 omega_2² - alpha_2 omega_1²)/K_2, and it is q that is given: it keeps its digits however small h is,
    and becomes an integral of the motion as h -> 0.
    """
    alpha = np.array(top.constants()[3:])
    square = (0.5 * h) ** 2 if abs(h) < LONGEST else math.inf
    pairs = square * np.roll(alpha, -1) * np.roll(alpha, -2)

    def k(y: Array) -> Array:
        return 1.0 - pairs * y[:, :3] ** 2

    def over_mean(invariant: Invariant, subject: str) -> Invariant:
        def value(y: Array) -> Array:
            return invariant.value(y) / k(y).mean(axis=1)

        def scale(y: Array) -> Array:
            return invariant.scale(y) / np.abs(k(y)).mean(axis=1)

        meaning = f"{subject} over the mean of K1, K2, K3"
        return Invariant(
            f"modified_{invariant.name}", f"{invariant.symbol}/K", f"{invariant.tex}/K", meaning, value, scale
        )

    def ratio(i: int, j: int) -> Invariant:
        def value(y: Array) -> Array:
            return (alpha[i] * y[:, j] ** 2 - alpha[j] * y[:, i] ** 2) / k(y)[:, j]

        def scale(y: Array) -> Array:
            return (np.abs(alpha[i]) * y[:, j] ** 2 + np.abs(alpha[j]) * y[:, i] ** 2) / np.abs(k(y)[:, j])

        a, b = i + 1, j + 1
        meaning = f"(K{a}/K{b} - 1)/((h/2)² α{6 - a - b})"
        return Invariant(f"modified_k{a}{b}", f"κ{a}{b}", rf"\kappa_{{{a}{b}}}", meaning, value, scale)

    m_sq, m_omega = top.invariants()[:2]
    return (
        over_mean(m_sq, "m²"),
        over_mean(m_omega, "m·ω"),
        ratio(0, 1),
        ratio(1, 2),
        ratio(2, 0),
    )


@scheme(
    "hk",
    top=FORMS,
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    modified=hk_integrals,
    citation="Hirota, Kimura 2000; " + CITATION,
    equations="the first difference equations of section 1.2; gamma as in dEulerPoisson, last term corrected",
    options=CompensatedOption,
    limits=lambda top: {"singular-step": SINGULAR} | ({} if len(top.components) == 3 else {"resonance": GAMMA_GROWS}),
)
def build_hk(top: Top, options: CompensatedOption) -> Stepper:
    """Every product of two components y z becomes (y' z + y z')/2: linear in the new state, solved in closed form.

    m² and m·omega are not conserved, but m²/K and m·omega/K are, with K = 1 + O(h²): their errors are of size h² and
    return to zero. With gamma carried, gamma² and m·gamma are conserved no better.
    """
    d = len(top.components)
    if compensation_wanted(options):
        made = increment_stepper(omega_change(hk_change) if d == 3 else hk_gamma_change, d, options)
    else:
        made = Stepper(hk_step if d == 3 else hk_gamma_step, d)
    return counting(made, NEAR_SINGULAR, small_determinant(euler_determinant), branch=True)


def _rotation_invariants(top: Top) -> tuple[str, ...]:
    return ("m_sq",) if len(top.components) == 3 else ("m_sq", "gamma_sq", "m_gamma")


@scheme(
    "bs",
    top=FORMS,
    title="BS scheme with the old omega",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=_rotation_invariants,
    citation=CITATION + ", after Bobenko, Suris 1999",
    equations="EulerBS; gamma by (A)",
    options=CompensatedOption,
)
def build_bs(top: Top, options: CompensatedOption) -> Stepper:
    """m turns by Cayley's rotation with the old omega, and so does gamma: m², gamma² and m·gamma are conserved.

    m·omega is not: it grows until the top turns about the axis of its smallest moment.
    """
    return _stepper(top, bs_change, old, options)


@scheme(
    "bs-implicit",
    top=FORMS,
    title="BS scheme with the new omega",
    order=1,
    explicit=False,
    self_adjoint=False,
    conserves=_rotation_invariants,
    citation=CITATION + ", after Bobenko, Suris 1999",
    equations="EulerBS with omega^{n+1}; gamma by (A) with omega^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": NEWTON_SINGULAR},
)
def build_bs_implicit(top: Top, options: CompensatedOption) -> Stepper:
    """The inverse of ``bs`` with -h: m and gamma turn by Cayley's rotation with the new omega.

    Newton's method with halved corrections as a safeguard finds omega to round-off. m², gamma² and m·gamma are
    conserved; m·omega falls until the top turns about the axis of its largest moment. A step that does not settle ends
    the run as `no_convergence`.
    """
    return _iterative(_stepper(top, implicit_change, new, options), len(top.components))


@scheme(
    "midpoint",
    top=FORMS,
    title="Implicit midpoint rule",
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=lambda top: tuple(invariant.name for invariant in top.invariants()),
    citation=CITATION,
    equations="the last difference equations of section 1.2; gamma by the modified BS scheme of section 3.2.3",
    options=CompensatedOption,
    limits={"resonance": NO_SOLUTION, "singular-step": NEWTON_SINGULAR},
)
def build_midpoint(top: Top, options: CompensatedOption) -> Stepper:
    """m and gamma turn by Cayley's rotation with the mean omega: all integrals are conserved.

    Newton's method on three unknowns starts from HK's step, which misses by O(h³); two or three corrections reach
    round-off. A step that does not settle ends the run as `no_convergence`.
    """
    return _iterative(_stepper(top, midpoint_change, mean, options), len(top.components))
