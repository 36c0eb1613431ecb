"""Make figures: load them, draw those that are not up to date, write data and pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topcli import __version__
from topcli.engine.fingerprint import fingerprint
from topcli.errors import TopcliError, UsageError, clipped
from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.picture import DEFAULT_FORMATS, STYLE, draw, save
from topcli.store.run_folder import io_failure, require_writable, write_whole
from topcli.store.series import read_metadata, write_parquet

SOURCE = "topcli.figure.source"


@dataclass(frozen=True)
class MadeFigure:
    """Files of a figure, and its ``status``: ``drawn`` or ``up to date``."""

    name: str
    files: tuple[Path, ...]
    status: str


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


def _files(name: str, out: Path, formats: Sequence[str]) -> tuple[Path, ...]:
    """Paths of the pictures, then of the plotted data."""
    return tuple(out / f"{name}.{suffix}" for suffix in (*formats, "parquet"))


def _padded(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of equal length, with nan after the end of shorter ones."""
    rows = max(map(len, columns.values()))
    return {name: np.append(values, np.full(rows - len(values), np.nan)) for name, values in columns.items()}


def write_figure(
    name: str,
    loaded: Loaded,
    out: Path,
    formats: Sequence[str] = DEFAULT_FORMATS,
    style: Mapping[str, Any] | None = None,
) -> tuple[Path, ...]:
    """Draw a loaded figure, write pictures and data into ``out``, and return their paths.

    Raises RunError if they cannot be written.
    """
    style = style or {}
    write = partial(save, style=style) if style else save
    *pictures, data_path = files = _files(name, out, formats)
    data = _padded(loaded.data())
    metadata = {SOURCE: _source(loaded, style), **loaded.metadata}
    try:
        out.mkdir(parents=True, exist_ok=True)
        data_path.unlink(missing_ok=True)  # written last: it vouches for the pictures
        figure = draw(loaded.panels, data, loaded.layout, style)
        for path in pictures:
            write_whole(path, lambda temporary: write(figure, temporary))
        write_whole(data_path, lambda temporary: write_parquet(temporary, data, metadata))
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
    existing = all(path.is_file() for path in files)
    if existing and not request.force and read_metadata(files[-1]).get(SOURCE) == _source(loaded, request.style):
        return MadeFigure(name, files, "up to date")
    return MadeFigure(name, write_figure(name, loaded, out, formats, request.style), "drawn")
