"""Base of the results of commands: a table, a plot on axes of the caller, files, and HTML for a notebook."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.errors import UsageError, quoted
from topcli.figures.picture import REFERENCE, STYLE, Drawable
from topcli.store.files import io_failure, require_writable, write_whole

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter

PICTURES = (".png", ".pdf", ".svg")
SUFFIXES = (".html", ".json", ".csv", ".parquet", *PICTURES)
"""Endings of the names of files that ``Report.save`` writes."""
_WIDTH = (6.4, 3.6)
_GREY = {"color": "0.75", "linewidth": 3.5, "linestyle": "-", "zorder": 1.5}


class Report(ABC):
    """Result of a command.

    Attributes
    ----------
    table : pandas.DataFrame
        The figures that the command prints, one row each, with all digits.
    """

    @property
    @abstractmethod
    def table(self) -> pd.DataFrame:
        """The figures of the report as a DataFrame."""

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON, as the option ``--json`` of the command prints it."""

    @abstractmethod
    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the report into ``ax``, by default new axes, and return the axes."""

    @abstractmethod
    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page; ``name`` is unique within the page, None leaves out pictures."""

    def save(self, path: str | Path) -> Path:
        """Write the report to a file, whole or not at all; an existing file is overwritten.

        Parameters
        ----------
        path : path or str
            File whose ending chooses what is written: ``.html`` the page of ``topcli report``, ``.json`` the plain
            data, ``.csv`` or ``.parquet`` the table, ``.png``, ``.pdf`` or ``.svg`` the plot.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        UsageError
            If the name has another ending, or its folder cannot be written.
        RunError
            If writing fails.
        """
        path = Path(path)
        if path.suffix.lower() not in SUFFIXES:
            raise UsageError(f"save: {quoted(path.name)}: unknown type of file; use {', '.join(SUFFIXES)}")
        require_writable(path.parent)
        try:
            write_whole(path, self._write)
        except OSError as error:
            raise io_failure(error, path, "nothing was written") from error
        return path

    def _write(self, path: Path) -> None:
        """Write the file in the format of its suffix."""
        match path.suffix.lower():
            case ".html":
                from topcli.pages.page import page_of

                path.write_text(page_of([self.chapter("part1")]).text, encoding="utf-8")
            case ".json":
                text = json.dumps(self.as_dict(), indent=1, ensure_ascii=False, allow_nan=False)
                path.write_text(text + "\n", encoding="utf-8")
            case ".csv":
                self.table.to_csv(path)
            case ".parquet":
                self.table.to_parquet(path)
            case _:
                self._picture(path)

    def _picture(self, path: Path) -> None:
        import matplotlib as mpl
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        from topcli.figures.picture import save

        with mpl.rc_context(fname=STYLE):
            figure = Figure(figsize=_WIDTH)
            FigureCanvasAgg(figure)
            self.plot(figure.add_subplot())
        save(figure, path)

    def __repr__(self) -> str:
        chapter = self.chapter(None)
        return f"<{type(self).__name__} of {chapter.title}: {chapter.message or chapter.state}>"

    def _repr_html_(self) -> str:
        """State and main table for a notebook, with everything escaped."""
        from topcli.pages.page import fragment

        return fragment(self.chapter(None))


def draw_panel(panel: Drawable, data: Mapping[str, np.ndarray], ax: Axes | None) -> Axes:
    """Draw ``panel`` into ``ax`` in the style of its owner; into new axes in the style of topcli's figures."""
    import matplotlib as mpl

    own = ax is None
    with mpl.rc_context(fname=STYLE) if own else nullcontext():
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.subplots(figsize=_WIDTH)[1]
        panel.paint(ax, data, defaultdict(dict, {REFERENCE: _GREY}))
        texts = ax.get_legend_handles_labels()[1]
        if len(texts) > 1 and ax.get_legend() is None:
            ax.legend()
    return ax
