"""Iterates of the HK map of the Euler top in closed form, by elliptic functions like the motion (``exact``)."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.multiprecision import digits, mp, real
from topcli.contracts import Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.euler.exact import Elliptic, axes_of
from topcli.schemes.euler.hk_integrals import euler_hk_integrals
from topcli.schemes.registry import scheme


@lru_cache(maxsize=64)
@digits()
def hk_motion(y0: Floats, h: float, p: Floats) -> Elliptic | None:
    """Iterates from ``y0`` (3,), with u per step; None if omega is constant.

    With K_i = 1 - d² alpha_j alpha_k omega_i² and d = h/2, u advances by 2 v per step, where cn² v = K_S/K_D and
    dn² v = K_S/K_C. The formulas of the amplitudes avoid differences of the K_i. Raises RunError for steps so long
    that K_S <= 0, where v is not real.
    """
    w, moments, alpha = ([Fraction(v) for v in values] for values in (y0, p[:3], p[3:6]))
    axes = axes_of(w, moments, alpha)
    if axes is None:
        return None
    D, S, C = axes
    d2 = (Fraction(h) / 2) ** 2
    KD = 1 - d2 * alpha[S] * alpha[C] * w[D] ** 2
    KS = 1 - d2 * alpha[C] * alpha[D] * w[S] ** 2
    KC = 1 - d2 * alpha[D] * alpha[S] * w[C] ** 2
    if KS <= 0:
        longest = float(2 / (mp.sqrt(real(alpha[C] * alpha[D])) * abs(real(w[S]))))
        raise RunError(
            f"hk-exact: h = {h:g} is too large for the closed form: its phase is not real for this initial state; "
            f"use |h| < {longest:.3g}"
        )
    bend = alpha[S] * w[D] ** 2 - alpha[D] * w[S] ** 2
    m1 = real(KS * alpha[S] * (alpha[C] * w[D] ** 2 - alpha[D] * w[C] ** 2) / (KC * alpha[C] * bend))
    sn_v = mp.sqrt(real(-d2 * alpha[C] * bend / KD))
    v = (-sn_v if h < 0 else sn_v) * mp.elliprf(real(KS / KD), real(KS / KC), 1)
    squares = (
        (w[D] ** 2 - alpha[D] / alpha[S] * w[S] ** 2) / KS,
        (w[S] ** 2 - alpha[S] / alpha[C] * w[C] ** 2) / KC,
        (w[C] ** 2 - alpha[C] / alpha[S] * w[S] ** 2) / KS,
    )
    return Elliptic.of(w, alpha, axes, squares, m1).turning(2 * v)


def hk_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 3) after ``n`` (m,) steps of ``h`` from ``y0`` (3,). Raises RunError if ``h`` is too long."""
    with digits():
        motion = hk_motion(tuple(map(float, y0)), float(h), tuple(map(float, p[:6])))
        if motion is None:
            return np.tile(y0, (len(n), 1))
        return motion.omega(motion.argument.functions(n, mp.mpf(1))[2:])


@scheme(
    "hk-exact",
    top="euler",
    order=2,
    explicit=True,
    self_adjoint=True,
    modified=lambda top, h, options: euler_hk_integrals(top, h),
)
def build_hk_exact(top: Top, options: NoOptions) -> Sampler:
    r"""Closed-form solution of the Hirota-Kimura map.

    The scheme computes the states of ``hk`` without its round-off, by Jacobi elliptic functions of a phase.

    The orbits of HK lie on the elliptic curves defined by the modified integrals of HK. The phase grows by 2 v in each
    step. Both v and the modulus of the elliptic functions depend on h.

    Source
    ------
    Hirota, Kimura 2000; Petrera, Suris 2010

    Equations
    ---------
    the first difference equations of section 1.2 of the paper, solved by Jacobi elliptic functions

    Formula
    -------
    \omega_1 = a_1\,\mathrm{cn}\,\varphi_n, \quad \omega_2 = a_2\,\mathrm{sn}\,\varphi_n, \quad
    \omega_3 = a_3\,\mathrm{dn}\,\varphi_n, \quad \varphi_n = \varphi_0 + 2nv, \qquad
    K_i = 1 - \tfrac{h^2}{4}\,\alpha_j\alpha_k\,\omega_i^2

    \mathrm{sn}^2 v = 1 - \frac{K_2}{K_3}, \qquad k^2\,\mathrm{sn}^2 v = 1 - \frac{K_2}{K_1}

    \text{(second moment of inertia between the others; first and third axis exchanged if } k > 1)

    Limits
    ------
    singular-step
        For steps of the order of 2/|omega| and longer, the phase of the map may not be real. The scheme refuses such
        steps, and the message names the largest admissible step.
    """
    return Sampler(hk_states)
