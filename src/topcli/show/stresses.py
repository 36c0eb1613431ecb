"""``topcli.stress``: schemes in hard cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from topcli.errors import UnknownNameError, nearest, quoted
from topcli.show.progress import Progress
from topcli.show.report import Report, draw_panel
from topcli.studies.stress.record import stress_data
from topcli.studies.stress.suite import chosen, require_options
from topcli.studies.stress.suite import stress as try_schemes

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter

COLUMNS = ("scheme", "top", "case", "outcome", "step", "verdict", "why", "limit", "seconds")


@dataclass(frozen=True, repr=False)
class StressReport(Report):
    """Outcomes of schemes in hard cases, as ``topcli.stress`` returns them.

    Attributes
    ----------
    study : dict
        Everything that was found, as ``topcli stress --json`` prints it.
    table : pandas.DataFrame
        A row for each trial: scheme, top, case, outcome, step, verdict, reason, declared limit, seconds.
    """

    study: dict[str, Any]

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the trials, one row each."""
        import pandas as pd

        return pd.DataFrame(self.study["trials"], columns=list(COLUMNS))

    @property
    def unexplained(self) -> pd.DataFrame:
        """Trials that broke without a declared limit, or held in spite of one, as DataFrame; empty if all is well."""
        return self.table.query("verdict in ['unexplained', 'outlived limit']")

    @property
    def tops(self) -> list[str]:
        """Tops of the trials, in their order."""
        return list(dict.fromkeys(one["top"] for one in self.study["trials"]))

    def grid(self, top: str | None = None) -> pd.DataFrame:
        """Return the outcomes of one top, by default the first: a row for each scheme, a column for each case.

        Raises UnknownNameError for another top.
        """
        wanted = self._top(top)
        mine = [one for one in self.study["trials"] if one["top"] == wanted]
        schemes, cases = (list(dict.fromkeys(one[key] for one in mine)) for key in ("scheme", "case"))
        shaped = self.table.query("top == @wanted").pivot(index="scheme", columns="case", values="outcome")
        return shaped.reindex(index=schemes, columns=cases)

    def _top(self, top: str | None) -> str:
        if top is None:
            return self.tops[0]
        if top not in self.tops:
            raise UnknownNameError(f"no trials of the top {quoted(top)}; {nearest(top, self.tops)}")
        return top

    def as_dict(self) -> dict[str, Any]:
        """Return the study as plain data, ready for JSON."""
        return self.study

    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.studies import stress_chapter

        return stress_chapter(self.study)

    def plot(self, ax: Axes | None = None, *, top: str | None = None) -> Axes:
        """Draw the outcomes of one top as shades: a row for each case, a column for each scheme.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into; new ones by default.
        top : str, optional
            Form of the top; by default the first one.

        Returns
        -------
        matplotlib Axes
            The axes.

        Raises
        ------
        UnknownNameError
            If the study has no trials of this top.
        """
        from topcli.figures.stress import StressPanel, figure_data

        wanted = self._top(top)
        data, names = figure_data(self.study)
        grid = self.grid(wanted)
        panel = StressPanel(wanted, tuple(grid.index), tuple(grid.columns), names)
        return draw_panel(panel, data, ax)


def stress(
    *schemes: str,
    cases: Sequence[str] = (),
    top: str | None = None,
    options: Mapping[str, Any] | None = None,
    progress: bool = True,
) -> StressReport:
    """Test schemes in hard cases and find what breaks.

    Parameters
    ----------
    *schemes : str
        Names of schemes; all by default.
    cases : sequence of str, optional
        Names of cases; all by default. ``topcli list cases`` shows them.
    top : str, optional
        Only schemes and cases of this top.
    options : mapping, optional
        Options for all schemes that have them.
    progress : bool, optional
        False to show no progress bar.

    Returns
    -------
    StressReport
        Outcome of each trial, and its verdict in view of the limits that the scheme declares.

    Raises
    ------
    UsageError
        For unknown schemes, cases, tops and options, or if nothing is left to try.

    Examples
    --------
    >>> import topcli
    >>> found = topcli.stress("hk", "dg4", cases=["delone", "pole"])
    >>> found.grid().loc["hk", "pole"]
    'held'
    >>> len(found.table), len(found.unexplained)
    (4, 0)
    """
    require_options(options or {}, chosen(schemes, cases, top)[0])
    with Progress("stress", progress, unit="trials") as bar:
        return StressReport(stress_data(try_schemes(schemes, cases, top, options, bar)))
