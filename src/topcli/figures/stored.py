"""Pictures of a stored run: its columns and the deviations of its integrals over time, or its Poincaré section."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.lyapunov import Verdict, growth_of
from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.errors import UsageError, nearest, quoted
from topcli.figures.figure import Columns, Figure
from topcli.figures.style import column_label, component_symbol, labelled, legend_above, plain_text, scheme_label
from topcli.schemes.display import display_name
from topcli.store.results import StoredResult, read_result
from topcli.store.series import INTEGERS, WORDS, envelope, read_series, series_names

IN_WORDS = {"omega": "angular velocity ω", "gamma": "vertical γ in the body", "m": "angular momentum m"}
"""Vectors of a state in words."""
MOST_LINES = 7
"""Lines of a picture that look different."""
EXPLODED = 1e3
"""Components of an exploding motion are drawn up to this multiple of their initial value."""
LARGEST_DEVIATION = 1e100
"""Larger deviations have no place on an axis."""
_TINTS = ("#0072B2", "#D55E00", "#999999", "#000000", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
"""Colours of the orbits of a section; the first of them are those of the verdicts."""
MOST_SIZE, INK = 2.0, 3000.0
"""Largest size of a point of a section in printer's points, and the sum of the sizes, if there are many."""


def recorded_vectors(names: Sequence[str], experiment: Experiment) -> dict[str, list[str]]:
    """Recorded components by the vector that they belong to."""
    components = experiment.top.components
    vectors = {vector: components[slice(*ends)] for vector, ends in experiment.top.vectors.items()}
    present = {vector: [name for name in columns if name in names] for vector, columns in vectors.items()}
    return {vector: columns for vector, columns in present.items() if columns}


def series_of(path: Path, h: float) -> dict[str, Array]:
    """Columns of a stored series at the rows that a picture needs, and the times ``t``; empty without rows or times.

    Raises RunError if the file is damaged.
    """
    names = [name for name in series_names(path) if name not in WORDS]
    if not {"t", "n"} & set(names):
        return {}
    data = envelope(path, names)
    if "t" not in data:
        data["t"] = data["n"] * h
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
    vectors = {tuple(columns): vector for vector, columns in recorded_vectors(names, experiment).items()}
    vector = vectors.get(tuple(names), "")
    label = IN_WORDS.get(vector, plain_text(vector)) or ", ".join(line.get_label() for line in axes.lines)
    limits = sorted(map(float, data["t"][[0, -1]]))
    options: dict[str, Any] = {"xlim": limits} if limits[0] < limits[1] else {}
    options |= {"yscale": "log"} if deviation else {}
    labelled(axes, "time $t$", "deviation from the first value" if deviation else label, title, **options)
    if len(names) > 1:
        legend_above(axes)


def panels_of(data: Mapping[str, Array], experiment: Experiment) -> list[tuple[list[str], bool]]:
    """Columns of each panel: those of a vector, a quantity, and, as deviations (True), the others that move."""
    vectors = list(recorded_vectors(list(data), experiment).values())
    quantities = [[column] for column in experiment.output.quantities or () if column in data]
    apart = {"t", *INTEGERS, *experiment.output.attitude_columns, *itertools.chain(*vectors, *quantities)}
    moved = [name for name in data if name not in apart and (data[name] != data[name][0]).any()]
    return [(names, False) for names in (*vectors, *quantities)] + [(moved[:MOST_LINES], True)] * bool(moved)


def _digests(run: StoredResult) -> str:
    """Digests of the config and the code of a run."""
    return f"{run.manifest['digest']} {run.manifest['code']}"


def run_figure(run: StoredResult) -> Figure:
    """The figure of ``topcli plot RUN``. Raises UsageError for an ensemble and for a config not known here."""
    name, report, takes = run.manifest["name"], run.report(), _digests(run)
    if report.get("kind") == "ensemble":
        raise UsageError(f"{run.folder}: is an ensemble; draw one of its trajectories, run by itself, or its section")
    experiment = load_experiment(run.manifest["config"], any_precision=True)
    series = series_of(run.series, float(Fraction(report["h"])))
    panels = panels_of(series, experiment) if series else []
    if not panels:
        raise UsageError(f"{run.folder}: nothing to draw: no rows with times")

    def draw(canvas: Any, columns: Columns) -> None:
        grid = canvas.subplots(len(panels), 1, squeeze=False)
        for axes, (names, deviation) in zip(grid.flat, panels, strict=True):
            draw_series(axes, columns, names, experiment, deviation)
        canvas.suptitle(f"{plain_text(name)}: {scheme_label(experiment)}, $h = {experiment.h:g}$", fontsize="medium")

    return Figure(name, name, lambda: series, draw, (6.4, 0.6 + 2.1 * len(panels)), lambda: takes)


def section_figure(folder: Path, x: str | None, y: str | None, colour: str | None) -> Figure:
    """The figure of ``topcli plot section``: the crossings of the run in ``folder``.

    The default of ``x`` and ``y`` are the first two columns that are free on the section. Raises UsageError for a run,
    columns or a colour that cannot be drawn.
    """
    if colour not in (None, "verdict"):
        raise UsageError(f"--colour {quoted(colour)}: a section is coloured by orbit, or with --colour verdict")
    run = read_result(folder)
    if run is None or run.outcome is None:
        raise UsageError(f"{folder}: no finished run here; topcli run CONFIG makes one")
    if "section" not in run.manifest["config"]:
        example = "--set section.component=gamma2 --set section.value=0"
        raise UsageError(f"{folder}: the run recorded steps, not a section; run it with, for example, {example}")
    report = run.report()
    if not report["section"]["crossings"]:
        raise UsageError(f"{folder}: nothing to draw: {report['message']}")
    experiment, takes = load(dict(run.manifest["config"])), _digests(run)
    section: Any = experiment.crossings
    columns = [name for name in experiment.recorded if name not in ("n", "t")]
    for option, name in (("--x", x), ("--y", y)):
        if name is not None and name not in columns:
            raise UsageError(f"{option} {quoted(name)}: no such column; {nearest(name, columns)}")
    # the component of the section itself is constant, and is the last choice for an axis
    free = [name for name in columns if name not in (section.component, x, y)] + columns
    across = x or free.pop(0)
    up = y or free[0]
    where = component_symbol(section.component) if section.component else section.formula
    title = f"{display_name(experiment.scheme.name)}, $h = {experiment.h:g}$: {where} = {section.value:g}"

    def draw(canvas: Any, points: Columns) -> None:
        axes = canvas.subplots()
        size = max(0.2, min(MOST_SIZE, INK / len(points["orbit"])))
        look = {"linestyle": "none", "marker": "o", "markersize": size, "markeredgewidth": 0.0, "rasterized": True}
        tints: Any = dict(zip(Verdict, _TINTS, strict=False)) if colour else dict(enumerate(_TINTS))
        kinds = points["verdict"] if colour else points["orbit"] % len(tints)
        for kind in filter(kinds.tolist().__contains__, tints):
            here = kinds == kind
            axes.plot(points[across][here], points[up][here], color=tints[kind], label=kind, **look)
        if colour:
            axes.legend(markerscale=3.0 / size, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        labelled(axes, component_symbol(across), component_symbol(up), title)

    def data() -> Columns:
        rows = read_series(run.series, ["trajectory"] * bool(experiment.ensemble) + [across, up])
        orbit = rows.pop("trajectory", np.zeros(len(rows[across]), dtype=int))
        return {**rows, "orbit": orbit} | ({"verdict": _verdicts(experiment)[orbit]} if colour else {})

    name = "-".join(filter(None, ["section", run.folder.name, across, up, colour]))
    return Figure(name, f"Section of {run.folder.name}", data, draw, (5.0, 4.2), lambda: takes)


def _verdicts(experiment: Experiment) -> np.ndarray:
    """Verdict on each orbit, in words."""
    ensemble = experiment.ensemble
    tops, states = (ensemble.tops, ensemble.states) if ensemble else ((experiment.top,), np.array([experiment.y0]))
    scheme, h, N = experiment.scheme, experiment.h, experiment.N
    methods = [experiment.model_copy(update={"top": top}).method() for top in tops]
    growths = [growth_of(top, scheme, method, h, N, states) for top, method in zip(tops, methods, strict=True)]
    return np.array([verdict.value for growth in growths for verdict in growth.verdicts])
