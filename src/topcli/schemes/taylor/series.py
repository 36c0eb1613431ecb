"""Taylor series of the Euler-Poisson equations, arranged for the vector units of a processor.

With y = (omega, gamma) and i, j, k cyclic the equations (Sogo, (Euler) and (Poisson)) are quadratic,

    omega_i' = alpha_i omega_j omega_k + beta_i gamma_j - delta_i gamma_k,
    gamma_i' = gamma_j omega_k - gamma_k omega_j,

and the coefficients y_m of their solution sum y_m t^m obey (m + 1) y_(m+1) = J y_m + sum y_k * y_(m-k), the sum over
k = 1..m-1, with J the Jacobian at y_0 and * the bilinear part. All series lie side by side in the lanes of one vector:

- what each coefficient waits for is J y_m alone, four products with permutations of y_m, which are factors of the sums
  to come as well; the division by m + 1 is a multiplication, exact where its rounding would add up;
- the sum takes one fused multiply-add of whole vectors for each k where at most eight of its nine products are there
  (``SYMMETRIC``: alpha_3 = 0), two in general, and runs two coefficients ahead of the chain of the y_m;
- the step is found from coefficients before the last ones, while those are formed.

The state is carried to more than a double, and at the greatest order the first coefficient is too: the others are
multiplied by powers of a step well below one, and so is what they round.

Everything is written once in terms of ``vectors.Operations``: ``vector_ir`` turns them into LLVM's language,
``vector_plain`` executes them with Python's floats, and both give the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from topcli.contracts import Array
from topcli.schemes.taylor.vectors import Operations, Scalar, Vector, product, scaled, total


@dataclass(frozen=True)
class Arrangement:
    """Which component stands in which lane of the factors.

    ``factors`` are the permutations whose products two by two make up the equations: omega_j omega_k or gamma_j omega_k
    in the lanes of omega_i or gamma_i, and where there is a vertical, gamma_j | omega_j and gamma_k | gamma_k, of whose
    products the lanes of gamma_i are subtracted. ``folded`` permutes the first product into the second, where it has
    spare lanes for it. The first factor holds every component: it is the order in which the state stands.
    """

    lanes: int
    factors: tuple[tuple[int, ...], ...]
    folded: tuple[int, ...] | None = None

    @property
    def kept(self) -> str:
        """The names of the factors that the sums of products need."""
        return "ab" if self.folded or len(self.factors) == 2 else "abcd"

    @property
    def places(self) -> tuple[int, ...]:
        """The lane of the state in which each component stands."""
        return tuple(self.factors[0].index(k) for k in range(3 if self.lanes == 4 else 6))

    def spread(self, y: Sequence[float] | Array) -> tuple[float, ...]:
        """The components in the lanes of the state."""
        return tuple(y[k] if k < len(y) else 0.0 for k in self.factors[0])


FREE = Arrangement(4, ((1, 2, 0, 3), (2, 0, 1, 3)))
"""omega alone: the Euler top."""
_LAST = ((4, 5, 3, 1, 2, 0, 3, 3), (5, 3, 4, 5, 3, 4, 3, 3))
GENERAL = Arrangement(8, ((1, 2, 0, 4, 5, 3, 6, 7), (2, 0, 1, 2, 0, 1, 6, 7), *_LAST))
"""Any top."""
SYMMETRIC = Arrangement(8, ((1, 2, 0, 4, 5, 3, 5, 3), (2, 0, 4, 2, 0, 1, 1, 2), *_LAST), (-1, -1, -1, 6, 7, 2, -1, -1))
"""A = B: without omega_1 omega_2 there are eight products, a lane each; lane 2 belongs to gamma_3."""


def arrangement_of(components: int, alpha3: float) -> Arrangement:
    """The cheapest arrangement for a state of so many components."""
    if components == 3:
        return FREE
    return SYMMETRIC if alpha3 == 0.0 else GENERAL


def _minus(o: Operations) -> Vector:
    """-1 in the lanes of gamma."""
    return o.constant((0.0, 0.0, 0.0, -1.0, -1.0, -1.0, 0.0, 0.0)[: o.lanes])


def _ones(o: Operations, value: float) -> Vector:
    """The value in all lanes that hold a component."""
    return o.constant((value,) * 3 + (0.0,) if o.lanes == 4 else (value,) * 6 + (0.0, 0.0))


def _kept(o: Operations, a: Arrangement, m: int, factors: list[Vector]) -> list[Vector]:
    """The factors of coefficient m, of which those that later sums need are stored."""
    for name, factor in zip(a.kept, factors, strict=False):
        o.store(name, m, factor)
    return factors


def _pairs(a: Arrangement) -> tuple[tuple[str, str], ...]:
    return (("a", "b"), ("c", "d"))[: len(a.kept) // 2]


def _folded(o: Operations, a: Arrangement, sums: list[Vector], alpha: Vector) -> Vector:
    """The sum, in the lanes of the components, from the sums of products."""
    first = o.mul(sums[0], alpha)
    if a.folded:
        return o.sub(first, o.permute(sums[0], a.folded))
    return o.fma(sums[1], _minus(o), first) if len(sums) == 2 else first


EARLY = 3
"""The step is chosen by the coefficients so far from the last, so that it is known when those are."""
EXACTLY_DIVIDED = 7
"""Coefficients up to this one are divided by their number in two parts: 1/3, rounded, is always wrong by as much, and
what it does to the motion would add up where random errors do not."""


def expand(
    o: Operations,
    a: Arrangement,
    order: int,
    y0: tuple[Vector, Vector | None],
    tables: tuple[Vector, Vector, Vector],
    log2_tol: Scalar,
) -> tuple[Scalar, Scalar, Vector | None]:
    """Store the coefficients 0..order of the solution through ``y0`` as the array ``a``.

    They stand in the order of the state, ``y0``. ``tables`` are (alpha | 1), (beta | 0) and (-delta | 0) in the lanes
    of (omega | gamma). Returns ``natural_step``'s two and what coefficient 1 rounds. This is None where ``y0``'s second
    part, by which the state is more than the first one, is none: the first coefficient is then to round-off only.
    """
    alpha, beta, delta = tables
    at = dict(zip(a.factors[0][::-1], range(a.lanes - 1, -1, -1), strict=True))
    turns = [tuple(at[k] for k in lanes) for lanes in a.factors]
    factors = _kept(o, a, 0, [y0[0], *(o.permute(y0[0], lanes) for lanes in turns[1:])])
    jacobian = [o.mul(factors[1], alpha), o.mul(factors[0], alpha)]
    minus = _minus(o)
    if len(factors) == 4:
        jacobian += [o.fma(factors[3], minus, beta), o.fma(factors[2], minus, delta)]
    y, missed = o.mul(jacobian[1], factors[1]), None
    if y0[1] is not None:
        lower = [y0[1], *(o.permute(y0[1], lanes) for lanes in turns[1:])]
        f = list(zip(factors, lower, strict=True))
        slope = scaled(o, alpha, product(o, f[0], f[1]))
        if len(factors) == 4:
            turning = product(o, (jacobian[2], o.mul(lower[3], minus)), f[2])
            slope = total(o, slope, total(o, turning, scaled(o, delta, f[3])))
        y, missed = slope[0], o.permute(slope[1], a.factors[0])
    elif len(factors) == 4:
        y = o.add(y, o.fma(jacobian[2], factors[2], o.mul(delta, factors[3])))
    sums = _Sums(o, a)
    step: tuple[Scalar, Scalar] = (None, None)
    for m in range(1, order):
        factors, known = _kept(o, a, m, [o.permute(y, lanes) for lanes in a.factors]), None
        if m == order - EARLY:
            step = natural_step(o, order, log2_tol)
        if m >= 2:
            known = _folded(o, a, sums.of(m), alpha)
        y = _linear(o, jacobian, factors, known)
        inverse = 1.0 / (m + 1)
        missing = float(Fraction(1, m + 1) - Fraction(inverse))
        if missing != 0.0 and m < EXACTLY_DIVIDED:
            small = [o.mul(column, _ones(o, missing)) for column in jacobian]
            rest = _linear(o, small, factors, None if known is None else o.mul(known, _ones(o, missing)))
            y = o.fma(y, _ones(o, inverse), rest)
        else:
            y = o.mul(y, _ones(o, inverse))
        sums.run_ahead(m, order)
        o.cut()
    o.store("a", order, o.permute(y, a.factors[0]))
    return step[0], step[1], missed


def _linear(o: Operations, columns: list[Vector], factors: list[Vector], known: Vector | None) -> Vector:
    """The columns times the factors, and what is known: in two halves, for the shortest chain."""
    left = o.mul(columns[0], factors[0]) if known is None else o.fma(columns[0], factors[0], known)
    right = o.mul(columns[1], factors[1])
    if len(factors) == 4:
        left, right = o.fma(columns[2], factors[2], left), o.fma(columns[3], factors[3], right)
    return o.add(left, right)


class _Sums:
    """The sums over k = 1..m-1 of the products y_k y_(m-k), formed two and two, two coefficients ahead.

    Those of older coefficients are added up after the links of the chain, whose instructions so come first and go
    first; the few with one of the last two or three when the sum is asked for. In two halves each, because a sum of one
    chain of additions would be waited for.
    """

    def __init__(self, o: Operations, a: Arrangement) -> None:
        self.o, self.pairs = o, _pairs(a)
        self.halves: dict[tuple[int, int, int], Vector] = {}

    def _gather(self, m: int, k: int, half: int) -> None:
        o = self.o
        for n, (left, right) in enumerate(self.pairs):
            x, z, slot = o.load(left, k), o.load(right, m - k), (m, n, half)
            self.halves[slot] = o.fma(x, z, self.halves[slot]) if slot in self.halves else o.mul(x, z)

    def run_ahead(self, m: int, order: int) -> None:
        """What y_1 to y_(m-1) give to the sums for m + 2 and m + 3 with an even m: half of it now, half with m + 1."""
        even = m - m % 2
        ks = range(1, even)
        middle = len(ks) // 2
        for k in ks[middle:] if m % 2 else ks[:middle]:
            for target in (even + 2, even + 3):
                if target < order and target - k < even:
                    self._gather(target, k, k % 2)

    def of(self, m: int) -> list[Vector]:
        """The sums for m."""
        newer = m - 2 - m % 2
        rest = [k for k in range(1, m) if k >= newer or m - k >= newer]
        for k in sorted(rest, key=lambda k: max(k, m - k)):
            self._gather(m, k, int(2 * k > m))
        found = []
        for n in range(len(self.pairs)):
            both = [self.halves[m, n, half] for half in (0, 1) if (m, n, half) in self.halves]
            found.append(self.o.add(*both) if len(both) == 2 else both[0])
        return found


def tail(o: Operations, order: int, d: Scalar, missed: Vector | None) -> tuple[Vector, Vector]:
    """The sum of y_m d^m over m = 1..order: y_1 d rounded, and the rest; ``missed`` is what y_1 rounded.

    The rest by pairs, pairs of pairs and so on, for the shortest chain.
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


LONGEST = 4.0
"""The longest step, in units in which the rates of change are of the order of one: where the series ends."""
SHARE = 0.6
"""The longest step in units of the radius of convergence that the later coefficients tell."""


def natural_step(o: Operations, order: int, log2_tol: Scalar) -> tuple[Scalar, Scalar]:
    """The step over which the last term stays below tol times the state; and a logarithm that tells inf and nan.

    As Jorba and Zou (Exp. Math. 14, 2005) take the radius from two coefficients, lest one vanish by symmetry; not from
    the last two, so that it is found while those are. Where they are small for another reason than the radius, the
    ratio to the middle ones bounds the step.
    """
    half, last = order // 2, order - EARLY
    y0, before, late = (o.logarithm(o.load("a", m)) for m in (0, last - 1, last))
    middle = o.largest(o.logarithm(o.load("a", half - 1)), o.logarithm(o.load("a", half)))
    least = o.largest(before, late)
    first = o.mul(o.sub(y0, before), o.number(1.0 / (last - 1)))
    second = o.mul(o.sub(y0, late), o.number(1.0 / last))
    ratio = o.mul(o.sub(middle, least), o.number(1.0 / (last - half)))
    share = o.mul(log2_tol, o.number(1.0 / (order - 1)))
    step = o.least(o.add(o.least(first, second), share), o.add(ratio, o.number(math.log2(SHARE))))
    return o.power(o.largest(o.least(step, o.number(math.log2(LONGEST))), o.number(-1000.0))), least
