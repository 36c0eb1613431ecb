"""Pictures of one run: the components of its state and the deviations of its integrals over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.errors import UsageError
from topcli.figures.figure import Columns, Drawing, Figure
from topcli.figures.labels import column_label, labelled, legend_above, plain, scheme_label
from topcli.store.envelope import envelope
from topcli.store.results import StoredResult
from topcli.store.series import INTEGERS, WORDS, read_series, series_names

VECTORS = {"omega": "angular velocity ω", "gamma": "vertical γ in the body", "m": "angular momentum m"}
"""Vectors of a state in words."""
MOST_LINES = 7
"""Lines of a picture that look different."""
EXPLODED = 1e3
"""A motion is drawn until a component exceeds the largest one at the start by this factor."""
CEILING = 1e100
"""Larger deviations have no place on an axis."""


@dataclass(frozen=True)
class RunPicture:
    """Picture with a ``name`` within the run, and its ``caption``."""

    name: str
    caption: str
    draw: Drawing


def recorded_vectors(names: Sequence[str], experiment: Experiment) -> dict[str, list[str]]:
    """Recorded components by the vector that they belong to."""
    components = experiment.top.components
    vectors = {vector: components[slice(*ends)] for vector, ends in experiment.top.vectors.items()}
    present = {vector: [name for name in own if name in names] for vector, own in vectors.items()}
    return {vector: own for vector, own in present.items() if own}


def series_of(path: Path, h: float, names: Sequence[str] | None = None) -> dict[str, Array]:
    """Columns ``names`` of a stored series at the rows that a picture needs, by default all, and the times ``t``.

    Empty without rows or times. Raises RunError if the file is damaged.
    """
    stored = [column for column in series_names(path) if column not in WORDS]
    time = next((name for name in ("t", "n") if name in stored), None)
    if time is None:
        return {}
    data = envelope(path, list(dict.fromkeys([time, *(stored if names is None else names)])))
    data.setdefault("t", data[time] * h)
    return data if len(data["t"]) else {}


def draw_series(
    axes: Any, data: Mapping[str, Array], names: Sequence[str], experiment: Experiment, deviation: bool = False
) -> None:
    """Draw columns over time, or the absolute deviations from their first values on a logarithmic axis."""
    for name in names:
        values = _positive(np.abs(data[name] - data[name][0])) if deviation else data[name]
        axes.plot(data["t"], values, label=column_label(experiment, name))
    vector = next((vector for vector, own in recorded_vectors(names, experiment).items() if own == list(names)), "")
    label = VECTORS.get(vector, plain(vector)) or ", ".join(line.get_label() for line in axes.lines)
    limits = sorted(map(float, data["t"][[0, -1]]))
    options: dict[str, Any] = {"xlim": limits} if limits[0] < limits[1] else {}
    options |= {"yscale": "log"} if deviation else {}
    labelled(axes, "time $t$", "deviation from the first value" if deviation else label, **options)
    if len(names) > 1:
        legend_above(axes)


def _positive(values: Array) -> Array:
    """``values`` with nan for those that have no place on a logarithmic axis."""
    return np.where((values > 0.0) & (values < CEILING), values, np.nan)


def run_pictures(data: Mapping[str, Array], experiment: Experiment) -> list[RunPicture]:
    """Pictures of the columns of one trajectory: one for each vector, and one of the deviations of the others."""
    vectors = recorded_vectors(list(data), experiment)
    moving = [component for components in vectors.values() for component in components]
    observed = [column for column in experiment.output.quantities or () if column in data]
    apart = {"t", *INTEGERS, *moving, *observed, *experiment.output.attitude_columns}
    others = [column for column in data if column not in apart]

    # rows before a component is beyond EXPLODED times the largest one at the start
    bounded, cut = data, ""
    if moving:
        largest = np.max([np.abs(data[name]) for name in moving], axis=0)
        beyond = np.flatnonzero(~(largest <= EXPLODED * max(1.0, largest[0])))
        if len(beyond) and beyond[0] > 1:
            bounded = {name: values[: beyond[0]] for name, values in data.items()}
            cut = f", up to t = {bounded['t'][-1]:.6g} before the motion explodes"

    pictures = []
    for vector, components in [*vectors.items(), *((column, [column]) for column in observed)]:
        caption = f"{VECTORS.get(vector, vector)} over time{cut}"
        pictures.append(RunPicture(vector, caption, _drawing(bounded, components, experiment)))
    moved = [name for name in others if (np.abs(data[name] - data[name][0]) > 0.0).any()]
    if moved:
        constant = [column for column in others if column not in moved]
        note = f"; {', '.join(constant)} did not change" if constant else ""
        caption = f"absolute deviations from the first values over time{note}"
        pictures.append(RunPicture("deviations", caption, _drawing(data, moved[:MOST_LINES], experiment, True)))
    return pictures


def _drawing(
    data: Mapping[str, Array], names: Sequence[str], experiment: Experiment, deviation: bool = False
) -> Drawing:
    return lambda axes: draw_series(axes, data, names, experiment, deviation)


def draw_quantiles(axes: Any, deviations: Mapping[str, Array]) -> None:
    """Draw the sorted deviations of each invariant over the fraction of trajectories below them."""
    for label, values in deviations.items():
        known = np.sort(values[np.isfinite(values)])
        axes.plot((np.arange(len(known)) + 0.5) / max(len(known), 1), _positive(known), label=plain(label))
        if (known > 0.0).any():
            axes.set_yscale("log")
    labelled(axes, "fraction of the trajectories", "largest deviation", xlim=(0.0, 1.0))
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), fontsize="small")


def quantiles_of(folder: Path, report: Mapping[str, Any]) -> dict[str, Array]:
    """Largest deviations of each invariant of the ensemble in ``folder``. Raises RunError if its table is damaged."""
    path = next(iter(sorted(folder.glob("trajectories.*"))), folder / "trajectories.parquet")
    columns = {str(row["symbol"]): f"max_deviation.{row['name']}" for row in report["invariants"]}
    table = read_series(path, list(columns.values()))
    return {symbol: table[column] for symbol, column in columns.items()}


def run_figure(run: StoredResult) -> Figure:
    """The figure of ``topcli plot RUN``. Raises ConfigError if its config is not known here."""
    name, report = run.manifest["name"], run.report()
    takes = f"{run.manifest['digest']} {run.manifest['code']}"
    if report.get("kind") == "ensemble":

        def draw_ensemble(canvas: Any, columns: Columns) -> None:
            draw_quantiles(canvas.subplots(), columns)

        return Figure(name, name, lambda: quantiles_of(run.folder, report), draw_ensemble, (6.4, 3.8), lambda: takes)
    experiment = load_experiment(run.manifest["config"], any_precision=True)
    series = series_of(run.series, float(Fraction(report["h"])))
    count = len(run_pictures(series, experiment)) if series else 0
    if not count:
        raise UsageError(f"{run.folder}: nothing to draw: no rows with times")

    def draw(canvas: Any, columns: Columns) -> None:
        panels = canvas.subplots(count, 1, squeeze=False)[:, 0]
        for axes, picture in zip(panels, run_pictures(columns, experiment), strict=True):
            picture.draw(axes)
        canvas.suptitle(f"{plain(name)}: {scheme_label(experiment)}, $h = {experiment.h:g}$", fontsize="medium")

    return Figure(name, name, lambda: series, draw, (6.4, 0.6 + 2.1 * count), lambda: takes)
