"""Pictures of a page as SVG elements: panels of studies, series of runs, quantiles of ensembles.

Their colours follow the scheme of the page, and the names of their parts are unique within it.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.errors import printable
from topcli.figures.curves import LINEAR, LOG, CurvePanel, curve_column, plain
from topcli.figures.picture import Grid, Line, Panel, column_label, component_symbol, draw
from topcli.figures.style import STYLE
from topcli.pages.contents import Picture, Pictures
from topcli.store.envelope import envelope
from topcli.store.series import INTEGERS, WORDS, read_series, series_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SMALL = (4.8, 2.8)
TIME = "time $t$"
COLOURS = {
    "#000000": "currentColor",
    "#ffffff": "var(--paper)",
    "#e0e0e0": "var(--grid)",
    "#0072b2": "var(--line1)",
    "#d55e00": "var(--line2)",
    "#009e73": "var(--line3)",
    "#cc79a7": "var(--line4)",
    "#56b4e9": "var(--line5)",
    "#e69f00": "var(--line6)",
}
"""Colours of ``print.mplstyle``, and those of the page that replace them."""
DEVIATION = "deviation:"
VECTORS = {"omega": "angular velocity ω", "gamma": "vertical γ in the body", "m": "angular momentum m"}
"""Vectors of a state in words."""
MOST_LINES = 7
"""Lines of a picture that look different."""
MOST_POINTS = 60
"""Points of a curve of quantiles."""
EXPLODED = 1e3
_COMPONENT = re.compile(r"([A-Za-z]+)([1-9])")
_HEAD = re.compile(r"<svg\b[^>]*>")
_SIZE = re.compile(r'(width|height)="([0-9.]+)pt"')
_UNUSED = re.compile(r"<metadata>.*?</metadata>|<style\b.*?</style>|<!--.*?-->", re.DOTALL)
_NAME = re.compile(r'(\bid="|xlink:href="#|href="#|url\(#)')
_SPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def svg_of(picture: Picture) -> str:
    """SVG element of a picture."""
    figure = draw((picture.panel,), picture.data, Grid(figsize=picture.size))
    return element(figure, picture.name, picture.caption)


def element(figure: Figure, name: str, label: str) -> str:
    """SVG element of a matplotlib figure on a transparent ground; ``label`` describes it to those who do not see it.

    A letter that no font has is drawn as a box, without a warning.
    """
    import matplotlib as mpl

    for part in (figure, *figure.axes):
        part.patch.set_visible(False)
    sink = io.StringIO()
    with (
        mpl.rc_context(fname=STYLE),
        mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": name}),
        warnings.catch_warnings(action="ignore"),
    ):
        figure.savefig(sink, format="svg", metadata=_NO_METADATA)
    text = _UNUSED.sub("", sink.getvalue())
    head = _HEAD.search(text)
    if head is None:
        raise ValueError("matplotlib wrote no SVG element")
    body = _NAME.sub(lambda match: f"{match[1]}{name}-", text[head.end() :].strip())
    for colour, own in COLOURS.items():
        body = body.replace(colour, own)
    width, height = (float(size) for _, size in _SIZE.findall(head[0])[:2])
    size = f'viewBox="0 0 {width:g} {height:g}" width="{width / 0.75:.0f}" height="{height / 0.75:.0f}"'
    about = f'role="img" aria-label="{escape(printable(label), quote=True)}" fill="currentColor"'
    return f"<svg {size} {about} {_SPACES}>{body}"


def vectors_of(names: Sequence[str], experiment: Experiment | None) -> dict[str, list[str]]:
    """Recorded components by the vector that they belong to."""
    vectors: dict[str, list[str]] = {}
    if experiment is not None:
        for vector, ends in experiment.top.vectors.items():
            own = [name for name in experiment.top.components[slice(*ends)] if name in names]
            vectors |= {vector: own} if own else {}
        return vectors
    for name in names:
        if match := _COMPONENT.fullmatch(name):
            vectors.setdefault(match[1], []).append(name)
    return vectors


def _label(name: str, experiment: Experiment | None) -> str:
    """Mathtext of a column; its plain name if the experiment is not known."""
    if experiment is not None:
        return column_label(experiment, name)
    return component_symbol(name) if _COMPONENT.fullmatch(name) else name.replace("$", r"\$")


def positive(values: Array) -> Array:
    """``values`` with nan for those that have no place on a logarithmic axis."""
    return np.where(values > 0.0, values, np.nan)


def deviations(data: dict[str, Array], names: Sequence[str]) -> dict[str, Array]:
    """Absolute deviations of columns from their first values, for a logarithmic axis, without constant ones."""
    moved = {DEVIATION + name: positive(np.abs(data[name] - data[name][0])) for name in names}
    return {name: values for name, values in moved.items() if np.isfinite(values).any()}


def before_explosion(data: dict[str, Array], names: Sequence[str]) -> dict[str, Array]:
    """Rows before the first at which a component is beyond ``EXPLODED`` times the largest one at the start."""
    largest = np.max([np.abs(data[name]) for name in names], axis=0)
    beyond = np.flatnonzero(~(largest <= EXPLODED * max(1.0, largest[0])))
    kept = int(beyond[0]) if len(beyond) and beyond[0] > 1 else len(largest)
    return {name: values[:kept] for name, values in data.items()}


def vector_in_words(vector: str) -> str:
    """Name of a vector or another column in words."""
    return VECTORS.get(vector, vector)


def time_panel(names: Sequence[str], experiment: Experiment | None, vector: str = "", deviation: bool = False) -> Panel:
    """Panel of the components of one ``vector``, or of columns of ``deviations``, over time."""
    lines = tuple(Line(name, _label(name.removeprefix(DEVIATION), experiment)) for name in names)
    if deviation:
        return Panel(lines, "deviation from the first value", TIME, log=True)
    return Panel(lines, vector_in_words(vector) or ", ".join(line.label for line in lines), TIME)


def series_pictures(path: Path, experiment: Experiment | None, h: float, name: str) -> Pictures | None:
    """Pictures of the series of one trajectory; None if it has no rows or no times.

    ``name`` is unique within the page. Raises RunError if the series is damaged.
    """
    names = [column for column in series_names(path) if column not in WORDS]
    time = "t" if "t" in names else "n"
    if time not in names:
        return None
    data = envelope(path, names)
    if not len(data[time]):
        return None
    data.setdefault("t", data[time] * h)
    vectors = vectors_of(names, experiment)
    moving = [component for own in vectors.values() for component in own]
    observed = [column for column in (experiment.output.quantities or () if experiment else ()) if column in names]
    others = [column for column in names if column not in {"t", *INTEGERS, *moving, *observed}]
    bounded = before_explosion(data, moving) if moving else data
    cut = f", up to t = {bounded['t'][-1]:.6g} before the motion explodes" if len(bounded["t"]) < len(data["t"]) else ""
    pictures = []
    for vector, own in [*vectors.items(), *((column, [column]) for column in observed)]:
        caption = f"{vector_in_words(vector)} over time{cut}"
        pictures.append(Picture(time_panel(own, experiment, vector), bounded, f"{name}-{vector}", caption, SMALL))
    if moved := deviations(data, others):
        constant = [column for column in others if DEVIATION + column not in moved]
        note = f"; {', '.join(constant)} did not change" if constant else ""
        caption = f"absolute deviations from the first values over time{note}"
        panel = time_panel(list(moved)[:MOST_LINES], experiment, deviation=True)
        pictures.append(Picture(panel, data | moved, f"{name}-deviations", caption, SMALL))
    return Pictures(pictures)


def quantile_curves(deviations: Mapping[str, Sequence[float]]) -> tuple[CurvePanel, dict[str, np.ndarray]]:
    """Panel and columns of the sorted deviations of each invariant over the fraction of trajectories below them."""
    data: dict[str, np.ndarray] = {}
    scale = LINEAR
    for label, values in deviations.items():
        known = np.sort(np.asarray(values, dtype=float))
        known = known[np.isfinite(known)]
        at = np.unique(np.linspace(0, len(known) - 1, min(MOST_POINTS, len(known))).astype(int))
        data[curve_column(label, "x")] = (at + 0.5) / max(len(known), 1)
        data[curve_column(label, "y")] = shown = positive(known[at])
        scale = LOG if np.isfinite(shown).any() else scale
    return CurvePanel(tuple(deviations), "fraction of the trajectories", "largest deviation", False, scale), data


def stored_quantiles(folder: Path, report: Mapping[str, Any]) -> tuple[CurvePanel, dict[str, np.ndarray]]:
    """``quantile_curves`` of the ensemble in ``folder``. Raises RunError if its table is damaged."""
    path = next(iter(sorted(folder.glob("trajectories.*"))), folder / "trajectories.parquet")
    columns = {plain(str(row["symbol"])): f"max_deviation.{row['name']}" for row in report["invariants"]}
    table = read_series(path, list(columns.values()))
    return quantile_curves({symbol: table[column].tolist() for symbol, column in columns.items()})


def quantile_pictures(folder: Path, report: Mapping[str, Any], name: str) -> Pictures:
    """Picture of the distribution of the deviations of an ensemble."""
    caption = "largest deviation of each invariant, over the fraction of trajectories that stay below it"
    return Pictures([Picture(*stored_quantiles(folder, report), f"{name}-quantiles", caption, SMALL)])
