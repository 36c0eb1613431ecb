"""The bifurcation diagram and the torus of the Kowalevski top: artists against formulas and integrated orbits."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp
from scipy.spatial import cKDTree

from conftest import GEN, PAPER, ROOT
from drawn_artists import arrows, drawn, explained, labelled, look, seen_from
from seen_colours import lightness
from topcli.analysis.motion.diagram import branches, regions
from topcli.analysis.motion.torus import Torus
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Top
from topcli.errors import UsageError
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Request
from topcli.figures.picture import component_symbol
from topcli.figures.portraits import HARD
from topcli.figures.torus import _closing_count
from topcli.tops import CATALOGUE, gentle_scene
from topcli.tops.kowalevski import Kowalevski

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
    return drawn(FIGURES[name].load(Request(configs=ROOT / "configs")))


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


@pytest.mark.slow
def test_flows_on_the_torus() -> None:
    """The flow of E is the motion; that of k² is its Hamiltonian vector field in the bracket of e(3)."""
    y = np.array(GEN)
    torus = Torus.of(GEN, 1.0)

    def along(rates: tuple[float, float], time: float) -> np.ndarray:
        return torus.states(*(np.array(begin + rate * time) for begin, rate in zip(torus.start, rates, strict=True)))

    for time in (1.0, 20.0):
        expected = reference_states(Kowalevski(), list(GEN), np.array([time]))[0]
        np.testing.assert_allclose(along(torus.energy_rates, time), expected, atol=1e-13)
    w, g = y[:3], y[3:]
    xi = complex(w[0], w[1]) ** 2 - complex(g[0], g[1])
    x = complex(w[0], w[1])
    slope_w = np.array([(4 * xi.conjugate() * x).real, (4 * xi.conjugate() * x * 1j).real, 0.0])  # of |xi|²
    slope_g = np.array([-2 * xi.real, -2 * xi.imag, 0.0])
    moments = np.array([2.0, 2.0, 1.0])
    by_m = slope_w / moments
    expected = np.hstack([(np.cross(moments * w, by_m) + np.cross(g, slope_g)) / moments, np.cross(g, by_m)])
    step = 1e-4
    found = (along(torus.k_sq_rates, step) - along(torus.k_sq_rates, -step)) / (2 * step)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    for shift in ((torus.periods[0], 0.0), (0.0, torus.periods[1])):
        there = torus.states(np.array(torus.start[0] + shift[0]), np.array(torus.start[1] + shift[1]))
        np.testing.assert_allclose(there, y, atol=1e-13)


COORDINATES = np.array([[2, 0, 0, 0, 0, 0], [0, 1, 0.5, 0, 0, 0], [0, 0, 0, 0, -1, 1]])


def seen(states: np.ndarray) -> np.ndarray:
    """Points (m, 3) of the picture of states: right, up, towards the viewer."""
    return seen_from(32.0, 165.0, states @ COORDINATES.T)


@pytest.mark.slow
def test_the_torus_is_drawn_with_its_flows() -> None:
    experiment = load_experiment("kowalevski_torus")
    assert experiment.y0 == TORUS
    (axes,) = figure_of("torus").axes
    lines = labelled(axes)
    assert list(lines) == ["flow of $E$", "flow of $k^2$", "the motion", "initial state"]
    key = explained(axes.figure)
    assert all(same_color(key[name].get_color(), line.get_color()) for name, line in lines.items())
    np.testing.assert_allclose(lines["initial state"].get_xydata()[0], seen(np.array([TORUS]))[0, :2], atol=1e-12)
    # the motion is the orbit, at equal times; hidden points are left out
    path = lines["the motion"].get_xydata()
    span = 1.6 / Torus.of(TORUS, 1.0).energy_rates[1]
    t = np.linspace(0.0, span, len(path))
    orbit = seen(reference_states(Kowalevski(), list(TORUS), t))
    kept = np.isfinite(path[:, 0])
    assert kept.mean() == pytest.approx(0.334, abs=0.02)
    np.testing.assert_allclose(path[kept], orbit[kept, :2], atol=1e-11)
    # every arrow on it points the way of the motion
    pointing = arrows(axes)
    assert len(pointing) > 3  # three belong to the coordinates
    for foot, head in pointing[:-3]:
        at = int(np.nanargmin(np.linalg.norm(path - foot, axis=1)))
        way = orbit[at + 3, :2] - orbit[at, :2]
        assert way @ (head - foot) > 0.95 * np.linalg.norm(way) * np.linalg.norm(head - foot)
    for (foot, head), axis in zip(pointing[-3:], np.linalg.pinv(COORDINATES).T, strict=True):
        expected = seen(axis[None])[0, :2]
        assert (head - foot) @ expected == pytest.approx(
            np.linalg.norm(head - foot) * np.linalg.norm(expected), rel=1e-9
        )


@pytest.mark.parametrize(("axis", "count"), [(0, 11), (1, 16)])
def test_lines_on_the_torus_have_no_seam(axis: int, count: int) -> None:
    """Each line ends where another begins, and its direction is that of the flow to a hundredth."""
    torus = Torus.of(TORUS, 1.0)
    assert _closing_count(torus, axis) == count
    lines = (torus.k_sq_lines, torus.energy_lines)[axis](count, 7)
    first, last = lines[:, 0] @ COORDINATES.T, lines[:, -1] @ COORDINATES.T
    assert np.linalg.norm(first[:, None] - last[None], axis=2).min(axis=0).max() < 1e-9
    rates = (torus.k_sq_rates, torus.energy_rates)[axis]
    turn = rates[1 - axis] / rates[axis] * torus.periods[axis] / torus.periods[1 - axis]
    assert round(count * turn) / count == pytest.approx(turn, rel=0.01)


@pytest.mark.slow
def test_points_behind_the_torus_are_hidden() -> None:
    """A point of a line is shown if no point of the surface is in front of it; nearly all, but for a thin margin."""
    torus = Torus.of(TORUS, 1.0)
    surface = seen(torus.surface(250, 500).reshape(-1, 6))
    (axes,) = figure_of("torus").axes
    points = seen(torus.k_sq_lines(11, 361).reshape(-1, 6))
    drawn_points = labelled(axes)["flow of $k^2$"].get_xydata()
    kept = np.isfinite(drawn_points[:, 0]).tolist()
    kept = np.array([flag for i, flag in enumerate([*kept, False]) if i % 362 != 361])
    size = np.ptp(surface, axis=0).max()
    near = cKDTree(surface[:, :2]).query_ball_point(points[:, :2], 0.006 * size)
    front = np.array([surface[some, 2].max() if some else -np.inf for some in near]) - points[:, 2]
    assert (kept[front > 0.05 * size]).mean() < 0.015
    assert (~kept[front < 0.004 * size]).mean() < 0.05


@pytest.mark.parametrize("name", ["bifurcation", "torus"])
def test_scenes_of_another_top_are_refused(name: str, tmp_path: Path) -> None:
    text = (ROOT / "configs" / "euler_hk.yaml").read_text(encoding="utf-8")
    for scene in ("kowalevski_torus", "kowalevski_generic_hk"):
        (tmp_path / f"{scene}.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=f"{name}: euler_hk is of the top euler, not kowalevski"):
        FIGURES[name].load(Request(configs=tmp_path))


@pytest.mark.slow
def test_a_motion_on_a_separatrix_has_no_torus() -> None:
    with pytest.raises(ValueError, match="not on a torus"):
        Torus.of((0.5, 0.25, 0.0, 0.0, 0.0, 1.0), 1.0)


def integrated(top: Top, y0: tuple[float, ...], t: np.ndarray) -> np.ndarray:
    """States (m, d) by an integrator of SciPy."""
    p = top.constants()
    found = solve_ivp(lambda t, y: type(top).field(tuple(y), p), t[[0, -1]], y0, "DOP853", t, rtol=1e-11, atol=1e-12)
    return found.y.T


def test_portraits_are_exact_motions() -> None:
    """Both curves of every top against another integrator, over the first few units of time."""
    figure = figure_of("catalogue")
    panels = dict(zip(CATALOGUE, figure.axes, strict=True))
    for form, axes in panels.items():
        assert axes.get_title(loc="left") == form
        lines = {line.get_label(): line for line in axes.lines if len(line.get_xdata()) > 1}
        assert [*lines] == ["gentle", "hard"]
        gentle, hard = (lightness(line.get_color()) for line in lines.values())
        assert gentle > hard + 15.0
        assert lines["gentle"].get_linewidth() < 0.85 * lines["hard"].get_linewidth()
        for (case, line), duration in zip(lines.items(), (40.0, 80.0), strict=True):
            scene = load_experiment(gentle_scene(form), HARD[form] if case == "hard" else ())
            t = np.linspace(0.0, duration, 1501)[:61]
            moved = integrated(scene.top, scene.y0, t)
            shown = np.column_stack([line.get_xdata(), line.get_ydata()])[:61]
            plane = [
                next(i for i, name in enumerate(scene.top.components) if component_symbol(name) == label)
                for label in (axes.get_xlabel(), axes.get_ylabel())
            ]
            np.testing.assert_allclose(shown, moved[:, plane], rtol=0.0, atol=1e-7)
