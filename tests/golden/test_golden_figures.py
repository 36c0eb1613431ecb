"""Every figure as data: axes, artists with their looks and numbers, legends, from small or made-up results."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import Collection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation

import golden
from drawn_artists import drawn, drawn_from
from figure_studies import figure_named
from sweep_rows import write_rows
from topcli.figures.catalogue import FIGURES
from topcli.figures.comparison import loaded_analysis, loaded_comparison
from topcli.figures.figure import Loaded, Request
from topcli.figures.sweep import Choice, sweep_figure
from topcli.studies.study import Result
from topcli.sweeps.rows import read_rows

OF_RUNS = ("fig1", "fig2", "fig3", "fig4", "modified", "polhodes", "body", "traces")
SLOW = {"chaos", "torus-points"}
"""Of what takes long, the loaded panels are drawn by tests of their own from made-up numbers."""


def numbers(values: Any) -> list[float]:
    """A few numbers that distinguish one set of data from another."""
    v = np.asarray(values, dtype=float).ravel()
    v = v[np.isfinite(v)]
    picked = [] if not len(v) else [v[0], v[len(v) // 3], v[-1], v.min(), v.max(), v.mean()]
    return [float(len(v)), *(float(f"{x:.4g}") for x in picked)]


def look(artist: Any) -> list[str]:
    if isinstance(artist, Line2D):
        return [
            to_hex(artist.get_color()),
            str(artist.get_linestyle()),
            str(artist.get_marker()),
            f"{artist.get_linewidth():.2g}",
            str(artist.get_markerfacecolor()),
        ]
    if isinstance(artist, Patch):
        return [to_hex(artist.get_facecolor()), str(artist.get_hatch())]
    return []


def of_axes(axes: Any) -> dict[str, Any]:
    limits = [float(f"{x:.3g}") for x in (*axes.get_xlim(), *axes.get_ylim())]
    data: dict[str, Any] = {
        "labels": [axes.get_xlabel(), axes.get_ylabel(), *(axes.get_title(loc=side) for side in ("left", "center"))],
        "scales": [axes.get_xscale(), axes.get_yscale()],
        "limits": limits,
        "lines": [
            [
                str(line.get_label()),
                str(line.get_gid()),
                *look(line),
                numbers(line.get_xdata()),
                numbers(line.get_ydata()),
            ]
            for line in axes.lines
        ],
        "patches": [[type(p).__name__, *look(p), numbers(p.get_path().vertices)] for p in axes.patches],
        "texts": [
            [t.get_text(), *numbers(t.xy if isinstance(t, Annotation) else t.get_position())] for t in axes.texts
        ],
        "images": [numbers(i.get_array()) for i in axes.images],
        "collections": [
            [
                type(c).__name__,
                numbers([p.vertices.mean(axis=0) for p in c.get_paths()]),
                numbers(c.get_facecolors()),
                numbers(c.get_edgecolors()),
                numbers(c.get_offsets()),
            ]
            for c in axes.collections
            if isinstance(c, Collection)
        ],
        "ticks": [t.get_text() for t in (*axes.get_xticklabels(), *axes.get_yticklabels())][:12],
        "inside": [of_axes(child) for child in axes.child_axes if hasattr(child, "get_title")],
    }
    legend = axes.get_legend()
    data["legend"] = [t.get_text() for t in legend.get_texts()] if legend else []
    return data


def of_figure(figure: Figure) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        figure.canvas.draw()
    legends = [[t.get_text() for t in legend.get_texts()] for legend in figure.legends]
    handles = [[look(h) for h in legend.legend_handles] for legend in figure.legends]
    return {
        "title": figure.get_suptitle(),
        "legends": legends,
        "handles": handles,
        "axes": [of_axes(a) for a in figure.axes],
    }


@pytest.mark.parametrize("name", [name for name in FIGURES if name not in SLOW])
def test_figure(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = drawn_from(name, tmp_path) if name in OF_RUNS else figure_named(name, tmp_path, monkeypatch)
    golden.check(f"figure_{name}", of_figure(figure), rel=2e-3)


T = np.linspace(0.0, 12.0, 240)
CONFIG = {"name": "a_$cene", "h": 0.25, "top": "euler", "initial": {"omega": [1, 0, 0]}, "scheme": "hk", "N": 1}


def compared() -> Loaded:
    series = {"t": T, "swing:reference": np.cos(T)}
    for name, shift in {"hk": 0.9, "bohlin-a": 0.2, "bohlin-b": 0.2021, "rk4": 1e-3}.items():
        series |= {f"error:{name}": shift * T, f"swing:{name}": np.cos(T - shift)}
    schemes = [{"label": name} for name in ("hk", "bohlin-a", "bohlin-b", "rk4")]
    return loaded_comparison(Result({"schemes": schemes, "reference": {"swing": "gamma1"}, "config": CONFIG}, series))


def analysed() -> Loaded:
    series = {"t": -T, "swing": np.cos(T), "deviation:m_sq": 0.0 * T, "deviation:m_omega": 1e-6 * T, "error": 1e-4 * T}
    series["swing:reference"] = np.cos(1.01 * T)
    return loaded_analysis(Result({"config": CONFIG, "file": "x.csv", "sha256": ""}, series))


@pytest.mark.parametrize(
    "loaded",
    [compared, analysed],
    ids=["comparison", "analysis"],
)
def test_made_up(loaded: Any, request: pytest.FixtureRequest) -> None:
    golden.check(f"figure_of_{request.node.callspec.id}", of_figure(drawn(loaded())), rel=2e-3)


@pytest.mark.parametrize(
    "choice",
    [("h", "max_error", "scheme", "median"), ("scheme", "drift", None, "mean"), ("h", "drift", "scheme", "max")],
)
def test_sweep(choice: tuple[str, str, str | None, str], tmp_path: Path) -> None:
    rows = [(scheme, h, seed) for scheme in ("hk", "rk4") for h in (0.1, 0.01, 0.001) for seed in (1, 2, 3, 4)]
    keys = {name: [row[i] for row in rows] for i, name in enumerate(("scheme", "h", "seed"))}
    value = [h ** (2 + 2 * (scheme == "rk4")) * (1 + 0.3 * seed**2) for scheme, h, seed in rows]
    value[5] = float("inf")
    drift = [v * (-1) ** i for i, v in enumerate(value)]
    folder = write_rows(tmp_path / "s", keys, {"max_error": value, "drift": drift}, log=["h"])
    x, y, by, aggregate = choice
    loaded = sweep_figure(read_rows(folder), Choice(x, y, by, aggregate=aggregate)).load(Request())
    golden.check(f"figure_sweep_{'-'.join(map(str, choice))}", of_figure(drawn(loaded)), rel=2e-3)
