"""Lax forms dL/dt = [M, L] of the tops: their matrices.

L and M are matrices that depend on the state (omega, gamma), affinely, and on a spectral parameter lambda. Where
dL/dt = [M, L] the spectrum of L is constant. A top's moments and gravity determine its forms:

=============  ====  ===========================  =========================================================
form           size  top                          source
=============  ====  ===========================  =========================================================
`manakov`      3     no gravity (Euler)           Manakov 1976
`lagrange`     3     A = B, gravity on axis 3     Ratiu, van Moerbeke 1982
`kowalevski`   5     A = B = 2C, gravity on 1     Reyman, Semenov-Tian-Shansky 1987; Bobenko et al. 1989
`block`        6     any                          Sogo, Discrete Spinning Tops, section 1.1, after (Audin)
=============  ====  ===========================  =========================================================

Three-vectors become matrices with the paper's sign: hat(v) hat(u) - hat(u) hat(v) = hat(u x v).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, EulerPoisson

Matrices = NDArray[Any]
"""Stacks (n, size, size) of real or complex matrices."""
MatrixOf = Callable[[Array, complex], Matrices]
"""States (n, 6) and lambda in, matrices (n, size, size) out; affine in the states."""


@dataclass(frozen=True)
class LaxForm:
    """One form dL/dt = [M, L] of a top's equations.

    ``blocks`` is the number of traces that conjugation keeps: one for an ordinary matrix, tr L^k. The matrices of the
    block form represent Gamma + epsilon M with epsilon² = 0, and conjugation by such matrices keeps two block traces:
    those of the diagonal and of the upper block of L^k, which are the two parts of the trace of (Gamma + epsilon M)^k.
    The trace tr L^k of the whole matrix is twice the first of them.
    """

    name: str
    title: str
    citation: str
    size: int
    spectral: bool
    """True if the matrices depend on lambda."""
    lax_pair: bool
    """True if the spectrum carries all integrals of the top; otherwise the form only rewrites the equations."""
    L: MatrixOf
    M: MatrixOf
    blocks: int = 1

    @property
    def traced(self) -> str:
        """Name of the invariants."""
        return "tr L^k" if self.blocks == 1 else "block traces of L^k"

    def invariants(self, states: Array, lam: complex) -> Matrices:
        """Traces of the blocks of L, ..., L^size at ``states`` (n, 6): shape (n, size * blocks)."""
        L = power = self.L(states, lam)
        found = []
        for _ in range(self.size):
            found += self.traces(power)
            power = power @ L
        return np.stack(found, axis=1)

    def traces(self, matrices: Matrices) -> list[NDArray[Any]]:
        """Trace (n,) of each block of ``matrices`` (n, size, size)."""
        k = self.size // self.blocks
        return [np.trace(matrices[:, :k, i * k : (i + 1) * k], axis1=1, axis2=2) for i in range(self.blocks)]

    def exponents(self) -> Array:
        """Degree in L of each of ``invariants``, shape (size * blocks,)."""
        return np.repeat(np.arange(1.0, self.size + 1.0), self.blocks)


def hat(v: Array) -> Matrices:
    """Antisymmetric matrices, with the paper's sign, of vectors (n, 3): shape (n, 3, 3)."""
    a, b, c = v.T
    o = np.zeros_like(a)
    return np.moveaxis(np.array([[o, c, -b], [-c, o, a], [b, -a, o]]), 2, 0)


def rates(equations: EulerPoisson, states: Array) -> Array:
    """Right-hand side of the Euler-Poisson equations at states (n, 6), Sogo (EulerPoisson)."""
    I, g = np.array(equations.moments), np.array(equations.gravity)  # noqa: E741
    omega, gamma = states[:, :3], states[:, 3:]
    torque = np.cross(I * omega, omega) + np.cross(gamma, g)
    return np.hstack([torque / I, np.cross(gamma, omega)])


def _block(upper: Matrices, diagonal: Matrices) -> Matrices:
    upper = np.broadcast_to(upper, diagonal.shape)
    return np.concatenate(
        [np.concatenate([diagonal, upper], axis=2), np.concatenate([0.0 * diagonal, diagonal], axis=2)], axis=1
    )


def block_form(equations: EulerPoisson) -> LaxForm:
    """The paper's form (Gamma M; 0 Gamma), (Omega G; 0 Omega), which every top has, integrable or not."""
    I, G = np.array(equations.moments), hat(np.array([equations.gravity]))  # noqa: E741
    return LaxForm(
        "block",
        "the paper's block form (Γ M; 0 Γ)",
        "Sogo, Discrete Spinning Tops, section 1.1; Audin 1996",
        6,
        False,
        False,
        lambda y, lam: _block(hat(I * y[:, :3]), hat(y[:, 3:])),
        lambda y, lam: _block(G, hat(y[:, :3])),
        blocks=2,
    )


def manakov_form(equations: EulerPoisson) -> LaxForm:
    """L = M + lambda J², M = Omega + lambda J with J = diag((B + C - A)/2, ...)."""
    I = np.array(equations.moments)  # noqa: E741
    J = np.diag(0.5 * I.sum() - I)
    return LaxForm(
        "manakov",
        "Manakov's pair, L = M + λJ²",
        "Manakov 1976",
        3,
        True,
        True,
        lambda y, lam: hat(I * y[:, :3]) + lam * (J @ J),
        lambda y, lam: hat(y[:, :3]) + lam * J,
    )


def lagrange_form(equations: EulerPoisson) -> LaxForm:
    """L = Gamma + lambda M + lambda² A G, M = Omega + lambda G."""
    I, G = np.array(equations.moments), hat(np.array([equations.gravity]))  # noqa: E741
    return LaxForm(
        "lagrange",
        "Lagrange's top, L = Γ + λM + λ²AG",
        "Ratiu, van Moerbeke 1982",
        3,
        True,
        True,
        lambda y, lam: hat(y[:, 3:]) + lam * hat(I * y[:, :3]) + lam**2 * I[0] * G,
        lambda y, lam: hat(y[:, :3]) + lam * G,
    )


def kowalevski_form(equations: EulerPoisson) -> LaxForm:
    """The 5x5 pair in so(3, 2); the equations in units of C, in which the paper's A = B = 2, C = 1 hold."""
    c = equations.gravity[0] / equations.moments[2]
    E = np.eye(3, 2)

    def corner(upper: Matrices, side: Matrices, lower: Matrices) -> Matrices:
        top = np.concatenate([upper + 0.0 * side[:, :, :1], side], axis=2)
        return np.concatenate([top, np.concatenate([side.transpose(0, 2, 1), lower], axis=2)], axis=1)

    def L(y: Array, lam: complex) -> Matrices:
        n = len(y)
        V = np.zeros((n, 3, 2), dtype=np.result_type(y, lam))
        V[:] = 2.0 * lam * E
        V[:, :, 0] -= (c / lam) * y[:, 3:]
        J = np.array([[0.0, 1.0], [-1.0, 0.0]])
        return corner(hat(y[:, :3] * np.array([2.0, 2.0, 1.0])), V, -y[:, 2, None, None] * J)

    def M(y: Array, lam: complex) -> Matrices:
        side = np.broadcast_to(lam * E, (len(y), 3, 2))
        return corner(hat(y[:, :3]), side, np.zeros((len(y), 2, 2)))

    return LaxForm(
        "kowalevski",
        "Kowalevski's top, 5x5",
        "Reyman, Semenov-Tian-Shansky 1987; Bobenko, Reyman, Semenov-Tian-Shansky 1989",
        5,
        True,
        True,
        L,
        M,
    )


def lax_forms(equations: EulerPoisson) -> tuple[LaxForm, ...]:
    """Lax forms of the equations: the pairs of an integrable top, and always the paper's block form."""
    A, B, C = equations.moments
    x, y, z = equations.gravity
    found = []
    if x == y == z == 0.0:
        found.append(manakov_form(equations))
    if A == B and x == y == 0.0:
        found.append(lagrange_form(equations))
    if A == B == 2.0 * C and y == z == 0.0:
        found.append(kowalevski_form(equations))
    return (*found, block_form(equations))
