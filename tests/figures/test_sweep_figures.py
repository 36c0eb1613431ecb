"""Figures of sweeps and of orders: the drawn artists equal the rows, and slopes those that the rows have."""

from __future__ import annotations

import itertools
import math
import re
import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases import table_of
from drawn_artists import SHOWN, data_of, drawn, explained, labelled
from sweep_rows import write_rows
from topcli.errors import UsageError
from topcli.figures.curves import cell_edges, symlog_ticks
from topcli.figures.errors import loaded_order
from topcli.figures.figure import Request
from topcli.figures.style import styled
from topcli.figures.sweep import MOST_KEYS, Choice, scale_of, sweep_figure, sweep_notes
from topcli.studies.order_ladders import SCHEMA_VERSION
from topcli.studies.study import Result
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


def test_curves_are_the_rows_with_their_slopes(folder: Path) -> None:
    """The plateau is dotted and its markers are open; a point without a value is a cross at the edge."""
    (axes,) = figure_of(folder, Choice("h", "max_error", "scheme"), ("seed=2",)).axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("step size h", "max error")
    assert axes.get_title(loc="left") == "mine, seed = 2"
    for scheme, line in labelled(axes).items():
        known = [(h, error_of(scheme, h, 2)) for h in sorted(SIZES) if (scheme, h) != ("bohlin-a", SIZES[-1])]
        assert points(line) == known
    looks = {(to_rgb(line.get_color()), line.get_marker()) for line in labelled(axes).values()}
    assert len(looks) == 3
    shown = explained(axes.figure)
    assert {text: shown[text].get_color() for text in shown if ":" in text} == {
        str(line.get_label()): line.get_color() for line in labelled(axes).values()
    }
    assert set(shown) == {"HK: 2.00", "RK4: 4.00", "Bohlin A: 1.00", "round-off", "no value"}
    legend = axes.get_legend()
    assert legend
    assert legend.get_title().get_text() == "scheme: slope"
    (dotted,) = (line for line in axes.lines if line.get_linestyle() == ":")
    flat = sorted(h for h in SIZES if h**4 * 1.2 < 2.0 * FLOOR * 1.02)
    assert len(flat) > 2
    assert points(dotted) == [(flat[0], FLOOR * 1.02), (flat[-1], FLOOR * 1.02)]
    (hollow,) = (one for one in axes.lines if to_rgb(one.get_markerfacecolor()) == (1.0, 1.0, 1.0))
    assert [x for x, _ in points(hollow)] == flat
    assert dotted.get_color() == hollow.get_color() == labelled(axes)["rk4"].get_color()
    (cross,) = (line for line in axes.lines if line.get_marker() == "x")
    assert points(cross) == [(SIZES[-1], pytest.approx(0.05, abs=0.05))]
    assert cross.get_transform() == axes.get_xaxis_transform()
    assert cross.get_color() == labelled(axes)["bohlin-a"].get_color()


def test_the_median_has_a_band_of_quartiles(folder: Path) -> None:
    (axes,) = figure_of(folder, Choice("h", "max_error", "scheme", aggregate="median")).axes
    assert axes.get_ylabel() == "max error (median and quartiles)"
    bands = list(axes.collections)
    assert len(bands) == 3
    for band, (scheme, line) in zip(bands, labelled(axes).items(), strict=True):
        assert to_rgb(band.get_facecolor()[0]) == to_rgb(line.get_color())
        drawn_points = {tuple(map(float, one)) for one in band.get_paths()[0].vertices}  # type: ignore[union-attr]
        for h, middle in points(line):
            values = [error_of(scheme, h, seed) for seed in SEEDS]
            low, median, high = statistics.quantiles(values, n=4, method="inclusive")
            assert middle == pytest.approx(median, rel=1e-14)
            ends = sorted(y for x, y in drawn_points if x == h)
            assert (ends[0], ends[-1]) == pytest.approx((low, high), rel=1e-12)


@pytest.mark.slow
def test_the_mean_has_its_standard_error_and_the_maximum_no_band(folder: Path) -> None:
    (axes,) = figure_of(folder, Choice("h", "median_swing_spacing", aggregate="mean")).axes
    assert axes.get_ylabel() == "median swing spacing (mean ± standard error)"
    assert axes.get_yscale() == "linear"
    ((h, mean), *_) = points(labelled(axes)["median_swing_spacing"])
    assert mean == pytest.approx(28.0 + h, rel=1e-14)
    assert axes.get_legend() is None, "the vertical axis says what it is"
    (axes,) = figure_of(folder, Choice("h", "max_error", "scheme", aggregate="max")).axes
    assert not axes.collections
    assert dict(points(labelled(axes)["hk"]))[0.1] == error_of("hk", 0.1, 3)


def test_values_of_both_signs_have_a_scale_with_two_sides(folder: Path) -> None:
    (axes,) = figure_of(folder, Choice("h", "drift.energy", "seed"), ("scheme=hk",)).axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "symlog")
    assert set(labelled(axes)) == {"seed = 1", "seed = 2", "seed = 3"}
    assert points(labelled(axes)["seed = 1"]) == [(h, -(h**3)) for h in sorted(SIZES)]
    assert axes.yaxis.get_transform().linthresh == SIZES[-1] ** 3  # type: ignore[attr-defined]
    assert list(explained(axes.figure)) == list(labelled(axes))


def test_names_along_x_have_their_points_side_by_side(folder: Path) -> None:
    choice = Choice("scheme", "max_error", "h", aggregate="median")
    (axes,) = figure_of(folder, choice, (f"h={SIZES[0]}", f"h={SIZES[1]}")).axes
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["HK", "RK4", "Bohlin A"]
    assert (axes.get_xscale(), list(labelled(axes))) == ("linear", ["h = 0.1", "h = 0.05"])
    for h, shift, line in zip(SIZES, (-0.06, 0.06), labelled(axes).values(), strict=False):
        assert line.get_linestyle() == "None"
        medians = [(i + shift, error_of(scheme, h, 2)) for i, scheme in enumerate(SCHEMES)]
        np.testing.assert_allclose(points(line), medians, rtol=1e-13)
    bars = [segment for one in axes.collections for segment in one.get_segments()]  # type: ignore[attr-defined]
    ends = {(round(float(x), 2), float(low), float(high)) for (x, low), (_, high) in bars}
    for i, scheme in enumerate(SCHEMES):
        values = [error_of(scheme, 0.1, seed) for seed in SEEDS]
        low, _, high = statistics.quantiles(values, n=4, method="inclusive")
        assert any(end == pytest.approx((i - 0.06, low, high), rel=1e-12) for end in ends)


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


@pytest.mark.slow
def test_a_dollar_is_no_mathematics(tmp_path: Path) -> None:
    keys = {"$x$": [1.0, 2.0, 1.0, 2.0], r"$\b": [r"$\nothing$", r"$\nothing$", "b", "b"]}
    folder = write_rows(tmp_path / "$a$", keys, {r"$\v$": [1.0, 2.0, 3.0, 4.0]})
    for choice in (
        Choice("$x$", r"$\v$", r"$\b"),
        Choice(r"$\b", r"$\v$", "$x$"),
        Choice("$x$", r"$\b", colour=r"$\v$"),
    ):
        figure = figure_of(folder, choice, ("$x$=1", "$x$=2"))
        figure.canvas.draw()
        axes = figure.axes[0]
        assert (axes.get_title(loc="left"), axes.get_xlabel()) == (
            r"\$a\$, \$x\$ = 1, \$x\$ = 2",
            choice.x.replace("$", r"\$"),
        )


def test_orders_are_drawn_over_names(folder: Path) -> None:
    (axes,) = figure_of(folder, Choice("scheme", "max_error", "seed", aggregate="order")).axes
    assert axes.get_ylabel() == "max error (order)"
    for line in labelled(axes).values():
        assert [y for _, y in points(line)] == pytest.approx(list(SCHEMES.values()), abs=1e-9)


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
    ("sizes", "log", "scale"),
    table_of("""
[0.1, 0.05, 0.025]   []     log
[0.1, 0.05, 0.02]    []     linear
[0.1, 0.05, 0.02]    ["h"]  log
[1.0, 1.9, 20.0]     []     log
[1.0, 1.9, 19.9]     []     linear
[1.0, 1.98, 20.0]    []     linear
[1.0, 51.0, 101.0]   []     linear
[0.0, 1.0, 1000.0]   ["h"]  linear
"""),
)
@pytest.mark.slow
def test_a_key_is_logarithmic_if_its_range_was(tmp_path: Path, sizes: list[float], log: list[str], scale: str) -> None:
    """Or over a range of 20 and more, with gaps of 1 : 20 and more, that are not even."""
    folder = write_rows(tmp_path / "x", {"h": sizes}, {"v": [1.0, 2.0, 3.0]}, log=log)
    (axes,) = figure_of(folder, Choice("h", "v")).axes
    assert axes.get_xscale() == scale


def test_ticks_of_two_sides_do_not_crowd() -> None:
    assert symlog_ticks(2e-16, -3e-3, 1e-4) == [-1e-3, -1e-7, -1e-11, -1e-15, 0.0, 1e-15, 1e-11, 1e-7]
    assert symlog_ticks(1e-3, -0.5, 20.0) == [-0.1, -0.01, 0.0, 0.01, 0.1, 1.0, 10.0]


def heat_cells(axes: Axes) -> tuple[np.ndarray, np.ndarray]:
    """Corners (rows + 1, columns + 1, 2) and values (rows, columns) of the cells."""
    (mesh,) = axes.collections
    return mesh.get_coordinates(), np.ma.filled(mesh.get_array().astype(float), NAN)  # type: ignore[attr-defined, union-attr]


def test_a_heat_map_has_the_rows_in_its_cells(folder: Path) -> None:
    choice = Choice("h", "scheme", colour="max_error", aggregate="median")
    axes, bar = figure_of(folder, choice).axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("step size h", "scheme")
    assert bar.get_ylabel() == "max error (median)"
    corners, values = heat_cells(axes)
    for i, scheme in enumerate(SCHEMES):
        for j, h in enumerate(sorted(SIZES)):
            assert corners[i, j, 0] < h < corners[i, j + 1, 0]
            assert corners[i, j, 1] < i < corners[i + 1, j, 1]
            if (scheme, h) == ("bohlin-a", SIZES[-1]):
                assert math.isnan(values[i, j])
            else:
                assert values[i, j] == pytest.approx(error_of(scheme, h, 2), rel=1e-14)
    names = dict(zip(axes.get_yticks(), (tick.get_text() for tick in axes.get_yticklabels()), strict=True))
    assert names == {0: "HK", 1: "RK4", 2: "Bohlin A"}
    assert axes.get_ylim() == (2.5, -0.5)
    (cross,) = axes.lines
    assert points(cross) == [(SIZES[-1], 2.0)]
    (mesh,) = axes.collections
    assert type(mesh.norm).__name__ == "LogNorm"
    assert (mesh.norm.vmin, mesh.norm.vmax) == pytest.approx((FLOOR * 1.02, 0.1 * 1.2), rel=1e-12)


def test_colours_of_both_signs_have_white_at_zero(folder: Path) -> None:
    axes, _ = figure_of(folder, Choice("seed", "h", colour="drift.energy"), ("scheme=hk",)).axes
    (mesh,) = axes.collections
    _, values = heat_cells(axes)
    assert values[-1].tolist() == [-(0.1**3), 0.1**3, -(0.1**3)]
    assert mesh.norm.vmin == -mesh.norm.vmax
    red, green, blue, _ = mesh.cmap(mesh.norm(0.0))
    assert min(red, green, blue) > 0.95
    assert (axes.get_xscale(), axes.get_yscale()) == ("linear", "log")


def test_linear_colours_of_both_signs_are_symmetric(tmp_path: Path) -> None:
    keys = {"a": [1.0, 2.0, 1.0, 2.0], "b": [1.0, 1.0, 2.0, 2.0]}
    for values, limits in (([-1.0, 4.0, 2.0, 3.0], (-4.0, 4.0)), ([1.0, 4.0, 2.0, 3.0], (1.0, 4.0))):
        folder = write_rows(tmp_path / f"x{values[0]}", keys, {"v": values})
        axes, _ = figure_of(folder, Choice("a", "b", colour="v")).axes
        (mesh,) = axes.collections
        assert (mesh.norm.vmin, mesh.norm.vmax) == limits
        assert heat_cells(axes)[1].tolist() == [values[:2], values[2:]]


def test_edges_of_cells_lie_between_their_centres() -> None:
    np.testing.assert_allclose(cell_edges(np.array([1.0, 2.0, 4.0]), False), [0.5, 1.5, 3.0, 5.0])
    np.testing.assert_allclose(cell_edges(np.array([0.01, 0.1, 1.0]), True), 10.0 ** np.array([-2.5, -1.5, -0.5, 0.5]))
    np.testing.assert_allclose(cell_edges(np.array([3.0]), False), [2.5, 3.5])


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


def study() -> dict[str, Any]:
    """A study of orders with an error that is not finite, and one of a scheme that explodes."""
    rows = [
        {
            "scheme": scheme,
            "declared_order": order,
            "points": [{"h": h, "error": error_of(scheme, h, 1)} for h in SIZES],
        }
        for scheme, order in SCHEMES.items()
    ]
    rows[0]["points"][0]["error"], rows[2]["points"][0]["error"] = None, 2e3
    return {"schema_version": SCHEMA_VERSION, "name": "mine", "top": "A top", "duration": 7.5, "schemes": rows}


def test_errors_of_orders_that_cannot_be_drawn_are_marked_at_the_edges() -> None:
    (axes,) = drawn(loaded_order(Result(study()))).axes
    for scheme, line in labelled(axes).items():
        assert sorted(points(line)) == [
            (h, error_of(scheme, h, 1)) for h in sorted(SIZES) if h < SIZES[0] or scheme == "rk4"
        ]
    marks = {
        line.get_marker(): points(line) for line in axes.lines if line.get_marker() in "x^" and len(points(line)) == 1
    }
    assert marks == {"x": [(SIZES[0], 0.025)], "^": [(SIZES[0], 0.975)]}
    assert "above 1000" in explained(axes.figure)


def test_notes_count_each_outcome_by_itself(folder: Path) -> None:
    path = folder / "rows.parquet"
    rows = pq.read_table(path)
    outcome = ["blew_up", "blew_up", *rows.column("outcome").to_pylist()[2:]]
    at = rows.schema.get_field_index("outcome")
    pq.write_table(rows.set_column(at, "outcome", [outcome]), path)
    said = sweep_notes(read_rows(folder), Choice("h", "max_error", "scheme", aggregate="max"))
    assert said == [
        "5 of 81 rows did not complete: 2 blew_up, 3 no_convergence",
        "3 of 81 values could not be computed (nan)",
    ]


def test_notes_say_what_cannot_be_drawn(tmp_path: Path) -> None:
    folder = write_rows(tmp_path / "x", {"h": [0.1, NAN, 0.2]}, {"v": [0.0, 2.0, 1e3]})
    assert sweep_notes(read_rows(folder), Choice("h", "v")) == [
        "1 of 3 values are zero and cannot be shown on a logarithmic scale",
        "rows without a number for h are not drawn",
    ]


def test_names_of_many_curves_are_at_their_ends_with_their_slopes(tmp_path: Path) -> None:
    """The finest step is on the right; a scheme that chooses its own steps and one below round-off have no slope."""
    orders = dict.fromkeys(SHOWN, 2) | {"rk4": 3}
    assert len(orders) > MOST_KEYS
    rows = list(itertools.product(orders, SIZES))
    keys = {"scheme": [scheme for scheme, _ in rows], "h": [h for _, h in rows]}
    errors = [(i + 1.0) * h ** orders[scheme] for i, (scheme, h) in enumerate(rows)]
    (axes,) = figure_of(write_rows(tmp_path / "x", keys, {"v": errors}, log=["h"]), Choice("h", "v", "scheme")).axes
    axes.figure.canvas.draw()
    assert axes.get_xlim()[0] > axes.get_xlim()[1]
    texts = {text.get_text().partition(": ")[0]: text for text in axes.texts}
    lines = {str(line.get_gid()): line for line in axes.lines if line.get_gid()}
    assert set(texts) == set(lines) == set(SHOWN.values())
    for scheme, name in SHOWN.items():
        assert (": " in texts[name].get_text()) == (scheme != "taylor")
        assert texts[name].xy == pytest.approx(points(lines[name])[0])  # type: ignore[attr-defined]
        with styled():
            assert to_rgb(lines[name].get_color()) == to_rgb(texts[name].arrow_patch.get_edgecolor())  # type: ignore[attr-defined]
    ends = sorted(lines, key=lambda name: points(lines[name])[0][1])
    heights = [texts[name].xyann[1] for name in ends]  # type: ignore[attr-defined]
    assert heights == sorted(heights)
