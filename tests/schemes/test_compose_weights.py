"""The weights of the compositions against the order conditions, in exact arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest

from topcli.schemes.compose import COMPOSITIONS, palindrome

by_composition = pytest.mark.parametrize("name", COMPOSITIONS)


def words(degree: int) -> list[tuple[int, ...]]:
    """The products of the generators X1, X3, X5, ... of degree up to ``degree``, the empty one first."""
    made = [()]
    for word in made:
        made += [(*word, k) for k in range(1, degree - sum(word) + 1, 2)]
    return made


def residual(weights: tuple[float, ...], order: int) -> float:
    """By how much a composition of exp(c X1 + c³ X3 + c⁵ X5 + ...) differs from exp(X1) up to degree ``order``.

    The largest coefficient of the difference in the free associative algebra, where nothing but what holds for every
    base of order 2 vanishes. Computed with fractions, from the weights as they are, rounded.
    """
    basis = words(order)
    product = {word: Fraction(word == ()) for word in basis}
    for weight in weights:
        c = Fraction(weight)
        stage = {word: c ** sum(word) / math.factorial(len(word)) for word in basis}
        product = {word: sum(product[word[:k]] * stage[word[k:]] for k in range(len(word) + 1)) for word in basis}
    exact = {word: Fraction(set(word) <= {1}) / math.factorial(len(word)) for word in basis}
    return float(max(abs(product[word] - exact[word]) for word in basis))


@pytest.mark.slow
@by_composition
def test_order_conditions(name: str) -> None:
    """Met to 1e-15 up to the order that is said, missed by far at the next order, missed by weights a bit off."""
    found = COMPOSITIONS[name]
    assert residual(found.weights, found.order) < 1e-15
    assert residual(found.weights, found.order + 2) > 1e-7
    half = found.weights[: found.stages // 2]
    for i in range(len(half)):
        off = palindrome(*half[:i], half[i] + 1e-11, *half[i + 1 :])
        assert 1.7e-12 < residual(off, found.order) < 1.3e-10


def test_number_of_conditions() -> None:
    """The number of conditions is that of the theory, and one stage alone has order 2."""
    assert [len(words(n)) - len(words(n - 1)) for n in range(1, 9)] == [1, 1, 2, 3, 5, 8, 13, 21]
    assert residual((1.0,), 2) == 0.0
    assert residual((1.0,), 4) == 1.0


@by_composition
def test_weights_are_palindromes_that_add_up_to_one(name: str) -> None:
    weights = COMPOSITIONS[name].weights
    assert weights == weights[::-1]
    assert len(weights) % 2 == 1
    assert abs(sum(map(Fraction, weights)) - 1) <= Fraction(math.ulp(weights[len(weights) // 2])) / 2


def test_weights_in_the_middle_are_the_published_ones() -> None:
    assert COMPOSITIONS["kahan-li6"].weights[4] == pytest.approx(0.79854399093482996340, rel=0, abs=1e-15)
    assert COMPOSITIONS["kahan-li8"].weights[8] == pytest.approx(-0.60550853383003451170, rel=0, abs=1e-15)
