"""The bifurcation diagram of the Kowalevski top: regions and curves against the order of the roots."""

from __future__ import annotations

import math

import numpy as np

from topcli.analysis.motion.kowalevski import branches, regions


def roots(E: float, k_sq: float, two_l: float) -> np.ndarray:
    """Roots of the cubic and (E/3 ± k)/2 for gamma² = 1."""
    m, k, L = E / 3, math.sqrt(k_sq), two_l / 2
    cubic = np.roots([4, 0, -(k_sq - 1 + 3 * m * m), -(m * (k_sq - 1 - m * m) + L * L)])
    return np.array([*cubic, (m + k) / 2, (m - k) / 2])


def region_of(E: float, k_sq: float, two_l: float) -> int:
    """Number of the region by the order of the real roots; 0 if the highest is not (E/3 + k)/2."""
    values = roots(E, k_sq, two_l)
    named = [(float(z.real), "eee45"[i]) for i, z in enumerate(values) if abs(z.imag) < 1e-9]
    word = "".join(name for _, name in sorted(named))
    return {"5e4": 1, "ee5e4": 2, "5eee4": 2, "e5ee4": 3, "e54": 4, "eee54": 5}.get(word, 0)


def test_regions_are_those_of_the_order_of_the_roots() -> None:
    random, seen = np.random.default_rng(1), set()
    for _ in range(500):
        two_l = random.choice([0.3, 1.288, 1.85, 4.0])
        E, k_sq = random.uniform(-1.0, 6.0), random.choice([random.uniform(0.0, 0.1), random.uniform(0.0, 8.0)])
        expected = region_of(E, k_sq, two_l)
        seen.add(expected)
        assert regions(np.array([E]), np.array([k_sq]), two_l / 2, 1.0)[0] == expected
    assert {0, 1, 2, 3, 4} <= seen
    assert regions(np.array([1.88]), np.array([0.015]), 1.85 / 2, 1.0)[0] == 5 == region_of(1.88, 0.015, 1.85)


def test_two_roots_coincide_on_the_curves_and_only_there() -> None:
    for two_l, window in ((0.3, (-0.9, 2.9)), (1.288, (-0.9, 4.9)), (4.0, (3.0, 12.5))):
        kinds = set()
        for branch in branches(two_l / 2, 1.0, window, (0.0, 3.0)):
            kinds.add(branch.kind)
            for at in np.linspace(0, len(branch.E) - 1, 7).astype(int)[1:-1]:
                apart = np.abs(np.subtract.outer(*[roots(branch.E[at], branch.k_sq[at], two_l)] * 2)) + 9 * np.eye(5)
                assert apart.min() < 1e-5
                off = np.abs(np.subtract.outer(*[roots(branch.E[at], branch.k_sq[at] + 0.05, two_l)] * 2)) + 9 * np.eye(
                    5
                )
                assert off.min() > 1e-4
        assert {"separatrix", "periodic", "delone"} <= kinds
