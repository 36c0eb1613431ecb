"""Figures of sweeps and of orders: the drawn artists equal the rows, and slopes those that the rows have."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases import table_of
from drawn_artists import data_of, drawn, explained
from sweep_rows import write_rows
from topcli.errors import UsageError
from topcli.figures.figure import Request
from topcli.figures.sweep import Choice, scale_of, sweep_figure
from topcli.sweeps.rows import read_rows
from topcli.sweeps.run import SWEEP_FILE

NAN = math.nan
SCHEMES = {"hk": 2.0, "rk4": 4.0, "bohlin-a": 1.0}
SIZES = [0.1 * 2.0**-k for k in range(9)]
SEEDS = (1, 2, 3)
FLOOR = 1e-9


def error_of(scheme: str, h: float, seed: int) -> float:
    """An error of the scheme's order with a plateau near ``FLOOR``, different for each row."""
    return max(h ** SCHEMES[scheme] * (1.0 + 0.1 * seed), FLOOR * (1.0 + 0.01 * seed))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rows = list(itertools.product(SCHEMES, SIZES, SEEDS))
    errors = [error_of(*row) for row in rows]
    for i, (scheme, h, _) in enumerate(rows):
        if (scheme, h) == ("bohlin-a", SIZES[-1]):
            errors[i] = NAN
    drifts = [(-1.0) ** seed * h**3 for _, h, seed in rows]
    keys = {name: [row[i] for row in rows] for i, name in enumerate(("scheme", "h", "seed"))}
    outcome = ["no_convergence" if math.isnan(error) else "completed" for error in errors]
    measures = {"max_error": errors, "drift.energy": drifts, "median_swing_spacing": [28.0 + h for _, h, _ in rows]}
    return write_rows(tmp_path / "mine", keys, measures, outcome=outcome, log=["h"])


def figure_of(folder: Path, choice: Choice, where: tuple[str, ...] = ()) -> Figure:
    return drawn(sweep_figure(read_rows(folder).where(where), choice).load(Request()))


def points(line: Line2D) -> list[tuple[float, float]]:
    return [(x, y) for x, y in data_of(line).tolist()]


def test_an_exploded_run_is_an_arrowhead_at_the_upper_edge(tmp_path: Path) -> None:
    values = [1e127, 9e9, 1.1e10, 1e-3, math.inf]
    folder = write_rows(tmp_path / "x", {"h": [0.4, 0.2, 0.1, 0.05, 0.025]}, {"v": values}, log=["h"])
    (axes,) = figure_of(folder, Choice("h", "v")).axes
    (line,) = (one for one in axes.lines if one.get_marker() == "o")
    assert points(line) == [(0.05, 1e-3), (0.2, 9e9)]
    (above,) = (one for one in axes.lines if one.get_marker() == "^")
    assert points(above) == [(0.025, 0.975), (0.1, 0.975), (0.4, 0.975)]
    assert above.get_transform() == axes.get_xaxis_transform()
    assert axes.get_ylim()[1] < 1e12
    assert list(explained(axes.figure)) == ["v", "above 1e+10"]


@pytest.mark.parametrize(
    ("values", "scale", "width"),
    table_of("""
[1.0, 99.0]              linear  0.0
[1.0, 101.0]             log     0.0
[0.0, 1.0, 101.0, None]  log     0.0
[-1.0, 99.0]             linear  0.0
[-1.0, 101.0]            symlog  1.0
[-1e-20, 5.0]            symlog  5e-10
[-1.0, -101.0]           symlog  1.0
[0.0, None]              linear  0.0
[1.0, 1e999]             linear  0.0
"""),
)
def test_scales_follow_the_magnitudes(values: list[Any], scale: str, width: float) -> None:
    assert scale_of(np.array(values, dtype=float)) == (scale, width)


@pytest.mark.parametrize(
    ("choice", "message"),
    table_of("""
x=h y=max_error by=scheme                up to 3 values fall into one point, because seed still varies
x=h y=scheme colour=max_error            up to 3 values fall into one point
x=hh y=max_error                         --x: unknown key 'hh'; did you mean 'h'
x=h y=error                              --y: unknown measure 'error'; did you mean 'max_error'
x=h y=scheme                             --y: 'scheme' is a key; give a measure
x=h y=max_error colour=drift.energy      --y: 'max_error' is a measure; give a varied key
x=h y=scheme colour=drift.enrgy          --colour: unknown measure 'drift.enrgy'; did you mean 'drift.energy'
x=h y=scheme by=seed colour=max_error    --colour and --by cannot be combined
x=h y=max_error by=h                     key 'h' is used twice
x=h y=max_error by=sceme                 --by: unknown key 'sceme'; did you mean 'scheme'
x=h y=max_error aggregate=avg            --aggregate 'avg': unknown aggregate
"""),
)
def test_wrong_choices_are_named(folder: Path, choice: str, message: str) -> None:
    given = dict(word.split("=") for word in choice.split())
    with pytest.raises(UsageError, match=re.escape(message)):
        sweep_figure(read_rows(folder), Choice(**given)).load(Request())


@pytest.mark.slow
def test_the_command_draws_stores_and_repeats_nothing(cli: Callable[..., Any], folder: Path) -> None:
    command = ("plot", "sweep", str(folder), "--x", "h", "--y", "max_error", "--by", "scheme", "--where", "seed=2")
    said = cli(*command, "--format", "png")
    name = "mine_max_error_over_h_by_scheme"
    assert said.out == f"{name}: drawn: results/figures/{name}.png, results/figures/{name}.parquet\n"
    assert said.err.splitlines() == [
        "1 of 27 rows did not complete: 1 no_convergence",
        "1 of 27 values could not be computed (nan)",
    ]
    data = pq.read_table(f"results/figures/{name}.parquet")
    assert data.column("hk:y").to_pylist() == [error_of("hk", h, 2) for h in sorted(SIZES)]
    assert cli(*command, "--format", "png", "--json").json()["figures"][0]["status"] == "up to date"
    other = cli(*command[:-1], "seed=1", "--format", "png", "--json").json()
    assert other["figures"][0]["status"] == "drawn"
    path = folder / "rows.parquet"
    table = pq.read_table(path)
    pq.write_table(table.slice(0, 60), path)
    assert cli(*command[:-1], "seed=1", "--format", "png", "--json").json()["figures"][0]["status"] == "drawn"


@pytest.mark.parametrize(
    ("arguments", "message"),
    table_of("""
sweep                  name one folder
sweep a b              name one folder
sweep nowhere --x h    no such file or folder
fig1 --x h             --x is only for sweeps
fig1 --where h=1       --where is only for sweeps
--all --aggregate max  --aggregate is only for sweeps
"""),
)
def test_wrong_commands_are_named(cli: Callable[..., Any], arguments: str, message: str) -> None:
    said = cli("plot", *arguments.split())
    assert (said.code, said.out) == (2, "")
    assert message in said.err


def test_a_sweep_is_not_taken_for_a_figure(cli: Callable[..., Any], folder: Path) -> None:
    """A misspelt name is named; without names, keys and measures are listed."""
    (folder / SWEEP_FILE).write_text("")  # as the folder of a sweep, which given as a figure would need a hint
    assert "is a sweep, not a figure" in cli("plot", str(folder)).err
    said = cli("plot", "sweep", str(folder), *["--x", "h", "--y", "max_error", "--where", "shceme=hk"])
    assert (said.code, said.out) == (2, "")
    assert said.err == "error: --where: unknown key 'shceme'; did you mean 'scheme' or 'seed'?\n"
    said = cli("plot", "sweep", str(folder), "--x", "h")
    assert said.code == 2
    assert "keys: scheme, h, seed; measures: max_error, drift.energy, median_swing_spacing" in said.err
