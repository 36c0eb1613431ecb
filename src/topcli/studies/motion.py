"""Python interface for the class, the frequencies and the actions of a motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from topcli.analysis.motion.of_top import motion_of
from topcli.analysis.motion.result import Motion
from topcli.config.duration import changed
from topcli.config.load import experiment_from, load_experiment


def motion(
    config: str | Path | Mapping[str, Any] | None = None, *, overrides: Sequence[str] = (), **changes: Any
) -> Motion:
    """Return class, frequencies and neighbourhood of the exact motion that an experiment starts.

    Everything follows from the closed form; nothing is integrated, and scheme, ``h`` and ``N`` do not matter. All
    quantities are dimensionless, as in configs.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file, name of a packaged scene, or the content of a config, as for ``topcli.simulate``.
    overrides : sequence of str
        Texts ``"key=value"`` as for ``--set`` on the command line; applied after the ``changes``.
    **changes
        Values that replace whole top-level keys of the config.

    Returns
    -------
    Motion
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
        experiment = experiment_from({"name": "motion", **changed(config or {}, changes)}, overrides)
    else:
        experiment = load_experiment(config, overrides, changes, any_precision=True)
    return motion_of(experiment.top, experiment.y0)
