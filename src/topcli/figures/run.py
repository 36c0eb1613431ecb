"""Pictures of one run: the components of its state and the deviations of its integrals over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.errors import UsageError
from topcli.figures.figure import Columns, Drawing, Figure
from topcli.figures.labels import column_label, escaped, labelled, legend_above, scheme_label
from topcli.store.results import StoredResult
from topcli.store.series import INTEGERS, WORDS, envelope, series_names

IN_WORDS = {"omega": "angular velocity ω", "gamma": "vertical γ in the body", "m": "angular momentum m"}
"""Vectors of a state in words."""
MOST_LINES = 7
"""Lines of a picture that look different."""
EXPLODED = 1e3
"""Components of an exploding motion are drawn up to this multiple of their initial value."""
LARGEST_DEVIATION = 1e100
"""Larger deviations have no place on an axis."""


def recorded_vectors(names: Sequence[str], experiment: Experiment) -> dict[str, list[str]]:
    """Recorded components by the vector that they belong to."""
    components = experiment.top.components
    vectors = {vector: components[slice(*ends)] for vector, ends in experiment.top.vectors.items()}
    present = {vector: [name for name in columns if name in names] for vector, columns in vectors.items()}
    return {vector: columns for vector, columns in present.items() if columns}


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
    title = ""
    for name in names:
        values = data[name]
        beyond = LARGEST_DEVIATION if deviation else EXPLODED * max(1.0, abs(float(values[0])))
        values = np.abs(values - values[0]) if deviation else values
        drawn = (np.abs(values) <= beyond) & ((values > 0.0) | (not deviation))
        title = title if deviation or drawn.all() else f"not shown: values beyond {beyond:.4g}"
        axes.plot(data["t"], np.where(drawn, values, np.nan), label=column_label(experiment, name))
    vector = next(
        (vector for vector, columns in recorded_vectors(names, experiment).items() if columns == list(names)), ""
    )
    label = IN_WORDS.get(vector, escaped(vector)) or ", ".join(line.get_label() for line in axes.lines)
    limits = sorted(map(float, data["t"][[0, -1]]))
    options: dict[str, Any] = {"xlim": limits} if limits[0] < limits[1] else {}
    options |= {"yscale": "log"} if deviation else {}
    labelled(axes, "time $t$", "deviation from the first value" if deviation else label, title, **options)
    if len(names) > 1:
        legend_above(axes)


def run_pictures(data: Mapping[str, Array], experiment: Experiment) -> list[Drawing]:
    """Pictures of the columns of one trajectory: one for each vector and quantity, and the deviations of the others."""
    vectors = recorded_vectors(list(data), experiment)
    moving = [component for components in vectors.values() for component in components]
    quantities = [column for column in experiment.output.quantities or () if column in data]
    apart = {"t", *INTEGERS, *moving, *quantities, *experiment.output.attitude_columns}
    panels = [*vectors.values(), *([column] for column in quantities)]
    pictures: list[Drawing] = [partial(draw_series, data=data, names=names, experiment=experiment) for names in panels]
    if moved := [name for name in data if name not in apart and (data[name] != data[name][0]).any()]:
        names = moved[:MOST_LINES]
        pictures.append(partial(draw_series, data=data, names=names, experiment=experiment, deviation=True))
    return pictures


def run_figure(run: StoredResult) -> Figure:
    """The figure of ``topcli plot RUN``. Raises UsageError for an ensemble and for a config not known here."""
    name, report = run.manifest["name"], run.report()
    takes = f"{run.manifest['digest']} {run.manifest['code']}"
    if report.get("kind") == "ensemble":
        raise UsageError(f"{run.folder}: is an ensemble; draw one of its trajectories, run by itself, or its section")
    experiment = load_experiment(run.manifest["config"], any_precision=True)
    series = series_of(run.series, float(Fraction(report["h"])))
    count = len(run_pictures(series, experiment)) if series else 0
    if not count:
        raise UsageError(f"{run.folder}: nothing to draw: no rows with times")

    def draw(canvas: Any, columns: Columns) -> None:
        panels = canvas.subplots(count, 1, squeeze=False)[:, 0]
        for axes, picture in zip(panels, run_pictures(columns, experiment), strict=True):
            picture(axes)
        canvas.suptitle(f"{escaped(name)}: {scheme_label(experiment)}, $h = {experiment.h:g}$", fontsize="medium")

    return Figure(name, name, lambda: series, draw, (6.4, 0.6 + 2.1 * count), lambda: takes)
