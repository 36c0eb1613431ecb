"""Taylor series of the Euler-Poisson equations, arranged for SIMD vectors.

With y = (omega, gamma) and i, j, k cyclic the equations (Sogo, (Euler) and (Poisson)) are quadratic,

    omega_i' = alpha_i omega_j omega_k + beta_i gamma_j - delta_i gamma_k,
    gamma_i' = gamma_j omega_k - gamma_k omega_j,

and the coefficients y_m of their solution sum y_m t^m satisfy (m + 1) y_(m+1) = J y_m + sum y_k * y_(m-k), the sum over
k = 1..m-1, with J the Jacobian at y_0 and * the bilinear part. The series of all components share one vector:

- the critical path of a coefficient is J y_m, four products with permutations of y_m, which are also factors of later
  sums; the division by m + 1 is a multiplication, exact where its rounding errors would accumulate;
- for each k the sum needs one fused multiply-add of vectors if at most eight of the nine products occur (``SYMMETRIC``:
  alpha_3 = 0), else two; it is computed two coefficients ahead of y_m;
- the step size is chosen from coefficients before the last ones, while those are computed.

The state has more than double precision, and at the largest order so has the first coefficient. The other coefficients,
with their rounding errors, are multiplied by powers of a step well below one.

The algorithm is written in terms of the methods of ``taylor_vectors.IRWriter``, so that the generation of LLVM IR and a
plain interpreter in the tests share it; both give the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from topcli.contracts import Array
from topcli.schemes.any_top.taylor_vectors import IRWriter, Scalar, Vector, pair_add, pair_mul, pair_scale


@dataclass(frozen=True)
class Arrangement:
    """Assignment of the components of the state to the lanes of the factors.

    ``factors`` are permutations of the components; the equations consist of products of pairs of them. The first pair
    gives omega_j omega_k or gamma_j omega_k in the lanes of omega_i or gamma_i. The second pair, present if there is a
    vertical, has gamma_j | omega_j and gamma_k | gamma_k, and its products are subtracted in the lanes of gamma_i.
    ``folded``, if set, moves products from spare lanes of the first pair to the lanes where they are subtracted. The
    first factor contains every component; its order is the order of the stored state.
    """

    lanes: int
    factors: tuple[tuple[int, ...], ...]
    folded: tuple[int, ...] | None = None

    @property
    def stored_factors(self) -> str:
        """Names of the factors that the sums of products need."""
        return "ab" if self.folded or len(self.factors) == 2 else "abcd"

    @property
    def component_lanes(self) -> tuple[int, ...]:
        """Lane of each component in the stored state."""
        return tuple(self.factors[0].index(k) for k in range(3 if self.lanes == 4 else 6))

    def to_lanes(self, y: Sequence[float] | Array) -> tuple[float, ...]:
        """Return the components ``y`` in the lane order of the stored state."""
        return tuple(y[k] if k < len(y) else 0.0 for k in self.factors[0])


FREE = Arrangement(4, ((1, 2, 0, 3), (2, 0, 1, 3)))
"""Arrangement for omega alone: the Euler top."""
_LAST = ((4, 5, 3, 1, 2, 0, 3, 3), (5, 3, 4, 5, 3, 4, 3, 3))
GENERAL = Arrangement(8, ((1, 2, 0, 4, 5, 3, 6, 7), (2, 0, 1, 2, 0, 1, 6, 7), *_LAST))
"""Arrangement for any top."""
SYMMETRIC = Arrangement(8, ((1, 2, 0, 4, 5, 3, 5, 3), (2, 0, 4, 2, 0, 1, 1, 2), *_LAST), (-1, -1, -1, 6, 7, 2, -1, -1))
"""Arrangement for A = B: without omega_1 omega_2 there are eight products, one per lane; lane 2 belongs to gamma_3."""


def arrangement_of(components: int, alpha3: float) -> Arrangement:
    """Return the cheapest arrangement for a state with this number of components."""
    if components == 3:
        return FREE
    return SYMMETRIC if alpha3 == 0.0 else GENERAL


def _minus_gamma(o: IRWriter) -> Vector:
    """Vector with -1 in the lanes of gamma, else 0."""
    return o.constant((0.0, 0.0, 0.0, -1.0, -1.0, -1.0, 0.0, 0.0)[: o.lanes])


def _filled(o: IRWriter, value: float) -> Vector:
    """Vector with the value in all lanes that hold a component, else 0."""
    return o.constant((value,) * 3 + (0.0,) if o.lanes == 4 else (value,) * 6 + (0.0, 0.0))


def _store_factors(o: IRWriter, a: Arrangement, m: int, factors: list[Vector]) -> list[Vector]:
    """Store those factors of coefficient m that later sums need; return all factors."""
    for name, factor in zip(a.stored_factors, factors, strict=False):
        o.store(name, m, factor)
    return factors


def _pairs(a: Arrangement) -> tuple[tuple[str, str], ...]:
    return (("a", "b"), ("c", "d"))[: len(a.stored_factors) // 2]


def _fold(o: IRWriter, a: Arrangement, sums: list[Vector], alpha: Vector) -> Vector:
    """Combine the sums of products into one vector in the lanes of the components."""
    first = o.mul(sums[0], alpha)
    if a.folded:
        return o.sub(first, o.permute(sums[0], a.folded))
    return o.fma(sums[1], _minus_gamma(o), first) if len(sums) == 2 else first


STEP_SIZE_LEAD = 3
"""Distance from the last coefficient to those that determine the step size, which is then known at the same time."""
EXACTLY_DIVIDED = 7
"""Coefficients up to this one are divided by their index with the inverse in two parts: the rounding error of 1/3 is
the same in every step, and its effect would accumulate systematically."""


def expand(
    o: IRWriter,
    a: Arrangement,
    order: int,
    y0: tuple[Vector, Vector | None],
    tables: tuple[Vector, Vector, Vector],
    log2_tol: Scalar,
) -> tuple[Scalar, Scalar, Vector | None]:
    """Store the coefficients 0..order of the solution through ``y0`` as the array ``a``, in the lane order of ``y0``.

    ``y0`` is the state and its low part, or None for the low part. ``tables`` are (alpha | 1), (beta | 0) and
    (-delta | 0) in the lanes of (omega | gamma). Returns the two results of ``step_size`` and the low part of
    coefficient 1, which is None if ``y0`` has no low part; coefficient 1 then has double precision only.
    """
    alpha, beta, delta = tables
    at = dict(zip(a.factors[0][::-1], range(a.lanes - 1, -1, -1), strict=True))
    turns = [tuple(at[k] for k in lanes) for lanes in a.factors]
    factors = _store_factors(o, a, 0, [y0[0], *(o.permute(y0[0], lanes) for lanes in turns[1:])])
    jacobian = [o.mul(factors[1], alpha), o.mul(factors[0], alpha)]
    minus = _minus_gamma(o)
    if len(factors) == 4:
        jacobian += [o.fma(factors[3], minus, beta), o.fma(factors[2], minus, delta)]
    y, missed = o.mul(jacobian[1], factors[1]), None
    if y0[1] is not None:
        lower = [y0[1], *(o.permute(y0[1], lanes) for lanes in turns[1:])]
        f = list(zip(factors, lower, strict=True))
        slope = pair_scale(o, alpha, pair_mul(o, f[0], f[1]))
        if len(factors) == 4:
            turning = pair_mul(o, (jacobian[2], o.mul(lower[3], minus)), f[2])
            slope = pair_add(o, slope, pair_add(o, turning, pair_scale(o, delta, f[3])))
        y, missed = slope[0], o.permute(slope[1], a.factors[0])
    elif len(factors) == 4:
        y = o.add(y, o.fma(jacobian[2], factors[2], o.mul(delta, factors[3])))
    sums = _ProductSums(o, a)
    step: tuple[Scalar, Scalar] = (None, None)
    for m in range(1, order):
        factors, known = _store_factors(o, a, m, [o.permute(y, lanes) for lanes in a.factors]), None
        if m == order - STEP_SIZE_LEAD:
            step = step_size(o, order, log2_tol)
        if m >= 2:
            known = _fold(o, a, sums.complete(m), alpha)
        y = _linear(o, jacobian, factors, known)
        inverse = 1.0 / (m + 1)
        missing = float(Fraction(1, m + 1) - Fraction(inverse))
        if missing != 0.0 and m < EXACTLY_DIVIDED:
            small = [o.mul(column, _filled(o, missing)) for column in jacobian]
            rest = _linear(o, small, factors, None if known is None else o.mul(known, _filled(o, missing)))
            y = o.fma(y, _filled(o, inverse), rest)
        else:
            y = o.mul(y, _filled(o, inverse))
        sums.accumulate_ahead(m, order)
        o.barrier()
    o.store("a", order, o.permute(y, a.factors[0]))
    return step[0], step[1], missed


def _linear(o: IRWriter, columns: list[Vector], factors: list[Vector], known: Vector | None) -> Vector:
    """Sum of the products of columns and factors, plus ``known``; in two halves, for a short dependency chain."""
    left = o.mul(columns[0], factors[0]) if known is None else o.fma(columns[0], factors[0], known)
    right = o.mul(columns[1], factors[1])
    if len(factors) == 4:
        left, right = o.fma(columns[2], factors[2], left), o.fma(columns[3], factors[3], right)
    return o.add(left, right)


class _ProductSums:
    """Sums over k = 1..m-1 of the products y_k y_(m-k), computed in pairs, two coefficients ahead.

    The products of older coefficients are added after the instructions of the critical path, so that the latter are
    issued first; the few products with one of the last two or three coefficients are added in ``complete``. Each sum
    has two halves, to shorten its dependency chain.
    """

    def __init__(self, o: IRWriter, a: Arrangement) -> None:
        self.o, self.pairs = o, _pairs(a)
        self.halves: dict[tuple[int, int, int], Vector] = {}

    def _gather(self, m: int, k: int, half: int) -> None:
        o = self.o
        for n, (left, right) in enumerate(self.pairs):
            x, z, slot = o.load(left, k), o.load(right, m - k), (m, n, half)
            self.halves[slot] = o.fma(x, z, self.halves[slot]) if slot in self.halves else o.mul(x, z)

    def accumulate_ahead(self, m: int, order: int) -> None:
        """Add products of y_1..y_(m-1) to the sums for m + 2 and m + 3, m even: half of them now, half at m + 1."""
        even = m - m % 2
        ks = range(1, even)
        middle = len(ks) // 2
        for k in ks[middle:] if m % 2 else ks[:middle]:
            for target in (even + 2, even + 3):
                if target < order and target - k < even:
                    self._gather(target, k, k % 2)

    def complete(self, m: int) -> list[Vector]:
        """Add the remaining products and return the sums for m."""
        newer = m - 2 - m % 2
        rest = [k for k in range(1, m) if k >= newer or m - k >= newer]
        for k in sorted(rest, key=lambda k: max(k, m - k)):
            self._gather(m, k, int(2 * k > m))
        sums = []
        for n in range(len(self.pairs)):
            both = [self.halves[m, n, half] for half in (0, 1) if (m, n, half) in self.halves]
            sums.append(self.o.add(*both) if len(both) == 2 else both[0])
        return sums


def taylor_increment(o: IRWriter, order: int, d: Scalar, missed: Vector | None) -> tuple[Vector, Vector]:
    """Return the sum of y_m d^m over m = 1..order as y_1 d rounded, and the rest; ``missed`` is the low part of y_1.

    The rest is summed by pairs, pairs of pairs and so on (Estrin's scheme), for a short dependency chain.
    """
    z, power = o.splat(d), d
    terms = [o.load("a", m) for m in range(2, order + 1)]
    while len(terms) > 1:
        factor = o.splat(power)
        joined = [o.fma(high, factor, low) for low, high in zip(terms[::2], terms[1::2], strict=False)]
        terms = joined + terms[2 * len(joined) :]
        power = o.mul(power, power)
    first = o.load("a", 1)
    main = o.mul(first, z)
    rest = o.mul(terms[0], z) if missed is None else o.fma(terms[0], z, missed)
    return main, o.fma(rest, z, o.fma(first, z, o.negative(main)))


MAX_STEP = 4.0
"""Longest step, in units in which the rates of change are of order one; relevant for a series that terminates."""
MAX_RADIUS_FRACTION = 0.6
"""Longest step, as a fraction of the radius of convergence estimated from the later coefficients."""


def step_size(o: IRWriter, order: int, log2_tol: Scalar) -> tuple[Scalar, Scalar]:
    """Return the step for which the last term stays below tol times the state, and a logarithm to detect inf and nan.

    As in Jorba and Zou (Exp. Math. 14, 2005), the radius is estimated from two coefficients, because one may vanish by
    symmetry; these are not the last two, so that the estimate overlaps with their computation. If the coefficients are
    small for another reason than the radius, the ratio to the middle ones bounds the step.
    """
    half, last = order // 2, order - STEP_SIZE_LEAD
    y0, before, late = (o.logarithm(o.load("a", m)) for m in (0, last - 1, last))
    middle = o.largest(o.logarithm(o.load("a", half - 1)), o.logarithm(o.load("a", half)))
    least = o.largest(before, late)
    first = o.mul(o.sub(y0, before), o.number(1.0 / (last - 1)))
    second = o.mul(o.sub(y0, late), o.number(1.0 / last))
    ratio = o.mul(o.sub(middle, least), o.number(1.0 / (last - half)))
    share = o.mul(log2_tol, o.number(1.0 / (order - 1)))
    step = o.least(o.add(o.least(first, second), share), o.add(ratio, o.number(math.log2(MAX_RADIUS_FRACTION))))
    return o.power(o.largest(o.least(step, o.number(math.log2(MAX_STEP))), o.number(-1000.0))), least
