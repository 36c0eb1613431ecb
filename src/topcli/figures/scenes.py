"""Figures of packaged scenes, and the panel of a body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import numpy as np

from topcli.arithmetic.quaternions import matrices
from topcli.config.load import load_experiment
from topcli.contracts import Outcome
from topcli.engine.columns import ATTITUDES, QUATERNION
from topcli.errors import RunError
from topcli.figures.body import Body, BodyArtist, body_of
from topcli.figures.figure import Figure, Loaded, Request
from topcli.figures.picture import Drawable, Grid
from topcli.figures.space import SPATIAL
from topcli.store.results import StoredResult


def scene_figure(
    name: str,
    title: str,
    scene: str,
    panels: Sequence[Drawable],
    layout: Grid,
    others: Sequence[str] = (),
    overrides: Sequence[str] = (),
) -> Figure:
    """A figure of columns of the run of ``scene``; ``other:name`` is a column of the run of a scene in ``others``.

    The texts ``key=value`` in ``overrides`` change the config of ``scene``.
    """
    runs = {"": (scene, overrides), scene: (scene, overrides)} | {other: (other, ()) for other in others}
    return Figure(name, title, scene, partial(_load, name, runs, tuple(panels), layout))


def _load(
    name: str,
    configs: Mapping[str, tuple[str, Sequence[str]]],
    panels: Sequence[Drawable],
    layout: Grid,
    request: Request,
) -> Loaded:
    """Load panels and columns of the runs, which are carried out if missing. Raises UsageError and RunError."""
    found = {config: _run(name, *config, request) for config in dict.fromkeys(configs.values())}
    runs = {scene: found[config] for scene, config in configs.items()}
    source = {"runs": [[run.manifest[key] for key in ("digest", "code")] for run in found.values()]}
    return Loaded(panels, lambda: _Columns(runs), source, layout)


def _run(name: str, scene: str, overrides: Sequence[str], request: Request) -> StoredResult:
    """Completed run of ``scene``. Raises UsageError and RunError."""
    from topcli.runs.run import RunOptions, run_experiment

    options = RunOptions(force=request.force, on_progress=request.on_progress)
    run = run_experiment(load_experiment(scene, overrides), request.results, options)
    if run.set_aside:
        request.on_message(f"renamed the earlier result to {run.set_aside}")
    if run.outcome is not Outcome.COMPLETED:
        raise RunError(f"{name}: the run {run.stored.folder} {run.report['message']}")
    return run.stored


class _Columns(dict[str, Any]):
    """Columns of the runs by scene, read when they are drawn."""

    def __init__(self, runs: Mapping[str, StoredResult]) -> None:
        super().__init__()
        self.runs = runs

    def __missing__(self, name: str) -> np.ndarray:
        """Column of this name."""
        from topcli.store.series import read_series

        scene, _, column = name.rpartition(":")
        self[name] = read_series(self.runs[scene].series, [column])[column]
        return self[name]


@dataclass(frozen=True)
class BodyPanel:
    """A body in the run of ``scene`` after the part ``until`` of its rows, with the trace of its axis until then."""

    title: str
    scene: str
    until: float
    body: Body = field(repr=False)
    projection: ClassVar[str] = SPATIAL

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw into ``axes``; ``styles`` is not used."""
        attitudes = np.column_stack([data[f"{self.scene}:{name}"] for name in ATTITUDES[QUATERNION]])
        rotations = matrices(attitudes[np.isfinite(attitudes).all(axis=1)])
        last = round(self.until * (len(rotations) - 1))
        artist = BodyArtist(axes, self.body, rotations[: last + 1] @ self.body.axis)
        artist.show(last, 0, rotations[last])
        for line in artist.new:
            line.set_linewidth(0.8 * line.get_linewidth() / 1.9)
        labels = "trace of the axis", "on the far side", "the axis at the end"
        for line, label in zip((*artist.new, artist.dot), labels, strict=True):
            line.set_label(label)
        axes.set_title(self.title)


BODIES = {
    "euler_attitude": ("(a) Euler", 0.45),
    "lagrange_attitude": ("(b) Lagrange", 0.93),
    "kowalevski_attitude": ("(c) Kowalevski", 0.5),
}
"""Title, and part of the rows, for each scene of the figure ``body``."""


def load_body(request: Request) -> Loaded:
    """Load the bodies of the scenes. Raises UsageError and RunError."""
    panels = []
    for scene, (title, until) in BODIES.items():
        experiment = load_experiment(scene)
        panels.append(BodyPanel(title, scene, until, body_of(experiment.top, experiment.y0)))
    heading = r"fixed directions: momentum $\boldsymbol{m}$, vertical $\boldsymbol{p}$"
    layout = Grid(figsize=(7.0, 3.1), ncols=3, heading=heading)
    return _load("body", {scene: (scene, ()) for scene in BODIES}, panels, layout, request)
