"""Make figures: find or run their experiments, take the plotted columns, draw, write data and pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from topcli import __version__
from topcli.config.load import load_experiment
from topcli.contracts import Outcome
from topcli.engine.fingerprint import fingerprint
from topcli.errors import RunError, UsageError
from topcli.figures.catalogue import FigureSpec, Measured, Study
from topcli.figures.picture import IMAGE_FORMATS, STYLE, Drawable, Drawn, Panel, Runs, draw, save
from topcli.figures.polhodes import Polhodes
from topcli.figures.sphere import Sphere
from topcli.store.run_folder import io_failure, require_writable, write_whole
from topcli.store.series import read_metadata, read_series, write_parquet
from topcli.studies.run import Progress, RunResult, run_experiment

SOURCE = "topcli.figure.source"


@dataclass(frozen=True)
class MadeFigure:
    """One figure's files and whether they were drawn now or stood up to date."""

    name: str
    files: tuple[Path, ...]
    status: str


def scene_config(scene: str, configs: Path) -> Path | str:
    """The config of ``scene`` in the folder ``configs`` when there is one, else the packaged scene's name."""
    for suffix in (".yaml", ".yml", ".toml"):
        path = configs / f"{scene}{suffix}"
        if path.is_file():
            return path
    return scene


def _source(panels: Sequence[Drawable], runs: Sequence[RunResult]) -> str:
    """What the figure was made from and with; an equal text means equal pictures."""
    return json.dumps(
        {
            "figure": fingerprint(draw, *(type(panel).paint for panel in panels), compiled=False),
            "style": STYLE.read_text(encoding="utf-8"),
            "panels": repr(tuple(panels)),
            "runs": [[run.stored.manifest[key] for key in ("digest", "code")] for run in runs],
            "topcli": __version__,
        }
    )


def write_figure(
    name: str,
    panels: Sequence[Drawable],
    data: Mapping[str, np.ndarray],
    out: Path,
    formats: Sequence[str] = IMAGE_FORMATS,
    metadata: Mapping[str, str] | None = None,
) -> tuple[Path, ...]:
    """Draw ``panels`` over the columns of ``data`` and write pictures and data into ``out``; the paths written.

    Raises RunError when they cannot be written.
    """
    data_path = out / f"{name}.parquet"
    pictures = [out / f"{name}.{suffix}" for suffix in formats]
    try:
        out.mkdir(parents=True, exist_ok=True)
        data_path.unlink(missing_ok=True)  # written last: it vouches for the pictures
        figure = draw(panels, data)
        for path in pictures:
            write_whole(path, lambda temporary: save(figure, temporary))
        write_whole(data_path, lambda temporary: write_parquet(temporary, data, metadata or {}))
    except OSError as error:
        raise io_failure(error, out, "the figure was not drawn") from error
    return (*pictures, data_path)


def _run(
    spec: FigureSpec,
    scene: str,
    columns: list[str],
    results: Path,
    configs: Path,
    force: bool,
    progress: Progress,
    told: Callable[[str], None],
) -> tuple[RunResult, Drawn]:
    """The finished run of ``scene`` with the ``columns``, made where it is missing. Raises UsageError and RunError."""
    experiment = load_experiment(scene_config(scene, configs))
    missing = [name for name in columns if experiment.output.columns and name not in experiment.output.columns]
    if missing:
        raise UsageError(f"{spec.name}: the config of {scene} does not record {', '.join(missing)}")
    run = run_experiment(experiment, results, force=force, progress=progress)
    if run.set_aside:
        told(f"kept the earlier, different run as {run.set_aside}")
    if run.outcome is not Outcome.COMPLETED:
        raise RunError(f"{spec.name}: the run {run.stored.folder} {run.report['message']}")
    packaged = load_experiment(scene)
    return run, Drawn(experiment, (experiment.top, experiment.y0) == (packaged.top, packaged.y0))


def _of_runs(panels: Sequence[Drawable], runs: Runs) -> tuple[Drawable, ...]:
    """The panels with titles, labels and parameters of the runs that they draw."""
    return tuple(panel.of_runs(runs) if isinstance(panel, Panel | Polhodes | Sphere) else panel for panel in panels)


def _make_studied(spec: FigureSpec, study: Study, out: Path, formats: Sequence[str], force: bool) -> MadeFigure:
    """Make a figure whose columns are a study's."""
    pictures = [out / f"{spec.name}.{suffix}" for suffix in formats]
    data_path = out / f"{spec.name}.parquet"
    source = _source(spec.panels, []) + study.code()
    if not force and all(path.is_file() for path in pictures) and read_metadata(data_path).get(SOURCE) == source:
        return MadeFigure(spec.name, (*pictures, data_path), "up to date")
    files = write_figure(spec.name, spec.panels, study.columns(), out, formats, {SOURCE: source})
    return MadeFigure(spec.name, files, "drawn")


def _make_measured(
    spec: FigureSpec, measured: Measured, out: Path, results: Path, formats: Sequence[str], force: bool
) -> MadeFigure:
    """The figure of what has been measured. Raises UsageError where there is nothing, and RunError."""
    panels, data, made_from = measured(results)
    source = json.dumps(
        [fingerprint(draw, *(type(panel).paint for panel in panels), compiled=False), repr(panels), made_from]
    )
    files = [*(out / f"{spec.name}.{suffix}" for suffix in formats), out / f"{spec.name}.parquet"]
    if not force and all(path.is_file() for path in files) and read_metadata(files[-1]).get(SOURCE) == source:
        return MadeFigure(spec.name, tuple(files), "up to date")
    return MadeFigure(spec.name, write_figure(spec.name, panels, data, out, formats, {SOURCE: source}), "drawn")


def make_figure(
    spec: FigureSpec,
    *,
    out: Path,
    results: Path,
    configs: Path,
    formats: Sequence[str] = IMAGE_FORMATS,
    force: bool = False,
    progress: Progress = lambda done, total: None,
    told: Callable[[str], None] = lambda line: None,
) -> MadeFigure:
    """Make one figure into the folder ``out``: ``<name>.png``, ``.pdf`` and the plotted data as ``.parquet``.

    Its runs are read from ``results``, and made there when missing; a different run that stands there is refused
    unless ``force``. Nothing is drawn again when data, drawing code and style are what they were.
    ``told`` receives lines of talk. Raises UsageError and RunError.
    """
    require_writable(out)
    if spec.study:
        return _make_studied(spec, spec.study, out, formats, force)
    if spec.measured is not None:
        return _make_measured(spec, spec.measured, out, results, formats, force)
    runs, drawn = [], {}
    for scene, columns in spec.sources.items():
        run, about = _run(spec, scene, list(columns), results, configs, force, progress, told)
        runs.append(run)
        drawn |= dict.fromkeys(columns.values(), about)
    panels = _of_runs(spec.panels, drawn)
    data_path = out / f"{spec.name}.parquet"
    pictures = [out / f"{spec.name}.{suffix}" for suffix in formats]
    source = _source(panels, runs)
    if not force and all(path.is_file() for path in pictures) and read_metadata(data_path).get(SOURCE) == source:
        return MadeFigure(spec.name, (*pictures, data_path), "up to date")
    data: dict[str, np.ndarray] = {}
    for run, columns in zip(runs, spec.sources.values(), strict=True):
        series = read_series(run.stored.series, list(columns))
        data |= {name: series[column] for column, name in columns.items()}
    rows = max(map(len, data.values()))
    data = {name: np.append(values, np.full(rows - len(values), np.nan)) for name, values in data.items()}
    files = write_figure(spec.name, panels, data, out, formats, {SOURCE: source})
    return MadeFigure(spec.name, files, "drawn")
