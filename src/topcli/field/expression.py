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
from dataclasses import dataclass, field
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
    """A formula: its ``text``, its checked tree, and the ``names`` that occur in it."""

    text: str
    tree: ast.expr = field(compare=False, repr=False)
    names: frozenset[str]


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
    used: set[str] = set()
    try:
        tree = _checked(ast.parse(flat, mode="eval").body, flat, names, used)
    except _FaultError as error:
        at, reason = error.args
    except SyntaxError as error:
        at, reason = (error.offset or 1) - 1, "cannot be read from here on; a product is written 2*x, a power x**2"
    except (RecursionError, MemoryError):
        at, reason = 0, "has too many nested operations"
    else:
        return Expression(text, tree, frozenset(used))
    at += shift
    several = f"line {text.count(chr(10), 0, at) + 1}, " if "\n" in text.strip() else ""
    raise ExpressionError(f"{several}column {at - text.rfind(chr(10), 0, at)}: {reason}")


class _FaultError(Exception):
    """Position in a text, and what is wrong there."""


def _checked(node: ast.expr, text: str, names: tuple[str, ...], used: set[str]) -> ast.expr:
    """Node of a formula; half powers become powers of roots. The names that occur are added to ``used``."""

    def inner(part: ast.expr) -> ast.expr:
        return _checked(part, text, names, used)

    # what is not listed is refused, so that a formula can do nothing but compute
    match node:
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            written = text[node.col_offset : node.end_col_offset]
            if not _is_double(written):
                reason = f"{quoted(written)} is no decimal number that a double holds; make it a parameter"
                raise _FaultError(node.col_offset, reason)
            return node
        case ast.Name(id=name) if name in names:
            used.add(name)
            return node
        case ast.Name(id=name) if name == PI:
            return ast.Attribute(ast.Name("math"), PI)
        case ast.UnaryOp(op=ast.UAdd() | ast.USub() as op, operand=operand):
            return ast.UnaryOp(op, inner(operand))
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as op, right=right):
            return ast.BinOp(inner(left), op, inner(right))
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            base, exponent = inner(left), _constant(inner(right))
            if exponent is None or exponent.denominator > 2 or abs(exponent) > HIGHEST:
                reason = f"an exponent is a number, whole or half, of size {HIGHEST} at most"
                raise _FaultError(right.col_offset, reason)
            base = ast.Call(_function("sqrt"), [base], []) if exponent.denominator == 2 else base
            return ast.BinOp(base, ast.Pow(), ast.Constant(exponent.numerator))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if ARITY.get(name) == len(arguments):
            return ast.Call(_function(name), [inner(argument) for argument in arguments], [])
    raise _FaultError(node.col_offset, _reason(node, names))


def _is_double(written: str) -> bool:
    """True if a text is a decimal number whose double has the same digits."""
    if not re.fullmatch(r"[0-9.]+([eE][+-]?[0-9]+)?", written) or not math.isfinite(value := float(written)):
        return False
    return Fraction(repr(value)) == Fraction(written) if value else not re.match(r"[0.]*[1-9]", written)


def _constant(node: ast.expr) -> Fraction | None:
    """Value of a number, of its negative or of a quotient of numbers; None of anything else."""
    match node:
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            return Fraction(str(value))
        case ast.UnaryOp(op=ast.USub(), operand=operand) if (value := _constant(operand)) is not None:
            return -value
        case ast.BinOp(left=left, op=ast.Div(), right=right) if bottom := _constant(right):
            return None if (top := _constant(left)) is None else top / bottom
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


def _function(name: str) -> ast.expr:
    """Function of a formula in Python."""
    return ast.Name(name) if name == "abs" else ast.Attribute(ast.Name("math"), name)


def _number(value: float, numbers: dict[float, int]) -> ast.expr:
    """Place of a number in the tuple ``c``, to which a new one is added."""
    return ast.Name(f"c[{numbers.setdefault(value, len(numbers))}]")


def _power(base: ast.expr, exponent: int, numbers: dict[float, int], products: dict[str, str]) -> ast.expr:
    """A power from repeated squares; its ``products`` are formulas with the name of the variable that holds each."""

    def named(product: ast.expr) -> ast.expr:
        return ast.Name(products.setdefault(ast.unparse(product), f"x{len(products)}"))

    square, power, left = named(base), None, abs(exponent)
    while left:
        if left % 2:
            power = square if power is None else named(ast.BinOp(power, ast.Mult(), square))
        left //= 2
        if left:
            square = named(ast.BinOp(square, ast.Mult(), square))
    if power is None:
        return _number(1.0, numbers)
    return ast.BinOp(_number(1.0, numbers), ast.Div(), power) if exponent < 0 else power


def _written(
    node: ast.expr, places: Mapping[str, str], numbers: dict[float, int], products: dict[str, str]
) -> ast.expr:
    """A formula with the place of each name and number, and a variable for each of the ``products`` in its powers."""

    def inner(part: ast.expr) -> ast.expr:
        return _written(part, places, numbers, products)

    match node:
        case ast.Name(id=name):
            return ast.Name(places[name])
        case ast.Constant(value=value):
            return _number(float(str(value)), numbers)
        case ast.UnaryOp(op=op, operand=operand):
            return ast.UnaryOp(op, inner(operand))
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(exponent))):
            return _power(inner(left), exponent, numbers, products)
        case ast.BinOp(left=left, op=op, right=right):
            return ast.BinOp(inner(left), op, inner(right))
        case ast.Call(func=function, args=arguments):
            return ast.Call(function, [inner(argument) for argument in arguments], [])
        case ast.Attribute():
            return node
    raise TypeError(f"{type(node).__name__} is not a part of a formula")


def function_of(
    name: str, expressions: Sequence[Expression], components: Sequence[str], parameters: Sequence[str]
) -> Callable[..., Any]:
    """Return a function ``name(y, p)`` that returns the values of formulas as a tuple.

    ``y`` holds the ``components`` and ``p`` begins with the ``parameters``.
    """
    places = {name: f"y[{i}]" for i, name in enumerate(components)}
    places |= {name: f"p[{i}]" for i, name in enumerate(parameters)}
    numbers: dict[float, int] = {}
    products: dict[str, str] = {}
    returned = "".join(f"{ast.unparse(_written(each.tree, places, numbers, products))}, " for each in expressions)
    constants = "".join(f"{value!r}, " for value in numbers)
    lines = [f"c = ({constants})"] * bool(constants) + [f"{name} = {text}" for text, name in products.items()]
    lines += [f"return ({returned})"]
    source = f"def {name}(y, p):\n    " + "\n    ".join(lines)
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

        def of_columns(*x: Any) -> Any:
            columns = any(isinstance(a, np.ndarray) for a in x)
            return np.frompyfunc(of_one, len(x), 1)(*x) if columns else of_one(*x)

        return of_columns
