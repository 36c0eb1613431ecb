"""Figures of the runs of scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from topcli.contracts import Outcome
from topcli.errors import RunError, UsageError
from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.picture import Drawable, DrawnRun, Grid, Runs, described, exact_column

if TYPE_CHECKING:
    from topcli.runs.run import RunResult


class RunPanel(Drawable, Protocol):
    """A panel that takes titles, labels or parameters from the runs that it draws."""

    def of_runs(self, runs: Runs) -> Drawable:
        """Return the panel as the runs complete it."""
        ...


@runtime_checkable
class Overlaid(Protocol):
    """A panel that can show the exact motion behind a run."""

    exact: tuple[str, ...]

    def overlaid(self, known: frozenset[str]) -> Any:
        """Return the panel with the exact motion of its columns that are ``known``."""
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
    takes_overrides: ClassVar[bool] = True

    @property
    def needs(self) -> frozenset[str]:
        """Scenes whose runs it draws."""
        return frozenset(self.sources)

    @property
    def takes_overlay(self) -> bool:
        """True if a panel shows components or integrals themselves."""
        return any(isinstance(panel, Overlaid) for panel in self.panels)

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
        changed = ""
        for scene, columns in self.sources.items():
            run, about = self._run(scene, list(columns), request)
            runs.append(run)
            drawn |= dict.fromkeys(columns.values(), about)
            changed = changed or about.changed
        panels = tuple(panel.of_runs(drawn) for panel in self.panels)
        heading = described(self.layout.heading, next(iter(drawn.values())).experiment)
        if request.overlay:
            panels = self._overlaid(panels, drawn)
            heading = "; ".join([*([heading] if heading else []), "exact motion in grey"])
        source = {"runs": [[run.stored.manifest[key] for key in ("digest", "code")] for run in runs]}
        layout = replace(self.layout, heading=heading)
        return Loaded(panels, lambda: self._data(runs, panels, drawn), source, layout, variant=changed)

    def _overlaid(self, panels: tuple[Drawable, ...], drawn: Runs) -> tuple[Drawable, ...]:
        """The panels with the exact motion. Raises UsageError if no panel can show it."""
        from topcli.studies.exact_motion import exact_names

        known = frozenset(name for name, run in drawn.items() if name.rpartition(":")[2] in exact_names(run.experiment))
        found = tuple(panel.overlaid(known) if isinstance(panel, Overlaid) else panel for panel in panels)
        if not any(panel.exact for panel in found if isinstance(panel, Overlaid)):
            raise UsageError(f"{self.name}: --overlay exact: no panel shows components or integrals themselves")
        return found

    def _run(self, scene: str, columns: list[str], request: Request) -> tuple[RunResult, DrawnRun]:
        """Completed run of ``scene`` with the ``columns``. Raises UsageError and RunError."""
        from topcli.config.load import load_experiment, load_named
        from topcli.runs.plan import RunOptions
        from topcli.runs.run import run_experiment

        config = scene_config(scene, request.configs)
        experiment = load_experiment(config, request.overrides)
        changed = bool(request.overrides) and experiment.digest != load_experiment(config).digest
        if changed:
            experiment = experiment.renamed(load_named(config, request.overrides).name)
        missing = [name for name in columns if name not in experiment.recorded]
        if missing:
            raise UsageError(f"{self.name}: the config of {scene} does not record {', '.join(missing)}")
        options = RunOptions(force=request.force, on_progress=request.on_progress)
        run = run_experiment(experiment, request.results, options)
        if run.set_aside:
            request.on_message(run.set_aside_message)
        if run.outcome is not Outcome.COMPLETED:
            raise RunError(f"{self.name}: the run {run.stored.folder} {run.report['message']}")
        packaged = load_experiment(scene)
        as_packaged = (experiment.top, experiment.y0) == (packaged.top, packaged.y0)
        return run, DrawnRun(experiment, as_packaged, experiment.digest[:6] if changed else "")

    def _data(self, runs: Sequence[RunResult], panels: Sequence[Drawable], drawn: Runs) -> Mapping[str, np.ndarray]:
        from topcli.store.series import read_series
        from topcli.studies.exact_motion import exact_columns

        exact = [name for panel in panels if isinstance(panel, Overlaid) for name in panel.exact]
        data: dict[str, np.ndarray] = {}
        for run, columns in zip(runs, self.sources.values(), strict=True):
            series = read_series(run.stored.series, list(columns))
            data |= {name: series[column] for column, name in columns.items()}
            wanted = {column: name for column, name in columns.items() if name in exact}
            if wanted:
                found = exact_columns(drawn[next(iter(wanted.values()))].experiment, list(wanted))
                data |= {exact_column(wanted[column]): values for column, values in found.items()}
        return data


class PaperFigure(SceneFigure):
    """One of the paper's figures, which are drawn first."""

    rank: ClassVar[int] = 0
