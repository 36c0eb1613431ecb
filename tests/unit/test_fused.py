"""The fused multiply-add: exact fractions against the processor, bit for bit."""

from __future__ import annotations

import itertools
import math

import numpy as np

from topcli.arithmetic.fused import fma
from topcli.engine.native import native

SPECIAL = (0.0, -0.0, math.inf, -math.inf, math.nan, 5e-324, -5e-324, 1e308, -1e308, 1.0)


def each(a, b, c, out, n):
    for i in range(n):
        out[i] = fma(a[i], b[i], c[i])
    return 0


def naive(a, b, c, out, n):
    for i in range(n):
        out[i] = a[i] * b[i] + c[i]
    return 0


def operands() -> list[np.ndarray]:
    """Any bit patterns, sums that cancel, and every triple of special values."""
    rng = np.random.default_rng(1)
    a, b, c = rng.integers(0, 2**64, (3, 4000), dtype=np.uint64).view(float)
    x, y = rng.normal(size=(2, 2000))
    special = np.array(list(itertools.product(SPECIAL, repeat=3))).T
    return [np.concatenate(pieces) for pieces in zip((a, b, c), (x, y, -x * y), special, strict=True)]


def test_the_instruction_is_the_exact_operation_rounded_once() -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        a, b, c = operands()
    fused, unfused = np.zeros_like(a), np.zeros_like(a)
    native(each, "ppppq")(a, b, c, fused, len(a))
    native(naive, "ppppq")(a, b, c, unfused, len(a))
    exact = np.array([fma(*values) for values in zip(a.tolist(), b.tolist(), c.tolist(), strict=True)])
    bits, wanted = fused.view(np.uint64), exact.view(np.uint64)
    assert np.all((bits == wanted) | (np.isnan(fused) & np.isnan(exact)))
    assert np.sum(unfused[4000:6000] == 0.0) == 2000  # the compiler fuses nothing by itself
    assert np.sum(fused[4000:6000] != 0.0) > 1900
