"""Report of a study: plain values, computed once, which every surface renders.

A study is a function in a module of this folder, named in ``STUDIES``, which returns a ``Report``:

1. ``order(*schemes, config=..., overrides=(), ..., watch=SILENT) -> Report``. Positional parameters are arguments of
   the command, keyword-only ones its options (``max_steps`` is ``--max-steps``; ``overrides`` is always ``--set``).
   The command reads names, types and defaults from the signature, and the help, the first sentence about each
   parameter, from the NumPy docstring; options with one name have the same help in all commands. ``topcli.order`` is
   this function itself.
2. Rows of a ``Table`` are plain dicts with all digits: a key is the name in DataFrames and, with spaces for
   underscores, the heading. ``formats`` shows a column otherwise than with three digits; ``detail`` names columns, or
   is True for a table, that a terminal shows only with ``--verbose``. A new column is a new key.
3. ``answer`` is the sentence to quote; ``notes`` explain; ``errors`` are faults, with the exit ``code``.
4. ``draw(axes, looks)`` draws ``columns`` with matplotlib's axes, without importing it; ``looks(labels)`` gives the
   styles of lines by label.
5. Call ``watch.begin(name, experiment)`` after all checks of arguments, then ``watch(done, total)``.

Nothing of a stored report is computed again: its JSON has the cells of the tables and the picture.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.errors import ExitCode, RunError, UsageError, printable
from topcli.table import Table, plain

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

_Draw = Callable[..., None]
PICTURES = (".png", ".pdf", ".svg")
TABLES = (".csv", ".md", ".tex")
"""Endings of the names of files of pictures and of tables."""
SIZE = (6.4, 3.6)
"""Width and height of a picture in inches."""
_KEYS = ("command", "title", "answer", "notes", "errors", "code", "config")


@dataclass(frozen=True, repr=False)
class Report:
    """Result of a study.

    Attributes
    ----------
    command : str
        Name of the study.
    title : str
        What was measured, in a line.
    answer : str
        Sentence that answers the question of the study.
    tables : sequence of Table
        Tables; the first is the main one.
    notes, errors : sequence of str
        Explanations, and messages about what failed or is false.
    code : int
        Exit code of the command.
    config : mapping
        Resolved config of the experiment.
    columns : mapping of str to ndarray
        Data of the picture.
    draw : callable, optional
        ``draw(axes, looks)`` draws into the axes of matplotlib; ``looks(labels, markers=False)`` are the styles of
        lines by label, those of schemes the same in all pictures. Lines with labels get a legend.
    """

    command: str
    title: str
    answer: str = ""
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    errors: Sequence[str] = ()
    code: int = ExitCode.SUCCESS
    config: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, Any] = field(default_factory=dict)
    draw: _Draw | None = None

    @property
    def table(self) -> pd.DataFrame:
        """Main table as a DataFrame."""
        return self.tables[0].frame()

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON, as the option ``--json`` of the command prints it."""
        tables = [table.as_dict() for table in self.tables]
        return {"schema_version": 1, **{key: plain(getattr(self, key)) for key in _KEYS}, "tables": tables}

    def record(self) -> dict[str, Any]:
        """Everything that a page shows: plain data, the picture as SVG (None without one), and the environment."""
        from topcli.store.provenance import environment

        try:
            picture = self.picture("svg").decode()
        except UsageError:
            picture = None
        return {**Report.as_dict(self), **self.as_dict(), "picture": picture, "environment": environment()}

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the report into ``ax`` and return the axes; without ``ax``, make new axes in the style of topcli.

        Raises UsageError if there is no picture.
        """
        from topcli.figures.figure import on_axes

        return on_axes(self._draw, ax, SIZE)

    def picture(self, form: str) -> bytes:
        """Picture as a file in a format, "png", "pdf" or "svg". Raises UsageError if there is none."""
        from topcli.figures.figure import picture_of

        return picture_of(lambda canvas: self._draw(canvas.add_subplot()), SIZE, form)

    def _draw(self, axes: Any) -> None:
        """Draw into axes; lines with labels get a legend beside them."""
        from topcli.figures.style import looks

        if self.draw is None:
            raise UsageError(f"this result of topcli {self.command} has no picture; see its tables")
        self.draw(axes, looks)
        if axes.get_legend() is None and len(axes.get_legend_handles_labels()[1]) > 1:
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), fontsize="small")

    def _text(self, form: str) -> str:
        return "\n".join(table.text(form) for table in self.tables if table.rows)

    def save(self, path: str | Path) -> Path:
        """Write the report to a file; an existing file is overwritten.

        Parameters
        ----------
        path : path or str
            Name of the file. Its ending chooses the content: ``.json`` everything, for ``topcli report``; ``.html`` the
            page; ``.csv`` the main table with all digits; ``.md`` or ``.tex`` the tables as shown; ``.png``, ``.pdf``
            or ``.svg`` the picture.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        UsageError
            If the name has another ending, if there is no picture, or if the folder cannot be written to.
        RunError
            If writing fails; then no partial file is left.
        """
        from topcli.store.files import sealed_text, write_by_ending
        from topcli.studies.page import page_of

        texts = {
            ".json": lambda: sealed_text(self.record()),
            ".html": lambda: page_of([self.record()]),
            ".csv": lambda: str(self.table.to_csv(lineterminator="\n")),
            ".md": lambda: self._text("markdown"),
            ".tex": lambda: self._text("latex"),
        }
        pictures = {ending: partial(self.picture, ending[1:]) for ending in PICTURES}
        return write_by_ending(path, texts | pictures)

    def __repr__(self) -> str:
        return f"<Report of {self.command}: {self.answer or self.title}>"

    def _repr_html_(self) -> str:
        """Title, answer and main table for a notebook."""
        import pandas as pd

        cells = self.tables[0].cells()
        head = "<br>".join(escape(printable(line)) for line in (self.title, self.answer) if line)
        return f"<p>{head}</p>" + pd.DataFrame(cells.lines, columns=list(cells.header)).to_html(index=False)


def read_record(path: Path) -> dict[str, Any]:
    """Stored ``Report.record`` in a JSON file. Raises UsageError for any other file, and RunError for a changed one."""
    from topcli.store.files import SEAL, DamagedError, check_seal, read_json

    try:
        record = read_json(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from None
    except DamagedError as error:
        raise UsageError(f"{path}: not a result of a study: {error}") from None
    if missing := {*_KEYS, "tables", "picture", "environment"} - record.keys():
        raise UsageError(f"{path}: not a result that this version of topcli writes ({min(missing)} is missing)")
    if SEAL in record:
        try:
            check_seal(record)
        except DamagedError as error:
            raise RunError(f"{path}: damaged: {error}") from None
    return record
