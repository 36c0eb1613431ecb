"""Arithmetic operations of a step, counted: a cost that does not depend on a machine.

The step runs as plain Python on numbers that count what is done with them. Operations on constants and h alone are not
counted, because the compiler moves them out of the loop. A fused multiply-add counts as a product and a sum. What a
processor makes of the operations, in particular how many it does at once, is measured by ``topcli bench``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from fractions import Fraction
from types import ModuleType
from typing import Any

from topcli.contracts import Scheme, Stepper
from topcli.engine.precise.numbers import FUNCTIONS
from topcli.engine.precise.rebuild import Rebuilder, obstacle
from topcli.tops import TOPS

H = 0.01
STEPS = 20
OMEGA, GAMMA = (0.7, -0.4, 1.3), (0.6, 0.48, 0.64)
"""State in general position from which the counted steps start: omega or m, and gamma or a."""


class Counted:
    """Double that counts the operations on it in ``counts`` if it ``varies`` from step to step."""

    __slots__ = ("counts", "value", "varies")

    def __init__(self, value: float, counts: Counter[str], varies: bool) -> None:
        self.value, self.counts, self.varies = value, counts, varies

    def _with(self, other: Any, kind: str, apply: Callable[[float, float], float]) -> Any:
        if not isinstance(other, Counted | float | int):
            return NotImplemented
        varies = self.varies or (isinstance(other, Counted) and other.varies)
        if varies:
            self.counts[kind] += 1
        try:
            value = apply(self.value, float(other))
        except ZeroDivisionError:
            value = math.nan
        return Counted(value, self.counts, varies)

    def __add__(self, other: Any) -> Any:
        return self._with(other, "sums", lambda a, b: a + b)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self._with(other, "sums", lambda a, b: a - b)

    def __rsub__(self, other: Any) -> Any:
        return self._with(other, "sums", lambda a, b: b - a)

    def __mul__(self, other: Any) -> Any:
        return self._with(other, "products", lambda a, b: a * b)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self._with(other, "divisions", lambda a, b: a / b)

    def __rtruediv__(self, other: Any) -> Any:
        return self._with(other, "divisions", lambda a, b: b / a)

    def __pow__(self, power: Any) -> Any:
        return self._with(power, "products", lambda a, b: a**b)

    def __neg__(self) -> Counted:
        return Counted(-self.value, self.counts, self.varies)

    def __abs__(self) -> Counted:
        return Counted(abs(self.value), self.counts, self.varies)

    def __float__(self) -> float:
        return self.value

    def __int__(self) -> int:
        return int(self.value)

    def __bool__(self) -> bool:
        return bool(self.value)

    def __hash__(self) -> int:
        return hash(self.value)

    def __eq__(self, other: object) -> bool:
        return self.value == other

    def __lt__(self, other: Any) -> bool:
        return self.value < float(other)

    def __le__(self, other: Any) -> bool:
        return self.value <= float(other)

    def __gt__(self, other: Any) -> bool:
        return self.value > float(other)

    def __ge__(self, other: Any) -> bool:
        return self.value >= float(other)


class Counting:
    """Arithmetic of doubles that counts, as ``Rebuilder`` needs it."""

    name, bits, eps, library = "counting", 53, 2.0**-52, "topcli"

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.math = ModuleType("math")
        for name in FUNCTIONS:
            self.math.__dict__[name] = self._counting(getattr(math, name), "functions")
        self.math.__dict__.update(
            sqrt=self._counting(math.sqrt, "roots"),
            fabs=abs,
            copysign=lambda x, y: abs(x) if math.copysign(1.0, float(y)) > 0.0 else -abs(x),
            floor=lambda x: math.floor(float(x)),
            isnan=lambda x: math.isnan(float(x)),
            isfinite=self.finite,
            nan=Counted(math.nan, self.counts, False),
            inf=Counted(math.inf, self.counts, False),
            pi=Counted(math.pi, self.counts, False),
        )

    def _counting(self, function: Callable[..., float], kind: str) -> Callable[..., Counted]:
        def counted(*values: Any) -> Counted:
            varies = any(isinstance(one, Counted) and one.varies for one in values)
            if varies:
                self.counts[kind] += 1
            try:
                value = function(*map(float, values))
            except ValueError:
                value = math.nan
            return Counted(value, self.counts, varies)

        return counted

    def active(self) -> AbstractContextManager[Any]:
        """Context without effect."""
        return nullcontext()

    def number(self, value: Fraction) -> Counted:
        """Constant."""
        return Counted(float(value), self.counts, False)

    def variable(self, value: float) -> Counted:
        """Component of a state."""
        return Counted(float(value), self.counts, True)

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        """Return a b + c: a product and a sum."""
        return a * b + c

    @staticmethod
    def finite(x: Any) -> bool:
        """True if ``x`` is neither infinite nor nan."""
        return math.isfinite(float(x))

    @property
    def root(self) -> Callable[[Any], Any]:
        """Square root."""
        return self.math.sqrt

    @staticmethod
    def fraction(x: Any) -> Fraction:
        """Exact value of a finite number."""
        return Fraction(float(x))

    def tolerance(self, value: float, power: float) -> Counted:
        """Tolerance for doubles."""
        return Counted(value, self.counts, False)

    @staticmethod
    def cap(value: int) -> int:
        """Maximum number of iterations for doubles."""
        return value


@dataclass(frozen=True)
class Operations:
    """Mean numbers of operations per step; ``functions`` are calls of the mathematical library."""

    sums: float
    products: float
    divisions: float
    roots: float
    functions: float

    @property
    def text(self) -> str:
        """Numbers for a table, such as ``74 +, 105 ×, 1 ÷``."""
        parts = [(self.sums, "+"), (self.products, "×"), (self.divisions, "÷"), (self.roots, "√")]
        parts.append((self.functions, "calls"))
        return ", ".join(f"{round(number)}\N{NO-BREAK SPACE}{sign}" for number, sign in parts if round(number))


def operations_of(scheme: Scheme) -> Operations | None:
    """Return the mean numbers of operations of a step; None for a method without steps in plain arithmetic.

    The options are the defaults, h is 0.01, and an iteration counts as often as it is carried out from a state in
    general position.
    """
    top, options = TOPS[scheme.top].new(), scheme.options()
    if obstacle(scheme, top, options):
        return None
    method = scheme.build(top, options)
    assert isinstance(method, Stepper)
    counting = Counting()
    step = Rebuilder(counting).function(method.step)  # pyright: ignore[reportArgumentType]
    constant = [Counted(value, counting.counts, False) for value in (H, *top.constants())]
    y = (*OMEGA, *GAMMA)[: len(top.components)]
    entered = method.enter(y, H, top.constants()) if method.enter else y
    state: Any = tuple(map(counting.variable, entered))
    for _ in range(STEPS):
        state = tuple(map(counting.variable, map(float, step(state, constant[0], tuple(constant[1:])))))
    kinds = ("sums", "products", "divisions", "roots", "functions")
    return Operations(**{kind: counting.counts[kind] / STEPS for kind in kinds})
