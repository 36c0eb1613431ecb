"""Bohlin's method for the Kowalevski top, with gamma by Method A, B or C (Sogo, section 3.2.2).

Performance:
- omega1 and omega2 come last, from a square root; all terms in the old gamma and omega3 are computed before;
- the angle follows directly from gamma', without omega3'; small angles need polynomials with fused sums, not libm;
- the square root is algebraic; its division and the choice of its sign overlap with the square root instruction.

Source
------
Sogo, Discrete Spinning Tops, section 3.2.2

Limits
------
homoclinic-spacing
    The motion of this case is close to the homoclinic orbit. The error of a method of order 1 acts like a
    larger distance from this orbit and shortens the time between two swings (falls and rises) of the top. In
    the paper's Figure 2 this time is 15.3 instead of 28.17.
rest-on-axis, delone-sleeping
    If gamma lies along the third axis and the body rests or rotates about this axis, then xi = 0. Such a state
    is a fixed point of the map: the state never changes.
huge
    |xi|² grows as |omega|⁴ and overflows if |omega| exceeds about 1e77. Choose a unit of time in which omega
    has a moderate size.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from topcli.arithmetic.fused import fma
from topcli.arithmetic.vectors import (
    Complex,
    Vector,
    add_rotation_increment,
    cayley_rotated,
    rodrigues_increment,
    root_nearest,
    root_sign,
)
from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.schemes.registry import scheme

Root = Callable[[float, float, float, float], Complex]
_Method = Callable[[float, float, float, float, float, float, float], Vector]
ROOTS: dict[str, Root] = {"nearest": root_nearest, "sign": root_sign}


class BranchOptions(BaseModel):
    """Choice between the two square roots for omega1 + i omega2."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    branch: Literal["nearest", "sign"] = Field(
        default="nearest",
        description="choice between the two square roots that omega1 + i omega2 can be: the one nearest to a "
        "prediction of omega1 + i omega2 (nearest), or by the sign of its argument (angle), as in the paper (sign)",
    )


def method_a(w1: float, w2: float, w3: float, g1: float, g2: float, g3: float, h: float) -> Vector:
    """New gamma by Method A, the BS scheme: gamma' - gamma = h/2 (gamma' + gamma) x omega."""
    d = 0.5 * h
    return cayley_rotated(d * w1, d * w2, d * w3, g1, g2, g3)


def method_b(w1: float, w2: float, w3: float, g1: float, g2: float, g3: float, h: float) -> Vector:
    """New gamma by Method B, Euler's rule for z = (gamma1 + i gamma2)/(1 + gamma3), which is infinite at gamma3 = -1.

    Terms in gamma and omega3 are computed first, because omega1 and omega2, from a square root, are available last.
    """
    r = 1.0 / (1.0 + g3)
    x, y = g1 * r, g2 * r
    d = 0.5 * h
    xx = x * x - y * y
    xy = d * (2.0 * x * y)
    turn = h * w3
    x, y = (
        fma(-w2, fma(d, xx, d), fma(w1, xy, fma(turn, y, x))),
        fma(w1, fma(-d, xx, d), fma(-w2, xy, fma(-turn, x, y))),
    )
    n = 2.0 / (fma(x, x, 1.0) + y * y)
    return (x * n, y * n, 0.5 * n * (1.0 - fma(x, x, y * y)))


def method_c(w1: float, w2: float, w3: float, g1: float, g2: float, g3: float, h: float) -> Vector:
    """New gamma by Method C, the rotation by the angle h |omega| about omega; the identity for omega = 0."""
    d1, d2, d3 = rodrigues_increment(h * w1, h * w2, h * w3, g1, g2, g3)
    return (g1 + d1, g2 + d2, g3 + d3)


def bohlin_step(method: _Method, root: Root) -> StepFunction:
    """Return the step: gamma by ``method``, then omega3, then omega1 + i omega2 by ``root`` (section 3.2.2)."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        w1, w2, w3, g1, g2, g3 = s
        half = 0.5 * p[0]
        f = h * half
        n1, n2, n3 = method(w1, w2, w3, g1, g2, g3, h)
        # half of xi
        x = 0.5 * ((w1 - w2) * (w1 + w2)) - half * g1
        y = w1 * w2 - half * g2
        chi = fma(-(0.5 * h * f), n2, fma(-(0.5 * h * f), g2, h * w3))  # h/2 (v3 + w3), independent of v3
        z1, z2 = add_rotation_increment(chi, x, y, fma(half, n1, x), fma(half, n2, y))
        q1, q2 = direct(s, h, p)
        v1, v2 = root(z1, z2, q1, q2)
        return (v1, v2, fma(-f, n2 + g2, w3), n1, n2, n3)

    return step


def direct(s: Floats, h: float, p: Floats) -> Complex:
    """Prediction of omega1, omega2 by Euler's rule, which selects the root (direct)."""
    d = 0.5 * h
    return (s[0] + d * (s[2] * s[1]), s[1] - d * (s[2] * s[0] - p[0] * s[5]))


bohlin = partial(
    scheme,
    top="kowalevski",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
    options=BranchOptions,
)


@bohlin("bohlin-a")
def build_a(top: Top, options: BranchOptions) -> Stepper:
    r"""Bohlin's method with gamma advanced by the Bobenko-Suris scheme.

    The scheme rotates gamma by a Cayley transform of the old omega, and computes the new omega by a rotation of xi.

    The old omega is omega before the step. The Cayley transform is that of the Bobenko-Suris scheme (`bs`). The new
    omega3 follows by the trapezoidal rule. The variable xi = (omega1 + i omega2)² - c (gamma1 + i gamma2) rotates by
    the angle -chi with chi = h/2 (omega3' + omega3); a prime marks a value after the step. The new omega1 + i omega2 is
    a square root of e^{-i chi} xi + c (gamma1' + i gamma2'). The scheme conserves |gamma| and k = |xi|. The order of
    the scheme is reduced where omega1 + i omega2 passes through 0, because the square root is singular there.

    If the body rests with gamma along the third axis, then xi = 0. This state is a fixed point of all three schemes of
    Bohlin's method (`bohlin-a`, `bohlin-b` and `bohlin-c`), although a real top would start to fall.

    Equations
    ---------
    (A), (Kxi) and (direct) of the paper

    Formula
    -------
    \gamma' - \gamma = h\,\bar\gamma\times\omega

    \omega_3' - \omega_3 = -h c\,\bar\gamma_2, \qquad
    (\omega_1' + i\omega_2')^2 = e^{-ih\bar\omega_3}\,\xi + c\,(\gamma_1' + i\gamma_2'), \qquad
    \xi = (\omega_1 + i\omega_2)^2 - c\,(\gamma_1 + i\gamma_2)
    """
    return Stepper(bohlin_step(method_a, ROOTS[options.branch]), 6)


@bohlin("bohlin-b")
def build_b(top: Top, options: BranchOptions) -> Stepper:
    r"""Bohlin's method with gamma advanced in a stereographic coordinate.

    The scheme advances a stereographic coordinate z of gamma by Euler's rule, and computes omega as in `bohlin-a`.

    The coordinate z = (gamma1 + i gamma2)/(1 + gamma3) is infinite at gamma3 = -1: where gamma comes close to that
    direction, the error of a step is large, and the run ends as `blew_up` if gamma is rounded to it.

    Equations
    ---------
    (B), (Kxi) and (direct) of the paper

    Formula
    -------
    z' - z = \tfrac{ih}{2}\,\bigl((\omega_1 + i\omega_2) - 2\omega_3 z - (\omega_1 - i\omega_2)\,z^2\bigr), \qquad
    z = \frac{\gamma_1 + i\gamma_2}{1 + \gamma_3}

    \omega_3' - \omega_3 = -h c\,\bar\gamma_2, \qquad
    (\omega_1' + i\omega_2')^2 = e^{-ih\bar\omega_3}\,\xi + c\,(\gamma_1' + i\gamma_2'), \qquad
    \xi = (\omega_1 + i\omega_2)^2 - c\,(\gamma_1 + i\gamma_2)

    Limits
    ------
    pole, there-and-back
        The coordinate z of gamma is infinite at gamma3 = -1. Where gamma comes close to this direction, Euler's rule
        for z has a large error, and the new gamma may be rounded to (0, 0, -1): the run then ends as `blew_up`.
    resonance, singular-step
        If the body turns by a radian or more in a step, Euler's rule squares a large z, the coordinate of gamma, in
        each step, until gamma is rounded to (0, 0, -1), where z is infinite: the run ends as `blew_up`.
    """
    return Stepper(bohlin_step(method_b, ROOTS[options.branch]), 6)


@bohlin("bohlin-c")
def build_c(top: Top, options: BranchOptions) -> Stepper:
    r"""Bohlin's method with gamma advanced by an instantaneous rotation.

    The scheme rotates gamma about the old omega by the angle h |omega|, and computes omega as in `bohlin-a`.

    The old omega is omega before the step. Rodrigues' formula gives the rotated gamma without a division by |omega|, so
    omega = 0 is a regular point.

    Equations
    ---------
    (C), (Kxi) and (direct) of the paper

    Formula
    -------
    \gamma' = e^{-h\hat\omega}\,\gamma, \qquad \hat\omega v = \omega\times v

    \omega_3' - \omega_3 = -h c\,\bar\gamma_2, \qquad
    (\omega_1' + i\omega_2')^2 = e^{-ih\bar\omega_3}\,\xi + c\,(\gamma_1' + i\gamma_2'), \qquad
    \xi = (\omega_1 + i\omega_2)^2 - c\,(\gamma_1 + i\gamma_2)

    Limits
    ------
    long runs
        The scheme does not conserve the energy. In this case, with h = 0.1, the energy rises from 2.1 to more than 200
        within t = 6500, and the run ends as `left_motion`; gamma² and k² stay constant.
    """
    return Stepper(bohlin_step(method_c, ROOTS[options.branch]), 6)
