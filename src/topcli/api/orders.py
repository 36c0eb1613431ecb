"""``topcli.order``: errors over a ladder of step sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.api.progress import Progress
from topcli.api.report import Report, draw_panel
from topcli.studies.order import STEPS, ladders, order_study

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter

PLAIN = ("declared_order", "order", "verdict", "plateau", "onset", "ended", "broken")


@dataclass(frozen=True, repr=False)
class OrderReport(Report):
    """Observed orders of convergence, as ``topcli.order`` returns them.

    Attributes
    ----------
    study : dict
        Everything that was measured, as ``topcli order --json`` prints it.
    table : pandas.DataFrame
        A row for each scheme, indexed by its name: declared and observed order, the verdict on the declared one, level
        and onset of the plateau of round-off, smallest error and its step.
    """

    study: dict[str, Any]

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the schemes, one row each, indexed by name."""
        import pandas as pd

        rows = []
        for row in self.study["schemes"]:
            known = [one for one in row["points"] if one["error"] is not None]
            best = min(known, key=lambda one: one["error"], default={"error": None, "h": None})
            smallest = {"smallest_error": best["error"], "at_h": best["h"]}
            rows.append({"scheme": row["scheme"], **{key: row[key] for key in PLAIN}, **smallest})
        return pd.DataFrame(rows).set_index("scheme")

    @property
    def errors(self) -> pd.DataFrame:
        """DataFrame of the largest errors: a row for each step size h, a column for each scheme; nan where not run."""
        import pandas as pd

        each = {row["scheme"]: {one["h"]: one["error"] for one in row["points"]} for row in self.study["schemes"]}
        return pd.DataFrame(each, dtype=float).rename_axis("h").sort_index(ascending=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the study as plain data, ready for JSON."""
        return self.study

    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.studies import order_chapter

        return order_chapter(self.study, name)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the errors over h, with the observed orders in the legend.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into; new ones by default.

        Returns
        -------
        matplotlib Axes
            The axes.
        """
        from topcli.figures.order import loaded_order

        loaded = loaded_order(self.study, "")
        return draw_panel(loaded.panels[0], loaded.data(), ax)


def order(
    *schemes: str,
    top: str | None = None,
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    sizes: Sequence[float] = (),
    duration: float | None = None,
    steps: int = STEPS,
    progress: bool = True,
) -> OrderReport:
    """Measure errors over h, observed orders of convergence, and the plateau of round-off.

    Parameters
    ----------
    *schemes : str
        Names of schemes; six by default.
    top : str, optional
        Form of a top, whose packaged scene is run.
    config : path, str or mapping, optional
        Config, scene, or the content of a config that gives the top, the initial state and, by N*h, the duration.
    overrides : sequence of str, optional
        Texts ``"key=value"`` as for ``--set`` on the command line.
    sizes : sequence of float, optional
        Step sizes, dimensionless; by default a ladder for each scheme.
    duration : float, optional
        Length of a run in time; 10 by default, or that of the config.
    steps : int, optional
        Largest number of steps of a run on a ladder.
    progress : bool, optional
        False to show no progress bar.

    Returns
    -------
    OrderReport
        Errors are the largest Euclidean norms of the difference of states from a Taylor reference in double-double
        arithmetic at common times.

    Raises
    ------
    UsageError
        For an unknown or unfit scheme or top, or a step size out of range.
    RunError
        If the reference cannot follow the motion.

    Examples
    --------
    >>> import topcli
    >>> found = topcli.order("hk", "rk4", config="euler_hk", duration=2, sizes=[0.1, 0.05, 0.025])
    >>> found.table["order"].round(1).to_dict()
    {'hk': 2.0, 'rk4': 4.0}
    >>> found.errors.shape
    (3, 2)
    """
    what = ladders(schemes, top=top, config=config, sets=overrides, sizes=sizes, duration=duration, steps=steps)
    with Progress("order", progress, unit="schemes") as bar:
        return OrderReport(order_study(what, bar))
