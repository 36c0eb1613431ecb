"""The picture of the stress study: every scheme in every hard case of its top, three shades that differ in grey too."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.figures.make import SOURCE, MadeFigure
from topcli.figures.picture import IMAGE_FORMATS, STYLE, save
from topcli.store.run_folder import io_failure, require_writable, write_whole
from topcli.store.series import read_metadata, write_parquet
from topcli.studies.stress.record import stored_stress, stress_data, stress_source, write_stress
from topcli.studies.stress.suite import stress

NAME = "stress"
TITLE = "Every scheme in the hard cases of its top: held, degraded, broke"
OUTCOMES = ("not tried", "held", "degraded", "broke")
SHADES = ("#ffffff", "#dcebf5", "#f2a541", "#7b1e2b")
"""In grey: 1.00, 0.90, 0.70 and 0.23."""
UNEXPLAINED = ("unexplained", "outlived limit")
COLUMNS = (("kowalevski", "heavy", "lagrange/inertial"), ("euler", "euler+gamma", "lagrange"))
"""The tops in the two columns of the picture, those that are not named below the second."""
SIZE = (7.0, 9.2)


def figure_data(study: dict[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, list[str]]]:
    """The plotted numbers, a row a trial, and the names that ``top``, ``scheme``, ``case`` and ``outcome`` count."""
    trials = study["trials"]
    names = {key: list(dict.fromkeys(one[key] for one in trials)) for key in ("top", "scheme", "case")}
    names["outcome"] = list(OUTCOMES)
    data = {key: np.array([float(known.index(one[key])) for one in trials]) for key, known in names.items()}
    data["step"] = np.array([np.nan if one["step"] is None else float(one["step"]) for one in trials])
    data["unexplained"] = np.array([float(one["verdict"] in UNEXPLAINED) for one in trials])
    return data, names


def _step_text(step: int | None) -> str:
    """A step in a small cell: as it is up to three digits, else as a power of ten."""
    if step is None:
        return ""
    return str(step) if step < 1000 else f"$10^{{{round(np.log10(step))}}}$"


def _panel(axes: Any, trials: Sequence[dict[str, Any]], top: str) -> None:
    """One top: a row for each case, a column for each scheme."""
    from matplotlib.colors import ListedColormap

    schemes = list(dict.fromkeys(one["scheme"] for one in trials))
    cases = list(dict.fromkeys(one["case"] for one in trials))
    values = np.zeros((len(cases), len(schemes)))
    for one in trials:
        row, column = cases.index(one["case"]), schemes.index(one["scheme"])
        values[row, column] = OUTCOMES.index(one["outcome"])
        if one["outcome"] == "broke":
            text = "!" if one["verdict"] in UNEXPLAINED else _step_text(one["step"])
            axes.text(column, row, text, ha="center", va="center", color="white", fontsize=5)
    axes.imshow(values, cmap=ListedColormap(SHADES), vmin=-0.5, vmax=3.5, aspect="auto", interpolation="nearest")
    axes.set_xticks(range(len(schemes)), schemes, rotation=90, fontsize=6.5)
    axes.set_yticks(range(len(cases)), cases, fontsize=6.5)
    axes.xaxis.tick_top()
    axes.set_xticks(np.arange(len(schemes) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(cases) + 1) - 0.5, minor=True)
    axes.tick_params(which="both", length=0, pad=2)
    axes.grid(False)
    axes.grid(which="minor", color="white", linewidth=0.8)
    axes.set_xlabel(top, fontsize=8, labelpad=3)


def draw_stress(study: dict[str, Any]) -> Any:
    """The matplotlib figure of the study: a panel for each top in two columns, and what the shades mean."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    by_top: dict[str, list[dict[str, Any]]] = {}
    for one in study["trials"]:
        by_top.setdefault(one["top"], []).append(one)
    named = {top for column in COLUMNS for top in column}
    columns = [[top for top in column if top in by_top] for column in COLUMNS]
    columns[1] += [top for top in by_top if top not in named]
    columns = [column for column in columns if column]
    with mpl.rc_context(fname=STYLE):
        figure = Figure(figsize=SIZE)
        FigureCanvasAgg(figure)
        widths = [max(len({one["scheme"] for one in by_top[top]}) for top in column) for column in columns]
        grid = figure.add_gridspec(1, len(columns), width_ratios=widths)
        for index, column in enumerate(columns):
            # the names of the schemes above each panel take about as much room as five cases
            heights = [len({one["case"] for one in by_top[top]}) + 5 for top in column]
            inner = grid[0, index].subgridspec(len(column), 1, height_ratios=heights)
            for row, top in enumerate(column):
                _panel(figure.add_subplot(inner[row, 0]), by_top[top], top)
        meanings = {
            "held": SHADES[1],
            "degraded: claims kept, accuracy lost": SHADES[2],
            "broke, at the step in the cell (! undeclared)": SHADES[3],
            "not tried": SHADES[0],
        }
        handles = [Patch(facecolor=shade, edgecolor="0.6", label=text) for text, shade in meanings.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=7, handlelength=1.0)
    return figure


def make_stress(
    *,
    out: Path,
    results: Path,
    formats: Sequence[str] = IMAGE_FORMATS,
    force: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> MadeFigure:
    """Draw the stored study, or run the suite and store it where there is none by this code; write data and pictures.

    Raises UsageError and RunError.
    """
    require_writable(out)
    source = stress_source()
    study = None if force else stored_stress(results)
    if study is None or study.get("source") != source:
        study = stress_data(stress(on_progress=progress))
        write_stress(study, results, source)
    data_path = out / f"{NAME}.parquet"
    pictures = [out / f"{NAME}.{suffix}" for suffix in formats]
    drawn = json.dumps([source, STYLE.read_text(encoding="utf-8"), Path(__file__).read_text(encoding="utf-8")])
    if not force and all(path.is_file() for path in pictures) and read_metadata(data_path).get(SOURCE) == drawn:
        return MadeFigure(NAME, (*pictures, data_path), "up to date")
    data, names = figure_data(study)
    figure = draw_stress(study)
    try:
        data_path.unlink(missing_ok=True)
        for path in pictures:
            write_whole(path, lambda temporary: save(figure, temporary))
        metadata = {SOURCE: drawn, "topcli.names": json.dumps(names)}
        write_whole(data_path, lambda temporary: write_parquet(temporary, data, metadata))
    except OSError as error:
        raise io_failure(error, out, "the figure was not drawn") from error
    return MadeFigure(NAME, (*pictures, data_path), "drawn")
