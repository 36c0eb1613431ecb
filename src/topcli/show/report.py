"""Reports of stored results and of exact motions in Python: tables, plots on the caller's axes, files, notebooks.

``topcli.motion`` needs only a top and a state.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.analysis.motion import Motion, motion_table
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.figures.study import on_axes, picture
from topcli.store.files import json_text, write_by_ending
from topcli.studies.report import PICTURES, html_of
from topcli.table import Cells

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter


class ResultReport(ABC):
    """Base class of the reports that ``topcli.run``, ``topcli.sweep`` and ``topcli.motion`` return.

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
    def chapter(self) -> Chapter:
        """Return the chapter of a page."""

    @abstractmethod
    def cells(self) -> Cells:
        """Texts of the table that a notebook shows."""

    @property
    @abstractmethod
    def headline(self) -> str:
        """Subject and result of the report in a sentence."""

    def save(self, path: str | Path) -> Path:
        """Write the report to a file; an existing file is overwritten.

        If writing fails, no partial file is left, and an existing file stays as it was.

        Parameters
        ----------
        path : path or str
            Name of the file. Its ending chooses the content: ``.html`` gives the page that ``topcli report`` writes,
            ``.json`` the plain data, ``.csv`` the main table, and ``.png``, ``.pdf`` or ``.svg`` the plot.

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
        from topcli.pages.page import page_of

        contents: dict[str, Callable[[], str | bytes]] = {
            ".html": lambda: page_of([self.chapter()]).text,
            ".json": lambda: json_text(self.as_dict()),
            ".csv": lambda: str(self.table.to_csv()),
        }
        pictures = {ending: partial(picture, self.plot, ending[1:]) for ending in PICTURES}
        return write_by_ending(path, contents | pictures)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.headline}>"

    def _repr_html_(self) -> str:
        """Headline and main table for a notebook."""
        return html_of([self.headline], self.cells())


IRRELEVANT = {"scheme": "taylor", "h": 0.01}
"""Keys that a config needs and a motion does not."""


@dataclass(frozen=True, repr=False)
class MotionReport(Motion, ResultReport):
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
        return motion_table(self).frame()

    def cells(self) -> Cells:
        """Texts of the quantities."""
        return motion_table(self).cells()

    @property
    def headline(self) -> str:
        """Name of the config, and the class of the motion in words."""
        return f"{self.experiment.name}: {self.title}"

    def chapter(self) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.studies import motion_chapter

        return motion_chapter(self, self.experiment)

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
        from topcli.figures.motion import motion_drawing

        draw, projection = motion_drawing(closed_form_top(self.experiment.top), self, self.experiment.name)
        return on_axes(draw, ax, projection)


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
