"""Figures as files: what they are made from and when their columns are computed again."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import topcli
from topcli.cli.options import complete
from topcli.errors import UsageError
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Figure, NothingMeasuredError, canvas_of, stored_columns
from topcli.figures.style import looks

QUICK = ("fig1", "fig2", "fig3", "fig4", "modified", "traces", "bifurcation")


def wave(calls: list[str], takes: str = "") -> Figure:
    """A figure from elsewhere with columns of two lengths, words and a nan."""

    def data() -> dict[str, np.ndarray]:
        calls.append("data")
        return {"x": np.linspace(0.0, 1.0, 20), "y": np.array([1.0, np.nan, 2.0]), "name": np.array(["a", "b"])}

    def draw(canvas: Any, columns: Any) -> None:
        assert {name: len(values) for name, values in columns.items()} == {"x": 20, "y": 3, "name": 2}
        assert np.isnan(columns["y"]).tolist() == [False, True, False]
        calls.append("draw")
        canvas.subplots().plot(columns["x"])

    return Figure("wave", "A wave", data, draw, takes=lambda: takes)


@pytest.mark.slow
def test_columns_are_computed_again_for_other_results_or_code_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    png, pdf, table = wave(calls).make(tmp_path)
    assert [path.suffix for path in (png, pdf, table)] == [".png", ".pdf", ".parquet"]
    first, drawn = png.read_bytes(), pdf.stat().st_mtime_ns
    wave(calls).make(tmp_path, ["png"])
    assert calls == ["data", "draw", "draw"]
    assert png.read_bytes() == first
    wave(calls, "other run").make(tmp_path, ["png"])
    wave(calls, "other run").make(tmp_path, ["png"], force=True)
    assert calls[3:] == ["data", "draw", "data", "draw"]
    assert pdf.stat().st_mtime_ns > drawn  # drawn again, for it showed the earlier columns
    table.write_bytes(table.read_bytes()[:-9])
    wave(calls, "other run").make(tmp_path, ["png"], force=True)
    assert stored_columns(table)
    monkeypatch.setattr("topcli.figures.figure.package_digest", lambda: "other")
    wave(calls, "other run").make(tmp_path, ["png"])
    assert calls[-2:] == ["data", "draw"]


def test_a_scheme_looks_the_same_beside_others() -> None:
    """Compositions have the colour of their scheme; labels that are no schemes have free colours."""
    alone = looks(["HK + Kahan-Li 8", "rk4"], markers=True)
    many = looks(["mine", "hk", "hk+kahan-li6", "HK + Kahan-Li 8", "rk2", "rk4"], markers=True)
    assert {name: many[name] for name in alone} == alone
    assert many["hk"]["color"] == many["hk+kahan-li6"]["color"] == many["HK + Kahan-Li 8"]["color"]
    assert len({str(look) for look in many.values()}) == len(many)


def test_other_peoples_files_stay(tmp_path: Path) -> None:
    (tmp_path / "wave.png").write_text("mine")
    with pytest.raises(UsageError, match=r"wave\.png: exists already"):
        wave([]).make(tmp_path)
    assert (tmp_path / "wave.png").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_figures_are_drawn_within_their_canvas(name: str) -> None:
    """No text is outside of the picture; those that compute for long have tests of their own."""
    figure = FIGURES[name]
    canvas = canvas_of(partial(figure.draw, columns=figure.data()), figure.size)
    canvas.draw_without_rendering()
    box = canvas.get_tightbbox()
    width, height = canvas.get_size_inches()
    assert box.x0 > -0.02
    assert box.y0 > -0.02
    assert (box.x1, box.y1) < (width + 0.02, height + 0.02)


@pytest.mark.slow
def test_the_figures_of_the_paper_show_what_they_should() -> None:
    """E runs from 4.99968 to 5.00416 over t in [0, 50]: not "almost constant"."""
    assert list(FIGURES)[:4] == ["fig1", "fig2", "fig3", "fig4"]
    hk, bohlin, secular, hybrid = (FIGURES[f"fig{i}"].data() for i in (1, 2, 3, 4))
    assert np.abs(hk["gamma1"] - hybrid["gamma1"]).max() < 0.01
    assert np.abs(hk["gamma1"] - bohlin["gamma1"]).max() > 1.5
    assert secular["energy"].min() == pytest.approx(4.99968, abs=1e-5)
    assert secular["energy"].max() == pytest.approx(5.00416, abs=1e-5)
    run = topcli.simulate("kowalevski_bohlin_a")
    assert list(secular) == ["t", "energy", "two_l"]
    for name, values in secular.items():
        np.testing.assert_array_equal(values, run[name])


def test_the_command_lists_completes_and_skips(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing() -> dict[str, np.ndarray]:
        raise NothingMeasuredError("nothing measured")

    figures = {"wave": wave([]), "slow": Figure("slow", "Slow", nothing, lambda canvas, columns: None)}
    for place in ("figure", "catalogue"):
        monkeypatch.setattr(f"topcli.figures.{place}.FIGURES", figures)
    listed = cli("list", "figures", "--json").json()["figures"]
    assert [item["name"] for item in listed] == ["wave", "slow"]
    assert complete("FIGURE", "w") == ["wave"]
    said = cli("plot", "--all", "--format", "png")
    assert said.out == "wave: drawn: results/figures/wave.png, results/figures/wave.parquet\n"
    assert said.err == "slow: skipped: nothing measured\n"
    assert cli("plot", "slow").code == 2


DRAW = "from topcli.__main__ import main; main()"


@pytest.mark.slow
def test_figures_do_not_depend_on_the_backend(in_tmp: Path) -> None:
    """That of a notebook is in the environment of the commands that it runs."""
    command = [sys.executable, "-c", DRAW, "plot", "modified", "--format", "png"]
    subprocess.run(command, env=os.environ | {"MPLBACKEND": "nonsense"}, check=True, capture_output=True)
    assert (in_tmp / "results" / "figures" / "modified.png").exists()


def test_a_run_is_drawn_by_its_name(cli: Callable[..., Any]) -> None:
    assert cli("run", "kowalevski_generic_hk", "--set", "N=200", "--set", "name=mine", "--quiet").code == 0
    files = cli("plot", "mine", "--format", "png", "--json").json()["figures"][0]["files"]
    columns = pq.read_table(files[-1]).to_pydict()
    run = topcli.simulate("kowalevski_generic_hk", N=200)
    np.testing.assert_array_equal(columns["gamma2"], run["gamma2"])
    np.testing.assert_array_equal(columns["energy"], run["energy"])
