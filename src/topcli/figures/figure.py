"""Type of a figure, and the drawing of figures that are not up to date, several at once."""

from __future__ import annotations

import hashlib
import json
import multiprocessing as mp
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli import __version__
from topcli.engine.fingerprint import fingerprint
from topcli.errors import ExitCode, RunError, TopcliError, UsageError, clipped
from topcli.figures.picture import DEFAULT_FORMATS, IMAGE_FORMATS, Drawable, Grid, draw, overlay_column, save
from topcli.figures.style import STYLE
from topcli.runs.identity import method_fingerprint
from topcli.schemes.registry import load_plugin_file, loaded_plugin_files
from topcli.store.files import io_failure, require_new, require_writable, write_whole
from topcli.store.series import read_metadata, write_parquet
from topcli.studies import imported

if TYPE_CHECKING:
    from topcli.config.models import Experiment

SOURCE = "topcli.figure.source"
STOP_SECONDS = 10.0
"""Time that an interrupted process has to leave its run in order."""
PROGRESS_SECONDS = 0.2
"""Shortest time between two reports of progress from a process."""
_MODULES = ("catalogue", "comparison", "growth", "motion", "period", "torus")
PRELOADED = ("topcli.runs.run", *(f"topcli.figures.{name}" for name in _MODULES))
"""Modules that all processes share."""

OnProgress = Callable[[str, int, int], None]
"""Function called with the name of a figure, and the parts of its data that are done and all of them."""


class NothingMeasuredError(UsageError):
    """Figure of measurements that have not been made yet; the exit code is 2."""


def ignored(*news: object) -> None:
    """Ignore progress or a message."""


@dataclass(frozen=True)
class Request:
    """Request for a figure: folders of results and configs, and options.

    With ``force``, existing results are computed again. ``overrides`` are texts
    ``key=value`` for the configs of the drawn runs. With ``overlay``, the exact motion is drawn behind these runs. The
    parameters of matplotlib in ``style`` replace those of the print style.
    """

    results: Path = Path("results")
    configs: Path = Path("configs")
    force: bool = False
    on_progress: Callable[[int, int], None] = ignored
    on_message: Callable[[str], None] = ignored
    overrides: tuple[str, ...] = ()
    overlay: bool = False
    style: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Loaded:
    """Content of a figure.

    ``source`` is plain data that identifies the results in the figure. ``data()`` returns the columns of the data file,
    some of which may be added while the panels are drawn; it is called only if the figure must be drawn. ``metadata``
    is stored with the plotted data. ``variant`` distinguishes the files of a figure that overrides have changed.
    """

    panels: Sequence[Drawable]
    data: Callable[[], Mapping[str, np.ndarray]]
    source: Mapping[str, Any]
    layout: Grid = field(default_factory=Grid)
    metadata: Mapping[str, str] = field(default_factory=dict)
    variant: str = ""


def study_digest(study: Mapping[str, Any]) -> str:
    """Digest of the plain data of a study."""
    return hashlib.sha256(json.dumps(study).encode()).hexdigest()


@dataclass(frozen=True)
class Figure:
    """A figure.

    Attributes
    ----------
    name : str
        Name on the command line and of the files.
    title : str
        Description in one line.
    scene : str
        Scene or command that the results come from.
    load : callable
        Function of a ``Request`` that returns panels, data and source; it raises UsageError and RunError.
    needs : tuple of str
        Stored results that it reads or makes, which no other process may make at the same time.
    rank : int
        When it begins among several: 0 for the paper's figures, 1 for those that take longest.
    takes_overrides, takes_overlay : bool
        Whether ``Request.overrides`` and ``Request.overlay`` have a meaning.
    origin : str
        Distribution or file that registered the figure. Those of plugins are drawn in the process that loaded them.
    """

    name: str
    title: str
    scene: str
    load: Callable[[Request], Loaded]
    needs: tuple[str, ...] = ()
    rank: int = 2
    takes_overrides: bool = False
    takes_overlay: bool = False
    origin: str = "topcli"


@dataclass(frozen=True)
class MadeFigure:
    """Files of a figure, and its ``status``: ``drawn`` or ``up to date``."""

    name: str
    files: tuple[Path, ...]
    status: str


def deferred(place: str) -> Callable[[Request], Loaded]:
    """The function ``module:name`` of this package, imported when it is called."""
    return partial(_call, place)


def _call(place: str, request: Request) -> Loaded:
    return imported(f"topcli.figures.{place}")(request)


def _source(loaded: Loaded, style: Mapping[str, Any]) -> str:
    """Text that identifies data, panels, style and drawing code: equal texts mean equal pictures."""
    painting = dict.fromkeys([type(loaded.layout), *map(type, loaded.panels)])
    return json.dumps(
        {
            "figure": fingerprint(draw, *painting, compiled=False),
            "style": [STYLE.read_text(encoding="utf-8"), repr(sorted(style.items()))],
            "panels": repr((tuple(loaded.panels), loaded.layout)),
            "topcli": __version__,
            **loaded.source,
        }
    )


def code_of(experiments: Iterable[Experiment], functions: Iterable[Callable[..., Any]], *settings: object) -> str:
    """Digest of everything that columns depend on which ``functions`` make of the motions of ``experiments``."""
    digests = [method_fingerprint(each.method()) + each.digest for each in experiments]
    return fingerprint(*functions, compiled=False) + "".join(digests) + repr(settings)


def _files(name: str, out: Path, formats: Sequence[str]) -> tuple[Path, ...]:
    """Paths of the pictures, then of the plotted data."""
    return tuple(out / f"{name}.{suffix}" for suffix in (*formats, "parquet"))


def _padded(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of equal length, with nan after the end of shorter ones; those of the exact motion are last."""
    rows = max(map(len, columns.values()))
    names = sorted(columns, key=lambda name: name.startswith(overlay_column("")))
    return {name: np.append(columns[name], np.full(rows - len(columns[name]), np.nan)) for name in names}


def write_figure(
    name: str,
    loaded: Loaded,
    out: Path,
    formats: Sequence[str] = DEFAULT_FORMATS,
    style: Mapping[str, Any] | None = None,
    force: bool = True,
) -> tuple[Path, ...]:
    """Draw a loaded figure, write pictures and data into ``out``, and return their paths.

    Raises UsageError if files exist that show another figure, unless ``force``, and RunError if they cannot be written.
    """
    style = style or {}
    write = partial(save, style=style) if style else save
    *pictures, data_path = files = _files(name, out, formats)
    drawn = read_metadata(data_path).get(SOURCE)
    other = drawn != _source(loaded, style)
    if other and not force:
        require_new(files)
    data = loaded.data()
    data = _padded(data) if data else data  # the columns of runs are read when they are drawn
    metadata = {SOURCE: _source(loaded, style), **loaded.metadata}
    try:
        out.mkdir(parents=True, exist_ok=True)
        figure = draw(loaded.panels, data, loaded.layout, style)
        data_path.unlink(missing_ok=True)  # written last: it vouches for the pictures
        for path in pictures:
            write_whole(path, lambda temporary: write(figure, temporary))
        write_whole(data_path, lambda temporary: write_parquet(temporary, _padded(data), metadata))
        for path in _files(name, out, IMAGE_FORMATS) if drawn and other else ():
            if path not in files:
                path.unlink(missing_ok=True)  # shows the earlier figure
    except OSError as error:
        raise io_failure(error, out, "the figure was not drawn") from error
    except (ValueError, TypeError, RuntimeError, MemoryError) as error:
        if not style or isinstance(error, TopcliError):
            raise
        reason = clipped(" ".join(str(error).split()))
        raise UsageError(f"{name}: cannot be drawn with this style: {reason}") from error
    return files


def make_figure(figure: Figure, request: Request, out: Path, formats: Sequence[str] = DEFAULT_FORMATS) -> MadeFigure:
    """Make one figure in the folder ``out``: ``<name>.png``, ``.pdf`` and the plotted data as ``.parquet``.

    With overrides that change a run, the name has six hexadecimal digits more that depend on them.
    A figure whose data, drawing code and style have not changed is not drawn again unless ``request.force``.
    Raises UsageError and RunError.
    """
    require_writable(out)
    loaded = figure.load(request)
    name = f"{figure.name}-{loaded.variant}" if loaded.variant else figure.name
    files = _files(name, out, formats)
    drawn = read_metadata(files[-1]).get(SOURCE)
    if not request.force and drawn is None:
        require_new(files)  # topcli did not draw them
    existing = all(path.is_file() for path in files)
    if existing and not request.force and drawn == _source(loaded, request.style):
        return MadeFigure(name, files, "up to date")
    return MadeFigure(name, write_figure(name, loaded, out, formats, request.style), "drawn")


def make_figures(
    figures: Sequence[Figure],
    request: Request,
    out: Path,
    formats: Sequence[str] = DEFAULT_FORMATS,
    jobs: int = 1,
    on_progress: OnProgress = lambda name, done, total: None,
) -> Generator[tuple[Figure, MadeFigure | TopcliError], None, None]:
    """Make figures as ``make_figure``, and yield each with its files, or with the error that it ended with.

    Several ``jobs`` are processes that draw one figure each; figures that need the same stored results are drawn one
    after the other. They begin in the order of their ``rank``. The processes end with the generator.
    """
    alone = len(figures) == 1 or jobs == 1
    here = figures if alone else [figure for figure in figures if figure.origin != "topcli"]
    for figure in here:
        on_progress(figure.name, 0, 1)
        watched = replace(request, on_progress=partial(on_progress, figure.name))
        try:
            yield figure, make_figure(figure, watched, out, formats)
        except TopcliError as error:
            yield figure, error
    if alone:
        return
    drawn = _Processes(request, out, tuple(formats), on_progress)
    waiting = sorted((figure for figure in figures if figure.origin == "topcli"), key=lambda figure: figure.rank)
    try:
        while waiting or drawn.running:
            for figure in list(waiting):
                if len(drawn.running) < jobs and drawn.are_free(figure.needs):
                    waiting.remove(figure)
                    drawn.start(figure)
            yield from drawn.ended()
    finally:
        drawn.stop()


class _Processes:
    """Processes that draw one figure each."""

    def __init__(self, request: Request, out: Path, formats: tuple[str, ...], on_progress: OnProgress) -> None:
        self.context = mp.get_context("forkserver")  # a thread of this process must not be forked
        self.context.set_forkserver_preload([*PRELOADED, "matplotlib.figure"])
        self.on_message, self.on_progress = request.on_message, on_progress
        silent = replace(request, on_progress=Request.on_progress, on_message=Request.on_message)
        plugins = tuple(Path(file.path).absolute() for file in loaded_plugin_files())
        self.arguments = (silent, out, formats, plugins)
        self.running: dict[Any, tuple[Figure, Any]] = {}

    def are_free(self, needs: Sequence[str]) -> bool:
        """True if no running process uses one of the stored results ``needs``."""
        return all(set(needs).isdisjoint(figure.needs) for figure, _ in self.running.values())

    def start(self, figure: Figure) -> None:
        """Start the process of a figure."""
        ours, theirs = self.context.Pipe(duplex=False)
        process = self.context.Process(target=_make_apart, args=(theirs, figure, *self.arguments), name=figure.name)
        process.start()
        theirs.close()
        self.running[ours] = figure, process
        self.on_progress(figure.name, 0, 1)

    def ended(self) -> Iterator[tuple[Figure, MadeFigure | TopcliError]]:
        """Wait for news, pass on progress and messages, and yield the figures whose processes have ended."""
        ready: list[Any] = wait(list(self.running))
        for pipe in ready:
            figure, process = self.running[pipe]
            try:
                news = pipe.recv()
            except EOFError:
                process.join()
                news = RunError(f"{figure.name}: its process ended with exit code {process.exitcode}")
            if isinstance(news, str):
                self.on_message(news)
            elif isinstance(news, tuple):
                self.on_progress(figure.name, *news)
            else:
                del self.running[pipe]
                process.join()
                yield figure, news

    def stop(self) -> None:
        """Interrupt the processes, and kill those that do not end."""
        processes = [process for _, process in self.running.values()]
        for process in processes:
            if process.is_alive():
                os.kill(process.pid, signal.SIGINT)
        for process in processes:
            process.join(STOP_SECONDS)
            process.kill()
            process.join()


def _make_apart(
    pipe: Connection, figure: Figure, request: Request, out: Path, formats: Sequence[str], plugins: Sequence[Path]
) -> None:
    """Make a figure in this process, and send messages, progress and the result, or the error, through ``pipe``."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background of a shell ignores it
    parent = mp.parent_process()
    assert parent is not None
    sentinel = parent.sentinel
    threading.Thread(target=lambda: (wait([sentinel]), os._exit(ExitCode.FAILED)), daemon=True).start()
    sent = time.monotonic()

    def progress(done: int, total: int) -> None:
        nonlocal sent
        if time.monotonic() - sent > PROGRESS_SECONDS:
            sent = time.monotonic()
            pipe.send((done, total))

    try:
        for path in plugins:
            load_plugin_file(path)
        pipe.send(make_figure(figure, replace(request, on_progress=progress, on_message=pipe.send), out, formats))
    except TopcliError as error:
        pipe.send(error)
    except KeyboardInterrupt:
        os._exit(ExitCode.INTERRUPTED)
