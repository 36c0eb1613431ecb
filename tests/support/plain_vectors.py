"""The vector operations of ``series`` executed with Python's floats, and the time loop around them.

The twin of the machine code, bit for bit, to test it with: slow, because it rounds its fused products by fractions.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, MutableSequence, Sequence
from fractions import Fraction

from topcli.schemes.any_top.taylor import (
    EXACT_REACH,
    FRACTION,
    LAG,
    LOG2_TOL,
    MAX_EXPANSIONS,
    STEP,
    TIME,
    UNITS,
)
from topcli.schemes.any_top.taylor_series import Arrangement, expand, taylor_increment
from topcli.schemes.any_top.taylor_vectors import POWER, ROUNDING, two_sum

Vector = tuple[float, ...]


Either = float | Vector


def fused(x: float, y: float, z: float) -> float:
    """X y + z, rounded once."""
    try:
        total = Fraction(x) * Fraction(y) + Fraction(z)
        return float(total) if total else x * y + z
    except (ValueError, OverflowError):  # inf and nan
        return x * y + z


def bits(x: float) -> int:
    """The 64 bits of x as a signed integer."""
    return struct.unpack("<q", struct.pack("<d", x))[0]


def each(operation: Callable[..., float], *operands: Either) -> Either:
    """An operation on scalars, or lane by lane on vectors."""
    if isinstance(operands[0], tuple):
        return tuple(operation(*lane) for lane in zip(*operands, strict=True))
    return operation(*operands)


class Plain:
    """The operations, executed."""

    def __init__(self, lanes: int, tables: Sequence[Vector], *, fuse: bool = True) -> None:
        self.lanes, self.tables, self.fuse = lanes, tables, fuse
        self.kept: dict[tuple[str, int], Vector] = {}

    def constant(self, values: Vector) -> Vector:
        """See ``Operations``; so all the following."""
        return values

    def table(self, index: int) -> Vector:
        """Coefficients of the field."""
        return self.tables[index]

    def splat(self, x: float) -> Vector:
        """A scalar in every lane."""
        return (x,) * self.lanes

    def number(self, x: float) -> float:
        """Itself."""
        return x

    def add(self, x: Either, y: Either) -> Either:
        """The sum."""
        return each(lambda a, b: a + b, x, y)

    def sub(self, x: Either, y: Either) -> Either:
        """The difference."""
        return each(lambda a, b: a - b, x, y)

    def mul(self, x: Either, y: Either) -> Either:
        """The product."""
        return each(lambda a, b: a * b, x, y)

    def fma(self, x: Either, y: Either, z: Either) -> Either:
        """x y + z, rounded once; twice without ``fuse``."""
        return each(fused if self.fuse else lambda a, b, c: a * b + c, x, y, z)

    def negative(self, x: Vector) -> Vector:
        """-x."""
        return tuple(-value for value in x)

    def permute(self, x: Vector, lanes: tuple[int, ...]) -> Vector:
        """The lanes of x at the indices; 0.0 at -1."""
        return tuple(x[k] if k >= 0 else 0.0 for k in lanes)

    def store(self, name: str, index: int, x: Vector) -> None:
        """Keep x."""
        self.kept[name, index] = x

    def load(self, name: str, index: int) -> Vector:
        """Values that were kept."""
        return self.kept[name, index]

    def barrier(self) -> None:
        """Do nothing: plain Python runs in program order."""

    def logarithm(self, x: Vector) -> float:
        """From the exponent, and the mantissa taken for its logarithm."""
        largest = max(bits(abs(value)) for value in x)
        return self.fma(float(largest), 2.0**-52, -1023.0)  # type: ignore[return-value]

    def power(self, x: float) -> float:
        """The exponent, and a parabola for the mantissa."""
        moved = x + (ROUNDING + 1023.0)
        part = x - (moved - (ROUNDING + 1023.0))
        two = struct.unpack("<d", struct.pack("<q", bits(moved) << 52 & (1 << 63) - 1))[0]
        return two * self.fma(part, self.fma(part, *POWER), 1.0)  # type: ignore[operator,arg-type]

    def least(self, x: float, y: float) -> float:
        """The smaller one, y when one is nan."""
        return x if x < y else y

    def largest(self, x: float, y: float) -> float:
        """The larger one, y when one is nan."""
        return x if x > y else y


def advance(
    a: Arrangement,
    order: int,
    work: MutableSequence[float],
    out: MutableSequence[float],
    h: float,
    steps: int,
    every: int,
    until: int,
    *,
    extended_precision: bool = False,
    fuse: bool = True,
) -> int:
    """Plain Python twin of ``series_loop``."""
    n, base, d = a.lanes, 2 * a.lanes, a.components
    at = base + UNITS
    unit, *tables = (tuple(work[at + k * n : at + (k + 1) * n]) for k in range(1 + len(a.tables)))
    o = Plain(n, tables, fuse=fuse)
    hi, lo = tuple(work[:n]), tuple(work[n:base])
    step, part, lag = int(work[base + STEP]), work[base + FRACTION], work[base + LAG]
    scaled = h * work[base + TIME]
    row, place, done = until, 0, 0
    for _ in range(MAX_EXPANSIONS):
        natural, late, missed = expand(o, a, order, (hi, lo if extended_precision else None), work[base + LOG2_TOL])
        capped = min(natural * (1.0 / abs(scaled)), 2.0**40)
        reach = float(math.floor(capped)) if capped >= EXACT_REACH else part + ((capped + EXACT_REACH) - EXACT_REACH)
        if not late < 1024.0 or not reach > part:
            if late < 1024.0:
                work[-2] = math.nan
            return -1 - max(step, 0)
        while row <= steps and row - step <= reach:
            main, small = taylor_increment(o, order, ((row - step) - part) * scaled - lag, missed)
            physical = o.mul(o.add(hi, o.add(main, o.add(small, lo))), unit)
            out[place : place + d] = physical[:d]  # type: ignore[index]
            row, place = row + every, place + d
        done = steps
        if steps - step <= reach:
            break
        move = (reach - part) * scaled
        exact = move - lag
        rest = o.fma(reach - part, scaled, -move)
        main, small = taylor_increment(o, order, exact, missed)
        lag = ((exact - move) + lag) - rest  # type: ignore[operator]
        new, lost = two_sum(o, hi, main)
        small = o.add(small, o.add(lo, lost))
        hi = o.add(new, small)
        lo = o.sub(small, o.sub(hi, new))
        passed = math.floor(reach)
        step, part = step + passed, reach - passed
        work[-1] += 1.0
        done = step
    work[:n], work[n:base] = hi, lo  # type: ignore[call-overload]
    work[base + STEP], work[base + FRACTION], work[base + LAG] = float(step - done), part, lag
    return done
