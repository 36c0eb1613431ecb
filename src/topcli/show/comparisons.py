"""``topcli.compare``: one experiment or ensemble under several schemes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from topcli.config.duration import changed
from topcli.config.load import any_from, load_any
from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.errors import UsageError
from topcli.show.progress import Progress
from topcli.show.report import Report, draw_panel
from topcli.store.envelope import thinned
from topcli.studies.compare import Comparison, compare_schemes, comparison_document

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter

PAPER_SCENE = "kowalevski_hk"
PLAIN = ("scheme", "h", "N", "outcome", "message", "max_error", "end_error", "swing_spacing", "nanoseconds_per_step")
OF_INVARIANTS = ("max_deviation", "drift", "drift_error", "verdict")


@dataclass(frozen=True, repr=False)
class ComparisonReport(Report):
    """Comparison of schemes, as ``topcli.compare`` returns it.

    Attributes
    ----------
    figures : dict
        Everything that was measured, as ``topcli compare --json`` prints it.
    arrays : dict of str to ndarray, shape (m,)
        Compared times ``t``, and for each entry ``error:<label>`` and ``swing:<label>``, the latter also for
        ``reference``; nan after a blow-up. Empty for an ensemble.
    table : pandas.DataFrame
        A row for each entry, indexed by its label.
    """

    figures: dict[str, Any]
    arrays: Mapping[str, Array] = field(default_factory=dict)

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the entries, one row each, indexed by label."""
        import pandas as pd

        row = _ensemble_row if self.figures.get("kind") == "ensemble" else _row
        return pd.DataFrame([{"entry": one["label"], **row(one)} for one in self.figures["schemes"]]).set_index("entry")

    @property
    def series(self) -> pd.DataFrame:
        """DataFrame of the compared rows: times, errors and swings."""
        import pandas as pd

        return pd.DataFrame(dict(self.arrays))

    def as_dict(self) -> dict[str, Any]:
        """Return plain data that ``topcli report`` reads: the figures, and the rows that a picture needs."""
        if not self.arrays:
            return {"schema_version": 1, "command": "compare", **self.figures}
        return comparison_document(Comparison(self.figures, dict(self.arrays)))

    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.studies import comparison_chapter

        return comparison_chapter(self.figures, thinned(self.arrays) if self.arrays else {}, name)

    def plot(self, ax: Axes | None = None, *, what: Literal["error", "swing"] = "error") -> Axes:
        """Draw the errors over time, or the swinging component beside that of the reference.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into, in their own style; new ones by default.
        what : {"error", "swing"}, optional
            Columns to draw.

        Returns
        -------
        matplotlib Axes
            The axes.

        Raises
        ------
        UsageError
            For an ensemble, which has no series, and for any other word.
        """
        from topcli.figures.picture import REFERENCE, Line, Panel, component_symbol

        if not self.arrays:
            raise UsageError("plot: the comparison of an ensemble has no series; see its table")
        labels = [one["label"] for one in self.figures["schemes"]]
        if what == "error":
            lines = tuple(Line(f"error:{label}", label) for label in labels)
            panel = Panel(lines, "error of the state", log=True)
        elif what == "swing":
            lines = tuple(Line(f"swing:{label}", label) for label in (REFERENCE, *labels))
            panel = Panel(lines, component_symbol(self.figures["reference"]["swing"]))
        else:
            raise UsageError(f"plot: what={what!r} must be 'error' or 'swing'")
        errors = {name: np.where(one > 0.0, one, np.nan) for name, one in self.arrays.items() if "error:" in name}
        return draw_panel(panel, {**self.arrays, **errors}, ax)


def _row(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of one entry, flat."""
    back = figures["reversal"]
    rows = [*figures["invariants"], *figures["modified"]]
    return {
        **{key: figures[key] for key in PLAIN},
        "reversal_defect": back["defect"],
        "reversal_order": back["order"],
        **{f"{row['name']}_{key}": row[key] for row in rows for key in OF_INVARIANTS},
    }


def _ensemble_row(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of one entry of an ensemble, flat: quantiles of each measure."""
    measures = {f"{name}, {key}": x for name, found in figures["measures"].items() for key, x in found.items()}
    plain = ("scheme", "h", "N", "message", "reached_end", "nanoseconds_per_step")
    return {key: figures[key] for key in plain} | measures


def compare(
    *entries: str,
    config: str | Path | Mapping[str, Any] = PAPER_SCENE,
    overrides: Sequence[str] = (),
    options: Mapping[str, Any] | None = None,
    reference: str = "taylor",
    progress: bool = True,
    **changes: Any,
) -> ComparisonReport:
    """Compare schemes on one experiment or ensemble: errors, drifts, reversal, swings, speed.

    Parameters
    ----------
    *entries : str
        Names of schemes, each with its own options and step if need be: ``"hk"``, ``"hk:h=0.02"``,
        ``"hybrid:branch=sign"``. Entries with different steps cover the same time.
    config : path, str or mapping, optional
        Config file, name of a packaged scene, or the content of a config; the paper's scene by default.
    overrides : sequence of str, optional
        Texts ``"key=value"`` as for ``--set`` on the command line; applied after the ``changes``.
    options : mapping, optional
        Options for all schemes that have them.
    reference : {"taylor", "exact"}, optional
        Reference of the errors: a Taylor series in double-double arithmetic, or the closed form of the top.
    progress : bool, optional
        False to show no progress bar for an ensemble.
    **changes
        Values that replace whole top-level keys of the config, such as ``h=0.01``.

    Returns
    -------
    ComparisonReport
        Figures of each entry. Errors are Euclidean norms of the difference of states from the reference, which
        ``figures["reference"]`` names.

    Raises
    ------
    ConfigError
        If the config has a fault.
    UsageError
        For unknown schemes or options, for steps without common times, and for a closed form that the top does not
        have.

    Examples
    --------
    >>> import topcli
    >>> found = topcli.compare("hk", "hk:h=0.02", "rk4", config="kowalevski_generic_hk", h=0.01, T=5)
    >>> found
    <ComparisonReport of kowalevski_generic_hk: completed>
    >>> fine, coarse = found.table["max_error"][["hk", "hk:h=0.02"]]
    >>> bool(3.9 < coarse / fine < 4.1)
    True
    >>> axes = found.plot()
    >>> axes.get_yscale()
    'log'
    """
    if not entries:
        raise UsageError("compare: name at least one scheme, as in topcli.compare('hk', 'hybrid')")
    if isinstance(config, Mapping):
        experiment = any_from(changed(config, changes), overrides)
    else:
        experiment = load_any(config, overrides, changes)
    if isinstance(experiment, Experiment):
        found = compare_schemes(experiment, entries, options, reference)
        return ComparisonReport(found.figures, found.series)
    from topcli.studies.compare_ensemble import compare_ensemble

    with Progress(experiment.name, progress) as bar:
        return ComparisonReport(compare_ensemble(experiment, entries, options, bar, reference))
