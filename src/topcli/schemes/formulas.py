"""Formulas in LaTeX that several schemes share, for the documentation; conventions as in ``contracts.Scheme``."""

from __future__ import annotations

HIROTA_KIMURA = r"""
J\,\frac{\omega' - \omega}{h} = \tfrac12\,(J\omega\times\omega' + J\omega'\times\omega) + \bar\gamma\times r, \qquad
\frac{\gamma' - \gamma}{h} = \tfrac12\,(\gamma\times\omega' + \gamma'\times\omega)
"""
XI = r"\xi = (\omega_1 + i\omega_2)^2 - c\,(\gamma_1 + i\gamma_2)"
BOHLIN = rf"""
\omega_3' - \omega_3 = -h c\,\bar\gamma_2, \qquad
(\omega_1' + i\omega_2')^2 = e^{{-ih\bar\omega_3}}\,\xi + c\,(\gamma_1' + i\gamma_2'), \qquad {XI}
"""
HYBRID = r"""
\gamma' - \gamma = h\,\bar\gamma\times\frac{\omega + \omega^{\mathrm{HK}}}{2}, \qquad
\omega_3' = \omega_3^{\mathrm{HK}}, \qquad
(\omega_1' + i\omega_2')^2 = e^{-ih\bar\omega_3}\,\xi + c\,(\gamma_1' + i\gamma_2')
"""
LAGRANGE_AXIS = r"""
\dot u^2 = (2E - s^2 - 2u)(1 - u^2) - (l - su)^2, \qquad
u = u_1 + (u_2 - u_1)\,\mathrm{sn}^2\Bigl(\sqrt{\tfrac{u_3 - u_1}{2}}\;(t + t_0)\,;\ k\Bigr), \quad
k^2 = \frac{u_2 - u_1}{u_3 - u_1}

u = \gamma_3 = a\cdot p, \quad s = m\cdot e_3 = m\cdot a, \quad l = m\cdot\gamma = m\cdot p, \quad
E = \tfrac12 m^2 + u, \qquad u_1 \leq u_2 \leq u_3 \text{ the zeros of } \dot u^2; \quad A = \mu = 1
"""
