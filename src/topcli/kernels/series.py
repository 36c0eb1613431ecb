"""Taylor series of the Euler-Poisson equations, arranged for the vector units of a processor.

With y = (omega, gamma) and i, j, k cyclic the equations (Sogo, (Euler) and (Poisson)) are quadratic,

    omega_i' = alpha_i omega_j omega_k + beta_i gamma_j - delta_i gamma_k,
    gamma_i' = gamma_j omega_k - gamma_k omega_j,

and the coefficients y_m of their solution sum y_m t^m obey (m + 1) y_(m+1) = J y_m + sum y_k * y_(m-k), the sum over
k = 1..m-1, with J the Jacobian at y_0 and * the bilinear part. All series lie side by side in the lanes of one vector:

- what each coefficient waits for is J y_m alone, four products of permutations of y_m, scaled by 1/(m + 1) beforehand;
- the sum takes one fused multiply-add of whole vectors for each k where at most eight of its nine products are there
  (``SYMMETRIC``: alpha_3 = 0), two in general, and runs ahead of the chain of the y_m;
- the sums for m and m + 1 are formed together, so that each coefficient is loaded once for both.

Everything is written once in terms of the operations ``Operations``: ``machine`` turns them into LLVM's language,
``plain`` executes them with Python's floats, and both give the same bits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

Vector = Any
Scalar = Any


class Operations(Protocol):
    """Vectors of ``lanes`` floats, scalars, and arrays of vectors with one name and an index each."""

    lanes: int

    def constant(self, values: tuple[float, ...]) -> Vector:
        """A vector known beforehand."""

    def splat(self, x: Scalar) -> Vector:
        """A scalar in every lane."""

    def number(self, x: float) -> Scalar:
        """A scalar known beforehand."""

    def add(self, x: Any, y: Any) -> Any:
        """The sum of two vectors or scalars; likewise ``sub`` and ``mul``."""

    def sub(self, x: Any, y: Any) -> Any:
        """x - y."""

    def mul(self, x: Any, y: Any) -> Any:
        """x y."""

    def fma(self, x: Any, y: Any, z: Any) -> Any:
        """x y + z, rounded once where the processor can."""

    def permute(self, x: Vector, lanes: tuple[int, ...]) -> Vector:
        """The lanes of x at the indices; 0.0 at -1."""

    def store(self, name: str, index: int, x: Vector) -> None:
        """Keep x as number ``index`` of the array ``name``."""

    def load(self, name: str, index: int) -> Vector:
        """What was kept."""

    def logarithm(self, x: Vector) -> Scalar:
        """The base-2 logarithm of the largest magnitude in x to 0.09; -1023 for 0.0, 1024 and more for inf and nan."""

    def power(self, x: Scalar) -> Scalar:
        """2^x, to 0.3 percent, for -1022 < x < 1023."""

    def least(self, x: Scalar, y: Scalar) -> Scalar:
        """The smaller one; likewise ``largest``."""

    def largest(self, x: Scalar, y: Scalar) -> Scalar:
        """The larger one."""


@dataclass(frozen=True)
class Arrangement:
    """Which component stands in which lane of the factors.

    ``first`` and ``second`` are the permutations whose products the sums add up: one pair, or two of which the second
    is subtracted. ``folded`` permutes the sum of the products into what is subtracted from it.
    """

    lanes: int
    turns: tuple[tuple[int, ...], ...]
    """omega_j, omega_k, and where there is a vertical gamma_j, gamma_k, in each of the lanes of omega_i and gamma_i."""
    first: tuple[tuple[int, ...], tuple[int, ...]]
    second: tuple[tuple[int, ...], tuple[int, ...]] | None = None
    folded: tuple[int, ...] | None = None


_J, _K = (1, 2, 0, 1, 2, 0, 6, 7), (2, 0, 1, 2, 0, 1, 6, 7)
_GJ, _GK = (4, 5, 3, 4, 5, 3, 6, 7), (5, 3, 4, 5, 3, 4, 6, 7)
_OWN_J, _OWN_K = (1, 2, 0, 4, 5, 3, 6, 7), (2, 0, 1, 5, 3, 4, 6, 7)

FREE = Arrangement(4, ((1, 2, 0, 3), (2, 0, 1, 3)), ((1, 2, 0, 3), (2, 0, 1, 3)))
"""omega alone: the Euler top."""
GENERAL = Arrangement(8, (_J, _K, _GJ, _GK), (_OWN_J, _K), ((-1, -1, -1, 5, 3, 4, 6, 7), _J))
"""Any top."""
SYMMETRIC = Arrangement(
    8, (_J, _K, _GJ, _GK), ((1, 2, 4, 4, 5, 3, 5, 3), (2, 0, 0, 2, 0, 1, 1, 2)), None, (-1, -1, -1, 6, 7, 2, -1, -1)
)
"""A = B: without omega_1 omega_2 there are eight products, a lane each; lane 2 belongs to gamma_3."""


def arrangement_of(components: int, alpha3: float) -> Arrangement:
    """The cheapest arrangement for a state of so many components."""
    if components == 3:
        return FREE
    return SYMMETRIC if alpha3 == 0.0 else GENERAL


def _mask(o: Operations, upper: float, spare: float = 0.0) -> Vector:
    """The value in the lanes of gamma."""
    return o.constant((0.0, 0.0, 0.0, upper, upper, upper, spare, spare)[: o.lanes])


def _ones(o: Operations, value: float) -> Vector:
    """The value in all lanes that hold a component."""
    return o.constant((value,) * 3 + (0.0,) if o.lanes == 4 else (value,) * 6 + (0.0, 0.0))


def _keep(o: Operations, a: Arrangement, m: int, y: Vector, alpha: Vector) -> None:
    """Store coefficient m, and its permutations that later sums take their factors from."""
    o.store("y", m, y)
    factor = o.permute(y, a.first[0])
    o.store("a", m, factor if a.folded else o.mul(factor, alpha))
    o.store("b", m, o.permute(y, a.first[1]))
    if a.second:
        o.store("c", m, o.permute(y, a.second[0]))
        o.store("d", m, o.permute(y, a.second[1]))


def _pairs(a: Arrangement) -> tuple[tuple[str, str], ...]:
    return (("a", "b"), ("c", "d")) if a.second else (("a", "b"),)


def _folded(o: Operations, a: Arrangement, sums: list[Vector], alpha: Vector, factor: float) -> Vector:
    """The sum, in the lanes of the components, from the sums of products; times ``factor``."""
    scale = _ones(o, factor)
    if a.second:
        return o.mul(o.sub(sums[0], sums[1]), scale)
    if a.folded:
        return o.fma(o.permute(sums[0], a.folded), _ones(o, -factor), o.mul(sums[0], o.mul(alpha, scale)))
    return o.mul(sums[0], scale)


EXACTLY_DIVIDED = 7
"""Coefficients up to this one are divided by their number in two parts: 1/3, rounded, is always wrong by as much, and
what it does to the motion would add up where random errors do not."""


def expand(o: Operations, a: Arrangement, order: int, y0: Vector, tables: tuple[Vector, Vector, Vector]) -> None:
    """Store the coefficients 0..order of the solution through ``y0`` as the array ``y``.

    ``tables`` are (alpha | 1), (beta | 0) and (-delta | 0) in the lanes of (omega | gamma).
    """
    alpha, beta, delta = tables
    _keep(o, a, 0, y0, alpha)
    turned = [o.permute(y0, lanes) for lanes in a.turns]
    if len(turned) == 2:
        by_j, by_k = o.mul(turned[1], alpha), o.mul(turned[0], alpha)
        jacobian = [by_j, by_k]
        y = o.mul(by_k, turned[1])
    else:
        minus = _mask(o, -1.0)
        by_j = o.fma(o.permute(y0, (2, 0, 1, -1, -1, -1, 6, 7)), alpha, o.mul(o.permute(y0, _OWN_K), minus))
        by_k = o.mul(o.permute(y0, _OWN_J), alpha)
        jacobian = [by_j, by_k, o.fma(turned[1], _mask(o, 1.0), beta), o.fma(turned[0], minus, delta)]
        pull = o.fma(beta, turned[2], o.mul(delta, turned[3]))
        y = o.fma(by_k, turned[1], o.fma(o.mul(o.permute(y0, _OWN_K), minus), turned[0], pull))
    ahead: list[Vector] | None = None
    for m in range(1, order):
        _keep(o, a, m, y, alpha)
        known = None
        missing = float(Fraction(1, m + 1) - Fraction(1.0 / (m + 1)))
        early = m + 1 <= EXACTLY_DIVIDED and missing != 0.0
        if m >= 2:
            if ahead is None:
                now, ahead = _two_sums(o, a, m, m + 1 < order)
            else:
                now, ahead = _finished(o, a, m, ahead), None
            known = _folded(o, a, now, alpha, 1.0 if early else 1.0 / (m + 1))
        inverse = _ones(o, 1.0 / (m + 1))
        columns = jacobian if early else [o.mul(column, inverse) for column in jacobian]
        turned = [o.permute(y, lanes) for lanes in a.turns]
        left = o.mul(columns[0], turned[0]) if known is None else o.fma(columns[0], turned[0], known)
        right = o.mul(columns[1], turned[1])
        if len(turned) == 4:
            left, right = o.fma(columns[2], turned[2], left), o.fma(columns[3], turned[3], right)
        y = o.add(left, right)
        if early:
            y = o.fma(y, inverse, o.mul(y, _ones(o, missing)))
    o.store("y", order, y)


def _two_sums(o: Operations, a: Arrangement, m: int, both: bool) -> tuple[list[Vector], list[Vector] | None]:
    """The sums over k = 1..m-1 of the products y_k y_(m-k), and those over 2..m-1 of y_k y_(m+1-k), for later.

    Each in two halves, because a sum of one chain of additions would be waited for.
    """
    now: list[Vector] = []
    later: list[Vector] = []
    for left, right in _pairs(a):
        sums: dict[tuple[int, int], Vector] = {}

        def gather(which: int, k: int, x: Vector, z: Vector, sums: dict[tuple[int, int], Vector] = sums) -> None:
            slot = (which, k % 2)
            sums[slot] = o.fma(x, z, sums[slot]) if slot in sums else o.mul(x, z)

        previous = o.load(right, m - 1) if both and m > 2 else None
        for k in range(2, m):
            x = o.load(left, k)
            z = o.load(right, m - k) if k < m - 1 else None
            if k < m - 1:
                gather(0, k, x, z)
            if both:
                gather(1, k, x, previous)
            previous = z
        for k in {1, m - 1}:
            gather(0, k if m > 2 else 0, o.load(left, k), o.load(right, m - k))
        now.append(_joined(o, sums, 0))
        later.append(_joined(o, sums, 1))
    return now, (later if both else None)


def _joined(o: Operations, sums: dict[tuple[int, int], Vector], which: int) -> Vector | None:
    """The two halves together; None where there is neither."""
    halves = [sums[which, k] for k in (0, 1) if (which, k) in sums]
    return o.add(*halves) if len(halves) == 2 else halves[0] if halves else None


def _finished(o: Operations, a: Arrangement, m: int, sums: list[Vector]) -> list[Vector]:
    """The sums for m from those over k = 2..m-2, with the two products of the newest coefficient."""
    found = []
    for (left, right), total in zip(_pairs(a), sums, strict=True):
        one = o.mul(o.load(left, 1), o.load(right, m - 1))
        other = o.load(left, m - 1), o.load(right, 1)
        found.append(o.add(one, o.mul(*other) if total is None else o.fma(*other, total)))
    return found


def tail(o: Operations, order: int, d: Scalar) -> Vector:
    """The sum of y_m d^m over m = 1..order: four sums by Horner's rule in d^4, side by side."""
    d2 = o.mul(d, d)
    z, z4 = o.splat(d), o.splat(o.mul(d2, d2))
    parts: list[Vector] = []
    for first in range(1, 5):
        total = None
        for m in range(first + (order - first) // 4 * 4, 0, -4):
            y = o.load("y", m)
            total = y if total is None else o.fma(total, z4, y)
        parts.append(total)
    total = parts[3]
    for part in parts[2::-1]:
        total = o.fma(total, z, part)
    return o.mul(total, z)


LONGEST = 4.0
"""The longest step, in units in which the rates of change are of the order of one: where the series ends."""
SHARE = 0.6
"""The longest step in units of the radius of convergence that the later coefficients tell."""


def natural_step(o: Operations, order: int, log2_tol: Scalar) -> tuple[Scalar, Scalar]:
    """The step over which the last two terms stay below tol times the state; and a logarithm that tells inf and nan.

    As Jorba and Zou (Exp. Math. 14, 2005) take the radius from two coefficients, lest one vanish by symmetry. Where
    they are small for another reason than the radius, the ratio to the middle ones bounds the step.
    """
    half = order // 2
    y0, before, last = (o.logarithm(o.load("y", m)) for m in (0, order - 1, order))
    middle = o.largest(o.logarithm(o.load("y", half - 1)), o.logarithm(o.load("y", half)))
    late = o.largest(before, last)
    level = o.add(y0, log2_tol)
    first = o.mul(o.sub(level, before), o.number(1.0 / (order - 1)))
    second = o.mul(o.sub(level, last), o.number(1.0 / order))
    ratio = o.mul(o.sub(middle, late), o.number(1.0 / (order - half)))
    bound = o.add(ratio, o.number(math.log2(SHARE)))
    step = o.least(o.least(first, second), bound)
    return o.power(o.largest(o.least(step, o.number(2.0)), o.number(-1000.0))), late
