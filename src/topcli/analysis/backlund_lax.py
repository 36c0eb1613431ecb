"""Discrete Lax pair L' U = U L of the Kowalevski top's map ``backlund``, from the 5x5 Lax matrix alone.

With alpha = -2/h, let L(alpha) l = nu l for an eigenvalue near 2 alpha, I = diag(1, 1, 1, -1, -1), P = l l^T/(l^T l)
and Q = I P I. As l is isotropic, l^T I l = 0, the matrix ::

    D(lambda) = (lambda - alpha)/(lambda + alpha) P + (1 - P - Q) + (lambda + alpha)/(lambda - alpha) Q

dresses L: D L D^-1 has no poles at +-alpha. With b the last two components of l, of length one, and S = 1 - 2 b b^T,
the constant reflection g = diag(S, 1, S) brings it back to the form of a Lax matrix, that of a state in between. U is
the product of two such matrices g D (lambda² - alpha²), for both eigenvalues near 2 alpha.
"""

from __future__ import annotations

import numpy as np

from topcli.analysis.lax import LaxForm, Matrices
from topcli.contracts import Array

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
    one = np.eye(5)
    P = 0.5 * (one - reflections(vectors))
    Q = SIGNATURE @ P @ SIGNATURE
    D = (lam - alpha) ** 2 * P + (lam**2 - alpha**2) * (one - P - Q) + (lam + alpha) ** 2 * Q
    g = np.broadcast_to(one, P.shape).astype(complex)
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
    """Largest ||L' U - U L|| over consecutive ``states`` (n, 6) a step h apart, relative to the norms of the factors.

    ``form`` is that of the Kowalevski top. nan if a step has no dressing, or if a state is not finite.
    """
    L = form.L(states, lam)
    with np.errstate(all="ignore"):
        try:
            second, first = factors(form, states[:-1], h, lam)
        except np.linalg.LinAlgError:
            return np.nan
        U = second @ first
        sizes = [np.linalg.norm(one, axis=(1, 2)) for one in (second, first, L[:-1], L[1:] @ U - U @ L[:-1])]
        return float((sizes[3] / (sizes[0] * sizes[1] * sizes[2])).max())
