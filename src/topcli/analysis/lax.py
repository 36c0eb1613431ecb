"""Lax forms dL/dt = [M, L] of the tops, the constancy of their spectra, and the integrals in the spectra.

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

The discrete Lax pair L' U = U L of the Kowalevski top's map ``backlund`` follows from the 5x5 Lax matrix alone.

With alpha = -2/h, let L(alpha) l = nu l for an eigenvalue near 2 alpha, I = diag(1, 1, 1, -1, -1), P = l l^T/(l^T l)
and Q = I P I. As l is isotropic, l^T I l = 0, the matrix ::

    D(lambda) = (lambda - alpha)/(lambda + alpha) P + (1 - P - Q) + (lambda + alpha)/(lambda - alpha) Q

dresses L: D L D^-1 has no poles at +-alpha. With b the last two components of l, of length one, and S = 1 - 2 b b^T,
the constant reflection g = diag(S, 1, S) brings it back to the form of a Lax matrix, that of a state in between. U is
the product of two such matrices g D (lambda² - alpha²), for both eigenvalues near 2 alpha.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, EulerPoisson, Invariant

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
        traces = []
        for _ in range(self.size):
            traces += self.traces(power)
            power = power @ L
        return np.stack(traces, axis=1)

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
    return np.stack(equations.rates(tuple(states.T)), axis=1)


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
    pairs = []
    if x == y == z == 0.0:
        pairs.append(manakov_form(equations))
    if A == B and x == y == 0.0:
        pairs.append(lagrange_form(equations))
    if A == B == 2.0 * C and y == z == 0.0:
        pairs.append(kowalevski_form(equations))
    return (*pairs, block_form(equations))


WEIGHTS = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)
"""Central differences of order 8: the weights of the states 1, 2, 3, 4 steps away."""
GENERIC = np.array([[0.83, -0.41, 1.27, 0.36, 0.62, -0.71], [-0.57, 1.13, 0.38, -0.81, 0.44, 0.29]])
"""States in general position."""
LAMBDAS: tuple[complex, ...] = (0.5, 1.0, 2.0, 1.0 + 1.0j)
"""Spectral parameters at which spectra are computed."""
RANK_TOLERANCE = 1e-9


def _size(stack: Matrices) -> float:
    return float(np.linalg.norm(stack, axis=(1, 2)).max())


def commutator_residual(form: LaxForm, states: Array, slopes: Array, lam: complex) -> float:
    """Largest ||dL/dt - [M, L]|| relative to the larger of ||dL/dt|| and ||M L||, for ``slopes`` (n, 6) of the states.

    dL/dt is L's linear part at the slopes.
    """
    zero = np.zeros_like(states)
    L, M = form.L(states, lam), form.M(states, lam)
    change = form.L(slopes, lam) - form.L(zero, lam)
    return _size(change - (M @ L - L @ M)) / (max(_size(change), _size(M @ L)) or 1.0)


def difference_slopes(windows: Array, step: float) -> Array:
    """Slopes (n, 6) from states (n, 9, 6) at -4 to 4 steps around each time: differences of order 8."""
    parts = [w * (windows[:, 4 + k] - windows[:, 4 - k]) for k, w in enumerate(WEIGHTS, start=1)]
    return np.sum(parts[::-1], axis=0) / step


def spectral_drift(form: LaxForm, states: Array, lam: complex) -> float:
    """Largest change of ``form.invariants`` from the first state, relative to ||L||^k; round-off on the exact flow."""
    traces = form.invariants(states, lam)
    size = _size(form.L(states, lam))
    return float((np.abs(traces - traces[0]) / size ** form.exponents()).max())


def eigenvalue_shift(form: LaxForm, states: Array, lam: complex) -> float:
    """Largest distance of an eigenvalue of L from the nearest one of the first state, relative to ||L||."""
    eigenvalues = np.linalg.eigvals(form.L(states, lam))
    distance = np.abs(eigenvalues[:, :, None] - eigenvalues[0][None, None, :]).min(axis=2)
    return float(distance.max()) / _size(form.L(states, lam))


def gradients(form: LaxForm, state: Array, lam: complex) -> Matrices:
    """Gradients (size * blocks, 6) of ``form.invariants`` at a state (6,): d tr L^k = k tr(L^(k-1) dL), by blocks."""
    units = np.eye(6)
    L = form.L(state[None, :], lam)
    dL = form.L(units, lam) - form.L(np.zeros((6, 6)), lam)
    power = np.broadcast_to(np.eye(form.size), L.shape)
    rows = []
    for k in range(1, form.size + 1):
        rows += form.traces(k * (power @ dL))
        power = power @ L
    return np.array(rows)


@dataclass(frozen=True)
class Content:
    """Integrals in the traces of a Lax form: the number of ``independent`` ones, and those with a name."""

    independent: int
    carries: tuple[str, ...]


def spectral_content(form: LaxForm, invariants: tuple[Invariant, ...], d: int) -> Content:
    """Integrals in ``form.invariants`` at ``LAMBDAS``, by the span of their gradients at states in general position.

    ``invariants`` are functions of the first ``d`` components of the state; one of them is carried when its gradient
    lies in the span. Differences of five points, exact for polynomials up to degree four.
    """
    independent, carried = 6, {invariant.name for invariant in invariants}
    for state in GENERIC:
        rows = np.concatenate([gradients(form, state, lam) for lam in LAMBDAS])
        rows = np.concatenate([np.real(rows), np.imag(rows)])
        sizes = np.linalg.norm(rows, axis=1)
        rows = rows[sizes > RANK_TOLERANCE * sizes.max()]
        _, values, basis = np.linalg.svd(rows / np.linalg.norm(rows, axis=1, keepdims=True))
        rank = int((values > RANK_TOLERANCE * values[0]).sum())
        independent = min(independent, rank)
        span = basis[:rank]
        for invariant in invariants:
            gradient = np.zeros(6)
            for i in range(d):
                e = 0.1 * np.eye(6)[i]
                v = invariant.value(np.array([state + k * e for k in (-2, -1, 1, 2)])[:, :d])
                gradient[i] = (8.0 * (v[2] - v[1]) - (v[3] - v[0])) / 1.2
            outside = gradient - span.T @ (span @ gradient)
            if np.linalg.norm(outside) > 1e-8 * np.linalg.norm(gradient):
                carried.discard(invariant.name)
    return Content(independent, tuple(i.name for i in invariants if i.name in carried))


def conjugation_defect(form: LaxForm, states: Array, h: float, lam: complex) -> float:
    """Largest ||L' U - U L|| / ||L U|| over consecutive ``states`` (n, 6) a step h apart.

    U = (1 - h/2 M)^-1 (1 + h/2 M) with M at the mean state. Where it vanishes L' = U L U^-1: the step keeps the
    spectrum of L, whatever lambda.
    """
    L = form.L(states, lam)
    X = 0.5 * h * form.M(0.5 * (states[1:] + states[:-1]), lam)
    identity = np.eye(form.size)
    U = np.linalg.solve(identity - X, identity + X)
    return _size(L[1:] @ U - U @ L[:-1]) / _size(U @ L[:-1])


SIGNATURE = np.diag([1.0, 1.0, 1.0, -1.0, -1.0])


def eigenvectors(L: Matrices, targets: Matrices) -> Matrices:
    """Eigenvectors (n, 5) of matrices (n, 5, 5) whose eigenvalues are nearest to ``targets`` (n,)."""
    values, vectors = np.linalg.eig(L)
    chosen = np.abs(values - targets[:, None]).argmin(axis=1)
    return np.take_along_axis(vectors, chosen[:, None, None], axis=2)[:, :, 0].astype(complex)


def reflections(axes: Matrices) -> Matrices:
    """1 - 2 a a^T/(a^T a) (n, d, d) for complex axes a (n, d)."""
    return np.eye(axes.shape[1]) - 2.0 * axes[:, :, None] * axes[:, None, :] / (axes**2).sum(axis=1)[:, None, None]


def dressings(vectors: Matrices, alpha: float, lam: complex) -> Matrices:
    """The matrices g D (lambda² - alpha²) (n, 5, 5) of eigenvectors (n, 5)."""
    identity = np.eye(5)
    P = 0.5 * (identity - reflections(vectors))
    Q = SIGNATURE @ P @ SIGNATURE
    D = (lam - alpha) ** 2 * P + (lam**2 - alpha**2) * (identity - P - Q) + (lam + alpha) ** 2 * Q
    g = np.broadcast_to(identity, P.shape).astype(complex)
    g[:, :2, :2] = g[:, 3:, 3:] = reflections(vectors[:, 3:])
    return g @ D


def states_between(states: Matrices, vectors: Matrices, alpha: float) -> Matrices:
    """States (n, 6) after one transformation with the eigenvectors (a; b), complex if they are.

    m' = -S m + 4 alpha a x b and gamma' = S R gamma, with the reflection R along a.
    """
    a, b = vectors[:, :3], np.pad(vectors[:, 3:], ((0, 0), (0, 1)))
    lengths = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))[:, None]
    S, R = reflections(b), reflections(a)
    to_m = np.array([2.0, 2.0, 1.0])
    m = 4.0 * alpha * np.cross(a, b) / lengths - (S @ (states[:, :3] * to_m)[:, :, None])[:, :, 0]
    return np.hstack([m / to_m, (S @ R @ states[:, 3:, None])[:, :, 0]])


def factors(form: LaxForm, states: Array, h: float, lam: complex) -> tuple[Matrices, Matrices]:
    """Second and first factor (n, 5, 5) of U(lambda), of steps of length h from ``states``."""
    alpha = -2.0 / h
    L = form.L(states, alpha)
    values = np.linalg.eigvals(L)
    order = np.argsort(-np.sign(alpha) * values.real, axis=1, kind="stable")
    nu = np.take_along_axis(values, order, axis=1)
    first = eigenvectors(L, nu[:, 0])
    second = eigenvectors(form.L(states_between(states, first, alpha), alpha), nu[:, 1])
    return dressings(second, alpha, lam), dressings(first, alpha, lam)


def discrete_lax_defect(form: LaxForm, states: Array, h: float, lam: complex) -> float:
    """Return the largest defect of the discrete Lax equation L' U = U L over consecutive states of a run.

    L is the Lax matrix before a step, and L' is the Lax matrix after it. U is the dressing matrix of the step. It is a
    product of two factors. The defect of the step is ||L' U - U L||, divided by the norms of L and of the two factors
    of U. ``form`` is the Lax form of the Kowalevski top, and ``lam`` is the spectral parameter. ``states``, shape
    (n, 6), contains states that are one step ``h`` apart. The result is nan if a state is not finite, or if a step has
    no matrix U.
    """
    L = form.L(states, lam)
    with np.errstate(all="ignore"):
        try:
            second, first = factors(form, states[:-1], h, lam)
        except np.linalg.LinAlgError:
            return np.nan
        U = second @ first
        sizes = [np.linalg.norm(matrices, axis=(1, 2)) for matrices in (second, first, L[:-1], L[1:] @ U - U @ L[:-1])]
        return float((sizes[3] / (sizes[0] * sizes[1] * sizes[2])).max())
