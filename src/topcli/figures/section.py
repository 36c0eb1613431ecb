"""Poincaré sections: the crossings of stored runs, coloured by orbit or by the verdict regular or chaotic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.lyapunov import Verdict, growth_of
from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load
from topcli.config.models import Experiment
from topcli.errors import UsageError, nearest, quoted
from topcli.figures.figure import Figure, Loaded, Request
from topcli.figures.picture import Grid, caption, component_symbol
from topcli.schemes.display import display_name
from topcli.store.results import StoredResult, read_result
from topcli.store.series import read_series

VERDICT = "verdict"
"""Colour by the growth of tangent vectors."""
COLOURS = {
    Verdict.REGULAR: "#0072B2",
    Verdict.CHAOTIC: "#D55E00",
    Verdict.UNDECIDED: "#999999",
    Verdict.BROKE_OFF: "#000000",
    Verdict.EQUILIBRIUM: "#009E73",
    Verdict.UNSTABLE: "#CC79A7",
    Verdict.ESCAPING: "#56B4E9",
}
ORBIT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#999999")
MOST_SIZE, INK = 2.0, 3000.0
"""Largest size of a point in printer's points, and the sum of the sizes, if there are many."""
NAME_LENGTH = 60


@dataclass(frozen=True)
class Points:
    """Crossings in the plane of the columns ``x`` and ``y``, with the numbers of the ``orbit`` and the ``verdict``."""

    x: str
    y: str
    title: str
    by_verdict: bool

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw into ``axes``; ``styles`` is not used."""
        orbit, verdict = data["orbit"].astype(int), data["verdict"].astype(int)
        size = max(0.2, min(MOST_SIZE, INK / len(orbit)))
        looks = {"linestyle": "none", "marker": "o", "markersize": size, "markeredgewidth": 0.0, "rasterized": True}
        kinds = [(kind.value, verdict == i, COLOURS[kind]) for i, kind in enumerate(Verdict)]
        if not self.by_verdict:
            count = len(ORBIT_COLOURS)
            kinds = [("", orbit % count == i, colour) for i, colour in enumerate(ORBIT_COLOURS)]
        for label, here, colour in kinds:
            if here.any():
                axes.plot(data[self.x][here], data[self.y][here], color=colour, label=label or None, **looks)
        if self.by_verdict:
            axes.legend(markerscale=3.0 / size, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        caption(axes, component_symbol(self.x), component_symbol(self.y), self.title)


def section_figure(folders: Sequence[Path], x: str | None, y: str | None, colour: str | None) -> Figure:
    """The figure of ``topcli plot section``: the crossings of the runs in ``folders``.

    Raises UsageError for runs, columns or a colour that cannot be drawn.
    """
    if not folders:
        raise UsageError("plot section: name folders of runs, as in: topcli plot section DIR/NAME --colour verdict")
    if colour not in (None, VERDICT):
        raise UsageError(f"--colour {quoted(colour)}: a section is coloured by orbit, or with --colour {VERDICT}")
    runs = [_run_with_section(folder) for folder in folders]
    experiments = [load(dict(run.manifest["config"])) for run in runs]
    first = _single(experiments[0])
    columns = [name for name in first.recorded if name not in ("n", "t")]
    free = [name for name in columns if first.section and name != first.section.component]
    for option, name in (("--x", x), ("--y", y)):
        if name is not None and name not in columns:
            raise UsageError(f"{option} {quoted(name)}: no such column; {nearest(name, columns)}")
    chosen = x or next(name for name in [*free, *columns] if name != y)
    other_axis = y or next(name for name in [*free, *columns] if name != chosen)
    common = _drawn_together(first, chosen, other_axis)
    for run, other in zip(runs, map(_single, experiments), strict=True):
        differing = [
            name for name, value in _drawn_together(other, chosen, other_axis).items() if value != common[name]
        ]
        if differing:
            verb = "differs" if len(differing) == 1 else "differ"
            raise UsageError(
                f"{run.folder}: its {' and '.join(differing)} {verb} from that of {runs[0].folder}; "
                "draw it in its own figure"
            )
    parts = "-".join(dict.fromkeys(run.folder.name for run in runs))[:NAME_LENGTH]
    name = f"section-{parts}-{chosen}-{other_axis}" + (f"-{colour}" if colour else "")
    loader = partial(_load_section, tuple(runs), tuple(experiments), chosen, other_axis, colour is not None)
    return Figure(name, f"Section of {parts}", "topcli run", loader)


def _single(experiment: Experiment | EnsembleExperiment) -> Experiment:
    return experiment if isinstance(experiment, Experiment) else experiment.first


def _drawn_together(experiment: Experiment, *columns: str) -> dict[str, Any]:
    """Parts of a config that all runs of one figure share, by name: the title and the axes state them."""
    config = experiment.resolved()
    formulas = experiment.output.quantities or {}
    meanings = {f"column {name}": (name in experiment.recorded, formulas.get(name)) for name in columns}
    return {name: config[name] for name in ("top", "scheme", "h", "section")} | meanings


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


def _load_section(
    runs: Sequence[StoredResult],
    experiments: Sequence[Experiment | EnsembleExperiment],
    x: str,
    y: str,
    by_verdict: bool,
    request: Request,
) -> Loaded:
    first = _single(experiments[0])
    assert first.section is not None

    def data() -> dict[str, np.ndarray]:
        parts, begin = [], 0
        for run, experiment in zip(runs, experiments, strict=True):
            count = experiment.count if isinstance(experiment, EnsembleExperiment) else 1
            ensemble = isinstance(experiment, EnsembleExperiment)
            rows = read_series(run.series, ["trajectory", x, y] if ensemble else [x, y])
            orbit = rows.pop("trajectory") if ensemble else np.zeros(len(rows[x]), dtype=int)
            verdicts = _verdicts(experiment) if by_verdict else np.zeros(count)
            parts.append({**rows, "orbit": (orbit + begin).astype(float), "verdict": verdicts[orbit]})
            begin += count
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    component = first.section.component
    where = component_symbol(component) if component else first.section.formula
    title = f"{display_name(first.scheme.name)}, $h = {first.h:g}$: {where} = {first.section.value:g}"
    source = {
        "runs": [[run.manifest["digest"], run.manifest["code"]] for run in runs],
        "columns": [x, y, by_verdict],
    }
    return Loaded((Points(x, y, title, by_verdict),), data, source, Grid(figsize=(5.0, 4.2)))


def _verdicts(experiment: Experiment | EnsembleExperiment) -> np.ndarray:
    """Verdict on each orbit, as its number in ``Verdict``. Raises UsageError for a scheme without a tangent map."""
    if isinstance(experiment, Experiment):
        groups = [(experiment, np.array([experiment.y0]))]
    else:
        groups = [(experiment.of_group(group), group.states) for group in experiment.members.groups]
    found = [growth_of(one.top, one.scheme, one.method(), one.h, one.N, y0).verdicts for one, y0 in groups]
    numbers = {verdict: float(i) for i, verdict in enumerate(Verdict)}
    return np.array([numbers[verdict] for verdicts in found for verdict in verdicts])
