"""Figures of studies: points on a torus, period, energies."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import topcli
from drawn_artists import data_of
from topcli.figures import growth, period, torus
from topcli.figures.picture import draw
from topcli.figures.torus import TorusSection


def test_crossings_lie_on_the_section() -> None:
    """Of a motion in circles, whose cubic through samples 0.1 apart is off by 1e-6."""
    t = np.arange(0.0, 20.0, 0.1)
    zero = np.zeros_like(t)
    states = np.column_stack([np.cos(t), np.sin(t), t, zero, zero, zero])
    rates = np.column_stack([-np.sin(t), np.cos(t), np.ones_like(t), zero, zero, zero])
    found = torus.crossings(states, rates, 0.1)
    expected = np.pi * (np.arange(6) + 0.5)
    np.testing.assert_allclose(found[:, 2], expected, atol=1e-5)
    np.testing.assert_allclose(found[:, :2], np.column_stack([0.0 * expected, np.sin(expected)]), atol=1e-5)


@pytest.mark.slow
def test_points_of_the_map_lie_on_the_torus_and_those_of_hk_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torus, "MAP_POINTS", 30_000)
    monkeypatch.setattr(torus, "FLOW_STEPS", 100_000)
    columns = torus.torus_columns()
    states = topcli.simulate("kowalevski_generic_backlund", N=29_999).states
    near = states[np.abs(states[:, 0]) < 0.01]
    np.testing.assert_array_equal(columns["backlund:v"], near[:, 4].astype(np.float32))
    assert (columns["backlund:points"], columns["hk:points"]) == (30_000, 30_000)
    flow = np.column_stack([columns["flow:u"], columns["flow:v"]])

    def distances(scheme: str) -> np.ndarray:
        points = np.column_stack([columns[f"{scheme}:u"], columns[f"{scheme}:v"]])
        return np.array([np.min(np.hypot(*(flow - one).T)) for one in points])

    assert distances("backlund").max() < 0.03  # the thickness of the section, and the gaps of the flow's points
    assert np.median(distances("hk")) > 0.2


def test_points_are_drawn_over_the_torus() -> None:
    """A map that has left its energy surface says so."""
    data = {"hk:u": np.array([0.5]), "hk:v": np.array([0.25]), "hk:points": np.array([21499.0])}
    data |= {"flow:u": np.array([1.0, -1.0]), "flow:v": np.array([0.0, 0.5])}
    (section,) = draw((TorusSection("hk", "(b)"),), data).axes
    assert section.get_title(loc="left") == "(b) HK: 21,499 points, then lost"
    assert [data_of(line).tolist() for line in section.lines] == [[[1.0, 0.0], [-1.0, 0.5]], [[0.5, 0.25]]]
    assert all(line.get_rasterized() for line in section.lines)


@pytest.mark.slow
def test_columns_of_the_period_are_those_of_the_runs() -> None:
    """With few steps: gamma_1 of the rows, the swings of the motion, spacings with the right limits and slope."""
    short = [replace(scheme, exponents=(-2.0, -3.0)) for scheme in period.SCHEMES]
    shown = (("exact", 1e-3), ("bohlin-a", 1e-3))
    progress: list[tuple[int, int]] = []
    columns = period.period_columns(lambda done, total: progress.append((done, total)), short, shown)
    assert progress[-1] == (50_000 + 5 * 55_000, 50_000 + 5 * 55_000)
    assert columns["swings"] == pytest.approx([14.0858, 42.2571], abs=1e-3)
    run = topcli.simulate("kowalevski_bohlin_a")
    np.testing.assert_allclose(columns["gamma1:bohlin-a:0.001"], run["gamma1"][::10], atol=1e-9)
    assert columns["h:hk"].tolist() == [1e-2, 1e-3]
    for name, spacing in (("hk", 28.1722), ("rk2", 28.1699), ("rk4", 28.1714), ("hybrid", 28.1676)):
        assert columns[f"spacing:{name}"][1] == pytest.approx(spacing, abs=2e-4)
    coarse, fine = columns["spacing:bohlin-a"]
    assert fine == pytest.approx(15.2967, abs=1e-3)
    assert fine - coarse == pytest.approx(math.sqrt(2.0) * math.log(10.0), rel=0.01)


def test_energies_are_the_largest_deviations_of_the_runs_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the formula of the energy, for one scheme of each scene; the control drifts."""
    monkeypatch.setattr(growth, "ENERGY_STEPS", 1 << 10)
    columns = growth.energy_columns()
    y = topcli.simulate("kowalevski_generic_hk", scheme="splitting", h=0.05, N=1024).states
    energy = y[:, 0] ** 2 + y[:, 1] ** 2 + 0.5 * y[:, 2] ** 2 + y[:, 3]
    off = np.abs(energy - energy[0]) / (0.49 + 0.16 + 0.5 * 1.69 + 0.6)
    steps = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14, 16, 18, 20, 23, 25, 29, 32]
    assert (columns["t:euler_hk"] / 0.05)[:20] == pytest.approx(steps, rel=1e-12)
    assert columns["t:euler_hk"][-1] == pytest.approx(0.05 * 1024, rel=1e-12)
    largest = [off[: round(t / 0.05) + 1].max() for t in columns["t:kowalevski_generic_hk"]]
    np.testing.assert_allclose(columns["kowalevski_generic_hk:splitting"], largest, rtol=1e-9)
    assert np.nanmax(columns["euler_hk:dmv"]) < 1e-13
    assert columns["euler_hk:splitting"].max() > 1e-5
    assert columns["euler_hk:rk4"][-1] > 2.0 * columns["euler_hk:rk4"][-13]
