"""Type of a figure, and the drawing of figures that are not up to date."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.errors import UsageError
from topcli.figures.picture import DEFAULT_FORMATS, IMAGE_FORMATS, Drawable, Grid, draw, save
from topcli.schemes.plugins import SOURCES, is_built_in
from topcli.store.files import io_failure, require_new, require_writable, write_whole
from topcli.store.series import read_metadata, write_parquet
from topcli.store.sources import digest_of_texts, package_digest
from topcli.studies import imported

if TYPE_CHECKING:
    pass

SOURCE = "topcli.figure.source"


class NothingMeasuredError(UsageError):
    """Figure of measurements that have not been made yet; the exit code is 2."""


def ignored(*news: object) -> None:
    """Ignore progress or a message."""


@dataclass(frozen=True)
class Request:
    """Request for a figure: the folder of results, and options.

    With ``force``, existing results are computed again.
    """

    results: Path = Path("results")
    force: bool = False
    on_progress: Callable[[int, int], None] = ignored
    on_message: Callable[[str], None] = ignored


@dataclass(frozen=True)
class Loaded:
    """Content of a figure.

    ``source`` is plain data that identifies the results in the figure. ``data()`` returns the columns of the data file,
    some of which may be added while the panels are drawn; it is called only if the figure must be drawn. ``metadata``
    is stored with the plotted data.
    """

    panels: Sequence[Drawable]
    data: Callable[[], Mapping[str, np.ndarray]]
    source: Mapping[str, Any]
    layout: Grid = field(default_factory=Grid)
    metadata: Mapping[str, str] = field(default_factory=dict)


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
    origin : str
        Distribution or file that registered the figure.
    """

    name: str
    title: str
    scene: str
    load: Callable[[Request], Loaded]
    origin: str = "topcli"


@dataclass(frozen=True)
class MadeFigure:
    """Files of a figure, and its ``status``: ``drawn`` or ``up to date``."""

    name: str
    files: tuple[Path, ...]
    status: str


def deferred(place: str) -> Callable[[Request], Loaded]:
    """The function ``module:name`` of this package, imported when it is called."""
    return lambda request: imported(f"topcli.figures.{place}")(request)


def _source(loaded: Loaded) -> str:
    """Text that identifies data, panels and code, also of a plugin's panels: equal texts mean equal pictures."""
    painting = dict.fromkeys([type(loaded.layout), *map(type, loaded.panels)])
    own = () if all(map(is_built_in, painting)) else (text for texts in SOURCES.values() for text in texts.values())
    return json.dumps(
        {
            "code": package_digest() + digest_of_texts(own),
            "panels": repr((tuple(loaded.panels), loaded.layout)),
            **loaded.source,
        }
    )


def _files(name: str, out: Path, formats: Sequence[str]) -> tuple[Path, ...]:
    """Paths of the pictures, then of the plotted data."""
    return tuple(out / f"{name}.{suffix}" for suffix in (*formats, "parquet"))


def _padded(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of equal length, with nan after the end of shorter ones."""
    rows = max(map(len, columns.values()))
    return {name: np.append(values, np.full(rows - len(values), np.nan)) for name, values in columns.items()}


def write_figure(
    name: str, loaded: Loaded, out: Path, formats: Sequence[str] = DEFAULT_FORMATS, force: bool = True
) -> tuple[Path, ...]:
    """Draw a loaded figure, write pictures and data into ``out``, and return their paths.

    Raises UsageError if files exist that show another figure, unless ``force``, and RunError if they cannot be written.
    """
    *pictures, data_path = files = _files(name, out, formats)
    drawn = read_metadata(data_path).get(SOURCE)
    other = drawn != _source(loaded)
    if other and not force:
        require_new(files)
    data = loaded.data()
    data = _padded(data) if data else data  # the columns of runs are read when they are drawn
    metadata = {SOURCE: _source(loaded), **loaded.metadata}
    try:
        out.mkdir(parents=True, exist_ok=True)
        figure = draw(loaded.panels, data, loaded.layout)
        data_path.unlink(missing_ok=True)  # written last: it vouches for the pictures
        for path in pictures:
            write_whole(path, lambda temporary: save(figure, temporary))
        write_whole(data_path, lambda temporary: write_parquet(temporary, _padded(data), metadata))
        for path in _files(name, out, IMAGE_FORMATS) if drawn and other else ():
            if path not in files:
                path.unlink(missing_ok=True)  # shows the earlier figure
    except OSError as error:
        raise io_failure(error, out, "the figure was not drawn") from error
    return files


def make_figure(figure: Figure, request: Request, out: Path, formats: Sequence[str] = DEFAULT_FORMATS) -> MadeFigure:
    """Make one figure in the folder ``out``: ``<name>.png``, ``.pdf`` and the plotted data as ``.parquet``.

    A figure whose data, drawing code and style have not changed is not drawn again unless ``request.force``.
    Raises UsageError and RunError.
    """
    require_writable(out)
    loaded = figure.load(request)
    files = _files(figure.name, out, formats)
    drawn = read_metadata(files[-1]).get(SOURCE)
    if not request.force and drawn is None:
        require_new(files)  # topcli did not draw them
    existing = all(path.is_file() for path in files)
    if existing and not request.force and drawn == _source(loaded):
        return MadeFigure(figure.name, files, "up to date")
    return MadeFigure(figure.name, write_figure(figure.name, loaded, out, formats), "drawn")
