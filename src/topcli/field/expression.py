"""Formulas as text, such as ``((B - C)*w2*w3 + k*w2)/A``, parsed and checked before they are evaluated.

A formula has numbers, the names it is given, pi, ``+ - * / **``, parentheses and the functions of ``FUNCTIONS``.
Exponents are numbers, whole or half. Nothing of the text is run: the function of a formula is written from its checked
tree.

The function is plain arithmetic on flat tuples, which the engine compiles with the bits of the same formula in Python.
Powers become products, because Python's ``x**3`` has other bits than compiled code, in which ``x**-3`` may also raise.
Its numbers lie in one constant, a tuple, so that Python does not compute with them in advance: ``1/3`` is one third in
every arithmetic. ``in_arithmetic`` exchanges them, and ``math``, for those of another arithmetic.
"""

from __future__ import annotations

import ast
import hashlib
import math
import re
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from topcli.arithmetic.fused import defined
from topcli.errors import nearest, quoted

FUNCTIONS = ("sin", "cos", "tan", "asin", "acos", "atan2", "exp", "log", "sqrt", "abs", "sinh", "cosh", "tanh")
ARITY = dict.fromkeys(FUNCTIONS, 1) | {"atan2": 2}
"""Number of arguments of each function."""
PI = "pi"
"""Name of the number, unless a formula is given this name."""
HIGHEST = 24
"""Largest exponent."""
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class ExpressionError(ValueError):
    """Text that is not a formula; the message begins with the column, and with the line if there are several lines."""


@dataclass(frozen=True)
class Expression:
    """A formula that has been checked: its ``text`` on one line."""

    text: str


def parse(text: str, names: Iterable[str]) -> Expression:
    """Read a formula of these names.

    Raises
    ------
    ExpressionError
        If the text is not a formula. The message gives line, column, what is wrong, and what would be right.
    """
    return _parsed(text, tuple(names))


@lru_cache(maxsize=1024)  # a sweep reads the same section for each of its parameters
def _parsed(text: str, names: tuple[str, ...]) -> Expression:
    flat, shift = re.sub(r"\s", " ", text).strip(), len(text) - len(text.lstrip())
    if not flat:
        raise ExpressionError("is empty; expected a formula")
    try:
        tree = ast.parse(flat, mode="eval").body
        _check(tree, flat, names)
        ast.unparse(tree)  # nesting that cannot be written later is refused here
    except _FaultError as error:
        at, reason = error.args
    except SyntaxError as error:
        at, reason = (error.offset or 1) - 1, "cannot be read from here on; a product is written 2*x, a power x**2"
    except (RecursionError, MemoryError):
        at, reason = 0, "has too many nested operations"
    else:
        return Expression(flat)
    at += shift
    several = f"line {text.count(chr(10), 0, at) + 1}, " if "\n" in text.strip() else ""
    raise ExpressionError(f"{several}column {at - text.rfind(chr(10), 0, at)}: {reason}")


class _FaultError(Exception):
    """Position in a text, and what is wrong there."""


def _check(node: ast.expr, text: str, names: tuple[str, ...]) -> None:
    """Refuse what is not a part of a formula; what is not listed is refused, so that it can do nothing but compute."""
    parts: Sequence[ast.expr] = ()
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            written = text[node.col_offset : node.end_col_offset]
            if not _is_double(written):
                reason = f"{quoted(written)} is no decimal number that a double holds; make it a parameter"
                raise _FaultError(node.col_offset, reason)
        case ast.Name(id=name) if name in names or name == PI:
            pass
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            parts = [operand]
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div(), right=right):
            parts = [left, right]
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            _check(left, text, names)
            _check(right, text, names)
            exponent = _exponent(right)
            if exponent is None or exponent.denominator > 2 or abs(exponent) > HIGHEST:
                reason = f"an exponent is a number, whole or half, of size {HIGHEST} at most"
                raise _FaultError(right.col_offset, reason)
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if ARITY.get(name) == len(arguments):
            parts = arguments
        case _:
            raise _FaultError(node.col_offset, _reason(node, names))
    for part in parts:
        _check(part, text, names)


def _is_double(written: str) -> bool:
    """True if a text is a decimal number whose double has the same digits."""
    if not re.fullmatch(r"[0-9.]+([eE][+-]?[0-9]+)?", written) or not math.isfinite(value := float(written)):
        return False
    return Fraction(repr(value)) == Fraction(written) if value else not re.match(r"[0.]*[1-9]", written)


def _exponent(node: ast.expr) -> Fraction | None:
    """Value of a number, of its negative or of a quotient of numbers; None of anything else."""
    match node:
        case ast.Constant(value=value):
            return Fraction(str(value))
        case ast.UnaryOp(op=ast.USub(), operand=operand) if (value := _exponent(operand)) is not None:
            return -value
        case ast.BinOp(left=left, op=ast.Div(), right=right) if bottom := _exponent(right):
            return None if (top := _exponent(left)) is None else top / bottom
    return None


def _reason(node: ast.expr, names: tuple[str, ...]) -> str:
    """Message about a node that is not a part of a formula."""
    match node:
        case ast.Name(id=name) | ast.Call(func=ast.Name(id=name)) if name in FUNCTIONS:
            return f"{name} is a function; write {name}({'y, x' if ARITY[name] == 2 else 'x'})"
        case ast.Name(id=name) | ast.Call(func=ast.Name(id=name)) if name not in names:
            hint = nearest(name, (*names, *FUNCTIONS))
            return f"unknown name {quoted(name)}; " + (hint if hint[:3] == "did" else f"known: {', '.join(names)}")
    allowed = f"numbers, names, + - * / **, parentheses and {', '.join(FUNCTIONS)}"
    return f"only {allowed} are allowed; a product is written 2*x, a power x**2, a decimal 0.5"


class _Writer(ast.NodeTransformer):
    """Formula in Python: names by their ``places``, ``numbers`` by those in the tuple ``c``, powers as products.

    ``products`` are formulas with the name of the variable that holds each.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        self.places = places
        self.numbers: dict[float, int] = {}
        self.products: dict[str, str] = {}

    def number(self, value: float) -> ast.expr:
        """Place of a number in the tuple ``c``, to which a new one is added."""
        return ast.Name(f"c[{self.numbers.setdefault(value, len(self.numbers))}]")

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Place of a name; functions and pi are those of ``math``."""
        return ast.Name(self.places.get(node.id, f"math.{node.id}"))

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        """Place of a number."""
        return self.number(float(str(node.value)))

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Call of a function, whose name may be that of a component too."""
        name = ast.unparse(node.func)
        return ast.Call(ast.Name(name if name == "abs" else f"math.{name}"), list(map(self.visit, node.args)), [])

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        """Power from repeated squares; other operations as they are."""
        if not isinstance(node.op, ast.Pow):
            return self.generic_visit(node)
        exponent, base = _exponent(node.right) or Fraction(0), self.visit(node.left)
        base = ast.Call(ast.Name("math.sqrt"), [base], []) if exponent.denominator == 2 else base
        square, power, left = self._named(base), None, abs(exponent.numerator)
        while left:
            if left % 2:
                power = square if power is None else self._named(ast.BinOp(power, ast.Mult(), square))
            left //= 2
            if left:
                square = self._named(ast.BinOp(square, ast.Mult(), square))
        if power is None:
            return self.number(1.0)
        return ast.BinOp(self.number(1.0), ast.Div(), power) if exponent < 0 else power

    def _named(self, product: ast.expr) -> ast.expr:
        return ast.Name(self.products.setdefault(ast.unparse(product), f"x{len(self.products)}"))


def function_of(
    name: str, expressions: Sequence[Expression], components: Sequence[str], parameters: Sequence[str]
) -> Callable[..., Any]:
    """Return a function ``name(y, p)`` that returns the values of formulas as a tuple.

    ``y`` holds the ``components`` and ``p`` begins with the ``parameters``.
    """
    places = {name: f"y[{i}]" for i, name in enumerate(components)}
    writer = _Writer(places | {name: f"p[{i}]" for i, name in enumerate(parameters)})
    trees = [writer.visit(ast.parse(each.text, mode="eval").body) for each in expressions]
    returned = "".join(f"{ast.unparse(tree)}, " for tree in trees)
    constants = "".join(f"{value!r}, " for value in writer.numbers)
    lines = [f"c = ({constants})"] * bool(constants) + [f"{name} = {text}" for text, name in writer.products.items()]
    source = f"def {name}(y, p):\n    " + "\n    ".join([*lines, f"return ({returned})"])
    label = f"formulas {hashlib.sha256(source.encode()).hexdigest()[:12]}"
    return defined(source, label, math=math, __name__=__name__)[name]


def in_arithmetic(
    function: Callable[..., Any], number: Callable[[float], Any], functions: Any = None
) -> Callable[..., Any]:
    """Return a function with ``number(c)`` instead of each float constant c in its code.

    ``functions`` replaces the module ``math``. Objects other than plain Python functions are returned unchanged.
    """
    if not isinstance(function, types.FunctionType):
        return function

    def exchanged(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(map(exchanged, value))
        return number(value) if isinstance(value, float) and math.isfinite(value) else value

    scope = function.__globals__ if functions is None else {**function.__globals__, "math": functions}
    code = function.__code__.replace(co_consts=tuple(map(exchanged, function.__code__.co_consts)))
    copy = types.FunctionType(code, scope, function.__name__, function.__defaults__, function.__closure__)
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


def value_of(
    expression: Expression, components: Sequence[str], parameters: Sequence[str]
) -> Callable[[Sequence[Any], Sequence[Any]], Any]:
    """Return a formula as a function ``value(y, p)``; ``y`` contains numbers of any arithmetic, or columns of numbers.

    Columns of objects, such as numbers of another precision, are computed in their arithmetic.
    """
    plain = function_of("formula", [expression], components, parameters)
    of_columns = in_arithmetic(plain, float, np)

    def value(y: Sequence[Any], p: Sequence[Any]) -> Any:
        objects: list[Any] = [x for x in (*y, *p) if isinstance(x, Fraction)]
        objects += [x.flat[0] for x in (*y, *p) if isinstance(x, np.ndarray) and x.dtype.hasobject and x.size]
        if not objects:
            return of_columns(y, p)[0]
        # those of mpmath know their functions; fractions and polynomials have those of math
        functions = _Elementwise(next((x.context for x in objects if hasattr(x, "context")), math))
        return in_arithmetic(plain, functions.number, functions)(y, p)[0]

    return value


class _Elementwise:
    """Constants and functions of columns of numbers that have these ``functions``.

    Those of fractions are doubles, which exact numbers refuse.
    """

    def __init__(self, functions: Any) -> None:
        self.functions = functions
        self.of = getattr(functions, "mpf", Fraction)

    def number(self, value: float | Fraction) -> Any:
        """Decimal number that a double is printed as."""
        exact = Fraction(repr(value)) if isinstance(value, float) else value
        return self.of(exact.numerator) / exact.denominator

    def __getattr__(self, name: str) -> Any:
        if name == PI:
            return +self.functions.pi

        def of_one(*x: Any) -> Any:
            numbers = [self.number(a) if isinstance(a, Fraction) else a for a in x]
            try:
                value = getattr(self.functions, name)(*numbers)
            except ValueError:
                if not all(isinstance(a, Fraction) for a in x):
                    raise
                return math.nan
            return value if value.imag == 0 else self.functions.nan  # mpmath's roots of negative numbers are complex

        return lambda *x: np.frompyfunc(of_one, len(x), 1)(*x)
