"""The bifurcation diagram and the torus of the Kowalevski top: artists against formulas and integrated orbits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from conftest import GEN, PAPER
from drawn_artists import drawn, explained, labelled, look
from topcli.analysis.motion.diagram import branches, regions
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Request

TORUS = (-0.4, 0.2, 0.0, -0.28, 0.0, 0.96)
"""Initial state of the scene kowalevski_torus."""


def integrals(y) -> tuple[float, float, float]:
    """E, 2l and k² for c = 1."""
    w1, w2, w3, g1, g2, g3 = y
    E = w1 * w1 + w2 * w2 + 0.5 * w3 * w3 + g1
    return E, 2 * (w1 * g1 + w2 * g2) + w3 * g3, abs(complex(w1, w2) ** 2 - complex(g1, g2)) ** 2


def roots(E: float, k_sq: float, two_l: float) -> np.ndarray:
    """Roots of the cubic and (E/3 ± k)/2 for gamma² = 1."""
    m, k, L = E / 3, math.sqrt(k_sq), two_l / 2
    cubic = np.roots([4, 0, -(k_sq - 1 + 3 * m * m), -(m * (k_sq - 1 - m * m) + L * L)])
    return np.array([*cubic, (m + k) / 2, (m - k) / 2])


def region_of(E: float, k_sq: float, two_l: float) -> int:
    """Number of the region by the order of the real roots; 0 if the highest is not (E/3 + k)/2."""
    found = roots(E, k_sq, two_l)
    named = [(float(z.real), "eee45"[i]) for i, z in enumerate(found) if abs(z.imag) < 1e-9]
    word = "".join(name for _, name in sorted(named))
    return {"5e4": 1, "ee5e4": 2, "5eee4": 2, "e5ee4": 3, "e54": 4, "eee54": 5}.get(word, 0)


def figure_of(name: str) -> Figure:
    return drawn(FIGURES[name].load(Request()))


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
        for one in branches(two_l / 2, 1.0, window, (0.0, 3.0)):
            kinds.add(one.kind)
            for at in np.linspace(0, len(one.E) - 1, 7).astype(int)[1:-1]:
                apart = np.abs(np.subtract.outer(*[roots(one.E[at], one.k_sq[at], two_l)] * 2)) + 9 * np.eye(5)
                assert apart.min() < 1e-5
                off = np.abs(np.subtract.outer(*[roots(one.E[at], one.k_sq[at] + 0.05, two_l)] * 2)) + 9 * np.eye(5)
                assert off.min() > 1e-4
        assert {"separatrix", "periodic", "delone"} <= kinds


@pytest.mark.slow
def test_bifurcation_diagrams_show_scenes_curves_and_tori() -> None:
    figure = figure_of("bifurcation")
    scenes = [("kowalevski_generic_hk", GEN), ("kowalevski_torus", TORUS), None, ("kowalevski_hk", PAPER)]
    tori = {"I": "1 torus", "II": "2 tori", "III": "2 tori", "IV": "2 tori", "V": "4 tori"}
    named, numbered = set(), set()
    for axes, scene in zip(figure.axes, scenes, strict=True):
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("energy $E$", "$k^2$")
        two_l = 1.85
        dots = [line for line in axes.lines if line.get_marker() == "o"]
        assert len(dots) == bool(scene)
        if scene:
            E, two_l, k_sq = integrals(scene[1])
            assert dots[0].get_xydata()[0] == pytest.approx((E, k_sq), rel=1e-12)
            assert [text.get_text() for text in axes.texts if hasattr(text, "xyann")] == [scene[0]]
        assert axes.get_title(loc="left").endswith(rf"$2\ell = {two_l:.6g}$")
        for text in axes.texts:
            name, _, number = text.get_text().partition("\n")
            if name in tori:
                named.add(name)
                assert number in ("", tori[name])
                numbered |= {name} if number else set()
                E, k_sq = text.get_position()
                assert region_of(E, k_sq, two_l) == list(tori).index(name) + 1
        (image,) = axes.images
        codes, (left, right, low, high) = np.asarray(image.get_array()), image.get_extent()
        rows, columns = codes.shape
        for row, column in ((rows // 7, columns // 3), (rows // 2, columns // 2), (rows - 9, columns - 9)):
            E = left + (right - left) * (column + 0.5) / columns
            assert codes[row, column] == region_of(E, low + (high - low) * (row + 0.5) / rows, two_l)
        assert all(line.get_clip_on() for line in axes.lines)  # no curve leaves its panel
    assert named == numbered == set(tori)
    key = explained(figure)
    assert len({(look(line), line.get_linewidth()) for line in key.values()}) == len(key) == 6
    for axes in figure.axes:
        assert all(look(line) == look(key[label]) for label, line in labelled(axes).items())
