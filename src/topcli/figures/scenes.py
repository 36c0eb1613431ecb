"""Figures of the runs of scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from topcli.contracts import Outcome
from topcli.errors import RunError, UsageError
from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.picture import Drawable, DrawnRun, Grid, Runs

if TYPE_CHECKING:
    from topcli.studies.run import RunResult


class RunPanel(Drawable, Protocol):
    """A panel that takes titles, labels or parameters from the runs that it draws."""

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


@dataclass(frozen=True)
class SceneFigure(Figure):
    """A figure of columns of the run of ``scene``; a column named ``other:column`` is read from the scene ``other``."""

    panels: tuple[RunPanel, ...]
    layout: Grid = field(default_factory=Grid)

    @property
    def sources(self) -> dict[str, dict[str, str]]:
        """Scenes read, each with the columns taken from its run and their names in the figure's data."""
        found: dict[str, dict[str, str]] = {}
        for name in dict.fromkeys(name for panel in self.panels for name in panel.columns):
            scene, _, column = name.rpartition(":")
            found.setdefault(scene or self.scene, {})[column] = name
        return found

    def load(self, request: Request) -> Loaded:
        """Return panels and columns of the runs, which are carried out if missing. Raises UsageError and RunError."""
        runs: list[RunResult] = []
        drawn: dict[str, DrawnRun] = {}
        for scene, columns in self.sources.items():
            run, about = self._run(scene, list(columns), request)
            runs.append(run)
            drawn |= dict.fromkeys(columns.values(), about)
        panels = tuple(panel.of_runs(drawn) for panel in self.panels)
        source = {"runs": [[run.stored.manifest[key] for key in ("digest", "code")] for run in runs]}
        return Loaded(panels, lambda: self._data(runs), source, self.layout)

    def _run(self, scene: str, columns: list[str], request: Request) -> tuple[RunResult, DrawnRun]:
        """Completed run of ``scene`` with the ``columns``. Raises UsageError and RunError."""
        from topcli.config.load import load_experiment
        from topcli.studies.run import Feedback, run_experiment

        experiment = load_experiment(scene_config(scene, request.configs))
        missing = [name for name in columns if name not in experiment.recorded]
        if missing:
            raise UsageError(f"{self.name}: the config of {scene} does not record {', '.join(missing)}")
        run = run_experiment(experiment, request.results, force=request.force, feedback=Feedback(request.on_progress))
        if run.set_aside:
            request.on_message(run.set_aside_message)
        if run.outcome is not Outcome.COMPLETED:
            raise RunError(f"{self.name}: the run {run.stored.folder} {run.report['message']}")
        packaged = load_experiment(scene)
        return run, DrawnRun(experiment, (experiment.top, experiment.y0) == (packaged.top, packaged.y0))

    def _data(self, runs: Sequence[RunResult]) -> Mapping[str, np.ndarray]:
        from topcli.store.series import read_series

        data: dict[str, np.ndarray] = {}
        for run, columns in zip(runs, self.sources.values(), strict=True):
            series = read_series(run.stored.series, list(columns))
            data |= {name: series[column] for column, name in columns.items()}
        return data
