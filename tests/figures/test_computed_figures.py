"""Figures of the paper's periods, of chaos, points on a torus and energies, at reduced sizes."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest

import topcli
from topcli.figures import paper, schemes
from topcli.figures.figure import canvas_of


@pytest.mark.slow
def test_chaos_appears_with_the_step_size_in_one_map_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {
        "MAP_SIZE": 4,
        "MAP_STEPS": 2000,
        "ORBIT_STEPS": 4000,
        "ORBITS": 64,
        "STEP_SIZES": (0.05, 0.8),
    }.items():
        monkeypatch.setattr(schemes, name, value)
    columns = schemes.chaos()
    exponents = columns["map:exponent"]
    assert (len(exponents), (exponents == 0.0).sum() > 5, 0.01 < np.nanmax(exponents) < 0.2) == (16, True, True)
    low, high = columns["share:HK, Kowalevski"]
    assert low < 0.05 < 0.2 < high
    assert not columns["share:HK, Lagrange"].any()
    assert not columns["share:Bäcklund, Kowalevski"].any()
    right = canvas_of(partial(schemes.draw_chaos, columns=columns), (7.0, 2.9)).axes[1]
    np.testing.assert_allclose(right.lines[0].get_ydata(), [100.0 * low, 100.0 * high])


@pytest.mark.slow
def test_points_of_the_map_lie_on_the_torus_and_those_of_hk_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schemes, "MAP_POINTS", 30_000)
    columns = schemes.torus_points()
    states = topcli.simulate("kowalevski_generic_backlund", N=29_999).states
    near = states[np.abs(states[:, 0]) < 0.01]
    np.testing.assert_array_equal(columns["backlund:gamma2"], near[:, 4])
    assert (columns["backlund:points"], columns["hk:points"]) == (30_000, 30_000)
    flow = np.column_stack([columns["flow:omega2"], columns["flow:gamma2"]])

    def distances(scheme: str) -> np.ndarray:
        points = np.column_stack([columns[f"{scheme}:omega2"], columns[f"{scheme}:gamma2"]])
        return np.array([np.min(np.hypot(*(flow - point).T)) for point in points])

    assert distances("backlund").max() < 0.03  # the thickness of the section, and the gaps of the flow's points
    assert np.median(distances("hk")) > 0.2
    canvas = canvas_of(
        partial(schemes.draw_torus_points, columns={**columns, "hk:points": np.array([21_499])}), (7.0, 3.8)
    )
    assert canvas.axes[1].get_title(loc="left") == "(b) HK: 21,499 points, then lost"


def test_energies_are_the_largest_deviations_of_the_runs_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the formula of the energy, for one scheme of each scene; the control drifts."""
    monkeypatch.setattr(schemes, "ENERGY_STEPS", 1 << 10)
    columns = schemes.long_energy()
    y = topcli.simulate("kowalevski_generic_hk", scheme="splitting", h=0.05, N=1024).states
    energy = y[:, 0] ** 2 + y[:, 1] ** 2 + 0.5 * y[:, 2] ** 2 + y[:, 3]
    off = np.abs(energy - energy[0]) / (0.49 + 0.16 + 0.5 * 1.69 + 0.6)
    steps = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14, 16, 18, 20, 23, 25, 29, 32]
    assert (columns["t"] / 0.05)[:20] == pytest.approx(steps, rel=1e-12)
    assert columns["t"][-1] == pytest.approx(0.05 * 1024, rel=1e-12)
    largest = [off[: round(t / 0.05) + 1].max() for t in columns["t"]]
    np.testing.assert_allclose(columns["kowalevski_generic_hk:splitting"], largest, rtol=1e-9)
    assert np.nanmax(columns["euler_hk:dmv"]) < 1e-13
    assert columns["euler_hk:rk4"][-1] > 2.0 * columns["euler_hk:rk4"][-13]
    canvas_of(partial(schemes.draw_long_energy, columns=columns), (7.0, 3.2))


@pytest.mark.slow
def test_spacings_follow_the_law_and_scale_as_order_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """With few steps: gamma_1 of the rows, the swings of the motion, spacings with the right limits and slope."""
    monkeypatch.setattr(paper, "LADDERS", dict.fromkeys(paper.LADDERS, (-2.0, -3.0)))
    monkeypatch.setattr(paper, "MOTIONS", (("exact", 1e-3), ("bohlin-a", 1e-3)))
    columns = paper.period()
    assert columns["swings"] == pytest.approx([14.0858, 42.2571], abs=1e-3)
    run = topcli.simulate("kowalevski_bohlin_a")
    np.testing.assert_allclose(columns["gamma1:bohlin-a:0.001"], run["gamma1"][::10], atol=1e-9)
    assert columns["h:hk"].tolist() == [1e-2, 1e-3]
    for name, spacing in (("hk", 28.1722), ("rk2", 28.1699), ("rk4", 28.1714), ("hybrid", 28.1676)):
        assert columns[f"spacing:{name}"][1] == pytest.approx(spacing, abs=2e-4)
    coarse, fine = columns["spacing:bohlin-a"]
    assert fine == pytest.approx(15.2967, abs=1e-3)
    assert fine - coarse == pytest.approx(math.sqrt(2.0) * math.log(10.0), rel=0.01)
    rows = canvas_of(partial(paper.draw_period, columns=columns), (7.0, 4.4)).axes[0].lines
    np.testing.assert_allclose(rows[3].get_ydata(), columns["gamma1:bohlin-a:0.001"] - 2.6)
