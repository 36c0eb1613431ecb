"""Figures of the runs of scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from topcli.contracts import Outcome
from topcli.errors import RunError, UsageError
from topcli.figures.figure import Figure, Loaded, Request
from topcli.figures.picture import Drawable, DrawnRun, Grid, Runs, described, exact_column

if TYPE_CHECKING:
    from topcli.runs.run import RunResult


class RunPanel(Protocol):
    """A panel that takes titles, labels or parameters from the runs that it draws.

    If it can show the exact motion behind them, the columns that have one are in ``exact``.
    """

    def of_runs(self, runs: Runs) -> Drawable:
        """Return the panel as the runs complete it."""
        ...


def scene_config(scene: str, configs: Path) -> Path | str:
    """Config of ``scene`` in the folder ``configs``, or the packaged scene's name if there is none."""
    for suffix in (".yaml", ".yml", ".toml"):
        path = configs / f"{scene}{suffix}"
        if path.is_file():
            return path
    return scene


def scene_figure(
    name: str,
    title: str,
    scene: str,
    panels: Sequence[RunPanel],
    layout: Grid,
    others: Sequence[str] = (),
    rank: int = 2,
) -> Figure:
    """A figure of columns of the run of ``scene``; ``other:name`` is a column of the run of a scene in ``others``."""
    return Figure(
        name,
        title,
        scene,
        partial(_load, name, {"": scene} | {other: other for other in others}, tuple(panels), layout),
        needs=(scene, *others),
        rank=rank,
        takes_overrides=True,
        takes_overlay=any(hasattr(panel, "exact") for panel in panels),
    )


def _load(name: str, scenes: Mapping[str, str], panels: Sequence[RunPanel], layout: Grid, request: Request) -> Loaded:
    """Load panels and columns of the runs, which are carried out if missing. Raises UsageError and RunError."""
    finished: dict[str, RunResult] = {}
    drawn: dict[str, DrawnRun] = {}
    for key, scene in scenes.items():
        finished[key], drawn[key] = finished[scene], drawn[scene] = _run(name, scene, request)
    runs = Runs(drawn, request.overlay)
    completed = tuple(panel.of_runs(runs) for panel in panels)
    heading = described(layout.heading, next(iter(drawn.values())).experiment)
    if request.overlay:
        if not any(getattr(panel, "exact", ()) for panel in completed):
            raise UsageError(f"{name}: --overlay exact: no panel shows components or integrals themselves")
        heading = "; ".join([*([heading] if heading else []), "exact motion in grey"])
    return Loaded(
        completed,
        lambda: _Columns(name, scenes, finished, drawn),
        {
            "runs": [
                [run.stored.manifest[key] for key in ("digest", "code")] for run in map(finished.__getitem__, scenes)
            ]
        },
        replace(layout, heading=heading),
        variant=next((run.changed for run in drawn.values() if run.changed), ""),
    )


def _run(name: str, scene: str, request: Request) -> tuple[RunResult, DrawnRun]:
    """Completed run of ``scene``. Raises UsageError and RunError."""
    from topcli.config.load import load_experiment, load_named
    from topcli.runs.decision import RunOptions
    from topcli.runs.run import run_experiment

    config = scene_config(scene, request.configs)
    experiment = load_experiment(config, request.overrides)
    changed = bool(request.overrides) and experiment.digest != load_experiment(config).digest
    if changed:
        experiment = experiment.renamed(load_named(config, request.overrides).name)
    options = RunOptions(force=request.force, on_progress=request.on_progress)
    run = run_experiment(experiment, request.results, options)
    if run.set_aside:
        request.on_message(run.set_aside_message)
    if run.outcome is not Outcome.COMPLETED:
        raise RunError(f"{name}: the run {run.stored.folder} {run.report['message']}")
    packaged = load_experiment(scene)
    as_packaged = (experiment.top, experiment.y0) == (packaged.top, packaged.y0)
    return run, DrawnRun(experiment, as_packaged, experiment.digest[:6] if changed else "")


class _Columns(dict[str, Any]):
    """Columns of the runs, read when they are drawn; ``exact:<column>`` is that of the exact motion."""

    def __init__(
        self, name: str, scenes: Mapping[str, str], finished: Mapping[str, RunResult], drawn: Mapping[str, DrawnRun]
    ) -> None:
        super().__init__()
        self.name, self.scenes, self.finished, self.drawn = name, scenes, finished, drawn
        self.exact: dict[str, Mapping[str, np.ndarray]] = {}

    def __missing__(self, name: str) -> np.ndarray:
        """Column of this name. Raises UsageError if its run does not record it."""
        from topcli.runs.references import exact_columns
        from topcli.store.series import read_series

        plain = name.removeprefix(exact_column(""))
        key, _, column = plain.rpartition(":")
        experiment = self.drawn[key].experiment
        if plain != name:
            if key not in self.exact:
                self.exact[key] = exact_columns(experiment)
            self[name] = self.exact[key][column]
        elif column in experiment.recorded:
            self[name] = read_series(self.finished[key].stored.series, [column])[column]
        else:
            raise UsageError(f"{self.name}: the config of {self.scenes.get(key, key)} does not record {column}")
        return self[name]
