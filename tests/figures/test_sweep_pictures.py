"""Figures of sweeps: the drawn artists equal the rows."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from cases import table_of
from sweep_rows import write_rows
from topcli.figures.figure import canvas_of
from topcli.figures.sweep import Choice, draw_sweep, is_geometric, points_of, scale_of
from topcli.sweeps.aggregates import read_rows

SCHEMES = {"hk": 2.0, "rk4": 4.0, "bohlin-a": 1.0}
SIZES = [0.1 * 2.0**-k for k in range(9)]
SEEDS = (1, 2, 3)


def error_of(scheme: str, h: float, seed: int) -> float:
    """An error of the scheme's order with a plateau near 1e-9, different for each row."""
    return max(h ** SCHEMES[scheme] * (1.0 + 0.1 * seed), 1e-9 * (1.0 + 0.01 * seed))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rows = list(itertools.product(SCHEMES, SIZES, SEEDS))
    keys = {name: [row[i] for row in rows] for i, name in enumerate(("scheme", "h", "seed"))}
    drifts = [(-1.0) ** seed * h**3 for _, h, seed in rows]
    return write_rows(tmp_path / "mine", keys, {"max_error": [error_of(*row) for row in rows], "drift.energy": drifts})


def figure_of(rows: pd.DataFrame, choice: Choice) -> Figure:
    return canvas_of(lambda canvas: draw_sweep(canvas.subplots(), points_of(rows, choice), "mine"), (6.4, 3.8))


def test_curves_are_medians_with_quartiles_and_slopes(folder: Path) -> None:
    (axes,) = figure_of(read_rows(folder), Choice("h", "max_error", "scheme", aggregate="median")).axes
    assert axes.get_legend_handles_labels()[1] == ["HK: 2.00", "RK4: 4.00", "Bohlin A: 1.00"]
    assert axes.get_ylabel() == "max error (median [quartiles])"
    for line, scheme in zip(axes.lines, SCHEMES, strict=True):
        expected = [np.median([error_of(scheme, h, seed) for seed in SEEDS]) for h in sorted(SIZES)]
        np.testing.assert_allclose(line.get_xydata(), np.column_stack([sorted(SIZES), expected]))
    band = axes.collections[0].get_paths()[0].vertices
    edge = band[np.isclose(band[:, 0], 0.1), 1]
    quartiles = np.quantile([error_of("hk", 0.1, seed) for seed in SEEDS], (0.25, 0.75))
    assert (edge.min(), edge.max()) == pytest.approx(quartiles)


def test_values_without_a_place_are_counted_in_the_title(tmp_path: Path) -> None:
    sizes, values = [0.4, 0.2, 0.1, 0.05, 0.025, 0.0125], [1e127, 9e9, math.nan, 1e-3, math.inf, 0.0]
    rows = read_rows(write_rows(tmp_path / "few", {"h": sizes}, {"v": values}))
    (axes,) = figure_of(rows, Choice("h", "v")).axes
    assert axes.lines[0].get_xydata().tolist() == [[0.05, 1e-3], [0.2, 9e9]]
    assert axes.get_title(loc="left") == "mine, 4 of 6 values not shown"


def test_a_mean_is_of_all_its_rows_whatever_the_scale(tmp_path: Path) -> None:
    """Zeros have no place on a logarithmic axis, and values beyond it none on any; both count in a mean."""
    keys = {"N": [20, 20, 50, 50, 5000, 5000], "seed": [1, 2, 1, 2, 1, 2]}
    rows = read_rows(write_rows(tmp_path / "few", keys, {"v": [0.0, 1.0, 0.0, 3.0, 900.0, 2e12]}))
    (axes,) = figure_of(rows, Choice("N", "v", aggregate="mean")).axes
    assert axes.get_yscale() == "linear"
    assert axes.lines[0].get_xydata().tolist() == [[20, 0.5], [50, 1.5]]
    assert axes.get_title(loc="left") == "mine, 1 of 3 points not shown"


def test_cells_are_those_of_the_rows(folder: Path) -> None:
    choice = Choice("h", "scheme", colour="drift.energy", aggregate="max")
    axes, bar = figure_of(read_rows(folder), choice).axes
    (mesh,) = axes.collections
    expected = [[h**3 for h in sorted(SIZES)]] * 3
    np.testing.assert_allclose(mesh.get_array().reshape(3, 9), expected)
    assert [label.get_text() for label in axes.get_yticklabels()] == ["Bohlin A", "RK4", "HK"]
    assert bar.get_ylabel() == "drift of energy (max)"


def test_names_on_an_axis_have_spreads(folder: Path) -> None:
    (axes,) = figure_of(read_rows(folder, ["h=0.1"]), Choice("scheme", "max_error", aggregate="mean")).axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["HK", "RK4", "Bohlin A"]
    values = [error_of("hk", 0.1, seed) for seed in SEEDS]
    half = np.std(values, ddof=1) / math.sqrt(3)
    segment = axes.collections[0].get_segments()[0]
    assert segment[:, 1] == pytest.approx([np.mean(values) - half, np.mean(values) + half])
    (axes,) = figure_of(read_rows(folder, ["h=0.1"]), Choice("scheme", "drift.energy", aggregate="median")).axes
    assert axes.collections[0].get_segments()[0][:, 1] == pytest.approx([-1e-3, 0.0], abs=1e-15)


@pytest.mark.parametrize(
    ("values", "scale", "width", "geometric"),
    table_of("""
[1.0, 99.0]                linear  None   False
[1.0, 10.0, 101.0]         log     None   True
[1.0, 2.0, 4.0]            linear  None   True
[1.0, 2.0, 3.0]            linear  None   False
[0.0, 1.0, 101.0]          log     None   False
[-1.0, 101.0]              symlog  1.0    False
[-1e-20, 5.0]              symlog  5e-10  False
"""),
)
def test_scales_follow_the_magnitudes(values: list[float], scale: str, width: float | None, geometric: bool) -> None:
    expected = {"value": scale} | ({"linthresh": width} if width else {})
    assert (scale_of(np.array(values)), is_geometric(np.array(values))) == (expected, geometric)


def test_the_command_stores_the_points_that_it_draws(cli: Callable[..., Any], folder: Path) -> None:
    command = ("plot", "sweep", str(folder), "--x", "h", "--y", "max_error", "--by", "scheme", "--where", "seed=2")
    name = "mine_max_error_over_h_by_scheme"
    output = cli(*command, "--format", "png")
    assert output.out == f"{name}: drawn: results/figures/{name}.png, results/figures/{name}.parquet\n"
    columns = pd.read_parquet(f"results/figures/{name}.parquet")
    assert columns["value"].tolist() == [error_of(scheme, h, 2) for scheme in SCHEMES for h in SIZES]
    assert cli(*command[:-1], "seed=1", "--format", "png").code == 0
    assert pd.read_parquet(f"results/figures/{name}.parquet")["value"][0] == error_of("hk", 0.1, 1)
