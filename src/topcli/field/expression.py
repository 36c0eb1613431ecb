"""Formulas as text, such as ``((B - C)*w2*w3 + k*w2)/A``, parsed and checked before they are evaluated.

A formula has numbers, the names it is given, ``+ - * / **``, parentheses and the functions of ``FUNCTIONS``. Exponents
are numbers, whole or half. Nothing of the text is run: the function of a formula is written from its checked tree.

The function is plain arithmetic on flat tuples, which the engine compiles with the bits of the same formula in Python.
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
from functools import cache, lru_cache
from importlib import import_module
from typing import Any

import numpy as np

from topcli.errors import nearest, quoted

FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sinh", "cosh", "tanh")
LONGEST = 2000
"""Characters of a formula."""
DEEPEST = 100
"""Nested operations; a sum of n terms has n - 1."""
HIGHEST = 24
"""Degree of a formula in its names, and its largest exponent."""
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_ALLOWED = re.compile(r"[A-Za-z0-9_+\-*/(). \t\n]*")
_HINTS = {
    "^": "; a power is written x**2",
    "[": "; use parentheses ( )",
    "{": "; use parentheses ( )",
    ",": "; a decimal has a point",
}
_OPERATORS: dict[type, Callable[[Fraction, Fraction], Fraction]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
}


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
    reader = _Reader(text, names)
    tree, _ = reader.checked(reader.tree(), 0)
    return Expression(text, tree, frozenset(reader.used))


class _Reader:
    """Reader of one formula."""

    def __init__(self, text: str, names: tuple[str, ...]) -> None:
        self.text, self.names = text, names
        self.flat = re.sub(r"\s", " ", text)
        self.shift = len(text) - len(self.flat.lstrip())
        self.used: set[str] = set()

    def fault(self, at: int, reason: str) -> ExpressionError:
        """Error at a position of the text."""
        line, column = self.text.count("\n", 0, at), at - self.text.rfind("\n", 0, at)
        several = f"line {line + 1}, " if "\n" in self.text.strip() else ""
        return ExpressionError(f"{several}column {column}: {reason}")

    def tree(self) -> ast.expr:
        """Tree of the text, not checked."""
        text = self.text
        if len(text) > LONGEST:
            raise ExpressionError(f"has {len(text)} characters; a formula has at most {LONGEST}")
        if not text.strip():
            raise ExpressionError("is empty; expected a formula")
        allowed = _ALLOWED.match(text)
        assert allowed is not None
        if (at := allowed.end()) < len(text):
            raise self.fault(at, f"unexpected {text[at]!r}{_HINTS.get(text[at], '')}")
        try:
            return ast.parse(self.flat.strip(), mode="eval").body
        except SyntaxError as error:
            end, at = len(text.rstrip()), self.shift + max((error.offset or 1) - 1, 0)
            if error.msg.startswith("'(' was never closed"):
                raise self.fault(at, "'(' is never closed") from None
            if at >= end or text[end - 1] in "+-*/":
                raise self.fault(end, "the formula ends too early") from None
            reason = f"cannot be read from {quoted(text[at : at + 16])} on; a product is written 2*x"
            raise self.fault(at, reason) from None
        except (RecursionError, MemoryError):
            raise ExpressionError(f"has more than {DEEPEST} nested operations") from None

    def place(self, node: ast.AST) -> int:
        """Position of a node in the text, which is ASCII."""
        return self.shift + getattr(node, "col_offset", 0)

    def checked(self, node: ast.expr, depth: int) -> tuple[ast.expr, Fraction | int]:
        """Node with its numbers as they are written, and its value, a fraction, or its degree if it has names."""
        if depth > DEEPEST:
            raise self.fault(self.place(node), f"more than {DEEPEST} nested operations")
        match node:
            case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
                return node, self.number(node)
            case ast.Name(id=name):
                return node, self.degree(node, self.name(node, name))
            case ast.UnaryOp(op=ast.UAdd() | ast.USub() as op, operand=operand):
                operand, value = self.checked(operand, depth + 1)
                negative = isinstance(op, ast.USub) and isinstance(value, Fraction)
                return ast.UnaryOp(op, operand), -value if negative else value
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self.power(node, left, right, depth)
            case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as op, right=right):
                left, a = self.checked(left, depth + 1)
                right, b = self.checked(right, depth + 1)
                made = ast.BinOp(left, op, right)
                if isinstance(op, ast.Div) and isinstance(b, Fraction) and not b:
                    raise self.fault(self.place(node.right), "divides by zero")
                if isinstance(a, Fraction) and isinstance(b, Fraction):
                    return made, _OPERATORS[type(op)](a, b)
                a, b = (0 if isinstance(x, Fraction) else x for x in (a, b))
                return made, self.degree(node, a + b if isinstance(op, ast.Mult | ast.Div) else max(a, b))
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
                argument, value = self.checked(argument, depth + 1)
                call = ast.Call(_function(name), [argument], [])
                return call, 0 if isinstance(value, Fraction) else value
        raise self.fault(self.place(node), self.reason(node))

    def number(self, node: ast.Constant) -> Fraction:
        """Value of a number, exactly as it is written."""
        at, end = self.place(node), self.shift + (node.end_col_offset or 0)
        written = self.text[at:end]
        value = float(written) if re.fullmatch(r"[0-9.]+([eE][+-]?[0-9]+)?", written) else math.inf
        underflows = not value and re.match(r"[0.]*[1-9]", written)
        if not math.isfinite(value) or underflows:
            raise self.fault(at, f"{quoted(written)} is not a decimal number that a double holds")
        exact = Fraction(written) if value else Fraction(0)
        if exact != Fraction(repr(value)):
            raise self.fault(at, f"{quoted(written)} has more digits than a double holds; make it a parameter")
        return exact

    def name(self, node: ast.Name, name: str) -> int:
        """Degree of a name, which is one. Raises ExpressionError for an unknown one."""
        if name in self.names:
            self.used.add(name)
            return 1
        if name in FUNCTIONS:
            raise self.fault(self.place(node), f"{name} is a function; write {name}(x)")
        hint = nearest(name, (*self.names, *FUNCTIONS))
        if hint.startswith("known"):
            hint = f"known: {', '.join(self.names)}; functions: {', '.join(FUNCTIONS)}"
        raise self.fault(self.place(node), f"unknown name {quoted(name)}; {hint}")

    def degree(self, node: ast.AST, degree: int) -> int:
        """The degree of a node, if it is not too high."""
        if degree > HIGHEST:
            raise self.fault(self.place(node), f"has degree {degree} in its names; at most {HIGHEST} is allowed")
        return degree

    def power(self, node: ast.BinOp, left: ast.expr, right: ast.expr, depth: int) -> tuple[ast.expr, Fraction | int]:
        """Check a power: its exponent is a number; a half-integer exponent becomes a power of the square root."""
        base, value = self.checked(left, depth + 1)
        _, exponent = self.checked(right, depth + 1)
        at = self.place(right)
        if not isinstance(exponent, Fraction) or exponent.denominator > 2 or abs(exponent) > HIGHEST:
            raise self.fault(at, f"an exponent is a number, whole or half, of size {HIGHEST} at most")
        if value == 0 and isinstance(value, Fraction) and exponent < 0:
            raise self.fault(at, "divides by zero")
        half = exponent.denominator == 2
        base = ast.Call(_function("sqrt"), [base], []) if half else base
        made = base if exponent == Fraction(1, 2) else ast.BinOp(base, ast.Pow(), ast.Constant(exponent.numerator))
        if isinstance(value, Fraction):
            return made, 0 if half else value**exponent.numerator
        return made, self.degree(node, math.ceil(value * abs(exponent)))

    def reason(self, node: ast.expr) -> str:
        """Message about a node that is not a part of a formula."""
        match node:
            case ast.Call(func=ast.Name(id=name)) if name in FUNCTIONS:
                return f"{name} takes one argument"
            case ast.Call(func=ast.Name(id=name)) if name in self.names:
                return f"{name} is not a function; a product is written {name}*(...)"
            case ast.Call(func=ast.Name(id=name)):
                return f"unknown function {quoted(name)}; {nearest(name, FUNCTIONS)}"
            case ast.Call():
                return "a product is written (...)*(...)"
            case ast.BinOp(op=ast.FloorDiv()):
                return "'//' is not allowed; a quotient is written x/y"
        return f"only numbers, names, + - * / **, parentheses and {', '.join(FUNCTIONS)} are allowed"


def _function(name: str) -> ast.expr:
    """Function of a formula in Python."""
    return ast.Name(name) if name == "abs" else ast.Attribute(ast.Name("math"), name)


def _written(node: ast.expr, places: Mapping[str, str], numbers: dict[float, int]) -> ast.expr:
    """A formula with the place of each name, and of its numbers in the tuple ``c``, to which new ones are added."""

    def inner(part: ast.expr) -> ast.expr:
        return _written(part, places, numbers)

    match node:
        case ast.Name(id=name):
            return ast.Name(places[name])
        case ast.Constant(value=value):
            return ast.Name(f"c[{numbers.setdefault(float(str(value)), len(numbers))}]")
        case ast.UnaryOp(op=op, operand=operand):
            return ast.UnaryOp(op, inner(operand))
        case ast.BinOp(left=left, op=op, right=right):
            return ast.BinOp(inner(left), op, right if isinstance(op, ast.Pow) else inner(right))
        case ast.Call(func=function, args=[argument]):
            return ast.Call(function, [inner(argument)], [])
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
    returned = "".join(f"{ast.unparse(_written(each.tree, places, numbers))}, " for each in expressions)
    constants = "".join(f"{value!r}, " for value in numbers)
    lines = [f"c = ({constants})"] * bool(constants) + [f"return ({returned})"]
    scope: dict[str, Any] = {"math": math, "__name__": __name__}
    source = f"def {name}(y, p):\n    " + "\n    ".join(lines)
    exec(compile(source, f"<formulas {hashlib.sha256(source.encode()).hexdigest()[:12]}>", "exec"), scope)
    return scope[name]


def uses_math(function: Callable[..., Any]) -> bool:
    """True if the code of a plain function refers to the module ``math``."""
    return isinstance(function, types.FunctionType) and function.__globals__.get("math") is math


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
    made = types.FunctionType(code, scope, function.__name__, function.__defaults__, function.__closure__)
    made.__kwdefaults__ = function.__kwdefaults__
    return made


def value_of(
    expression: Expression, components: Sequence[str], parameters: Sequence[str]
) -> Callable[[Sequence[Any], Sequence[Any]], Any]:
    """Return a formula as a function ``value(y, p)``; ``y`` contains numbers of any arithmetic, or columns of numbers.

    Columns of objects, such as numbers of another precision, are computed in their arithmetic.
    """
    plain = function_of("formula", [expression], components, parameters)
    of_columns = in_arithmetic(plain, float, np)
    of_objects = in_arithmetic(plain, lambda value: Fraction(repr(value)), _Elementwise())

    def value(y: Sequence[Any], p: Sequence[Any]) -> Any:
        exact = any(isinstance(x, np.ndarray) and x.dtype.hasobject for x in (*y, *p))
        return (of_objects if exact else of_columns)(y, p)[0]

    return value


class _Elementwise:
    """Functions of columns of objects, each in the arithmetic of its numbers."""

    def __getattr__(self, name: str) -> Callable[[Any], Any]:
        return _elementwise(name)


@cache
def _elementwise(name: str) -> Callable[[Any], Any]:
    def of_one(x: Any) -> Any:
        library = type(x).__module__.partition(".")[0]
        functions: Any = import_module("gmpy2") if library == "gmpy2" else getattr(x, "context", math)
        return getattr(functions, name)(x)

    columns = np.frompyfunc(of_one, 1, 1)
    return lambda x: columns(x) if isinstance(x, np.ndarray) else of_one(x)
