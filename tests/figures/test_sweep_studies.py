"""Figures of packaged sweeps: each view draws the rows that it names, under the scales, labels and law it declares."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from sweep_rows import write_rows
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Figure, Request, make_figure
from topcli.figures.picture import Grid, draw
from topcli.figures.sweep import Choice, View, sweep_views

SWEEP = """
name: small
base: {top: euler, initial: {omega: [0.7, -0.4, 1.3]}, T: 2}
grid: {scheme: [hk, rk2], h: [0.2, 0.1, 0.05], top.A: [3.0, 2.5]}
measure: [error.max, deviation.m_sq]
"""


VIEWS = (
    View(
        "upper",
        Choice("h", "error.max", "scheme"),
        ("top.A=2.5",),
        "$h$",
        "error",
        xlog=True,
        law=np.square,
        law_label="law",
    ),
    View("lower", Choice("top.A", "deviation.m_sq", "scheme", aggregate="max"), ("scheme=hk",)),
)


def small(tmp_path: Path, views: tuple[View, ...]) -> Figure:
    """Figure of a small sweep."""
    path = tmp_path / "small.yaml"
    path.write_text(SWEEP, encoding="utf-8")
    return sweep_views("small", "a small sweep", str(path), views, Grid())


@pytest.fixture
def figure(tmp_path: Path) -> Figure:
    return small(tmp_path, VIEWS)


def test_views_draw_their_rows(figure: Figure, tmp_path: Path) -> None:
    """And run no others; progress counts those that are run."""
    progress: list[tuple[int, int]] = []
    loaded = figure.load(Request(tmp_path / "results", on_progress=lambda *parts: progress.append(parts)))
    picture = draw(loaded.panels, loaded.data(), loaded.layout)
    rows = pq.read_table(tmp_path / "results" / "small" / "rows.parquet").to_pylist()
    for row in rows:
        seen = row["top.A"] == 2.5 or row["scheme"] == "hk"
        assert (row["outcome"] == "completed", row["error.max"] is not None) == (seen, seen)
    assert sorted(progress)[-1] == (9, 9)
    left, right = picture.axes
    assert (left.get_xlabel(), left.get_ylabel(), right.get_xlabel()) == ("$h$", "error", "top.A")
    assert [axes.get_title(loc="left") for axes in (left, right)] == ["(a) upper", "(b) lower"]
    assert (left.get_xscale(), right.get_xscale()) == ("log", "linear")
    shown = {str(line.get_label()).partition(":")[0]: line for line in left.lines}
    for scheme in ("hk", "rk2"):
        expected = {row["h"]: row["error.max"] for row in rows if row["scheme"] == scheme and row["top.A"] == 2.5}
        got = dict(zip(map(float, shown[scheme].get_xdata()), map(float, shown[scheme].get_ydata()), strict=True))
        assert got == expected
        assert len(set(got.values())) == 3
    x, y = (np.asarray(values) for values in shown["law"].get_data())
    assert x.tolist() == [0.05, 0.1, 0.2]
    assert y.tolist() == (x * x).tolist()
    (line,) = (line for line in right.lines if len(np.asarray(line.get_xdata())) == 2)
    for A, value in zip(*line.get_data(), strict=True):
        over_h = [row["deviation.m_sq"] for row in rows if row["scheme"] == "hk" and row["top.A"] == A]
        assert len(over_h) == 3
        assert value == max(over_h)


def test_a_second_request_runs_and_draws_nothing(figure: Figure, tmp_path: Path) -> None:
    request = Request(tmp_path / "results")
    assert make_figure(figure, request, tmp_path / "figures", ["png"]).status == "drawn"
    journal = (tmp_path / "results" / "small" / "journal.jsonl").read_bytes()
    assert make_figure(figure, request, tmp_path / "figures", ["png"]).status == "up to date"
    assert (tmp_path / "results" / "small" / "journal.jsonl").read_bytes() == journal


@pytest.mark.slow
def test_a_view_may_ask_for_a_logarithmic_axis(tmp_path: Path) -> None:
    """The few values of top.A alone would not."""
    lower = VIEWS[1]
    for xlog, scale in ((False, "linear"), (True, "log")):
        loaded = small(tmp_path, (replace(lower, xlog=xlog),)).load(Request(tmp_path / "results"))
        (axes,) = draw(loaded.panels, loaded.data(), loaded.layout).axes
        assert axes.get_xscale() == scale


def test_the_random_tops_are_drawn_by_medians_and_quartiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the heading says, and not by means or by the largest of the hundred, which differ from them here."""
    schemes, seeds = ("hk", "rk4", "splitting"), range(1, 6)
    rows = [(scheme, seed) for scheme in schemes for seed in seeds]
    sizes = {row: 1e-6 * 10.0 ** (2 * schemes.index(row[0])) * row[1] ** 3 for row in rows}
    signed = {row: (-1.0) ** row[1] * size for row, size in sizes.items()}
    keys = {"scheme": [scheme for scheme, _ in rows], "random": [seed for _, seed in rows]}
    measures = {"deviation.energy": list(sizes.values()), "drift.energy": list(signed.values())}
    folder = write_rows(tmp_path / "heavy_drift", keys, measures)
    result = SimpleNamespace(folder=folder, outcomes={"completed": len(rows)})
    monkeypatch.setattr("topcli.sweeps.run.run_sweep", lambda *arguments, **options: result)
    loaded = FIGURES["heavy-drift"].load(Request(tmp_path))
    picture = draw(loaded.panels, loaded.data(), loaded.layout)
    assert "medians and quartiles" in picture.get_suptitle()
    labels = ["deviation of $E$", "drift of $E$ per unit time"]
    for axes, label, values in zip(picture.axes, labels, (sizes, signed), strict=True):
        assert axes.get_ylabel() == label
        assert [tick.get_text() for tick in axes.get_xticklabels()] == list(schemes)
        (line,) = (one for one in axes.lines if len(np.asarray(one.get_xdata())) == 3 and one.get_marker() == "o")
        bars = [segment for one in axes.collections for segment in one.get_segments()]  # type: ignore[attr-defined]
        for i, scheme in enumerate(schemes):
            ordered = sorted(values[scheme, seed] for seed in seeds)
            assert float(np.asarray(line.get_ydata())[i]) == pytest.approx(ordered[2], rel=1e-12)
            (bar,) = (bar for bar in bars if bar[0][0] == i)
            assert (bar[0][1], bar[1][1]) == pytest.approx((ordered[1], ordered[3]), rel=1e-12)


ERRORS = ["hk", "bohlin-a", "hybrid", "hk-projected", "splitting", "backlund", "rk4", "taylor"]


def test_one_legend_has_the_slopes_in_all_panels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of most schemes in both panels, of rk4 in the first alone, of neither for a scheme that chooses its own steps.

    Other schemes of the sweep are not drawn.
    """
    sizes = [0.1 * 2.0**-k for k in range(8)]
    rows = [(scheme, h) for scheme in ("midpoint", *ERRORS, "dg4") for h in sizes]
    keys = {"scheme": [scheme for scheme, _ in rows], "h": [h for _, h in rows]}
    measures = {
        "error.max": [h**2 if scheme != "rk4" else h**3 for scheme, h in rows],
        "deviation.energy": [h**4 if scheme != "rk4" else 1e-15 for scheme, h in rows],
    }
    folder = write_rows(tmp_path / "kowalevski_errors", keys, measures, log=["h"])
    result = SimpleNamespace(folder=folder, outcomes={"completed": len(rows)})
    monkeypatch.setattr("topcli.sweeps.run.run_sweep", lambda *arguments, **options: result)
    loaded = FIGURES["errors"].load(Request(tmp_path))
    picture = draw(loaded.panels, loaded.data(), loaded.layout)
    assert [axes.get_legend() for axes in picture.axes] == [None, None]
    (legend,) = picture.legends
    handles = dict(zip([text.get_text() for text in legend.get_texts()], legend.get_lines(), strict=True))
    slopes = dict.fromkeys(ERRORS, ": 2.00, 4.00") | {"rk4": ": 3.00, –", "taylor": ""}
    assert list(handles) == [*(f"{name}{slope}" for name, slope in slopes.items()), "round-off"]
    assert legend.get_title().get_text() == "scheme: slopes in (a), (b)"
    shown = {str(line.get_label()).partition(":")[0]: line for line in picture.axes[0].lines}
    for name, handle in list(handles.items())[:-1]:
        line = shown[name.partition(":")[0]]
        assert (handle.get_color(), handle.get_marker()) == (line.get_color(), line.get_marker())
