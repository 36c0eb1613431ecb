"""Results of commands in Python: a table, a plot on axes of the caller, files, and HTML for a notebook.

The function of a study has the parameters of its ``measure`` and returns a ``StudyReport``. ``topcli.motion`` needs
only a top and a state.
"""

from __future__ import annotations

import inspect
import json
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.motion import QUANTITIES, Motion
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.errors import UsageError, quoted
from topcli.figures.picture import Drawable
from topcli.figures.style import REFERENCE, REFERENCE_LOOK, styled
from topcli.show.progress import Progress
from topcli.store.files import io_failure, require_writable, write_whole
from topcli.studies import STUDIES, find_study, imported
from topcli.studies.study import Result, Study
from topcli.table import Table

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter


PICTURES = (".png", ".pdf", ".svg")
SUFFIXES = (".html", ".json", ".csv", ".parquet", *PICTURES)
"""Endings of the names of files that ``Report.save`` writes."""
_WIDTH = (6.4, 3.6)


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
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        from topcli.figures.picture import save

        with styled():
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
    own = ax is None
    with styled() if own else nullcontext():
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.subplots(figsize=_WIDTH)[1]
        panel.paint(ax, data, defaultdict(dict, {REFERENCE: REFERENCE_LOOK}))
        texts = ax.get_legend_handles_labels()[1]
        if len(texts) > 1 and ax.get_legend() is None:
            ax.legend()
    return ax


@dataclass(frozen=True, repr=False)
class StudyReport(Report):
    """Result of a study, as the function of its name returns it.

    Attributes
    ----------
    declaration : Study
        Name, tables, notes and figure of the study.
    result : Result
        What was measured.
    study : dict
        The same as ``as_dict()``.
    table : pandas.DataFrame
        The main table; further tables are attributes of their names, such as ``errors`` of ``topcli.order``.
    """

    declaration: Study
    result: Result

    def __getattr__(self, name: str) -> Any:
        """DataFrame of the table called ``name``, or another attribute that the study declares."""
        if not name.startswith("_"):
            if name in self.declaration.extras:
                return self.declaration.extras[name](self.result)
            if table := self._table(name):
                return table.frame(self.study)
        raise AttributeError(f"a report of {self.declaration.name!r} has no attribute {name!r}")

    @property
    def study(self) -> dict[str, Any]:
        """Everything that was measured, as ``--json`` prints it."""
        return self.result.data

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the main table."""
        main = self._table("table")
        assert main is not None
        return main.frame(self.study)

    def _table(self, name: str) -> Table | None:
        """Table of the result that is called ``name``."""
        tables = (*self.declaration.frames, *self.declaration.tables_of(self.study))
        return next((table for table in tables if table.name == name), None)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON; ``topcli report`` reads it."""
        return self.declaration.as_dict(self.result)

    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page; ``name`` is unique within the page, None leaves out pictures."""
        from topcli.pages.studies import study_chapter

        return study_chapter(self.declaration, self.result, name)

    def plot(self, ax: Axes | None = None, **options: Any) -> Axes:
        """Draw the result into ``ax``, by default new axes, and return the axes; some studies take ``options``."""
        if self.declaration.plotted:
            panel, data = imported(self.declaration.plotted)(self.result, **options)
            return draw_panel(panel, data, ax)
        if not self.declaration.figure:
            raise UsageError(f"plot: {self.declaration.name} has no picture; see its table")
        loaded = imported(self.declaration.figure)(self.result)
        return draw_panel(loaded.panels[0], loaded.data(), ax)


_WATCH = """watch : Watch, optional
        Observer of the study.
"""
_PROGRESS = """progress : bool, optional
        False to show no progress bar.
"""


@cache
def function(name: str) -> Callable[..., StudyReport]:
    """Return the Python function of the study called ``name``: ``measure``, with a progress bar."""
    study = find_study(name)

    def call(*arguments: Any, progress: bool = True, **options: Any) -> StudyReport:
        with Progress(study.name, progress, study.unit) as bar:
            return StudyReport(study, study.measure(*arguments, **options, watch=bar))

    parameters = inspect.signature(study.measure).parameters
    shown = inspect.Parameter("progress", inspect.Parameter.KEYWORD_ONLY, default=True, annotation="bool")
    kept = [shown if parameter.name == "watch" else parameter for parameter in parameters.values()]
    call.__signature__ = inspect.Signature(kept, return_annotation="StudyReport")  # pyright: ignore[reportFunctionMemberAccess]
    call.__name__ = call.__qualname__ = name
    call.__doc__ = (study.measure.__doc__ or "").replace(_WATCH, _PROGRESS)
    call.__module__ = study.measure.__module__
    return call


IRRELEVANT = {"scheme": "taylor", "h": 0.01}
"""Keys that a config needs and a motion does not."""


@dataclass(frozen=True, repr=False)
class MotionReport(Motion, Report):
    """Motion that an experiment starts, as ``topcli.motion`` returns it.

    Attributes
    ----------
    experiment : Experiment
        The experiment; only its top and its initial state matter.
    table : pandas.DataFrame
        A row for each quantity, indexed by its name: value and meaning.
    """

    experiment: Experiment = field(kw_only=True)

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the quantities, one row each, indexed by name."""
        return QUANTITIES.frame(self)

    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.studies import motion_chapter

        return motion_chapter(self, self.experiment, name)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the motion.

        That of the Kowalevski top is a place in the bifurcation diagram, that of the Euler top a polhode on the energy
        ellipsoid, that of the Lagrange top the trace of its axis on the sphere; other tops are drawn over time.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into; new ones by default.

        Returns
        -------
        matplotlib Axes
            The axes.

        Raises
        ------
        RunError
            If the motion is too fast to be followed for its picture.
        """
        from topcli.analysis.motion.of_top import closed_form_top
        from topcli.figures.motion import motion_drawn

        return draw_panel(*motion_drawn(closed_form_top(self.experiment.top), self, self.experiment.name), ax)


def motion(
    config: str | Path | Mapping[str, Any] | None = None, *, overrides: Sequence[str] = (), **changes: Any
) -> MotionReport:
    """Return class, frequencies and neighbourhood of the exact motion that an experiment starts.

    Everything follows from the closed form; nothing is integrated, and scheme, ``h`` and ``N`` do not matter. All
    quantities are dimensionless, as in configs.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file, name of a packaged scene, or the content of a config, as for ``topcli.simulate``;
        ``top`` and ``initial`` are enough.
    overrides : sequence of str
        Texts ``"key=value"`` as for ``--set`` on the command line; applied after the ``changes``.
    **changes
        Values that replace whole top-level keys of the config.

    Returns
    -------
    MotionReport
        For the Kowalevski top the class of the torus, its frequencies, periods and actions, and the nearest critical
        motions; for the Euler top the class and period of the polhode; for the Lagrange top nutation and precession.
        For a heavy top without a closed form the integrals only.

    Raises
    ------
    ConfigError
        If the config cannot be read, has a fault, or is an ensemble or a sweep.
    UnknownNameError
        If there is no such scene.

    Examples
    --------
    >>> import topcli
    >>> motion = topcli.motion("lagrange_cusps")
    >>> motion.title
    'nutation with cusps: the axis stops at one of the bounds'
    >>> round(motion["period.nutation"], 6)
    2.15473
    """
    if config is None or isinstance(config, Mapping):
        length = {} if "T" in {**(config or {}), **changes} else {"N": 1}
        config = {"name": "motion", **IRRELEVANT, **length, **(config or {})}
    from topcli.analysis.motion.of_top import motion_of

    experiment = load_experiment(config, overrides, changes, any_precision=True)
    plain = motion_of(experiment.top, experiment.y0)
    return MotionReport(**{entry.name: getattr(plain, entry.name) for entry in fields(plain)}, experiment=experiment)


def __getattr__(name: str) -> Callable[..., StudyReport]:
    """Python function of the study called ``name``."""
    if name not in STUDIES:
        raise AttributeError(name)
    return function(name)
