"""Results of commands in Python: tables, plots on the caller's axes, files, and HTML for notebooks.

The Python function of a study has the parameters of the study's ``measure`` and returns a ``StudyReport``.
``topcli.motion`` needs only a top and a state.
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
    """Base class of the reports that ``topcli.run``, ``topcli.compare`` and similar functions return.

    Attributes
    ----------
    table : pandas.DataFrame
        The main table of the command, with all digits of its numbers.
    """

    @property
    @abstractmethod
    def table(self) -> pd.DataFrame:
        """Main table of the report as a DataFrame."""

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON, as the option ``--json`` of the command prints it."""

    @abstractmethod
    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the report into ``ax`` and return the axes; without ``ax``, make new axes."""

    @abstractmethod
    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page; ``name`` is unique within the page; with None, it has no pictures."""

    def save(self, path: str | Path) -> Path:
        """Write the report to a file; an existing file is overwritten.

        If writing fails, no partial file is left, and an existing file stays as it was.

        Parameters
        ----------
        path : path or str
            Name of the file. Its ending chooses the content: ``.html`` gives the page that ``topcli report`` writes,
            ``.json`` the plain data, ``.csv`` or ``.parquet`` the main table, and ``.png``, ``.pdf`` or ``.svg`` the
            plot.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        UsageError
            If the name has another ending, or if the folder of the file cannot be written to.
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
    """Draw ``panel`` into ``ax`` in the style of its owner; into new axes in the style of topcli's figures.

    A three-dimensional picture replaces two-dimensional axes by others at their place.
    """
    own, projection = ax is None, getattr(panel, "projection", None)
    with styled() if own else nullcontext():
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.figure(figsize=_WIDTH).add_subplot(projection=projection)
        elif projection and ax.name != projection:
            figure, place, box = ax.figure, ax.get_subplotspec(), ax.get_position().bounds
            ax.remove()
            of = {"projection": projection}
            ax = figure.add_subplot(place, **of) if place else figure.add_axes(box, **of)
        panel.paint(ax, data, defaultdict(dict, {REFERENCE: REFERENCE_LOOK}))
        texts = ax.get_legend_handles_labels()[1]
        if len(texts) > 1 and ax.get_legend() is None:
            ax.legend()
    return ax


@dataclass(frozen=True, repr=False)
class StudyReport(Report):
    """Result of a study, as returned by ``topcli.compare``, ``topcli.order`` and the functions of other studies.

    Attributes
    ----------
    declaration : Study
        Description of the study: its name, tables, notes and figure.
    result : Result
        The measured data.
    study : dict
        The measured data as plain data, ready for JSON.
    table : pandas.DataFrame
        The main table. Each further table is an attribute with the name of the table, such as ``errors`` in a report
        of ``topcli.order``.
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
        """Return plain data, ready for JSON, in the form that ``topcli report`` reads."""
        return self.declaration.as_dict(self.result)

    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page; ``name`` is unique within the page; with None, it has no pictures."""
        from topcli.pages.studies import study_chapter

        return study_chapter(self.declaration, self.result, name)

    def plot(self, ax: Axes | None = None, **options: Any) -> Axes:
        """Draw the result into ``ax`` and return the axes; without ``ax``, make new axes. Some studies take options."""
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


def _refuse_lists(name: str, bound: inspect.BoundArguments) -> None:
    """Raise UsageError for a list, such as overrides in the wrong place, where a study takes no sequence."""
    for key, value in bound.arguments.items():
        parameter = bound.signature.parameters[key]
        values = value if parameter.kind is inspect.Parameter.VAR_POSITIONAL else [value]
        if "Sequence" not in str(parameter.annotation) and any(isinstance(each, list | tuple) for each in values):
            raise UsageError(
                f"topcli.{name}: {key}: a list is not expected here; KEY=VALUE texts go to overrides=[...]"
            )


@cache
def function(name: str) -> Callable[..., StudyReport]:
    """Return the Python function of the study called ``name``: ``measure``, with a progress bar."""
    study = find_study(name)
    signature = inspect.signature(study.measure, eval_str=True)

    def call(*arguments: Any, progress: bool = True, **options: Any) -> StudyReport:
        _refuse_lists(name, signature.bind(*arguments, **options))
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
    """Exact motion from an initial state, as returned by ``topcli.motion``.

    Attributes
    ----------
    experiment : Experiment
        Experiment of the config, of which only the top and the initial state matter.
    table : pandas.DataFrame
        Value and meaning of each quantity, indexed by the name of the quantity.
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

        The picture depends on the top. For the Kowalevski top, the picture shows the place of the integrals of the
        motion in the bifurcation diagram. For the Euler top, it shows the polhode (the path of omega in the body) on
        the energy ellipsoid. For the Lagrange top, it shows the path of the symmetry axis on the unit sphere. For other
        tops, it shows the components of the state over time.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into. By default, new axes are made. The pictures of the Euler and the Lagrange top are
            three-dimensional; for them, two-dimensional axes are replaced by three-dimensional ones at their place.

        Returns
        -------
        matplotlib Axes
            The axes of the picture.

        Raises
        ------
        RunError
            If the motion is too fast to be integrated for the picture.
        """
        from topcli.analysis.motion.of_top import closed_form_top
        from topcli.figures.motion import motion_drawn

        return draw_panel(*motion_drawn(closed_form_top(self.experiment.top), self, self.experiment.name), ax)


def motion(
    config: str | Path | Mapping[str, Any] | None = None, overrides: Sequence[str] = (), **changes: Any
) -> MotionReport:
    """Return the class, the frequencies and the periods of an exact motion.

    All results follow from the initial state and the closed form of the motion. Nothing is integrated, so the scheme,
    ``h`` and ``N`` of the config do not matter. All quantities are dimensionless, as in configs.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file, name of a scene (a packaged config), or the content of a config, as for ``topcli.simulate``. The
        keys ``top`` and ``initial`` are enough.
    overrides : sequence of str
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line. They are applied
        after ``changes``.
    **changes
        Values that replace whole top-level keys of the config.

    Returns
    -------
    MotionReport
        For the Kowalevski top, the report gives the class of the torus, its frequencies and periods, and the distance
        to the nearest separatrix. For the Euler top, the report gives the class and the period of the polhode. For the
        Lagrange top, it gives nutation and precession. For a top without a closed form, the report gives only the
        integrals.

    Raises
    ------
    ConfigError
        If the config cannot be read, is invalid, or describes an ensemble or a sweep.
    UnknownNameError
        If no scene has the given name.

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
