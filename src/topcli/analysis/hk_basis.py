"""Integrals of a rational map from Hirota-Kimura bases, and its invariant density, modulo a prime.

The monomials up to some degree, evaluated along an orbit, are the columns of a matrix. Its null space, an HK basis of
the orbit (Petrera, Pfadler, Suris, Exp. Math. 18 (2009) 223), is the same for all points of the orbit: quotients of its
coefficients are integrals of the map. The rank of their derivatives, found from the tangent map, is the number of
functionally independent ones. A polynomial P with P(x') = J(x) P(x), where J is the Jacobian determinant of the map,
gives the invariant measure dx/P.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from topcli.engine.residues import PRIME, Jet, RationalMap, Residues, folded, inverse
from topcli.field.polynomial import Monomial

EXTRA = 8
"""Rows of a matrix beyond the number of columns: a null space is accidental with a probability of PRIME**-EXTRA."""
_CHUNK = 32
"""Rows that are eliminated together, so that they stay in the processor's cache."""


def monomials(d: int, degree: int) -> list[Monomial]:
    """Monomials of d variables up to a degree, the lowest first."""
    return [m for k in range(degree + 1) for m in combinations_with_replacement(range(d), k)]


def values_of(states: Sequence[Jet], degree: int) -> Residues:
    """Monomials of a state up to a degree with their derivatives, (rows of a jet, points, monomials)."""
    values: dict[Monomial, Jet] = {(): Jet(np.zeros_like(states[0].a)) + 1}
    for m in monomials(len(states), degree)[1:]:
        values[m] = values[m[:-1]] * states[m[-1]]
    return np.stack([jet.a for jet in values.values()], axis=-1)


def reduced(matrix: Residues) -> tuple[Residues, list[int]]:
    """Reduced row echelon form without zero rows, and the columns of its pivots."""
    left, pivots = matrix % PRIME, list[int]()
    for column in range(left.shape[1]):
        row = len(pivots)
        below = row + np.flatnonzero(left[row:, column] % PRIME)
        if len(below):
            left[[row, below[0]]] = left[[below[0], row]]
            left[row, column:] %= PRIME
            left[row, column:] = left[row, column:] * inverse(left[row, column : column + 1]) % PRIME
            factors = PRIME - left[row + 1 :, column, None] % PRIME
            for at in range(0, len(factors), _CHUNK):
                rest = left[row + 1 + at : row + 1 + at + _CHUNK, column:]
                rest[...] = folded(rest + factors[at : at + _CHUNK] * left[row, column:])
            pivots.append(column)
    left = left[: len(pivots)]
    free = np.setdiff1d(np.arange(left.shape[1]), pivots)
    for row in reversed(range(len(pivots))):  # the pivots' columns are those of the identity
        column = pivots[row]
        left[:row, free] = (left[:row, free] + (PRIME - left[:row, column, None] % PRIME) * left[row, free]) % PRIME
        left[:row, column] = 0
    return left, pivots


def null_space(matrix: Residues) -> Residues:
    """Basis of the null space, a vector in each row."""
    left, pivots = reduced(matrix)
    free = np.setdiff1d(np.arange(matrix.shape[1]), pivots)
    basis = np.zeros((len(free), matrix.shape[1]), dtype=np.int64)
    basis[np.arange(len(free)), free] = 1
    basis[:, pivots] = -left[:, free].T % PRIME
    return basis


def determinants(matrices: Residues) -> Residues:
    """Determinants of the matrices (d, d, points)."""
    left, product = matrices.copy(), np.ones(matrices.shape[2], dtype=np.int64)
    for i in range(len(left)):
        if not left[i, i].all():  # random points, so that this is structure: bring a row where it does not vanish
            swap = next((k for k in range(i + 1, len(left)) if left[k, i].all()), None)
            if swap is None:
                return np.zeros_like(product)
            left[[i, swap]] = left[[swap, i]]
            product = -product
        product = product * left[i, i] % PRIME
        factors = left[i + 1 :, i] * inverse(left[i, i]) % PRIME
        left[i + 1 :] = (left[i + 1 :] - factors[:, None] * left[i]) % PRIME
    return product % PRIME


def random_state(step: RationalMap, points: int, seed: int) -> list[Jet]:
    """Random states with the unit directions as derivatives."""
    d = step.d
    values = np.random.default_rng(seed).integers(1, PRIME, (d, points))
    directions = np.broadcast_to(np.eye(d, dtype=np.int64)[:, :, None], (d, d, points))
    return [Jet(np.concatenate([values[i][None], directions[i]])) for i in range(d)]


@dataclass(frozen=True)
class HKBasis:
    """HK basis of the monomials up to a ``degree``: dimension of the null space, and number of independent integrals.

    ``integrals`` counts the functionally independent quotients of its coefficients.
    """

    degree: int
    monomials: int
    null: int
    integrals: int


def hk_orbit(step: RationalMap, points: int, seed: int) -> list[Jet]:
    """States of an orbit from a random one, one a step, with derivatives along the initial components."""
    state, states = step.enter(random_state(step, 1, seed)), list[Sequence[Jet]]()
    for _ in range(points):
        states.append(step.leave(state))
        state = step.step(state)
    return [Jet(np.concatenate([y[i].a for y in states], axis=1)) for i in range(step.d)]


def hk_bases(step: RationalMap, degrees: Sequence[int], seed: int = 1) -> Iterator[HKBasis]:
    """HK bases of a random orbit, one for each of the ``degrees``. Raises ZeroDivisionError in special position."""
    states: list[Jet] = []
    for degree in degrees:
        m = len(monomials(step.d, degree))
        states = hk_orbit(step, m + EXTRA, seed)
        values, *slopes = values_of(states, degree)
        left, pivots = reduced(values)
        r, free = len(pivots), np.setdiff1d(np.arange(m), pivots)
        if not len(free):
            yield HKBasis(degree, m, 0, 0)
            continue
        # on r rows, A_p X = A_f for the free columns f and the pivots p, so that A_p dX = dA_f - dA_p X
        rest = [(slope[:r, free] - matrix_product(slope[:r][:, pivots], left[:, free])) % PRIME for slope in slopes]
        solved, leading = reduced(np.concatenate([values[:r][:, pivots], *rest], axis=1))
        if leading != list(range(r)):
            raise ZeroDivisionError("the first rows are dependent")
        gradients = solved[:, r:].reshape(r, step.d, len(free)).transpose(0, 2, 1).reshape(-1, step.d)
        yield HKBasis(degree, m, len(free), len(reduced(gradients)[1]))


def matrix_product(a: Residues, b: Residues) -> Residues:
    """Product of two matrices of residues."""
    total = np.zeros((a.shape[0], b.shape[1]), dtype=np.int64)
    for column, row in zip(a.T, b, strict=True):
        total = (total + column[:, None] * row) % PRIME
    return total


@dataclass(frozen=True)
class Density:
    """Polynomials P of the lowest ``degree`` for which dx/P is invariant; ``basis`` has a row for each."""

    degree: int
    basis: Residues


def density(step: RationalMap, most: int, seed: int = 2) -> Density | None:
    """Invariant density 1/P with a polynomial P of the lowest degree; None if there is none up to degree ``most``.

    Raises ZeroDivisionError in special position.
    """
    points = len(monomials(step.d, most)) + EXTRA
    before = random_state(step, points, seed)
    after = step.leave(step.step(step.enter(before)))
    jacobian = determinants(np.stack([y.a[1:] for y in after]))
    old = values_of([Jet(y.a[:1]) for y in before], most)[0]
    new = values_of([Jet(y.a[:1]) for y in after], most)[0]
    equations = (new - jacobian[:, None] * old) % PRIME
    for degree in range(most + 1):
        m = len(monomials(step.d, degree))
        basis = null_space(equations[: m + EXTRA, :m])
        if len(basis):
            return Density(degree, basis)
    return None
