"""Formulas as text: values against Python's own, in every arithmetic, and what is refused."""

from __future__ import annotations

import ast
import math
import re
import struct
import warnings
from contextlib import suppress
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from topcli.arithmetic.sized import Sized
from topcli.engine.native import native
from topcli.engine.numbers import StrayDoubleError, decimals, rationals
from topcli.field.expression import FUNCTIONS, HIGHEST, ExpressionError, function_of, parse, value_of
from topcli.field.polynomial import NotPolynomialError, Polynomial, polynomial_field

Y, P = ("w1", "w2"), ("A", "k")


def value(text: str, y, p):
    return value_of(parse(text, (*Y, *P)), Y, P)(y, p)


numbers = st.sampled_from(["0", "1", "2", "3.", ".5", "0.1", "1e-3", "2.5E+1", "17", "1.7320508075688772"])
operands = numbers | st.sampled_from((*Y, *P, "pi"))
formulas = st.recursive(
    operands,
    lambda inner: (
        st.tuples(inner, st.sampled_from([" + ", "-", " *", "/"]), inner).map("({0[0]}{0[1]}{0[2]})".format)
        | st.tuples(inner, st.sampled_from(["+", " - ", "*", " / "]), operands).map("{0[0]}{0[1]}{0[2]}".format)
        | inner.map("-{}".format)
        | st.tuples(inner, st.sampled_from(["2", "3", "-1", "0", "(4/2)"])).map("({0[0]})**{0[1]}".format)
        | st.tuples(st.sampled_from(["sin", "exp", "tanh", "abs", "acos"]), inner).map("{0[0]}({0[1]})".format)
        | st.tuples(inner, operands).map("atan2({0[0]}, 1.0 + ({0[1]})**2)".format)  # no sign of a zero decides
    ),
    max_leaves=10,
)


def power(x: float, n: int) -> float:
    """Product of those of x, x², x⁴ ... whose exponents add up to |n|, or its inverse: the powers of a formula."""
    product, square = 1.0, x
    for digit in reversed(f"{abs(int(n)):b}"):
        product = product * square if digit == "1" else product
        square *= square
    return 1.0 / product if n < 0 else product


class Products(ast.NodeTransformer):
    """Replacement of Python's powers, which have other bits, by calls of ``power``."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        if not isinstance(node.op, ast.Pow):
            return node
        return ast.Call(ast.Name("power", ast.Load()), [node.left, node.right], [])


def eval_with(text: str, scope):
    """Python's own value; None where it has none."""
    try:
        return eval(text, {"__builtins__": {}}, scope)
    except (ArithmeticError, ValueError):
        return None


def bits(x: float) -> bytes:
    return struct.pack("<d", x)


@settings(max_examples=300, deadline=None)
@given(formulas, st.tuples(*[st.floats(-3.0, 3.0)] * 2))
def test_a_formula_has_the_value_that_python_gives_it(text: str, y) -> None:
    """Of its sums, products, quotients and functions; powers are products."""
    p = (1.3, -0.7)
    scope = {name: getattr(math, name) for name in FUNCTIONS if name != "abs"}
    scope |= {"abs": abs, "pi": math.pi, "power": power}
    products = ast.unparse(Products().visit(ast.parse(text, mode="eval")))
    expected = eval_with(products, scope | dict(zip((*Y, *P), (*y, *p), strict=True)))
    function = function_of("f", [parse(text, (*Y, *P))], Y, P)
    if expected is None:
        with pytest.raises((ArithmeticError, ValueError)):
            function(y, p)
        return
    # whole numbers of the text are doubles, which 17*17*... may outgrow
    (found,) = function(y, p)
    assert bits(found) == bits(float(expected)) or found == pytest.approx(expected, rel=1e-15), text


@settings(max_examples=200, deadline=None)
@given(formulas)
def test_a_formula_is_exact_in_fractions(text: str) -> None:
    assume(not any(name in text for name in ("sin", "exp", "tanh", "acos", "atan2", "pi")))
    y, p = (Fraction(3, 7), Fraction(-2, 9)), (Fraction(13, 10), Fraction(-7, 10))
    exact = re.sub(r"(?<![\w.])(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", r"F('\g<0>')", text)
    expected = eval_with(exact, {"F": Fraction, "abs": abs} | dict(zip((*Y, *P), (*y, *p), strict=True)))
    formula = parse(text, (*Y, *P))
    column = [np.array([x], dtype=object) for x in y]
    if expected is not None:
        found = value_of(formula, Y, P)(column, p)
        assert (found[0] if isinstance(found, np.ndarray) else found) == expected, text


REFUSED = """
kk*w1 -> 1: unknown name 'kk'; did you mean 'k'?
w1 + omega -> 6: unknown name 'omega'; known: w1, w2, A, k
2 w1 -> 3: cannot be read from here on; a product is written 2*x
w1) + (w2 -> 3: cannot be read from here on
w1) -> 3: cannot be read from here on
w1^2 -> 1: only numbers, names, + - * / **, parentheses and sin
w1//2 -> 1: only numbers, names
w[1] -> 1: only numbers, names
0,5*w1 -> 1: only numbers, names
w1 + k(w2) -> 6: only numbers, names
(w1 + w2)(A) -> 1: only numbers, names
w1.real -> 1: only numbers, names
w1 if A else k -> 1: only numbers, names
True -> 1: only numbers, names
1j -> 1: only numbers, names
abs(x for x in w1) -> 4: only numbers, names
__import__ -> 1: unknown name '__import__'
sin + w1 -> 1: sin is a function; write sin(x)
sine(w1) -> 1: unknown name 'sine'; did you mean 'sin'
atan2(w1) -> 1: atan2 is a function; write atan2(y, x)
asin(w1, w2) -> 1: asin is a function; write asin(x)
w1**A -> 5: an exponent is a number, whole or half, of size 24 at most
w1**0.3 -> 5: an exponent is a number, whole or half
w1**25 -> 5: an exponent is a number
1e400 -> 1: '1e400' is no decimal number that a double holds
1_0*w1 -> 1: '1_0' is no decimal number that a double holds
w1 + 9007199254740993 -> 6: '9007199254740993' is no decimal number that a double holds
"""
FAULTS = [("", "is empty"), ("w1 +\n  zz*w2", "line 2, column 3: unknown name 'zz'")]
FAULTS += [("w1" + "+w1" * 20_000, "column 1: has too many nested operations")]
FAULTS += [(text, f"column {message}") for text, message in (line.split(" -> ") for line in REFUSED.split("\n")[1:-1])]


@pytest.mark.parametrize(("text", "message"), FAULTS)
def test_what_is_no_formula_is_refused(text: str, message: str) -> None:
    with pytest.raises(ExpressionError) as error:
        parse(text, (*Y, *P))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


POWERS = tuple(n for n in range(-HIGHEST, HIGHEST + 1))
SPECIAL = (0.0, -0.0, 1.0, -1.0, 1e-200, -1e200, math.inf, math.nan)


def test_compiled_powers_have_the_bits_of_python_and_never_raise() -> None:
    """Of random numbers and special ones, to within the rounding of the products; at 0, 0**-n is infinite."""
    formulas = [parse(f"w1**{n}", Y) for n in POWERS]
    plain = [function_of("power", [formula], Y, ()) for formula in formulas]
    all_powers = function_of("powers", formulas, Y, ())

    def take_steps(work, out):
        values = all_powers((work[0], 0.0), ())
        for i in range(len(POWERS)):
            out[i] = values[i]
        return 1

    compiled, out = native(take_steps, "pp"), np.zeros(len(POWERS))
    for x in (*SPECIAL, *np.random.default_rng(2).normal(size=100).tolist()):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            compiled.checked(np.array([x]), out)
        for n, found, function in zip(POWERS, out.tolist(), plain, strict=True):
            if n < 0 and 0.0 in (x, power(x, -n)):
                with pytest.raises(ZeroDivisionError):
                    function((x, 0.0), ())
                assert abs(found) == math.inf
                continue
            (expected,) = function((x, 0.0), ())
            assert bits(found) == bits(expected) or (math.isnan(found) and math.isnan(expected)), (x, n)
            if 1e-200 < abs(found) < math.inf:  # each product and the quotient round by half an ulp
                exact = mpmath.mpf(x) ** n
                assert abs(found - exact) <= (abs(n) + 1) * 2.0**-53 * abs(exact), (x, n)


def test_half_exponents_are_powers_of_the_root() -> None:
    for text, expected in (("w1**0.5", 1.5), ("w1**(3/2)", 3.375), ("w1**-1.5", 1 / 3.375), ("4**.5*A", 2.0)):
        assert value(text, (2.25, 0.0), (1.0, 1.0)) == pytest.approx(expected, rel=1e-15)
    assert value(f"w1**{HIGHEST}", (2.0, 0.0), (1.0, 1.0)) == 2.0**HIGHEST


def test_columns_and_the_sizes_of_their_terms() -> None:
    w1, w2 = np.array([0.2, -0.5]), np.array([0.1, 3.0])
    p = (1.5, 0.25)
    expected = (1.5 - 0.25) * w2 * w1 + np.sin(w1) ** 2 - abs(w2)
    text = "(A - k)*w2*w1 + sin(w1)**2 - abs(w2)"
    assert value(text, (w1, w2), p) == pytest.approx(expected, rel=1e-15)
    sized = value(text, (Sized(w1), Sized(w2)), p)
    assert sized.size == pytest.approx(1.25 * abs(w2 * w1) + np.sin(w1) ** 2 + abs(w2), rel=1e-15)
    assert value("0.5", (w1, w2), p) == 0.5


def test_a_dense_power_is_refused_before_it_takes_minutes() -> None:
    names = tuple(f"x{i}" for i in range(12))
    field = function_of("field", [parse(f"({'+'.join(names)})**20", names)] * 12, names, ())
    with pytest.raises(NotPolynomialError, match="too long as a polynomial"):
        polynomial_field(field, 12, [])


@pytest.mark.parametrize(
    "text", ["sqrt(2)*w1", "2*pi*w2/3", "atan2(w1 - 1, w2)", "atan2(-1, 3)*w1", "asin(w1) + acos(-w2/7)", "log(3)*pi"]
)
def test_functions_and_constants_have_the_digits_of_the_numbers(text: str) -> None:
    y = Fraction(2, 7), Fraction(1, 3)

    def at(precision: int | str) -> Fraction | float:
        arithmetic = decimals(precision) if isinstance(precision, int) else rationals()
        found = value(text, [np.array([arithmetic.number(x)], dtype=object) for x in y], (1, 1))
        found = found[0] if isinstance(found, np.ndarray) else found
        return found if isinstance(found, float) else arithmetic.fraction(found)

    found = at(40)
    with mpmath.workdps(60):
        scope = {name: getattr(mpmath, name) for name in (*FUNCTIONS, "pi") if name != "abs"}
        expected = eval_with(
            text, scope | {n: mpmath.mpf(x.numerator) / x.denominator for n, x in zip(Y, y, strict=True)}
        )
        assert abs(mpmath.mpf(found.numerator) / found.denominator - expected) < mpmath.mpf(10) ** -39
    with suppress(StrayDoubleError):  # rational numbers have no such values: a float is refused, here or later
        assert isinstance(at("rational"), float)


def test_a_name_of_a_formula_may_be_pi() -> None:
    assert value_of(parse("pi*w1", ("w1", "pi")), ("w1",), ("pi",))((2.0,), (3.0,)) == 6.0
    assert value_of(parse("pi*w1", ("w1",)), ("w1",), ())((2.0,), ()) == 2.0 * math.pi


def test_functions_of_polynomials_are_refused_in_columns_too() -> None:
    column = np.array([Polynomial.variable(0)], dtype=object)
    with pytest.raises(NotPolynomialError):
        value("cos(w1)", (column, column), (1.0, 1.0))
