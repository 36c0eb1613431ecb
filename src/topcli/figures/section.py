"""Poincaré sections: the crossings of a stored run, coloured by orbit or by the verdict regular or chaotic."""

from __future__ import annotations

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
_COLOURS = dict(zip(Verdict, _TINTS, strict=True))
ORBIT_COLOURS = (*_TINTS, "#E69F00")
MOST_SIZE, INK = 2.0, 3000.0
"""Largest size of a point in printer's points, and the sum of the sizes, if there are many."""


def section_figure(folder: Path, x: str | None, y: str | None, colour: str | None) -> Figure:
    """The figure of ``topcli plot section``: the crossings of the run in ``folder``.

    The default of ``x`` and ``y`` are the first two columns that are free on the section. Raises UsageError for a run,
    columns or a colour that cannot be drawn.
    """
    if colour not in (None, "verdict"):
        raise UsageError(f"--colour {quoted(colour)}: a section is coloured by orbit, or with --colour verdict")
    run = _run_with_section(folder)
    experiment = load(dict(run.manifest["config"]))
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
        tints: Any = _COLOURS if colour else dict(enumerate(ORBIT_COLOURS))
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
    takes = f"{run.manifest['digest']} {run.manifest['code']}"
    return Figure(name, f"Section of {run.folder.name}", data, draw, (5.0, 4.2), lambda: takes)


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


def _verdicts(experiment: Experiment) -> np.ndarray:
    """Verdict on each orbit, in words."""
    ensemble = experiment.ensemble
    tops, states = (ensemble.tops, ensemble.states) if ensemble else ((experiment.top,), np.array([experiment.y0]))
    scheme, h, N = experiment.scheme, experiment.h, experiment.N
    methods = [experiment.model_copy(update={"top": top}).method() for top in tops]
    growths = [growth_of(top, scheme, method, h, N, states) for top, method in zip(tops, methods, strict=True)]
    return np.array([verdict.value for growth in growths for verdict in growth.verdicts])
