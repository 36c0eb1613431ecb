"""Poincaré sections: the crossings of stored runs, coloured by orbit or by the verdict regular or chaotic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.lyapunov import Verdict, growth_of
from topcli.config.load import load
from topcli.config.models import Experiment
from topcli.errors import UsageError, nearest, quoted
from topcli.figures.figure import Columns, Figure
from topcli.figures.labels import component_symbol, labelled
from topcli.schemes.display import display_name
from topcli.store.results import StoredResult, read_result
from topcli.store.series import read_series

_TINTS = ("#0072B2", "#D55E00", "#999999", "#000000", "#009E73", "#CC79A7", "#56B4E9")
COLOURS = dict(zip(Verdict, _TINTS, strict=True))
ORBIT_COLOURS = (*_TINTS, "#E69F00")
MOST_SIZE, INK = 2.0, 3000.0
"""Largest size of a point in printer's points, and the sum of the sizes, if there are many."""


def section_figure(folders: Sequence[Path], x: str | None, y: str | None, colour: str | None) -> Figure:
    """The figure of ``topcli plot section``: the crossings of the runs in ``folders``.

    Raises UsageError for runs, columns or a colour that cannot be drawn.
    """
    if not folders:
        raise UsageError("plot section: name folders of runs, as in: topcli plot section DIR/NAME --colour verdict")
    if colour not in (None, "verdict"):
        raise UsageError(f"--colour {quoted(colour)}: a section is coloured by orbit, or with --colour verdict")
    runs = [_run_with_section(folder) for folder in folders]
    experiments = [load(dict(run.manifest["config"])) for run in runs]
    first, *others = experiments
    for run, other in zip(runs[1:], others, strict=True):
        if _shared(other) != _shared(first):
            raise UsageError(f"{run.folder}: its top, scheme, h, section or quantities differ; draw it by itself")

    # by default, the first two columns that are free on the section
    section: Any = first.section
    columns = [name for name in first.recorded if name not in ("n", "t")]
    for option, name in (("--x", x), ("--y", y)):
        if name is not None and name not in columns:
            raise UsageError(f"{option} {quoted(name)}: no such column; {nearest(name, columns)}")
    free = [name for name in columns if name not in (section.component, x, y)] + columns
    across = x or free.pop(0)
    up = y or free[0]
    where = component_symbol(section.component) if section.component else section.formula
    title = f"{display_name(first.scheme.name)}, $h = {first.h:g}$: {where} = {section.value:g}"

    def draw(canvas: Any, points: Columns) -> None:
        axes, by_verdict = canvas.subplots(), colour is not None
        size = max(0.2, min(MOST_SIZE, INK / len(points["orbit"])))
        look = {"linestyle": "none", "marker": "o", "markersize": size, "markeredgewidth": 0.0, "rasterized": True}
        numbers = points["orbit"] % len(ORBIT_COLOURS)
        kinds = COLOURS.items() if by_verdict else enumerate(ORBIT_COLOURS)
        for kind, tint in kinds:
            here = points["verdict"] == kind if by_verdict else numbers == kind
            if here.any():
                axes.plot(points[across][here], points[up][here], color=tint, label=kind, **look)
        if by_verdict:
            axes.legend(markerscale=3.0 / size, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        labelled(axes, component_symbol(across), component_symbol(up), title)

    def data() -> Columns:
        parts = [_crossings(*pair, [across, up], colour) for pair in zip(runs, experiments, strict=True)]
        begins = np.cumsum([0, *(part["orbit"].max() + 1 for part in parts)])
        for part, begin in zip(parts, begins, strict=False):
            part["orbit"] = part["orbit"] + begin
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    names = "-".join(dict.fromkeys(run.folder.name for run in runs))[:60]
    name = "-".join(filter(None, ["section", names, across, up, colour]))
    takes = " ".join(f"{run.manifest['digest']} {run.manifest['code']}" for run in runs)
    return Figure(name, f"Section of {names}", data, draw, (5.0, 4.2), lambda: takes)


def _shared(experiment: Experiment) -> list[Any]:
    """Parts of a config that all runs of one figure share: the title and the axes state them."""
    config = experiment.resolved()
    return [*(config[name] for name in ("top", "scheme", "h", "section")), experiment.output.quantities]


def _run_with_section(folder: Path) -> StoredResult:
    """Run in ``folder``. Raises UsageError if there is none, or none with crossings."""
    run = read_result(folder)
    if run is None or run.outcome is None:
        raise UsageError(f"{folder}: no finished run here; topcli run CONFIG makes one")
    if "section" not in run.manifest["config"]:
        raise UsageError(
            f"{folder}: the run recorded steps, not a section; "
            "run it with, for example, --set section.component=gamma2 --set section.value=0"
        )
    report = run.report()
    if not report["section"]["crossings"]:
        raise UsageError(f"{folder}: nothing to draw: {report['message']}")
    return run


def _crossings(run: StoredResult, experiment: Experiment, names: Sequence[str], colour: str | None) -> dict[str, Any]:
    """Columns of the crossings of a run, the numbers of their orbits, and verdicts in words if they give the colour."""
    ensemble = experiment.ensemble
    rows = read_series(run.series, ["trajectory"] * bool(ensemble) + list(names))
    orbit = rows.pop("trajectory", np.zeros(len(rows[names[0]]), dtype=int))
    if colour is None:
        return {**rows, "orbit": orbit}
    tops, states = (ensemble.tops, ensemble.states) if ensemble else ((experiment.top,), np.array([experiment.y0]))
    copies = [experiment.model_copy(update={"top": top}) for top in tops]
    growths = [growth_of(each.top, each.scheme, each.method(), each.h, each.N, states) for each in copies]
    verdicts = np.array([verdict.value for growth in growths for verdict in growth.verdicts])
    return {**rows, "orbit": orbit, "verdict": verdicts[orbit]}
