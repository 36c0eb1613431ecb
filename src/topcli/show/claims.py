"""``topcli.claims``: the paper's claims, decided by experiments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from topcli.paper.decide import Claims, decide_claims
from topcli.paper.page import CLAIMS, claims_page
from topcli.show.progress import Progress
from topcli.show.report import Report, draw_panel

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter


@dataclass(frozen=True, repr=False)
class ClaimsReport(Claims, Report):
    """Claims of the paper and findings beyond it with their verdicts, as ``topcli.claims`` returns them.

    Attributes
    ----------
    rows : tuple of Decided
        The claims, in the order of the ledger.
    controls : tuple of CheckResult
        The positive control of each kind of check that was used.
    table : pandas.DataFrame
        A row for each claim, indexed by ``id``: origin (``paper`` or ``ours``), statement, source, experiment, figure,
        bound, verdict.
    """

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the claims, one row each, indexed by ``id``."""
        return CLAIMS.frame(self.as_dict())

    def to_markdown(self) -> str:
        """Page of the documentation with the claims."""
        return claims_page(self)

    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.studies import claims_chapter

        return claims_chapter(self.as_dict(), name)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the number of statements with each verdict, a bar for each part of the paper.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into; new ones by default.

        Returns
        -------
        matplotlib Axes
            The axes.
        """
        from topcli.figures.outcomes import verdict_panel

        return draw_panel(*verdict_panel(self.as_dict()["claims"]), ax)


def claims(ids: str | Sequence[str] = (), *, fast: bool = False, progress: bool = True) -> ClaimsReport:
    """Decide the claims of the paper, and findings beyond it, by experiments.

    Parameters
    ----------
    ids : str or sequence of str, optional
        Names of claims, such as ``"hybrid-reversible"``; all by default.
    fast : bool, optional
        True to leave out claims that take more than a few tenths of a second, unless they are named.
    progress : bool, optional
        False to show no progress bar.

    Returns
    -------
    ClaimsReport
        The claims with figures, bounds and verdicts, and the positive controls of the kinds of checks.

    Raises
    ------
    UnknownNameError
        If there is no such claim; the message names the nearest ones.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.claims(["hybrid-k-sq", "hybrid-reversible"])
    >>> report.table["verdict"].tolist()
    ['holds', 'does not hold as stated']
    >>> report.changed, report.uncaught
    ((), ())
    """
    with Progress("claims", progress, unit="checks") as bar:
        decided = decide_claims(ids, fast=fast, on_progress=bar)
    return ClaimsReport(decided.rows, decided.controls)
