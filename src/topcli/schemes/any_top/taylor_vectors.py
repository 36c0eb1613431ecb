"""Vector operations of the Taylor series in LLVM IR.

LLVM maps a vector of eight doubles to the registers of the processor: one of AVX-512, two of AVX2, four of NEON.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

LaneValue = Any
Scalar = Any


Pair = tuple[LaneValue, LaneValue]
"""Vector in more than double precision: high and low part."""


def vector_two_sum(o: IRWriter, x: LaneValue, z: LaneValue) -> tuple[LaneValue, LaneValue]:
    """Return the rounded sum of two vectors and its rounding error."""
    rounded = o.add(x, z)
    part = o.sub(rounded, x)
    return rounded, o.add(o.sub(x, o.sub(rounded, part)), o.sub(z, part))


def pair_add(o: IRWriter, x: Pair, z: Pair) -> Pair:
    """Return the sum of two pairs."""
    rounded, missing = vector_two_sum(o, x[0], z[0])
    return rounded, o.add(missing, o.add(x[1], z[1]))


def pair_mul(o: IRWriter, x: Pair, z: Pair) -> Pair:
    """Return the product of two pairs."""
    rounded, missing = pair_scale(o, x[0], z)
    return rounded, o.fma(x[1], z[0], missing)


def pair_scale(o: IRWriter, factor: LaneValue, x: Pair) -> Pair:
    """Return the product of an exact vector and a pair."""
    rounded = o.mul(factor, x[0])
    return rounded, o.fma(factor, x[1], o.fma(factor, x[0], o.negative(rounded)))


def literal(x: float) -> str:
    """Return ``x`` as an IR literal, bit for bit."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', x))[0]:016X}"


_ROUNDING = 1.5 * 2.0**52
"""Adding this to a number leaves the nearest integer in the lowest bits."""
POWER = (0.23986, 0.70294)
"""Coefficients p_0, p_1 of 2^x = 1 + x (p_1 + x p_0) on [-1/2, 1/2]."""
WINDOW = 3
"""Number of most recently stored vectors of each array that are reused from registers: a load right after a store is
slow."""
DECLARATIONS = """declare void @llvm.codeview.annotation(metadata)
!0 = !{!"cut"}"""
"""Declarations required by a module whose functions contain a ``barrier``."""


class IRWriter:
    """Operations on scalars, vectors of ``lanes`` floats and named arrays of vectors, as IR instructions in ``lines``.

    A method returns the name of its result.
    """

    def __init__(self, lanes: int, names: Iterator[int]) -> None:
        self.lanes, self._names = lanes, names
        self.lines: list[str] = []
        self._in_registers: dict[str, dict[int, str]] = {}
        self.vector = f"<{lanes} x double>"

    def emit(self, text: str) -> str:
        """Append an instruction whose result is a vector."""
        name = f"%v{next(self._names)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def kind(self, x: str) -> str:
        """Type of an operand; the names of scalars start with %s."""
        return "double" if x.startswith("%s") or x.startswith("0x") else self.vector

    def emit_scalar(self, text: str) -> str:
        """Append an instruction whose result is a scalar."""
        name = f"%s{next(self._names)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def _binary(self, word: str, x: str, y: str) -> str:
        kind = self.kind(x)
        return (self.emit_scalar if kind == "double" else self.emit)(f"{word} {kind} {x}, {y}")

    number = staticmethod(literal)
    """Scalar constant."""

    def constant(self, values: tuple[float, ...]) -> str:
        """Return a vector constant."""
        return "<" + ", ".join(f"double {literal(x)}" for x in values) + ">"

    def table(self, index: int) -> str:
        """Return a vector of coefficients of the field."""
        return f"%table{index}"

    def splat(self, x: str) -> str:
        """Return a vector with the scalar in every lane."""
        first = self.emit(f"insertelement {self.vector} poison, double {x}, i32 0")
        zeros = ", ".join(["i32 0"] * self.lanes)
        return self.emit(f"shufflevector {self.vector} {first}, {self.vector} poison, <{self.lanes} x i32> <{zeros}>")

    def add(self, x: str, y: str) -> str:
        """Return x + y."""
        return self._binary("fadd", x, y)

    def sub(self, x: str, y: str) -> str:
        """Return x - y."""
        return self._binary("fsub", x, y)

    def mul(self, x: str, y: str) -> str:
        """Return x y."""
        return self._binary("fmul", x, y)

    def fma(self, x: str, y: str, z: str) -> str:
        """Return x y + z, with two roundings on processors without fma."""
        kind = self.kind(x)
        suffix = "f64" if kind == "double" else f"v{self.lanes}f64"
        call = f"call {kind} @llvm.fmuladd.{suffix}({kind} {x}, {kind} {y}, {kind} {z})"
        return (self.emit_scalar if kind == "double" else self.emit)(call)

    def negative(self, x: str) -> str:
        """Return -x."""
        return self.emit(f"fneg {self.vector} {x}")

    def permute(self, x: str, lanes: tuple[int, ...]) -> str:
        """Return the lanes of x at the indices; 0.0 at index -1."""
        indices = ", ".join(f"i32 {k if k >= 0 else self.lanes}" for k in lanes)
        return self.emit(
            f"shufflevector {self.vector} {x}, {self.vector} zeroinitializer, <{self.lanes} x i32> <{indices}>"
        )

    def _slot(self, name: str, index: int) -> str:
        pointer = f"%p{next(self._names)}"
        self.lines.append(f"  {pointer} = getelementptr {self.vector}, ptr %{name}, i64 {index}")
        return pointer

    def store(self, name: str, index: int, x: str) -> None:
        """Store x at position ``index`` of the array ``name``."""
        pointer = self._slot(name, index)
        self.lines.append(f"  store {self.vector} {x}, ptr {pointer}, align {8 * self.lanes}")
        self._in_registers[name] = {
            **{k: v for k, v in self._in_registers.get(name, {}).items() if k > index - WINDOW},
            index: x,
        }

    def load(self, name: str, index: int) -> str:
        """Return the stored vector."""
        if index in self._in_registers.get(name, {}):
            return self._in_registers[name][index]
        return self.emit(f"load {self.vector}, ptr {self._slot(name, index)}, align {8 * self.lanes}")

    def barrier(self) -> None:
        """Scheduling barrier: append an annotation, which LLVM's schedulers do not move instructions across."""
        self.lines.append("  call void @llvm.codeview.annotation(metadata !0)")

    def logarithm(self, x: str) -> str:
        """Return log2 of the largest magnitude in x, to within 0.09; -1023 for 0.0, at least 1024 for inf and nan.

        It is approximated by the exponent plus the fraction of the mantissa.
        """
        n = self.lanes
        bits = self.emit(f"bitcast {self.vector} {x} to <{n} x i64>")
        mask = ", ".join(["i64 9223372036854775807"] * n)
        size = self.emit(f"and <{n} x i64> {bits}, <{mask}>")
        largest = self.emit(f"call i64 @llvm.vector.reduce.smax.v{n}i64(<{n} x i64> {size})")
        number = self.emit_scalar(f"sitofp i64 {largest} to double")
        return self.fma(number, literal(2.0**-52), literal(-1023.0))

    def power(self, x: str) -> str:
        """Return 2^x for -1022 < x < 1023, from the exponent and a parabola for the mantissa: to 0.3 percent."""
        moved = self.add(x, literal(_ROUNDING + 1023.0))
        whole = self.sub(moved, literal(_ROUNDING + 1023.0))
        part = self.sub(x, whole)
        shifted = self.emit(f"shl i64 {self.emit(f'bitcast double {moved} to i64')}, 52")
        two = self.emit_scalar(f"bitcast i64 {shifted} to double")
        return self.mul(two, self.fma(part, self.fma(part, literal(POWER[0]), literal(POWER[1])), literal(1.0)))

    def least(self, x: str, y: str) -> str:
        """Return the smaller one, y if one is nan."""
        less = self.emit(f"fcmp olt double {x}, {y}")
        return self.emit_scalar(f"select i1 {less}, double {x}, double {y}")

    def largest(self, x: str, y: str) -> str:
        """Return the larger one, y if one is nan."""
        more = self.emit(f"fcmp ogt double {x}, {y}")
        return self.emit_scalar(f"select i1 {more}, double {x}, double {y}")
