"""The vector operations of ``series`` written as LLVM's intermediate language.

LLVM makes of a vector of eight doubles whatever the processor has: one AVX-512 register, two of AVX2, four of NEON.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator


def literal(x: float) -> str:
    """The number, bit for bit."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', x))[0]:016X}"


ROUNDING = 1.5 * 2.0**52
"""Added to a number, it leaves the nearest integer in the lowest bits."""
POWER = (0.23986, 0.70294)
"""2^x over -1/2..1/2 as 1 + x (p_1 + x p_0)."""
FRESH = 3
"""So many vectors of each array are still at hand when they are asked for: what was just stored is slow to load."""
DECLARATIONS = """declare void @llvm.codeview.annotation(metadata)
!0 = !{!"cut"}"""
"""What a module needs besides, whose functions hold a ``cut``."""


class Text:
    """Operations that append a line of LLVM's language each and return the name of the result."""

    def __init__(self, lanes: int, names: Iterator[int], fresh: int = FRESH) -> None:
        self.lanes, self._names, self._recent = lanes, names, fresh
        self.lines: list[str] = []
        self._fresh: dict[str, dict[int, str]] = {}
        self.vector = f"<{lanes} x double>"

    def line(self, text: str) -> str:
        """Append an instruction with a result."""
        name = f"%v{next(self._names)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def kind(self, x: str) -> str:
        """Scalars carry a mark, because the language wants types."""
        return "double" if x.startswith("%s") or x.startswith("0x") else self.vector

    def scalar(self, text: str) -> str:
        """Append an instruction whose result is a scalar."""
        name = f"%s{next(self._names)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def _binary(self, word: str, x: str, y: str) -> str:
        kind = self.kind(x)
        return (self.scalar if kind == "double" else self.line)(f"{word} {kind} {x}, {y}")

    def constant(self, values: tuple[float, ...]) -> str:
        """See ``Operations``; so all the following."""
        return "<" + ", ".join(f"double {literal(x)}" for x in values) + ">"

    def splat(self, x: str) -> str:
        """A scalar in every lane."""
        one = self.line(f"insertelement {self.vector} poison, double {x}, i32 0")
        zeros = ", ".join(["i32 0"] * self.lanes)
        return self.line(f"shufflevector {self.vector} {one}, {self.vector} poison, <{self.lanes} x i32> <{zeros}>")

    def number(self, x: float) -> str:
        """A scalar known beforehand."""
        return literal(x)

    def add(self, x: str, y: str) -> str:
        """The sum."""
        return self._binary("fadd", x, y)

    def sub(self, x: str, y: str) -> str:
        """The difference."""
        return self._binary("fsub", x, y)

    def mul(self, x: str, y: str) -> str:
        """The product."""
        return self._binary("fmul", x, y)

    def fma(self, x: str, y: str, z: str) -> str:
        """x y + z; in two roundings where the processor has no such instruction."""
        kind = self.kind(x)
        suffix = "f64" if kind == "double" else f"v{self.lanes}f64"
        call = f"call {kind} @llvm.fmuladd.{suffix}({kind} {x}, {kind} {y}, {kind} {z})"
        return (self.scalar if kind == "double" else self.line)(call)

    def negative(self, x: str) -> str:
        """-x."""
        return self.line(f"fneg {self.vector} {x}")

    def permute(self, x: str, lanes: tuple[int, ...]) -> str:
        """The lanes of x at the indices; 0.0 at -1."""
        indices = ", ".join(f"i32 {k if k >= 0 else self.lanes}" for k in lanes)
        return self.line(
            f"shufflevector {self.vector} {x}, {self.vector} zeroinitializer, <{self.lanes} x i32> <{indices}>"
        )

    def _slot(self, name: str, index: int) -> str:
        pointer = f"%p{next(self._names)}"
        self.lines.append(f"  {pointer} = getelementptr {self.vector}, ptr %{name}, i64 {index}")
        return pointer

    def store(self, name: str, index: int, x: str) -> None:
        """Keep x."""
        pointer = self._slot(name, index)
        self.lines.append(f"  store {self.vector} {x}, ptr {pointer}, align {8 * self.lanes}")
        self._fresh[name] = {
            **{k: v for k, v in self._fresh.get(name, {}).items() if k > index - self._recent},
            index: x,
        }

    def load(self, name: str, index: int) -> str:
        """What was kept."""
        if index in self._fresh.get(name, {}):
            return self._fresh[name][index]
        return self.line(f"load {self.vector}, ptr {self._slot(name, index)}, align {8 * self.lanes}")

    def cut(self) -> None:
        """A label, which LLVM's schedulers of instructions leave where it is."""
        self.lines.append("  call void @llvm.codeview.annotation(metadata !0)")

    def logarithm(self, x: str) -> str:
        """From the exponent, and the mantissa taken for its logarithm."""
        n = self.lanes
        bits = self.line(f"bitcast {self.vector} {x} to <{n} x i64>")
        kept = ", ".join(["i64 9223372036854775807"] * n)
        size = self.line(f"and <{n} x i64> {bits}, <{kept}>")
        largest = self.line(f"call i64 @llvm.vector.reduce.smax.v{n}i64(<{n} x i64> {size})")
        number = self.scalar(f"sitofp i64 {largest} to double")
        return self.fma(number, literal(2.0**-52), literal(-1023.0))

    def power(self, x: str) -> str:
        """The exponent, and a parabola for the mantissa."""
        moved = self.add(x, literal(ROUNDING + 1023.0))
        whole = self.sub(moved, literal(ROUNDING + 1023.0))
        part = self.sub(x, whole)
        shifted = self.line(f"shl i64 {self.line(f'bitcast double {moved} to i64')}, 52")
        two = self.scalar(f"bitcast i64 {shifted} to double")
        return self.mul(two, self.fma(part, self.fma(part, literal(POWER[0]), literal(POWER[1])), literal(1.0)))

    def least(self, x: str, y: str) -> str:
        """The smaller one, y when one is nan."""
        less = self.line(f"fcmp olt double {x}, {y}")
        return self.scalar(f"select i1 {less}, double {x}, double {y}")

    def largest(self, x: str, y: str) -> str:
        """The larger one, y when one is nan."""
        more = self.line(f"fcmp ogt double {x}, {y}")
        return self.scalar(f"select i1 {more}, double {x}, double {y}")
