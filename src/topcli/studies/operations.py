"""Arithmetic operations of a step, counted: a cost that does not depend on a machine.

The step runs as plain Python on numbers that count what is done with them. Operations on constants and h alone are not
counted, because the compiler moves them out of the loop. A fused multiply-add counts as a product and a sum. What a
processor makes of the operations, in particular how many it does at once, is measured by ``topcli bench``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

from topcli.contracts import Scheme, Stepper
from topcli.engine.precise import Rebuilder, obstacle
from topcli.engine.precise_numbers import FUNCTIONS
from topcli.tops import TOPS

H = 0.01
STEPS = 20
OMEGA, GAMMA = (0.7, -0.4, 1.3), (0.6, 0.48, 0.64)
"""State in general position from which the counted steps start: omega or m, and gamma or a."""
KINDS = {
    "sums": ("add", "radd", "sub", "rsub"),
    "products": ("mul", "rmul", "pow"),
    "divisions": ("truediv", "rtruediv"),
    "": ("neg", "abs"),
}
"""Operators of Python by the kind as which they are counted; a change of sign costs nothing."""


class CountedFloat(float):
    """Double that changes from step to step; operations on it are counted in ``counts`` of its class."""

    counts: ClassVar[Counter[str]]


def _counted(kind: str, apply: Callable[..., Any]) -> Callable[..., Any]:
    """Operator or function that counts each call with a ``CountedFloat``; nan where it is not defined."""

    def counted(*values: Any) -> Any:
        number = next((value for value in values if isinstance(value, CountedFloat)), None)
        try:
            result = apply(*values)
        except (ValueError, ZeroDivisionError):
            result = math.nan
        if number is None or result is NotImplemented:
            return result
        number.counts[kind] += 1
        return type(number)(result)

    return counted


for _kind, _names in KINDS.items():
    for _name in _names:
        setattr(CountedFloat, f"__{_name}__", _counted(_kind, getattr(float, f"__{_name}__")))


def _copysign(x: float, y: float) -> float:
    return abs(x) if math.copysign(1.0, y) > 0.0 else -abs(x)


def _counting_arithmetic() -> Any:
    """Doubles as an arithmetic of ``Rebuilder``, with functions that count; a fused a b + c is a product and a sum."""
    module = ModuleType("math")
    vars(module).update(vars(math), fabs=abs, copysign=_copysign, sqrt=_counted("roots", math.sqrt))
    vars(module).update({name: _counted("functions", getattr(math, name)) for name in FUNCTIONS})
    return SimpleNamespace(
        name="counting",
        bits=53,
        math=module,
        number=float,
        fma=lambda a, b, c: a * b + c,
        tolerance=lambda value, power: value,
        cap=lambda value: value,
    )


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
    varying = type("Varying", (CountedFloat,), {"counts": Counter()})
    step: Any = Rebuilder(_counting_arithmetic()).function(method.step)
    constants = top.constants()
    y = (*OMEGA, *GAMMA)[: len(top.components)]
    state: Any = method.enter(y, H, constants) if method.enter else y
    for _ in range(STEPS):
        state = step(tuple(map(varying, state)), H, constants)
    return Operations(*(varying.counts[field.name] / STEPS for field in fields(Operations)))
