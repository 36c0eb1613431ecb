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
from functools import cache, lru_cache
from importlib import import_module
from typing import Any

import numpy as np

from topcli.errors import nearest, quoted

FUNCTIONS = ("sin", "cos", "tan", "asin", "acos", "atan2", "exp", "log", "sqrt", "abs", "sinh", "cosh", "tanh")
ARITY = dict.fromkeys(FUNCTIONS, 1) | {"atan2": 2}
"""Number of arguments of each function."""
PI = "pi"
"""Name of the number, unless a formula is given this name."""
DIGITS = 170
"""Decimal digits of a function of exact numbers: more than any precision of a run."""
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
        case ast.Call(func=ast.Name(id=name)) if name in names:
            return f"{name} is not a function; a product is written {name}*(...)"
        case ast.Call(func=ast.Name(id=name)):
            return f"unknown function {quoted(name)}; {nearest(name, FUNCTIONS)}"
        case ast.Call():
            return "a product is written (...)*(...)"
        case ast.Name(id=name):
            hint = nearest(name, (*names, *FUNCTIONS))
            if hint.startswith("known"):
                hint = f"known: {', '.join(names)}; functions: {', '.join(FUNCTIONS)}"
            return f"unknown name {quoted(name)}; {hint}"
        case ast.BinOp(op=ast.FloorDiv() | ast.BitXor()):
            return "a quotient is written x/y, a power x**2"
        case ast.Tuple():
            return "unexpected ','; a decimal has a point"
    return f"only numbers, names, + - * / **, parentheses and {', '.join(FUNCTIONS)} are allowed"


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
    of_objects, of_fractions = (
        in_arithmetic(plain, lambda value: Fraction(repr(value)), _Elementwise(rational)) for rational in (False, True)
    )

    def value(y: Sequence[Any], p: Sequence[Any]) -> Any:
        columns = [x for x in (*y, *p) if isinstance(x, np.ndarray) and x.dtype.hasobject]
        exact = [x for x in (*y, *p) if isinstance(x, Fraction)] + [x.flat[0] for x in columns if x.size]
        if not (columns or exact):
            return of_columns(y, p)[0]
        return (of_fractions if all(_functions(x) is math for x in exact) else of_objects)(y, p)[0]

    return value


class _Elementwise:
    """Functions of columns of objects, each in the arithmetic of its numbers.

    Constants have ``DIGITS`` digits. ``rational`` numbers have no functions: the values are floats, which are refused.
    """

    def __init__(self, rational: bool) -> None:
        self.rational = rational

    def __getattr__(self, name: str) -> Any:
        if name == PI:
            return math.pi if self.rational else exact_function(PI)()
        return _elementwise(name, self.rational)


def _functions(x: Any) -> Any:
    """Module, or context, with the functions of a number; ``math`` for fractions and floats."""
    return import_module("gmpy2") if type(x).__module__.partition(".")[0] == "gmpy2" else getattr(x, "context", math)


@cache
def _elementwise(name: str, rational: bool) -> Callable[..., Any]:
    def of_one(*x: Any) -> Any:
        if not rational and all(isinstance(a, Fraction) for a in x):
            try:
                return exact_function(name)(*x)
            except ValueError:
                return math.nan
        functions = next((f for f in map(_functions, x) if f is not math), math)
        found = getattr(functions, name)(*x)
        return found if found.imag == 0 else functions.nan  # mpmath's roots of negative numbers are complex

    def of_columns(*x: Any) -> Any:
        if any(isinstance(a, np.ndarray) for a in x):
            return np.frompyfunc(of_one, len(x), 1)(*x)
        return of_one(*x)

    return of_columns


@cache
def exact_function(name: str) -> Callable[..., Fraction]:
    """Function of fractions, or a constant, as a function without arguments.

    The root of a square is exact, other values are accurate to ``DIGITS`` digits. The function raises ValueError where
    it has no value.
    """
    from mpmath.ctx_mp import MPContext
    from mpmath.libmp import to_rational

    context: Any = MPContext()
    context.dps = DIGITS

    def value(*x: Fraction) -> Fraction:
        if name == "sqrt" and x[0] >= 0:
            root = Fraction(math.isqrt(x[0].numerator), math.isqrt(x[0].denominator))
            if root * root == x[0]:
                return root
        function = getattr(context, name)
        found = function(*(context.mpf(a.numerator) / a.denominator for a in x)) if x else +function
        if not isinstance(found, context.mpf) or not context.isfinite(found):
            raise ValueError(f"takes {name} of {', '.join(f'{float(a):g}' for a in x)}, which is not a number")
        return Fraction(*map(int, to_rational(found._mpf_)))  # with gmpy2 installed, they are its integers

    return value
