"""``topcli.motion``: the closed form of one motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.analysis.motion import QUANTITIES, Motion
from topcli.analysis.motion.of_top import closed_form_top, motion_of
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.show.report import Report, draw_panel

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter

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
    experiment = load_experiment(config, overrides, changes, any_precision=True)
    plain = motion_of(experiment.top, experiment.y0)
    return MotionReport(**{entry.name: getattr(plain, entry.name) for entry in fields(plain)}, experiment=experiment)
