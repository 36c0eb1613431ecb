"""Preprocessed moments of the discrete Moser-Veselov scheme: their coefficients, orders, and what stays exact."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from conftest import GEN
from stepping import Steps, made, states_of
from topcli.analysis.reference import reference_states
from topcli.contracts import Top
from topcli.engine.loop import Run
from topcli.errors import UsageError
from topcli.schemes.any_top.dmv import scale_coefficients, shift_coefficients
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

EPS = 2.0**-52


def test_preprocessed_moments_are_refused_with_a_reason() -> None:
    with pytest.raises(UsageError, match="moments: preprocessed needs a free body"):
        made(Kowalevski(), "dmv", moments="preprocessed")
    with pytest.raises(UsageError, match="order: 6 needs moments: preprocessed"):
        made(Euler(), "dmv", order=6)
    assert made(Kowalevski(c0=0.0), "dmv", moments="preprocessed").iterative


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"moments": "preprocessed"}, {"moments": "preprocessed", "order": 10}])
def test_moser_veselov_keeps_momentum_and_energy(options: dict) -> None:
    top = Euler()
    run = Run(top, made(top, "dmv", **options), GEN[:3], 0.1, 100_000, 100)
    states = run.collect().states
    for value in (np.square(states * (3.0, 2.0, 1.0)).sum(axis=1), (np.square(states) * (3.0, 2.0, 1.0)).sum(axis=1)):
        assert np.abs(value - value[0]).max() < 50.0 * EPS * math.sqrt(1e5) * value[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "counts"),
    [
        (4, (60, 120)),
        (6, (40, 80)),
        (8, (28, 56)),
        (10, (24, 48)),
    ],
)
@pytest.mark.parametrize("top", [Euler(), EulerGamma(A=1.3, B=2.0, C=0.9), Lagrange(mu=0.0)], ids=repr)
def test_preprocessed_moments_raise_the_order(top: Top, order: int, counts: tuple[int, int]) -> None:
    """For omega and for gamma, by the root mean square of the errors from twelve states each."""
    step, vectors = Steps(top, "dmv", moments="preprocessed", order=order), len(top.components) // 3
    errors = []
    for y in states_of(top, 12, seed=26):
        y[:3] *= 0.7
        truth = reference_states(top, tuple(y.tolist()), np.array([4.0]))[0]
        misses = [step(y, 4.0 / N, N) - truth for N in counts]
        errors.append([[np.linalg.norm(miss[part]) for part in (slice(0, 3), slice(3, 6))] for miss in misses])
    coarse, fine = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.log2(coarse[:vectors] / fine[:vectors]) == pytest.approx(order, abs=0.1)


def series_product(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    return [sum((a[k] * b[n - k] for k in range(n + 1)), Fraction(0)) for n in range(len(a))]


def exact_cayley_vector(i: list[Fraction], m: list[Fraction], length: int) -> list[list[Fraction]]:
    """Power series in h of the Cayley vector of the free motion: c' = (omega + c (c . omega) + c x omega)/2."""
    axes = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    w = [[i[a] * m[a]] + [Fraction(0)] * length for a in range(3)]
    c = [[Fraction(0)] * (length + 1) for _ in range(3)]
    for n in range(length):
        for a, j, k in axes:  # I omega' = m x omega
            turn = sum(w[j][q] * w[k][n - q] for q in range(n + 1)) * (1 / i[j] - 1 / i[k])
            w[a][n + 1] = i[a] * turn / (n + 1)
    for n in range(length):
        inner = [sum(c[a][q] * w[a][t - q] for a in range(3) for q in range(t + 1)) for t in range(n + 1)]
        for a, j, k in axes:
            rate = w[a][n] + sum(
                c[a][q] * inner[n - q] + c[j][q] * w[k][n - q] - c[k][q] * w[j][n - q] for q in range(n + 1)
            )
            c[a][n + 1] = rate / 2 / (n + 1)
    return c


@pytest.mark.slow
@pytest.mark.parametrize("order", [4, 6, 8, 10])
def test_coefficients_of_the_modified_moments_are_exact(order: int) -> None:
    """In rational numbers c = k (1 + |c|²) - r c c holds for the exact motion up to h^order, and fails beyond."""
    random = np.random.default_rng(27)
    length = order + 1
    for _ in range(5):
        i: list[Any] = [Fraction(int(n), int(d)) for n, d in zip((3, 5, 8), random.integers(1, 9, 3), strict=True)]
        m = [Fraction(int(n), 3) for n in random.integers(1, 9, 3)]
        c = exact_cayley_vector(i, m, length)
        square: Any = sum(x * x for x in m) / 2
        energy: Any = sum(x * x * y for x, y in zip(m, i, strict=True)) / 2
        scale: list[Any] = [Fraction(0)] * (length + 1)
        shift = list(scale)
        scale[0] = Fraction(1)
        e1, e2, e3 = sum(i), i[0] * i[1] + i[1] * i[2] + i[2] * i[0], i[0] * i[1] * i[2]
        powers = [(p - q, q) for p in range(1, order // 2) for q in range(p + 1)]
        terms = zip(powers, scale_coefficients(e1, e2, e3), shift_coefficients(e1, e2, e3), strict=False)
        for (p, q), s, d in terms:
            scale[2 * (p + q)] += s * square**p * energy**q
            shift[2 * (p + q)] += d * square**p * energy**q
        inverse = [[one * x + y for x, y in zip(scale, shift, strict=True)] for one in i]
        norm = [Fraction(n == 0) + sum(series_product(x, x)[n] for x in c) for n in range(length + 1)]
        # times 2 J_j J_k: h m_i j_i (1 + |c|²) j_j j_k - 2 c_i j_j j_k - 2 (j_j - j_k) j_i c_j c_k
        for a, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            pair = series_product(inverse[j], inverse[k])
            first = series_product(series_product(inverse[a], pair), norm)
            first = [Fraction(0), *(m[a] * x for x in first[:-1])]
            second = series_product(c[a], pair)
            gap = [x - y for x, y in zip(inverse[j], inverse[k], strict=True)]
            third = series_product(series_product(gap, inverse[a]), series_product(c[j], c[k]))
            left = [x - 2 * (y + z) for x, y, z in zip(first, second, third, strict=True)]
            assert not any(left[: order + 1])
            assert left[order + 1] != 0
