"""Search for polynomials of the state that stay constant along given orbits.

The monomials up to a degree, less their mean along each orbit, are the columns of a matrix. Its null space consists of
the polynomials that are constant on every orbit, each orbit with a value of its own. It shows as a gap between singular
values of the size of round-off and the others.

On a single orbit the relations of an HK basis are constant too, whose coefficients belong to that orbit. Constants F
and G of lower degree make F G constant; and a combination of them that is zero on all orbits, such as F - c where c is
the value on the only one, makes its product with every monomial constant. These products are not counted again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from topcli.field.polynomial import Monomial, Polynomial

Floats = NDArray[np.float64]
GAP = 1e4
"""Smallest ratio of the singular values on both sides of the gap."""
NOISE = 1e-8
"""Share of a polynomial's largest term below which a term is round-off."""
EXTRA = 10
"""Rows beyond the number of monomials that are needed at least."""


@dataclass(frozen=True)
class Constant:
    """A polynomial with its ``values`` on the orbits, and its largest relative ``deviation`` from them."""

    polynomial: Polynomial
    values: tuple[float, ...]
    deviation: float


@dataclass(frozen=True)
class Level:
    """Constants of one ``degree``: dimension of the null space among the ``monomials``, and that of known products.

    ``kept`` and ``left`` are the singular values on both sides of the gap, relative to the largest; None for no side.
    """

    degree: int
    monomials: int
    null: int
    products: int
    kept: float | None
    left: float | None
    constants: tuple[Constant, ...]


def monomials_to(d: int, degree: int) -> list[Monomial]:
    """Monomials of d variables from degree 1 up, the lowest first."""
    return [m for k in range(1, degree + 1) for m in combinations_with_replacement(range(d), k)]


def _columns(orbit: Floats, monomials: Sequence[Monomial]) -> Floats:
    return np.stack([orbit[:, m].prod(axis=1) for m in monomials], axis=1)


def null_dimension(singular: Floats, tolerance: float) -> int:
    """Number of singular values, in falling order, below the widest gap under the tolerance; 0 if it is narrow."""
    s = np.maximum(singular / singular[0], 1e-18)
    below = [i for i in range(1, len(s)) if s[i] < tolerance]
    if not below:
        return 0
    at = max(below, key=lambda i: s[i - 1] / s[i])
    return len(s) - at if s[at - 1] / s[at] >= GAP else 0


def constants(orbits: Sequence[Floats], degree: int, tolerance: float) -> list[Level]:
    """Polynomials up to a degree that are constant on all orbits (rows, d), by degree.

    Singular values of the null space are at most ``tolerance`` times the largest of all.
    """
    found: list[Level] = []
    known: list[Constant] = []
    d = orbits[0].shape[1]
    for e in range(1, degree + 1):
        monomials = monomials_to(d, e)
        columns = [_columns(orbit, monomials) for orbit in orbits]
        sizes = np.sqrt(np.mean([(c**2).mean(axis=0) for c in columns], axis=0))
        sizes[sizes == 0.0] = 1.0
        matrix = np.concatenate([(c - c.mean(axis=0)) / sizes for c in columns])
        _, singular, rows = np.linalg.svd(np.linalg.qr(matrix, mode="r"))
        null = null_dimension(singular, tolerance)
        basis = rows[len(rows) - null :]
        known_ones = [_vector(one, monomials) * sizes for one in _products(known, e, d)]
        products, leads = _echelon(np.array(known_ones).reshape(-1, len(rows)))
        new = basis - basis[:, leads] @ products
        left = np.linalg.svd(new)[2][: max(null - len(products), 0)]
        fresh = [_constant(vector, monomials, columns) for vector in _readable(left, sizes)]
        s = singular / singular[0]
        kept, other = (float(s[-null]) if null else None), (float(s[-null - 1]) if null < len(s) else None)
        found.append(Level(e, len(monomials), null, min(len(products), null), kept, other, tuple(fresh)))
        known += fresh
    return found


def _vector(polynomial: Polynomial, monomials: Sequence[Monomial]) -> Floats:
    return np.array([float(polynomial.terms.get(m, 0)) for m in monomials])


def _echelon(vectors: Floats) -> tuple[Floats, list[int]]:
    """Basis of the span of vectors, each with 1 where all others have 0: at its last element that is no round-off."""
    left, leads = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300), list[int]()
    for column in reversed(range(left.shape[1])):
        at = len(leads)
        if at == len(left):
            break
        pivot = at + int(np.argmax(np.abs(left[at:, column])))
        if abs(left[pivot, column]) > NOISE:
            left[[at, pivot]] = left[[pivot, at]]
            left[at] /= left[at, column]
            others = np.arange(len(left)) != at
            left[others] -= left[others, column, None] * left[at]
            leads.append(column)
    return left[: len(leads)], leads


def _products(known: Sequence[Constant], degree: int, d: int) -> list[Polynomial]:
    """Constants up to this degree that follow from the known ones: their products, and multiples of what vanishes."""
    powers: list[tuple[Polynomial, Floats]] = []
    for factors in (some for k in range(1, degree + 1) for some in combinations_with_replacement(known, k)):
        if sum(one.polynomial.degree for one in factors) <= degree:
            polynomial = math.prod((one.polynomial for one in factors), start=Polynomial({(): Fraction(1)}))
            powers.append((polynomial, np.prod([one.values for one in factors], axis=0)))
    found = [polynomial for polynomial, _ in powers]
    for e in sorted({polynomial.degree for polynomial in found}):
        low = [one for one in powers if one[0].degree <= e]
        for zero in _vanishing(low):
            found += [zero * Polynomial({m: Fraction(1)}) for m in monomials_to(d, degree - e)]
    return found


def _vanishing(powers: Sequence[tuple[Polynomial, Floats]]) -> list[Polynomial]:
    """Basis of the combinations of constants, and of 1, that are zero on all orbits."""
    values = np.stack([np.ones(len(powers[0][1])), *(value for _, value in powers)], axis=1)
    sizes = np.abs(values).max(axis=0)
    sizes[sizes == 0.0] = 1.0
    _, singular, rows = np.linalg.svd(values / sizes)
    rank = int((singular > NOISE * singular[0]).sum())
    polynomials = [Polynomial({(): Fraction(1)}), *(polynomial for polynomial, _ in powers)]
    return [
        sum((one * Fraction(c) for one, c in zip(polynomials, row.tolist(), strict=True)), start=Polynomial({}))
        for row in rows[rank:] / sizes
    ]


def _readable(vectors: Floats, sizes: Floats) -> Floats:
    """Basis of the same space with few terms in each vector: pivots are the largest elements in units of ``sizes``."""
    left, taken = vectors.copy(), np.zeros(len(vectors), dtype=bool)
    for _ in range(len(left)):
        row, column = np.unravel_index(np.argmax(np.abs(left) * ~taken[:, None]), left.shape)
        left[row] /= left[row, column]
        others = np.arange(len(left)) != row
        left[others] -= left[others, column, None] * left[row]
        taken[row] = True
    left[np.abs(left) < NOISE] = 0.0
    plain = left / sizes
    largest = np.abs(plain).max(axis=1, initial=0.0, keepdims=True)
    return plain / np.where(largest > 0.0, largest, 1.0)


def _constant(vector: Floats, monomials: Sequence[Monomial], columns: Sequence[Floats]) -> Constant:
    lead = next(c for _, c in sorted(zip(monomials, vector, strict=True), key=lambda one: (-len(one[0]), one[0])) if c)
    vector = vector * np.sign(lead)
    terms = {m: Fraction(c) for m, c in zip(monomials, vector.tolist(), strict=True)}
    along = [c @ vector for c in columns]
    scale = max(float((np.abs(c) @ np.abs(vector)).max()) for c in columns) or 1.0
    values = tuple(float(v.mean()) for v in along)
    return Constant(Polynomial(terms), values, max(float(np.abs(v - v.mean()).max()) for v in along) / scale)
