"""Figures of sweeps: the drawn artists equal the rows."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from cases import table_of
from sweep_rows import write_rows
from topcli.errors import UsageError
from topcli.figures.figure import canvas_of
from topcli.figures.sweep import Choice, draw_sweep, scale_of
from topcli.sweeps.table import read_rows

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


def figure_of(frame: pd.DataFrame, choice: Choice) -> Figure:
    choice.require(frame)
    return canvas_of(lambda canvas, _: draw_sweep(canvas.subplots(), frame, choice, "mine"), {}, (6.4, 3.8))


def test_curves_are_medians_with_quartiles_and_slopes(folder: Path) -> None:
    (axes,) = figure_of(read_rows(folder), Choice("h", "max_error", "scheme", aggregate="median")).axes
    assert [line.get_label() for line in axes.lines] == ["HK: 2.00", "RK4: 4.00", "Bohlin A: 1.00"]
    for line, scheme in zip(axes.lines, SCHEMES, strict=True):
        expected = [np.median([error_of(scheme, h, seed) for seed in SEEDS]) for h in sorted(SIZES)]
        np.testing.assert_allclose(line.get_xydata(), np.column_stack([sorted(SIZES), expected]))
    band = axes.collections[0].get_paths()[0].vertices
    low, high = np.quantile([error_of("hk", 0.1, seed) for seed in SEEDS], (0.25, 0.75))
    edge = band[np.isclose(band[:, 0], 0.1), 1]
    assert (edge.min(), edge.max()) == (pytest.approx(low), pytest.approx(high))


def test_values_without_a_place_are_counted_in_the_title() -> None:
    frame = pd.DataFrame({"h": [0.4, 0.2, 0.1, 0.05, 0.025, 0.0125], "v": [1e127, 9e9, math.nan, 1e-3, math.inf, 0.0]})
    (axes,) = figure_of(frame, Choice("h", "v")).axes
    assert axes.lines[0].get_xydata().tolist() == [[0.05, 1e-3], [0.2, 9e9]]
    assert axes.get_title(loc="left") == "mine, 4 of 6 values not shown"


def test_cells_are_those_of_the_rows(folder: Path) -> None:
    choice = Choice("h", "scheme", colour="drift.energy", aggregate="max")
    axes, bar = figure_of(read_rows(folder), choice).axes
    (mesh,) = axes.collections
    expected = [[h**3 for h in sorted(SIZES)]] * 3
    np.testing.assert_allclose(mesh.get_array().reshape(3, 9), expected)
    assert [label.get_text() for label in axes.get_yticklabels()] == ["Bohlin A", "RK4", "HK"]
    assert bar.get_ylabel() == "drift of energy (max)"


def test_names_on_an_axis_have_spreads(folder: Path) -> None:
    frame = read_rows(folder).query("h == 0.1")
    (axes,) = figure_of(frame, Choice("scheme", "max_error", aggregate="mean")).axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["HK", "RK4", "Bohlin A"]
    values = [error_of("hk", 0.1, seed) for seed in SEEDS]
    half = np.std(values, ddof=1) / math.sqrt(3)
    segment = axes.collections[0].get_segments()[0]
    assert segment[:, 1] == pytest.approx([np.mean(values) - half, np.mean(values) + half])


@pytest.mark.parametrize(
    ("values", "scale", "width"),
    table_of("""
[1.0, 99.0]              linear  None
[1.0, 101.0]             log     None
[0.0, 1.0, 101.0, None]  log     None
[-1.0, 101.0]            symlog  1.0
[-1e-20, 5.0]            symlog  5e-10
[0.0, None]              linear  None
"""),
)
def test_scales_follow_the_magnitudes(values: list[Any], scale: str, width: float | None) -> None:
    found = scale_of(np.array(values, dtype=float))
    assert (found["value"], found.get("linthresh")) == (scale, width)


@pytest.mark.parametrize(
    ("choice", "message"),
    table_of("""
x=h y=max_error by=scheme                up to 3 rows have the same h and scheme; add --aggregate median
x=h y=scheme colour=max_error            up to 3 rows have the same h and scheme
x=hh y=max_error                         --x 'hh': no such column; did you mean 'h'
x=h y=max_eror                           --y 'max_eror': no such column; did you mean 'max_error'
x=h y=scheme                             --y 'scheme': has words, not numbers
x=h y=scheme by=seed colour=max_error    --colour and --by cannot be combined
x=h y=max_error by=h                     key 'h' is used twice
x=h y=max_error aggregate=avg            --aggregate 'avg': unknown aggregate
"""),
)
def test_wrong_choices_are_named(folder: Path, choice: str, message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        Choice(**dict(word.split("=") for word in choice.split())).require(read_rows(folder))


def test_the_command_stores_the_rows_that_it_draws(cli: Callable[..., Any], folder: Path) -> None:
    command = ("plot", "sweep", str(folder), "--x", "h", "--y", "max_error", "--by", "scheme", "--where", "seed=2")
    name = "mine_max_error_over_h_by_scheme"
    said = cli(*command, "--format", "png")
    assert said.out == f"{name}: drawn: results/figures/{name}.png, results/figures/{name}.parquet\n"
    data = pd.read_parquet(f"results/figures/{name}.parquet")
    assert data["max_error"].tolist() == [error_of(scheme, h, 2) for scheme in SCHEMES for h in SIZES]
    assert cli(*command[:-1], "seed=1", "--format", "png").code == 0
    assert pd.read_parquet(f"results/figures/{name}.parquet")["max_error"][0] == error_of("hk", 0.1, 1)
    for words, message in (
        ("sweep", "name one folder"),
        (f"sweep {folder} --x h", "keys: scheme, h, seed; measures: max_error, drift.energy"),
        ("fig1 --where h=1", "--where is only for sweeps"),
    ):
        refused = cli("plot", *words.split())
        assert (refused.code, refused.out) == (2, "")
        assert message in refused.err
