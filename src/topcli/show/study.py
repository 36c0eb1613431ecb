"""The Python face of studies: a function with the parameters of ``measure``, and the report that it returns."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from topcli.errors import UsageError
from topcli.show.progress import Progress
from topcli.show.report import Report, draw_panel
from topcli.studies import STUDIES, find_study, imported
from topcli.studies.study import Result, Study
from topcli.table import Table

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter


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
        from topcli.pages.study import study_chapter

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
    call.__doc__ = (study.measure.__doc__ or "").replace(
        "watch : Watch, optional\n        Observer of the study.\n", _PROGRESS
    )
    call.__module__ = study.measure.__module__
    return call


def __getattr__(name: str) -> Callable[..., StudyReport]:
    """Python function of the study called ``name``."""
    if name not in STUDIES:
        raise AttributeError(name)
    return function(name)
