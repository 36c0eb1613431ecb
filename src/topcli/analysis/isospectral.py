"""Constancy of the spectrum of a Lax matrix, and the integrals that it carries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from topcli.analysis.lax import LaxForm, Matrices
from topcli.contracts import Array, Invariant

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
    found = np.linalg.eigvals(form.L(states, lam))
    distance = np.abs(found[:, :, None] - found[0][None, None, :]).min(axis=2)
    return float(distance.max()) / _size(form.L(states, lam))


def gradients(form: LaxForm, state: Array, lam: complex) -> Matrices:
    """Gradients (size * blocks, 6) of ``form.invariants`` at a state (6,): d tr L^k = k tr(L^(k-1) dL), by blocks."""
    units = np.eye(6)
    L = form.L(state[None, :], lam)
    dL = form.L(units, lam) - form.L(np.zeros((6, 6)), lam)
    power = np.broadcast_to(np.eye(form.size), L.shape)
    found = []
    for k in range(1, form.size + 1):
        found += form.traces(k * (power @ dL))
        power = power @ L
    return np.array(found)


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
    one = np.eye(form.size)
    U = np.linalg.solve(one - X, one + X)
    return _size(L[1:] @ U - U @ L[:-1]) / _size(U @ L[:-1])
