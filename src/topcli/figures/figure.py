"""Type of a figure: a function that computes columns, a function that draws them, and the files of both."""

from __future__ import annotations

import inspect
import io
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.errors import UsageError
from topcli.figures.style import styled
from topcli.plugins import origin_of
from topcli.store.files import io_failure, require_new, require_writable, write_whole
from topcli.store.identity import digest_of_texts, package_digest
from topcli.store.series import read_metadata

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

Columns = Mapping[str, np.ndarray]
"""One-dimensional arrays by name; they may differ in length."""
Drawing = Callable[[Any], Any]
"""Function that draws into a matplotlib figure or axes."""
KEY = "topcli.figure"
IMAGE_FORMATS = ("png", "pdf", "svg")
DEFAULT_FORMATS = ("png", "pdf")


class NothingMeasuredError(UsageError):
    """Figure of measurements that have not been made yet; the exit code is 2."""


@dataclass(frozen=True)
class Figure:
    """A figure.

    Attributes
    ----------
    name : str
        Name on the command line and of the files.
    title : str
        Description in one line.
    data : callable
        Function without arguments that returns the columns; it raises UsageError and RunError.
    draw : callable
        Function that draws the columns into an empty matplotlib figure.
    size : (float, float)
        Width and height in inches.
    takes : callable
        Function that returns the digests of the stored results that ``data`` reads, as one text.
    origin : str
        Distribution or file that registered the figure.
    """

    name: str
    title: str
    data: Callable[[], Columns]
    draw: Callable[..., None]
    size: tuple[float, float] = (7.0, 2.9)
    takes: Callable[[], str] = str
    origin: str = "topcli"

    @property
    def key(self) -> str:
        """Digest of the code and the results behind the columns: equal keys mean equal columns."""
        module = Path(inspect.getfile(self.data)).read_text(encoding="utf-8")
        return digest_of_texts([package_digest(), module, self.takes()])

    def make(self, out: Path, formats: Sequence[str] = DEFAULT_FORMATS, force: bool = False) -> tuple[Path, ...]:
        """Write the pictures and the plotted columns, as Parquet, into ``out``; return their paths.

        Columns that are stored there under the same key are drawn again, without computing them. With other columns,
        earlier pictures in further formats are drawn again too. Raises UsageError for files that topcli did not draw,
        unless ``force``, and RunError if a file cannot be written.
        """
        require_writable(out)
        table = out / f"{self.name}.parquet"
        pictures = [out / f"{self.name}.{suffix}" for suffix in formats]
        stored = read_metadata(table).get(KEY)
        if stored is None and not force:
            require_new([*pictures, table])
        columns = None if force or stored != self.key else stored_columns(table)
        try:
            if columns is None:
                columns = self.data()
                write_whole(table, lambda path: write_columns(path, columns or {}, self.key))
                further = [out / f"{self.name}.{suffix}" for suffix in IMAGE_FORMATS if suffix not in formats]
                pictures += [path for path in further if stored is not None and path.exists()]
            canvas = canvas_of(lambda canvas: self.draw(canvas, columns), self.size)
            for picture in pictures:
                write_whole(picture, lambda path, form=picture.suffix[1:]: save(canvas, path, form))
        except OSError as error:
            raise io_failure(error, out, "the figure was not drawn") from error
        return (*pictures, table)


def write_columns(path: Path, columns: Columns, key: str) -> None:
    """Write columns as Parquet; shorter ones end in nulls."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = max(map(len, columns.values()))
    arrays = {name: pa.array(np.asarray(values)) for name, values in columns.items()}
    padded = {
        name: pa.chunked_array([values, pa.nulls(rows - len(values), values.type)]) for name, values in arrays.items()
    }
    pq.write_table(pa.table(padded).replace_schema_metadata({KEY: key}), path, compression="zstd")


def stored_columns(path: Path) -> dict[str, np.ndarray] | None:
    """Columns as they were written; None if the file is damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
        return {name: table[name].drop_null().to_numpy() for name in table.column_names}
    except (OSError, pa.ArrowException):
        return None


def canvas_of(draw: Drawing, size: tuple[float, float]) -> Canvas:
    """Return a matplotlib figure of ``size`` inches with what ``draw(canvas)`` draws, in the print style."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    with styled():
        canvas = Canvas(figsize=size)
        FigureCanvasAgg(canvas)
        draw(canvas)
    return canvas


def save(canvas: Canvas, target: Path | io.BytesIO, form: str) -> None:
    """Write the picture in a format, without a date, so that equal data gives equal files."""
    dates = {"pdf": ("CreationDate", "ModDate"), "svg": ("Date",)}.get(form, ())
    # a letter that no font has is drawn as a box, without a warning
    with warnings.catch_warnings(action="ignore"), styled({"svg.hashsalt": "topcli"}):
        canvas.savefig(target, format=form, metadata=dict.fromkeys(dates))


def picture_of(draw: Drawing, size: tuple[float, float], form: str) -> bytes:
    """Picture of what ``draw(canvas)`` draws in a format, "png", "pdf" or "svg"."""
    sink = io.BytesIO()
    save(canvas_of(draw, size), sink, form)
    return sink.getvalue()


def on_axes(draw: Drawing, ax: Axes | None, size: tuple[float, float]) -> Axes:
    """Draw into ``ax`` in the style of its owner, or into new axes in the print style."""
    with styled() if ax is None else nullcontext():
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.figure(figsize=size).add_subplot()
        draw(ax)
    return ax


FIGURES: dict[str, Figure] = {}


def figure(
    name: str,
    title: str,
    draw: Callable[[Any, Columns], None],
    size: tuple[float, float] = (7.0, 2.9),
    takes: Callable[[], str] = str,
) -> Callable[[Callable[[], Columns]], Callable[[], Columns]]:
    """Register the decorated function as the data of a figure of ``topcli plot``.

    Parameters
    ----------
    name : str
        Name of the figure and of its files, in lower case.
    title : str
        Description on one line.
    draw : callable
        Function ``draw(canvas, columns)`` that draws the columns into an empty ``matplotlib.figure.Figure``.
    size : (float, float), optional
        Width and height in inches.
    takes : callable, optional
        Function that returns a text that changes when stored results change that the data come from.

    Returns
    -------
    callable
        Decorator that registers the function and returns it unchanged. The decorated function takes no arguments and
        returns a dictionary of one-dimensional arrays, which is stored as Parquet beside the picture.

    Raises
    ------
    ValueError
        If there is already a figure with this name.
    """

    def register(data: Callable[[], Columns]) -> Callable[[], Columns]:
        if name in FIGURES:
            raise ValueError(f"figure {name!r} is already registered by {FIGURES[name].origin}")
        FIGURES[name] = Figure(name, title, data, draw, size, takes, origin=origin_of(data))
        return data

    return register
