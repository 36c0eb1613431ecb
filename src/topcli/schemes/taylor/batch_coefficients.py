"""The coefficients of eight Taylor series side by side, with half of the multiplications saved.

Every component is a vector of its own. The sums of products that the coefficients need are formed by pairs of indices,

    x_k z_l + x_l z_k = (x_k + x_l)(z_k + z_l) - x_k z_k - x_l z_l,

where the sum of two coefficients serves all products of the equations, and what is subtracted over all pairs is one
running sum. The sums for m and m + 1 are formed in one go, so that each coefficient is loaded once for both.
"""

from __future__ import annotations

from functools import partial, reduce

from topcli.schemes.taylor.llvm_vectors import Text
from topcli.schemes.taylor.vectors import Pair, product, scaled, total

LANES = 8
DIRECT = 7
"""From this coefficient on the sums go by pairs, x_k z_l + x_l z_k = (x_k + x_l)(z_k + z_l) - x_k z_k - x_l z_l, with
half of the multiplications; what they round is then too small a share of the motion to count,
as long as the unit of time is near the radius of convergence."""


def _terms(d: int, lacks: frozenset[str]) -> list[tuple[str, int, int, bool]]:
    """The products of the equations: what they add up to, the two components, and whether they are subtracted."""
    terms = []
    for i in range(3):
        j, n = (i + 1) % 3, (i + 2) % 3
        if f"alpha{i}" not in lacks:
            terms.append((f"w{i}", j, n, False))
        if d == 6:
            terms += [(f"g{i}", 3 + j, n, False), (f"g{i}", 3 + n, j, True)]
    return terms


Sums = dict[str, str]


class Products:
    """Sums of products of whole coefficients."""

    def __init__(self, o: Text, d: int, lacks: frozenset[str]) -> None:
        self.o, self.d, self.terms = o, d, _terms(d, lacks)
        self.alone: Sums = {}
        self.ahead: dict[int, Sums] = {}

    def coefficient(self, m: int) -> list[str]:
        """The components of coefficient m."""
        return [self.o.load("y", m * self.d + c) for c in range(self.d)]

    def gather(self, sums: Sums, x: list[str], z: list[str]) -> None:
        """Add the products of ``x`` and ``z`` to the sums."""
        o = self.o
        for name, i, j, less in self.terms:
            if name not in sums:
                sums[name] = o.mul(x[i], z[j])
            else:
                sums[name] = o.fma(o.negative(x[i]) if less else x[i], z[j], sums[name])

    def pair(self, sums: Sums, x: list[str], z: list[str]) -> None:
        """Add the products of x and z and those of z and x, but for what x gives with itself and z with itself."""
        both = [self.o.add(one, other) for one, other in zip(x, z, strict=True)]
        self.gather(sums, both, x if x is z else both)

    def direct(self, m: int) -> Sums:
        """The sums over k = 0..m of the products of y_k and y_(m-k), one by one."""
        sums: Sums = {}
        for k in range(m, -1, -1):
            self.gather(sums, self.coefficient(k), self.coefficient(m - k))
        return sums

    def by_pairs(self, m: int, both: bool) -> Sums:
        """The same by pairs; with ``both`` the pairs for m + 1 of the coefficients up to m as well, for later."""
        sums = self.ahead.pop(m, None)
        if sums is not None:
            self.pair(sums, self.coefficient(0), self.coefficient(m))
            return sums
        sums, later = {}, {}
        before = None
        for k in range((m + both) // 2, -1, -1):
            low, high = self.coefficient(k), self.coefficient(m - k)
            if 2 * k <= m:
                self.pair(sums, low, low if 2 * k == m else high)
            if both and before is not None:
                self.pair(later, before, before if 2 * (k + 1) == m + 1 else high)
            before = low
        if both:
            self.ahead[m + 1] = later
        return sums


def _slopes(o: Text, d: int, lacks: frozenset[str]) -> list[Pair]:
    """The first coefficients to more than a double: alpha omega x omega + beta gamma + delta gamma, gamma x omega."""
    y = [(f"%hi{c}", f"%lo{c}") for c in range(d)]
    found: list[Pair] = []
    for i in range(d):
        j, n = (i + 1) % 3, (i + 2) % 3
        if i < 3:
            terms = [scaled(o, f"%alpha{i}", product(o, y[j], y[n]))] if f"alpha{i}" not in lacks else []
            pulls = (("beta", 3 + j), ("delta", 3 + n)) if d == 6 else ()
            terms += [scaled(o, f"%{name}{i}", y[c]) for name, c in pulls if f"{name}{i}" not in lacks]
        else:
            away = o.negative(y[3 + n][0]), o.negative(y[3 + n][1])
            terms = [product(o, y[3 + j], y[n]), product(o, away, y[j])]
        found.append(reduce(partial(total, o), terms) if terms else ("zeroinitializer", "zeroinitializer"))
    return found


def expand_all(o: Text, d: int, order: int, lacks: frozenset[str]) -> list[str]:
    """Store the coefficients 1..order of the d series, where 0 is stored; what coefficients 1 round."""
    products = Products(o, d, lacks)
    products.gather(products.alone, products.coefficient(0), products.coefficient(0))
    slopes = _slopes(o, d, lacks)
    for c, (slope, _) in enumerate(slopes):
        o.store("y", d + c, slope)
    for m in range(1, order):
        newest = products.coefficient(m)
        products.gather(products.alone, newest, newest)
        if m < DIRECT:
            sums = products.direct(m)
        else:
            sums = products.by_pairs(m, m + 1 < order)
            sums = {name: o.sub(found, products.alone[name]) for name, found in sums.items()}
        scale = o.constant((1.0 / (m + 1),) * LANES)
        for i in range(3):
            rate = o.mul(sums[f"w{i}"], f"%alpha{i}") if f"w{i}" in sums else None
            for name, c in (("beta", 3 + (i + 1) % 3), ("delta", 3 + (i + 2) % 3)):
                if d == 6 and f"{name}{i}" not in lacks:
                    pull = newest[c]
                    rate = o.mul(f"%{name}{i}", pull) if rate is None else o.fma(f"%{name}{i}", pull, rate)
            o.store("y", (m + 1) * d + i, "zeroinitializer" if rate is None else o.mul(rate, scale))
            if d == 6:
                o.store("y", (m + 1) * d + 3 + i, o.mul(sums[f"g{i}"], scale))
        o.cut()
    return [missed for _, missed in slopes]
